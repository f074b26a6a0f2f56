#include "tracking/homography_initialiser.h"

#include <algorithm>
#include <cmath>

#include "base/assert.h"
#include "geometry/robust.h"

namespace pptam {

namespace {

// A first view is taken when the image moves by at most so much, in level-0 px, while it is read out and exposed: more
// blurs the corners, and the rolling shutter is corrected by the full-frame rotation alone. A tenth of it uncorrected
// shifts one end of the readout against the other by half a pixel. And at most so fast where both times are short or
// unknown, in radians/s of apparent rotation.
constexpr float kMaxStartMotion_px = 6.5f;
constexpr float kMaxStartSpeed = 0.6f;
constexpr int kMaxBadFrames = 5;
// A measurement's noise, level-0 px, for judging how well a decomposition is constrained. Measured against the truth in
// 2200 frames of 40 emulated starts on planes: the normal's error was 0.42 (median) and 1.5 (99 %) times what sigma_n
// says for 1 px, which is 0.36 to 0.5 px for the Rayleigh distribution. Most of it is tremor within the readout.
constexpr float kDecompositionNoise_px = 0.5f;
constexpr float kMaxSigmaNormal_rad = 0.045f;  // 2.6 degrees
constexpr float kMinBaseline = 0.03f;          // t / d
// Stage 2 begins when the information of the frames adds up to that of one frame in which everything is known so many
// times better than it must be. Frames within kSameNoise_s share their tremor and count once; those in which too little
// is known do not count. Who moves on gets a better map, who stops moving gets one at all.
constexpr float kWellKnown = 2.0f;
constexpr float kMinMargin = 0.8f;
constexpr float kSameNoise_s = 0.2f;
constexpr float kPureRotationTolerance = 0.02f;
constexpr float kTurned_rad = 0.14f;  // 8 degrees without a baseline: say so
// What counts as a plane: residuals' scale, and the share of the found points that fit. A plane leaves at most the
// floor of the scale (0.3 px in all of 960 frames of planes under three shutters); a homography bends to fit two walls
// of a corner within 0.4 to 1 px, and so do a plane and a wrong calibration: then stage 2 has to tell.
constexpr float kCertainPlanarSigma_px = 0.4f;
constexpr float kMaxPlanarSigma_px = 1.2f;
constexpr float kMinPlanarShare = 0.7f;

// General motion.
constexpr int kRelativeSteps = 8;      // at most, of one start
constexpr int kRelativeBudget = 1200;  // points times steps, after which a frame tries no further start
constexpr float kEpipolarFloor_px = 0.3f;
constexpr float kMaxEpipolarSigma_px = 1.2f;
constexpr float kMinEpipolarShare = 0.7f;
constexpr float kMaxDepthSigma = 0.06f;  // of the median point, relative
constexpr float kMaxDirectionSigma_rad = 0.1f;
constexpr int kDirectionCount = 9;  // half a sphere: the sign follows from the points' side
constexpr float kDirections[kDirectionCount][3] = {{1, 0, 0},        {0, 1, 0},       {0.7f, 0.7f, 0},
                                                   {0.7f, -0.7f, 0}, {0, 0, 1},       {0.7f, 0, 0.7f},
                                                   {-0.7f, 0, 0.7f}, {0, 0.7f, 0.7f}, {0, -0.7f, 0.7f}};

constexpr int64_t kHypothesisTimeout_ns = 4'000'000'000;
// A new first view is taken from the present frame when nothing has come of the old one for so long, and when the
// motion is hardly known and so few of the points are left in sight: turning on the spot makes the first view
// worthless.
constexpr int64_t kFirstViewTimeout_ns = 10'000'000'000;
constexpr float kMinVisibleShare = 0.6f;
// Of the search in L1: the prediction from the last frame's motion leaves little; without it a slanted plane's
// parallax.
constexpr float kRadius_px = 3.0f, kWideRadius_px = 4.0f;
constexpr float kBlurLimit_px = 6.0f;  // image motion within the exposure at which L1 becomes useless
constexpr float kOffPlane = 0.1f;      // of a point's depth on the plane, beyond which it does not lie on it
constexpr float kMinSigma = 1e-6f;     // of a quantity known perfectly

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
      speed * camera.model.fx * (camera.readout_s() + config_.exposure_s) > kMaxStartMotion_px)
    return Hint::kHoldStill;
  if (!tracker_.start(frame.pyramid(), rotation_rate)) return Hint::kTooLittleTexture;
  report_.progress = 0;
  report_.observed = {};
  recorder_.start(frame, tracker_.points());
  previous_ns_ = start_ns_ = frame.timestamp_ns();
  frames_ = bad_frames_ = 0;
  known_ = 0;
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
  options.level = blur_px > kBlurLimit_px ? config_.coarse_search_level : config_.search_level;
  options.radius_px = bad_frames_ > 0 || frames_ < 2 ? kWideRadius_px : kRadius_px;
  const bool good = tracker_.track(recorder_.first_pyramid(), frame.pyramid(), dt_s, R_cp, options);
  report_.hint = blur_px > kBlurLimit_px ? Hint::kTooFast : Hint::kMoveSideways;
  report_.observed = tracker_.observed();
  report_.attempted = tracker_.attempted();
  report_.found = tracker_.found();
  if (!good) return ++bad_frames_ > kMaxBadFrames ? give_up() : Progress::kTracking;
  bad_frames_ = 0;
  ++frames_;
  const bool sharp = blur_px < 0.5f * kBlurLimit_px;
  recorder_.note(frame, tracker_.points(), sharp);
  if (stage_ == Stage::kHypotheses) return compare(frame, dt_s);
  constrain(frame, R_cp, dt_s, sharp);
  return Progress::kTracking;
}

