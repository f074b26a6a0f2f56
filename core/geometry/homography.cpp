#include "geometry/homography.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "geometry/normal_equations.h"
#include "geometry/robust.h"

namespace pptam {
namespace {

// Squared singular values that differ by less, relative to the middle one, are called equal: 17 times float32's
// rounding. Not swept.
constexpr float kRounding = 2e-6f;
// Smallest ratio of the smallest to the largest squared singular value: below it the second camera lies on the plane
// within rounding. Not swept.
constexpr float kMinSquaredRatio = 1e-5f;
// Bounds of the largest element of a usable matrix, in its own unit: well inside float32's range. Not swept.
constexpr float kMaxElement = 1e30f;
constexpr float kMinElement = 1e-30f;

template <int N>
struct EigenSystem {
  Eigen::Matrix<float, N, 1> values;
  Eigen::Matrix<float, N, N> vectors;  // in columns
};

// Eigenvalues (unsorted) and eigenvectors of a symmetric positive definite matrix by cyclic Jacobi rotations. Unlike
// tridiagonal methods they keep the relative precision of small eigenvalues when parameters are badly scaled.
template <int N>
EigenSystem<N> jacobi_eigen(Eigen::Matrix<float, N, N> A) {
  constexpr int kSweeps = 8;  // sweeps; convergence is quadratic, and five are enough for N = 8 in float32
  EigenSystem<N> result;
  Eigen::Matrix<float, N, N>& V = result.vectors;
  V.setIdentity();
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    for (int p = 0; p < N; ++p) {
      for (int q = p + 1; q < N; ++q) {
        if (A(p, q) == 0.0f) continue;
        // Rotation by the smaller angle that makes A(p, q) zero, tan = t.
        const float theta = (A(q, q) - A(p, p)) / (2.0f * A(p, q));
        const float magnitude = 1.0f / (std::fabs(theta) + std::sqrt(theta * theta + 1.0f));
        const float t = theta < 0.0f ? -magnitude : magnitude;
        const float c = 1.0f / std::sqrt(t * t + 1.0f);
        const float s = t * c;
        A(p, p) -= t * A(p, q);
        A(q, q) += t * A(p, q);
        A(p, q) = A(q, p) = 0.0f;
        for (int k = 0; k < N; ++k) {
          if (k != p && k != q) {
            const float a_kp = A(k, p);
            const float a_kq = A(k, q);
            A(k, p) = A(p, k) = c * a_kp - s * a_kq;
            A(k, q) = A(q, k) = s * a_kp + c * a_kq;
          }
          const float v_kp = V(k, p);
          const float v_kq = V(k, q);
          V(k, p) = c * v_kp - s * v_kq;
          V(k, q) = s * v_kp + c * v_kq;
        }
      }
    }
  }
  result.values = A.diagonal();
  return result;
}

// Chooses the sign of n (and of t with it) so that the plane lies in front of the first camera at every point. False
// when neither sign does. Without points, n.z >= 0.
bool orient(std::span<const Vector2f> points, Vector3f* n, Vector3f* t) {
  bool all_in_front = true;
  bool all_behind = true;
  for (const Vector2f& x : points) {
    const float side = n->dot(x.homogeneous());
    all_in_front = all_in_front && side > 0.0f;
    all_behind = all_behind && side < 0.0f;
  }
  if (points.empty()) all_in_front = n->z() >= 0.0f;
  if (all_in_front) return true;
  *n = -*n;
  *t = -*t;
  return all_behind;
}

// Total order of normals, for Decomposition::solutions.
bool comes_first(const Vector3f& a, const Vector3f& b) {
  if (a.z() != b.z()) return a.z() > b.z();
  if (a.x() != b.x()) return a.x() > b.x();
  return a.y() > b.y();
}

}  // namespace

Vector2f apply_homography(const Matrix3f& H, const Vector2f& x) {
  const Vector3f y = H * x.homogeneous();
  return {y.x() / y.z(), y.y() / y.z()};
}

Matrix2f homography_point_jacobian(const Matrix3f& H, const Vector2f& x) {
  const Vector3f w = H * x.homogeneous();
  const Vector2f y(w.x() / w.z(), w.y() / w.z());
  return (H.topLeftCorner<2, 2>() - y * H.block<1, 2>(2, 0)) / w.z();
}

