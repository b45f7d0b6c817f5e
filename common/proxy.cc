#include "common/proxy.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <numeric>
#include <optional>
#include <string>
#include <type_traits>
#include <unordered_map>
#include <utility>

#include "common/check.h"
#include "common/flat_index.h"
#include "common/voxel_block.h"

namespace preheat {
namespace {

static_assert(std::endian::native == std::endian::little);

// ---- pieces: convex polygons clipped to a cell ----

constexpr std::size_t kPieceVerticesMax = 9;  // a triangle cut by the six faces of a cell

struct Piece {
  std::uint32_t material = 0;
  bool emits = false;
  std::uint8_t count = 0;
  float twice_area = 0.0F;
  Vec3 normal{0.0F};  // as long as twice_area
  std::array<Vec3, kPieceVerticesMax> vertices{};

  void add(const Vec3& vertex) {
    if (count < kPieceVerticesMax) { vertices[count++] = vertex; }
  }
  void measure() {
    normal = Vec3(0.0F);
    for (std::uint32_t i = 2; i < count; ++i) {
      normal += glm::cross(vertices[i - 1] - vertices[0], vertices[i] - vertices[0]);
    }
    twice_area = glm::length(normal);
  }
  // False where rounding leaves nothing but a sliver.
  [[nodiscard]] bool has_area() const { return count >= 3 && twice_area > 0.0F; }
};

// Both parts of a piece beside the plane x[axis] = at, not measured where they are new. A piece in
// the plane is wholly below.
void split_piece(const Piece& piece, int axis, float at, Piece& below, Piece& above) {
  below.material = above.material = piece.material;
  below.emits = above.emits = piece.emits;
  below.count = above.count = 0;
  bool has_below = false;
  bool has_above = false;
  for (std::uint32_t i = 0; i < piece.count; ++i) {
    has_below |= piece.vertices[i][axis] < at;
    has_above |= piece.vertices[i][axis] > at;
  }
  if (!has_above) {
    below = piece;
    return;
  }
  if (!has_below) {
    above = piece;
    return;
  }
  for (std::uint32_t i = 0; i < piece.count; ++i) {
    const Vec3& from = piece.vertices[i];
    const Vec3& to = piece.vertices[i + 1 == piece.count ? 0 : i + 1];
    if (from[axis] <= at) { below.add(from); }
    if (from[axis] >= at) { above.add(from); }
    if ((from[axis] < at && to[axis] > at) || (from[axis] > at && to[axis] < at)) {
      // From the lower end, so that neighbours which share the edge cut it at the same point.
      const Vec3& low = from[axis] < to[axis] ? from : to;
      const Vec3& high = from[axis] < to[axis] ? to : from;
      Vec3 cut = low + (high - low) * ((at - low[axis]) / (high[axis] - low[axis]));
      cut[axis] = at;
      below.add(cut);
      above.add(cut);
    }
  }
}

Aabb bounds_of(const Piece& piece) {
  Aabb bounds;
  for (std::uint32_t i = 0; i < piece.count; ++i) { bounds.extend(piece.vertices[i]); }
  return bounds;
}

std::vector<Piece> pieces_in_cell(const Scene& scene, std::span<const std::uint32_t> triangles,
                                  const Aabb& cell) {
  std::vector<Piece> pieces;
  pieces.reserve(triangles.size());
  for (const std::uint32_t id : triangles) {
    const Triangle& triangle = scene.triangles[id];
    const bool emits = scene.materials[triangle.material].emission != Vec3(0.0F);
    Piece piece;
    piece.material = triangle.material;
    piece.emits = emits;
    for (const std::uint32_t vertex : triangle.vertices) { piece.add(scene.positions[vertex]); }
    // What lies in the lower face belongs to this cell too, as a voxel's triangles do: a wall
    // between two voxels stops the rays of both.
    const Aabb bounds = bounds_of(piece);
    Piece kept;
    Piece outside;
    for (int axis = 0; axis < 3; ++axis) {
      if (bounds.high[axis] > cell.high[axis]) {
        split_piece(piece, axis, cell.high[axis], kept, outside);
        piece = kept;
      }
      if (bounds.low[axis] < cell.low[axis]) {
        split_piece(piece, axis, cell.low[axis], outside, kept);
        piece = kept;
      }
    }
    piece.measure();
    if (piece.has_area()) { pieces.push_back(piece); }
  }
  return pieces;
}

// ---- the shadow of pieces on a face of their bounds ----

std::uint8_t code_255(float share) {
  return static_cast<std::uint8_t>(std::clamp(share, 0.0F, 1.0F) * 255.0F + 0.5F);
}

// A face of the bounds is looked at with so many samples a side, at the middle of as many squares.
constexpr unsigned kSamples = 16;
constexpr float kLastSample = static_cast<float>(kSamples - 1);

// For small numbers of either sign; std::ceil is a call into the C library.
int ceil_of(float x) {
  const int truncated = static_cast<int>(x);
  return truncated + (static_cast<float>(truncated) < x ? 1 : 0);
}
int floor_of(float x) {
  const int truncated = static_cast<int>(x);
  return truncated - (static_cast<float>(truncated) > x ? 1 : 0);
}

// Four neighbouring rows or columns of samples at once. Every lane is computed as a float is, so
// that nothing depends on how many there are. A comparison gives -1 for true and 0 for false.
constexpr int kLanes = 4;
using Float4 = float __attribute__((vector_size(16)));
using Int4 = std::int32_t __attribute__((vector_size(16)));

Float4 float4(float x) { return Float4{x, x, x, x}; }
Float4 float4(const Int4& x) { return __builtin_convertvector(x, Float4); }
Int4 truncated4(const Float4& x) { return __builtin_convertvector(x, Int4); }
Int4 lanes_from(int first) { return Int4{first, first + 1, first + 2, first + 3}; }

bool is_none(const Int4& condition) {
  std::array<std::uint64_t, 2> halves;
  std::memcpy(halves.data(), &condition, sizeof(condition));
  return (halves[0] | halves[1]) == 0;
}

// As std::clamp, but `low` of what is not a number.
Float4 clamp4(const Float4& x, float low, float high) {
  const Float4 raised = x > float4(low) ? x : float4(low);
  return float4(high) < raised ? float4(high) : raised;
}
Int4 ceil4(const Float4& x) {
  const Int4 truncated = truncated4(x);
  return truncated - (float4(truncated) < x);
}
Int4 floor4(const Float4& x) {
  const Int4 truncated = truncated4(x);
  return truncated + (float4(truncated) > x);
}

// The frame in which the samples of all six faces of the bounds have the coordinates 0 to
// kSamples - 1.
struct SampleFrame {
  explicit SampleFrame(const Aabb& bounds)
      : low(bounds.low), scale(Vec3(static_cast<float>(kSamples)) / bounds.extent()) {}
  [[nodiscard]] Vec3 point(const Vec3& scene) const { return (scene - low) * scale - 0.5F; }
  // Of a plane, any length.
  [[nodiscard]] Vec3 normal(const Vec3& scene) const { return scene / scale; }

  Vec3 low;
  Vec3 scale;
};

// How high over a face's samples a plane lies, in the sample frame.
struct SeenPlane {
  // `normal` in the sample frame, not edge-on.
  SeenPlane(const FlatAxes& axes, const Vec3& normal, const Vec3& point) {
    const float reciprocal = 1.0F / normal[axes.axis];
    per_column = -normal[axes.u] * reciprocal;
    per_row = -normal[axes.v] * reciprocal;
    origin = point[axes.axis] - per_column * point[axes.u] - per_row * point[axes.v];
  }
  // Calls visit(block, covered, heights) for each four columns, from block * kLanes, that hold any
  // from first to last; `covered` tells which.
  template <class Visit>
  void for_each_block(int row, int first, int last, Visit&& visit) const {
    for (int block = first / kLanes; block <= last / kLanes; ++block) {
      const Int4 columns = lanes_from(block * kLanes);
      const Int4 covered = (columns >= Int4{} + first) & (columns <= Int4{} + last);
      visit(block, covered,
            float4(origin) + float4(per_column) * float4(columns) +
                float4(per_row * static_cast<float>(row)));
    }
  }
  float origin = 0.0F;
  float per_column = 0.0F;
  float per_row = 0.0F;
};

// A piece in the sample frame.
struct SampledPiece {
  // The samples along an axis among which it lies.
  struct Range {
    [[nodiscard]] bool is_empty() const { return first > last; }
    int first;
    int last;
  };

