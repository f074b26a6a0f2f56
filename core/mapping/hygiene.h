// Keeps the map clean when nothing else is to do: bad points go, points that are one become one, patches turn as they
// lie. Coroutines of `background`.
#pragma once

#include "map/map.h"
#include "scheduler/task.h"

namespace pptam {

class Hygiene {
 public:
  Hygiene(const Config& config, Map& map, WorkMeter& meter, Background& background)
      : config_(config), map_(map), meter_(meter), background_(background) {}

  // Measurements of points that have more than Config allows.
  Task<> cull_measurements();

  // Points that are expected to be seen and are not found. One that only two keyframes have measured is on trial: a
  // wrong match that happened to lie on the epipolar line is found nowhere else.
  Task<> discard_unreliable_points();

  // Every point and its neighbours, in turn: duplicates become one, and the patch lies as its neighbours do. Stops when
  // a keyframe waits, and goes on where it stopped.
  Task<> tidy();
  bool untidy() const { return left_ > 0; }
  void begin_round() { left_ = map_.points().size(); }  // of tidy(): the map has changed
  void forget() { next_ = left_ = 0; }                  // another map

  FrameStack& frames() { return background_.frames(); }

 private:
  void merge_if_same(int a, int b);

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  Background& background_;
  int next_ = 0, left_ = 0;  // slot of Map::points(), and how many more
};

}  // namespace pptam