// Generator G moves (y, 1) by G (y, 1) = (a, b), a two components, b the third: the projection moves by a - y b.
Eigen::Matrix<float, 2, 8> homography_sl3_jacobian(const Vector2f& y) {
  const float u = y.x();
  const float v = y.y();
  Eigen::Matrix<float, 2, 8> J;
  J << 1.0f, 0.0f, v, 3.0f * u, u, v, -u * u, -u * v,  //
      0.0f, 1.0f, -u, 3.0f * v, -v, u, -u * v, -v * v;
  return J;
}

// H is scaled so that its middle singular value is 1. With the plane in front of both cameras det H > 0 (it is the
// ratio of the plane's distances from the two cameras), and H = U diag(d1, 1, d3) V^T with det U = det V. Of Faugeras
// and Lustman's eight solutions the four for d' < 0 see the plane from opposite sides; they do not arise here. In the
// frame of U and V, diag = R' + t' n'^T with
//   n' = (x1, 0, x3), x1^2 = (d1^2 - 1) / (d1^2 - d3^2), x3^2 = (1 - d3^2) / (d1^2 - d3^2),
//   t' = (d1 - d3) (x1, 0, -x3),  R' about the second axis: sin = (d1 - d3) x1 x3, cos = (1 + d1 d3) / (d1 + d3),
// the sign of x1 x3 being free: two solutions.
Decomposition decompose_homography(const Matrix3f& H, std::span<const Vector2f> points, float rotation_tolerance) {
  Decomposition result;
  float largest = 0.0f;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const float magnitude = std::fabs(H(i, j));
      if (!(magnitude <= kMaxElement)) return result;  // NaN and infinite too
      if (magnitude > largest) largest = magnitude;
    }
  }
  if (!(largest > kMinElement)) return result;
  Matrix3f G = H / largest;

  const float determinant = G.col(0).dot(G.col(1).cross(G.col(2)));
  if ((points.empty() ? determinant : homography_depth(G, points[0])) < 0.0f) G = -G;
  for (const Vector2f& x : points) {
    if (!(homography_depth(G, x) > 0.0f)) return result;
  }
  if (!(G.col(0).dot(G.col(1).cross(G.col(2))) > 0.0f)) return result;

  EigenSystem<3> eigen = jacobi_eigen<3>(G.transpose() * G);
  int order[3] = {0, 1, 2};
  for (int pass = 0; pass < 2; ++pass) {
    for (int i = 0; i < 2; ++i) {
      if (eigen.values(order[i]) < eigen.values(order[i + 1])) std::swap(order[i], order[i + 1]);
    }
  }
  const float middle = eigen.values(order[1]);
  if (!(eigen.values(order[2]) > kMinSquaredRatio * eigen.values(order[0]))) return result;
  const float d1_sq = eigen.values(order[0]) / middle;
  const float d3_sq = eigen.values(order[2]) / middle;
  const float d1 = std::sqrt(d1_sq);
  const float d3 = std::sqrt(d3_sq);
  result.singular_values[0] = d1;
  result.singular_values[1] = 1.0f;
  result.singular_values[2] = d3;

  Matrix3f V;
  Matrix3f U;
  for (int i = 0; i < 3; ++i) {
    V.col(i) = eigen.vectors.col(order[i]);
    const Vector3f column = G * V.col(i);
    U.col(i) = column / std::sqrt(column.dot(column));
  }

  if (d1 / d3 - 1.0f < rotation_tolerance || d1_sq - d3_sq < kRounding) {
    result.pure_rotation = true;
    result.count = 1;
    result.solutions[0].T_21.R = orthonormalised(U * V.transpose());
    return result;
  }

  const float above = d1_sq - 1.0f > kRounding ? d1_sq - 1.0f : 0.0f;
  const float below = 1.0f - d3_sq > kRounding ? 1.0f - d3_sq : 0.0f;
  const float x1 = std::sqrt(above / (above + below));
  const float x3 = std::sqrt(below / (above + below));
  const float sine = (d1 - d3) * x1 * x3;
  const float cosine = (1.0f + d1 * d3) / (d1 + d3);
  const int candidates = above > 0.0f && below > 0.0f ? 2 : 1;  // with two equal singular values the two coincide
  for (int i = 0; i < candidates; ++i) {
    const float sign = i == 0 ? 1.0f : -1.0f;
    Matrix3f R;
    R << cosine, 0.0f, -sign * sine, 0.0f, 1.0f, 0.0f, sign * sine, 0.0f, cosine;
    PlaneMotion motion;
    Vector3f n = V * Vector3f(sign * x1, 0.0f, x3);
    Vector3f t = U * Vector3f(sign * (d1 - d3) * x1, 0.0f, (d3 - d1) * x3);
    if (!orient(points, &n, &t)) continue;
    motion.n_1 = n / std::sqrt(n.dot(n));
    motion.T_21 = SE3(orthonormalised(U * R * V.transpose()), t);
    result.solutions[result.count++] = motion;
  }
  if (result.count == 2 && comes_first(result.solutions[1].n_1, result.solutions[0].n_1)) {
    std::swap(result.solutions[0], result.solutions[1]);
  }
  return result;
}

