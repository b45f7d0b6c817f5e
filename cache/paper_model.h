// The model of [P], Reinhard, Kok and Chalmers 1998, sections 3 to 7, on the store's octree.
//
// How the sentences of [P] that leave a choice are read, beside those of cache/cell_response.h:
// - Section 4: a voxel's primary rays are the pixels that its cell covers, parts included, times
//   the samples per pixel; the image's edge and the view point clip it (cache/voxel_projection.h).
//   Nothing hides anything: a ray is counted in every voxel that it would cross.
// - Section 5, "the number of rays that each of the remaining voxels sends towards this voxel": of
//   the rays in a bin of i's array, j receives the share of the bin's solid angle that j's cell
//   covers, seen from i's centre (cache/direction_bins.h), never more than all. A voxel
//   sends nothing to itself.
// - Rays that come from several voxels are gathered in j by direction, in the same array, and each
//   bin answers once, with the mean of its directions: linear in the objects for each bin rather
//   than for each pair.
// - Section 6, n/m: n is what is sent within an iteration and m what all voxels receive of it.
// Every
//   crossing is counted, only the new distributions are scaled. For the first step n is the
//   camera rays that meet the octree. Where m < n rays have left the scene and nothing is scaled.
// - Section 6, blocking: p-bar is the mean over the cut's cells by volume, empty ones with 0, of
//   1 - (1 - p-bar_i)^(2^D-bar_i), what the subtree of each stops. d counts the cells of the cut,
//   empty ones included, on the way from centre to centre without the first. Both the count and the
//   new distribution of j are scaled by the factor of each pair. As printed it is d p (1-p)^(d-1).
//   The probability of arriving is (1-p)^(d-1); what arrives and is stopped there goes on, so the
//   new distribution has a factor 1 - (1 - p-bar_j)^(2^D-bar_j) more. For the first step i is the
//   eye, and the counts stay the pixels of section 4.
// - Shadow rays start no new rays. The array knows directions only, so they are counted beyond
//   their light too.
// - Section 7: NodePrediction counts leaf traversals, rays times the cell's C_t. Per voxel of the
//   cache the same rays count once per voxel, without C_t (spread_over_voxels).
#pragma once

#include "cache/prediction.h"

namespace preheat {

// Wants a store. Knobs out of range are usage errors. Same result on any number of threads.
[[nodiscard]] Result<Prediction> predict_paper(const PredictionInput& input);

}  // namespace preheat
