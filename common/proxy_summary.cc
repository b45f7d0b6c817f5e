#include "common/proxy_summary.h"

#include <bit>
#include <cmath>
#include <cstring>
#include <optional>
#include <utility>

#include "common/voxel_block.h"

namespace preheat {
namespace {

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

  SampledPiece(const ProxyPiece& piece, const SampleFrame& frame)
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

struct Normals {
  Vec3 mean{0.0F};         // unit
  float agreement = 0.0F;  // length of the mean of the unit normals, turned to one side
  bool oriented = false;
  double area = 0.0;
  double area_emitting = 0.0;
};

Normals normals_of(const PieceSelection& selection) {
  Normals normals;
  Vec3 projected(0.0F);
  selection.for_each([&](const ProxyPiece& piece) { projected += glm::abs(piece.normal); });
  const int dominant = flat_axes(projected).axis;
  Vec3d signed_sum(0.0);
  Vec3d turned_sum(0.0);
  selection.for_each([&](const ProxyPiece& piece) {
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

Aabb bounds_of(const PieceSelection& selection) {
  Aabb bounds;
  selection.for_each([&](const ProxyPiece& piece) {
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

Spread spread_along(const Vec3& normal, const PieceSelection& selection) {
  float low = kInfinity;
  float high = -kInfinity;
  double sum = 0.0;
  double weight = 0.0;
  selection.for_each([&](const ProxyPiece& piece) {
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
float set_flat_materials(ProxySummary& summary, const SeenSides& sides, const FlatAxes& axes,
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

float set_flat(ProxySummary& summary, const PieceSelection& selection, const Spread& spread,
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
  selection.for_each([&](const ProxyPiece& piece) {
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

float set_scattered_materials(ProxySummary& summary, const std::array<SeenSides, 3>& sides) {
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
  void add(const ProxyPiece& piece) {
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

void set_roundness(ProxySummary& summary, const PieceSelection& selection) {
  Roundness all;
  Roundness major;
  Roundness minor;
  selection.for_each([&](const ProxyPiece& piece) {
    all.add(piece);
    if (piece.material == summary.materials[0]) { major.add(piece); }
    if (piece.material == summary.materials[1]) { minor.add(piece); }
  });
  ProxyRecord& record = summary.record;
  record.thickness = code_255(all.value());
  record.shape = static_cast<std::uint8_t>(record.shape | major.code_7() << kShapeMajorRoundness |
                                           minor.code_7() << kShapeMinorRoundness);
}

float set_scattered(ProxySummary& summary, const PieceSelection& selection, const Aabb& bounds,
                    bool has_one_material) {
  ProxyRecord& record = summary.record;
  const SampleFrame frame(bounds);
  std::array<SeenFace, 3> faces;
  std::optional<std::array<SeenSides, 3>> sides;
  if (!has_one_material) { sides.emplace(); }
  selection.for_each([&](const ProxyPiece& piece) {
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

}  // namespace

ProxySummary summarise(const PieceSelection& selection, const Aabb& cell) {
  ProxySummary summary;
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

}  // namespace preheat
