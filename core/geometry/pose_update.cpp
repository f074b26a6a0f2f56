#include "geometry/pose_update.h"

#include <Eigen/Cholesky>
#include <cmath>

#include "geometry/robust.h"

namespace pptam {

namespace {

constexpr int kIterations = 10;
constexpr int kMaxPoints = 256;  // more are left out
constexpr int kMinInliers = 6;
// Squared steps, radians and scene depths.
constexpr float kConverged = 1e-10f;  // 0.004 px on the phone
constexpr float kMaxStep = 0.5f;      // more comes from garbage
// Smallest pivot of the system scaled to a unit diagonal: a hundred times float32's rounding.
constexpr float kMinPivot = 1e-5f;

using Matrix12f = Eigen::Matrix<float, 12, 12>;
using Vector12f = Eigen::Matrix<float, 12, 1>;

}  // namespace

bool project_rolling(const CameraModel& camera, const RollingShutter& shutter, const SE3& T_cw,
                     const Vector6f& velocity, const Vector3f& p_w, Vector2f* px, SE3* T_line) {
  *T_line = T_cw;
  if (!camera.project(T_cw * p_w, px)) return false;
  if (shutter.line_time_s == 0) return true;
  for (int pass = 0; pass < 2; ++pass) {
    *T_line = pose_at(T_cw, velocity, shutter.dt_s(*px, camera.width, camera.height));
    if (!camera.project(*T_line * p_w, px)) return false;
  }
  return true;
}

PoseUpdate update_pose(const CameraModel& camera, const RollingShutter& shutter, const SE3& T_start,
                       const VelocityPrior& prior, std::span<PosePoint> points, float sigma_floor, WorkMeter& meter) {
  PoseUpdate result;
  result.T_cw = T_start;
  result.velocity = prior.mean;
  const int count = std::min<int>(static_cast<int>(points.size()), kMaxPoints);
  if (count < kMinInliers) return result;
  const bool estimate_velocity = shutter.line_time_s != 0 && prior.sigma_rotation > 0;

  float squared[kMaxPoints];
  Vector2f error[kMaxPoints];
  Matrix26f J[kMaxPoints];
  float dt_s[kMaxPoints];
  SE3 T = T_start;
  Vector6f velocity = prior.mean;
  bool last_pass = false;
  for (int iteration = 0; iteration <= kIterations; ++iteration) {
    meter.charge(Work::kPosePoint, count);
    int valid = 0;
    float depth_sum = 0;
    for (int i = 0; i < count; ++i) {
      PosePoint& point = points[i];
      dt_s[i] = shutter.dt_s(point.px, camera.width, camera.height);
      const Vector3f p_c = pose_at(T, velocity, dt_s[i]) * point.p_w;
      Vector2f px;
      Matrix23f J_px_p;
      if (!camera.project(p_c, &px, &J_px_p)) {
        point.error_sq = 1e12f;
        J[i].setZero();
        error[i].setZero();
        continue;
      }
      error[i] = (point.px - px) / point.sigma;
      J[i] = J_px_p * se3_point_jacobian(p_c) / point.sigma;
      point.error_sq = error[i].squaredNorm();
      squared[valid] = point.error_sq;
      ++valid;
      depth_sum += p_c.z();
    }
    if (valid < kMinInliers) return result;
    result.sigma = std::max(robust_sigma({squared, static_cast<size_t>(valid)}), sigma_floor);
    const float mean_depth = depth_sum / static_cast<float>(valid);

    Matrix6f A = Matrix6f::Zero(), A_dt = Matrix6f::Zero(), A_dt2 = Matrix6f::Zero();
    Vector6f b = Vector6f::Zero(), b_dt = Vector6f::Zero();
    int inliers = 0;
    float cost = 0;
    for (int i = 0; i < count; ++i) {
      PosePoint& point = points[i];
      point.weight = tukey_weight(point.error_sq, result.sigma);
      cost += tukey_cost(point.error_sq, result.sigma);
      if (point.weight == 0) continue;
      ++inliers;
      const Matrix6f JtJ = point.weight * (J[i].transpose() * J[i]);
      const Vector6f Jte = point.weight * (J[i].transpose() * error[i]);
      A += JtJ;
      b += Jte;
      if (estimate_velocity) {
        A_dt += dt_s[i] * JtJ;
        A_dt2 += (dt_s[i] * dt_s[i]) * JtJ;
        b_dt += dt_s[i] * Jte;
      }
    }
    result.cost = cost;
    result.inliers = inliers;
    if (inliers < kMinInliers) return result;

    const float noise = result.sigma * result.sigma;
    Matrix12f H = Matrix12f::Identity();
    Vector12f g = Vector12f::Zero();
    H.topLeftCorner<6, 6>() = A / noise;
    g.head<6>() = b / noise;
    if (estimate_velocity) {
      Vector6f prior_information;
      prior_information << Vector3f::Constant(1.0f / (prior.sigma_translation * prior.sigma_translation)),
          Vector3f::Constant(1.0f / (prior.sigma_rotation * prior.sigma_rotation));
      H.topRightCorner<6, 6>() = A_dt / noise;
      H.bottomLeftCorner<6, 6>() = A_dt / noise;
      H.bottomRightCorner<6, 6>() = A_dt2 / noise;
      H.bottomRightCorner<6, 6>().diagonal() += prior_information;
      g.tail<6>() = b_dt / noise + prior_information.cwiseProduct(prior.mean - velocity);
    }
    // Scaled to a unit diagonal, which keeps the system within float32 and makes the pivots tell its conditioning.
    if (!(H.diagonal().minCoeff() > 0)) return result;
    const Vector12f unit = H.diagonal().cwiseSqrt().cwiseInverse();
    H = unit.asDiagonal() * H * unit.asDiagonal();
    g = unit.cwiseProduct(g);
    const Eigen::LDLT<Matrix12f> ldlt(H);
    if (ldlt.info() != Eigen::Success || !(ldlt.vectorD().minCoeff() > kMinPivot)) return result;
    if (last_pass || iteration == kIterations) {
      const Matrix12f inverse = ldlt.solve(Matrix12f::Identity());
      const Vector6f u = unit.head<6>();
      result.covariance = u.asDiagonal() * inverse.topLeftCorner<6, 6>() * u.asDiagonal();
      result.T_cw = {orthonormalised(T.R), T.t};
      result.velocity = velocity;
      result.ok = result.T_cw.t.allFinite() && result.T_cw.R.allFinite() && result.covariance.allFinite();
      if (!result.ok) result.T_cw = T_start;
      return result;
    }
    const Vector12f step = unit.cwiseProduct(ldlt.solve(g));
    if (!step.allFinite()) return result;
    const float size = step.head<3>().squaredNorm() / (mean_depth * mean_depth) + step.segment<3>(3).squaredNorm();
    if (size > kMaxStep) return result;
    last_pass = iteration >= 3 && size < kConverged;
    T = SE3::exp(step.head<6>()) * T;
    if (estimate_velocity) velocity += step.tail<6>();
  }
  return result;
}

}  // namespace pptam
