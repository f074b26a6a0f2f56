// Finishes a map that an initialiser has made [phone 5.1, ptam 6.1]: finds the poses of the views between the first and
// the last and all velocities, adjusts the map, and moves the world's coordinates onto the ground.
#pragma once

#include "map/map.h"
#include "mapping/bundle_adjustment.h"
#include "mapping/ground.h"
#include "mapping/keyframe_pose.h"
#include "scheduler/task.h"

namespace pptam {

class InitialMap {
 public:
  InitialMap(const Config& config, Map& map, Background& background, BundleAdjuster& bundle, KeyframePose& pose,
             Ground& ground);

  // A coroutine of `background`. False when the map does not explain its measurements, when too few points are left, or
  // when no plane is found: the map is of no use then.
  Task<bool> finish();

  FrameStack& frames() { return background_.frames(); }

 private:
  Task<bool> locate_views();
  Task<> measure_velocities();

  const Config& config_;
  Map& map_;
  Background& background_;
  BundleAdjuster& bundle_;
  KeyframePose& pose_;
  Ground& ground_;
};

}  // namespace pptam
