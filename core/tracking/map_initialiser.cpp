#include "tracking/map_initialiser.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "geometry/robust.h"

namespace pptam {

namespace {

constexpr int kMinCorners = 25;  // fewer cannot constrain 8 parameters well once some are lost
// A first view is taken when the image moves by at most so much, in level-0 px, while it is read out and exposed: more
// blurs the corners, and the rolling shutter is corrected by the full-frame rotation alone. A tenth of it uncorrected
// shifts one end of the readout against the other by half a pixel. And at most so fast where both times are short or
// unknown, in radians/s of apparent rotation.
constexpr float kMaxStartMotion_px = 6.5f;
constexpr float kMaxStartSpeed = 0.6f;
constexpr float kMinFoundFraction = 0.3f;  // of the points expected in the image
constexpr int kMinInliers = 14;
constexpr int kMaxBadFrames = 5;
// All measurements count as of this level, those of blurred frames too: stage 2 compares costs in one unit.
constexpr uint8_t kLevel = 1;
constexpr float kSigma_px = 2.0f;  // their expected standard deviation, before sub-pixel refinement
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
constexpr float kLeastMargin = 0.8f;
constexpr float kSameNoise_s = 0.2f;
constexpr float kPureRotationTolerance = 0.02f;
constexpr float kTurned_rad = 0.14f;  // 8 degrees without a baseline: say so
// What counts as a plane: residuals' scale, and the share of the found points that fit. A plane leaves at most the
// floor of the scale (0.3 px in all of 960 frames of planes under three shutters); a homography bends to fit two walls
// of a corner within 0.4 to 1 px, and so do a plane and a wrong calibration: then stage 2 has to tell.
constexpr float kCertainPlanarSigma_px = 0.4f;
constexpr float kMaxPlanarSigma_px = 1.2f;
constexpr float kMinPlanarShare = 0.7f;
constexpr float kResidualDecay = 0.7f;  // of an off-plane point's offset, per frame without a match

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

// Stage 2.
// Cost ratio that decides [phone 5.1], relaxed frame by frame: with a wrong calibration no hypothesis fits well, and
// the ratio stays under 2 for ever.
constexpr float kHypothesisCostRatio = 2.0f, kMinCostRatio = 1.2f, kCostRatioPerFrame = 0.05f;
constexpr float kPlaneCostRatio = 1.15f;
constexpr float kCostMemory = 0.8f;        // costs are summed with forgetting, about five frames
constexpr float kMaxCostScale = 1.0f;      // 2 px
constexpr float kPriorTranslation = 0.1f;  // depths/s, of the velocity during the readout
constexpr float kPriorRotation = 0.15f;    // radians/s
constexpr int kMinHypothesisFrames = 3;
constexpr int kMaxPosePoints = 40;  // of each hypothesis' pose: three of them must fit into a frame's time
constexpr int64_t kHypothesisTimeout_ns = 4'000'000'000;
// A new first view is taken from the present frame when nothing has come of the old one for so long, and when the
// motion is hardly known and so few of the points are left in sight: turning on the spot makes the first view
// worthless.
constexpr int64_t kFirstViewTimeout_ns = 10'000'000'000;
constexpr float kMinVisibleShare = 0.6f;
constexpr float kMaxHypothesisSigma = 1.0f;  // 2 px: a right model fits to under 1 px
constexpr float kMinParallax_rad = 0.01f;
constexpr int kMinMapPoints = 15;
// Of the search in L1: the prediction from the last frame's motion leaves little; without it a slanted plane's
// parallax.
constexpr float kRadius_px = 3.0f, kWideRadius_px = 4.0f;
// Of the first view's points, in turns: each costs about 45 thousand ARMv6 instructions of a frame's 6 million.
constexpr int kSearchesPerFrame = 85;
constexpr float kBlurLimit_px = 6.0f;  // image motion within the exposure at which L1 becomes useless

// log of a matrix near the identity, second order.
Matrix3f log_near_identity(const Matrix3f& M) {
  const Matrix3f D = M - Matrix3f::Identity();
  Matrix3f L = D - 0.5f * (D * D);
  L -= Matrix3f::Identity() * (L.trace() / 3.0f);
  return L;
}

}  // namespace

MapInitialiser::MapInitialiser(Arena& arena, const Config& config, WorkMeter& meter)
    : config_(config),
      meter_(meter),
      corner_detector_(arena, config.camera.model.width, config.camera.model.height),
      corners_(arena, config.max_initial_points),
      points_(arena, config.max_initial_points),
      pose_points_(arena, kMaxPosePoints),
      pose_(arena, kMaxPosePoints, config.camera.shutter.line_time_s != 0, meter),
      squared_(arena, config.max_initial_points),
      weights_(arena, config.max_initial_points),
      correspondences_(arena, config.max_initial_points),
      inlier_rays_(arena, config.max_initial_points),
      observed_(arena, config.max_initial_points) {
  for (View& view : views_) {
    for (FixedVector<ViewPoint>* points : {&view.points, &view.before.points, &view.after.points})
      *points = FixedVector<ViewPoint>(arena, config.max_initial_points);
    view.frame = Keyframe(arena, config.camera.model);
  }
  last_.points = FixedVector<ViewPoint>(arena, config.max_initial_points);
  for (Hypothesis& hypothesis : hypotheses_) hypothesis.p_1 = FixedVector<Vector3f>(arena, config.max_initial_points);
}

void MapInitialiser::note_points(FixedVector<ViewPoint>& points) const {
  points.clear();
  for (const Point& point : points_) points.push_back({point.px_2, point.found});
  meter_.charge(Work::kOther, 5LL * points.size());
}

void MapInitialiser::note_neighbour(int64_t timestamp_ns, Neighbour& neighbour) const {
  neighbour.known = true;
  neighbour.timestamp_ns = timestamp_ns;
  note_points(neighbour.points);
}

void MapInitialiser::store_view(const Pyramid& pyramid, const GreyView& small, int64_t timestamp_ns, View& view) {
  view.frame.timestamp_ns = timestamp_ns;
  view.frame.set_images(pyramid, small);
  note_points(view.points);
  std::swap(view.before, last_);
  view.after.known = false;
  meter_.charge(Work::kKeyframePixel,
                static_cast<int64_t>(config_.camera.model.width) * config_.camera.model.height * 4 / 3);
}

// Every view_stride_-th frame; when the places run out every second view goes and the stride doubles, so that the views
// stay spread over the whole way. The last one always finds a place.
void MapInitialiser::record_view(const Pyramid& pyramid, const GreyView& small, int64_t timestamp_ns, bool last) {
  if (views_[view_count_ - 1].frame.timestamp_ns == timestamp_ns) return;
  ++frames_since_view_;
  if (!last && frames_since_view_ < view_stride_) return;
  const int places =
      std::min(kMaxInitialKeyframes, std::max(3, config_.max_keyframes / 2));  // leaves room for the map to grow
  if (view_count_ == places && !last) {
    for (int i = 1; 2 * i < places; ++i) std::swap(views_[i], views_[2 * i]);
    view_count_ = (places + 1) / 2;
    view_stride_ *= 2;
    if (frames_since_view_ < view_stride_) return;
  }
  if (view_count_ == places) --view_count_;  // replaced by the last
  store_view(pyramid, small, timestamp_ns, views_[view_count_++]);
  frames_since_view_ = 0;
}

void MapInitialiser::reset() {
  stage_ = Stage::kIdle;
  progress_ = 0;
  points_.clear();
  observed_.clear();
}

Hint MapInitialiser::start(const Pyramid& pyramid, const GreyView& small, int64_t timestamp_ns,
                           const Vector3f& rotation_rate) {
  const Camera& camera = config_.camera;
  const float speed = rotation_rate.norm();
  if (speed > kMaxStartSpeed ||
      speed * camera.model.fx * (camera.readout_s() + config_.exposure_s) > kMaxStartMotion_px)
    return Hint::kHoldStill;
  corners_.resize(corners_.capacity());
  const int count = corner_detector_.detect(pyramid, CornerParams(), corners_);
  meter_.charge(Work::kCornerPixel, corner_detector_.scored_pixels());
  meter_.charge(Work::kCornerAscent, corner_detector_.ascent_steps());
  if (count < kMinCorners) return Hint::kTooLittleTexture;
  reset();
  for (int i = 0; i < count; ++i) {
    Point point;
    point.px_1 = {static_cast<float>(corners_[i].x), static_cast<float>(corners_[i].y)};
    point.x_1 = corrected(point.px_1, hat(rotation_rate));
    Vector2f px;
    Matrix23f J;
    if (!config_.camera.project({point.x_1.x(), point.x_1.y(), 1.0f}, &px, &J)) continue;
    point.J_1 = J.leftCols<2>();
    points_.push_back(point);
  }
  for (Point& point : points_) {
    point.px_2 = point.px_1;
    point.found = true;
  }
  view_count_ = 0;
  view_stride_ = 1;
  last_.known = false;
  store_view(pyramid, small, timestamp_ns, views_[view_count_++]);
  frames_since_view_ = 0;
  H_.setIdentity();
  H_previous_.setIdentity();
  H_rate_.setZero();
  parallax_rate_.setZero();
  previous_ns_ = start_ns_ = timestamp_ns;
  frames_ = bad_frames_ = 0;
  known_ = 0;
  winner_ = -1;
  all_failed_ = false;
  relative_ = RelativePose();
  next_start_ = next_search_ = 0;
  stage_ = Stage::kHomography;
  hint_ = Hint::kMoveSideways;
  return Hint::kNone;
}

// Where a global shutter would have seen the normalised point of pixel px, in an image that moves at `rate`.
Vector2f MapInitialiser::corrected(const Vector2f& px, const Matrix3f& rate) const {
  const Vector2f x = config_.camera.unproject(px);
  const float dt_s = config_.camera.dt_s(px);
  if (dt_s == 0) return x;
  return apply_homography(Matrix3f::Identity() - dt_s * rate, x);
}

void MapInitialiser::search_points(const Pyramid& pyramid, const Matrix3f& H_predicted, const Matrix3f& rate,
                                   const SearchOptions& options) {
  observed_.clear();
  attempted_ = found_ = 0;
  for (Point& point : points_) {
    point.found = false;
    point.weight = 0;
  }
  const int count = points_.size();
  const int first = next_search_;
  for (int step = 0; step < count && attempted_ < kSearchesPerFrame; ++step) {
    next_search_ = (first + step + 1) % count;
    Point& point = points_[(first + step) % count];
    if (homography_depth(H_predicted, point.x_1) <= 0.1f) continue;
    const Vector2f x = apply_homography(H_predicted, point.x_1) + point.residual;
    Vector2f px;
    Matrix23f J;
    if (!config_.camera.project({x.x(), x.y(), 1.0f}, &px, &J)) continue;
    const float dt_s = config_.camera.dt_s(px);
    if (dt_s != 0) {
      const Vector2f moved = apply_homography(Matrix3f::Identity() + dt_s * rate, x);
      px += J.leftCols<2>() * (moved - x);
    }
    if (!config_.camera.in_image(px, 12.0f)) continue;
    const Matrix2f A = J.leftCols<2>() * homography_point_jacobian(H_predicted, point.x_1) * point.J_1.inverse();
    PatchTemplate patch;
    meter_.charge(Work::kPatchWarp, 1);
    if (!warp_template(views_[0].frame.pyramid, point.px_1, A, options.level, &patch)) continue;
    ImagePoint found;
    const SearchOutcome outcome = find_template(pyramid, patch, px, options, meter_, &found);
    if (outcome == SearchOutcome::kNotVisible) continue;
    ++attempted_;
    ObservedPoint observed;
    observed.predicted_px = px;
    observed.px = px;
    observed.level = static_cast<uint8_t>(options.level);
    if (outcome == SearchOutcome::kFound) {
      ++found_;
      point.found = true;
      point.px_2 = found.px;
      observed.px = found.px;
      observed.predicted_px = point.px_1;
      observed.kind = ObservedKind::kInitial;
    }
    observed_.push_back(observed);
  }
}

// H to the found points, from the prediction.
bool MapInitialiser::fit_to_found(const Matrix3f& H_predicted) {
  correspondences_.clear();
  for (const Point& point : points_)
    if (point.found) correspondences_.push_back({point.x_1, point.x_2});
  weights_.resize(correspondences_.size());
  squared_.resize(correspondences_.size());
  const HomographyFit fit =
      fit_homography(correspondences_, H_predicted, kSigma_px / config_.camera.model.fx, weights_, squared_);
  meter_.charge(Work::kHomographyPoint, fit.iterations * correspondences_.size());
  const float* weight = weights_.data();
  for (Point& point : points_) point.weight = point.found ? *weight++ : 0.0f;
  sigma_px_ = kSigma_px * fit.sigma;
  if (fit.ok) H_ = fit.H;
  return fit.ok;
}

MapInitialiser::Progress MapInitialiser::track(const Pyramid& pyramid, const GreyView& small, int64_t timestamp_ns,
                                               const Matrix3f& R_cp) {
  if (stage_ == Stage::kIdle) return Progress::kIdle;
  const float dt_s = static_cast<float>(timestamp_ns - previous_ns_) * 1e-9f;
  last_.known = false;
  if (bad_frames_ == 0) note_neighbour(previous_ns_, last_);
  previous_ns_ = timestamp_ns;
  // Rotation as seen, and what was left of the last frame's motion: the parallax goes on.
  const Matrix3f motion = (Matrix3f::Identity() + dt_s * parallax_rate_) * R_cp;
  const Matrix3f H_predicted = motion * H_;
  const Matrix3f predicted_rate = log_near_identity(motion) / dt_s;
  const float blur_px = so3_log(R_cp).norm() / dt_s * config_.exposure_s * config_.camera.model.fx;
  SearchOptions options;
  options.level = blur_px > kBlurLimit_px ? 2 : 1;
  options.radius_px = bad_frames_ > 0 || frames_ < 2 ? kWideRadius_px : kRadius_px;
  search_points(pyramid, H_predicted, predicted_rate, options);

  hint_ = options.level > 1 ? Hint::kTooFast : Hint::kMoveSideways;
  H_previous_ = H_;
  const Matrix3f rate_guess = predicted_rate;
  for (Point& point : points_)
    if (point.found) point.x_2 = corrected(point.px_2, rate_guess);
  bool good = found_ >= kMinInliers &&
              static_cast<float>(found_) >= kMinFoundFraction * static_cast<float>(attempted_) &&
              fit_to_found(H_predicted);
  if (good) {
    // Once more with the measured rate: H's own, not the rotation's.
    H_rate_ = log_near_identity(H_ * H_previous_.inverse()) / dt_s;
    parallax_rate_ = H_rate_ - log_near_identity(R_cp) / dt_s;
    for (Point& point : points_)
      if (point.found) point.x_2 = corrected(point.px_2, H_rate_);
    good = fit_to_found(H_);
  }
  for (Point& point : points_) {
    if (good && point.found) {
      point.residual = point.x_2 - apply_homography(H_, point.x_1);
      point.on_plane = point.weight > 0;
    } else {
      point.residual *= kResidualDecay;
    }
  }
  if (!good) {
    H_ = R_cp * H_previous_;
    parallax_rate_.setZero();
    if (++bad_frames_ > kMaxBadFrames) {
      reset();
      hint_ = Hint::kStartLost;
      return Progress::kLost;
    }
    return Progress::kTracking;
  }
  bad_frames_ = 0;
  ++frames_;
  View& newest = views_[view_count_ - 1];
  if (last_.known && newest.frame.timestamp_ns == last_.timestamp_ns) note_neighbour(timestamp_ns, newest.after);
  // A blurred view makes a poor keyframe.
  const bool sharp = blur_px < 0.5f * kBlurLimit_px;
  if (sharp) record_view(pyramid, small, timestamp_ns, false);

  if (stage_ == Stage::kHomography) {
    inlier_rays_.clear();
    for (const Point& point : points_)
      if (point.weight > 0) inlier_rays_.push_back(point.x_1);
    const Decomposition decomposition = decompose_homography(H_, inlier_rays_, kPureRotationTolerance);
    const bool planar = sigma_px_<kMaxPlanarSigma_px&& static_cast<float>(inlier_rays_.size())> kMinPlanarShare *
                        static_cast<float>(found_);
    const bool certainly_planar = planar && sigma_px_ < kCertainPlanarSigma_px;
    if (planar && (decomposition.pure_rotation || decomposition.count == 0)) {
      if (sharp && so3_log(orthonormalised(H_)).norm() > kTurned_rad) hint_ = Hint::kOnlyRotating;
      progress_ = known_ = 0;
      renew_first_view(pyramid, small, timestamp_ns, so3_log(R_cp) / dt_s);
      return Progress::kTracking;
    }
    const float margin = certainly_planar ? planar_margin(decomposition) : general_margin(decomposition);
    if (margin > kLeastMargin) known_ += margin * margin * dt_s / kSameNoise_s;
    progress_ = std::clamp(std::max(margin, std::sqrt(known_)) / kWellKnown, 0.0f, 1.0f);
    if (progress_ < 1 || margin < kLeastMargin || !sharp) {
      renew_first_view(pyramid, small, timestamp_ns, so3_log(R_cp) / dt_s);
      return Progress::kTracking;
    }
    branch_ns_ = timestamp_ns;
    branch(decomposition, !certainly_planar);
    stage_ = Stage::kHypotheses;
    return Progress::kTracking;
  }

  if (!track_hypotheses(dt_s)) {
    if (all_failed_ || timestamp_ns - branch_ns_ > kHypothesisTimeout_ns) {
      reset();
      hint_ = Hint::kStartLost;
      return Progress::kLost;
    }
    return Progress::kTracking;
  }
  record_view(pyramid, small, timestamp_ns, true);
  return Progress::kDone;
}

void MapInitialiser::renew_first_view(const Pyramid& pyramid, const GreyView& small, int64_t timestamp_ns,
                                      const Vector3f& rotation_rate) {
  const int searched = std::min(points_.size(), kSearchesPerFrame);
  const bool out_of_sight =
      progress_ < 0.5f && static_cast<float>(attempted_) < kMinVisibleShare * static_cast<float>(searched);
  if (!out_of_sight && timestamp_ns - start_ns_ < kFirstViewTimeout_ns) return;
  const Hint hint = hint_;
  if (start(pyramid, small, timestamp_ns, rotation_rate) == Hint::kNone) hint_ = hint;
}

// How well constrained the plane's decomposition is, by its worst quantity, relative to what is needed. Both solutions
// must be.
float MapInitialiser::planar_margin(const Decomposition& decomposition) {
  float worst_sigma_n = 0, shortest = 1e9f;
  for (int i = 0; i < decomposition.count; ++i) {
    const float sigma = std::max(sigma_px_, kDecompositionNoise_px) / config_.camera.model.fx;
    const DecompositionQuality quality = decomposition_quality(decomposition.solutions[i], inlier_rays_, sigma);
    worst_sigma_n = std::max(worst_sigma_n, quality.sigma_n_rad);
    shortest = std::min(shortest, decomposition.solutions[i].T_21.t.norm());
  }
  return std::min(kMaxSigmaNormal_rad / worst_sigma_n, shortest / kMinBaseline);
}

// No plane explains the points: the relative pose from the epipolar constraint. Starts from the last frame's and, some
// in each frame, from the plane's solutions and fixed directions of translation in turn; the cheapest is kept. How well
// it is known, as for the plane; 0 when it is not.
float MapInitialiser::general_margin(const Decomposition& decomposition) {
  correspondences_.clear();
  for (const Point& point : points_)
    if (point.found) correspondences_.push_back({point.x_1, point.x_2});
  squared_.resize(squared_.capacity());
  const float floor = kEpipolarFloor_px / config_.camera.model.fx;
  RelativePose best;
  int spent = 0;
  const auto attempt = [&](const SE3& T_start) {
    const RelativePose pose = refine_relative_pose(correspondences_, T_start, kRelativeSteps, floor, squared_);
    spent += correspondences_.size() * pose.steps;
    if (!pose.ok) return;
    // Compared at one scale, the smaller: as cost / scale^2 grows with what does not fit.
    const float scale = std::max(pose.sigma, floor), best_scale = std::max(best.sigma, floor);
    if (!best.ok || pose.cost * scale * scale < best.cost * best_scale * best_scale) best = pose;
  };
  const Matrix3f R = orthonormalised(H_);
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
  if (!best.ok || best.sigma > kMaxEpipolarSigma_px / config_.camera.model.fx) return 0;
  if (next_start_ < kDirectionCount + 2) return 0;  // until all have been tried it may be a local minimum
  // How well are the depths known? Median over the points that triangulate.
  squared_.clear();
  for (const Correspondence& c : correspondences_) {
    Triangulated triangulated;
    if (!triangulate(best.T_21, c.x1, c.x2, 0, &triangulated)) continue;
    squared_.push_back(triangulated.sigma_inverse_depth * triangulated.p_1.z() * kDecompositionNoise_px /
                       config_.camera.model.fx);
  }
  if (squared_.size() < kMinMapPoints) return 0;
  float* middle = squared_.begin() + squared_.size() / 2;
  std::nth_element(squared_.begin(), middle, squared_.end());
  const float inlier_share = static_cast<float>(best.inliers) / static_cast<float>(correspondences_.size());
  if (inlier_share < kMinEpipolarShare) return 0;
  return std::min(kMaxDepthSigma / std::max(*middle, 1e-6f),
                  kMaxDirectionSigma_rad / std::max(best.sigma_t_rad, 1e-6f));
}

// Stage 2 begins: a map for each solution, points by triangulation.
void MapInitialiser::branch(const Decomposition& decomposition, bool general) {
  frames_ = 0;
  for (int k = 0; k < kHypotheses; ++k) {
    Hypothesis& hypothesis = hypotheses_[k];
    hypothesis.planar = k < 2;
    hypothesis.alive = hypothesis.planar ? k < decomposition.count : general;
    hypothesis.cost = 0;
    if (!hypothesis.alive) continue;
    SE3 T_b1 = hypothesis.planar ? decomposition.solutions[k].T_21 : relative_.T_21;
    if (hypothesis.planar) hypothesis.n_1 = decomposition.solutions[k].n_1;
    hypothesis.p_1.clear();
    float depth_sum = 0;
    int count = 0;
    for (const Point& point : points_) {
      Triangulated triangulated;
      Vector3f p_1 = Vector3f::Zero();
      const Vector3f ray = point.x_1.homogeneous();
      if (hypothesis.planar && point.on_plane && hypothesis.n_1.dot(ray) > 0) {
        p_1 = ray / hypothesis.n_1.dot(ray);  // knows its plane better than its parallax tells
      } else if (point.found && triangulate(T_b1, point.x_1, point.x_2, kMinParallax_rad, &triangulated)) {
        p_1 = triangulated.p_1;
      }
      hypothesis.p_1.push_back(p_1);
      depth_sum += p_1.z();
      count += p_1.z() > 0;
    }
    if (count < kMinMapPoints) {
      hypothesis.alive = false;
      continue;
    }
    if (!hypothesis.planar) {  // unit baseline so far: make the scene about 1 away
      const float scale = static_cast<float>(count) / depth_sum;
      for (Vector3f& p : hypothesis.p_1) p *= scale;
      T_b1.t *= scale;
    }
    hypothesis.T_c1 = T_b1;
    hypothesis.velocity = velocity_from_rate(H_rate_, hypothesis, T_b1);
  }
  for (Point& point : points_) {
    point.found_b = point.found;
  }
}

// The camera velocity whose image motion at the points is that of the homography's rate: least squares over the points
// [phone 6], with a weak prior against the poorly seen directions.
Vector6f MapInitialiser::velocity_from_rate(const Matrix3f& rate, const Hypothesis& hypothesis, const SE3& T_k1) const {
  constexpr float kWeakTranslation = 0.5f, kWeakRotation = 0.5f, kFlowNoise = 0.03f;  // depths/s, radians/s, 1/s
  Matrix6f A = Matrix6f::Zero();
  A.diagonal() << Vector3f::Constant(1 / (kWeakTranslation * kWeakTranslation)),
      Vector3f::Constant(1 / (kWeakRotation * kWeakRotation));
  Vector6f b = Vector6f::Zero();
  for (const Vector3f& p_1 : hypothesis.p_1) {
    if (p_1.z() <= 0) continue;
    const Vector3f p = T_k1 * p_1;
    if (p.z() <= 0.05f) continue;
    const Vector2f x = p.head<2>() / p.z();
    const Vector2f flow = (apply_homography(Matrix3f::Identity() + 0.01f * rate, x) - x) / 0.01f;
    Matrix23f J_x_p;
    J_x_p << 1 / p.z(), 0, -x.x() / p.z(), 0, 1 / p.z(), -x.y() / p.z();
    const Matrix26f J = J_x_p * se3_point_jacobian(p) / kFlowNoise;
    A += J.transpose() * J;
    b += J.transpose() * (flow / kFlowNoise);
  }
  return A.ldlt().solve(b);
}

// One SE(3) pose in each hypothesis' map. True when one is left: winner_.
bool MapInitialiser::track_hypotheses(float dt_s) {
  float frame_scale = kRobustSigmaFloor;
  for (Hypothesis& hypothesis : hypotheses_) {
    if (!hypothesis.alive) continue;
    gather_pose_points(hypothesis);
    VelocityPrior prior;
    prior.mean = velocity_from_rate(H_rate_, hypothesis, hypothesis.T_c1);
    prior.sigma_translation = kPriorTranslation;
    prior.sigma_rotation = kPriorRotation;
    const PoseUpdate& update =
        pose_.run(SE3::exp(prior.mean * dt_s) * hypothesis.T_c1, prior, PosePoints(config_.camera, pose_points_));
    if (!update.ok) {
      hypothesis.alive = false;
      continue;
    }
    hypothesis.T_c1 = update.T_cw;
    hypothesis.velocity = update.velocity;
    hypothesis.sigma = update.sigma;
    frame_scale = std::max(frame_scale, std::min(update.sigma, kMaxCostScale));
  }
  // All costs at one scale, the largest: at a smaller one the worse hypothesis' errors would saturate. A point that one
  // hypothesis explains counts against those that do not, or cannot place it; one that none explains is a wrong match.
  float frame_cost[kHypotheses] = {};
  const float saturated = tukey_cost(1e12f, frame_scale);
  for (int i = 0; i < points_.size(); ++i) {
    const Point& point = points_[i];
    if (!point.found || !point.found_b) continue;
    float cost[kHypotheses];
    bool explained = false;
    for (int k = 0; k < kHypotheses; ++k) {
      const Hypothesis& hypothesis = hypotheses_[k];
      cost[k] = saturated;
      Vector2f px;
      if (!hypothesis.alive || hypothesis.p_1[i].z() <= 0) continue;
      const SE3 T = pose_at(hypothesis.T_c1, hypothesis.velocity, config_.camera.dt_s(point.px_2));
      if (!config_.camera.project(T * hypothesis.p_1[i], &px)) continue;
      cost[k] = tukey_cost((point.px_2 - px).squaredNorm() / (kSigma_px * kSigma_px), frame_scale);
      explained |= cost[k] < saturated;
    }
    for (int k = 0; k < kHypotheses; ++k)
      if (explained) frame_cost[k] += cost[k];
  }
  for (int k = 0; k < kHypotheses; ++k)
    hypotheses_[k].cost = kCostMemory * hypotheses_[k].cost + frame_cost[k] / (frame_scale * frame_scale);
  int best = -1;
  bool decided = true;
  for (int k = 0; k < kHypotheses; ++k)
    if (hypotheses_[k].alive && (best < 0 || hypotheses_[k].cost < hypotheses_[best].cost)) best = k;
  if (best < 0) {
    all_failed_ = true;
    return false;
  }
  // The plane has fewer unknowns than the general structure: where it costs hardly more it is right.
  for (int k = 0; k < kHypotheses; ++k)
    if (!hypotheses_[best].planar && hypotheses_[k].planar && hypotheses_[k].alive &&
        hypotheses_[k].cost < kPlaneCostRatio * hypotheses_[best].cost)
      best = k;
  const float ratio = std::max(kHypothesisCostRatio - kCostRatioPerFrame * static_cast<float>(frames_), kMinCostRatio);
  for (int k = 0; k < kHypotheses; ++k) {
    if (k == best || !hypotheses_[k].alive || (hypotheses_[best].planar && !hypotheses_[k].planar)) continue;
    if (hypotheses_[k].cost < ratio * hypotheses_[best].cost) decided = false;
  }
  if (!decided || frames_ < kMinHypothesisFrames || hypotheses_[best].sigma > kMaxHypothesisSigma) return false;
  winner_ = best;
  return true;
}

// The found points that the hypothesis can place, into pose_points_; of many every so-manieth, up to kMaxPosePoints.
void MapInitialiser::gather_pose_points(const Hypothesis& hypothesis) {
  const auto usable = [&](int i) { return points_[i].found && hypothesis.p_1[i].z() > 0; };
  int total = 0;
  for (int i = 0; i < points_.size(); ++i) total += usable(i);
  const int wanted = std::min(total, kMaxPosePoints);
  int seen = 0;
  pose_points_.clear();
  for (int i = 0; i < points_.size(); ++i) {
    if (!usable(i)) continue;
    ++seen;
    if (seen * wanted / total == (seen - 1) * wanted / total) continue;
    PosePoint point;
    point.p_w = hypothesis.p_1[i];
    point.found = {points_[i].px_2, kLevel};
    pose_points_.push_back(point);
  }
}

bool MapInitialiser::build(Map& map, SE3* T_cw, Vector6f* velocity) {
  PPTAM_ASSERT(winner_ >= 0 && !map.exists());
  const Hypothesis& hypothesis = hypotheses_[winner_];
  if (!add_views(hypothesis, map) || !add_points(hypothesis, map)) {
    map.clear();
    return false;
  }
  *T_cw = hypothesis.T_c1;
  *velocity = hypothesis.velocity;
  return true;
}

// Has the point a place, and two measurements?
bool MapInitialiser::usable(const Hypothesis& hypothesis, int point) const {
  int views = 0;
  for (int k = 0; k < view_count_; ++k) views += views_[k].points[point].found;
  return hypothesis.p_1[point].z() > 0 && views >= 2;
}

bool MapInitialiser::add_views(const Hypothesis& hypothesis, Map& map) {
  float depth_sum = 0;
  int count = 0;
  for (int i = 0; i < points_.size(); ++i) {
    if (!usable(hypothesis, i)) continue;
    depth_sum += hypothesis.p_1[i].z();
    ++count;
  }
  if (count < kMinMapPoints) return false;
  for (int k = 0; k < view_count_; ++k) {
    Keyframe& frame = views_[k].frame;
    frame.T_kw = k == 0 ? SE3() : hypothesis.T_c1;
    frame.velocity = k + 1 < view_count_ ? Vector6f::Zero() : hypothesis.velocity;
    frame.velocity_prior = frame.velocity;
    frame.mean_depth = depth_sum / static_cast<float>(count);
    if (map.add_keyframe(frame) < 0) return false;
  }
  return true;
}

// The usable points, with what was found of them in views and in the frames next to these.
bool MapInitialiser::add_points(const Hypothesis& hypothesis, Map& map) {
  const Neighbour* sources[2 * kMaxInitialKeyframes];
  int neighbours = 0;
  for (int k = 0; k < view_count_; ++k) {
    for (const Neighbour* neighbour : {&views_[k].before, &views_[k].after}) {
      if (!neighbour->known) continue;
      map.add_neighbour(k, neighbour->timestamp_ns);
      sources[neighbours++] = neighbour;
    }
  }
  int count = 0;
  for (int i = 0; i < points_.size(); ++i) {
    const Vector3f& p_1 = hypothesis.p_1[i];
    if (!usable(hypothesis, i)) continue;
    const bool on_plane = hypothesis.planar && std::abs(hypothesis.n_1.dot(p_1) - 1.0f) < 0.1f;
    const Vector3f normal = on_plane ? Vector3f(-hypothesis.n_1) : Vector3f(-p_1.normalized());
    const int index = map.add_point(p_1, {0, points_[i].px_1, normal});
    if (index < 0) break;
    for (int k = 0; k < view_count_; ++k)
      if (views_[k].points[i].found)
        map.add_measurement(index, {{views_[k].points[i].px, kLevel}, static_cast<int16_t>(k)});
    map.count_search(index, true);
    for (int n = 0; n < neighbours; ++n)
      if (sources[n]->points[i].found)
        map.add_neighbour_measurement(n, {index, map.points()[index].id, {sources[n]->points[i].px, kLevel}});
    ++count;
  }
  return count >= kMinMapPoints;
}

}  // namespace pptam
