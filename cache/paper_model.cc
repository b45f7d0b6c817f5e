#include "cache/paper_model.h"

#include <fmt/format.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "cache/cell_response.h"
#include "cache/cell_surfaces.h"
#include "cache/direction_bins.h"
#include "cache/voxel_projection.h"
#include "common/blocking.h"
#include "common/octree_summary.h"

namespace preheat {
namespace {

// Of two arrays of outgoing rays, by cell and bin.
constexpr std::uint64_t kArrayEntriesMax = std::uint64_t{1} << 26U;

[[nodiscard]] Vec3d centre_of(const Aabb& box) { return 0.5 * (Vec3d(box.low) + Vec3d(box.high)); }

// What all cells send in one iteration.
struct Sent {
  Sent(std::size_t cells, std::size_t bins)
      : scatter(cells * bins, 0.0),
        shadow(cells * bins, 0.0),
        shadow_inside(cells, 0.0),
        throughput(cells, 1.0) {}

  std::vector<double> scatter;        // [cells * bins]
  std::vector<double> shadow;         // [cells * bins]
  std::vector<double> shadow_inside;  // [cells]
  std::vector<double> throughput;     // [cells]
  double scale = 1.0;                 // n/m, of all of them
};

struct Received {
  double scatter = 0.0;
  double shadow = 0.0;
};

[[nodiscard]] double sum_of(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double value : values) { sum += value; }
  return sum;
}

// Section 6, first option. Never more than 1: see the header.
[[nodiscard]] double ratio(double sent, double received) {
  return received > sent ? sent / received : 1.0;
}

class PaperModel {
 public:
  PaperModel(const PredictionInput& input, const OctreeCut& cut, const VoxelProjection& projection,
             std::vector<std::vector<SurfaceGroup>> surfaces);

  [[nodiscard]] Prediction predict();

 private:
  // What one thread needs to work on a cell.
  struct Workspace {
    explicit Workspace(const DirectionBins& bins)
        : look(bins), rays(bins.size(), 0.0), directions(bins.size(), Vec3d(0.0)) {}
    BoxInBins look;
    CellResponse::Scratch scratch{};
    std::vector<double> rays;       // [bins] received, by the way they travel
    std::vector<Vec3d> directions;  // [bins] their sum, weighted
    std::vector<IncomingRays> incoming{};
  };

  template <class Body>
  void for_each_cell(Body&& body);

  [[nodiscard]] double primary_rays(const Aabb& cell) const;
  // Where a camera ray to the point comes from.
  [[nodiscard]] Vec3d eye_of(const Vec3d& point) const;
  void send_primary(Sent& sent);
  [[nodiscard]] std::vector<Received> exchange(const Sent& sent, std::uint32_t bounce, Sent* next);
  [[nodiscard]] Received gather(const Sent& sent, std::size_t receiver, Workspace& space,
                                double& throughput) const;
  void respond(std::size_t cell, std::uint32_t bounce, double throughput, Workspace& space,
               Sent& into) const;

  // The factor of section 6 for rays that travel from a point to a cell's centre; 1 for n/m.
  [[nodiscard]] double arrival(const Vec3d& from, const Vec3d& to) const;
  // Of the rays that arrive, the share that goes on.
  [[nodiscard]] double stopped(std::size_t cell) const;
  [[nodiscard]] Prediction finish() const;

  const PredictionInput& input_;
  const PaperKnobs& knobs_;
  const OctreeSummary& summary_;
  const OctreeCut& cut_;
  const VoxelProjection& projection_;
  DirectionBins bins_;
  CellResponse response_;
  std::vector<CellContent> cells_{};
  std::vector<Vec3d> centres_{};
  double blocking_mean_ = 0.0;  // p-bar of section 6
  tbb::enumerable_thread_specific<Workspace> spaces_;