  SampledPiece(const Piece& piece, const SampleFrame& frame)
      : material(piece.material), count(piece.count), normal(frame.normal(piece.normal)) {
    Vec3 low(kInfinity);
    Vec3 high(-kInfinity);
    for (std::uint32_t i = 0; i < count; ++i) {
      vertices[i] = frame.point(piece.vertices[i]);
      low = glm::min(low, vertices[i]);
      high = glm::max(high, vertices[i]);
    }
    for (int axis = 0; axis < 3; ++axis) {
      ranges[static_cast<std::size_t>(axis)] = {ceil_of(std::max(low[axis], 0.0F)),
                                                floor_of(std::min(high[axis], kLastSample))};
    }
  }

  [[nodiscard]] const Range& range(int axis) const {
    return ranges[static_cast<std::size_t>(axis)];
  }

  // False for most pieces that are smaller than a sample's square.
  [[nodiscard]] bool may_cover_samples(const FlatAxes& axes) const {
    return !range(axes.u).is_empty() && !range(axes.v).is_empty();
  }

  // Calls visit(row, first, last) for each row in which the piece covers samples of the face.
  template <class Visit>
  void for_each_row(const FlatAxes& axes, Visit&& visit) const {
    if (!may_cover_samples(axes)) { return; }
    const Range rows = range(axes.v);
    for (int block = rows.first / kLanes; block <= rows.last / kLanes; ++block) {
      const Float4 at = float4(lanes_from(block * kLanes));
      Float4 from = float4(kInfinity);
      Float4 to = float4(-kInfinity);
      for (std::uint32_t i = 0; i < count; ++i) {
        const Vec3& a = vertices[i];
        const Vec3& b = vertices[i + 1 == count ? 0 : i + 1];
        if (a[axes.v] == b[axes.v]) { continue; }
        const Int4 crossing = (float4(a[axes.v]) <= at) ^ (float4(b[axes.v]) <= at);
        const Float4 u =
            float4(a[axes.u]) + float4(b[axes.u] - a[axes.u]) *
                                    ((at - float4(a[axes.v])) / float4(b[axes.v] - a[axes.v]));
        from = crossing & (u < from) ? u : from;
        to = crossing & (to < u) ? u : to;
      }
      const Int4 first = ceil4(clamp4(from, 0.0F, kLastSample + 1.0F));
      const Int4 last = floor4(clamp4(to, -1.0F, kLastSample));
      for (int lane = 0; lane < kLanes; ++lane) {
        if (first[lane] <= last[lane]) { visit(block * kLanes + lane, first[lane], last[lane]); }
      }
    }
  }

  std::uint32_t material;
  std::uint32_t count;
  Vec3 normal;
  std::array<Range, 3> ranges;                   // by axis
  std::array<Vec3, kPieceVerticesMax> vertices;  // [count]
};

// One bit for every sample of a face.
class SampleBits {
 public:
  void add(int row, int first, int last) {
    rows_[static_cast<std::size_t>(row)] |= run(first, last);
  }

  [[nodiscard]] int count() const {
    int sum = 0;
    for (const unsigned row : rows_) { sum += std::popcount(row); }
    return sum;
  }

  // By flat_bit, how many of its samples each of 8 x 8 squares holds.
  [[nodiscard]] std::array<std::uint8_t, 64> squares() const {
    std::array<std::uint8_t, 64> counts{};
    for (unsigned row = 0; row < kSamples; ++row) {
      for (unsigned left = rows_[row]; left != 0; left &= left - 1) {
        const auto column = static_cast<unsigned>(std::countr_zero(left));
        ++counts[flat_bit(column * 8 / kSamples, row * 8 / kSamples)];
      }
    }
    return counts;
  }

 private:
  [[nodiscard]] static unsigned run(int first, int last) {
    return ((2U << static_cast<unsigned>(last)) - 1U) &
           ~((1U << static_cast<unsigned>(first)) - 1U);
  }

  std::array<unsigned, kSamples> rows_{};
};

// ---- the blocks of a scattered leaf ----

// How many of the 16 columns of blocks along the axis have 0 to 4 occupied ones.
std::array<int, 5> column_heights(std::uint64_t blocks, int axis) {
  std::array<int, 16> height{};
  for (; blocks != 0; blocks &= blocks - 1) {
    const auto bit = static_cast<unsigned>(std::countr_zero(blocks));
    const std::array<unsigned, 3> at{bit & 3U, bit >> 2U & 3U, bit >> 4U};
    const FlatAxes axes = axes_along(axis);
    ++height[at[static_cast<std::size_t>(axes.u)] * 4 + at[static_cast<std::size_t>(axes.v)]];
  }
  std::array<int, 5> count{};
  for (const int blocks_high : height) { ++count[static_cast<std::size_t>(blocks_high)]; }
  return count;
}

// The probability that a block stops a ray along the axis with which the columns' shadow covers
// `covered` of the face.
float block_coverage(const std::array<int, 5>& columns, float covered) {
  float low = 0.0F;
  float high = 1.0F;
  for (int i = 0; i < 12; ++i) {
    const float middle = 0.5F * (low + high);
    float shadow = 0.0F;
    float passing = 1.0F;
    for (std::size_t blocks_high = 0; blocks_high < columns.size(); ++blocks_high) {
      shadow += static_cast<float>(columns[blocks_high]) * (1.0F - passing) / 16.0F;
      passing *= 1.0F - middle;
    }
    (shadow < covered ? low : high) = middle;
  }
  return high;
}

// ---- summaries ----

// Some of a voxel's pieces.
struct Selection {
  const std::vector<Piece>& pieces;
  std::span<const std::uint32_t> indices;

  template <class Visit>
  void for_each(Visit&& visit) const {
    for (const std::uint32_t index : indices) { visit(pieces[index]); }
  }
  [[nodiscard]] const Piece& first() const { return pieces[indices[0]]; }
  [[nodiscard]] bool has_one_material() const {
    return std::all_of(indices.begin(), indices.end(), [this](std::uint32_t index) {
      return pieces[index].material == first().material;
    });
  }
};

// A flat leaf's geometry stays within this share of the bounds' diagonal across its plane, and its
// normals agree at least this much.
constexpr float kFlatThicknessMax = 0.2F;
constexpr float kFlatAgreementMin = 0.75F;

void store_mask(ProxyRecord& record, std::uint64_t mask) {
  for (std::uint16_t& part : record.mask) {
    part = static_cast<std::uint16_t>(mask);
    mask >>= 16U;
  }
}

struct Summary {
  ProxyRecord record{};  // without materials
  std::array<std::uint32_t, 2> materials{};
  // How much a ray's fate is misjudged: the chance that a random ray meets the bounds, by their
  // surface, times a measure in [0,1] of what one record cannot tell.
  float error = 0.0F;
};

struct Normals {
  Vec3 mean{0.0F};         // unit
  float agreement = 0.0F;  // length of the mean of the unit normals, turned to one side
  bool oriented = false;
  double area = 0.0;
  double area_emitting = 0.0;
};

Normals normals_of(const Selection& selection) {
  Normals normals;
  Vec3 projected(0.0F);
  selection.for_each([&](const Piece& piece) { projected += glm::abs(piece.normal); });
  const int dominant = flat_axes(projected).axis;
  Vec3d signed_sum(0.0);
  Vec3d turned_sum(0.0);
  selection.for_each([&](const Piece& piece) {
    const Vec3d vector(piece.normal);
    const auto area = static_cast<double>(piece.twice_area);
    normals.area += area;
    if (piece.emits) { normals.area_emitting += area; }
    signed_sum += vector;
    turned_sum += vector[dominant] < 0.0 ? -vector : vector;
  });
  const double signed_length = glm::length(signed_sum);
  const double turned_length = glm::length(turned_sum);
  normals.oriented = signed_length > 0.6 * normals.area;
  normals.agreement = static_cast<float>(turned_length / normals.area);
  normals.mean = Vec3(normals.oriented ? signed_sum / signed_length : turned_sum / turned_length);
  return normals;
}

Aabb bounds_of(const Selection& selection) {
  Aabb bounds;
  selection.for_each([&](const Piece& piece) {
    for (std::uint32_t i = 0; i < piece.count; ++i) { bounds.extend(piece.vertices[i]); }
  });
  return bounds;
}

float half_surface(const Aabb& box) {
  const Vec3 e = box.extent();
  return e.x * e.y + e.y * e.z + e.z * e.x;
}

void set_bounds(ProxyRecord& record, const Aabb& tight, const Aabb& cell) {
  const Vec3 scale = Vec3(255.0F) / cell.extent();
  for (int axis = 0; axis < 3; ++axis) {
    const auto i = static_cast<std::size_t>(axis);
    const float low = std::floor((tight.low[axis] - cell.low[axis]) * scale[axis]);
    const float high = std::ceil((tight.high[axis] - cell.low[axis]) * scale[axis]);
    record.low[i] = static_cast<std::uint8_t>(std::clamp(low, 0.0F, 255.0F));
    record.high[i] = static_cast<std::uint8_t>(std::clamp(high, 0.0F, 255.0F));
  }
}

// How often materials are seen; the first eight that turn up are told apart.
class SeenMaterials {
 public:
  void add(std::uint32_t material, unsigned times) {
    std::size_t i = 0;
    while (i < count_ && seen_[i].material != material) { ++i; }
    if (i == seen_.size()) { return; }
    if (i == count_) { seen_[count_++].material = material; }
    seen_[i].times += times;
    total_ += times;
  }

