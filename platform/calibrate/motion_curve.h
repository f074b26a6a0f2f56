// The camera's motion about one frame, from its poses in the frames beside it: what a rolling shutter's lines see.
#pragma once

#include <Eigen/Dense>
#include <vector>

namespace pptam::platform {

// A pose at a time: a point p is seen at R p + t.
struct TimedPose {
  double t_s = 0;
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Eigen::Vector3d t = Eigen::Vector3d::Zero();
};

inline Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

// The rotation by |phi| about phi, radians.
inline Eigen::Matrix3d turn_by(const Eigen::Vector3d& phi) {
  const double angle = phi.norm();
  if (angle == 0) return Eigen::Matrix3d::Identity();
  return Eigen::AngleAxisd(angle, phi / angle).toRotationMatrix();
}

// The polynomials, of a degree that is the number of other poses, through all of them: of the turn and the shift since
// the frame, (phi, s), which are 0 at its time. A line dt seconds later sees p at turn_by(phi(dt)) R p + t + s(dt).
class MotionCurve {
 public:
  // others: at times that differ; unit_s: about the time between two frames, so that powers stay near 1.
  template <class Poses>
  MotionCurve(const TimedPose& frame, const Poses& others, double unit_s) : unit_s_(unit_s) {
    const Eigen::Index degree = static_cast<Eigen::Index>(others.size());
    coefficients_.resize(degree, 6);
    if (degree == 0) return;  // none is known
    Eigen::MatrixXd powers(degree, degree);
    Eigen::MatrixXd values(degree, 6);
    Eigen::Index k = 0;
    for (const TimedPose* other : others) {
      const Eigen::AngleAxisd turn(other->R * frame.R.transpose());
      values.row(k) << (turn.angle() * turn.axis()).transpose(), (other->t - frame.t).transpose();
      const double at = (other->t_s - frame.t_s) / unit_s_;
      double power = 1;
      for (Eigen::Index p = 0; p < degree; ++p) powers(k, p) = power *= at;
      ++k;
    }
    coefficients_ = powers.partialPivLu().solve(values);
  }

  // (turn, shift) at a time relative to the frame's.
  Eigen::Matrix<double, 6, 1> at(double dt_s) const {
    const double x = dt_s / unit_s_;
    Eigen::Matrix<double, 1, 6> value = Eigen::Matrix<double, 1, 6>::Zero();
    for (Eigen::Index p = coefficients_.rows(); p-- > 0;) value = (value + coefficients_.row(p)) * x;
    return value.transpose();
  }

  // Its derivative by the time, per second.
  Eigen::Matrix<double, 6, 1> rate(double dt_s) const {
    const double x = dt_s / unit_s_;
    Eigen::Matrix<double, 1, 6> value = Eigen::Matrix<double, 1, 6>::Zero();
    for (Eigen::Index p = coefficients_.rows(); p-- > 0;)
      value = value * x + static_cast<double>(p + 1) * coefficients_.row(p);
    return value.transpose() / unit_s_;
  }

 private:
  double unit_s_;
  Eigen::MatrixXd coefficients_;
};

}  // namespace pptam::platform
