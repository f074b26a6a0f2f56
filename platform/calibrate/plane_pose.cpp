#include "platform/calibrate/plane_pose.h"

#include <Eigen/Dense>
#include <cmath>
#include <numbers>

namespace pptam::platform {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr int kPoseSteps = 10;  // Gauss-Newton from a homography's pose: converged after four or five

// Takes the points to mean 0 and mean distance sqrt(2).
Matrix3d normalisation(const std::vector<Vector2d>& points) {
  Vector2d mean = Vector2d::Zero();
  for (const Vector2d& p : points) mean += p / static_cast<double>(points.size());
  double distance = 0;
  for (const Vector2d& p : points) distance += (p - mean).norm() / static_cast<double>(points.size());
  const double scale = distance > 0 ? std::numbers::sqrt2 / distance : 1;
  Matrix3d T;
  T << scale, 0, -scale * mean.x(), 0, scale, -scale * mean.y(), 0, 0, 1;
  return T;
}

Eigen::Isometry3d pose_of_homography(const Matrix3d& H) {
  const double scale = 2 / (H.col(0).norm() + H.col(1).norm());
  const double sign = H(2, 2) < 0 ? -1 : 1;  // the plane lies before the camera
  const Vector3d x = sign * scale * H.col(0), y = sign * scale * H.col(1);
  Matrix3d R;
  R << x, y, x.cross(y);
  const Eigen::JacobiSVD<Matrix3d> svd(R, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear() = svd.matrixU() * svd.matrixV().transpose();
  pose.translation() = sign * scale * H.col(2);
  return pose;
}

}  // namespace

Matrix3d plane_homography(const std::vector<Vector2d>& plane, const std::vector<Vector2d>& image) {
  const Matrix3d A = normalisation(plane), B = normalisation(image);
  Eigen::Matrix<double, 9, 9> M = Eigen::Matrix<double, 9, 9>::Zero();
  for (size_t i = 0; i < plane.size(); ++i) {
    const Vector3d p = A * plane[i].homogeneous();
    const Vector3d q = B * image[i].homogeneous();
    Eigen::Matrix<double, 2, 9> rows;
    rows << p.transpose(), Eigen::RowVector3d::Zero(), -q.x() * p.transpose(),  //
        Eigen::RowVector3d::Zero(), p.transpose(), -q.y() * p.transpose();
    M += rows.transpose() * rows;
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 9, 9>> solver(M);
  const Eigen::Matrix<double, 9, 1> h = solver.eigenvectors().col(0);
  Matrix3d H;
  H << h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8];
  H = B.inverse() * H * A;
  return H / H(2, 2);
}

Eigen::Isometry3d plane_pose(const std::vector<Vector2d>& plane, const std::vector<Vector2d>& rays) {
  Eigen::Isometry3d pose = pose_of_homography(plane_homography(plane, rays));
  for (int step = 0; step < kPoseSteps; ++step) {
    Eigen::Matrix<double, 6, 6> A = Eigen::Matrix<double, 6, 6>::Zero();
    Eigen::Matrix<double, 6, 1> b = Eigen::Matrix<double, 6, 1>::Zero();
    for (size_t i = 0; i < plane.size(); ++i) {
      const Vector3d turned = pose.linear() * Vector3d(plane[i].x(), plane[i].y(), 0);
      const Vector3d q = turned + pose.translation();
      if (!(q.z() > 0)) return pose;
      Eigen::Matrix<double, 2, 3> J_x_q;
      J_x_q << 1 / q.z(), 0, -q.x() / (q.z() * q.z()), 0, 1 / q.z(), -q.y() / (q.z() * q.z());
      Eigen::Matrix<double, 3, 6> J_q_mu;  // mu: translation, rotation about the board's middle
      J_q_mu << Matrix3d::Identity(),
          Matrix3d{{0, turned.z(), -turned.y()}, {-turned.z(), 0, turned.x()}, {turned.y(), -turned.x(), 0}};
      const Eigen::Matrix<double, 2, 6> J = J_x_q * J_q_mu;
      A += J.transpose() * J;
      b += J.transpose() * (rays[i] - Vector2d(q.x() / q.z(), q.y() / q.z()));
    }
    const Eigen::Matrix<double, 6, 1> mu = A.ldlt().solve(b);
    pose.translation() += mu.head<3>();
    const double angle = mu.tail<3>().norm();
    if (angle > 0) pose.linear() = Eigen::AngleAxisd(angle, mu.tail<3>() / angle).toRotationMatrix() * pose.linear();
    if (mu.norm() < 1e-12) break;
  }
  return pose;
}

}  // namespace pptam::platform