  struct Seen {
    std::uint32_t material = 0;
    unsigned times = 0;
  };
  // The two seen most; the first one's material for both if there is one only.
  [[nodiscard]] std::array<Seen, 2> most() const {
    Seen major = seen_[0];
    Seen minor{seen_[0].material, 0};
    for (std::size_t i = 1; i < count_; ++i) {
      if (seen_[i].times > major.times) {
        minor = std::exchange(major, seen_[i]);
      } else if (seen_[i].times > minor.times) {
        minor = seen_[i];
      }
    }
    return {major, minor};
  }
  // How often `minor` is seen of the times that either is; 0 where they are one.
  [[nodiscard]] std::optional<float> share_of_both(std::uint32_t major, std::uint32_t minor) const {
    if (major == minor) { return 0.0F; }
    const unsigned both = times(major) + times(minor);
    if (both == 0) { return std::nullopt; }
    return static_cast<float>(times(minor)) / static_cast<float>(both);
  }
  [[nodiscard]] bool empty() const { return count_ == 0; }
  [[nodiscard]] float share(unsigned times) const {
    return total_ > 0 ? static_cast<float>(times) / static_cast<float>(total_) : 0.0F;
  }

 private:
  [[nodiscard]] unsigned times(std::uint32_t material) const {
    for (std::size_t i = 0; i < count_; ++i) {
      if (seen_[i].material == material) { return seen_[i].times; }
    }
    return 0;
  }

  std::array<Seen, 8> seen_{};
  std::size_t count_ = 0;
  unsigned total_ = 0;
};

// Which materials the samples of a face and of the one opposite see.
class SeenSides {
 public:
  SeenSides() {
    low_.fill(Block{float4(kInfinity), Int4{}});
    high_.fill(Block{float4(-kInfinity), Int4{}});
  }

  // Four samples of a row, in the given block of columns, at which the piece has such heights.
  void add(int row, int block, const Int4& covered, const Float4& heights, std::uint32_t material) {
    const auto at = static_cast<std::size_t>(row * kBlocks + block);
    const Int4 materials = Int4{} + static_cast<std::int32_t>(material);
    const Int4 is_lower = covered & (heights < low_[at].heights);
    low_[at].heights = is_lower ? heights : low_[at].heights;
    low_[at].materials = is_lower ? materials : low_[at].materials;
    const Int4 is_higher = covered & (heights > high_[at].heights);
    high_[at].heights = is_higher ? heights : high_[at].heights;
    high_[at].materials = is_higher ? materials : high_[at].materials;
  }

  // Calls visit(material, times), row by row, for samples that see it one after the other.
  template <class Visit>
  void see_from_below(Visit&& visit) const {
    see(low_, visit);
  }
  template <class Visit>
  void see_from_above(Visit&& visit) const {
    see(high_, visit);
  }

 private:
  static constexpr int kBlocks = static_cast<int>(kSamples) / kLanes;
  struct Block {
    Float4 heights;
    Int4 materials;
  };
  using Blocks = std::array<Block, std::size_t{kSamples} * kBlocks>;

  template <class Visit>
  static void see(const Blocks& blocks, Visit&& visit) {
    std::int32_t material = 0;
    unsigned times = 0;
    for (const Block& block : blocks) {
      const Int4 is_seen =
          (block.heights < float4(kInfinity)) & (block.heights > float4(-kInfinity));
      if (is_none(is_seen)) { continue; }
      const Int4 is_other = is_seen & (block.materials != material);
      if (is_none(is_other)) {
        times -= static_cast<unsigned>(is_seen[0] + is_seen[1] + is_seen[2] + is_seen[3]);
        continue;
      }
      for (int lane = 0; lane < kLanes; ++lane) {
        if (is_seen[lane] == 0) { continue; }
        if (block.materials[lane] != material && times > 0) {
          visit(static_cast<std::uint32_t>(material), std::exchange(times, 0));
        }
        material = block.materials[lane];
        ++times;
      }
    }
    if (times > 0) { visit(static_cast<std::uint32_t>(material), times); }
  }

  Blocks low_;
  Blocks high_;
};

// Which of the 4 x 4 x 4 blocks hold what the samples of a face see.
class SeenBlocks {
 public:
  void add(int row, int block, const Int4& covered, const Float4& heights) {
    constexpr float kBlocksPerSample = 4.0F / static_cast<float>(kSamples);
    const Int4 layer =
        truncated4(clamp4((heights + float4(0.5F)) * float4(kBlocksPerSample), 0.0F, 3.0F));
    // 2^layer by way of a float's exponent: there is no shift by lanes before AVX2.
    const Int4 exponent = (layer + 127) << 23;
    Float4 power;
    std::memcpy(&power, &exponent, sizeof(power));
    seen_[static_cast<std::size_t>(row / kLanes * 4 + block)] |= covered & truncated4(power);
  }

  [[nodiscard]] std::uint64_t blocks(const FlatAxes& axes) const {
    std::uint64_t blocks = 0;
    std::array<unsigned, 3> at{};
    for (unsigned column = 0; column < 16; ++column) {
      const Int4& lanes = seen_[column];
      const int layers = lanes[0] | lanes[1] | lanes[2] | lanes[3];
      at[static_cast<std::size_t>(axes.u)] = column & 3U;
      at[static_cast<std::size_t>(axes.v)] = column >> 2U;
      for (unsigned left = static_cast<unsigned>(layers); left != 0; left &= left - 1) {
        at[static_cast<std::size_t>(axes.axis)] = static_cast<unsigned>(std::countr_zero(left));
        blocks |= std::uint64_t{1} << block_bit(at[0], at[1], at[2]);
      }
    }
    return blocks;
  }

