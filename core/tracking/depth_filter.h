// Depth of partial points [phone 5.2]: some are searched in every frame, along their epipolar lines. Their measurements
// take part in the pose where map points are few; then the pose corrects their depths.
//
//   search() ─▶ attempts() ─▶ MapMatching::join() ─▶ update(), with the frame's pose
#pragma once

#include <span>

#include "camera/motion_model.h"
#include "map/map.h"
#include "map/patch_search.h"

namespace pptam {

// The search of one partial point in the frame.
struct PartialAttempt {
  enum class Outcome : uint8_t {
    kOutOfRange,  // its depth is outside of the scene's: not searched
    kMissed,
    kFound
  };
  int32_t slot = -1;  // of Map::partial_points()
  uint32_t id = 0;    // the point's
  Outcome outcome = Outcome::kOutOfRange;
  bool known = false;                        // found before, so that its place in the image is not one chance match
  Vector3f p_w = Vector3f::Zero();           // at its present inverse depth, world units
  Vector2f predicted_px = Vector2f::Zero();  // level-0 pixels
  ImagePoint at;                             // where it was found
  // Pixels by which one sigma of the inverse depth moves it along its epipolar line, level 0.
  Vector2f depth_px = Vector2f::Zero();

  bool serves() const { return known && outcome == Outcome::kFound; }  // the pose
  // Row of the pose update, of covariance sigma^2 I + depth_px depth_px^T: along the epipolar line the depth takes most
  // of the residual, across it the pose does.
  void set_row(const Camera& camera, const SE3& T_cw, const Vector6f& velocity, PoseRow* row) const;
};

class DepthFilter {
 public:
  DepthFilter(Arena& arena, const Config& config, Map& map, WorkMeter& meter);

  // Where the search begins, and how.
  struct Start {
    SE3 T_cw;
    Vector6f velocity = Vector6f::Zero();  // during the readout
    float mean_depth = 1;                  // of the scene, world units
    float margin_px = 0;                   // of the pose's error in the image, pixels of the level searched
    int level = 1;                         // searched
    int count = 0;                         // points searched at most
  };
  // Searches partial points in turn. Nothing in the map changes.
  void search(const Pyramid& pyramid, const Start& start);
  void forget() { attempts_.clear(); }
  std::span<const PartialAttempt> attempts() const { return attempts_; }
  // Updates the points that were searched, by the frame's pose in `motion`. Found points are added to `observed`;
  // `result` counts attempts and finds.
  void update(const MotionModel& motion, FixedVector<ObservedPoint>* observed, TrackResult* result);
  void restart() { next_ = 0; }

 private:
  // Inverse depths between which a point is sought, where they appear, and the middle one.
  struct Line {
    float near = 0, q = 0, far = 0;  // inverse depths, world units^-1
    SE3 T_ws;                        // exposed_pose() of the source
    PredictedPoint at_near, at_q, at_far;
    Vector2f slope() const;  // d(px)/dq
  };
  enum class Place : uint8_t { kVisible, kNotVisible, kOutOfRange };
  Place project(const PartialPoint& partial, const SE3& T_cw, const Vector6f& velocity, float mean_depth,
                Line* line) const;
  void try_slot(int slot, const Pyramid& pyramid, const Start& start);
  bool correct(const PartialAttempt& attempt, const MotionModel& motion);

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  PatchFinder finder_;
  FixedVector<PartialAttempt> attempts_;
  int next_ = 0;        // slot of Map::partial_points() where the next frame's search begins
  int after_last_ = 0;  // slot after the last one searched in this frame
};

}  // namespace pptam
