// Writes into a map without the checks of Map's functions: for the reader of map files, and for tests.
#pragma once

#include "map/map.h"

namespace pptam {

struct MapAccess {
  static Keyframe& keyframe(Map& map, int index) { return map.keyframes_[index]; }
  static MapPoint& point(Map& map, int index) { return map.points_[index]; }
  static Measurement& measurement(Map& map, int point, int i) {
    return map.measurements_.at(&map.points_[point].measurements, i);
  }
  static PartialPoint& partial_point(Map& map, int index) { return map.partial_points_[index]; }
  static void resize_keyframes(Map& map, int slots) { map.keyframes_.resize(slots); }
  static uint32_t next_id(const Map& map) { return map.next_id_; }
  static void set_next_id(Map& map, uint32_t id) { map.next_id_ = id; }
};

}  // namespace pptam