 private:
  static_assert(kSamples == 4 * kLanes, "a lane for each column of a block");
  std::array<Int4, 16> seen_{};  // by row and column of blocks; bit i of a lane: layer i
};

// The mean distance of the pieces along the normal, and the range of their vertices.
struct Spread {
  float mean = 0.0F;
  float range = 0.0F;
};

Spread spread_along(const Vec3& normal, const Selection& selection) {
  float low = kInfinity;
  float high = -kInfinity;
  double sum = 0.0;
  double weight = 0.0;
  selection.for_each([&](const Piece& piece) {
    float middle = 0.0F;
    for (std::uint32_t i = 0; i < piece.count; ++i) {
      const float distance = glm::dot(normal, piece.vertices[i]);
      low = std::min(low, distance);
      high = std::max(high, distance);
      middle += distance;
    }
    const auto area = static_cast<double>(piece.twice_area);
    sum += area * static_cast<double>(middle) / static_cast<double>(piece.count);
    weight += area;
  });
  return {static_cast<float>(sum / weight), high - low};
}

// Weights in a record's error of what it guesses about materials; most of all, whether a surface is
// the lamp or what the lamp hangs from, as rays to the lamp make up a good part of all rays.
constexpr float kMaterialWeight = 0.5F;
constexpr float kLampWeight = 4.0F;

// Each returns what the record cannot tell.
float set_flat_materials(Summary& summary, const SeenSides& sides, const FlatAxes& axes,
                         const Vec3& normal) {
  SeenMaterials above;
  SeenMaterials below;
  sides.see_from_above([&](std::uint32_t material, unsigned times) { above.add(material, times); });
  sides.see_from_below([&](std::uint32_t material, unsigned times) { below.add(material, times); });
  if (above.empty()) { return 0.0F; }
  const bool is_up = normal[axes.axis] > 0.0F;
  const auto front = (is_up ? above : below).most();
  const auto back = (is_up ? below : above).most();
  summary.materials = {front[0].material, back[0].material};
  return kMaterialWeight * (above.share(front[1].times) + below.share(back[1].times));
}

// What of a plane is there.
struct PlaneCover {
  std::uint64_t mask = 0;
  float coverage = 1.0F;  // of each square in the mask
  float unknown = 0.0F;   // share of all samples for which that is wrong
};

// Opaque squares, as many as the covered samples fill and where they are densest: a wall must not
// let a share of all rays through because it has a door. Where that places too many samples
// wrongly, as on a grating, every square that holds any is partly transparent instead.
PlaneCover cover_plane(const SampleBits& bits) {
  constexpr int kSquareSamples = static_cast<int>(kSamples * kSamples) / 64;
  constexpr float kAllSamples = static_cast<float>(kSamples * kSamples);
  constexpr float kMisplacedMax = 0.25F;
  const std::array<std::uint8_t, 64> squares = bits.squares();
  std::array<int, kSquareSamples + 1> with_count{};
  std::uint64_t any = 0;
  int covered = 0;
  for (std::size_t square = 0; square < squares.size(); ++square) {
    ++with_count[squares[square]];
    covered += squares[square];
    if (squares[square] > 0) { any |= std::uint64_t{1} << square; }
  }
  PlaneCover opaque;
  int left = (covered + kSquareSamples / 2) / kSquareSamples;
  int misplaced = 0;
  for (int count = kSquareSamples; count > 0; --count) {
    const int candidates = with_count[static_cast<std::size_t>(count)];
    const int taken = std::min(left, candidates);
    left -= taken;
    misplaced += taken * (kSquareSamples - count) + (candidates - taken) * count;
    // Spread over the candidates.
    int seen = 0;
    for (std::size_t square = 0; taken > 0 && square < squares.size(); ++square) {
      if (squares[square] != count) { continue; }
      if ((seen + 1) * taken / candidates > seen * taken / candidates) {
        opaque.mask |= std::uint64_t{1} << square;
      }
      ++seen;
    }
  }
  opaque.unknown = static_cast<float>(misplaced) / kAllSamples;
  if (opaque.mask != 0 &&
      static_cast<float>(misplaced) <= kMisplacedMax * static_cast<float>(covered)) {
    return opaque;
  }
  const int samples = kSquareSamples * std::popcount(any);
  const float coverage =
      samples > 0 ? static_cast<float>(covered) / static_cast<float>(samples) : 0.0F;
  const float share = static_cast<float>(std::popcount(any)) / 64.0F;
  return {any, coverage, share * coverage * (1.0F - coverage)};
}

float set_flat(Summary& summary, const Selection& selection, const Spread& spread,
               const Aabb& bounds, bool has_one_material) {
  ProxyRecord& record = summary.record;
  const Vec3 normal = record_normal(record);
  const PlaneRange range = plane_range(normal, bounds);
  const float at = (spread.mean - range.low) / (range.high - range.low);
  record.shape |= kShapeFlat;
  set_record_plane(record, at);
  const float thickness = spread.range / glm::length(bounds.extent());
  // Rounded up, as rays must clear all of it; but what is flat up to rounding stays so.
  record.thickness =
      static_cast<std::uint8_t>(std::ceil(std::min(thickness, 1.0F) * 255.0F - 0.05F));

  const FlatAxes axes = flat_axes(normal);
  const SampleFrame frame(bounds);
  SampleBits bits;
  std::optional<SeenSides> sides;
  if (!has_one_material) { sides.emplace(); }
  selection.for_each([&](const Piece& piece) {
    const SampledPiece sampled(piece, frame);
    const SeenPlane plane(axes, sampled.normal, sampled.vertices[0]);
    const bool has_height = sides && sampled.normal[axes.axis] != 0.0F;
    sampled.for_each_row(axes, [&](int row, int first, int last) {
      bits.add(row, first, last);
      if (!has_height) { return; }
      plane.for_each_block(row, first, last,
                           [&](int block, const Int4& covered, const Float4& heights) {
                             sides->add(row, block, covered, heights, piece.material);
                           });
    });
  });
  const PlaneCover cover = cover_plane(bits);
  store_mask(record, cover.mask);
  record.coverage[0] = code_255(cover.coverage);
  const float unknown = thickness + cover.unknown;
  return has_one_material ? unknown : unknown + set_flat_materials(summary, *sides, axes, normal);
}

// What the samples of a face and of the one opposite see.
struct SeenFace {
  void add(const SampledPiece& piece, const FlatAxes& axes, SeenSides* sides) {
    if (!piece.may_cover_samples(axes)) { return; }
    const bool is_edge_on = piece.normal[axes.axis] == 0.0F;
    const SeenPlane plane(axes, piece.normal, piece.vertices[0]);
    piece.for_each_row(axes, [&](int row, int first, int last) {
      bits.add(row, first, last);
      if (is_edge_on) { return; }
      plane.for_each_block(row, first, last,
                           [&](int block, const Int4& covered, const Float4& heights) {
                             blocks.add(row, block, covered, heights);
                             if (sides != nullptr) {
                               sides->add(row, block, covered, heights, piece.material);
                             }
                           });
    });
  }

  SampleBits bits;
  SeenBlocks blocks;
};

float set_scattered_materials(Summary& summary, const std::array<SeenSides, 3>& sides) {
  SeenMaterials all;
  std::array<SeenMaterials, 3> below;
  std::array<SeenMaterials, 3> above;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    sides[axis].see_from_below([&](std::uint32_t material, unsigned times) {
      below[axis].add(material, times);
      all.add(material, times);
    });
    sides[axis].see_from_above([&](std::uint32_t material, unsigned times) {
      above[axis].add(material, times);
      all.add(material, times);
    });
  }
  if (all.empty()) { return 0.0F; }
  const auto most = all.most();
  summary.materials = {most[0].material, most[1].material};
  const float share_mean =
      static_cast<float>(most[1].times) / static_cast<float>(most[0].times + most[1].times);
  const auto code_15 = [&](const SeenMaterials& side) {
    const float share = side.share_of_both(most[0].material, most[1].material).value_or(share_mean);
    return static_cast<unsigned>(share * 15.0F + 0.5F);
  };
  for (std::size_t axis = 0; axis < 3; ++axis) {
    summary.record.place[axis] =
        static_cast<std::uint8_t>(code_15(below[axis]) | code_15(above[axis]) << 4U);
  }
  return kMaterialWeight * all.share(most[1].times);
}

// 0 where all normals lie along axes, 1 where they are as those of a sphere, whose |x| + |y| + |z|
// is 3/2 on average, or further from the axes yet; 0 of nothing.
class Roundness {
 public:
  void add(const Piece& piece) {
    const Vec3 normal = glm::abs(piece.normal);
    sum_ += normal.x + normal.y + normal.z;
    area_ += piece.twice_area;
  }
  [[nodiscard]] float value() const {
    return area_ > 0.0F ? std::clamp(2.0F * (sum_ / area_ - 1.0F), 0.0F, 1.0F) : 0.0F;
  }
  [[nodiscard]] unsigned code_7() const { return static_cast<unsigned>(value() * 7.0F + 0.5F); }

