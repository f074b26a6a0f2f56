// What System reports about its map and about a saved map.
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
  Vector3f p_w = Vector3f::Zero();       // world units
  Vector3f normal_w = Vector3f::Zero();  // unit normal of the patch
  int measurements = 0;                  // count
  uint8_t grey = 0;                      // grey value of its source pixel, for drawing
};

// A map point measured in a keyframe.
struct MeasurementInfo {
  uint32_t point_id = 0;
  uint32_t keyframe_id = 0;
  Vector2f px = Vector2f::Zero();         // level-0 pixels, as measured
  Vector2f global_px = Vector2f::Zero();  // corrected to a global shutter at the keyframe's timestamp, level-0 pixels
  float sigma = 1;                        // expected standard deviation of a coordinate, level-0 pixels
};

// The most planes that System::planes() lists.
constexpr int kMostPlanes = 4;
// A plane of a map, a ground that could be chosen.
struct PlaneInfo {
  Vector3f normal_w = Vector3f::UnitZ();  // unit, towards the map's first camera
  Vector3f middle_w = Vector3f::Zero();   // mean of its points
  float threshold = 0;                    // distance up to which a point lies on it, world units
  int points = 0;
};

// Header of a saved map.
struct MapInfo {
  int version = 0;  // of the file format
  Camera camera;    // with which it was made, not prepared; see System::load_map
  int maps = 0;     // in the file (Config::max_maps)
  int keyframes = 0, erased_keyframes = 0, map_points = 0, partial_points = 0;  // of all of them
  // Smallest capacities (max_... of Config) with which it can be loaded.
  int min_keyframes = 0, min_erased_keyframes = 0, min_map_points = 0, min_partial_points = 0;
  int min_measurements = 0, min_measurements_per_point = 0;
};

}  // namespace pptam
