#include <cmath>

#include <pocket_ptam/se3.h>
#include "base/deterministic_math.h"

namespace pptam {
namespace {

// Radians^2. Below this squared angle the coefficients come from two terms of their series: the third is under 1e-9.
constexpr float kSmallAngleSq = 1e-4f;

// Coefficients of exp(hat(w)) = I + a hat(w) + b hat(w)^2 and of V = I + b hat(w) + c hat(w)^2, which takes the
// translation part of mu to T.t.
struct RodriguesCoefficients {
  float a;  // sin(angle) / angle
  float b;  // (1 - cos(angle)) / angle^2
  float c;  // (angle - sin(angle)) / angle^3
};

RodriguesCoefficients rodrigues(float angle_sq) {
  if (angle_sq < kSmallAngleSq) {
    return {1.0f - angle_sq / 6.0f, 0.5f - angle_sq / 24.0f, 1.0f / 6.0f - angle_sq / 120.0f};
  }
  const float angle = std::sqrt(angle_sq);
  const float sine = det_sin(angle);
  const float half_sine = det_sin(0.5f * angle) / angle;  // 1 - cos = 2 sin^2(angle/2) avoids cancellation
  return {sine / angle, 2.0f * half_sine * half_sine, (angle - sine) / (angle_sq * angle)};
}

}  // namespace

Matrix3f hat(const Vector3f& a) {
  Matrix3f m;
  m << 0.0f, -a.z(), a.y(), a.z(), 0.0f, -a.x(), -a.y(), a.x(), 0.0f;
  return m;
}

Matrix3f so3_exp(const Vector3f& omega) {
  const RodriguesCoefficients k = rodrigues(omega.dot(omega));
  const Matrix3f W = hat(omega);
  return Matrix3f::Identity() + k.a * W + k.b * (W * W);
}

// By way of the unit quaternion (w, v). The largest of its four components is taken from the diagonal, which avoids
// cancellation at every angle. angle = 2 atan2(|v|, w), axis = v / |v|.
Vector3f so3_log(const Matrix3f& R) {
  const float trace = R(0, 0) + R(1, 1) + R(2, 2);
  float w;
  Vector3f v;
  if (trace >= R(0, 0) && trace >= R(1, 1) && trace >= R(2, 2)) {
    const float s = 2.0f * std::sqrt(1.0f + trace);  // 4 w
    w = 0.25f * s;
    v = Vector3f(R(2, 1) - R(1, 2), R(0, 2) - R(2, 0), R(1, 0) - R(0, 1)) / s;
  } else {
    int i = 0;
    if (R(1, 1) > R(0, 0)) i = 1;
    if (R(2, 2) > R(i, i)) i = 2;
    const int j = (i + 1) % 3;
    const int k = (i + 2) % 3;
    const float s = 2.0f * std::sqrt(1.0f + R(i, i) - R(j, j) - R(k, k));  // 4 v(i)
    w = (R(k, j) - R(j, k)) / s;
    v(i) = 0.25f * s;
    v(j) = (R(j, i) + R(i, j)) / s;
    v(k) = (R(k, i) + R(i, k)) / s;
  }
  if (w < 0.0f) {  // (-w, -v) is the same rotation with an angle of at most pi
    w = -w;
    v = -v;
  }
  const float length_sq = v.dot(v);
  if (length_sq < kSmallAngleSq) return v * (2.0f / w * (1.0f - length_sq / (3.0f * w * w)));
  const float length = std::sqrt(length_sq);
  return v * (2.0f * det_atan2(length, w) / length);
}

Matrix3f orthonormalised(const Matrix3f& R) {
  const Vector3f x = R.row(0).transpose() / std::sqrt(R.row(0).squaredNorm());
  Vector3f y = R.row(1).transpose();
  y -= x.dot(y) * x;
  y /= std::sqrt(y.squaredNorm());
  Matrix3f result;
  result.row(0) = x.transpose();
  result.row(1) = y.transpose();
  result.row(2) = x.cross(y).transpose();
  return result;
}

SE3 SE3::exp(const Vector6f& mu) {
  const Vector3f translation = mu.head<3>();
  const Vector3f omega = mu.tail<3>();
  const RodriguesCoefficients k = rodrigues(omega.dot(omega));
  const Matrix3f W = hat(omega);
  const Matrix3f W2 = W * W;
  const Vector3f W_t = W * translation;
  const Vector3f W2_t = W * W_t;
  return {Matrix3f::Identity() + k.a * W + k.b * W2, translation + k.b * W_t + k.c * W2_t};
}

// V^-1 = I - hat(w)/2 + d hat(w)^2,  d = (1 - (angle/2) cot(angle/2)) / angle^2.
Vector6f SE3::log() const {
  const Vector3f omega = so3_log(R);
  const float angle_sq = omega.dot(omega);
  float d = 1.0f / 12.0f + angle_sq / 720.0f;
  if (angle_sq >= kSmallAngleSq) {
    const float half = 0.5f * std::sqrt(angle_sq);
    d = (1.0f - half * det_cos(half) / det_sin(half)) / angle_sq;
  }
  const Vector3f w_t = omega.cross(t);
  Vector6f mu;
  mu.head<3>() = t - 0.5f * w_t + d * omega.cross(w_t);
  mu.tail<3>() = omega;
  return mu;
}

Matrix3f sl3_algebra(const Vector8f& x) {
  Matrix3f A;
  A << x(3) + x(4), x(2) + x(5), x(0),  //
      x(5) - x(2), x(3) - x(4), x(1),   //
      x(6), x(7), -2.0f * x(3);
  return A;
}

// Scaling and squaring: exp(A) = exp(A / 2^s)^(2^s).
Matrix3f sl3_exp(const Vector8f& x) {
  constexpr float kMaxScaledNorm = 0.5f;
  constexpr int kTerms = 8;          // of the series, for a norm of at most 1/2: the ninth term is 1e-8 of the first
  constexpr int kMaxSquarings = 12;  // bounds the loop; enough for a norm of 2048, far beyond any fit's step. Not swept
  Matrix3f A = sl3_algebra(x);
  float norm = std::sqrt(A.squaredNorm());
  int squarings = 0;
  while (norm > kMaxScaledNorm && squarings < kMaxSquarings) {
    norm *= 0.5f;
    A *= 0.5f;
    ++squarings;
  }
  Matrix3f H = Matrix3f::Identity();
  for (int k = kTerms; k >= 1; --k) {  // Horner: I + A (I + A/2 (I + A/3 ...))
    const Matrix3f product = A * H;
    H = Matrix3f::Identity() + product / static_cast<float>(k);
  }
  for (int i = 0; i < squarings; ++i) {
    const Matrix3f square = H * H;
    H = square;
  }
  return normalised_sl3(H);
}

Matrix3f normalised_sl3(const Matrix3f& H) {
  // Divided by its largest element first, so that the determinant cannot overflow.
  float largest = 0.0f;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      if (std::fabs(H(i, j)) > largest) largest = std::fabs(H(i, j));
  const Matrix3f scaled = H / largest;
  const float determinant = scaled.col(0).dot(scaled.col(1).cross(scaled.col(2)));
  return scaled / det_cbrt(determinant);
}

Eigen::Matrix<float, 3, 6> se3_point_jacobian(const Vector3f& p) {
  Eigen::Matrix<float, 3, 6> J;
  J.leftCols<3>().setIdentity();
  J.rightCols<3>() = -hat(p);
  return J;
}

}  // namespace pptam