 private:
  float sum_ = 0.0F;
  float area_ = 0.0F;
};

void set_roundness(Summary& summary, const Selection& selection) {
  Roundness all;
  Roundness major;
  Roundness minor;
  selection.for_each([&](const Piece& piece) {
    all.add(piece);
    if (piece.material == summary.materials[0]) { major.add(piece); }
    if (piece.material == summary.materials[1]) { minor.add(piece); }
  });
  ProxyRecord& record = summary.record;
  record.thickness = code_255(all.value());
  record.shape = static_cast<std::uint8_t>(record.shape | major.code_7() << kShapeMajorRoundness |
                                           minor.code_7() << kShapeMinorRoundness);
}

float set_scattered(Summary& summary, const Selection& selection, const Aabb& bounds,
                    bool has_one_material) {
  ProxyRecord& record = summary.record;
  const SampleFrame frame(bounds);
  std::array<SeenFace, 3> faces;
  std::optional<std::array<SeenSides, 3>> sides;
  if (!has_one_material) { sides.emplace(); }
  selection.for_each([&](const Piece& piece) {
    const SampledPiece sampled(piece, frame);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      faces[axis].add(sampled, axes_along(static_cast<int>(axis)),
                      sides ? &(*sides)[axis] : nullptr);
    }
  });
  std::uint64_t blocks = 0;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    blocks |= faces[axis].blocks.blocks(axes_along(static_cast<int>(axis)));
  }
  store_mask(record, blocks);
  float unknown = 0.0F;
  for (int axis = 0; axis < 3; ++axis) {
    const auto i = static_cast<std::size_t>(axis);
    const std::array<int, 5> columns = column_heights(blocks, axis);
    const float stopped =
        block_coverage(columns, static_cast<float>(faces[i].bits.count()) / (kSamples * kSamples));
    record.coverage[i] = code_255(stopped);
    const float occupied = static_cast<float>(16 - columns[0]) / 16.0F;
    unknown += occupied * (0.25F + stopped * (1.0F - stopped)) / 3.0F;
  }
  if (!has_one_material) { unknown += set_scattered_materials(summary, *sides); }
  set_roundness(summary, selection);
  return unknown;
}

Summary summarise(const Selection& selection, const Aabb& cell) {
  Summary summary;
  ProxyRecord& record = summary.record;
  if (selection.indices.empty()) { return summary; }
  const Aabb tight = bounds_of(selection);
  set_bounds(record, tight, cell);
  summary.materials = {selection.first().material, selection.first().material};
  const Aabb bounds = record_bounds(record, cell);
  const Normals normals = normals_of(selection);
  const std::uint32_t code = encode_normal(normals.mean);
  record.normal = {static_cast<std::uint16_t>(code), static_cast<std::uint16_t>(code >> 16U)};
  record.shape = normals.oriented ? kShapeOriented : 0;

  const bool has_one_material = selection.has_one_material();
  const Spread spread = spread_along(record_normal(record), selection);
  const bool is_flat = spread.range <= kFlatThicknessMax * glm::length(tight.extent()) &&
                       normals.agreement >= kFlatAgreementMin;
  const float unknown = is_flat ? set_flat(summary, selection, spread, bounds, has_one_material)
                                : set_scattered(summary, selection, bounds, has_one_material);
  const auto lamps = static_cast<float>(normals.area_emitting / normals.area);
  summary.error = half_surface(tight) * (unknown + kLampWeight * lamps * (1.0F - lamps));
  return summary;
}

// ---- one voxel's tree, split where the error is largest first ----

constexpr std::uint32_t kNeverSplit = 0xFFFFFFFF;
// Rays that meet less than this of the scene's unit surface are too few to tell apart.
constexpr float kErrorMin = 2e-7F;

// So many rays meet this that a voxel of few triangles, the edge of a room, is split for them too.
constexpr float kErrorLarge = 1e-4F;
constexpr std::size_t kLeavesMax = 256;

struct BuildNode {
  Summary summary{};
  std::uint32_t first_child = 0;
  std::uint8_t child_mask = 0;
  std::uint32_t split = kNeverSplit;  // how many splits of the voxel came before its own
};

struct BuildSplit {
  float error = 0.0F;       // the least of this split's and all earlier ones'
  std::uint32_t added = 0;  // leaves
};

struct VoxelTree {
  Aabb cell{};
  std::vector<BuildNode> nodes{};
  std::vector<BuildSplit> splits{};  // in order
  std::uint32_t splits_kept = 0;
  float error_min = kInfinity;  // every split of at least this error is there; infinity = not built
};

// Where many triangles coincide every split multiplies their pieces, so splitting ends at this many
// times the voxel's own.
constexpr std::size_t kPieceGrowthMax = 8;
constexpr std::size_t kPiecesFree = 4096;

class VoxelTreeBuilder {
 public:
  explicit VoxelTreeBuilder(VoxelTree& tree) : tree_(tree) {}

  // Leaves out splits of an error below `error_min`.
  void build(std::vector<Piece> pieces, std::size_t leaf_count_max, float error_min) {
    const std::size_t pieces_max = kPieceGrowthMax * pieces.size() + kPiecesFree;
    pieces_ = std::move(pieces);
    std::vector<std::uint32_t> all(pieces_.size());
    std::iota(all.begin(), all.end(), 0U);
    tree_.nodes.push_back({summarise({pieces_, all}, tree_.cell)});
    push({0, 0, tree_.cell, std::move(all)});
    std::size_t leaf_count = 1;
    float error = kInfinity;
    while (!open_.empty()) {
      const float error_next = tree_.nodes[open_.front().node].summary.error;
      if (error_next < error_min) {
        tree_.error_min = error_min;
        return;
      }
      const std::size_t max = error_next > kErrorLarge ? kLeavesMax : leaf_count_max;
      if (leaf_count >= max || pieces_.size() > pieces_max) { break; }
      std::pop_heap(open_.begin(), open_.end(), later_);
      const Open open = std::move(open_.back());
      open_.pop_back();
      const std::uint32_t children = split(open);
      if (children == 0) { continue; }
      BuildNode& node = tree_.nodes[open.node];
      node.split = static_cast<std::uint32_t>(tree_.splits.size());
      error = std::min(error, node.summary.error);
      tree_.splits.push_back({error, children - 1});
      leaf_count += children - 1;
    }
    tree_.error_min = 0.0F;
  }

 private:
  struct Open {
    std::uint32_t node = 0;
    unsigned depth = 0;
    Aabb cell{};
    std::vector<std::uint32_t> pieces{};  // into pieces_
  };

  struct Later {
    const VoxelTree* tree;
    bool operator()(const Open& a, const Open& b) const {
      const float error_a = tree->nodes[a.node].summary.error;
      const float error_b = tree->nodes[b.node].summary.error;
      return error_a != error_b ? error_a < error_b : a.node > b.node;
    }
  };

  void push(Open open) {
    const bool is_small = open.cell.extent().x < 8.0F * kVoxelMargin;
    if (tree_.nodes[open.node].summary.error < kErrorMin || open.depth == kProxyDepthMax ||
        is_small) {
      return;
    }
    open_.push_back(std::move(open));
    std::push_heap(open_.begin(), open_.end(), later_);
  }

  using Parts = std::array<std::vector<std::uint32_t>, 8>;  // by octant, into pieces_

  // Returns how many children the node got; none if rounding leaves nothing of its slivers.
  std::uint32_t split(const Open& open) {
    const Vec3 middle = child_cell(open.cell, 0).high;
    Parts parts;
    for (const std::uint32_t piece : open.pieces) { distribute(piece, middle, parts); }
    const auto first_child = static_cast<std::uint32_t>(tree_.nodes.size());
    tree_.nodes[open.node].first_child = first_child;
    std::uint32_t count = 0;
    for (unsigned octant = 0; octant < 8; ++octant) {
      if (parts[octant].empty()) { continue; }
      const Aabb cell = child_cell(open.cell, octant);
      tree_.nodes.push_back({summarise({pieces_, parts[octant]}, cell)});
      tree_.nodes[open.node].child_mask |= static_cast<std::uint8_t>(1U << octant);
      push({first_child + count, open.depth + 1, cell, std::move(parts[octant])});
      ++count;
    }
    return count;
  }

