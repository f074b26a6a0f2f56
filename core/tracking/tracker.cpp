#include "tracking/tracker.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "base/deterministic_math.h"
#include "geometry/robust.h"
#include "image/grey.h"
#include "map/patch_search.h"
#include "tracking/relocaliser.h"

namespace pptam {

namespace {

// Quality from the fraction of expected points found as inliers, and their number.
constexpr float kGoodFraction = 0.45f;
constexpr float kPoorFraction = 0.22f;
constexpr int kGoodInliers = 12;
constexpr int kPoorInliers = 8;
constexpr int kBadFramesUntilLost = 3;
// Who hides a point: seen within so many level-0 px of where it was expected, at less than this share of its depth.
constexpr float kNeighbour_px = 25.0f;
constexpr float kHidingDepth = 0.85f;
constexpr int kFramesToConfirm = 2;

// Image motion within the exposure at which L1 becomes too blurred: a third of the 16 level-0 px that a template
// covers.
constexpr float kBlurLimit_px = 6.0f;

constexpr float kVelocityBlend = 0.7f;      // share of the newest measured velocity
constexpr float kVelocityDecayRate = 1.6f;  // 1/s: a fifth is left of a velocity after a second without measurements

constexpr int kCellsX = 6;
constexpr int kCellsY = 8;
constexpr float kImageBorder_px = 12.0f;             // half a template and the search circle of L1, in level-0 pixels
constexpr float kMinCosView = 0.5f;                  // between the source's and the present viewing direction
constexpr float kMinScale = 0.4f, kMaxScale = 2.5f;  // distance ratios that a warp can bridge

// New keyframes: distance to the nearest keyframe in mean depths, which grows as the map fills (a young map needs
// baselines soon, a full one must not grow), or the share of the budget that the view fills.
constexpr float kKeyframeDistanceNew = 0.004f, kKeyframeDistanceFull = 0.18f;
constexpr float kKeyframeMinDistance = 0.004f;
constexpr float kSparseViewFraction = 0.6f;
constexpr float kFullInterval_s = 2.0f;    // a map that had none to spare is asked again after this time
constexpr float kKeyframeCosTurn = 0.98f;  // 11.5 degrees: views turned by more do not count as near

constexpr int kMaxPartialFailures = 12;
constexpr float kInverseDepthRange = 2.5f;  // partial points are sought within mean / range to mean * range

// Rest before initialisation starts by itself: its length, and the apparent rotation in radians/s that a hand at rest
// does not exceed.
constexpr float kSteadyTime_s = 0.3f;
constexpr float kSteadySpeed = 0.2f;

// How far the velocity during a readout may be from the mean since the last frame: this share of the change of the
// rotation rate from frame to frame, rms of each component over some ten frames; at least what a calm hand needs, at
// most this in radians/s.
constexpr float kUnrestShare = 0.5f;
constexpr float kUnrestBlend = 0.1f;
constexpr float kMaxSigmaRotation = 0.3f;

// Standing still. Turn of the image between two frames that says so, 0.09 degrees: a starting point, not swept. Share
// of the newest difference in the mean, and of a difference that is noise in the pose shown.
constexpr float kStillTurn_rad = 0.0015f;
constexpr float kDifferenceBlend = 0.3f;
constexpr float kSlowestGain = 0.1f;
// Of a measured patch from frame to frame, in pixels of its level [tests/kernels: 0.024 at contrast 50].
constexpr float kPatchNoise = 0.03f;

// After a longer gap the motion model's velocity says nothing.
constexpr float kLongestGap_s = 1.0f;

// Through double: timestamps may be further apart than int64 can tell.
float elapsed_s(int64_t from_ns, int64_t to_ns) {
  return static_cast<float>((static_cast<double>(to_ns) - static_cast<double>(from_ns)) * 1e-9);
}

bool inside(const CameraModel& camera, const Vector2f& px) {
  return camera.in_image(px, kImageBorder_px);
}

}  // namespace

Tracker::Tracker(Arena& arena, const Config& config, Map& map, WorkMeter& meter)
    : config_(config),
      map_(map),
      meter_(meter),
      pyramid_storage_(arena, config.camera.width, config.camera.height, 1),
      full_frame_rotation_(arena, config.camera),
      initialiser_(arena, config, meter),
      candidates_(arena, config.max_map_points),
      selected_(arena, config.max_measured_points),
      pose_points_(arena, config.max_measured_points),
      pose_indices_(arena, config.max_measured_points),
      observed_(arena, config.max_measured_points + config.max_partial_searches) {
  const int width = config.camera.width, height = config.camera.height;
  grey_storage_ = {arena.allocate_array<uint8_t>(static_cast<size_t>(width) * height), width, height, width};
  const int small_width = width >> (kPyramidLevels - 1), small_height = height >> (kPyramidLevels - 1);
  for (GreyImage* small : {&small_, &small_previous_})
    *small = {arena.allocate_array<uint8_t>(static_cast<size_t>(small_width) * small_height), small_width, small_height,
              small_width};
}

void Tracker::tap() {
  reset();
  tap_pending_ = true;
  hint_ = Hint::kNone;
}

void Tracker::reset() {
  map_.clear();
  initialiser_.reset();
  state_ = TrackingState::kWaiting;
  hint_ = config_.auto_start ? Hint::kHoldStill : Hint::kTap;
  steady_s_ = 0;
  tap_pending_ = false;
  velocity_.setZero();
  bad_frames_ = good_frames_ = confirm_ = 0;
}

void Tracker::begin_lost() {
  state_ = TrackingState::kLost;
  hint_ = Hint::kReturnToKnownView;
  relocalise_attempt_ = 0;
  next_partial_ = 0;
  last_keyframe_ns_ = INT64_MIN;  // the map's timestamps are another recording's
}

void Tracker::mark_stage(Stage stage, TrackResult* result) {
  if (!clock_) return;
  const int64_t now_ns = clock_->now_ns();
  result->stage_ns[static_cast<int>(stage)] += now_ns - stage_start_ns_;
  stage_start_ns_ = now_ns;
}

void Tracker::prepare_frame(const Frame& frame) {
  const GreyView grey = to_grey(frame, grey_storage_);
  if (grey.data == grey_storage_.data)
    meter_.charge(Work::kGreyPixel, static_cast<int64_t>(frame.width) * frame.height);
  pyramid_ = build_pyramid(grey, pyramid_storage_);
  meter_.charge(Work::kPyramidPixel, static_cast<int64_t>(frame.width) * frame.height / 3);
  std::swap(small_, small_previous_);
  make_small_image(pyramid_, small_);
}

TrackResult Tracker::track(const Frame& frame, const Clock* clock) {
  TrackResult result;
  result.timestamp_ns = frame.timestamp_ns;
  clock_ = clock;
  if (clock_) stage_start_ns_ = clock_->now_ns();
  const float dt_s = have_previous_ ? elapsed_s(timestamp_ns_, frame.timestamp_ns) : 1.0f / 15.0f;
  timestamp_ns_ = frame.timestamp_ns;
  gap_ = dt_s > kLongestGap_s;
  if (gap_) velocity_.setZero();
  observed_.clear();

  prepare_frame(frame);
  mark_stage(Stage::kPyramid, &result);

  // The mapper may have changed the world's coordinates, or given the map up.
  if (state_ != TrackingState::kWaiting && !initialiser_.active() && !map_.exists()) {
    state_ = TrackingState::kWaiting;
    hint_ = Hint::kStartLost;
    good_frames_ = 0;
  }
  follow_map();
  predict(dt_s);
  mark_stage(Stage::kRotation, &result);

  if (map_.exists() && state_ == TrackingState::kLost) {
    relocalise(&result);
  } else if (map_.exists()) {
    track_with_map(dt_s, &result);
  } else {
    track_initialiser(dt_s, &result);
    mark_stage(Stage::kInitialise, &result);
  }
  have_previous_ = true;

  result.state = state_;
  result.hint = hint_;
  result.limits_hit |= map_.limits_hit;
  result.keyframes = std::min(map_.live_count(), config_.max_keyframes);  // one more while culling decides
  result.erased_keyframes = map_.erased_count();
  result.map_points = map_.point_count();
  if (result.points.empty()) result.points = observed_;
  return result;
}

void Tracker::follow_map() {
  Similarity S;
  if (!map_.take_transform(&S)) return;
  T_cw_ = T_cw_ * S.T.inverse();
  T_cw_.t *= S.scale;
  T_shown_ = T_cw_;
  velocity_.head<3>() *= S.scale;
  last_motion_.head<3>() *= S.scale;
  velocity_now_.head<3>() *= S.scale;
  mean_depth_ *= S.scale;
}

// Full-frame rotation, and from it and the motion model the pose, the velocity and the blur of this frame.
void Tracker::predict(float dt_s) {
  const bool with_map = map_.exists() && state_ != TrackingState::kLost;
  const SE3 motion = with_map ? SE3::exp(velocity_ * dt_s) : SE3();
  R_cp_.setIdentity();
  rotation_ok_ = false;
  if (have_previous_) {
    // The map's translation first, so that only the rotation is left to see (algorithms: the narrow view's pitfall).
    const RotationEstimate rotation = full_frame_rotation_.estimate(
        small_previous_, small_, motion.R, with_map ? Vector3f(motion.t / mean_depth_) : Vector3f::Zero());
    meter_.charge(Work::kRotationPixel, static_cast<int64_t>(rotation.iterations) * small_.width * small_.height);
    rotation_ok_ = rotation.ok;
    R_cp_ = rotation.ok ? rotation.R_cp : motion.R;
  }
  const Vector3f turn = so3_log(R_cp_) / dt_s;
  unrest_sq_ += kUnrestBlend * ((turn - last_turn_).squaredNorm() / 3 - unrest_sq_);
  last_turn_ = turn;
  T_predicted_ = SE3(R_cp_, motion.t) * T_cw_;
  T_predicted_.R = orthonormalised(T_predicted_.R);
  frame_interval_s_ = dt_s;
  prior_ = velocity_prior(T_predicted_);
  const Vector3f omega = prior_.mean.tail<3>();
  const Vector3f v = with_map ? Vector3f(velocity_.head<3>() / mean_depth_) : Vector3f::Zero();
  const float speed = std::sqrt((omega.y() + v.x()) * (omega.y() + v.x()) + (v.y() - omega.x()) * (v.y() - omega.x()));
  blur_px_ = speed * config_.camera.fx * config_.exposure_s;
}

// What the last pose says of the velocity at this frame's timestamp, if the pose is T_cw: the mean since then. Without
// a believed last pose the rotation seen by the full frame.
VelocityPrior Tracker::velocity_prior(const SE3& T_cw) const {
  VelocityPrior prior;
  prior.sigma_rotation = std::clamp(kUnrestShare * std::sqrt(unrest_sq_), kVelocitySigmaRotation, kMaxSigmaRotation);
  prior.sigma_translation = prior.sigma_rotation * (kVelocitySigmaTranslation / kVelocitySigmaRotation) * mean_depth_;
  if (good_frames_ < 1) {
    prior.mean.head<3>() = velocity_.head<3>();
    prior.mean.tail<3>() = so3_log(R_cp_) / frame_interval_s_;
    return prior;
  }
  prior.mean = (T_cw * T_cw_.inverse()).log() / frame_interval_s_;
  prior.rate_per_s = 1 / frame_interval_s_;
  return prior;
}

// A tap, or by itself after a moment of rest.
bool Tracker::wants_start(float dt_s) {
  if (tap_pending_) return true;
  if (!config_.auto_start) return false;
  steady_s_ = rotation_ok_ && prior_.mean.tail<3>().norm() < kSteadySpeed ? steady_s_ + dt_s : 0;
  if (steady_s_ >= kSteadyTime_s) return true;
  if (have_previous_ && !rotation_ok_) {
    hint_ = Hint::kTooLittleTexture;       // not even the smallest image can be followed
  } else if (hint_ != Hint::kStartLost) {  // bad news stays until the next start
    hint_ = Hint::kHoldStill;
  }
  return false;
}

void Tracker::track_initialiser(float dt_s, TrackResult* result) {
  if (!initialiser_.active()) {
    if (!wants_start(dt_s)) return;
    hint_ = initialiser_.start(pyramid_, small_, timestamp_ns_, prior_.mean.tail<3>());
    if (hint_ != Hint::kNone) return;  // the tap stays pending until the view is suitable
    tap_pending_ = false;
    steady_s_ = 0;
    state_ = TrackingState::kInitialising;
    hint_ = Hint::kMoveSideways;
    return;
  }
  if (gap_) {  // too long to predict where the points are
    initialiser_.reset();
    state_ = TrackingState::kWaiting;
    hint_ = Hint::kStartLost;
    return;
  }
  const MapInitialiser::Progress progress = initialiser_.track(pyramid_, small_, timestamp_ns_, R_cp_);
  result->progress = initialiser_.progress();
  result->points = initialiser_.observed();
  result->points_attempted = initialiser_.attempted();
  result->points_found = initialiser_.found();
  hint_ = initialiser_.hint();
  if (progress == MapInitialiser::Progress::kLost) {
    state_ = TrackingState::kWaiting;
  } else if (progress == MapInitialiser::Progress::kDone) {
    const bool built = initialiser_.build(map_, &T_cw_, &velocity_);
    initialiser_.reset();
    if (!built) {
      state_ = TrackingState::kWaiting;
      hint_ = Hint::kStartLost;
      return;
    }
    mean_depth_ = map_.keyframes[0].mean_depth;
    last_keyframe_ns_ = timestamp_ns_;
    bad_frames_ = 0;
    good_frames_ = 1;
    result->progress = 1;
  }
}

// Which points to measure: expected to be visible, spread over the image, reliable ones first, always the same ones in
// the same view (a changing choice makes the pose jitter). The best of every cell, then the second best of every cell,
// and so on.
void Tracker::select_points(const SE3& T_cw) {
  candidates_.clear();
  selected_.clear();
  int projected = 0;
  const Vector3f centre = T_cw.centre();
  constexpr int kCachedCentres = 96;
  Vector3f source_centre[kCachedCentres];
  const int cached = std::min(map_.keyframes.size(), kCachedCentres);
  for (int k = 0; k < cached; ++k) source_centre[k] = map_.keyframes[k].T_kw.centre();
  for (int i = 0; i < map_.points.size(); ++i) {
    const MapPoint& point = map_.points[i];
    if (point.id == 0) continue;
    ++projected;
    Vector2f px;
    if (!config_.camera.project(T_cw * point.p_w, &px) || !inside(config_.camera, px)) continue;
    const int k = point.source.keyframe;
    const Vector3f from_source = point.p_w - (k < cached ? source_centre[k] : map_.keyframes[k].T_kw.centre());
    const Vector3f from_here = point.p_w - centre;
    const float source_sq = from_source.squaredNorm(), here_sq = from_here.squaredNorm();
    if (here_sq < kMinScale * kMinScale * source_sq || here_sq > kMaxScale * kMaxScale * source_sq) continue;
    const float dot = from_source.dot(from_here);
    if (dot < 0 || dot * dot < kMinCosView * kMinCosView * source_sq * here_sq) continue;
    Candidate candidate;
    candidate.point = i;
    const int cx = std::clamp(static_cast<int>(px.x()) * kCellsX / config_.camera.width, 0, kCellsX - 1);
    const int cy = std::clamp(static_cast<int>(px.y()) * kCellsY / config_.camera.height, 0, kCellsY - 1);
    candidate.cell = static_cast<int16_t>(cy * kCellsX + cx);
    const float reliability = (static_cast<float>(point.found) + 2.0f) / (static_cast<float>(point.attempts) + 3.0f);
    candidate.score = reliability * (1.0f + 0.1f * static_cast<float>(std::min(point.measurements.size(), 6)));
    candidates_.push_back(candidate);
  }
  meter_.charge(Work::kPointProjected, projected);
  const auto better = [this](int a, int b) {  // ties by the older point
    const Candidate &x = candidates_[a], &y = candidates_[b];
    if (x.score != y.score) return x.score > y.score;
    return map_.points[x.point].id < map_.points[y.point].id;
  };
  for (;;) {
    int best[kCellsX * kCellsY];
    std::fill(std::begin(best), std::end(best), -1);
    for (int i = 0; i < candidates_.size(); ++i) {
      const Candidate& candidate = candidates_[i];
      if (candidate.taken) continue;
      int& rival = best[candidate.cell];
      if (rival < 0 || better(i, rival)) rival = i;
    }
    const auto end = std::remove(std::begin(best), std::end(best), -1);
    if (end == std::begin(best)) return;
    std::sort(std::begin(best), end, better);
    for (const int* i = std::begin(best); i != end; ++i) {
      if (!selected_.push_back(candidates_[*i].point)) return;
      candidates_[*i].taken = true;
    }
  }
}

Tracker::MapTracking Tracker::search_and_update(const SE3& T_start, const VelocityPrior& prior, int level,
                                                float radius_px) {
  MapTracking tracking;
  tracking.visible = candidates_.size();
  pose_points_.clear();
  pose_indices_.clear();
  observed_.clear();
  SearchOptions options;
  options.level = level;
  options.radius_px = radius_px;
  for (const int index : selected_) {
    const MapPoint& point = map_.points[index];
    Vector2f predicted;
    SE3 T_line;
    if (!project_rolling(config_.camera, config_.shutter, T_start, prior.mean, point.p_w, &predicted, &T_line) ||
        !inside(config_.camera, predicted))
      continue;
    FoundPatch found;
    const SearchOutcome outcome =
        find_point(map_, config_.camera, point.source, point.p_w, T_line, pyramid_, predicted, options, meter_, &found);
    if (outcome == SearchOutcome::kNotVisible) continue;
    ++tracking.attempted;
    ObservedPoint observed;
    observed.point_id = point.id;
    observed.predicted_px = observed.px = predicted;
    observed.level = static_cast<uint8_t>(level);
    if (outcome == SearchOutcome::kFound) {
      ++tracking.found;
      PosePoint pose_point;
      pose_point.p_w = point.p_w;
      pose_point.px = found.px;
      pose_point.sigma = found.sigma;
      pose_points_.push_back(pose_point);
      observed.px = found.px;
      observed.kind = ObservedKind::kOutlier;
    }
    pose_indices_.push_back(index);
    observed_.push_back(observed);
  }
  tracking.pose = update_pose(config_.camera, config_.shutter, T_start, prior, pose_points_, kRobustSigmaFloor, meter_);
  // Tell each observation what became of it.
  int found_index = 0;
  for (ObservedPoint& observed : observed_) {
    if (observed.kind == ObservedKind::kMissed) continue;
    if (tracking.pose.ok && pose_points_[found_index].weight > 0) observed.kind = ObservedKind::kInlier;
    ++found_index;
  }
  if (tracking.pose.ok) tracking.attempted -= excuse_hidden_points(tracking.pose.T_cw);
  if (tracking.pose.ok && tracking.attempted > 0) {
    const float fraction = static_cast<float>(tracking.pose.inliers) / static_cast<float>(tracking.attempted);
    if (fraction >= kGoodFraction && tracking.pose.inliers >= kGoodInliers) {
      tracking.quality = TrackingQuality::kGood;
    } else if (fraction >= kPoorFraction && tracking.pose.inliers >= kPoorInliers) {
      tracking.quality = TrackingQuality::kPoor;
    }
  }
  return tracking;
}

float Tracker::reprojection_px() const {
  float sum = 0;
  int count = 0;
  for (const PosePoint& point : pose_points_) {
    if (point.weight == 0) continue;
    sum += point.error_sq * point.sigma * point.sigma;
    ++count;
  }
  return count > 0 ? std::sqrt(0.5f * sum / static_cast<float>(count)) : 0.0f;
}

// A missed point whose neighbour in the image is seen much nearer is probably behind it, and was not to be expected.
// Returns how many.
int Tracker::excuse_hidden_points(const SE3& T_cw) {
  const auto depth = [&](int i) { return T_cw.R.row(2).dot(map_.points[pose_indices_[i]].p_w) + T_cw.t.z(); };
  int hidden = 0;
  for (int i = 0; i < observed_.size(); ++i) {
    if (observed_[i].kind != ObservedKind::kMissed) continue;
    const float nearer = kHidingDepth * depth(i);
    for (int j = 0; j < observed_.size(); ++j) {
      if (observed_[j].kind != ObservedKind::kInlier || depth(j) > nearer ||
          (observed_[j].px - observed_[i].predicted_px).squaredNorm() > kNeighbour_px * kNeighbour_px)
        continue;
      observed_[i].kind = ObservedKind::kHidden;
      ++hidden;
      break;
    }
  }
  return hidden;
}

Tracker::MapTracking Tracker::track_map(const SE3& T_predicted, const VelocityPrior& prior, SearchMode mode) {
  SE3 T_start = T_predicted;
  VelocityPrior velocity = prior;
  select_points(T_start);
  if (mode == SearchMode::kWide) {
    // Coarse to fine: a wide circle costs little in L2 and is less ambiguous than in L1.
    const MapTracking coarse = search_and_update(T_start, velocity, 2, 7.0f);
    if (coarse.pose.ok && coarse.quality != TrackingQuality::kBad) {
      T_start = coarse.pose.T_cw;
      velocity = velocity_prior(T_start);
      select_points(T_start);
    }
  }
  return search_and_update(T_start, velocity, mode == SearchMode::kBlurred ? 2 : 1, 4.0f);
}

void Tracker::track_with_map(float dt_s, TrackResult* result) {
  const bool blurred = blur_px_ > kBlurLimit_px;
  const SearchMode mode = blurred ? SearchMode::kBlurred : bad_frames_ > 0 ? SearchMode::kWide : SearchMode::kNormal;
  MapTracking tracking = track_map(T_predicted_, prior_, mode);
  if (mode == SearchMode::kNormal && tracking.quality == TrackingQuality::kBad)
    tracking = track_map(T_predicted_, prior_, SearchMode::kWide);
  mark_stage(Stage::kSearch, result);

  result->quality = tracking.quality;
  result->blurred = blurred;
  result->points_attempted = tracking.attempted;
  result->points_found = tracking.found;
  result->points_inliers = tracking.pose.inliers;
  result->reprojection_px = reprojection_px();
  if (tracking.visible > selected_.capacity()) result->limits_hit |= kLimitMeasuredPoints;

  const bool confirming = confirm_ > 0;
  if (tracking.quality == TrackingQuality::kBad || (confirming && tracking.quality != TrackingQuality::kGood)) {
    if (map_.held) release_keyframe(nullptr, dt_s);
    T_cw_ = T_predicted_;
    velocity_ *= std::max(0.0f, 1.0f - 3.0f * dt_s);
    good_frames_ = 0;
    ++bad_frames_;
    if (confirming || bad_frames_ >= kBadFramesUntilLost) {
      confirm_ = 0;
      relocalise_attempt_ = 0;
      if (map_.ready) {
        state_ = TrackingState::kLost;
        hint_ = Hint::kReturnToKnownView;
      } else {
        map_.clear();
        state_ = TrackingState::kWaiting;
        hint_ = Hint::kStartLost;
      }
    }
    return;
  }

  accept(tracking.pose, dt_s);
  if (confirming && ++confirm_ < kFramesToConfirm) return;
  confirm_ = 0;
  result->covariance = tracking.pose.covariance;
  result->T_cw = shown_pose(tracking.pose);
  if (map_.ready) {
    state_ = TrackingState::kTracking;
    hint_ = Hint::kNone;
    result->pose_valid = true;
  } else {
    state_ = TrackingState::kInitialising;
    result->progress = 1;
  }
  // Search statistics, from frames that deserve it.
  if (tracking.quality == TrackingQuality::kGood && !blurred) {
    for (int i = 0; i < observed_.size(); ++i) {
      if (observed_[i].kind == ObservedKind::kHidden) continue;
      map_.points[pose_indices_[i]].count_search(observed_[i].kind == ObservedKind::kInlier);
    }
    mark_stage(Stage::kPose, result);
    if (map_.ready && !map_.locked) {
      update_partial_points(result);
      mark_stage(Stage::kPartial, result);
      if (wants_keyframe(tracking)) {
        hold_keyframe();
        result->keyframe_added = true;
        mark_stage(Stage::kKeyframe, result);
      }
    }
  }
}

// The measured pose, damped while the full frame says that the camera stands still. The differences to what is shown
// are averaged; noise averages out, a movement adds up. Below the noise of such a mean (chi-squared over six degrees of
// freedom of one) the shown pose follows slowly, at a few times it at once.
SE3 Tracker::shown_pose(const PoseUpdate& pose) {
  // One frame that seems to turn is noise, unless the pose says so too.
  const bool turning = !rotation_ok_ || so3_log(R_cp_).norm() > kStillTurn_rad;
  turning_frames_ = turning ? std::min(turning_frames_ + 1, 2) : 0;
  if (!config_.steady_damping || good_frames_ <= 2 || turning_frames_ == 2) {
    T_shown_ = pose.T_cw;
    difference_.setZero();
    return T_shown_;
  }
  const Vector6f difference = (pose.T_cw * T_shown_.inverse()).log();
  difference_ += kDifferenceBlend * (difference - difference_);
  // The covariance counts all that the map does not explain; from frame to frame only the patches' noise changes.
  const float noise = kPatchNoise / pose.sigma;
  const Matrix6f covariance = pose.covariance * (noise * noise * kDifferenceBlend / (2 - kDifferenceBlend));
  // Scaled to a unit diagonal: float32 would not bear metres beside radians.
  const Vector6f unit = covariance.diagonal().cwiseSqrt().cwiseInverse();
  const Matrix6f scaled = unit.asDiagonal() * covariance * unit.asDiagonal();
  const Vector6f x = unit.cwiseProduct(difference_);
  const float chi_sq = x.dot(scaled.ldlt().solve(x)) / 6;
  const float gain = chi_sq >= 0 ? std::clamp((chi_sq - 1) / 3, kSlowestGain, 1.0f) : 1.0f;
  T_shown_ = SE3::exp(gain * difference) * T_shown_;
  T_shown_.R = orthonormalised(T_shown_.R);
  return T_shown_;
}

void Tracker::accept(const PoseUpdate& pose, float dt_s) {
  const SE3 motion = pose.T_cw * T_cw_.inverse();
  Vector6f measured = motion.log() / dt_s;
  if (bad_frames_ > 0 || good_frames_ == 0) measured.head<3>().setZero();  // the last pose was a guess
  if (map_.held) release_keyframe(&measured, dt_s);
  last_motion_ = measured;
  last_interval_s_ = dt_s;
  const float decay = det_exp(-kVelocityDecayRate * dt_s);
  velocity_ = decay * (kVelocityBlend * measured + (1 - kVelocityBlend) * velocity_);
  T_cw_ = pose.T_cw;
  velocity_now_ = pose.velocity;
  bad_frames_ = 0;
  ++good_frames_;
  float depth_sum = 0;
  int count = 0;
  for (const PosePoint& point : pose_points_) {
    if (point.weight == 0) continue;
    depth_sum += (T_cw_ * point.p_w).z();
    ++count;
  }
  if (count > 0) mean_depth_ = depth_sum / static_cast<float>(count);
}

void Tracker::relocalise(TrackResult* result) {
  velocity_.setZero();
  const RelocalisationCandidate candidate =
      propose_pose(map_, full_frame_rotation_, small_, relocalise_attempt_++, meter_);
  mark_stage(Stage::kInitialise, result);
  if (candidate.keyframe < 0) return;
  mean_depth_ = map_.keyframes[candidate.keyframe].mean_depth;
  good_frames_ = 0;
  const VelocityPrior prior = velocity_prior(candidate.T_cw);
  const MapTracking tracking = track_map(candidate.T_cw, prior, SearchMode::kWide);
  mark_stage(Stage::kSearch, result);
  result->points_attempted = tracking.attempted;
  result->points_found = tracking.found;
  result->points_inliers = tracking.pose.inliers;
  if (tracking.quality != TrackingQuality::kGood) return;
  // Still kLost in the result: the next frame has to confirm it.
  bad_frames_ = 0;
  accept(tracking.pose, 1.0f);
  velocity_.setZero();
  confirm_ = 1;
  state_ = TrackingState::kTracking;
  result->pose_valid = false;
}

// Depth of a few partial points along their epipolar lines [phone 5.2].
void Tracker::update_partial_points(TrackResult* result) {
  const int slots = map_.partial_points.size();
  if (slots == 0) return;
  const float mean_q = 1.0f / mean_depth_;
  SearchOptions options;
  for (int step = 0; step < slots && result->partial_attempted < config_.max_partial_searches; ++step) {
    const int slot = next_partial_;
    next_partial_ = (next_partial_ + 1) % slots;
    PartialPoint& partial = map_.partial_points[slot];
    if (partial.id == 0) continue;
    const Keyframe& keyframe = map_.keyframes[partial.source.keyframe];
    const SE3 T_wk = keyframe.T_kw.inverse();
    const float sigma = partial.information > 0 ? 1.0f / std::sqrt(partial.information) : 1e9f;
    const float q_near = std::min(partial.inverse_depth + 2 * sigma, kInverseDepthRange * mean_q);
    const float q_far = std::max(partial.inverse_depth - 2 * sigma, mean_q / kInverseDepthRange);
    if (!(q_near >= q_far)) {
      partial = PartialPoint();  // its depth has left the scene's range
      continue;
    }
    const auto project_at = [&](float q, Vector2f* px, SE3* T_line) {
      return project_rolling(config_.camera, config_.shutter, T_cw_, velocity_now_, T_wk * Vector3f(partial.ray / q),
                             px, T_line);
    };
    Vector2f px, px_near, px_far;
    SE3 T_line, T_unused;
    const float q = std::clamp(partial.inverse_depth, q_far, q_near);
    if (!project_at(q, &px, &T_line) || !project_at(q_near, &px_near, &T_unused) ||
        !project_at(q_far, &px_far, &T_unused) || !inside(config_.camera, px))
      continue;
    // d(px)/dq along the epipolar line, from the ends of the range.
    const Vector2f J = (px_near - px_far) / std::max(q_near - q_far, 1e-6f * mean_q);
    const float half_length_l1 = 0.25f * (px_near - px_far).norm();
    options.radius_px = std::clamp(half_length_l1 + 2.0f, 3.0f, 8.0f);
    FoundPatch found;
    const SearchOutcome outcome = find_point(map_, config_.camera, partial.source, T_wk * Vector3f(partial.ray / q),
                                             T_line, pyramid_, px, options, meter_, &found);
    if (outcome == SearchOutcome::kNotVisible) continue;
    ++result->partial_attempted;
    ++partial.attempts;
    if (outcome == SearchOutcome::kFound) {
      const Vector2f e = found.px - px;
      const float J_sq = J.squaredNorm();
      // Off the epipolar line by more than the pose explains: another patch.
      const float across = J_sq > 1e-12f ? std::abs(e.x() * J.y() - e.y() * J.x()) / std::sqrt(J_sq) : e.norm();
      if (across < 3.0f) {
        ++partial.found;
        ++result->partial_found;
        const float variance = found.sigma * found.sigma;
        partial.information += J_sq / variance;
        if (partial.information > 0) {
          const float gain = 1.0f / (variance * partial.information);
          partial.inverse_depth = std::clamp(q + gain * J.dot(e), q_far, q_near);
        }
        ObservedPoint observed;
        observed.px = found.px;
        observed.predicted_px = px;
        observed.point_id = partial.id;
        observed.kind = ObservedKind::kPartial;
        observed_.push_back(observed);
      }
    }
    if (partial.attempts - partial.found > kMaxPartialFailures && partial.found * 2 < partial.attempts)
      partial = PartialPoint();
  }
}

bool Tracker::wants_keyframe(const MapTracking& tracking) const {
  if (map_.held || map_.queued >= map_.queue.size()) return false;
  const bool full = map_.limits_hit & kLimitKeyframes;
  const float interval_s =
      full ? std::max(kFullInterval_s, config_.min_keyframe_interval_s) : config_.min_keyframe_interval_s;
  if (elapsed_s(last_keyframe_ns_, timestamp_ns_) < interval_s) return false;
  if (good_frames_ < 2) return false;
  const Vector3f centre = T_cw_.centre();
  const Vector3f axis = T_cw_.R.row(2).transpose();
  // The nearest keyframe that looks the same way.
  float nearest_alike = 1e9f;
  const auto consider = [&](const SE3& T_kw) {
    const float distance = (T_kw.centre() - centre).norm();
    if (axis.dot(T_kw.R.row(2).transpose()) > kKeyframeCosTurn) nearest_alike = std::min(nearest_alike, distance);
  };
  for (const Keyframe& keyframe : map_.keyframes)
    if (keyframe.id != 0) consider(keyframe.T_kw);  // erased ones too: a second one there would go the same way
  for (int i = 0; i < map_.queued; ++i) consider(map_.queue[i].frame.T_kw);
  const bool sparse =
      static_cast<float>(tracking.visible) < kSparseViewFraction * static_cast<float>(selected_.capacity());
  const float fill = static_cast<float>(map_.live_count()) / static_cast<float>(config_.max_keyframes);
  const float far = kKeyframeDistanceNew + (kKeyframeDistanceFull - kKeyframeDistanceNew) * fill;
  if (nearest_alike > far * mean_depth_) return true;
  return sparse && nearest_alike > kKeyframeMinDistance * mean_depth_;
}

void Tracker::hold_keyframe() {
  KeyframeCandidate& candidate = map_.queue[map_.queued];
  map_.held = true;
  Keyframe& frame = candidate.frame;
  frame.timestamp_ns = timestamp_ns_;
  frame.T_kw = T_cw_;
  frame.velocity = velocity_now_;
  frame.velocity_prior = last_motion_;  // until the next frame tells more
  frame.mean_depth = mean_depth_;
  frame.pyramid = copy_pyramid(pyramid_, frame.storage);
  for (int y = 0; y < small_.height; ++y) std::copy_n(small_.row(y), small_.width, frame.small.row(y));
  meter_.charge(Work::kKeyframePixel, static_cast<int64_t>(config_.camera.width) * config_.camera.height * 4 / 3);
  candidate.measurements.clear();
  for (int i = 0; i < pose_indices_.size(); ++i) {
    if (observed_[i].kind != ObservedKind::kInlier) continue;
    KeyframeMeasurement measurement;
    measurement.point = pose_indices_[i];
    measurement.point_id = map_.points[pose_indices_[i]].id;
    measurement.px = observed_[i].px;
    measurement.sigma = static_cast<float>(1 << observed_[i].level);
    candidate.measurements.push_back(measurement);
  }
  last_keyframe_ns_ = timestamp_ns_;
}

// Into the queue. Its velocity was expected from the past; from the motion to the next frame, if that is known, the
// central difference is: the mean of both sides' velocities, the nearer one's counting more.
void Tracker::release_keyframe(const Vector6f* motion_since, float dt_s) {
  if (motion_since && good_frames_ >= 2) {
    Keyframe& frame = map_.queue[map_.queued].frame;
    frame.velocity_prior = (dt_s * last_motion_ + last_interval_s_ * *motion_since) / (dt_s + last_interval_s_);
  }
  ++map_.queued;
  map_.held = false;
}

}  // namespace pptam
