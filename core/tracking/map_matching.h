// Matches one frame against the map: chooses points, predicts and searches them, and finds the pose from the matches
// [phone 4].
#pragma once

#include <span>

#include "camera/motion_model.h"
#include "map/map.h"
#include "map/patch_search.h"
#include "tracking/depth_filter.h"
#include "tracking/kept_templates.h"
#include "tracking/point_selection.h"
#include "tracking/stage_timer.h"

namespace pptam {

// The search of one chosen map point in the frame.
struct Attempt {
  enum class Outcome : uint8_t {
    kNotVisible,  // not searched
    kMissed,      // searched and not found
    kHidden,      // missed, but a surface close by in the image is much nearer: probably occluded
    kOutlier,     // found, zero weight
    kInlier
  };
  int32_t point = -1;  // index into Map::points()
  Outcome outcome = Outcome::kNotVisible;
  Vector2f predicted_px = Vector2f::Zero();  // level-0 pixels
  ImagePoint at;                             // where it was found; at.level is the level searched

  bool found() const { return outcome >= Outcome::kOutlier; }
  bool searched() const { return outcome != Outcome::kNotVisible; }
};

struct MapMatch {
  PoseUpdate pose;
  int visible = 0;          // map points expected in the image, from which the searched ones were chosen
  int attempted = 0;        // points searched, without those that are hidden
  int found = 0;            // points found, outliers too
  int inliers = 0;          // points that the pose agrees with
  int partial_rows = 0;     // partial points that took part in the pose
  int partial_inliers = 0;  // those that it agrees with
  TrackingQuality quality = TrackingQuality::kBad;

  void report(TrackResult* result) const {
    result->points_attempted = attempted;
    result->points_found = found;
    result->points_inliers = inliers;
  }
};

class MapMatching {
 public:
  enum class Search : uint8_t { kNormal, kBlurred, kWide };

  // stages: is told when points are searched and when the pose is found.
  MapMatching(Arena& arena, const Config& config, Map& map, WorkMeter& meter, StageTimer& stages);

  MapMatch match(const Pyramid& pyramid, const MotionModel& motion, Search search) {
    return match(pyramid, motion, search, motion.T_predicted());
  }
  // Begins at T_start in place of the predicted pose.
  MapMatch match(const Pyramid& pyramid, const MotionModel& motion, Search search, const SE3& T_start);
  // Number of points found in the coarse level where `motion` predicts them, of a few that the last frame searched:
  // tells predictions apart.
  int support(const Pyramid& pyramid, const MotionModel& motion);
  // The pose of the last match's measurements together with those of partial points, begun at T_start.
  MapMatch join(std::span<const PartialAttempt> partials, const MotionModel& motion, const SE3& T_start);

  // Results of the last match.
  std::span<const Attempt> attempts() const { return attempts_; }
  float mean_depth(const SE3& T_cw, float without) const;  // of the inliers, world units; `without` if there are none
  int staying(const MotionModel& motion) const;            // inliers that will still be in view in half a second
  float reprojection_px() const;                           // rms error of an inlier's coordinate, level-0 pixels
  int capacity() const { return selection_.capacity(); }
  void forget() { attempts_.clear(); }
  void restart() {  // with another map
    selected_ = {};
    kept_.forget();
  }
  void report(FixedVector<ObservedPoint>* observed) const;  // replaces *observed by the attempts
  void count_searches();                                    // adds the attempts to the map points' statistics

 private:
  struct Rows;
  MapMatch match_coarse_to_fine(const Pyramid& pyramid, const MotionModel& motion, Search search, const SE3& T_first);
  MapMatch search_and_update(const Pyramid& pyramid, const SE3& T_start, const VelocityPrior& prior,
                             const SearchOptions& options);
  void search(const Pyramid& pyramid, const SE3& T_start, const VelocityPrior& prior, const SearchOptions& options);
  MapMatch solve(const SE3& T_start, const VelocityPrior& prior, std::span<const PartialAttempt> partials);
  int mark_occluded_points(const SE3& T_cw);

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  StageTimer& stages_;
  PointSelection selection_;
  std::span<const int> selected_;
  FixedVector<Attempt> attempts_;
  PatchFinder finder_;
  KeptTemplates kept_;  // of level_of_points()
  PoseUpdater pose_;
};

}  // namespace pptam