  void distribute(std::uint32_t index, const Vec3& middle, Parts& parts) {
    const Piece& piece = pieces_[index];
    unsigned above = 0;  // bit per axis
    unsigned cut_axes = 0;
    for (unsigned axis = 0; axis < 3; ++axis) {
      const int i = static_cast<int>(axis);
      bool has_below = false;
      bool has_above = false;
      for (std::uint32_t vertex = 0; vertex < piece.count; ++vertex) {
        has_below |= piece.vertices[vertex][i] < middle[i];
        has_above |= piece.vertices[vertex][i] > middle[i];
      }
      if (has_above && has_below) { cut_axes |= 1U << axis; }
      if (has_above && !has_below) { above |= 1U << axis; }
    }
    if (cut_axes == 0) {
      parts[above].push_back(index);
      return;
    }
    for (Piece& cut : cut_) { cut.count = 0; }
    cut_[above] = piece;
    for (unsigned axis = 0; axis < 3; ++axis) {
      if ((cut_axes >> axis & 1U) == 0) { continue; }
      for (unsigned octant = 0; octant < 8; ++octant) {
        if ((octant >> axis & 1U) != 0 || cut_[octant].count == 0) { continue; }
        const Piece whole = cut_[octant];
        split_piece(whole, static_cast<int>(axis), middle[static_cast<int>(axis)], cut_[octant],
                    cut_[octant | (1U << axis)]);
      }
    }
    for (unsigned octant = 0; octant < 8; ++octant) {
      Piece& cut = cut_[octant];
      if (cut.count < 3) { continue; }
      cut.measure();
      if (!cut.has_area()) { continue; }
      parts[octant].push_back(static_cast<std::uint32_t>(pieces_.size()));
      pieces_.push_back(cut);
    }
  }

  VoxelTree& tree_;
  Later later_{&tree_};
  std::vector<Open> open_;
  std::vector<Piece> pieces_;  // whole and cut, of all nodes
  std::array<Piece, 8> cut_;   // by octant: the parts of the piece that is distributed
};

// ---- the cut through all trees that the budget allows ----

// At most a record for so many triangles while splitting; the cut across voxels takes its pick.
constexpr std::size_t kTrianglesPerLeafMin = 5;
constexpr std::size_t kLeavesPerVoxelFree = 12;
constexpr std::uint64_t kDirectoryBytesPerVoxel = 96;

using CellBytes = std::array<float, 6>;  // low, high
constexpr std::size_t kCellBytes = sizeof(CellBytes);
constexpr std::size_t kInnerNodeBytes = 2;

// The cells of the octree nodes that are voxels.
std::vector<Aabb> voxel_cells(const Octree& octree, std::span<const std::uint32_t> voxel_roots) {
  std::vector<Aabb> cells(voxel_roots.size());
  std::unordered_map<std::uint32_t, std::size_t> voxel_of_node;
  for (std::size_t voxel = 0; voxel < voxel_roots.size(); ++voxel) {
    voxel_of_node.emplace(voxel_roots[voxel], voxel);
  }
  if (voxel_roots.empty()) { return cells; }
  std::vector<std::pair<std::uint32_t, Aabb>> pending{{0U, octree.root}};
  while (!pending.empty()) {
    const auto [node, cell] = pending.back();
    pending.pop_back();
    const auto found = voxel_of_node.find(node);
    if (found != voxel_of_node.end()) {
      cells[found->second] = cell;
      continue;
    }
    const std::uint32_t first_child = octree.nodes[node].first_child;
    for (unsigned octant = 0; octant < 8 && first_child != 0; ++octant) {
      pending.emplace_back(first_child + octant, child_cell(cell, octant));
    }
  }
  return cells;
}

// A lower bound of the voxel's bytes in the store.
std::uint64_t voxel_bytes(const Scene& scene, const Octree& octree, std::uint32_t root) {
  const OctreeNode& node = octree.nodes[root];
  FlatIndex triangles(node.references_count / 2);
  FlatIndex vertices(node.references_count / 2);
  bool has_normals = false;
  for (std::uint64_t i = 0; i < node.references_count; ++i) {
    const std::uint32_t id = octree.references[node.references_begin + i];
    const std::size_t known = triangles.size();
    if (triangles.number_of(id) < known) { continue; }
    for (const std::uint32_t vertex : scene.triangles[id].vertices) {
      static_cast<void>(vertices.number_of(vertex));
      has_normals = has_normals || scene.normals[vertex] != Vec3(0.0F);
    }
  }
  return voxel_block_bytes(vertices.size(), triangles.size(), has_normals) +
         kDirectoryBytesPerVoxel;
}

void build_voxel_tree(const Scene& scene, const Octree& octree, std::uint32_t root, float error_min,
                      VoxelTree& tree) {
  const std::vector<std::uint32_t> triangles = triangles_below(octree, root);
  tree.nodes.clear();
  tree.splits.clear();
  VoxelTreeBuilder(tree).build(pieces_in_cell(scene, triangles, tree.cell),
                               kLeavesPerVoxelFree + triangles.size() / kTrianglesPerLeafMin,
                               error_min);
}

// A split of some voxel, by what is kept first.
struct RankedSplit {
  float error = 0.0F;
  std::uint32_t voxel = 0;
  std::uint32_t index = 0;
};

std::vector<RankedSplit> rank_splits(const std::vector<VoxelTree>& trees) {
  std::vector<RankedSplit> ranked;
  for (std::uint32_t voxel = 0; voxel < trees.size(); ++voxel) {
    for (std::uint32_t index = 0; index < trees[voxel].splits.size(); ++index) {
      ranked.push_back({trees[voxel].splits[index].error, voxel, index});
    }
  }
  tbb::parallel_sort(ranked.begin(), ranked.end(), [](const RankedSplit& a, const RankedSplit& b) {
    if (a.error != b.error) { return a.error > b.error; }
    return a.voxel != b.voxel ? a.voxel < b.voxel : a.index < b.index;
  });
  return ranked;
}

std::uint64_t bytes_of(const BuildSplit& split) {
  return split.added * sizeof(ProxyRecord) + kInnerNodeBytes;
}

// Keeps the splits of largest error, over all voxels, whose bytes fit. A voxel's errors never grow
// along its splits, so what is kept of it is always a prefix: a tree. Returns the error of the
// first split that is not kept; 0 if all are.
float keep_splits(std::vector<VoxelTree>& trees, std::uint64_t budget_bytes) {
  for (VoxelTree& tree : trees) { tree.splits_kept = 0; }
  std::uint64_t bytes = 0;
  for (const RankedSplit& split : rank_splits(trees)) {
    VoxelTree& tree = trees[split.voxel];
    bytes += bytes_of(tree.splits[split.index]);
    if (bytes > budget_bytes) { return split.error; }
    tree.splits_kept = split.index + 1;
  }
  return 0.0F;
}

// Most splits that a voxel allows are beyond the budget: nine of ten of a small scene, every second
// or third of a large one. Some voxels, split as far as they allow, tell about where the budget
// ends; the others are split down to a share of that error. Where the budget then ends no lower, no
// split that was left out would have been kept, so the guess never changes the result.
constexpr std::size_t kSampleStride = 16;
constexpr std::size_t kSampleVoxelsMin = 32;
constexpr std::array<float, 2> kErrorSharesOfGuess{0.7F, 0.2F};

// What keep_splits() would return if all voxels were as those that are built.
float guess_error_kept(const std::vector<VoxelTree>& trees, std::size_t voxels_built,
                       std::uint64_t budget_bytes) {
  const auto share = static_cast<double>(voxels_built) / static_cast<double>(trees.size());
  double left = share * static_cast<double>(budget_bytes);
  for (const RankedSplit& split : rank_splits(trees)) {
    left -= static_cast<double>(bytes_of(trees[split.voxel].splits[split.index]));
    if (left < 0.0) { return split.error; }
  }
  return 0.0F;
}

