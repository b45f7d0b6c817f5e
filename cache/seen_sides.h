// Which materials show their fronts only, as a few paths find out.
//
// A ray that leaves a solid body never comes upon that body's surface from behind, but an aggregate
// of its facets has no inside: neighbours stick out of each other and are met again. Files do not
// say what bounds a body: windings disagree, and rooms are open. So the sides are counted that
// rays show which begin in free space or far away. A material whose backs they hardly see has only
// fronts. Not so the other way round: where the camera looks at an open box from outside it sees
// the backs of walls, and the rays that scatter inside see their fronts.
//
// A body's outline shows leaves whose mean normal is turned away a little while facets of theirs
// are not; so each sight counts by the cosine between ray and normal.
// Threads: one owner.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace preheat {

class SeenSides {
 public:
  explicit SeenSides(std::size_t material_count) : seen_(material_count) {}

  // `cosine` between the way to the viewer and the normal: below 0 the back is seen.
  void add(std::size_t material, float cosine);
  // Requires: as many materials.
  void add(const SeenSides& other);

  // [material_count] 1 for those seen often enough, and hardly from behind.
  [[nodiscard]] std::vector<std::uint8_t> one_sided() const;

 private:
  struct Seen {
    double front = 0.0;  // sums of cosines
    double back = 0.0;
  };
  std::vector<Seen> seen_;
};

}  // namespace preheat
