// Homographies that a plane induces between two views: fit, decomposition, and how well they constrain the plane.
//
// Convention: plane n_1 . p_1 = d in the first camera's frame (n_1 unit, d > 0, towards the plane: n_1.z > 0 for a
// visible one), T_21 = (R, t) takes first-camera to second-camera coordinates. Normalised image points: x_2 ~ H x_1
// with
//   H = R + (t / d) n_1^T.
// [phone 5.1], decomposition by Faugeras and Lustman 1988.
#pragma once

#include <span>

#include <pocket_ptam/se3.h>

namespace pptam {

// One measured correspondence, normalised image coordinates (x/z, y/z).
struct Correspondence {
  Vector2f x1 = Vector2f::Zero();
  Vector2f x2 = Vector2f::Zero();
};

// Maps normalised point x by H. homography_depth(H, x) must be positive.
Vector2f apply_homography(const Matrix3f& H, const Vector2f& x);
// Third homogeneous coordinate of H (x, 1).
inline float homography_depth(const Matrix3f& H, const Vector2f& x) {
  return H(2, 0) * x.x() + H(2, 1) * x.y() + H(2, 2);
}
// d(H x)/d(x), 2x2, at normalised point x.
Matrix2f homography_point_jacobian(const Matrix3f& H, const Vector2f& x);
// d(exp(e) H x)/d(e) at e = 0, 2x8, in terms of y = apply_homography(H, x). Generators are those of sl3_exp.
Eigen::Matrix<float, 2, 8> homography_sl3_jacobian(const Vector2f& y);

struct HomographyFit {
  Matrix3f H = Matrix3f::Identity();  // determinant 1
  float sigma = 0;                    // robust scale: 1-sigma of a coordinate, in units of expected_sigma
  int iterations = 0;                 // iterations made; the work meter charges them
  bool ok = false;                    // at least 10 inliers that constrain all eight parameters
};
// Robust fit of H to x_2 ~ H x_1 by Gauss-Newton with left-multiplied sl(3) updates, from H_start [phone 5.1].
// expected_sigma: standard deviation of a coordinate of x_2, normalised units. weights (output): final Tukey weight of
// each correspondence, 0 for outliers. weights and scratch must be as long as correspondences.
HomographyFit fit_homography(std::span<const Correspondence> correspondences, const Matrix3f& H_start,
                             float expected_sigma, std::span<float> weights, std::span<float> scratch);

struct PlaneMotion {
  SE3 T_21;                          // translation in units of the plane's distance: t / d
  Vector3f n_1 = Vector3f::UnitZ();  // plane n_1 . p_1 = 1 in those units
};

struct Decomposition {
  int count = 0;                  // 0, 1 or 2 solutions left after the visibility test
  PlaneMotion solutions[2];       // larger n_1.z first: a total order, so that every target gives the same one
  float singular_values[3] = {};  // descending, scaled so that the middle one is 1
  // d1 and d3 are equal within rotation_tolerance. The only solution is then the nearest rotation with t = 0; its n_1
  // is meaningless.
  bool pure_rotation = false;
};

// Decomposes H (any scale and sign) by Faugeras and Lustman. points: normalised points of the first view for the
// visibility test: the plane must lie in front of both cameras at each of them (n_1 . x_1 > 0). Without points, the
// sign with n_1.z >= 0 is taken. rotation_tolerance: d1/d3 - 1 below which H is called a pure rotation. count is 0 when
// H is not finite, is singular, or sees the plane's two sides.
Decomposition decompose_homography(const Matrix3f& H, std::span<const Vector2f> points, float rotation_tolerance);

// The focal length, relative to the one by which H's points were normalised, with which H is a pure rotation within
// rotation_tolerance, as Decomposition::pure_rotation: H = D R D^-1, D = diag(k, k, 1), the principal point being
// right. 0 when there is none in 1 / max_ratio to max_ratio. A wrong field of view makes parallax of turning, but only
// some that one k explains; moving sideways while turning the same way can look alike, until it goes on.
float focal_of_rotation(const Matrix3f& H, float max_ratio, float rotation_tolerance);

struct DecompositionQuality {
  float eigenvalue_ratio = 0;  // min/max eigenvalue of the 8x8 information matrix [phone 5.1]
  float sigma_n_rad = 3.14f;   // standard deviation of the plane's normal, worst direction, radians; pi: unknown
};

// From the information matrix of the 8 parameters (3 rotation, 3 translation t/d, 2 normal), given the points'
// projections into the second view. points: first view. sigma: isotropic noise of a projection, both in normalised
// units.
DecompositionQuality decomposition_quality(const PlaneMotion& motion, std::span<const Vector2f> points, float sigma);

}  // namespace pptam
