// One frame against the map: points chosen, predicted, searched, and the pose from what was found [phone 4].
#pragma once

#include "camera/motion_model.h"
#include "map/map.h"
#include "map/patch_search.h"
#include "tracking/point_selection.h"

namespace pptam {

// What became of a chosen map point.
struct Attempt {
  enum class Outcome : uint8_t {
    kNotVisible,  // not searched
    kMissed,      // searched and not found
    kHidden,      // missed, but a neighbour is seen much nearer: it is probably behind
    kOutlier,     // found, zero weight
    kInlier
  };
  int32_t point = -1;  // index into Map::points()
  Outcome outcome = Outcome::kNotVisible;
  Vector2f predicted_px = Vector2f::Zero();  // level-0 pixels
  ImagePoint at;                             // where it was found; its level is the one searched

  bool found() const { return outcome >= Outcome::kOutlier; }
  bool searched() const { return outcome != Outcome::kNotVisible; }
};

struct MapMatch {
  PoseUpdate pose;
  int visible = 0;    // points that were to be chosen from
  int attempted = 0;  // searched, those excused that are hidden
  int found = 0;
  TrackingQuality quality = TrackingQuality::kBad;

  void report(TrackResult* result) const {
    result->points_attempted = attempted;
    result->points_found = found;
    result->points_inliers = pose.inliers;
  }
};

class MapMatching {
 public:
  enum class Search : uint8_t { kNormal, kBlurred, kWide };

  MapMatching(Arena& arena, const Config& config, Map& map, WorkMeter& meter);

  MapMatch match(const Pyramid& pyramid, const MotionModel& motion, Search search) {
    return match(pyramid, motion, search, motion.T_predicted());
  }
  // Begins at a pose of the caller's.
  MapMatch match(const Pyramid& pyramid, const MotionModel& motion, Search search, const SE3& T_start);

  // Of the last match.
  std::span<const Attempt> attempts() const { return attempts_; }
  float mean_depth(const SE3& T_cw, float without) const;  // of the inliers; `without` if there are none
  float reprojection_px() const;                           // rms error of a weighted measurement's coordinate
  int capacity() const { return selection_.capacity(); }
  void forget() { attempts_.clear(); }
  void report(FixedVector<ObservedPoint>* observed) const;  // the attempts, in place of what was there
  void count_searches();                                    // in the map, for its points' statistics

 private:
  struct Rows;
  MapMatch search_and_update(const Pyramid& pyramid, const SE3& T_start, const VelocityPrior& prior,
                             const SearchOptions& options);
  void search(const Pyramid& pyramid, const SE3& T_start, const VelocityPrior& prior, const SearchOptions& options);
  int excuse_hidden_points(const SE3& T_cw);

  const Config& config_;
  Map& map_;
  PointSelection selection_;
  std::span<const int> selected_;
  FixedVector<Attempt> attempts_;
  PatchFinder finder_;
  PoseUpdater pose_;
};

}  // namespace pptam
