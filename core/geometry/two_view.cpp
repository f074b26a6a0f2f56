#include "geometry/two_view.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "base/deterministic_math.h"

namespace pptam {

// Unknowns (u, v, q): the point is (u, v, 1) / q in the first frame, with q in units of 1 / |t|, so that all three have
// the size of image coordinates. It projects to (u, v) in the first view and, with w = R (u, v, 1) + q t, to w / w.z in
// the second.
bool triangulate(const SE3& T_21, const Vector2f& x1, const Vector2f& x2, float min_parallax_rad, Triangulated* out) {
  constexpr int kSteps = 4;
  const float baseline = std::sqrt(T_21.t.dot(T_21.t));
  if (!(baseline > 0.0f)) return false;
  const Vector3f t = T_21.t / baseline;
  const Vector3f ray_1 = T_21.R * x1.homogeneous();
  const Vector3f ray_2 = x2.homogeneous();
  const Vector3f normal = ray_1.cross(ray_2);
  const float parallax = det_atan2(std::sqrt(normal.dot(normal)), ray_1.dot(ray_2));
  if (!(parallax > min_parallax_rad)) return false;

  // Linear start: x2 w.z = (w.x, w.y) is a + q b = 0 in two rows.
  const Vector2f a = x2 * ray_1.z() - ray_1.head<2>();
  const Vector2f b = x2 * t.z() - t.head<2>();
  float u = x1.x();
  float v = x1.y();
  float q = -a.dot(b) / b.dot(b);

  Vector2f J_q = Vector2f::Zero();
  for (int step = 0;; ++step) {
    const Vector3f w = T_21.R * Vector3f(u, v, 1.0f) + q * t;
    if (!(w.z() > 0.0f) || !(q > 0.0f)) return false;
    const Vector2f y(w.x() / w.z(), w.y() / w.z());
    // d(y)/d(u, v, q) = [I, -y] / w.z * [R.col(0), R.col(1), t].
    Matrix23f J;
    for (int row = 0; row < 2; ++row) {
      J(row, 0) = (T_21.R(row, 0) - y(row) * T_21.R(2, 0)) / w.z();
      J(row, 1) = (T_21.R(row, 1) - y(row) * T_21.R(2, 1)) / w.z();
      J(row, 2) = (t(row) - y(row) * t.z()) / w.z();
    }
    J_q = J.col(2);
    if (step == kSteps) break;
    const Vector2f error_2 = x2 - y;
    Matrix3f A = J.transpose() * J;
    A(0, 0) += 1.0f;
    A(1, 1) += 1.0f;
    Vector3f g = J.transpose() * error_2;
    g(0) += x1.x() - u;
    g(1) += x1.y() - v;
    // A x = g by Cramer's rule; A is well scaled unless the point lies on the baseline.
    const Vector3f c12 = A.col(1).cross(A.col(2));
    const float determinant = A.col(0).dot(c12);
    if (!(determinant > 0.0f)) return false;
    u += g.dot(c12) / determinant;
    v += A.col(0).dot(g.cross(A.col(2))) / determinant;
    q += A.col(0).dot(A.col(1).cross(g)) / determinant;
  }
  const float slope = std::sqrt(J_q.dot(J_q)) * baseline;
  const float z = baseline / q;
  // Beyond a million baselines either way it is no measurement; this also catches absurd image coordinates.
  if (!(q > 1e-6f) || !(q < 1e6f) || !(slope > 0.0f)) return false;
  out->p_1 = Vector3f(u * z, v * z, z);
  out->parallax_rad = parallax;
  out->sigma_inverse_depth = 1.0f / slope;
  return true;
}

namespace {

// Tukey cut-off for one-dimensional residuals, 95 % efficient, and the median's factor to sigma.
constexpr float kCutoff1d = 4.685f;
constexpr float kMedianToSigma = 1.4826f;
constexpr float kConverged_rad = 1e-5f;  // step in rotation and direction: under 0.01 px at a focal length of 1000

// Depths of the midpoint between both rays have the same signs as those of the true point.
bool in_front(const SE3& T_21, const Correspondence& c) {
  const Vector3f a = T_21.R * c.x1.homogeneous();
  const Vector3f b = c.x2.homogeneous();
  // z1 a + t = z2 b in the least-squares sense.
  const float aa = a.dot(a), bb = b.dot(b), ab = a.dot(b), at = a.dot(T_21.t), bt = b.dot(T_21.t);
  const float det = aa * bb - ab * ab;
  return det > 0 && ab * bt - bb * at > 0 && aa * bt - ab * at > 0;
}

}  // namespace

RelativePose refine_relative_pose(std::span<const Correspondence> correspondences, const SE3& T_start, int steps,
                                  float sigma_floor, std::span<float> scratch) {
  using Matrix5f = Eigen::Matrix<float, 5, 5>;
  using Vector5f = Eigen::Matrix<float, 5, 1>;
  RelativePose result;
  result.T_21 = T_start;
  const float norm = T_start.t.norm();
  const size_t count = std::min(correspondences.size(), scratch.size());
  if (!(norm > 0) || count < 8) return result;
  Matrix3f R = T_start.R;
  Vector3f t = T_start.t / norm;
  bool converged = false;
  for (int step = 0;; ++step) {
    ++result.steps;
    // Tangents of the sphere at t.
    const Vector3f axis = std::abs(t.x()) < 0.7f ? Vector3f::UnitX() : Vector3f::UnitY();
    const Vector3f u = t.cross(axis).normalized();
    const Vector3f v = t.cross(u);
    const Matrix3f E = hat(t) * R;
    const auto distance = [&E](const Correspondence& c, float* scale) {
      const Vector3f l2 = E * c.x1.homogeneous();
      const Vector3f l1 = E.transpose() * c.x2.homogeneous();
      const float gradient_sq = l2.head<2>().squaredNorm() + l1.head<2>().squaredNorm();
      *scale = gradient_sq > 1e-20f ? 1.0f / std::sqrt(gradient_sq) : 0.0f;
      return c.x2.homogeneous().dot(l2) * *scale;
    };
    for (size_t i = 0; i < count; ++i) {
      float scale;
      scratch[i] = std::abs(distance(correspondences[i], &scale));
    }
    const auto middle = scratch.begin() + static_cast<long>(count / 2);
    std::nth_element(scratch.begin(), middle, scratch.begin() + static_cast<long>(count));
    result.sigma = kMedianToSigma * *middle;
    const float cutoff = kCutoff1d * std::max(result.sigma, sigma_floor);
    const float cutoff_sq = cutoff * cutoff;
    Matrix5f A = Matrix5f::Zero();
    Vector5f b = Vector5f::Zero();
    float cost = 0;
    int inliers = 0;
    for (size_t i = 0; i < count; ++i) {
      const Correspondence& c = correspondences[i];
      float scale;
      const float e = distance(c, &scale);
      const float a_sq = 1.0f - e * e / cutoff_sq;
      cost += a_sq > 0 ? 1.0f - a_sq * a_sq * a_sq : 1.0f;
      if (!(a_sq > 0)) continue;
      ++inliers;
      const float weight = a_sq * a_sq;
      // e = x2 . (t x a), a = R x1; de/dt = a x x2, de/dw = a x (x2 x t); the scale's derivative is of second order.
      const Vector3f a = R * c.x1.homogeneous();
      const Vector3f x2 = c.x2.homogeneous();
      const Vector3f de_dt = a.cross(x2) * scale;
      const Vector3f de_dw = a.cross(x2.cross(t)) * scale;
      Vector5f J;
      J << de_dw, de_dt.dot(u), de_dt.dot(v);
      A += (weight * J) * J.transpose();
      b -= (weight * e) * J;
    }
    result.cost = cost * kCutoff1d * kCutoff1d / 6.0f;
    if (inliers < 8) return result;
    if (!(A.diagonal().minCoeff() > 0)) return result;
    const Vector5f unit = A.diagonal().cwiseSqrt().cwiseInverse();
    A = (unit.asDiagonal() * A * unit.asDiagonal()).eval();
    const Eigen::LDLT<Matrix5f> ldlt(A);
    if (ldlt.info() != Eigen::Success || !(ldlt.vectorD().minCoeff() > 1e-7f)) return result;
    if (step == steps || converged) {
      const float noise = std::max(result.sigma, sigma_floor);
      const Matrix5f inverse = ldlt.solve(Matrix5f::Identity());
      Matrix2f covariance = inverse.bottomRightCorner<2, 2>();
      covariance = (unit.tail<2>().asDiagonal() * covariance * unit.tail<2>().asDiagonal()).eval() * noise * noise;
      const float half = 0.5f * (covariance(0, 0) + covariance(1, 1));
      const float difference = 0.5f * (covariance(0, 0) - covariance(1, 1));
      result.sigma_t_rad = std::sqrt(half + std::sqrt(difference * difference + covariance(0, 1) * covariance(0, 1)));
      break;
    }
    const Vector5f delta = unit.cwiseProduct(ldlt.solve(unit.cwiseProduct(b)));
    if (!delta.allFinite()) return result;
    // Half a radian at most: far from the minimum the linearisation is worthless.
    const float size = delta.norm();
    const Vector5f bounded = size > 0.5f ? Vector5f(delta * (0.5f / size)) : delta;
    R = orthonormalised(so3_exp(bounded.head<3>()) * R);
    t = (t + bounded[3] * u + bounded[4] * v).normalized();
    converged = size < kConverged_rad;
  }
  int front = 0, behind = 0;
  for (size_t i = 0; i < count; ++i) {
    float scale;
    const Vector3f l2 = hat(t) * (R * correspondences[i].x1.homogeneous());
    const Vector3f l1 = R.transpose() * (hat(t).transpose() * correspondences[i].x2.homogeneous());
    scale = l2.head<2>().squaredNorm() + l1.head<2>().squaredNorm();
    const float e = correspondences[i].x2.homogeneous().dot(l2);
    const float cutoff = kCutoff1d * std::max(result.sigma, sigma_floor);
    if (!(e * e < cutoff * cutoff * scale)) continue;
    front += in_front({R, t}, correspondences[i]);
    behind += in_front({R, -t}, correspondences[i]);
  }
  result.T_21 = front >= behind ? SE3(R, t) : SE3(R, -t);
  result.inliers = std::max(front, behind);
  result.ok = result.inliers >= 8 && result.T_21.R.allFinite() && result.T_21.t.allFinite() &&
              std::isfinite(result.sigma_t_rad);
  return result;
}

}  // namespace pptam