  // Rays that cross each cell [cut cells].
  std::vector<double> camera_{};
  std::vector<double> scatter_{};
  std::vector<double> shadow_{};
  double scatter_total_ = 0.0;
  double shadow_total_ = 0.0;
};

PaperModel::PaperModel(const PredictionInput& input, const OctreeCut& cut,
                       const VoxelProjection& projection,
                       std::vector<std::vector<SurfaceGroup>> surfaces)
    : input_(input),
      knobs_(input.knobs.paper),
      summary_(input.store->octree_summary()),
      cut_(cut),
      projection_(projection),
      bins_(knobs_.bins_polar, knobs_.bins_azimuth),
      response_(input.tables, input.settings, bins_),
      cells_(cut.cells.size()),
      spaces_([this] { return Workspace(bins_); }),
      camera_(cut.cells.size(), 0.0),
      scatter_(cut.cells.size(), 0.0),
      shadow_(cut.cells.size(), 0.0) {
  for (std::size_t cell = 0; cell < cells_.size(); ++cell) {
    const CutCell& place = cut.cells[cell];
    cells_[cell].surfaces = std::move(surfaces[cell]);
    centres_.push_back(centre_of(place.cell));
    blocking_mean_ += std::ldexp(summary_.nodes[place.node].sums.stop_probability(),
                                 -3 * static_cast<int>(place.depth));
  }
  for_each_cell([this](std::size_t cell, Workspace&) {
    cells_[cell].lights =
        response_.look_at_lights(cut_.cells[cell].cell, static_cast<std::uint32_t>(cell));
  });
}

template <class Body>
void PaperModel::for_each_cell(Body&& body) {
  tbb::parallel_for(std::size_t{0}, cells_.size(),
                    [&](std::size_t cell) { body(cell, spaces_.local()); });
}

double PaperModel::primary_rays(const Aabb& cell) const {
  const std::vector<ScreenPoint> outline =
      knobs_.as_printed ? projection_.outline_as_printed(cell) : projection_.outline(cell);
  return projection_.pixels(outline) * input_.settings.spp;
}

Vec3d PaperModel::eye_of(const Vec3d& point) const {
  const View& view = projection_.view();
  const Vec3d origin(view.origin);
  if (!view.orthographic) { return origin; }
  const Vec3d forward(view.forward);
  return point - forward * std::max(0.0, glm::dot(point - origin, forward));
}

double PaperModel::arrival(const Vec3d& from, const Vec3d& to) const {
  if (knobs_.occlusion == PaperOcclusion::kRatio) { return 1.0; }
  const std::uint32_t crossed = cells_crossed(summary_, cut_.depth, from, to);
  // The eye may lie outside the octree, a voxel never does.
  const bool starts_inside = cells_crossed(summary_, 0, from, from + 1e-6 * (to - from)) > 0;
  const double d = std::max(1.0, static_cast<double>(crossed) - (starts_inside ? 1.0 : 0.0));
  const double passed = pass_probability(blocking_mean_, d - 1.0);
  return knobs_.occlusion == PaperOcclusion::kArrival
             ? passed
             : std::min(1.0, d * std::min(1.0, blocking_mean_) * passed);
}

double PaperModel::stopped(std::size_t cell) const {
  return knobs_.occlusion == PaperOcclusion::kArrival
             ? summary_.nodes[cut_.cells[cell].node].sums.stop_probability()
             : 1.0;
}

void PaperModel::respond(std::size_t cell, std::uint32_t bounce, double throughput,
                         Workspace& space, Sent& into) const {
  const std::size_t bins = bins_.size();
  OutgoingRays outgoing{.scatter = std::span(into.scatter).subspan(cell * bins, bins),
                        .shadow = std::span(into.shadow).subspan(cell * bins, bins)};
  response_.respond(cells_[cell], space.incoming, bounce, throughput, space.scratch, outgoing);
  into.shadow_inside[cell] = outgoing.shadow_inside;
  into.throughput[cell] = outgoing.throughput;
}

void PaperModel::send_primary(Sent& sent) {
  for_each_cell([&](std::size_t cell, Workspace& space) {
    camera_[cell] = primary_rays(cut_.cells[cell].cell);
    if (!(camera_[cell] > 0.0)) { return; }
    const Vec3d eye = eye_of(centres_[cell]);
    const Vec3d towards = centres_[cell] - eye;
    const double distance = glm::length(towards);
    // From the centre itself, rays leave along the view.
    const Vec3 direction = distance > 0.0 ? Vec3(towards / distance) : input_.settings.view.forward;
    const double rays = camera_[cell] * arrival(eye, centres_[cell]) * stopped(cell);
    space.incoming.assign(1, {glm::normalize(direction), rays});
    respond(cell, 0, 1.0, space, sent);
  });
  if (knobs_.occlusion == PaperOcclusion::kRatio) {
    sent.scale = ratio(primary_rays(summary_.root), sum_of(camera_));
  }
}

Received PaperModel::gather(const Sent& sent, std::size_t receiver, Workspace& space,
                            double& throughput) const {
  const std::size_t bins = bins_.size();
  std::fill(space.rays.begin(), space.rays.end(), 0.0);
  std::fill(space.directions.begin(), space.directions.end(), Vec3d(0.0));
  Received received;
  double throughput_sum = 0.0;
  for (std::size_t sender = 0; sender < cells_.size(); ++sender) {
    if (sender == receiver) { continue; }
    double scatter = 0.0;
    double shadow = 0.0;
    for (const auto& [bin, weight] : space.look.look(centres_[sender], cut_.cells[receiver].cell)) {
      scatter += weight * sent.scatter[sender * bins + bin];
      shadow += weight * sent.shadow[sender * bins + bin];
    }
    if (!(scatter > 0.0 || shadow > 0.0)) { continue; }
    const double share = sent.scale * arrival(centres_[sender], centres_[receiver]);
    received.shadow += share * shadow;
    if (!(scatter > 0.0)) { continue; }
    received.scatter += share * scatter;
    throughput_sum += share * scatter * sent.throughput[sender];
    const Vec3d direction = glm::normalize(centres_[receiver] - centres_[sender]);
    const std::uint32_t way = bins_.bin_of(direction).value_or(0);
    space.rays[way] += share * scatter;
    space.directions[way] += share * scatter * direction;
  }
  const double goes_on = stopped(receiver);
  space.incoming.clear();
  for (std::size_t bin = 0; bin < bins; ++bin) {
    const double length = glm::length(space.directions[bin]);
    if (!(space.rays[bin] > 0.0) || !(length > 0.0)) { continue; }
    space.incoming.push_back({Vec3(space.directions[bin] / length), space.rays[bin] * goes_on});
  }
  throughput = received.scatter > 0.0 ? throughput_sum / received.scatter : 1.0;
  return received;
}

std::vector<Received> PaperModel::exchange(const Sent& sent, std::uint32_t bounce, Sent* next) {
  std::vector<Received> received(cells_.size());
  for_each_cell([&](std::size_t cell, Workspace& space) {
    double throughput = 1.0;
    received[cell] = gather(sent, cell, space, throughput);
    if (next != nullptr) { respond(cell, bounce, throughput, space, *next); }
  });
  return received;
}

Prediction PaperModel::predict() {
  const std::uint32_t rounds =
      knobs_.bounces_exchanged < 0
          ? input_.settings.bounces
          : std::min(input_.settings.bounces, static_cast<std::uint32_t>(knobs_.bounces_exchanged));
  Sent sent(cells_.size(), bins_.size());
  send_primary(sent);
  for (std::uint32_t round = 0; round < rounds; ++round) {
    const double scatter_sent = sent.scale * sum_of(sent.scatter);
    const double shadow_sent = sent.scale * (sum_of(sent.shadow) + sum_of(sent.shadow_inside));
    scatter_total_ += scatter_sent;
    shadow_total_ += shadow_sent;
    if (!(scatter_sent + shadow_sent > 0.0)) { break; }
    Sent next(cells_.size(), bins_.size());
    const bool is_last = round + 1 == rounds;
    const std::vector<Received> received = exchange(sent, round + 1, is_last ? nullptr : &next);
    double scatter_received = 0.0;
    for (std::size_t cell = 0; cell < cells_.size(); ++cell) {
      scatter_[cell] += received[cell].scatter;
      shadow_[cell] += received[cell].shadow;
      scatter_received += received[cell].scatter;
    }
    if (knobs_.occlusion == PaperOcclusion::kRatio) {
      next.scale = ratio(scatter_sent, scatter_received);
    }
    sent = std::move(next);
  }
  return finish();
}

Prediction PaperModel::finish() const {
  Prediction prediction;
  const auto per_voxel = [&](const std::vector<double>& rays) {
    return spread_over_voxels(summary_, cut_, rays, input_.proxy.cells, input_.tables.voxels);
  };
  const auto per_node = [&](const std::vector<double>& rays) {
    std::vector<double> traversals(rays);
    for (std::size_t cell = 0; cell < rays.size(); ++cell) {
      traversals[cell] *= summary_.nodes[cut_.cells[cell].node].sums.traversal_cost();
    }
    return traversals;
  };
  prediction.rays_camera = per_voxel(camera_);
  prediction.rays_scatter = per_voxel(scatter_);
  prediction.rays_shadow = per_voxel(shadow_);
  prediction.nodes = {cut_.depth, per_node(camera_), per_node(scatter_), per_node(shadow_)};
  const RenderSettings& settings = input_.settings;
  prediction.camera_total = static_cast<double>(settings.width) * settings.height * settings.spp;
  prediction.scatter_total = scatter_total_;
  prediction.shadow_total = shadow_total_;
  return prediction;
}

[[nodiscard]] Result<void> check_knobs(const PaperKnobs& knobs) {
  const auto check = [](const char* what, std::uint64_t value, std::uint64_t least,
                        std::uint64_t most) -> Result<void> {
    if (value >= least && value <= most) { return {}; }
    return fail(ExitCode::kUsage, fmt::format("model paper: {} is {}, must be within {}..{}", what,
                                              value, least, most));
  };
  return check("the depth", knobs.depth, 0, kSummaryDepthMax)
      .and_then([&] { return check("polar bins", knobs.bins_polar, 1, kBinsPolarMax); })
      .and_then([&] { return check("azimuth bins", knobs.bins_azimuth, 1, kBinsAzimuthMax); });
}

// Nothing to see: what any model says of a scene without voxels.
[[nodiscard]] Prediction empty_prediction(const RenderSettings& settings, unsigned depth) {
  Prediction prediction;
  prediction.camera_total = static_cast<double>(settings.width) * settings.height * settings.spp;
  prediction.nodes.depth = depth;
  return prediction;
}

}  // namespace

