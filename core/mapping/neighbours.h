// What the nearest points of the map say of a point: how its patch lies, and whether it is the same as one of them.
//
// A patch begins facing the camera that it was cut from. Seen from elsewhere it is then warped wrongly and found a
// little beside its place, or not at all. Where a point and its neighbours lie on a plane, the patch is taken to lie on
// it too.
//
// The mapper calls, for every point when bundle adjustment has come to rest. Frames as in map.h. Cost: about 12 ARMv6
// instructions for each point of the map to find the neighbours of one, some 5000 for their plane (estimates).
#pragma once

#include "map/map.h"

namespace pptam {

// Not critical: from 7 to 16 no difference was seen on the emulated phone.
constexpr int kNeighbours = 12;

// Indices into Map::points of the nearest to a point, itself first, by ascending distance; of equally distant ones the
// lower slot first. None beyond a quarter of its distance from the camera that its patch comes from.
using Neighbours = InlineVector<int, kNeighbours>;
Neighbours find_neighbours(const Map& map, int point);

// Normal of the plane through the neighbours, in the frame of the point's source keyframe, towards its camera. False,
// with the output unchanged, where fewer than six are near, they do not agree on a plane, or it is seen too much from
// the side.
bool fit_patch_normal(const Map& map, const Neighbours& neighbours, Vector3f* normal_k);

// Does the position of `point` explain all that was measured of `other`, each to within one sigma?
bool explains(const Map& map, const Camera& camera, const MapPoint& point, const MapPoint& other);

}  // namespace pptam
