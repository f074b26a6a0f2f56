// Uses the nearest map points of a point: for the normal of its patch, and to find duplicates.
//
// A patch is first taken to face its source camera. From other viewpoints its warp is wrong then, and it is found
// beside its true position or not at all. Where a point and its neighbours lie on a plane, the patch is taken to lie on
// it too.
//
// Called by the mapper for every point, when bundle adjustment has converged. Frames as in map.h. Cost: about 12 ARMv6
// instructions for each point of the map to find the neighbours of one, some 5000 for their plane (estimates).
#pragma once

#include "map/map.h"

namespace pptam {

// Points for a plane, the middle one included. Not critical: 7, 12 and 16 were equally good on the emulated phone
// (seven scenes, six seeds each).
constexpr int kNeighbours = 12;

// Indices into Map::points() of the points nearest to a point: the point itself, then the others by ascending distance,
// and by slot at equal distances. Within a quarter of the point's distance from its source camera.
using Neighbours = InlineVector<int, kNeighbours>;
Neighbours find_neighbours(const Map& map, int point);

// Normal of the plane through the neighbours, unit, in the frame of the point's source keyframe, towards its camera.
// False, with the output unchanged, when there are fewer than six neighbours, they do not lie on a plane, or the camera
// sees the plane at over 66 degrees from its normal.
bool fit_patch_normal(const Map& map, const Neighbours& neighbours, Vector3f* normal_k);

// True when the position of `point` projects to within one sigma of every measurement of `other`.
bool explains(const Map& map, const Camera& camera, const MapPoint& point, const MapPoint& other);

}  // namespace pptam
