// What can be read of a map, and of a saved one.
#pragma once

#include <cstdint>

#include <pocket_ptam/camera.h>

namespace pptam {

struct KeyframeInfo {
  uint32_t id = 0;
  int64_t timestamp_ns = 0;
  SE3 T_cw;
};
struct MapPointInfo {
  uint32_t id = 0;
  Vector3f p_w = Vector3f::Zero();
  Vector3f normal_w = Vector3f::Zero();
  int measurements = 0;
  uint8_t grey = 0;  // of its source pixel, for pictures
};

// A point found in a keyframe.
struct MeasurementInfo {
  uint32_t point_id = 0;
  uint32_t keyframe_id = 0;
  Vector2f px = Vector2f::Zero();         // level-0 pixels, as measured
  Vector2f global_px = Vector2f::Zero();  // where a global shutter would have seen it: what T_cw alone explains
  float sigma = 1;                        // expected, level-0 pixels
};

// What a saved map says of itself.
struct MapInfo {
  int version = 0;
  Camera camera;  // with which it was made, not prepared; Config's must be the same to load it
  int keyframes = 0, erased_keyframes = 0, map_points = 0, partial_points = 0;
  // Capacities of a Config that can load it.
  int min_keyframes = 0, min_erased_keyframes = 0, min_map_points = 0, min_partial_points = 0;
  int min_measurements = 0, min_measurements_per_point = 0;
};

}  // namespace pptam
