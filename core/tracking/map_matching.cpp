#include "tracking/map_matching.h"

#include <algorithm>
#include <cmath>

namespace pptam {

namespace {

// Tracking quality [ptam 5.6]: least share of inliers among the points searched, and least number of inliers, of map
// points and of the partial points that took part. Only a frame of good quality confirms a pose of the relocaliser; one
// that is not even poor counts towards being lost. Shares reached: 0.62 to
// 0.78 in real recordings (their worst tenth 0.28 to 0.65), 0.83 to 0.94 on the emulated phone. Not swept.
constexpr float kGoodFraction = 0.45f;
constexpr float kPoorFraction = 0.22f;
constexpr int kGoodInliers = 12;
constexpr int kPoorInliers = 8;
// Largest 1-sigma of the position in mean depths: 0.004 in a sharp frame of an emulated map, up to 0.012 where the view
// is being replaced, 0.05 in the blurred ones of a shake that are off by a tenth of the depth. Not swept.
constexpr float kGoodPositionSigma = 0.03f;
// A missed point is taken to be occluded by an inlier that lies within this distance of the missed point's prediction,
// level-0 px, at less than this share of its depth. Not swept. Larger values excuse more misses, wrong poses' too.
constexpr float kMaxOccluderDistance_px = 25.0f;
constexpr float kMaxOccluderDepthRatio = 0.85f;
// Time after which inliers must still be in view to count as staying, s: a new corner serves the pose after about this
// time, at 15 frames/s. Not swept.
constexpr float kStayingAhead_s = 0.5f;
// Radius of the search, pixels of the level searched: of every frame [phone 4], and of the coarse stage of a wide
// search. The wide radius is not swept.
constexpr float kRadius_px = 4.0f, kWideRadius_px = 7.0f;

// With levels of their own: radius of the coarse stage, of a usual frame and of a wide search, and of the fine stage,
// pixels of each point's level. Not swept.
constexpr float kCoarseRadius_px = 6.0f, kWideCoarseRadius_px = 12.0f, kFineRadius_px = 4.0f;
// Image motion since the last frame, level-0 px, under which the camera is nearly stationary and the coarse stage is
// left out: two stages make the pose jitter [ptam 6.5]. The fine stage bridges four times as much. Not swept.
constexpr float kNearlyStill_px = 1.0f;

// Templates kept for each point that may be searched in a frame: points come and go. Not swept.
constexpr int kKeptPerSearched = 2;

// Points searched for support(), and the radius, pixels of the coarse level. With twice the radius three of 54 emulated
// runs lost the camera that keep it with this one: chance matches outvote a prediction. Their number was not swept.
constexpr int kSupportPoints = 16;
constexpr float kSupportRadius_px = 2.0f;

TrackingQuality quality_of(const MapMatch& match) {
  const int searched = match.attempted + match.partial_rows;
  const int inliers = match.inliers + match.partial_inliers;
  if (!match.pose.ok || searched <= 0) return TrackingQuality::kBad;
  const float fraction = static_cast<float>(inliers) / static_cast<float>(searched);
  if (fraction >= kGoodFraction && inliers >= kGoodInliers && match.pose.position_sigma() < kGoodPositionSigma)
    return TrackingQuality::kGood;
  if (fraction >= kPoorFraction && inliers >= kPoorInliers) return TrackingQuality::kPoor;
  return TrackingQuality::kBad;
}

}  // namespace

// Rows of the pose update: the map points that were found, then the partial points that serve, in their order.
struct MapMatching::Rows final : PoseRows {
  Rows(const MapMatching& matching, std::span<const PartialAttempt> partials)
      : matching_(matching), partials_(partials) {}
  int count() const override {
    int count = 0;
    for (const Attempt& attempt : matching_.attempts_) count += attempt.found();
    for (const PartialAttempt& partial : partials_) count += partial.serves();
    return count;
  }
  void linearise(const SE3& T_cw, const Vector6f& velocity, std::span<PoseRow> rows) const override {
    const Camera& camera = matching_.config_.camera;
    size_t i = 0;
    for (const Attempt& attempt : matching_.attempts_)
      if (attempt.found() && i < rows.size())
        rows[i++].set_point(camera, T_cw, velocity, matching_.map_.points()[attempt.point].p_w, attempt.at);
    for (const PartialAttempt& partial : partials_)
      if (partial.serves() && i < rows.size()) partial.set_row(camera, T_cw, velocity, &rows[i++]);
  }

