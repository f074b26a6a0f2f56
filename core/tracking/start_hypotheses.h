// Stage 2 of the homography start: tracks rival maps until one wins [phone 5.1].
//
// There are up to two planar hypotheses (R, t, n) and one without a plane, each with its own triangulated points. An
// SE(3) pose is tracked in each at every frame, until the others cost twice as much. A plane that costs hardly more
// than the general structure wins: it has fewer unknowns.
#pragma once

#include "camera/pose_update.h"
#include "geometry/homography.h"
#include "geometry/two_view.h"
#include "map/map.h"
#include "tracking/homography_tracker.h"

namespace pptam {

struct Hypothesis {
  bool planar = true;
  Vector3f n_1 = Vector3f::UnitZ();  // the plane n_1 . p_1 = 1, when planar
  SE3 T_c1;                          // pose of the current frame
  Vector6f velocity = Vector6f::Zero();
  FixedVector<Vector3f> p_1;  // one per point, first camera's frame; z = 0 where not triangulated
  float cost = 0;             // robust cost, summed over the frames with forgetting; units of scale^2
  float sigma = 0;            // robust scale of its residuals in the current frame, units of start_sigma_px()
  bool alive = false;
};

class StartHypotheses {
 public:
  enum class Outcome : uint8_t { kUndecided, kDecided, kNoneLeft };

  StartHypotheses(Arena& arena, const Config& config, WorkMeter& meter);

  // Makes a map for each of the plane's solutions and, if it is not null, for the relative pose.
  void branch(const HomographyTracker& tracker, const Decomposition& decomposition, const RelativePose* general);
  // Finds the next frame's pose in each map, and compares their costs.
  Outcome track(const HomographyTracker& tracker, float dt_s);
  const Hypothesis& winner() const { return hypotheses_[winner_]; }  // after kDecided

 private:
  static constexpr int kHypotheses = 3;  // two of the plane, one general

  bool triangulate_points(const HomographyTracker& tracker, Hypothesis& hypothesis, SE3* T_b1) const;
  float track_poses(const HomographyTracker& tracker, float dt_s);
  void add_costs(std::span<const TrackedPoint> points, float scale);
  Outcome decide();
  void gather_pose_points(std::span<const TrackedPoint> points, const Hypothesis& hypothesis);
  Vector6f velocity_from_rate(const Matrix3f& rate, const Hypothesis& hypothesis, const SE3& T_k1) const;

  const Config& config_;
  FixedVector<uint8_t> found_at_branch_;  // one per point: 1 when it was found in the frame of branch()
  FixedVector<PosePoint> pose_points_;
  PoseUpdater pose_;
  Hypothesis hypotheses_[kHypotheses];
  int frames_ = 0;
  int winner_ = 0;
};

}  // namespace pptam
