#include "geometry/two_view.h"

#include <algorithm>
#include <cmath>

#include "base/deterministic_math.h"
#include "geometry/normal_equations.h"
#include "geometry/robust.h"

namespace pptam {

// Unknowns (u, v, q): the point is (u, v, 1) / q in the first frame, with q in units of 1 / |t|, so that all three have
// the size of image coordinates. It projects to (u, v) in the first view and, with w = R (u, v, 1) + q t, to w / w.z in
// the second.
bool triangulate(const SE3& T_21, const Vector2f& x1, const Vector2f& x2, float min_parallax_rad, Triangulated* out) {
  constexpr int kSteps = 4;  // Gauss-Newton steps; not swept
  // Inverse depths, 1 / |t|. Beyond a million baselines either way it is no measurement; this also rejects absurd image
  // coordinates. Not swept.
  constexpr float kMinInverseDepth = 1e-6f;
  constexpr float kMaxInverseDepth = 1e6f;
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
  if (!(q > kMinInverseDepth) || !(q < kMaxInverseDepth) || !(slope > 0.0f)) return false;
  out->p_1 = Vector3f(u * z, v * z, z);
  out->parallax_rad = parallax;
  out->sigma_inverse_depth = 1.0f / slope;
  return true;
}

namespace {

constexpr float kMaxStep = 0.5f;  // radians; longer steps are shortened, as the linearisation is local. Not swept
constexpr float kConverged_rad = 1e-5f;  // radians of rotation and direction: 0.01 px at a focal length of 1000 px
constexpr float kMinPivot = 1e-7f;  // ratio (NormalEquations): float32's rounding, as t is often barely constrained
constexpr int kMinInliers = 8;      // points, for five unknowns; not swept
constexpr float kMinGradientSq = 1e-20f;  // of x2^T E x1, below which the distance is taken as 0; not swept
constexpr float kMaxAxisCosine = 0.7f;    // t's tangents are made from the x axis unless t is within 45 degrees of it

// Whether the point lies in front of both cameras. The depths of the midpoint between both rays have the same signs as
// those of the true point.
bool in_front(const SE3& T_21, const Correspondence& c) {
  const Vector3f a = T_21.R * c.x1.homogeneous();
  const Vector3f b = c.x2.homogeneous();
  // z1 a + t = z2 b in the least-squares sense.
  const float aa = a.dot(a), bb = b.dot(b), ab = a.dot(b), at = a.dot(T_21.t), bt = b.dot(T_21.t);
  const float det = aa * bb - ab * ab;
  return det > 0 && ab * bt - bb * at > 0 && aa * bt - ab * at > 0;
}

// Robust fit of rotation and direction of translation to Sampson distances, for RobustFit.
struct EpipolarFit {
  static constexpr int kUnknowns = 5;
  std::span<const Correspondence> correspondences;
  std::span<float> squared;
  int steps;
  float sigma_floor;
  Matrix3f R;
  Vector3f t;  // unit
  RelativePose result;

  Matrix3f E;
  Vector3f u, v;  // tangents of the sphere at t
  NormalEquations<kUnknowns> equations;
  Tukey tukey{1};
  int inliers = 0;
  float cost = 0;
  bool moved_little = false;

  // Sampson distance, signed. *inverse_gradient: 1 / |d(x2^T E x1)/d(x1, x2)|, by which the algebraic error becomes a
  // distance; 0 where there is no gradient.
  float distance(const Correspondence& c, float* inverse_gradient) const {
    const Vector3f l2 = E * c.x1.homogeneous();
    const Vector3f l1 = E.transpose() * c.x2.homogeneous();
    const float gradient_sq = l2.head<2>().squaredNorm() + l1.head<2>().squaredNorm();
    *inverse_gradient = gradient_sq > kMinGradientSq ? 1.0f / std::sqrt(gradient_sq) : 0.0f;
    return c.x2.homogeneous().dot(l2) * *inverse_gradient;
  }

