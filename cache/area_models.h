// Estimates that know the scene but no camera: how likely a line drawn through the scene at random
// meets a voxel. These are the ways that [P] section 2 reports of earlier work; preheat judges the
// models that know the camera against them.
//
// Of all lines that meet a convex body the share that meets a convex body inside it is the ratio of
// their surfaces (Cauchy and Crofton; Santalo, Integral Geometry and Geometric Probability, 1976).
// Rays per voxel = rays of the frame * that share * how much of its way a ray goes.
//
// Rays of the frame: the camera's are known. For the rest a path is taken to live as long as the
// settings allow and every vertex to sample a light where there is one (common/path_rules.h), which
// no path exceeds.
#pragma once

#include "cache/prediction.h"

namespace preheat {

// The surface of the voxel's bounds over that of all bounds; every ray goes all its way.
[[nodiscard]] Result<Prediction> predict_surface_area(const PredictionInput& input);

// MacDonald and Booth, Heuristics for ray tracing using space subdivision, The Visual Computer 6,
// 1990. Surfaces as above, times a factor for the rays that end early, which [P] section 2 reports
// to follow from the density of objects. Our reading: a line meets surfaces at random, tau of them
// on its whole way, and has gone the share (1 - e^-tau) / tau when it meets the first. tau adds up,
// over the proxy's leaves, the chance to meet the leaf's bounds times the share that is filled.
[[nodiscard]] Result<Prediction> predict_macdonald_booth(const PredictionInput& input);

// Cleary and Wyvill, Analysis of an algorithm for fast ray tracing using uniform space subdivision,
// The Visual Computer 4, 1988. [P] section 2: from the area of the cells that hold an object. Our
// reading: a ray visits a voxel when it meets its octree cell, whatever part of it is filled.
[[nodiscard]] Result<Prediction> predict_cleary_wyvill(const PredictionInput& input);

// Subramanian and Fussell, Automatic termination criteria for ray tracing hierarchies, Graphics
// Interface 1991. [P] section 2: from the projected area of the box that encloses a cell's objects,
// the number of cells that a ray traverses and the chance that it meets an object in one. Our
// reading: a line crosses n = sum of the cells' surfaces over the scene's cells; in a cell it meets
// the enclosing box with the ratio of their surfaces, on average p, and ends there. It then visits
// (1 - (1 - p)^n) / p cells, and every voxel's share falls by what that is of n.
[[nodiscard]] Result<Prediction> predict_subramanian_fussell(const PredictionInput& input);

}  // namespace preheat