// Builds the trees, whose cells are given, as far as the budget keeps their splits.
void build_trees(const Scene& scene, const Octree& octree,
                 std::span<const std::uint32_t> voxel_roots, std::uint64_t budget_bytes,
                 std::vector<VoxelTree>& trees) {
  const auto build_every = [&](std::size_t stride, float error_min) {
    const std::size_t count = (trees.size() + stride - 1) / stride;
    tbb::parallel_for(std::size_t{0}, count, [&](std::size_t i) {
      VoxelTree& tree = trees[i * stride];
      if (tree.error_min <= error_min) { return; }
      build_voxel_tree(scene, octree, voxel_roots[i * stride], error_min, tree);
    });
    return count;
  };
  if (trees.size() >= kSampleStride * kSampleVoxelsMin) {
    const std::size_t count = build_every(kSampleStride, 0.0F);
    const float guess = guess_error_kept(trees, count, budget_bytes);
    for (const float share : kErrorSharesOfGuess) {
      build_every(1, share * guess);
      if (keep_splits(trees, budget_bytes) >= share * guess) { return; }
    }
  }
  build_every(1, 0.0F);
  keep_splits(trees, budget_bytes);
}

// ---- the proxy as a value, and its bytes ----

// What is stored. A node is inner or a leaf by its parent's leaf mask, a voxel's root by
// root_inner.
struct Packed {
  struct InnerNode {
    std::uint8_t child_mask = 0;
    std::uint8_t leaf_mask = 0;  // which of the children are leaves
  };
  std::vector<Aabb> cells{};
  std::vector<std::uint8_t> root_inner{};  // [voxel_count]
  std::vector<InnerNode> inner{};          // in the order of Proxy::nodes
  std::vector<ProxyRecord> records{};
  std::vector<std::uint32_t> materials{};
};

class MaterialPalette {
 public:
  std::uint16_t index_of(std::uint32_t material) {
    const auto next = static_cast<std::uint32_t>(materials_.size());
    if (next == 0x10000U && !index_.contains(material)) { return 0xFFFFU; }
    const auto [at, is_new] = index_.emplace(material, next);
    if (is_new) { materials_.push_back(material); }
    return static_cast<std::uint16_t>(at->second);
  }
  [[nodiscard]] std::vector<std::uint32_t> take() { return std::move(materials_); }

 private:
  std::unordered_map<std::uint32_t, std::uint32_t> index_;
  std::vector<std::uint32_t> materials_;
};

void pack_tree(const VoxelTree& tree, MaterialPalette& palette, Packed& packed) {
  const auto is_inner = [&](std::uint32_t node) {
    return tree.nodes[node].split < tree.splits_kept;
  };
  packed.cells.push_back(tree.cell);
  packed.root_inner.push_back(is_inner(0) ? 1 : 0);
  std::vector<std::uint32_t> order{0};
  for (std::size_t at = 0; at < order.size(); ++at) {
    const BuildNode& node = tree.nodes[order[at]];
    if (!is_inner(order[at])) {
      ProxyRecord record = node.summary.record;
      record.material_major = palette.index_of(node.summary.materials[0]);
      record.material_minor = palette.index_of(node.summary.materials[1]);
      packed.records.push_back(record);
      continue;
    }
    Packed::InnerNode inner{node.child_mask, 0};
    std::uint32_t child = node.first_child;
    for (unsigned octant = 0; octant < 8; ++octant) {
      if ((node.child_mask >> octant & 1U) == 0) { continue; }
      if (!is_inner(child)) { inner.leaf_mask |= static_cast<std::uint8_t>(1U << octant); }
      order.push_back(child++);
    }
    packed.inner.push_back(inner);
  }
}

tl::unexpected<Error> damaged(const std::string& what) {
  return fail(ExitCode::kStoreDamaged, "proxy: " + what);
}

// Rebuilds the nodes with their bounds, and checks what the nodes rely on.
class Expander {
 public:
  explicit Expander(Packed packed) : packed_(std::move(packed)) {}

  Result<Proxy> expand() {
    for (std::size_t voxel = 0; voxel < packed_.cells.size(); ++voxel) {
      const Result<void> done = expand_voxel(voxel);
      if (!done) { return tl::unexpected<Error>(done.error()); }
    }
    if (inner_taken_ != packed_.inner.size() || records_taken_ != packed_.records.size()) {
      return damaged("nodes or records that no voxel owns");
    }
    proxy_.cells = std::move(packed_.cells);
    proxy_.records = std::move(packed_.records);
    proxy_.materials = std::move(packed_.materials);
    return std::move(proxy_);
  }

 private:
  struct Pending {
    Aabb cell{};
    unsigned depth = 0;
    bool is_leaf = false;
  };

  Result<void> expand_voxel(std::size_t voxel) {
    const std::size_t begin = proxy_.nodes.size();
    proxy_.roots.push_back(static_cast<std::uint32_t>(begin));
    proxy_.nodes.emplace_back();
    pending_.assign(1, {packed_.cells[voxel], 0, packed_.root_inner[voxel] == 0});
    for (std::size_t at = 0; at < pending_.size(); ++at) {
      const Pending pending = pending_[at];
      if (pending.is_leaf) {
        if (records_taken_ == packed_.records.size()) { return damaged("too few records"); }
        proxy_.nodes[begin + at].first = static_cast<std::uint32_t>(records_taken_);
        proxy_.nodes[begin + at].bounds =
            record_bounds(packed_.records[records_taken_++], pending.cell);
        continue;
      }
      if (inner_taken_ == packed_.inner.size()) { return damaged("too few nodes"); }
      if (pending.depth == kProxyDepthMax) { return damaged("a tree deeper than 24 levels"); }
      const Packed::InnerNode inner = packed_.inner[inner_taken_++];
      if (inner.child_mask == 0 || (inner.leaf_mask & ~inner.child_mask) != 0) {
        return damaged("a node with impossible children");
      }
      proxy_.nodes[begin + at].child_mask = inner.child_mask;
      proxy_.nodes[begin + at].first = static_cast<std::uint32_t>(proxy_.nodes.size());
      for (unsigned octant = 0; octant < 8; ++octant) {
        if ((inner.child_mask >> octant & 1U) == 0) { continue; }
        pending_.push_back({child_cell(pending.cell, octant), pending.depth + 1,
                            (inner.leaf_mask >> octant & 1U) != 0});
        proxy_.nodes.emplace_back();
      }
    }
    for (std::size_t node = proxy_.nodes.size(); node-- > begin;) { join_children(node); }
    return {};
  }

  void join_children(std::size_t node) {
    const int count = std::popcount(proxy_.nodes[node].child_mask);
    for (int child = 0; child < count; ++child) {
      const std::size_t at = proxy_.nodes[node].first + static_cast<std::size_t>(child);
      proxy_.nodes[node].bounds.extend(proxy_.nodes[at].bounds);
    }
  }

  Packed packed_;
  Proxy proxy_;
  std::vector<Pending> pending_;
  std::size_t inner_taken_ = 0;
  std::size_t records_taken_ = 0;
};

// The encoded proxy: header, materials, cells, root_inner, inner nodes, records, without padding.
struct Header {
  std::uint32_t magic = 0x50525850;  // "PXRP"
  std::uint32_t voxel_count = 0;
  std::uint32_t material_count = 0;
  std::uint32_t inner_count = 0;
  std::uint32_t record_count = 0;
};

template <class T>
void append(std::vector<std::byte>& bytes, const std::vector<T>& values) {
  const std::size_t end = bytes.size();
  bytes.resize(end + values.size() * sizeof(T));
  if (!values.empty()) {
    std::memcpy(bytes.data() + end, values.data(), values.size() * sizeof(T));
  }
}

