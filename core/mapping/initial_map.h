// Finishes a map that an initialiser has made [phone 5.1, ptam 6.1]: finds the poses of the views between the first and
// the last and all velocities, adjusts the map, and moves the world's coordinates onto the ground.
#pragma once

#include "map/map.h"
#include "mapping/bundle_adjustment.h"
#include "mapping/keyframe_pose.h"
#include "scheduler/task.h"

namespace pptam {

class InitialMap {
 public:
  InitialMap(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background,
             BundleAdjuster& bundle, KeyframePose& pose);

  // A coroutine of `background`. False when the map does not explain its measurements, when too few points are left, or
  // when no plane is found: the map is of no use then.
  Task<bool> finish();

  FrameStack& frames() { return background_.frames(); }

 private:
  // Points of the plane: normal . p = offset, in the first camera's frame.
  struct Plane {
    Vector3f normal = Vector3f::UnitZ();
    float offset = 0;
    bool found = false;
  };

  // Of the points for a plane, with a distance up to which they lie on it.
  struct Support {
    int on = 0, below = 0;  // below: on the far side, seen from the camera
    float near = 0;         // sum of their nearness, 1 on the plane
  };

  Task<bool> locate_views();
  Task<> measure_velocities();
  Task<bool> align_to_ground();
  bool faces_up(const Plane& plane) const;
  Support support_of(const Plane& plane, float threshold) const;
  Plane next_plane(uint32_t* state) const;
  Task<Plane> sample_dominant_plane(float threshold);
  Task<Plane> sample_ground(float threshold);
  Task<Plane> refine(Plane plane, float threshold);
  bool align_to(const Plane& plane, float threshold);
  Vector3f p_1(int i) const;  // position of points_[i] in the first camera's frame

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  Background& background_;
  BundleAdjuster& bundle_;
  KeyframePose& pose_;
  FixedVector<int16_t> points_;  // indices of the map points among which the plane is sought
};

}  // namespace pptam