Result<Prediction> predict_paper(const PredictionInput& input) {
  const PaperKnobs& knobs = input.knobs.paper;
  if (const Result<void> valid = check_knobs(knobs); !valid) {
    return tl::unexpected(valid.error());
  }
  if (input.tables.voxels.empty()) { return empty_prediction(input.settings, knobs.depth); }
  if (input.store == nullptr) {
    return fail(ExitCode::kUsage,
                "model paper reads the scene's triangles and octree: it needs a store");
  }
  if (input.proxy.cells.size() != input.tables.voxels.size() ||
      input.store->tables().voxels.size() != input.tables.voxels.size()) {
    return fail(ExitCode::kFailed,
                fmt::format("model paper: tables of {} voxels, a proxy of {} and a store of {}",
                            input.tables.voxels.size(), input.proxy.cells.size(),
                            input.store->tables().voxels.size()));
  }
  const Result<VoxelProjection> projection =
      VoxelProjection::create(input.settings.view, input.settings.width, input.settings.height);
  if (!projection) { return tl::unexpected(projection.error()); }
  const OctreeCut cut = cut_octree(input.store->octree_summary(), knobs.depth);
  const std::uint64_t entries =
      std::uint64_t{cut.cells.size()} * knobs.bins_polar * knobs.bins_azimuth;
  if (entries > kArrayEntriesMax) {
    return fail(
        ExitCode::kUsage,
        fmt::format("model paper: {} cells with {}x{} bins each are {} entries, at most {}: "
                    "choose a smaller depth or fewer bins",
                    cut.cells.size(), knobs.bins_polar, knobs.bins_azimuth, entries,
                    kArrayEntriesMax));
  }
  Result<Prediction> prediction;
  tbb::task_arena arena(static_cast<int>(std::max(1U, input.threads)));
  arena.execute([&] {
    auto surfaces = gather_surfaces(*input.store, cut);
    prediction = surfaces ? PaperModel(input, cut, *projection, *std::move(surfaces)).predict()
                          : Result<Prediction>(tl::unexpected(surfaces.error()));
  });
  return prediction;
}

}  // namespace preheat
