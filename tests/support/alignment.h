// How far apart two shapes are when place, direction and size do not count.
#pragma once

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <cmath>
#include <cstddef>
#include <vector>

namespace pptam::test {

// Root mean square distance of b's points from a's after the best similarity of a (Umeyama 1991). As Eigen::umeyama,
// whose matrices of any size take the compiler five seconds in every file.
inline double distance_after_similarity(const std::vector<Eigen::Vector3d>& a, const std::vector<Eigen::Vector3d>& b) {
  const auto count = static_cast<double>(a.size());
  Eigen::Vector3d mean_a = Eigen::Vector3d::Zero(), mean_b = Eigen::Vector3d::Zero();
  for (size_t i = 0; i < a.size(); ++i) {
    mean_a += a[i] / count;
    mean_b += b[i] / count;
  }
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  double variance = 0;
  for (size_t i = 0; i < a.size(); ++i) {
    const Eigen::Vector3d p = a[i] - mean_a, q = b[i] - mean_b;
    for (int k = 0; k < 3; ++k) covariance.col(k) += q * (p[k] / count);
    variance += p.squaredNorm() / count;
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d U = svd.matrixU();
  Eigen::Vector3d d = svd.singularValues();
  if (U.determinant() * svd.matrixV().determinant() < 0) {  // a rotation, no reflection
    U.col(2) = -U.col(2);
    d[2] = -d[2];
  }
  const Eigen::Matrix3d R = U * svd.matrixV().transpose();
  const double scale = d.sum() / variance;
  double sum = 0;
  for (size_t i = 0; i < a.size(); ++i) {
    const Eigen::Vector3d moved = R * (a[i] - mean_a);
    sum += (scale * moved + mean_b - b[i]).squaredNorm();
  }
  return std::sqrt(sum / count);
}

}  // namespace pptam::test
