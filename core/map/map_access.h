// Writes into a map without the checks of Map's functions: for the reader of map files, and for tests.
#pragma once

#include "base/assert.h"
#include "map/map.h"

namespace pptam {

struct MapAccess {
  // What there is of one of the maps.
  struct Part {
    const FixedVector<Keyframe>* keyframes = nullptr;
    const FixedVector<MapPoint>* points = nullptr;
    const FixedVector<PartialPoint>* partial_points = nullptr;
    uint32_t number = 0;
  };
  static Part in_use(const Map& map) { return {&map.keyframes_, &map.points_, &map.partial_points_, map.number_}; }
  static Part aside(const Map& map, int place) {
    const Map::Contents& contents = map.aside_[place];
    return {&contents.keyframes, &contents.points, &contents.partial_points, contents.number};
  }
  static Keyframe& keyframe(Map& map, int index) { return map.keyframes_[index]; }
  static MapPoint& point(Map& map, int index) { return map.points_[index]; }
  static Measurement& measurement(Map& map, int point, int i) {
    return map.measurements_.at(&map.points_[point].measurements, i);
  }
  static PartialPoint& partial_point(Map& map, int index) { return map.partial_points_[index]; }
  static void resize_keyframes(Map& map, int slots) { map.keyframes_.resize(slots); }
  static uint32_t next_id(const Map& map) { return map.next_id_; }
  static void set_next_id(Map& map, uint32_t id) { map.next_id_ = id; }
  static uint32_t last_number(const Map& map) { return map.last_number_; }
  static void set_numbers(Map& map, uint32_t number, uint32_t last) {
    map.number_ = number;
    map.last_number_ = last;
  }
  static void bring_images(Map& map, int index) {
    const bool brought = map.bring_images(index);
    PPTAM_ASSERT(brought);
    (void)brought;
  }
};

}  // namespace pptam
