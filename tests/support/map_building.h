// Maps made by hand.
#pragma once

#include <gtest/gtest.h>

#include <concepts>
#include <cstddef>
#include <span>
#include <vector>

#include "map/map.h"
#include "map/map_access.h"

namespace pptam::test {

// The memory that `build` takes from an arena, and its results there: it runs twice, first on an arena that measures.
class Block {
 public:
  template <class Build>
  explicit Block(Build&& build) {
    Arena measure;
    build(measure);
    memory_.resize(measure.used() / sizeof(std::max_align_t) + 1);
    Arena arena(std::as_writable_bytes(std::span(memory_)));
    build(arena);
    EXPECT_FALSE(arena.overflowed());
  }

 private:
  std::vector<std::max_align_t> memory_;
};

// Hands a keyframe that `fill` completes through the queue, as tracker and mapper do. Its index, or -1.
template <std::invocable<Keyframe&> Fill>
int add_keyframe(Map& map, Fill&& fill) {
  fill(map.queue().hold().frame);
  map.queue().release();
  const int index = map.add_keyframe(map.queue().front().frame);
  map.queue().pop();
  return index;
}
inline int add_keyframe(Map& map, const SE3& T_kw) {  // about one unit from the scene
  return add_keyframe(map, [&](Keyframe& frame) {
    frame.T_kw = T_kw;
    frame.mean_depth = 1;
  });
}

// Of p_w in a keyframe, where it projects without the keyframe's motion.
inline Measurement measure_exactly(const Map& map, const Camera& camera, int keyframe, const Vector3f& p_w) {
  Measurement m;
  m.keyframe = static_cast<int16_t>(keyframe);
  EXPECT_TRUE(camera.project(map.keyframes()[keyframe].T_kw * p_w, &m.at.px)) << "not to be seen in " << keyframe;
  return m;
}

inline void remove_measurements(Map& map, int point) {
  while (map.points()[point].measurements.size() > 0) map.remove_measurement(point, 0);
}

}  // namespace pptam::test
