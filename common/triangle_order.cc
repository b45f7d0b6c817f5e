#include "common/triangle_order.h"

#include <algorithm>
#include <array>
#include <numeric>
#include <utility>

#include "common/aabb.h"

namespace preheat {
namespace {

struct Range {
  std::size_t begin = 0;
  std::size_t end = 0;
  [[nodiscard]] std::size_t size() const { return end - begin; }
};

// Where a range is cut along an axis; nowhere yet while nothing is left of it.
struct Cut {
  std::size_t axis = 0;
  std::size_t left = 0;  // triangles
  float cost = 0.0F;
};

float half_area(const Aabb& box) {
  const Vec3 extent = box.extent();
  return extent.x * extent.y + extent.y * extent.z + extent.z * extent.x;
}

// Whole nodes of leaves while there are more than two of them.
std::size_t unit_of(std::size_t count) {
  if (count > 2 * kTrianglesPerLeafNode) { return kTrianglesPerLeafNode; }
  return count > kTrianglesPerLeafNode ? 2 * kTrianglesPerLeaf : kTrianglesPerLeaf;
}

// The triangles are numbered as they are given. For each axis a list of them all is kept sorted by
// their boxes' centres within every range, as they are divided.
class Ordering {
 public:
  explicit Ordering(std::vector<Aabb> boxes)
      : boxes_(std::move(boxes)), areas_(boxes_.size()), is_left_(boxes_.size()) {
    scratch_.resize(boxes_.size());
    for (std::size_t axis = 0; axis < 3; ++axis) {
      std::vector<std::uint32_t>& list = lists_[axis];
      list.resize(boxes_.size());
      std::iota(list.begin(), list.end(), 0U);
      std::vector<float> centres(boxes_.size());
      for (std::size_t at = 0; at < boxes_.size(); ++at) {
        centres[at] =
            boxes_[at].low[static_cast<int>(axis)] + boxes_[at].high[static_cast<int>(axis)];
      }
      std::stable_sort(list.begin(), list.end(),
                       [&](std::uint32_t a, std::uint32_t b) { return centres[a] < centres[b]; });
    }
  }

  [[nodiscard]] std::vector<std::uint32_t> take() {
    std::vector<Range> ranges{{0, boxes_.size()}};
    while (!ranges.empty()) {
      const Range range = ranges.back();
      ranges.pop_back();
      if (range.size() <= kTrianglesPerLeaf) { continue; }
      Cut best;
      for (std::size_t axis = 0; axis < 3; ++axis) { best_cut(range, axis, best); }
      divide(range, best);
      ranges.push_back({range.begin + best.left, range.end});
      ranges.push_back({range.begin, range.begin + best.left});
    }
    return std::move(lists_[0]);
  }

 private:
  void best_cut(const Range& range, std::size_t axis, Cut& best) {
    const std::vector<std::uint32_t>& list = lists_[axis];
    const std::size_t count = range.size();
    const std::size_t unit = unit_of(count);
    const std::size_t margin = std::max<std::size_t>(count / 8, 1);
    const std::size_t first = (margin + unit - 1) / unit * unit;
    const std::size_t last = std::max((count - margin) / unit * unit, first);
    Aabb right;
    for (std::size_t left = count; left-- > first;) {
      right.extend(boxes_[list[range.begin + left]]);
      if (left % unit == 0) { areas_[left] = half_area(right); }
    }
    Aabb box;
    for (std::size_t left = 1; left <= last; ++left) {
      box.extend(boxes_[list[range.begin + left - 1]]);
      if (left < first || left % unit != 0) { continue; }
      const float cost = half_area(box) * static_cast<float>(left) +
                         areas_[left] * static_cast<float>(count - left);
      if (best.left == 0 || cost < best.cost) { best = {axis, left, cost}; }
    }
  }

  void divide(const Range& range, const Cut& cut) {
    const std::vector<std::uint32_t>& along = lists_[cut.axis];
    for (std::size_t at = 0; at < range.size(); ++at) {
      is_left_[along[range.begin + at]] = at < cut.left;
    }
    for (std::size_t axis = 0; axis < 3; ++axis) {
      if (axis == cut.axis) { continue; }
      const auto begin = lists_[axis].begin() + static_cast<std::ptrdiff_t>(range.begin);
      const auto end = lists_[axis].begin() + static_cast<std::ptrdiff_t>(range.end);
      auto left = begin;
      auto right = scratch_.begin();
      for (auto at = begin; at != end; ++at) {
        if (is_left_[*at] != 0) {
          *left++ = *at;
        } else {
          *right++ = *at;
        }
      }
      std::copy(scratch_.begin(), right, left);
    }
  }

  std::vector<Aabb> boxes_;
  std::array<std::vector<std::uint32_t>, 3> lists_{};
  std::vector<float> areas_;  // right of each cut
  std::vector<char> is_left_;
  std::vector<std::uint32_t> scratch_{};
};

}  // namespace

std::vector<std::uint32_t> order_for_tree(const Scene& scene,
                                          std::span<const std::uint32_t> triangles) {
  std::vector<Aabb> boxes;
  boxes.reserve(triangles.size());
  for (const std::uint32_t triangle : triangles) {
    Aabb& box = boxes.emplace_back();
    for (const std::uint32_t vertex : scene.triangles[triangle].vertices) {
      box.extend(scene.positions[vertex]);
    }
  }
  std::vector<std::uint32_t> order = Ordering(std::move(boxes)).take();
  for (std::uint32_t& at : order) { at = triangles[at]; }
  return order;
}

}  // namespace preheat
