#include "tracking/homography_tracker.h"

#include <Eigen/LU>
#include <algorithm>

namespace pptam {

namespace {

// Corners that a first view must have: fewer cannot constrain 8 parameters well once some are lost. With 25 bare tables
// start no worse and no better: how well the plane's normal is known decides.
constexpr int kMinCorners = 14;
constexpr float kMinFoundFraction = 0.3f;  // found points among those searched, a ratio; not swept
constexpr int kMinInliers = 10;         // found points without which no fit is tried, as in fit_homography(); not swept
constexpr float kResidualDecay = 0.7f;  // factor of a point's offset from H, per frame without a match; not swept
// Corners of the first view from which on no weaker ones are added. Not swept.
constexpr int kEnoughCorners = 50;
// Points searched in a frame, in turns. Each costs about 45 thousand ARMv6 instructions of the 6 million that a frame
// may take.
constexpr int kSearchesPerFrame = 85;
// A point rests within this distance of its place in the first view, level-0 px: twice the noise of a measurement; and
// the share of such points, a ratio, from which on the camera stands. Not swept.
constexpr float kRest_px = 0.8f;
constexpr float kMaxRestingShare = 0.2f;
// Share of the points looked for that are missed where the motion puts them and found at rest, from which on the
// scene rests, a ratio: in 113 emulated starts it is at most 0.024, in eleven recorded ones at most 0.098; in those of
// a thing that moves before a resting camera 0.10 to 0.31 emulated, and recorded 0.07 to 0.22, but for one frame.
constexpr float kMaxMissedAtRest = 0.1f;
// From this share of such points on, those that are found at rest count too, to kMaxRestingShare, if this share of the
// found points has moved so far, level-0 px: the motion fits the thing and some of the scene. Not swept.
constexpr float kMinMissedAtRest = 0.05f, kMovedShare = 0.25f, kMoved_px = 30.0f;
// Radius of their search, pixels of the level searched: the hand's tremor; and SearchOptions::max_relative_zmssd,
// strict, since what moves away uncovers anything. Not swept.
constexpr float kRestRadius_px = 3.0f, kRestZmssd = 0.2f;
// Homogeneous coordinate under which H cannot place a point, a ratio. Not swept.
constexpr float kMinPlacedDepth = 0.1f;
// ARMv6, as counted: a point's prediction and what its search takes besides what is charged there; a measurement
// corrected for the shutter; an iteration of the fit besides its points.
constexpr int64_t kPointInstructions = 700, kCorrectedInstructions = 170, kFitStepInstructions = 7000;

// log of a matrix near the identity, second order; the trace is removed, so that the result is in sl(3).
Matrix3f log_near_identity(const Matrix3f& M) {
  const Matrix3f D = M - Matrix3f::Identity();
  Matrix3f L = D - 0.5f * (D * D);
  L -= Matrix3f::Identity() * (L.trace() / 3.0f);
  return L;
}

}  // namespace

HomographyTracker::HomographyTracker(Arena& arena, const Config& config, WorkMeter& meter, CornerSource* corner_source)
    : config_(config),
      meter_(meter),
      corner_source_(corner_source),
      corners_(arena, config.max_initial_points),
      points_(arena, config.max_initial_points),
      squared_(arena, config.max_initial_points),
      weights_(arena, config.max_initial_points),
      correspondences_(arena, config.max_initial_points),
      inlier_rays_(arena, config.max_initial_points),
      observed_(arena, config.max_initial_points) {}

bool HomographyTracker::start(const Pyramid& first_view, const Vector3f& rotation_rate) {
  corners_.resize(corners_.capacity());
  const int count = corner_source_->detect(first_view, corners_, kEnoughCorners);
  if (count < kMinCorners) return false;
  reset();
  for (int i = 0; i < count; ++i) {
    TrackedPoint point;
    point.px_1 = corners_[i].px();
    point.x_1 = corrected(point.px_1, hat(rotation_rate));
    Vector2f px;
    Matrix23f J;
    if (!config_.camera.project({point.x_1.x(), point.x_1.y(), 1.0f}, &px, &J)) continue;
    point.J_1 = J.leftCols<2>();
    point.px_2 = point.px_1;
    point.found = true;
    points_.push_back(point);
  }
  H_.setIdentity();
  H_rate_.setZero();
  parallax_rate_.setZero();
  next_search_ = 0;
  return true;
}

void HomographyTracker::reset() {
  points_.clear();
  observed_.clear();
}

int HomographyTracker::searched_at_once() const {
  return std::min(points_.size(), kSearchesPerFrame);
}

std::span<const Vector2f> HomographyTracker::inlier_rays() {
  inlier_rays_.clear();
  for (const TrackedPoint& point : points_)
    if (point.weight > 0) inlier_rays_.push_back(point.x_1);
  return inlier_rays_;
}

std::span<const Correspondence> HomographyTracker::correspondences() {
  correspondences_.clear();
  for (const TrackedPoint& point : points_)
    if (point.found) correspondences_.push_back({point.x_1, point.x_2});
  return correspondences_;
}

// Normalised point of pixel px as a global shutter would have seen it, in an image that moves at `rate`, 1/s.
Vector2f HomographyTracker::corrected(const Vector2f& px, const Matrix3f& rate) const {
  Vector2f x = config_.camera.unproject(px);
  const float dt_s = config_.camera.dt_s(px);
  if (dt_s == 0) return x;
  return apply_homography(Matrix3f::Identity() - dt_s * rate, x);
}

void HomographyTracker::correct(const Matrix3f& rate) {
  for (TrackedPoint& point : points_)
    if (point.found) point.x_2 = corrected(point.px_2, rate);
  meter_.charge(Work::kOther, kCorrectedInstructions * found_);
}

bool HomographyTracker::camera_stands() const {
  int resting = 0;
  const float rest_px = kRest_px * config_.px_scale();
  for (const TrackedPoint& point : points_) resting += point.found && point.farthest_sq < rest_px * rest_px;
  return static_cast<float>(resting) > kMaxRestingShare * static_cast<float>(found_);
}

bool HomographyTracker::scene_rests(const Pyramid& first_view, const Pyramid& pyramid, const SearchOptions& options) {
  SearchOptions at_rest = options;
  at_rest.radius_px = kRestRadius_px;
  at_rest.max_relative_zmssd = kRestZmssd;
  at_rest.refine = false;
  int turns = 0, searches = 0, resting = 0, found_at_rest = 0, moved = 0;
  const float rest_px = kRestRadius_px * static_cast<float>(1 << options.level);
  const float moved_px = kMoved_px * config_.px_scale();
  for (const TrackedPoint& point : points_) {
    PatchTemplate patch;
    ImagePoint at;
    turns += point.had_turn;
    if (point.found) {
      const float shift_sq = (point.px_2 - point.px_1).squaredNorm();
      found_at_rest += shift_sq < rest_px * rest_px;
      moved += shift_sq > moved_px * moved_px;
    } else if (point.had_turn && searches < kSearchesPerFrame) {
      ++searches;
      meter_.charge(Work::kPatchWarp, 1);
      resting += warp_template(first_view, point.px_1, Matrix2f::Identity(), options.level, &patch) &&
                 find_template(pyramid, patch, point.px_1, at_rest, meter_, &at) == SearchOutcome::kFound;
    }
  }
  const auto share = [&](int count) { return static_cast<float>(count) / static_cast<float>(turns); };
  if (share(resting) > kMaxMissedAtRest) return true;
  return share(resting) > kMinMissedAtRest && share(resting + found_at_rest) > kMaxRestingShare &&
         static_cast<float>(moved) > kMovedShare * static_cast<float>(found_);
}

bool HomographyTracker::track(const Pyramid& first_view, const Pyramid& pyramid, float dt_s, const Matrix3f& R_cp,
                              const SearchOptions& options) {
  // Prediction: the rotation seen by the full frame, and the last frame's parallax continued.
  const Matrix3f motion = (Matrix3f::Identity() + dt_s * parallax_rate_) * R_cp;
  const Matrix3f H_previous = H_, H_predicted = motion * H_;
  const Matrix3f predicted_rate = log_near_identity(motion) / dt_s;
  search(first_view, pyramid, H_predicted, predicted_rate, options);
  correct(predicted_rate);
  bool good = found_ >= kMinInliers &&
              static_cast<float>(found_) >= kMinFoundFraction * static_cast<float>(attempted_) && fit(H_predicted);
  if (good) {
    // Second fit, with measurements corrected by H's own rate in place of the predicted one.
    H_rate_ = log_near_identity(H_ * H_previous.inverse()) / dt_s;
    parallax_rate_ = H_rate_ - log_near_identity(R_cp) / dt_s;
    correct(H_rate_);
    good = fit(H_);
  }
  for (TrackedPoint& point : points_) {
    if (point.found) point.farthest_sq = std::max(point.farthest_sq, (point.px_2 - point.px_1).squaredNorm());
    if (good && point.found) {
      point.residual = point.x_2 - apply_homography(H_, point.x_1);
      point.on_plane = point.weight > 0;
    } else {
      point.residual *= kResidualDecay;
    }
  }
  if (good) return true;
  H_ = R_cp * H_previous;
  parallax_rate_.setZero();
  return false;
}

// px: predicted position, level-0 pixels. A: warp of the point's patch there. False where H cannot place the point in
// the image.
bool HomographyTracker::predict(const TrackedPoint& point, const Matrix3f& H_predicted, const Matrix3f& rate,
                                Vector2f* px, Matrix2f* A) const {
  if (homography_depth(H_predicted, point.x_1) <= kMinPlacedDepth) return false;
  const Vector2f x = apply_homography(H_predicted, point.x_1) + point.residual;
  Matrix23f J;
  if (!config_.camera.project({x.x(), x.y(), 1.0f}, px, &J)) return false;
  const float dt_s = config_.camera.dt_s(*px);
  if (dt_s != 0) {
    const Vector2f moved = apply_homography(Matrix3f::Identity() + dt_s * rate, x);
    *px += J.leftCols<2>() * (moved - x);
  }
  if (!config_.camera.in_image(*px, search_border_px(config_))) return false;
  *A = J.leftCols<2>() * homography_point_jacobian(H_predicted, point.x_1) * point.J_1.inverse();
  return true;
}

void HomographyTracker::search(const Pyramid& first_view, const Pyramid& pyramid, const Matrix3f& H_predicted,
                               const Matrix3f& rate, const SearchOptions& options) {
  observed_.clear();
  attempted_ = found_ = 0;
  for (TrackedPoint& point : points_) {
    point.had_turn = point.found = false;
    point.weight = 0;
  }
  const int count = points_.size();
  const int first = next_search_;
  for (int step = 0; step < count && attempted_ < kSearchesPerFrame; ++step) {
    next_search_ = (first + step + 1) % count;
    TrackedPoint& point = points_[(first + step) % count];
    point.had_turn = true;
    Vector2f px;
    Matrix2f A;
    meter_.charge(Work::kOther, kPointInstructions);
    if (!predict(point, H_predicted, rate, &px, &A)) continue;
    PatchTemplate patch;
    meter_.charge(Work::kPatchWarp, 1);
    if (!warp_template(first_view, point.px_1, A, options.level, &patch)) continue;
    ImagePoint at;
    const SearchOutcome outcome = find_template(pyramid, patch, px, options, meter_, &at);
    if (outcome == SearchOutcome::kNotVisible) continue;
    ++attempted_;
    ObservedPoint observed;
    observed.predicted_px = px;
    observed.px = px;
    observed.level = static_cast<uint8_t>(options.level);
    if (outcome == SearchOutcome::kFound) {
      ++found_;
      point.found = true;
      point.px_2 = at.px;
      observed.px = at.px;
      observed.predicted_px = point.px_1;
      observed.kind = ObservedKind::kInitial;
    }
    observed_.push_back(observed);
  }
}

// Fits H to the found points.
bool HomographyTracker::fit(const Matrix3f& H_start) {
  const std::span<const Correspondence> found = correspondences();
  weights_.resize(static_cast<int>(found.size()));
  squared_.resize(static_cast<int>(found.size()));
  const HomographyFit fit =
      fit_homography(found, H_start, start_sigma_px(config_) / config_.camera.model.fx, weights_, squared_);
  meter_.charge(Work::kHomographyPoint, fit.iterations * static_cast<int64_t>(found.size()));
  meter_.charge(Work::kOther, kFitStepInstructions * fit.iterations);
  const float* weight = weights_.data();
  for (TrackedPoint& point : points_) point.weight = point.found ? *weight++ : 0.0f;
  sigma_px_ = start_sigma_px(config_) * fit.sigma;
  if (fit.ok) H_ = fit.H;
  return fit.ok;
}

}  // namespace pptam
