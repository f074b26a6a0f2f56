// Map maintenance in idle time: removes surplus measurements and unreliable points, merges duplicate points, and
// estimates patch normals. Coroutines of `background`.
#pragma once

#include "map/map.h"
#include "scheduler/task.h"

namespace pptam {

class Hygiene {
 public:
  Hygiene(const Config& config, Map& map, WorkMeter& meter, Background& background)
      : config_(config), map_(map), meter_(meter), background_(background) {}

  // Removes the least useful measurements of points that have more than Config allows.
  Task<> cull_measurements();

  // Removes points that are expected to be seen and are rarely found. A point with two measurements is judged after
  // fewer searches: a wrong match that happened to lie on the epipolar line is found nowhere else.
  Task<> discard_unreliable_points();

  // Takes every point with its neighbours in turn: merges duplicates, and lays the patch on the neighbours' plane.
  // Stops when a keyframe waits; the next call continues there.
  Task<> refine_points();
  bool refining() const { return left_ > 0; }           // points are left in this round of refine_points()
  void begin_round() { left_ = map_.points().size(); }  // to be called when the map has changed
  void forget() { next_ = left_ = 0; }                  // to be called when the map is another one

  FrameStack& frames() { return background_.frames(); }

 private:
  void merge_if_same(int a, int b);

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  Background& background_;
  int next_ = 0;  // slot of Map::points() where refine_points() continues
  int left_ = 0;  // slots left in this round
};

}  // namespace pptam