// Stage 1: how well is the motion known?
void HomographyInitialiser::constrain(const FrameInput& frame, const Matrix3f& R_cp, float dt_s, bool sharp) {
  const std::span<const Vector2f> inliers = tracker_.inlier_rays();
  const Decomposition decomposition = decompose_homography(tracker_.H(), inliers, kPureRotationTolerance);
  const bool most_fit = static_cast<float>(inliers.size()) > kMinPlanarShare * static_cast<float>(tracker_.found());
  const bool planar = most_fit && tracker_.sigma_px() < kMaxPlanarSigma_px;
  const bool certainly_planar = planar && tracker_.sigma_px() < kCertainPlanarSigma_px;
  const Vector3f rotation_rate = so3_log(R_cp) / dt_s;
  if (planar && (decomposition.pure_rotation || decomposition.count == 0)) {
    if (sharp && so3_log(orthonormalised(tracker_.H())).norm() > kTurned_rad) report_.hint = Hint::kOnlyRotating;
    report_.progress = known_ = 0;
    renew_first_view(frame, rotation_rate);
    return;
  }
  const float margin = certainly_planar ? planar_margin(decomposition) : general_margin(decomposition);
  if (margin > kMinMargin) known_ += margin * margin * dt_s / kSameNoise_s;
  report_.progress = std::clamp(std::max(margin, std::sqrt(known_)) / kWellKnown, 0.0f, 1.0f);
  if (report_.progress < 1 || margin < kMinMargin || !sharp) {
    renew_first_view(frame, rotation_rate);
    return;
  }
  branch_ns_ = frame.timestamp_ns();
  frames_ = 0;
  hypotheses_.branch(tracker_, decomposition, certainly_planar ? nullptr : &relative_);
  stage_ = Stage::kHypotheses;
}

// Stage 2: which map is right?
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
      report_.progress < 0.5f &&
      static_cast<float>(tracker_.attempted()) < kMinVisibleShare * static_cast<float>(tracker_.searched_at_once());
  if (!out_of_sight && frame.timestamp_ns() - start_ns_ < kFirstViewTimeout_ns) return;
  const Hint hint = report_.hint;
  if (start(frame, rotation_rate) == Hint::kNone) report_.hint = hint;
}

