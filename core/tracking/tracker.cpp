#include "tracking/tracker.h"

#include <algorithm>
#include <iterator>

#include "tracking/relocaliser.h"

namespace pptam {

namespace {

// Bad frames in a row after which the camera is lost: the motion model bridges fewer [ptam 5.6, "a few"]. Not swept.
constexpr int kBadFramesUntilLost = 3;
// Good frames in a row, the first included and the last one sharp, that confirm a pose of the relocaliser before it is
// reported. Fewer accept wrong poses, which corrupt the map. Not swept.
constexpr int kFramesToConfirm = 2;

// Seconds for which the camera is lost before a new map begins (Config::auto_start): a view that the map knows is found
// again within one (tests/MEASURED.md). Not swept.
constexpr float kNewMapAfter_s = 3.0f;
// Frames between two looks at a map that is set aside: each costs up to as much as a tracked frame. In three of four
// frames a start has the time for itself. Not swept.
constexpr int kLookIntervalTracking = 8, kLookIntervalWithout = 4;

// Interval, s, given to the motion model for a relocalised pose: the time since the last pose means nothing, and a long
// interval makes the motion between the two slow. Not swept.
constexpr float kRelocalisedInterval_s = 1.0f;

// Map points alone give the pose, and partial points do not take part, from so many inliers on, and where these give
// the position within so many mean depths (1-sigma; in the middle of a map it is 0.003). Pans on the spot over new
// scenery, eight emulated runs: with inliers alone the position is off by up to 2.3 % of the depth, 7 % while the
// constants of the pose's prior were varied; with 0.004 to 0.006 by 1.2 %. With 0.005 and less they take part in so
// many frames that an emulated camera's quick small step is followed late.
constexpr int kEnoughInliers = 30;
constexpr float kEnoughPositionSigma = 0.006f;
// Inliers that will still be in view in half a second, from which on the map takes nothing from a misfit: it serves
// without. Quick motion bends a map so that frames do not fit it, just where it has to grow. Of eleven emulated quick
// explorations two lose a third of their frames and more where 32 inliers in view now are enough to refuse, and one
// with 20 that stay; with 32 that stay a shifted stretch of one wall (of four) bends the map by a third of its extent,
// with 20 by 3 %.
constexpr int kEnoughToRefuse = 20;
// Image motion within the exposure, level-0 px, above which points are searched in the coarse level, and the map takes
// nothing: templates are blurred by as much in level 1 as can still be told apart, most of their width. With 6 in place
// of 12, and sharp templates, two emulated dim rooms cost 2 and 5 times the error (1.07 in place of 0.19 % in one).
constexpr float kCoarseBlur_px = 12.0f;
// ARMv6, of one slot of map points, estimates: to set a map aside, and to drop a keyframe.
constexpr int64_t kSetAsideInstructions = 100, kDropInstructions = 50;
constexpr int64_t kCountSlotInstructions = 5;  // likewise, for TrackResult::map_points, as counted
// Error of the pose in the image, pixels of the level searched, where map points gave it, and where it is predicted.
// Not swept.
constexpr float kPlacedMargin_px = 2.0f, kPredictedMargin_px = 4.0f;

}  // namespace

Tracker::Tracker(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Initialiser* initialiser)
    : config_(config),
      map_(map),
      meter_(meter),
      frame_(arena, config.camera.model, meter),
      full_frame_rotation_(arena, config.camera),
      matching_(arena, config, map, meter, stages_),
      depth_filter_(arena, config, map, meter),
      keyframe_policy_(config, map, meter),
      initialiser_(initialiser),
      start_trigger_(config),
      observed_(arena, config.max_measured_points + config.max_partial_searches) {}

void Tracker::tap() {
  reset();
  start_trigger_.tap();
  hint_ = Hint::kNone;
}

void Tracker::reset() {
  map_.clear_all();
  initialiser_->reset();
  state_ = TrackingState::kWaiting;
  hint_ = config_.auto_start ? Hint::kHoldStill : Hint::kTap;
  start_trigger_.reset();
  motion_.forget();
  matching_.restart();
  frame_fit_.forget();
  last_ = TrackResult();
  confirmed_ = 0;
  frames_until_look_ = look_place_ = 0;
  std::fill(std::begin(look_attempts_), std::end(look_attempts_), 0);
}

void Tracker::begin_lost() {
  state_ = TrackingState::kLost;
  hint_ = Hint::kReturnToKnownView;
  relocalise_attempt_ = 0;
  lost_s_ = 0;
  depth_filter_.restart();
  keyframe_policy_.forget_time();  // the map's timestamps are those of another recording
}

bool Tracker::last_pose(const Vector2f& px, SE3* T_cw) const {
  if (!last_.pose_valid || map_.looking()) return false;
  const float dt_s = px.allFinite() ? config_.camera.dt_s(px) : 0;
  *T_cw = pose_at(last_.T_cw, last_.velocity, dt_s);
  return true;
}

void Tracker::follow_map() {
  Similarity S;
  if (!map_.take_transform(&S)) return;
  motion_.apply(S);
  last_.T_cw = S.moved(last_.T_cw);
  last_.velocity.head<3>() *= S.scale;
  still_camera_.apply(motion_.T_cw());
}

TrackResult Tracker::track(const Frame& frame, const Clock* clock, Tracer* tracer) {
  TrackResult result;
  result.timestamp_ns = frame.timestamp_ns;
  stages_.begin(clock, tracer);
  // Where there is no pose a repeated picture is tried again: a start or the relocaliser may have more luck with it.
  if (!frame_.take(frame, last_.pose_valid)) {
    stages_.end(&result);
    return repeated(result);
  }
  observed_.clear();
  matching_.forget();
  if (frame_.dt_s() > kMaxGap_s) motion_.stop();

  // The mapper may have changed the world's coordinates, or discarded the map.
  if (state_ != TrackingState::kWaiting && !initialiser_->active() && !map_.exists()) {
    state_ = TrackingState::kWaiting;
    hint_ = Hint::kStartLost;
    motion_.lose();
  }
  follow_map();
  stages_.enter(Stage::kRotation);
  predict();

  if (map_.exists() && state_ == TrackingState::kLost) {
    relocalise(&result);
    begin_anew_if_lost_long();
  } else if (map_.exists()) {
    track_with_map(&result);
  } else {
    stages_.enter(Stage::kInitialise);
    track_initialiser(&result);
  }
  result.map = static_cast<int>(map_.number());
  if (map_.aside_count() > 0) look_aside();

  result.state = state_;
  result.hint = hint_;
  result.limits_hit |= map_.limits_hit();
  result.maps = map_.aside_count() + (map_.ready() ? 1 : 0);
  result.keyframes = std::min(map_.live_count(), map_.max_live());  // the map has one more while culling decides
  result.erased_keyframes = map_.erased_count();
  result.map_points = map_.point_count();
  meter_.charge(Work::kOther, kCountSlotInstructions * map_.points().size());
  if (result.points.empty()) result.points = observed_;
  stages_.end(&result);
  last_ = result;
  return result;
}

// The last picture once more, as from a recorder that stalls or at a lower rate than its times say: it has the last
// picture's pose, and the motion model learns nothing from it.
TrackResult Tracker::repeated(const TrackResult& taken) {
  follow_map();
  TrackResult result = last_;
  result.timestamp_ns = taken.timestamp_ns;
  std::copy_n(taken.stage_ns, kStages, result.stage_ns);
  result.state = state_;
  result.hint = hint_;
  result.repeated = true;
  result.keyframe_added = false;
  return result;
}

// Predicts pose and velocity of this frame from the motion model and the full-frame rotation. The previous small image
// is first shifted by the expected translation, so that only rotation is measured: at a narrow field of view both look
// alike.
void Tracker::predict() {
  motion_.begin_frame(frame_.dt_s(), map_.exists() && state_ != TrackingState::kLost);
  if (!frame_.has_previous()) {
    motion_.turn(nullptr);
    return;
  }
  const GreyImage& small = frame_.small();
  const RotationEstimate rotation = full_frame_rotation_.estimate(
      frame_.previous_small(), small, motion_.expected_motion().R, motion_.expected_shift(), lamp_bands_.seen());
  if (rotation.near) lamp_bands_.note(rotation.line_share);
  if (lamp_bands_.seen()) frame_.set_lamp_lines(full_frame_rotation_.lines());
  meter_.charge(Work::kRotationPixel, static_cast<int64_t>(rotation.iterations) * full_frame_rotation_.pixels());
  meter_.charge(Work::kOther, kRotationStepInstructions * rotation.iterations);
  motion_.turn(&rotation);
  if (state_ != TrackingState::kLost && motion_.rotation_surprises(config_)) choose_rotation();
}

// A thing that moves through the view looks like a turn of the camera, and so may parallax. Of the predictions with and
// without the full-frame rotation, the one where more points are found.
void Tracker::choose_rotation() {
  const MotionModel turned = motion_;
  const int found_if_turned = matching_.support(frame_.pyramid(), motion_);
  motion_.disregard_rotation();
  if (matching_.support(frame_.pyramid(), motion_) <= found_if_turned) motion_ = turned;
}

void Tracker::track_with_map(TrackResult* result) {
  using Search = MapMatching::Search;
  const float blur_px = motion_.image_speed() * config_.camera.model.fx * config_.exposure_s;
  const bool blurred = blur_px > kCoarseBlur_px * config_.px_scale();
  const Search search = blurred ? Search::kBlurred : motion_.missed() > 0 ? Search::kWide : Search::kNormal;
  const bool with_partials = map_.ready() && !map_.locked() && confirmed_ == 0;
  MapMatch match = match_with_partials(search, with_partials);
  if (search == Search::kNormal && match.quality == TrackingQuality::kBad)
    match = match_with_partials(Search::kWide, with_partials);
  stages_.enter(Stage::kPose);
  matching_.report(&observed_);

  result->quality = match.quality;
  result->blurred = blurred;
  match.report(result);
  result->reprojection_px = matching_.reprojection_px();
  if (match.visible > matching_.capacity()) result->limits_hit |= kLimitMeasuredPoints;

  // Points that bad pictures have put into the map agree about a pose that they fit badly.
  const bool misfit = !blurred && !map_.looking() && !frame_fit_.is_usual(result->reprojection_px);
  const bool doubtful = match.quality != TrackingQuality::kGood || misfit;
  if (match.quality == TrackingQuality::kBad || (confirmed_ > 0 && doubtful)) {
    miss();
  } else {
    accept(match, blurred, result);
  }
}

// Map points give the pose. Partial points are searched from there, or from the prediction when there is none, as many
// as map points are lacking; where those are few the pose is found anew from both kinds.
MapMatch Tracker::match_with_partials(MapMatching::Search search, bool allowed) {
  MapMatch match = matching_.match(frame_.pyramid(), motion_, search);
  depth_filter_.forget();
  if (!allowed) return match;
  stages_.enter(Stage::kPartial);
  const bool placed = match.quality != TrackingQuality::kBad;
  DepthFilter::Start start;
  start.T_cw = placed ? match.pose.T_cw : motion_.T_predicted();
  start.velocity = placed ? match.pose.velocity : motion_.prior().mean;
  start.mean_depth = placed ? matching_.mean_depth(start.T_cw, motion_.mean_depth()) : motion_.mean_depth();
  start.margin_px = placed ? kPlacedMargin_px : kPredictedMargin_px;
  start.level = search == MapMatching::Search::kBlurred ? config_.coarse_search_level : config_.search_level;
  start.count = config_.max_partial_searches + matching_.capacity() - static_cast<int>(matching_.attempts().size());
  depth_filter_.search(frame_.pyramid(), start);
  if (match.inliers >= kEnoughInliers && match.pose.position_sigma() < kEnoughPositionSigma) return match;
  return matching_.join(depth_filter_.attempts(), motion_, start.T_cw);
}

void Tracker::miss() {
  if (map_.looking()) return leave_look();
  keyframe_policy_.release_unmeasured();
  motion_.miss();
  if (confirmed_ == 0 && motion_.missed() < kBadFramesUntilLost) return;
  if (confirmed_ == 0) lost_s_ = 0;  // a pose that was not confirmed was none
  confirmed_ = 0;
  relocalise_attempt_ = 0;
  if (map_.ready()) {
    if (state_ == TrackingState::kTracking) drop_doubted();
    state_ = TrackingState::kLost;
    hint_ = Hint::kReturnToKnownView;
  } else {
    map_.clear();
    state_ = TrackingState::kWaiting;
    hint_ = Hint::kStartLost;
  }
}

// Lost out of a misfit: the pictures were not what they seemed, as those of a stabiliser or a zoom that jumps back.
// What the map took from them would pull it, and every later pose with it.
void Tracker::drop_doubted() {
  const uint32_t id = frame_fit_.doubted_since();
  if (id == 0 || map_.locked()) return;
  meter_.charge(Work::kOther, kDropInstructions * map_.points().size() * map_.drop_keyframes_since(id));
  frame_fit_.forget();
  matching_.restart();
}

void Tracker::accept(const MapMatch& match, bool blurred, TrackResult* result) {
  motion_.believe(match.pose, frame_.dt_s(), matching_.mean_depth(match.pose.T_cw, motion_.mean_depth()));
  if (!map_.looking()) keyframe_policy_.release(motion_);  // the one that is held belongs to the other map
  if (confirmed_ > 0 && (blurred || ++confirmed_ < kFramesToConfirm)) return;
  confirmed_ = 0;
  if (map_.looking()) settle_look();
  result->covariance = match.pose.covariance;
  result->T_cw = still_camera_.show(match.pose, motion_, config_.steady_damping);
  if (map_.ready()) {
    state_ = TrackingState::kTracking;
    hint_ = Hint::kNone;
    result->velocity = match.pose.velocity;
    result->pose_valid = true;
  } else {
    state_ = TrackingState::kInitialising;
    result->progress = 1;
  }
  // The map takes nothing from blurred frames, nor from misfits while it serves without. It does from those of poor
  // quality: few points that agree constrain a pose whatever was not found, and a map that does not grow there starves.
  if (blurred) return;
  const int staying = matching_.staying(motion_);
  if (map_.ready() && match.inliers > 0) {
    const bool serves = staying >= kEnoughToRefuse;
    result->misfit = !frame_fit_.fits(result->reprojection_px, frame_.dt_s(), serves ? map_.next_id() : 0);
    if (result->misfit) result->quality = TrackingQuality::kPoor;
    if (result->misfit && serves) return;
  }
  const bool fixed = map_.ready() && map_.locked();
  if (!fixed) matching_.count_searches();
  if (!map_.ready() || fixed) return;
  stages_.enter(Stage::kPartial);
  depth_filter_.update(motion_, &observed_, result);
  stages_.enter(Stage::kKeyframe);
  if (!keyframe_policy_.wants(frame_.timestamp_ns(), motion_, staying)) return;
  keyframe_policy_.hold(frame_, motion_, matching_.attempts());
  result->keyframe_added = true;
}

void Tracker::relocalise(TrackResult* result) {
  lost_s_ += std::min(frame_.dt_s(), kMaxGap_s);  // while nothing was seen nobody looked
  find_candidate(&relocalise_attempt_, result);
}

// One attempt of the relocaliser in the map in use. True when its pose is good; then state and motion are those of a
// pose that the next frame has to confirm, and none is reported yet. result: null in a map that is only looked at.
bool Tracker::find_candidate(int* attempt, TrackResult* result) {
  stages_.enter(Stage::kInitialise);
  motion_.stop();
  const RelocalisationCandidate candidate = propose_pose(map_, config_.camera, full_frame_rotation_, lamp_bands_.seen(),
                                                         frame_.small(), (*attempt)++, meter_);
  if (candidate.keyframe < 0) return false;
  motion_.start_guess(map_.keyframes()[candidate.keyframe].mean_depth);
  const MapMatch match = matching_.match(frame_.pyramid(), motion_, MapMatching::Search::kWide, candidate.T_cw);
  if (result != nullptr) {
    matching_.report(&observed_);
    match.report(result);
  }
  if (match.quality != TrackingQuality::kGood) return false;
  motion_.believe(match.pose, kRelocalisedInterval_s, matching_.mean_depth(match.pose.T_cw, motion_.mean_depth()));
  motion_.stop();
  confirmed_ = 1;
  state_ = TrackingState::kTracking;
  return true;
}

void Tracker::begin_anew_if_lost_long() {
  if (!config_.auto_start || !map_.can_set_aside() || map_.locked() || state_ != TrackingState::kLost ||
      lost_s_ < kNewMapAfter_s)
    return;
  map_.set_aside();
  meter_.charge(Work::kOther, kSetAsideInstructions * map_.points().size());
  matching_.restart();
  motion_.forget();
  frame_fit_.forget();
  start_trigger_.reset();
  state_ = TrackingState::kWaiting;
  hint_ = Hint::kHoldStill;
}

// Now and then the relocaliser tries one of the maps that are set aside. From a finished map only older ones are
// returned to: two that show the same scene would take turns.
void Tracker::look_aside() {
  if (map_.looking() || confirmed_ > 0 || --frames_until_look_ > 0) return;
  const bool tracking = state_ == TrackingState::kTracking;
  frames_until_look_ = tracking ? kLookIntervalTracking : kLookIntervalWithout;
  int place = -1;
  for (int i = 1; i <= map_.places() && place < 0; ++i) {
    const int next = (look_place_ + i) % map_.places();
    if (map_.is_aside(next) && (!tracking || map_.number_aside(next) < map_.number())) place = next;
  }
  if (place < 0) return;
  look_place_ = place;
  before_look_ = motion_;
  state_before_look_ = state_;
  hint_before_look_ = hint_;
  map_.exchange(place);
  if (!find_candidate(&look_attempts_[place], nullptr)) {
    map_.exchange(place);
    motion_ = before_look_;
  }
  matching_.restart();
}

// The pose that a look had found was not confirmed: all is as before, but for a frame that was missed.
void Tracker::leave_look() {
  confirmed_ = 0;
  map_.exchange(look_place_);
  matching_.restart();
  motion_ = before_look_;
  motion_.begin_frame(frame_.dt_s(), map_.exists() && state_before_look_ != TrackingState::kLost);
  motion_.turn(nullptr);
  if (state_before_look_ == TrackingState::kTracking) motion_.miss();
  state_ = state_before_look_;
  hint_ = hint_before_look_;
}

// It was confirmed.
void Tracker::settle_look() {
  map_.settle(look_place_);
  initialiser_->reset();
  start_trigger_.reset();
  frame_fit_.forget();
  depth_filter_.restart();
  keyframe_policy_.forget_time();
}

void Tracker::track_initialiser(TrackResult* result) {
  if (!initialiser_->active()) {
    if (!start_trigger_.wants_start(frame_, motion_, &hint_)) return;
    hint_ = initialiser_->start(frame_, motion_.prior().mean.tail<3>());
    if (hint_ != Hint::kNone) return;  // the tap stays pending until the view is suitable
    start_trigger_.reset();
    state_ = TrackingState::kInitialising;
    hint_ = Hint::kMoveSideways;
    return;
  }
  if (frame_.dt_s() > kMaxGap_s) {  // too long to predict where the points are
    initialiser_->reset();
    state_ = TrackingState::kWaiting;
    hint_ = Hint::kStartLost;
    return;
  }
  const Initialiser::Progress progress = initialiser_->track(frame_, motion_.R_cp());
  const Initialiser::Report& report = initialiser_->report();
  result->progress = report.progress;
  result->points = report.observed;
  result->points_attempted = report.attempted;
  result->points_found = report.found;
  hint_ = report.hint;
  if (progress == Initialiser::Progress::kLost) {
    state_ = TrackingState::kWaiting;
  } else if (progress == Initialiser::Progress::kDone) {
    SE3 T_cw;
    Vector6f velocity;
    const bool built = initialiser_->build(map_, &T_cw, &velocity);
    matching_.restart();
    initialiser_->reset();
    if (!built) {
      state_ = TrackingState::kWaiting;
      hint_ = Hint::kStartLost;
      return;
    }
    motion_.start(T_cw, velocity, map_.keyframes()[0].mean_depth);
    keyframe_policy_.made_at(frame_.timestamp_ns());
    result->progress = 1;
  }
}

}  // namespace pptam
