// The pose and the velocity of one keyframe, or of a frame next to one, from the map points measured in it [phone 6].
// Coroutines of `background`.
#pragma once

#include "camera/pose_update.h"
#include "map/map.h"
#include "scheduler/task.h"

namespace pptam {

class KeyframePose {
 public:
  KeyframePose(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background);

  // First what is measured in the frame, at most so many points: it is kept until the next call.
  Task<> gather(int keyframe, int most);
  void gather(const NeighbourFrame& frame, int most);
  // Then the pose that it gives, from a start.
  Task<PoseUpdate> find(const SE3& T_start, const VelocityPrior& prior);

  // The prior that a keyframe's own velocity prior makes, as wide as a calm hand's tremor.
  VelocityPrior prior_of(const Keyframe& keyframe, const Vector6f& mean) const;

  // Velocities of all live keyframes during their readout, against the map as it is.
  Task<> update_velocities();

  FrameStack& frames() { return background_.frames(); }

 private:
  const Config& config_;
  Map& map_;
  Background& background_;
  FixedVector<PosePoint> points_;
  PoseUpdater updater_;
};

}  // namespace pptam