// A rotation's last row and last column are equally long but for their common element: that gives k. Whether the rest
// fits, the singular values tell.
float focal_of_rotation(const Matrix3f& H, float max_ratio, float rotation_tolerance) {
  const float column = H.block<2, 1>(0, 2).norm(), row = H.block<1, 2>(2, 0).norm();
  if (!(row > 0.0f && column > 0.0f)) return 0;
  const float k = std::sqrt(column / row);
  if (!(k <= max_ratio && k * max_ratio >= 1.0f)) return 0;
  Matrix3f R = H;
  R.block<2, 1>(0, 2) /= k;
  R.block<1, 2>(2, 0) *= k;
  return decompose_homography(R, {}, rotation_tolerance).pure_rotation ? k : 0;
}

// Point x of the plane is seen at the projection of w = R x + t (n . x), so with w / w.z = (y, 1)
//   d(y) = [I, -y] / w.z * (-hat(R x) d(rotation) + (n . x) d(t) + t x^T d(n)),  d(n) in the plane's two tangents.
DecompositionQuality decomposition_quality(const PlaneMotion& motion, std::span<const Vector2f> points, float sigma) {
  using Matrix8f = Eigen::Matrix<float, 8, 8>;
  DecompositionQuality quality;
  const Vector3f& n = motion.n_1;
  const Vector3f& t = motion.T_21.t;
  int axis = 0;  // the coordinate axis most nearly perpendicular to n
  if (std::fabs(n(1)) < std::fabs(n(axis))) axis = 1;
  if (std::fabs(n(2)) < std::fabs(n(axis))) axis = 2;
  Vector3f tangent_1 = n.cross(Vector3f(Vector3f::Unit(axis)));
  tangent_1 /= std::sqrt(tangent_1.dot(tangent_1));
  const Vector3f tangent_2 = n.cross(tangent_1);

  Matrix8f information = Matrix8f::Zero();
  for (const Vector2f& point : points) {
    const Vector3f x = point.homogeneous();
    const Vector3f Rx = motion.T_21.R * x;
    const float n_x = n.dot(x);
    const Vector3f w = Rx + t * n_x;
    if (!(w.z() > 0.0f)) continue;
    Eigen::Matrix<float, 3, 8> J_w;
    J_w.leftCols<3>() = -hat(Rx);
    J_w.middleCols<3>(3) = n_x * Matrix3f::Identity();
    J_w.col(6) = t * tangent_1.dot(x);
    J_w.col(7) = t * tangent_2.dot(x);
    for (int row = 0; row < 2; ++row) {
      const float y = w(row) / w.z();
      float J[8];
      for (int k = 0; k < 8; ++k) J[k] = (J_w(row, k) - y * J_w(2, k)) / w.z();
      for (int i = 0; i < 8; ++i) {
        for (int j = i; j < 8; ++j) information(i, j) += J[i] * J[j];
      }
    }
  }
  for (int i = 0; i < 8; ++i) {
    for (int j = 0; j < i; ++j) information(i, j) = information(j, i);
  }

  const EigenSystem<8> eigen = jacobi_eigen<8>(information);
  float smallest = eigen.values(0);
  float greatest = eigen.values(0);
  for (int i = 1; i < 8; ++i) {
    if (!(eigen.values(i) >= smallest)) smallest = eigen.values(i);
    if (eigen.values(i) > greatest) greatest = eigen.values(i);
  }
  if (!(smallest > 0.0f) || !(greatest <= kMaxElement)) return quality;

  float c11 = 0.0f;  // covariance of the normal along its two tangents, radians^2, for sigma = 1
  float c12 = 0.0f;
  float c22 = 0.0f;
  for (int i = 0; i < 8; ++i) {
    const float a = eigen.vectors(6, i);
    const float b = eigen.vectors(7, i);
    c11 += a * a / eigen.values(i);
    c12 += a * b / eigen.values(i);
    c22 += b * b / eigen.values(i);
  }
  const float half_difference = 0.5f * (c11 - c22);
  const float variance = 0.5f * (c11 + c22) + std::sqrt(half_difference * half_difference + c12 * c12);
  const float sigma_n = sigma * std::sqrt(variance);
  quality.eigenvalue_ratio = smallest / greatest;
  if (sigma_n < quality.sigma_n_rad) quality.sigma_n_rad = sigma_n;
  return quality;
}

