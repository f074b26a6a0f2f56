// Where a plane is seen from: the homography of its points, and the pose by least squares. In double.
#pragma once

#include <Eigen/Geometry>
#include <vector>

namespace pptam::platform {

using Eigen::Vector2d;

// image ~ H (plane, 1), H(2, 2) = 1, by the direct linear transform on normalised points. At least four points.
Eigen::Matrix3d plane_homography(const std::vector<Vector2d>& plane, const std::vector<Vector2d>& image);

// The plane's coordinates to the camera's. rays: (x/z, y/z) of each point, from a homography refined by Gauss-Newton.
Eigen::Isometry3d plane_pose(const std::vector<Vector2d>& plane, const std::vector<Vector2d>& rays);

}  // namespace pptam::platform
