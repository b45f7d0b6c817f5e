// The objects of each cell of the cut octree, as the paper's model sees them: an object is a
// triangle, and all of a cell lie at its centre ([P] section 8).
//
// So nothing of a triangle matters but its area inside the cell, its normal and its material, and
// triangles that agree in normal, up to a small angle, and in material are one group. Time and
// reading are linear in the triangles; what follows is not.
#pragma once

#include <cstdint>
#include <vector>

#include "common/octree_summary.h"
#include "common/result.h"
#include "common/store.h"
#include "common/vec3.h"

namespace preheat {

struct SurfaceGroup {
  Vec3 normal{0.0F, 0.0F, 1.0F};  // unit, the mean by area, on the side of the winding
  std::uint32_t material = 0;
  double area = 0.0;  // inside the cell [scene units^2], positive
};

// [cut cells]. A triangle that straddles cells counts in each with the part that lies there.
// Triangles without area are left out. Reads every voxel's block: kStoreDamaged if one is not what
// a block must be. Same result on any number of threads; runs on those of the caller's arena.
[[nodiscard]] Result<std::vector<std::vector<SurfaceGroup>>> gather_surfaces(const Store& store,
                                                                             const OctreeCut& cut);

}  // namespace preheat
