// Rotations SO(3), rigid motions SE(3) and homographies SL(3), with their exponential maps.
//
// T_cw takes world to camera: p_c = T_cw * p_w; inner letters cancel, T_ck = T_cw * T_wk. Updates multiply on the left:
// T <- exp(mu) T, mu = (translation, rotation). Everything is float32, with the same bits on every target: sines and
// arctangents come from base/deterministic_math.h. Angles are radians.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace pptam {

using Eigen::Matrix2f;
using Eigen::Matrix3f;
using Eigen::Vector2f;
using Eigen::Vector3f;
using Matrix23f = Eigen::Matrix<float, 2, 3>;
using Matrix26f = Eigen::Matrix<float, 2, 6>;
using Matrix6f = Eigen::Matrix<float, 6, 6>;
using Vector6f = Eigen::Matrix<float, 6, 1>;
using Vector8f = Eigen::Matrix<float, 8, 1>;
static_assert(alignof(Matrix6f) == alignof(float),
              "compile with EIGEN_DONT_VECTORIZE, as the library is: otherwise TrackResult has another layout here");

// Skew-symmetric matrix: hat(a) * b = a x b.
Matrix3f hat(const Vector3f& a);

Matrix3f so3_exp(const Vector3f& omega);      // Rodrigues' formula; its Taylor series below 1e-2 rad
Vector3f so3_log(const Matrix3f& R);          // angle in [0, pi]; stable near 0 and near pi
Matrix3f orthonormalised(const Matrix3f& R);  // a rotation by Gram-Schmidt on the rows; R must be close to one already

struct SE3 {
  Matrix3f R = Matrix3f::Identity();
  Vector3f t = Vector3f::Zero();

  SE3() = default;
  SE3(const Matrix3f& rotation, const Vector3f& translation) : R(rotation), t(translation) {}
  SE3 operator*(const SE3& b) const { return {R * b.R, R * b.t + t}; }
  Vector3f operator*(const Vector3f& p) const { return R * p + t; }
  SE3 inverse() const { return {R.transpose(), -(R.transpose() * t)}; }
  Vector3f centre() const { return -(R.transpose() * t); }  // camera centre in the world, for T_cw

  static SE3 exp(const Vector6f& mu);  // mu = (translation, rotation)
  Vector6f log() const;
};

// x -> scale * (R x + t): a change of world coordinates.
struct Similarity {
  SE3 T;
  float scale = 1;
  Vector3f operator*(const Vector3f& p) const { return scale * (T * p); }
  // Composition: applies `first`, then this one: s2 (R2 s1 (R1 p + t1) + t2).
  Similarity operator*(const Similarity& first) const {
    return {SE3(T.R * first.T.R, T.R * first.T.t + T.t / first.scale), scale * first.scale};
  }
  // The camera pose T_cw in the new world coordinates: [R_cw R^T, s (t_cw - R_cw R^T t)].
  SE3 moved(const SE3& T_cw) const {
    SE3 moved = T_cw * T.inverse();
    moved.t *= scale;
    return moved;
  }
};

// exp: sl(3) -> SL(3), eight generators in this order: translation x and y, rotation, scale, two of aspect and shear,
// two projective. Determinant 1 by construction (normalised). Used as H <- sl3_exp(x) H.
//   G1 e13  G2 e23  G3 e12 - e21  G4 e11 + e22 - 2 e33  G5 e11 - e22  G6 e12 + e21  G7 e31  G8 e32
Matrix3f sl3_algebra(const Vector8f& x);
Matrix3f sl3_exp(const Vector8f& x);
Matrix3f normalised_sl3(const Matrix3f& H);  // H / cbrt(det H); det must not be 0

// d(exp(mu) p)/d(mu) at mu = 0: [I, -hat(p)], 3x6.
Eigen::Matrix<float, 3, 6> se3_point_jacobian(const Vector3f& p);

}  // namespace pptam