// How well constrained the plane's decomposition is, by its worst quantity, relative to what is needed. Both solutions
// must be.
float HomographyInitialiser::planar_margin(const Decomposition& decomposition) {
  float worst_sigma_n = 0, shortest = 1e9f;
  for (int i = 0; i < decomposition.count; ++i) {
    const float sigma = std::max(tracker_.sigma_px(), kDecompositionNoise_px) / config_.camera.model.fx;
    const DecompositionQuality quality =
        decomposition_quality(decomposition.solutions[i], tracker_.inlier_rays(), sigma);
    worst_sigma_n = std::max(worst_sigma_n, quality.sigma_n_rad);
    shortest = std::min(shortest, decomposition.solutions[i].T_21.t.norm());
  }
  return std::min(kMaxSigmaNormal_rad / worst_sigma_n, shortest / kMinBaseline);
}

// No plane explains the points: how well the relative pose is known, as for the plane; 0 when it is not.
float HomographyInitialiser::general_margin(const Decomposition& decomposition) {
  const std::span<const Correspondence> correspondences = tracker_.correspondences();
  seek_relative_pose(decomposition, correspondences);
  if (!relative_.ok || relative_.sigma > kMaxEpipolarSigma_px / config_.camera.model.fx) return 0;
  if (next_start_ < kDirectionCount + 2) return 0;  // until all have been tried it may be a local minimum
  const float depth_sigma = median_depth_sigma(correspondences);
  if (!(depth_sigma > 0)) return 0;
  const float inlier_share = static_cast<float>(relative_.inliers) / static_cast<float>(correspondences.size());
  if (inlier_share < kMinEpipolarShare) return 0;
  return std::min(kMaxDepthSigma / std::max(depth_sigma, kMinSigma),
                  kMaxDirectionSigma_rad / std::max(relative_.sigma_t_rad, kMinSigma));
}

// From the epipolar constraint. Starts from the last frame's and, some in each frame, from the plane's solutions and
// fixed directions of translation in turn; the cheapest is kept.
void HomographyInitialiser::seek_relative_pose(const Decomposition& decomposition,
                                               std::span<const Correspondence> correspondences) {
  values_.resize(values_.capacity());
  const float floor = kEpipolarFloor_px / config_.camera.model.fx;
  RelativePose best;
  int spent = 0;
  const auto attempt = [&](const SE3& T_start) {
    const RelativePose pose = refine_relative_pose(correspondences, T_start, kRelativeSteps, floor, values_);
    spent += static_cast<int>(correspondences.size()) * pose.steps;
    if (!pose.ok) return;
    // Compared at one scale, the smaller: as cost / scale^2 grows with what does not fit.
    const float scale = std::max(pose.sigma, floor), best_scale = std::max(best.sigma, floor);
    if (!best.ok || pose.cost * scale * scale < best.cost * best_scale * best_scale) best = pose;
  };
  const Matrix3f R = orthonormalised(tracker_.H());
  if (relative_.ok) attempt(relative_.T_21);
  for (int i = 0; i < kDirectionCount + 2 && spent < kRelativeBudget; ++i) {
    const int choice = next_start_++ % (kDirectionCount + 2);
    if (choice < 2) {
      if (choice < decomposition.count) attempt(decomposition.solutions[choice].T_21);
    } else {
      attempt({R, Vector3f(kDirections[choice - 2][0], kDirections[choice - 2][1], kDirections[choice - 2][2])});
    }
  }
  meter_.charge(Work::kHomographyPoint, spent);
  relative_ = best;
}

// How well the depths are known, relative: median over the points that triangulate; 0 when these are too few.
float HomographyInitialiser::median_depth_sigma(std::span<const Correspondence> correspondences) {
  values_.clear();
  for (const Correspondence& c : correspondences) {
    Triangulated triangulated;
    if (!triangulate(relative_.T_21, c.x1, c.x2, 0, &triangulated)) continue;
    values_.push_back(triangulated.sigma_inverse_depth * triangulated.p_1.z() * kDecompositionNoise_px /
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

// Has the point a place, and two measurements?
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

// The usable points, with what was found of them in views and in the frames next to these.
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
      if (seen.found) map.add_measurement(index, {{seen.px, kStartLevel}, static_cast<int16_t>(k)});
    }
    map.count_search(index, true);
    for (int n = 0; n < neighbour_count; ++n) {
      const ViewRecorder::ViewPoint& seen = neighbours[n]->points[i];
      if (seen.found) map.add_neighbour_measurement(n, {index, map.points()[index].id, {seen.px, kStartLevel}});
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