// Requires: the bytes hold so many values; the whole length was checked against the header.
template <class T>
void take(std::span<const std::byte>& bytes, std::vector<T>& values, std::size_t count) {
  static_assert(std::is_trivially_copyable_v<T>);
  values.resize(count);
  if (count > 0) { std::memcpy(values.data(), bytes.data(), count * sizeof(T)); }
  bytes = bytes.subspan(count * sizeof(T));
}

bool is_cell(const Aabb& cell) {
  for (int axis = 0; axis < 3; ++axis) {
    const bool inside = cell.low[axis] >= -4.0F && cell.high[axis] <= 4.0F;  // false for NaN
    if (!inside || !(cell.low[axis] < cell.high[axis])) { return false; }
  }
  return true;
}

Result<void> check_packed(const Packed& packed) {
  if (!std::all_of(packed.cells.begin(), packed.cells.end(), is_cell)) {
    return damaged("a voxel without a cell inside the scene frame");
  }
  for (const ProxyRecord& record : packed.records) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      if (record.low[axis] > record.high[axis]) { return damaged("a record without bounds"); }
    }
    const std::size_t material = std::max(record.material_major, record.material_minor);
    if (material >= packed.materials.size()) { return damaged("a record without a material"); }
  }
  return {};
}

}  // namespace

Aabb record_bounds(const ProxyRecord& record, const Aabb& cell) {
  Aabb bounds;
  const Vec3 step = cell.extent() * (1.0F / 255.0F);
  for (int axis = 0; axis < 3; ++axis) {
    const auto i = static_cast<std::size_t>(axis);
    bounds.low[axis] = cell.low[axis] + step[axis] * static_cast<float>(record.low[i]);
    bounds.high[axis] = record.high[i] == 255
                            ? cell.high[axis]
                            : cell.low[axis] + step[axis] * static_cast<float>(record.high[i]);
    if (bounds.high[axis] - bounds.low[axis] < kProxyExtentMin) {
      const float middle = 0.5F * (bounds.low[axis] + bounds.high[axis]);
      bounds.low[axis] = middle - 0.5F * kProxyExtentMin;
      bounds.high[axis] = middle + 0.5F * kProxyExtentMin;
    }
  }
  return bounds;
}

Vec3 record_normal(const ProxyRecord& record) {
  return decode_normal(record.normal[0] | static_cast<std::uint32_t>(record.normal[1]) << 16U);
}

float record_roundness(const ProxyRecord& record, bool of_minor) {
  const unsigned code = record.shape >> (of_minor ? kShapeMinorRoundness : kShapeMajorRoundness);
  return static_cast<float>(code & 7U) / 7.0F;
}

float record_minor_share(const ProxyRecord& record, int axis, bool from_low_side) {
  const unsigned shares = record.place[static_cast<std::size_t>(axis)];
  return static_cast<float>(from_low_side ? shares & 15U : shares >> 4U) / 15.0F;
}

void set_record_plane(ProxyRecord& record, float share) {
  const auto offset = static_cast<unsigned>(std::clamp(share, 0.0F, 1.0F) * 65535.0F + 0.5F);
  record.place = {static_cast<std::uint8_t>(offset), static_cast<std::uint8_t>(offset >> 8U), 0};
}

Proxy build_proxy(const Scene& scene, const Octree& octree,
                  std::span<const std::uint32_t> voxel_roots, std::uint64_t store_bytes_other) {
  std::vector<VoxelTree> trees(voxel_roots.size());
  const std::vector<Aabb> cells = voxel_cells(octree, voxel_roots);
  std::vector<std::uint64_t> bytes(voxel_roots.size());
  tbb::parallel_for(std::size_t{0}, trees.size(), [&](std::size_t voxel) {
    trees[voxel].cell = cells[voxel];
    bytes[voxel] = voxel_bytes(scene, octree, voxel_roots[voxel]);
  });
  const std::uint64_t store_bytes = std::accumulate(bytes.begin(), bytes.end(), store_bytes_other);
  const auto proxy_bytes_max =
      static_cast<std::uint64_t>(static_cast<double>(store_bytes) * kProxyShareMax);
  // No record names a material that the scene does not have.
  const std::uint64_t proxy_bytes_min = sizeof(Header) +
                                        sizeof(std::uint32_t) * scene.materials.size() +
                                        trees.size() * (kCellBytes + 1 + sizeof(ProxyRecord));
  build_trees(scene, octree, voxel_roots,
              proxy_bytes_max - std::min(proxy_bytes_min, proxy_bytes_max), trees);

  Packed packed;
  MaterialPalette palette;
  for (const VoxelTree& tree : trees) { pack_tree(tree, palette, packed); }
  packed.materials = palette.take();
  Result<Proxy> proxy = Expander(std::move(packed)).expand();
  CHECK(proxy.has_value());
  return std::move(*proxy);
}

std::vector<std::byte> encode_proxy(const Proxy& proxy) {
  std::vector<std::uint8_t> root_inner;
  for (const std::uint32_t root : proxy.roots) {
    root_inner.push_back(proxy.nodes[root].child_mask != 0 ? 1 : 0);
  }
  std::vector<Packed::InnerNode> inner;
  for (const ProxyNode& node : proxy.nodes) {
    if (node.child_mask == 0) { continue; }
    Packed::InnerNode packed{node.child_mask, 0};
    std::uint32_t child = node.first;
    for (unsigned octant = 0; octant < 8; ++octant) {
      if ((node.child_mask >> octant & 1U) == 0) { continue; }
      if (proxy.nodes[child++].child_mask == 0) {
        packed.leaf_mask |= static_cast<std::uint8_t>(1U << octant);
      }
    }
    inner.push_back(packed);
  }
  std::vector<Header> header(1);
  header[0].voxel_count = static_cast<std::uint32_t>(proxy.roots.size());
  header[0].material_count = static_cast<std::uint32_t>(proxy.materials.size());
  header[0].inner_count = static_cast<std::uint32_t>(inner.size());
  header[0].record_count = static_cast<std::uint32_t>(proxy.records.size());
  std::vector<std::byte> bytes;
  append(bytes, header);
  append(bytes, proxy.materials);
  std::vector<CellBytes> cells;
  for (const Aabb& cell : proxy.cells) {
    cells.push_back({cell.low.x, cell.low.y, cell.low.z, cell.high.x, cell.high.y, cell.high.z});
  }
  append(bytes, cells);
  append(bytes, root_inner);
  append(bytes, inner);
  append(bytes, proxy.records);
  return bytes;
}

Result<Proxy> decode_proxy(std::span<const std::byte> bytes, std::size_t voxel_count) {
  Header header;
  const std::uint32_t magic = header.magic;
  if (bytes.size() < sizeof(Header)) { return damaged("shorter than its header"); }
  std::memcpy(&header, bytes.data(), sizeof(Header));
  const std::uint64_t size_expected = sizeof(Header) +
                                      sizeof(std::uint32_t) * std::uint64_t{header.material_count} +
                                      (kCellBytes + 1) * std::uint64_t{header.voxel_count} +
                                      kInnerNodeBytes * std::uint64_t{header.inner_count} +
                                      sizeof(ProxyRecord) * std::uint64_t{header.record_count};
  if (header.magic != magic || header.voxel_count != voxel_count) {
    return damaged("not the proxy of a scene of " + std::to_string(voxel_count) + " voxels");
  }
  if (bytes.size() != size_expected) {
    return damaged(std::to_string(bytes.size()) + " bytes instead of " +
                   std::to_string(size_expected));
  }
  bytes = bytes.subspan(sizeof(Header));
  Packed packed;
  take(bytes, packed.materials, header.material_count);
  std::vector<CellBytes> cells;
  take(bytes, cells, header.voxel_count);
  for (const CellBytes& cell : cells) {
    packed.cells.push_back({{cell[0], cell[1], cell[2]}, {cell[3], cell[4], cell[5]}});
  }
  take(bytes, packed.root_inner, header.voxel_count);
  take(bytes, packed.inner, header.inner_count);
  take(bytes, packed.records, header.record_count);
  const Result<void> checked = check_packed(packed);
  if (!checked) { return tl::unexpected<Error>(checked.error()); }
  return Expander(std::move(packed)).expand();
}

}  // namespace preheat
