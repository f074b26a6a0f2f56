// Two views of unknown points: their relative pose from the epipolar constraint, and triangulation.
#pragma once

#include <span>

#include <pocket_ptam/se3.h>
#include "geometry/homography.h"

namespace pptam {

struct Triangulated {
  Vector3f p_1 = Vector3f::Zero();  // point in the first camera's frame
  float parallax_rad = 0;           // angle between the two rays
  // 1-sigma of 1/z in the first frame, per unit of noise (normalised image coordinates) along the epipolar line in the
  // second view: 1 / |d(x2)/d(1/z)|. Equal noise in both views gives about sqrt(2) times as much when both see the
  // point from the same distance.
  float sigma_inverse_depth = 0;
};

// Point that minimises the reprojection error in both views (normalised coordinates, equal noise): linear start, then
// four Gauss-Newton steps. False (out unchanged) when the rays are parallel within min_parallax_rad, the point falls
// behind either camera, its depth is not within 1e-6 to 1e6 baselines, or the input is not finite.
bool triangulate(const SE3& T_21, const Vector2f& x1, const Vector2f& x2, float min_parallax_rad, Triangulated* out);

struct RelativePose {
  SE3 T_21;         // |t| = 1
  float sigma = 0;  // robust scale of the distances to the epipolar lines, normalised units
  float cost = 0;   // sum of Tukey costs / scale^2, scale = max(sigma, sigma_floor): comparable between starts
  int steps = 0;    // iterations made; the work meter charges them
  int inliers = 0;  // points of non-zero weight and in front of both cameras
  float sigma_t_rad = 3.14f;  // standard deviation of the direction of t, worst direction; pi: unknown
  bool ok = false;
};

// Refines a relative pose by Gauss-Newton on Tukey-weighted Sampson distances
//   e = x2^T [t]x R x1 / sqrt(|(E x1)_xy|^2 + |(E^T x2)_xy|^2),
// five parameters (rotation, direction of t), at most `steps` iterations. sigma_floor: smallest scale of the distances,
// normalised units. scratch: at least as long as correspondences. The sign of t is the one that puts most points in
// front of both cameras. Not ok with fewer than 8 inliers.
RelativePose refine_relative_pose(std::span<const Correspondence> correspondences, const SE3& T_start, int steps,
                                  float sigma_floor, std::span<float> scratch);

}  // namespace pptam
