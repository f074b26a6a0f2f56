#include "tracking/start_hypotheses.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "geometry/robust.h"

namespace pptam {

namespace {

// Cost ratio at which the cheaper hypothesis wins: 2 [phone 5.1]. It falls by 0.05 a frame down to 1.2, since with a
// wrong calibration no hypothesis fits well and the ratio stays under 2. The relaxation is not swept.
constexpr float kHypothesisCostRatio = 2.0f, kMinCostRatio = 1.2f, kCostRatioPerFrame = 0.05f;
// A plane wins against the general structure up to this cost ratio: it has fewer unknowns. Not swept.
constexpr float kPlaneCostRatio = 1.15f;
constexpr float kCostMemory = 0.8f;    // factor of the summed costs per frame: a memory of about five frames; not swept
constexpr float kMaxCostScale = 1.0f;  // robust scale of the costs, units of start_sigma_px(); not swept
// How far the velocity during a readout may be from that of the homography's rate, 1-sigma of each component: depths/s
// and radians/s, a hand's tremor. Not swept.
constexpr float kPriorTranslation = 0.1f;
constexpr float kPriorRotation = 0.15f;
constexpr int kMinFrames = 3;       // frames compared before a hypothesis may win; not swept
constexpr int kMaxPosePoints = 40;  // of each hypothesis' pose: three poses must fit into a frame's time; not swept
// Robust scale of the winner's residuals, units of start_sigma_px(): a right map fits to under half of it. Not
// swept.
constexpr float kMaxSigma = 1.0f;
constexpr float kMinParallax_rad = 0.01f;  // between the rays of a triangulated point: 0.6 degrees; not swept
constexpr float kUnseen = 1e12f;           // squared error, units of sigma^2, at which every cost is saturated
constexpr float kMinFlowDepth = 0.05f;     // where a point's flow is used, with the scene at about 1: guards a division
// Prior of velocity_from_rate(), 1-sigma: wide, only for directions of motion that the points do not show. Depths/s and
// radians/s. Not swept.
constexpr float kWeakTranslation = 0.5f, kWeakRotation = 0.5f;
constexpr float kFlowNoise = 0.03f;   // 1-sigma of the flow, normalised image units per second; not swept
constexpr float kFlowStep_s = 0.01f;  // difference quotient of the homography's rate

}  // namespace

StartHypotheses::StartHypotheses(Arena& arena, const Config& config, WorkMeter& meter)
    : config_(config),
      found_at_branch_(arena, config.max_initial_points),
      pose_points_(arena, kMaxPosePoints),
      pose_(arena, kMaxPosePoints, config.camera.shutter.line_time_s != 0, meter) {
  for (Hypothesis& hypothesis : hypotheses_) hypothesis.p_1 = FixedVector<Vector3f>(arena, config.max_initial_points);
}

void StartHypotheses::branch(const HomographyTracker& tracker, const Decomposition& decomposition,
                             const RelativePose* general) {
  frames_ = 0;
  for (int k = 0; k < kHypotheses; ++k) {
    Hypothesis& hypothesis = hypotheses_[k];
    hypothesis.planar = k < 2;
    hypothesis.alive = hypothesis.planar ? k < decomposition.count : general != nullptr;
    hypothesis.cost = 0;
    if (!hypothesis.alive) continue;
    SE3 T_b1 = hypothesis.planar ? decomposition.solutions[k].T_21 : general->T_21;
    if (hypothesis.planar) hypothesis.n_1 = decomposition.solutions[k].n_1;
    hypothesis.alive = triangulate_points(tracker, hypothesis, &T_b1);
    if (!hypothesis.alive) continue;
    hypothesis.T_c1 = T_b1;
    hypothesis.velocity = velocity_from_rate(tracker.rate(), hypothesis, T_b1);
  }
  found_at_branch_.clear();
  for (const TrackedPoint& point : tracker.points()) found_at_branch_.push_back(point.found);
}

// Positions of the hypothesis' points. The general hypothesis is scaled so that the scene's mean depth is 1. False when
// too few points have a position.
bool StartHypotheses::triangulate_points(const HomographyTracker& tracker, Hypothesis& hypothesis, SE3* T_b1) const {
  hypothesis.p_1.clear();
  float depth_sum = 0;
  int count = 0;
  for (const TrackedPoint& point : tracker.points()) {
    Triangulated triangulated;
    Vector3f p_1 = Vector3f::Zero();
    const Vector3f ray = point.x_1.homogeneous();
    if (hypothesis.planar && point.on_plane && hypothesis.n_1.dot(ray) > 0) {
      p_1 = ray / hypothesis.n_1.dot(ray);  // more precise than triangulation: many points share the plane
    } else if (point.found && triangulate(*T_b1, point.x_1, point.x_2, kMinParallax_rad, &triangulated)) {
      p_1 = triangulated.p_1;
    }
    hypothesis.p_1.push_back(p_1);
    depth_sum += p_1.z();
    count += p_1.z() > 0;
  }
  if (count < kMinInitialPoints) return false;
  if (hypothesis.planar) return true;
  const float scale = static_cast<float>(count) / depth_sum;  // from a baseline of 1 to a mean depth of 1
  for (Vector3f& p : hypothesis.p_1) p *= scale;
  T_b1->t *= scale;
  return true;
}

// Camera velocity whose image motion at the points is that of the homography's rate: least squares over the points
// [phone 6], with a wide prior for directions of motion that the points do not show.
Vector6f StartHypotheses::velocity_from_rate(const Matrix3f& rate, const Hypothesis& hypothesis,
                                             const SE3& T_k1) const {
  Matrix6f A = Matrix6f::Zero();
  A.diagonal() << Vector3f::Constant(1 / (kWeakTranslation * kWeakTranslation)),
      Vector3f::Constant(1 / (kWeakRotation * kWeakRotation));
  Vector6f b = Vector6f::Zero();
  for (const Vector3f& p_1 : hypothesis.p_1) {
    if (p_1.z() <= 0) continue;
    const Vector3f p = T_k1 * p_1;
    if (p.z() <= kMinFlowDepth) continue;
    const Vector2f x = p.head<2>() / p.z();
    const Vector2f flow = (apply_homography(Matrix3f::Identity() + kFlowStep_s * rate, x) - x) / kFlowStep_s;
    Matrix23f J_x_p;
    J_x_p << 1 / p.z(), 0, -x.x() / p.z(), 0, 1 / p.z(), -x.y() / p.z();
    const Matrix26f J = J_x_p * se3_point_jacobian(p) / kFlowNoise;
    A += J.transpose() * J;
    b += J.transpose() * (flow / kFlowNoise);
  }
  return A.ldlt().solve(b);
}

StartHypotheses::Outcome StartHypotheses::track(const HomographyTracker& tracker, float dt_s) {
  ++frames_;
  add_costs(tracker.points(), track_poses(tracker, dt_s));
  return decide();
}

// Tracks one SE(3) pose in each hypothesis' map. Returns the scale for all costs: the largest of the hypotheses'
// scales, since at a smaller one the errors of the worse hypothesis would saturate.
float StartHypotheses::track_poses(const HomographyTracker& tracker, float dt_s) {
  float scale = kRobustSigmaFloor;
  for (Hypothesis& hypothesis : hypotheses_) {
    if (!hypothesis.alive) continue;
    gather_pose_points(tracker.points(), hypothesis);
    VelocityPrior prior;
    prior.mean = velocity_from_rate(tracker.rate(), hypothesis, hypothesis.T_c1);
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
    scale = std::max(scale, std::min(update.sigma, kMaxCostScale));
  }
  return scale;
}

// Adds the frame's costs. A point explained by one hypothesis costs the full amount in every hypothesis that does not
// explain it or has no position for it. A point that no hypothesis explains is a wrong match and does not count.
void StartHypotheses::add_costs(std::span<const TrackedPoint> points, float scale) {
  float frame_cost[kHypotheses] = {};
  const float saturated = tukey_cost(kUnseen, scale), start_sigma = start_sigma_px(config_);
  for (int i = 0; i < static_cast<int>(points.size()); ++i) {
    const TrackedPoint& point = points[static_cast<size_t>(i)];
    if (!point.found || !found_at_branch_[i]) continue;
    float cost[kHypotheses];
    bool explained = false;
    for (int k = 0; k < kHypotheses; ++k) {
      const Hypothesis& hypothesis = hypotheses_[k];
      cost[k] = saturated;
      Vector2f px;
      if (!hypothesis.alive || hypothesis.p_1[i].z() <= 0) continue;
      const SE3 T = pose_at(hypothesis.T_c1, hypothesis.velocity, config_.camera.dt_s(point.px_2));
      if (!config_.camera.project(T * hypothesis.p_1[i], &px)) continue;
      cost[k] = tukey_cost((point.px_2 - px).squaredNorm() / (start_sigma * start_sigma), scale);
      explained |= cost[k] < saturated;
    }
    for (int k = 0; k < kHypotheses; ++k)
      if (explained) frame_cost[k] += cost[k];
  }
  for (int k = 0; k < kHypotheses; ++k)
    hypotheses_[k].cost = kCostMemory * hypotheses_[k].cost + frame_cost[k] / (scale * scale);
}

StartHypotheses::Outcome StartHypotheses::decide() {
  int best = -1;
  for (int k = 0; k < kHypotheses; ++k)
    if (hypotheses_[k].alive && (best < 0 || hypotheses_[k].cost < hypotheses_[best].cost)) best = k;
  if (best < 0) return Outcome::kNoneLeft;
  // Prefers the plane up to kPlaneCostRatio.
  for (int k = 0; k < kHypotheses; ++k)
    if (!hypotheses_[best].planar && hypotheses_[k].planar && hypotheses_[k].alive &&
        hypotheses_[k].cost < kPlaneCostRatio * hypotheses_[best].cost)
      best = k;
  const float ratio = std::max(kHypothesisCostRatio - kCostRatioPerFrame * static_cast<float>(frames_), kMinCostRatio);
  for (int k = 0; k < kHypotheses; ++k) {
    if (k == best || !hypotheses_[k].alive || (hypotheses_[best].planar && !hypotheses_[k].planar)) continue;
    if (hypotheses_[k].cost < ratio * hypotheses_[best].cost) return Outcome::kUndecided;
  }
  if (frames_ < kMinFrames || hypotheses_[best].sigma > kMaxSigma) return Outcome::kUndecided;
  winner_ = best;
  return Outcome::kDecided;
}

// Fills pose_points_ with found points that have a position in the hypothesis: evenly spaced among them, up to
// kMaxPosePoints.
void StartHypotheses::gather_pose_points(std::span<const TrackedPoint> points, const Hypothesis& hypothesis) {
  const int count = static_cast<int>(points.size());
  const auto usable = [&](int i) { return points[static_cast<size_t>(i)].found && hypothesis.p_1[i].z() > 0; };
  int total = 0;
  for (int i = 0; i < count; ++i) total += usable(i);
  const int wanted = std::min(total, kMaxPosePoints);
  int seen = 0;
  pose_points_.clear();
  for (int i = 0; i < count; ++i) {
    if (!usable(i)) continue;
    ++seen;
    if (seen * wanted / total == (seen - 1) * wanted / total) continue;
    pose_points_.push_back({hypothesis.p_1[i], {points[static_cast<size_t>(i)].px_2, start_level(config_)}});
  }
}

}  // namespace pptam