  bool errors(int) {
    ++result.steps;
    const Vector3f axis = std::abs(t.x()) < kMaxAxisCosine ? Vector3f::UnitX() : Vector3f::UnitY();
    u = t.cross(axis).normalized();
    v = t.cross(u);
    E = hat(t) * R;
    for (size_t i = 0; i < correspondences.size(); ++i) {
      float inverse_gradient;
      const float e = distance(correspondences[i], &inverse_gradient);
      squared[i] = e * e;
    }
    return true;
  }
  void scale() {
    result.sigma = robust_sigma_1d(squared);
    tukey = Tukey(std::max(result.sigma, sigma_floor), kTukeyCutoff1d);
    equations.clear();
    inliers = 0;
    cost = 0;
  }
  int residuals() const { return static_cast<int>(correspondences.size()); }
  void sum(int from, int to) {
    for (int i = from; i < to; ++i) {
      const Correspondence& c = correspondences[static_cast<size_t>(i)];
      float inverse_gradient;
      const float e = distance(c, &inverse_gradient);
      const float weight = tukey.weight(e * e);
      cost += tukey.cost(e * e);
      if (weight == 0) continue;
      ++inliers;
      // e = x2 . (t x a) with a = R x1: de/dt = a x x2, de/dw = a x (x2 x t). The derivative of the gradient is of
      // second order.
      const Vector3f a = R * c.x1.homogeneous();
      const Vector3f x2 = c.x2.homogeneous();
      const Vector3f de_dt = a.cross(x2) * inverse_gradient;
      const Vector3f de_dw = a.cross(x2.cross(t)) * inverse_gradient;
      // The predicted quantity is the distance; its measured value is zero.
      equations.add({de_dw.x(), de_dw.y(), de_dw.z(), de_dt.dot(u), de_dt.dot(v)}, -e, weight);
    }
  }
  FitStep step(int iteration) {
    const float noise = std::max(result.sigma, sigma_floor);
    result.cost = cost / (noise * noise);
    if (inliers < kMinInliers) return FitStep::kFailed;
    float x[kUnknowns];
    if (!equations.solve(kMinPivot, x)) return FitStep::kFailed;
    if (iteration == steps || moved_little) {
      float c[kUnknowns];
      equations.covariance_column(3, 0, c);
      const float c_33 = c[3], c_43 = c[4];
      equations.covariance_column(4, 0, c);
      const float half = 0.5f * (c_33 + c[4]), difference = 0.5f * (c_33 - c[4]);
      result.sigma_t_rad = noise * std::sqrt(half + std::sqrt(difference * difference + c_43 * c_43));
      return FitStep::kConverged;
    }
    const Vector3f turn(x[0], x[1], x[2]);
    const float size = std::sqrt(turn.squaredNorm() + x[3] * x[3] + x[4] * x[4]);
    const float bound = size > kMaxStep ? kMaxStep / size : 1.0f;
    R = orthonormalised(so3_exp(bound * turn) * R);
    t = (t + bound * (x[3] * u + x[4] * v)).normalized();
    moved_little = size < kConverged_rad;
    return FitStep::kAgain;
  }
};

}  // namespace

RelativePose refine_relative_pose(std::span<const Correspondence> correspondences, const SE3& T_start, int steps,
                                  float sigma_floor, std::span<float> scratch) {
  EpipolarFit fit;
  fit.result.T_21 = T_start;
  const float norm = T_start.t.norm();
  const size_t count = std::min(correspondences.size(), scratch.size());
  if (!(norm > 0) || count < kMinInliers) return fit.result;
  fit.correspondences = correspondences.first(count);
  fit.squared = scratch.first(count);
  fit.steps = steps;
  fit.sigma_floor = sigma_floor;
  fit.R = T_start.R;
  fit.t = T_start.t / norm;
  RobustFit<EpipolarFit> loop;
  if (!loop.run(fit, static_cast<int>(count))) return fit.result;

  RelativePose result = fit.result;
  int front = 0, behind = 0;
  for (const Correspondence& c : fit.correspondences) {
    float inverse_gradient;
    const float e = fit.distance(c, &inverse_gradient);
    if (!(fit.tukey.weight(e * e) > 0)) continue;
    front += in_front({fit.R, fit.t}, c);
    behind += in_front({fit.R, -fit.t}, c);
  }
  result.T_21 = front >= behind ? SE3(fit.R, fit.t) : SE3(fit.R, -fit.t);
  result.inliers = std::max(front, behind);
  result.ok = result.inliers >= kMinInliers && result.T_21.R.allFinite() && result.T_21.t.allFinite() &&
              std::isfinite(result.sigma_t_rad);
  return result;
}

}  // namespace pptam
