// The discretised sphere of [P] section 4, figure 3: all directions in a 2D array of polar
// coordinates, rows of equal polar angle from +z to -z and columns of equal azimuth from +x.
//
// Every direction but zero lies in exactly one bin, whatever its length and the signs of its zeros;
// a pole lies in the bin of azimuth 0. Turning a direction by 90 degrees about z permutes the
// columns exactly where their number is divisible by four, and mirroring z mirrors the rows.
// Threads: immutable.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/aabb.h"
#include "common/vec3.h"

namespace preheat {

inline constexpr unsigned kBinsPolarMax = 64;
inline constexpr unsigned kBinsAzimuthMax = 128;

class DirectionBins {
 public:
  // Requires: 1 <= polar <= kBinsPolarMax, 1 <= azimuth <= kBinsAzimuthMax.
  DirectionBins(unsigned polar, unsigned azimuth);

  [[nodiscard]] std::uint32_t size() const { return polar_ * azimuth_; }
  [[nodiscard]] unsigned polar() const { return polar_; }
  [[nodiscard]] unsigned azimuth() const { return azimuth_; }

  // Row by row. None for the zero vector and for what is not finite.
  [[nodiscard]] std::optional<std::uint32_t> bin_of(const Vec3d& direction) const;

  [[nodiscard]] double solid_angle(std::uint32_t bin) const {
    return solid_angles_[bin / azimuth_];
  }
  // The integral of the unit direction over the bin: its dot product with a normal is the bin's
  // share of a cosine lobe, times pi, where the bin lies wholly on the normal's side.
  [[nodiscard]] const Vec3d& flux(std::uint32_t bin) const { return fluxes_[bin]; }

 private:
  unsigned polar_;
  unsigned azimuth_;
  std::vector<double> solid_angles_{};  // [polar] of each bin of a row [sr]
  std::vector<Vec3d> fluxes_{};         // [size()]
};

// How a box looks from a point outside: which share of each bin it covers.
//
// The faces that look towards the point are cut into patches that see no more than half a bin, and
// each patch's solid angle, area times cosine over squared distance, goes to the bin of its middle.
// A share is never more than 1. From inside, the box covers everything. Threads: one owner, who
// keeps it to reuse its memory.
class BoxInBins {
 public:
  struct Share {
    std::uint32_t bin = 0;
    double weight = 0.0;  // in [0,1]
  };

  explicit BoxInBins(const DirectionBins& bins);

  // Valid until the next call. In the order in which the patches meet the bins.
  [[nodiscard]] std::span<const Share> look(const Vec3d& from, const Aabb& box);

 private:
  void add_face(const Vec3d& from, const Vec3d& low, const Vec3d& high, int axis, bool upper);
  void add(std::uint32_t bin, double solid_angle);

  const DirectionBins& bins_;
  std::vector<Share> shares_{};
  std::vector<std::uint32_t> place_{};  // [bins] into shares_, plus one; 0 = not there
};

}  // namespace preheat
