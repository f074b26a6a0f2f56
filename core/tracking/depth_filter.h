// Depth of partial points: a few of them are searched in every good frame, along their epipolar lines [phone 5.2].
#pragma once

#include "camera/motion_model.h"
#include "map/map.h"
#include "map/patch_search.h"

namespace pptam {

class DepthFilter {
 public:
  DepthFilter(const Config& config, Map& map, WorkMeter& meter)
      : config_(config), map_(map), finder_(map, config.camera, meter) {}

  // Searches partial points in turn, up to Config::max_partial_searches, and updates their inverse depths. `motion` has
  // the frame's pose. Found points are added to `observed`; `result` counts attempts and finds.
  void update(const Pyramid& pyramid, const MotionModel& motion, FixedVector<ObservedPoint>* observed,
              TrackResult* result);
  void restart() { next_ = 0; }

 private:
  void search(int slot, const Pyramid& pyramid, const MotionModel& motion, FixedVector<ObservedPoint>* observed,
              TrackResult* result);

  const Config& config_;
  Map& map_;
  PatchFinder finder_;
  int next_ = 0;  // slot of Map::partial_points() where the next frame's search begins
};

}  // namespace pptam
