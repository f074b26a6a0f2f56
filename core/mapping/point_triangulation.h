// The position of a map point from where it was found in two keyframes, with the checks that every point source makes.
#pragma once

#include "map/map.h"

namespace pptam {

enum class PointDepth : uint8_t {
  kKnown,
  kUncertain,  // rays nearly parallel, or too much noise for their angle
  kOffTheLine  // the two measurements are not of one point
};

struct PointMeasurements {
  int keyframe_1 = -1, keyframe_2 = -1;                       // indices into Map::keyframes()
  Vector2f px_1 = Vector2f::Zero(), px_2 = Vector2f::Zero();  // level-0 pixels
  float noise_px = 0.8f;                                      // of a measurement, level-0 pixels
  float max_error_px = 4;  // of the triangulated point's projections, level-0 pixels: more is off the epipolar line
};

// *p_w: about where the point is, for the rolling shutter's correction; its position if it is known, and otherwise
// unchanged. 3500 ARMv6 instructions, as counted, are charged by the caller.
PointDepth triangulate_point(const Map& map, const Camera& camera, const PointMeasurements& measured, Vector3f* p_w);
constexpr int64_t kTriangulationInstructions = 3500;

}  // namespace pptam