 private:
  const MapMatching& matching_;
  std::span<const PartialAttempt> partials_;
};

MapMatching::MapMatching(Arena& arena, const Config& config, Map& map, WorkMeter& meter, StageTimer& stages)
    : config_(config),
      map_(map),
      meter_(meter),
      stages_(stages),
      selection_(arena, config, meter),
      attempts_(arena, config.max_measured_points),
      finder_(map, config, meter),
      kept_(arena, config.max_map_points, kKeptPerSearched * config.max_measured_points),
      pose_(arena, config.max_measured_points + config.max_partial_searches, config.camera.shutter.line_time_s != 0,
            meter) {}

MapMatch MapMatching::match(const Pyramid& pyramid, const MotionModel& motion, Search search, const SE3& T_first) {
  stages_.enter(Stage::kSearch);
  if (config_.own_levels) return match_coarse_to_fine(pyramid, motion, search, T_first);
  SE3 T_start = T_first;
  VelocityPrior prior = motion.prior(T_start);
  SearchOptions options;
  selected_ = selection_.select(map_, T_start);
  if (search == Search::kWide) {
    // Coarse to fine: a wide circle in a coarse level costs less than in a fine one and has fewer false matches.
    options.level = config_.coarse_search_level;
    options.radius_px = kWideRadius_px;
    const MapMatch coarse = search_and_update(pyramid, T_start, prior, options);
    if (coarse.quality != TrackingQuality::kBad) {
      T_start = coarse.pose.T_cw;
      prior = motion.prior(T_start);
      stages_.enter(Stage::kSearch);
      selected_ = selection_.select(map_, T_start);
    }
  }
  options.level = search == Search::kBlurred ? config_.coarse_search_level : config_.search_level;
  options.radius_px = kRadius_px;
  return search_and_update(pyramid, T_start, prior, options);
}

// Points in their own levels: a few coarse ones in a wide circle, which tolerate a bad prediction and blur, then all
// the others near where the pose of these predicts them [ptam 5.5].
MapMatch MapMatching::match_coarse_to_fine(const Pyramid& pyramid, const MotionModel& motion, Search search,
                                           const SE3& T_first) {
  kept_.begin_search();
  SE3 T_start = T_first;
  SearchOptions options;
  options.level = kOwnLevel;
  const float moved_px = motion.image_speed() * motion.dt_s() * config_.camera.model.fx;
  if (search == Search::kNormal && moved_px < kNearlyStill_px) {
    selected_ = selection_.select(map_, T_start);
  } else {
    selected_ = selection_.select_coarse(map_, T_start, config_.max_coarse_points);
    options.radius_px = search == Search::kWide ? kWideCoarseRadius_px : kCoarseRadius_px;
    MapMatch coarse = search_and_update(pyramid, T_start, motion.prior(T_start), options);
    if (search == Search::kBlurred) return coarse;
    if (coarse.quality != TrackingQuality::kBad) T_start = coarse.pose.T_cw;
    stages_.enter(Stage::kSearch);
    selected_ = search == Search::kWide ? selection_.select(map_, T_start) : selection_.select_again(map_);
  }
  options.radius_px = kFineRadius_px;
  return search_and_update(pyramid, T_start, motion.prior(T_start), options);
}

int MapMatching::support(const Pyramid& pyramid, const MotionModel& motion) {
  SearchOptions options;
  options.level = config_.coarse_search_level;
  options.radius_px = kSupportRadius_px;
  options.refine = false;
  selected_ = selected_.first(std::min<size_t>(selected_.size(), kSupportPoints));
  search(pyramid, motion.T_predicted(), motion.prior(), options);
  return static_cast<int>(
      std::count_if(attempts_.begin(), attempts_.end(), [](const Attempt& attempt) { return attempt.found(); }));
}

MapMatch MapMatching::search_and_update(const Pyramid& pyramid, const SE3& T_start, const VelocityPrior& prior,
                                        const SearchOptions& options) {
  search(pyramid, T_start, prior, options);
  return solve(T_start, prior, {});
}

MapMatch MapMatching::join(std::span<const PartialAttempt> partials, const MotionModel& motion, const SE3& T_start) {
  for (Attempt& attempt : attempts_) {
    if (attempt.outcome == Attempt::Outcome::kInlier) attempt.outcome = Attempt::Outcome::kOutlier;
    if (attempt.outcome == Attempt::Outcome::kHidden) attempt.outcome = Attempt::Outcome::kMissed;
  }
  return solve(T_start, motion.prior(T_start), partials);
}

MapMatch MapMatching::solve(const SE3& T_start, const VelocityPrior& prior, std::span<const PartialAttempt> partials) {
  stages_.enter(Stage::kPose);
  MapMatch match;
  match.visible = selection_.visible();
  for (const Attempt& attempt : attempts_) {
    match.attempted += attempt.searched();
    match.found += attempt.found();
  }
  for (const PartialAttempt& partial : partials) match.partial_rows += partial.serves();
  match.pose = pose_.run(T_start, prior, Rows(*this, partials));
  if (match.pose.ok) {
    const PoseRow* row = pose_.rows().data();
    for (Attempt& attempt : attempts_) {
      if (!attempt.found() || (row++)->weight == 0) continue;
      attempt.outcome = Attempt::Outcome::kInlier;
      ++match.inliers;
    }
    match.partial_inliers = match.pose.inliers - match.inliers;
    match.attempted -= mark_occluded_points(match.pose.T_cw);
  }
  match.quality = quality_of(match);
  return match;
}

void MapMatching::search(const Pyramid& pyramid, const SE3& T_start, const VelocityPrior& prior,
                         const SearchOptions& options) {
  stages_.enter(Stage::kSearch);
  attempts_.clear();
  const bool keeps = options.level == level_of_points(config_);
  if (keeps && options.level != kOwnLevel) kept_.begin_search();
  for (const int index : selected_) {
    const MapPoint& point = map_.points()[index];
    PredictedPoint predicted;
    if (point.id == 0) continue;  // of support(): removed since the last frame
    meter_.charge(Work::kOther, kPredictionInstructions);
    if (!config_.camera.project_rolling(T_start, prior.mean, point.p_w, &predicted) ||
        !config_.camera.in_image(predicted.px, search_border_px(config_)))
      continue;
    Attempt attempt;
    attempt.point = index;
    attempt.predicted_px = predicted.px;
    const int level = options.level == kOwnLevel ? point.source.level : options.level;
    attempt.at = {predicted.px, static_cast<uint8_t>(level)};
    KeptTemplate* const kept = keeps ? kept_.of(index, point.id) : nullptr;
    switch (finder_.find(point.source, point.p_w, predicted, pyramid, options, &attempt.at, kept)) {
      case SearchOutcome::kNotVisible:
        break;
      case SearchOutcome::kNotFound:
        attempt.outcome = Attempt::Outcome::kMissed;
        break;
      case SearchOutcome::kFound:
        attempt.outcome = Attempt::Outcome::kOutlier;  // until the pose update gives it a weight
        break;
    }
    attempts_.push_back(attempt);
  }
}

// Marks missed points as hidden where an inlier close by in the image is much nearer to the camera: the point is
// probably behind that surface, and missing it says nothing about the pose. Returns the number marked.
int MapMatching::mark_occluded_points(const SE3& T_cw) {
  const auto depth = [&](const Attempt& attempt) {
    return T_cw.R.row(2).dot(map_.points()[attempt.point].p_w) + T_cw.t.z();
  };
  const float near_px = kMaxOccluderDistance_px * config_.px_scale();
  int hidden = 0;
  for (Attempt& missed : attempts_) {
    if (missed.outcome != Attempt::Outcome::kMissed) continue;
    const float nearer = kMaxOccluderDepthRatio * depth(missed);
    for (const Attempt& seen : attempts_) {
      if (seen.outcome != Attempt::Outcome::kInlier ||
          (seen.at.px - missed.predicted_px).squaredNorm() > near_px * near_px || depth(seen) > nearer)
        continue;
      missed.outcome = Attempt::Outcome::kHidden;
      ++hidden;
      break;
    }
  }
  return hidden;
}

float MapMatching::mean_depth(const SE3& T_cw, float without) const {
  float sum = 0;
  int count = 0;
  for (const Attempt& attempt : attempts_) {
    if (attempt.outcome != Attempt::Outcome::kInlier) continue;
    sum += (T_cw * map_.points()[attempt.point].p_w).z();
    ++count;
  }
  return count > 0 ? sum / static_cast<float>(count) : without;
}

int MapMatching::staying(const MotionModel& motion) const {
  const SE3 T_ahead = SE3::exp(motion.last_motion() * kStayingAhead_s) * motion.T_cw();
  int staying = 0;
  for (const Attempt& attempt : attempts_) {
    Vector2f px;
    staying += attempt.outcome == Attempt::Outcome::kInlier &&
               config_.camera.project(T_ahead * map_.points()[attempt.point].p_w, &px) &&
               config_.camera.in_image(px, search_border_px(config_));
  }
  return staying;
}

float MapMatching::reprojection_px() const {
  float sum = 0;
  int count = 0;
  const PoseRow* row = pose_.rows().data();
  for (const Attempt& attempt : attempts_) {
    if (!attempt.found()) continue;
    const float sigma = attempt.at.sigma();
    if (row->weight != 0) {
      sum += row->error_sq * sigma * sigma;
      ++count;
    }
    ++row;
  }
  return count > 0 ? std::sqrt(0.5f * sum / static_cast<float>(count)) : 0.0f;
}

void MapMatching::count_searches() {
  for (const Attempt& attempt : attempts_)
    if (attempt.searched() && attempt.outcome != Attempt::Outcome::kHidden)
      map_.count_search(attempt.point, attempt.outcome == Attempt::Outcome::kInlier);
}

void MapMatching::report(FixedVector<ObservedPoint>* observed) const {
  observed->clear();
  for (const Attempt& attempt : attempts_) {
    ObservedPoint point;
    switch (attempt.outcome) {
      case Attempt::Outcome::kNotVisible:
        continue;
      case Attempt::Outcome::kMissed:
        point.kind = ObservedKind::kMissed;
        break;
      case Attempt::Outcome::kHidden:
        point.kind = ObservedKind::kHidden;
        break;
      case Attempt::Outcome::kOutlier:
        point.kind = ObservedKind::kOutlier;
        break;
      case Attempt::Outcome::kInlier:
        point.kind = ObservedKind::kInlier;
        break;
    }
    point.px = attempt.at.px;
    point.predicted_px = attempt.predicted_px;
    point.point_id = map_.points()[attempt.point].id;
    point.level = attempt.at.level;
    observed->push_back(point);
  }
}

}  // namespace pptam
