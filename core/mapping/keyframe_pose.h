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

  // Collects up to `most` points that are measured in the frame, for find(). They are kept until the next call.
  Task<> gather(int keyframe, int most);
  void gather(const NeighbourFrame& frame, int most);
  // Pose and velocity from the collected points, beginning at T_start.
  Task<PoseUpdate> find(const SE3& T_start, const VelocityPrior& prior);

  // Prior with the given mean, as wide as a calm hand's tremor (kVelocitySigma...) at the keyframe's mean depth.
  VelocityPrior prior_of(const Keyframe& keyframe, const Vector6f& mean) const;

  // Estimates the velocities of all live keyframes during their readout. Poses and points stay as they are.
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