namespace {

// Robust fit of a homography, for RobustFit.
struct SlFit {
  static constexpr int kUnknowns = 8;
  static constexpr int kMaxIterations = 10;   // as many as the pose update's in [ptam 5.4]; not swept
  static constexpr int kMinInliers = 10;      // points: 20 equations for 8 unknowns; not swept
  static constexpr float kMinDepth = 0.1f;    // third homogeneous coordinate of a point that is used; not swept
  static constexpr float kMinPivot = 1e-6f;   // ratio (NormalEquations), ten times float32's rounding; not swept
  static constexpr float kMaxStep = 1.0f;     // norm of a step, whose parameters are of order 1; not swept
  static constexpr float kConverged = 1e-5f;  // norm of a step: 0.004 px on the phone

  std::span<const Correspondence> correspondences;
  std::span<float> weights, squared;
  float scale_factor;  // 1 / expected_sigma
  HomographyFit result;
  NormalEquations<kUnknowns> equations;
  Tukey tukey{1};
  size_t usable_count = 0;
  int inliers = 0;

  bool usable(const Correspondence& c) const { return homography_depth(result.H, c.x1) > kMinDepth; }

  bool errors(int) {
    ++result.iterations;
    size_t count = 0;
    for (const Correspondence& c : correspondences)
      if (usable(c)) squared[count++] = (scale_factor * (c.x2 - apply_homography(result.H, c.x1))).squaredNorm();
    usable_count = count;
    return count >= kMinInliers;
  }
  void scale() {
    result.sigma = std::max(robust_sigma(squared.first(usable_count)), kRobustSigmaFloor);
    tukey = Tukey(result.sigma);
    equations.clear();
    inliers = 0;
  }
  int residuals() const { return static_cast<int>(correspondences.size()); }
  void sum(int from, int to) {
    for (auto i = static_cast<size_t>(from); i < static_cast<size_t>(to); ++i) {
      const Correspondence& c = correspondences[i];
      weights[i] = 0;
      if (!usable(c)) continue;
      const Vector2f y = apply_homography(result.H, c.x1);
      const Vector2f e = scale_factor * (c.x2 - y);
      weights[i] = tukey.weight(e.squaredNorm());
      if (weights[i] == 0) continue;
      ++inliers;
      const Eigen::Matrix<float, 2, 8> J = homography_sl3_jacobian(y);
      for (int row = 0; row < 2; ++row) {
        float J_row[kUnknowns];
        for (int k = 0; k < kUnknowns; ++k) J_row[k] = scale_factor * J(row, k);
        equations.add(J_row, e[row], weights[i]);
      }
    }
  }
  FitStep step(int iteration) {
    if (inliers < kMinInliers) return FitStep::kFailed;
    Vector8f x;
    if (!equations.solve(kMinPivot, x.data())) return FitStep::kFailed;
    const float size = x.norm();
    if (size > kMaxStep) return FitStep::kFailed;
    result.H = sl3_exp(x) * result.H;
    return size < kConverged || iteration + 1 == kMaxIterations ? FitStep::kConverged : FitStep::kAgain;
  }
};

}  // namespace

HomographyFit fit_homography(std::span<const Correspondence> correspondences, const Matrix3f& H_start,
                             float expected_sigma, std::span<float> weights, std::span<float> scratch) {
  SlFit fit;
  fit.correspondences = correspondences;
  fit.weights = weights;
  fit.squared = scratch;
  fit.scale_factor = 1 / expected_sigma;
  fit.result.H = H_start;
  std::fill(weights.begin(), weights.end(), 0.0f);
  RobustFit<SlFit> loop;
  fit.result.ok = loop.run(fit, static_cast<int>(correspondences.size()));
  if (!fit.result.ok) return fit.result;
  fit.result.H = normalised_sl3(fit.result.H);
  fit.result.ok = fit.result.H.allFinite();
  return fit.result;
}

}  // namespace pptam
