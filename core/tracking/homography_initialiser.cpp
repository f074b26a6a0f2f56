#include "tracking/homography_initialiser.h"

#include <algorithm>
#include <cmath>

#include "base/assert.h"
#include "geometry/robust.h"

namespace pptam {

namespace {

// Largest image motion of a first view during its readout and exposure, level-0 px. More blurs the corners. The rolling
// shutter is corrected by the full-frame rotation alone: an error of a tenth of this motion shifts one end of the
// readout against the other by half a pixel. Not swept.
constexpr float kMaxStartMotion_px = 6.5f;
// Largest apparent rotation of a first view, radians/s: decides where both times are short or unknown. Not swept.
constexpr float kMaxStartSpeed = 0.6f;
constexpr int kMaxBadFrames = 5;  // bad frames in a row that a start survives; not swept
// A measurement's noise, level-0 px, for judging how well a decomposition is constrained. Measured against the truth in
// 2200 frames of 40 emulated starts on planes: the normal's error was 0.42 (median) and 1.5 (99 %) times what sigma_n
// says for 1 px, which is 0.36 to 0.5 px for the Rayleigh distribution. Most of it is tremor within the readout.
constexpr float kDecompositionNoise_px = 0.5f;
// Standard deviation of the plane's normal, 2.6 degrees: just under the 3 degrees at which a decomposition is accepted
// (derived: 50 points, 1 px of noise, a frontal plane reach 3.1 degrees at t / d = 0.05). Not swept.
constexpr float kMaxSigmaNormal_rad = 0.045f;
constexpr float kMinBaseline = 0.03f;  // t / d, a ratio: less is hard to tell from pure rotation; not swept
// Stage 2 begins when the summed information of the frames is that of one frame in which everything is known this many
// times better than required, a ratio: a camera that keeps moving soon reaches it in one frame, and one that stops
// reaches it by waiting. Not swept.
constexpr float kRequiredMargin = 2.0f;
// Margin under which a frame adds no information, and under which stage 2 does not begin: a ratio, not swept.
constexpr float kMinMargin = 0.8f;
// Frames within this time share the hand's tremor, s: together they count as one. Not swept.
constexpr float kTremorCorrelation_s = 0.2f;
// d1 / d3 - 1 of the homography's singular values under which it is a pure rotation [phone 5.1]. Not swept.
constexpr float kPureRotationTolerance = 0.02f;
// A wrong field of view by up to this factor makes no map of turning. The larger, the more starts wait in which the
// camera moves and turns alike.
constexpr float kMaxWrongFocal = 2.2f;
// Rotation without a baseline, 8 degrees, from which on the user is told (Hint::kOnlyRotating). Not swept.
constexpr float kMaxPureTurn_rad = 0.14f;
// What counts as a plane: robust scale of the residuals, level-0 px, and share of the found points that fit. On planes
// the scale stays at its floor (0.3 px in all of 960 frames under three shutters). A homography fits the two walls of a
// corner, or a plane with a wrong calibration, within 0.4 to 1 px: above the lower bound stage 2 has to decide.
// The upper bound and the share are not swept.
constexpr float kCertainPlanarSigma_px = 0.4f;
constexpr float kMaxPlanarSigma_px = 1.2f;
constexpr float kMinPlanarShare = 0.7f;

// General motion, from the epipolar constraint.
constexpr int kRelativeSteps = 8;  // iterations of one start at most; not swept
// Points times iterations after which a frame tries no further start: about 1.2 million ARMv6 instructions, which keeps
// the counted worst frame of a start in clutter at 4.1 million (tests/budget).
constexpr int kRelativeBudget = 1200;
constexpr float kEpipolarFloor_px = 0.3f;     // smallest robust scale: start_sigma_px() * kRobustSigmaFloor, as of H
constexpr float kMaxEpipolarSigma_px = 1.2f;  // robust scale, level-0 px; not swept
constexpr float kMinEpipolarShare = 0.7f;     // inliers among the found points, a ratio; not swept
// How well the relative pose must be known: sigma of the median point's depth, relative to the depth, and of the
// translation's direction. Not swept.
constexpr float kMaxDepthSigma = 0.06f;
constexpr float kMaxDirectionSigma_rad = 0.1f;
constexpr int kPlanarStarts = 2;  // the decomposition's solutions, tried as starts too
// Directions of translation to start from, over half a sphere: the sign follows from the points' side.
constexpr int kDirectionCount = 9;
constexpr float kDirections[kDirectionCount][3] = {{1, 0, 0},        {0, 1, 0},       {0.7f, 0.7f, 0},
                                                   {0.7f, -0.7f, 0}, {0, 0, 1},       {0.7f, 0, 0.7f},
                                                   {-0.7f, 0, 0.7f}, {0, 0.7f, 0.7f}, {0, -0.7f, 0.7f}};
constexpr int kStartCount = kPlanarStarts + kDirectionCount;

constexpr int64_t kHypothesisTimeout_ns = 4'000'000'000;  // stage 2 is given up after 4 s; not swept
// A new first view is taken from the present frame after this time without stage 2: 10 s, not swept.
constexpr int64_t kFirstViewTimeout_ns = 10'000'000'000;
// A new first view is also taken when less than this share of the points is in sight at less than this progress: after
// turning on the spot the old first view is of no use. Ratios, not swept.
constexpr float kMinVisibleShare = 0.6f;
constexpr float kMinProgressToKeep = 0.5f;
// Radius of the search, pixels of the level searched. With a prediction from the last frame's motion the smaller one is
// enough. Without a prediction a slanted plane's parallax is to be covered [phone 4: 4 px]. Not swept.
constexpr float kStartRadius_px = 3.0f, kWideStartRadius_px = 4.0f;
constexpr int kMinFramesToPredict = 2;  // frames tracked well before the last motion predicts the next
// Image motion within the exposure, level-0 px: above the first, L1 is too blurred to search, as a third of the 16 px
// that a template covers; up to the second a view is recorded. Not swept.
constexpr float kBlurLimit_px = 6.0f;
constexpr float kMaxSharpBlur_px = 0.5f * kBlurLimit_px;
// Distance from the plane, relative to the plane's depth, up to which a point's patch gets the plane's normal. Not
// swept.
constexpr float kOffPlane = 0.1f;
constexpr float kMinSigma = 1e-6f;              // of a quantity that is known perfectly: guards a division
constexpr float kNoBaseline = 1e9f;             // t / d, before any solution has been looked at
constexpr int64_t kQualityInstructions = 1500;  // ARMv6, of a point's share of decomposition_quality(), as counted

}  // namespace

HomographyInitialiser::HomographyInitialiser(Arena& arena, const Config& config, WorkMeter& meter,
                                             CornerSource* corner_source)
    : config_(config),
      meter_(meter),
      tracker_(arena, config, meter, corner_source),
      recorder_(arena, config, meter),
      hypotheses_(arena, config, meter),
      values_(arena, config.max_initial_points) {}

void HomographyInitialiser::reset() {
  stage_ = Stage::kIdle;
  tracker_.reset();
  report_.progress = 0;
  report_.observed = {};
}

Hint HomographyInitialiser::start(const FrameInput& frame, const Vector3f& rotation_rate) {
  const Camera& camera = config_.camera;
  const float speed = rotation_rate.norm();
  if (speed > kMaxStartSpeed ||
      speed * camera.model.fx * (camera.readout_s() + config_.exposure_s) > px(kMaxStartMotion_px))
    return Hint::kHoldStill;
  if (!tracker_.start(frame.pyramid(), rotation_rate)) return Hint::kTooLittleTexture;
  report_.progress = 0;
  report_.observed = {};
  recorder_.start(frame, tracker_.points());
  previous_ns_ = start_ns_ = frame.timestamp_ns();
  frames_ = bad_frames_ = 0;
  information_ = 0;
  relative_ = RelativePose();
  next_start_ = 0;
  stage_ = Stage::kHomography;
  report_.hint = Hint::kMoveSideways;
  return Hint::kNone;
}

Initialiser::Progress HomographyInitialiser::give_up() {
  reset();
  report_.hint = Hint::kStartLost;
  return Progress::kLost;
}

Initialiser::Progress HomographyInitialiser::track(const FrameInput& frame, const Matrix3f& R_cp) {
  if (stage_ == Stage::kIdle) return Progress::kIdle;
  const float dt_s = static_cast<float>(frame.timestamp_ns() - previous_ns_) * 1e-9f;
  recorder_.note_last(bad_frames_ == 0, previous_ns_, tracker_.points());
  previous_ns_ = frame.timestamp_ns();
  const float blur_px = so3_log(R_cp).norm() / dt_s * config_.exposure_s * config_.camera.model.fx;
  SearchOptions options;
  options.level = blur_px > px(kBlurLimit_px) ? config_.coarse_search_level : config_.search_level;
  options.radius_px = bad_frames_ > 0 || frames_ < kMinFramesToPredict ? kWideStartRadius_px : kStartRadius_px;
  const bool good = tracker_.track(recorder_.first_pyramid(), frame.pyramid(), dt_s, R_cp, options);
  report_.hint = blur_px > px(kBlurLimit_px) ? Hint::kTooFast : Hint::kMoveSideways;
  report_.observed = tracker_.observed();
  report_.attempted = tracker_.attempted();
  report_.found = tracker_.found();
  if (!good) return ++bad_frames_ > kMaxBadFrames ? give_up() : Progress::kTracking;
  bad_frames_ = 0;
  ++frames_;
  const bool sharp = blur_px < px(kMaxSharpBlur_px);
  recorder_.note(frame, tracker_.points(), sharp);
  if (stage_ == Stage::kHypotheses) return compare(frame, dt_s);
  constrain(frame, R_cp, dt_s, sharp, options);
  return Progress::kTracking;
}

// Stage 1: judges how well the motion is known, and begins stage 2 when that is enough.
void HomographyInitialiser::constrain(const FrameInput& frame, const Matrix3f& R_cp, float dt_s, bool sharp,
                                      const SearchOptions& options) {
  const std::span<const Vector2f> inliers = tracker_.inlier_rays();
  const Decomposition decomposition = decompose_homography(tracker_.H(), inliers, kPureRotationTolerance);
  const bool most_fit = static_cast<float>(inliers.size()) > kMinPlanarShare * static_cast<float>(tracker_.found());
  const bool planar = most_fit && tracker_.sigma_px() < px(kMaxPlanarSigma_px);
  const bool certainly_planar = planar && tracker_.sigma_px() < px(kCertainPlanarSigma_px);
  const Vector3f rotation_rate = so3_log(R_cp) / dt_s;
  const auto turns_only = [&] {
    return decomposition.pure_rotation || decomposition.count == 0 ||
           focal_of_rotation(tracker_.H(), kMaxWrongFocal, kPureRotationTolerance) > 0;
  };
  if (planar && turns_only()) {
    if (sharp && so3_log(orthonormalised(tracker_.H())).norm() > kMaxPureTurn_rad) report_.hint = Hint::kOnlyRotating;
    report_.progress = information_ = 0;
    renew_first_view(frame, rotation_rate);
    return;
  }
  if (tracker_.camera_stands()) {  // the motion is that of a thing in the view
    report_.progress = information_ = 0;
    renew_first_view(frame, rotation_rate);
    return;
  }
  const float margin = certainly_planar ? planar_margin(decomposition) : general_margin(decomposition);
  if (margin > kMinMargin) information_ += margin * margin * dt_s / kTremorCorrelation_s;
  report_.progress = std::clamp(std::max(margin, std::sqrt(information_)) / kRequiredMargin, 0.0f, 1.0f);
  if (report_.progress < 1 || margin < kMinMargin || !sharp) {
    renew_first_view(frame, rotation_rate);
    return;
  }
  if (tracker_.scene_rests(recorder_.first_pyramid(), frame.pyramid(), options)) {
    report_.progress = information_ = 0;
    renew_first_view(frame, rotation_rate);
    return;
  }
  branch_ns_ = frame.timestamp_ns();
  frames_ = 0;
  hypotheses_.branch(tracker_, decomposition, certainly_planar ? nullptr : &relative_);
  stage_ = Stage::kHypotheses;
}

// Stage 2: tracks the rival maps until one wins.
Initialiser::Progress HomographyInitialiser::compare(const FrameInput& frame, float dt_s) {
  const StartHypotheses::Outcome outcome = hypotheses_.track(tracker_, dt_s);
  if (outcome == StartHypotheses::Outcome::kDecided) {
    recorder_.finish(frame, tracker_.points());
    return Progress::kDone;
  }
  const bool failed =
      outcome == StartHypotheses::Outcome::kNoneLeft || frame.timestamp_ns() - branch_ns_ > kHypothesisTimeout_ns;
  return failed ? give_up() : Progress::kTracking;
}

void HomographyInitialiser::renew_first_view(const FrameInput& frame, const Vector3f& rotation_rate) {
  const bool out_of_sight =
      report_.progress < kMinProgressToKeep &&
      static_cast<float>(tracker_.attempted()) < kMinVisibleShare * static_cast<float>(tracker_.searched_at_once());
  if (!out_of_sight && frame.timestamp_ns() - start_ns_ < kFirstViewTimeout_ns) return;
  const Hint hint = report_.hint;
  if (start(frame, rotation_rate) == Hint::kNone) report_.hint = hint;
}

// How well constrained the plane's decomposition is: required over reached sigma of its worst quantity, a ratio. The
// worse of the two solutions counts.
float HomographyInitialiser::planar_margin(const Decomposition& decomposition) {
  float worst_sigma_n = 0, shortest = kNoBaseline;
  for (int i = 0; i < decomposition.count; ++i) {
    const float sigma = std::max(tracker_.sigma_px(), px(kDecompositionNoise_px)) / config_.camera.model.fx;
    const DecompositionQuality quality =
        decomposition_quality(decomposition.solutions[i], tracker_.inlier_rays(), sigma);
    meter_.charge(Work::kOther, kQualityInstructions * static_cast<int64_t>(tracker_.inlier_rays().size()));
    worst_sigma_n = std::max(worst_sigma_n, quality.sigma_n_rad);
    shortest = std::min(shortest, decomposition.solutions[i].T_21.t.norm());
  }
  return std::min(kMaxSigmaNormal_rad / worst_sigma_n, shortest / kMinBaseline);
}

// How well the relative pose is known when no plane explains the points: required over reached sigma of its worst
// quantity, a ratio. 0 when no relative pose is found.
float HomographyInitialiser::general_margin(const Decomposition& decomposition) {
  const std::span<const Correspondence> correspondences = tracker_.correspondences();
  seek_relative_pose(decomposition, correspondences);
  if (!relative_.ok || relative_.sigma > px(kMaxEpipolarSigma_px) / config_.camera.model.fx) return 0;
  if (next_start_ < kStartCount) return 0;  // a local minimum is possible until all starts have been tried
  const float depth_sigma = median_depth_sigma(correspondences);
  if (!(depth_sigma > 0)) return 0;
  const float inlier_share = static_cast<float>(relative_.inliers) / static_cast<float>(correspondences.size());
  if (inlier_share < kMinEpipolarShare) return 0;
  return std::min(kMaxDepthSigma / std::max(depth_sigma, kMinSigma),
                  kMaxDirectionSigma_rad / std::max(relative_.sigma_t_rad, kMinSigma));
}

// Relative pose from the epipolar constraint. Starts from the last frame's relative pose, and from the plane's
// solutions and fixed directions of translation in turn, some in each frame. The result with the lowest cost is kept.
void HomographyInitialiser::seek_relative_pose(const Decomposition& decomposition,
                                               std::span<const Correspondence> correspondences) {
  values_.resize(values_.capacity());
  const float floor = px(kEpipolarFloor_px) / config_.camera.model.fx;
  RelativePose best;
  int spent = 0;
  const auto attempt = [&](const SE3& T_start) {
    const RelativePose pose = refine_relative_pose(correspondences, T_start, kRelativeSteps, floor, values_);
    spent += static_cast<int>(correspondences.size()) * pose.steps;
    if (!pose.ok) return;
    // Costs are given relative to each result's own scale^2: multiplied by it, they compare in one unit.
    const float scale = std::max(pose.sigma, floor), best_scale = std::max(best.sigma, floor);
    if (!best.ok || pose.cost * scale * scale < best.cost * best_scale * best_scale) best = pose;
  };
  const Matrix3f R = orthonormalised(tracker_.H());
  if (relative_.ok) attempt(relative_.T_21);
  for (int i = 0; i < kStartCount && spent < kRelativeBudget; ++i) {
    const int choice = next_start_++ % kStartCount;
    if (choice < kPlanarStarts) {
      if (choice < decomposition.count) attempt(decomposition.solutions[choice].T_21);
    } else {
      attempt({R, Vector3f(kDirections[choice - kPlanarStarts][0], kDirections[choice - kPlanarStarts][1],
                           kDirections[choice - kPlanarStarts][2])});
    }
  }
  meter_.charge(Work::kHomographyPoint, spent);
  relative_ = best;
}

// Sigma of a point's depth relative to the depth: median over the points that triangulate. 0 when these are too few.
float HomographyInitialiser::median_depth_sigma(std::span<const Correspondence> correspondences) {
  values_.clear();
  for (const Correspondence& c : correspondences) {
    Triangulated triangulated;
    if (!triangulate(relative_.T_21, c.x1, c.x2, 0, &triangulated)) continue;
    values_.push_back(triangulated.sigma_inverse_depth * triangulated.p_1.z() * px(kDecompositionNoise_px) /
                      config_.camera.model.fx);
  }
  return values_.size() < kMinInitialPoints ? 0.0f : median_of(values_);
}

bool HomographyInitialiser::build(Map& map, SE3* T_cw, Vector6f* velocity) {
  PPTAM_ASSERT(!map.exists());
  const Hypothesis& winner = hypotheses_.winner();
  if (!add_views(winner, map) || !add_points(winner, map)) {
    map.clear();
    return false;
  }
  *T_cw = winner.T_c1;
  *velocity = winner.velocity;
  return true;
}

// True for a point with a triangulated position and measurements in two views or more.
bool HomographyInitialiser::usable(const Hypothesis& hypothesis, int point) const {
  int views = 0;
  for (int k = 0; k < recorder_.count(); ++k) views += recorder_.view(k).points[point].found;
  return hypothesis.p_1[point].z() > 0 && views >= 2;
}

bool HomographyInitialiser::add_views(const Hypothesis& hypothesis, Map& map) {
  float depth_sum = 0;
  int count = 0;
  for (int i = 0; i < hypothesis.p_1.size(); ++i) {
    if (!usable(hypothesis, i)) continue;
    depth_sum += hypothesis.p_1[i].z();
    ++count;
  }
  if (count < kMinInitialPoints) return false;
  const int views = recorder_.count();
  for (int k = 0; k < views; ++k) {
    Keyframe& frame = recorder_.view(k).frame;
    frame.T_kw = k == 0 ? SE3() : hypothesis.T_c1;
    frame.velocity = k + 1 < views ? Vector6f::Zero() : hypothesis.velocity;
    frame.velocity_prior = frame.velocity;
    frame.mean_depth = depth_sum / static_cast<float>(count);
    if (map.add_keyframe(frame) < 0) return false;
  }
  return true;
}

// Adds the usable points with their measurements in the views and in the frames next to the views.
bool HomographyInitialiser::add_points(const Hypothesis& hypothesis, Map& map) {
  const ViewRecorder::Neighbour* neighbours[2 * kMaxInitialKeyframes];
  int neighbour_count = 0;
  for (int k = 0; k < recorder_.count(); ++k) {
    for (const ViewRecorder::Neighbour* neighbour : {&recorder_.view(k).before, &recorder_.view(k).after}) {
      if (!neighbour->known) continue;
      map.add_neighbour(k, neighbour->timestamp_ns);
      neighbours[neighbour_count++] = neighbour;
    }
  }
  int count = 0;
  for (int i = 0; i < hypothesis.p_1.size(); ++i) {
    const Vector3f& p_1 = hypothesis.p_1[i];
    if (!usable(hypothesis, i)) continue;
    const bool on_plane = hypothesis.planar && std::abs(hypothesis.n_1.dot(p_1) - 1.0f) < kOffPlane;
    const Vector3f normal = on_plane ? Vector3f(-hypothesis.n_1) : Vector3f(-p_1.normalized());
    const int index = map.add_point(p_1, {0, tracker_.points()[static_cast<size_t>(i)].px_1, normal});
    if (index < 0) break;
    for (int k = 0; k < recorder_.count(); ++k) {
      const ViewRecorder::ViewPoint& seen = recorder_.view(k).points[i];
      if (seen.found) map.add_measurement(index, {{seen.px, start_level(config_)}, static_cast<int16_t>(k)});
    }
    map.count_search(index, true);
    for (int n = 0; n < neighbour_count; ++n) {
      const ViewRecorder::ViewPoint& seen = neighbours[n]->points[i];
      if (seen.found)
        map.add_neighbour_measurement(n, {index, map.points()[index].id, {seen.px, start_level(config_)}});
    }
    ++count;
  }
  return count >= kMinInitialPoints;
}

Initialiser* create_homography_initialiser(Arena& arena, const Config& config, WorkMeter& meter,
                                           CornerSource* corner_source) {
  return arena.create<HomographyInitialiser>(config, meter, corner_source);
}

}  // namespace pptam
