// The world's z = 0 [ptam 6.1]: found when a map is finished, and chosen anew by the user.
//
// A map's first ground is its dominant plane, unless that is an upright front and there is something below for it to
// stand on. z points from the plane to the camera; x is along the camera's x.
#pragma once

#include <span>

#include <pocket_ptam/config.h>
#include <pocket_ptam/map_info.h>
#include "base/containers.h"
#include "geometry/plane.h"
#include "map/map_access.h"
#include "scheduler/task.h"

namespace pptam {

class Ground {
 public:
  Ground(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background);

  // Moves a new map's coordinates onto its ground and gives them their scale. A coroutine of `background`. False, with
  // nothing changed, when no plane is found.
  Task<bool> align_new_map();

  // For System::set_ground(), planes(). T_cw: the pose from which px is seen. At once, not in slices.
  Status choose(const SE3& T_cw, const Vector2f& px, Similarity* change);
  int planes(const MapAccess::Part& part, std::span<PlaneInfo> out);

  FrameStack& frames() { return background_.frames(); }

 private:
  void gather(const FixedVector<MapPoint>& points, const SE3& T_cw);
  int choose_near(const Vector2f& ray, std::span<Vector3f> near);
  bool faces_up(const Plane& plane) const;
  Task<Plane> sample_dominant_plane(float threshold);
  Task<Plane> sample_ground(float threshold);
  Task<Plane> refine(Plane plane, float threshold);
  bool align_to(const Plane& plane, float threshold);

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  Background& background_;
  FixedVector<Vector3f> points_;  // those among which a plane is sought, in a camera's frame
  FixedVector<int16_t> order_;    // of points_
  FixedVector<float> weights_;    // likewise
};

}  // namespace pptam
