// Bundle adjustment problems with a known truth, in double: a phone's views of a relief about one unit away. Unit
// tests, the count of instructions and the comparison with Ceres work on the same ones.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include <pocket_ptam/camera_model.h>

namespace pptam::test {

struct BundleProblem {
  struct View {
    Eigen::Matrix3d R = Eigen::Matrix3d::Identity();  // world to camera
    Eigen::Vector3d t = Eigen::Vector3d::Zero();
    Eigen::Matrix<double, 6, 1> velocity = Eigen::Matrix<double, 6, 1>::Zero();  // translation, rotation; per second
    Eigen::Vector3d centre() const { return -(R.transpose() * t); }
  };
  struct Observation {
    int view = 0;  // ascending within a point
    Eigen::Vector2d px = Eigen::Vector2d::Zero();
    double dt_s = 0;  // of its line
    bool wrong = false;
  };
  struct Point {
    Eigen::Vector3d truth = Eigen::Vector3d::Zero(), start = Eigen::Vector3d::Zero();
    std::vector<Observation> observations;
  };
  static constexpr double kFocal_px = 358.6, kCentreX_px = 119.5, kCentreY_px = 159.5;
  static constexpr double kSigma_px = 2;  // level 1

  std::vector<View> truth, start;
  std::vector<Point> points;

  static CameraModel camera() {
    CameraModel model;
    model.width = 240;
    model.height = 320;
    model.fx = model.fy = static_cast<float>(kFocal_px);
    model.cx = static_cast<float>(kCentreX_px);
    model.cy = static_cast<float>(kCentreY_px);
    model.prepare();
    return model;
  }
};

struct BundleProblemOptions {
  int views = 35;
  int points = 300;
  int observations_per_point = 8;
  double noise = 0.3;         // of the measurements, in their sigmas (2 px)
  double outliers = 0.05;     // share of the measurements that are 20 to 60 px off
  double pose_error = 0.01;   // world units and radians, 1 sigma; the first view is the datum and has none
  double point_error = 0.02;  // world units
  double readout_s = 0.060;   // of the 240 columns, later columns first; 0: global shutter, no motion
  bool exploring = false;     // views follow a path over the scene, and neighbours see the same points; otherwise all
                              // views look at the same place, and each point is seen by any of them
};

class BundleProblemMaker {
 public:
  BundleProblemMaker(const BundleProblemOptions& options, uint64_t seed) : options_(options), engine_(seed) {}

  BundleProblem make() {
    BundleProblem problem;
    for (int k = 0; k < options_.views; ++k) {
      const BundleProblem::View truth = view(k);
      BundleProblem::View start = truth;
      if (k > 0) {
        const Eigen::Vector3d turn = vector(options_.pose_error);
        start.R = Eigen::AngleAxisd(turn.norm(), turn.normalized()) * truth.R;
        start.t += vector(options_.pose_error);
      }
      if (options_.readout_s > 0) start.velocity += motion(0.01, 0.05);
      problem.truth.push_back(truth);
      problem.start.push_back(start);
    }
    while (static_cast<int>(problem.points.size()) < options_.points) add_point(problem);
    return problem;
  }

 private:
  double uniform(double low, double high) {
    return low + (high - low) * (static_cast<double>(engine_() >> 11) * 0x1.0p-53);
  }
  double gaussian() {
    double sum = -6;
    for (int i = 0; i < 12; ++i) sum += uniform(0, 1);
    return sum;
  }
  Eigen::Vector3d vector(double sigma) {
    const double x = gaussian(), y = gaussian(), z = gaussian();
    return sigma * Eigen::Vector3d(x, y, z);
  }
  Eigen::Matrix<double, 6, 1> motion(double translation, double rotation) {
    Eigen::Matrix<double, 6, 1> v;
    v.head<3>() = vector(translation);
    v.tail<3>() = vector(rotation);
    return v;
  }

  BundleProblem::View view(int k) {
    Eigen::Vector3d centre = vector(0.15), target(0, 0, 1);
    if (options_.exploring) {
      target.x() = 0.06 * k;
      centre.x() += target.x();
    }
    if (k == 0) centre.setZero();
    centre.z() *= 0.5;
    BundleProblem::View view;
    const Eigen::Vector3d z = (target - centre).normalized(), x = Eigen::Vector3d::UnitY().cross(z).normalized();
    view.R << x.transpose(), z.cross(x).transpose(), z.transpose();
    view.t = -(view.R * centre);
    if (options_.readout_s > 0) view.velocity = motion(0.1, 0.2);
    return view;
  }

  // The line that sees the point is found by iteration, which contracts by a tenth.
  bool see(const BundleProblem::View& view, const Eigen::Vector3d& p_w, BundleProblem::Observation* seen) const {
    const Eigen::Vector3d q = view.R * p_w + view.t;
    seen->dt_s = 0;
    for (int pass = 0; pass < 20; ++pass) {
      const Eigen::Vector3d p = q + seen->dt_s * (view.velocity.head<3>() + view.velocity.tail<3>().cross(q));
      if (!(p.z() > 0.1)) return false;
      seen->px = BundleProblem::kFocal_px * p.hnormalized() +
                 Eigen::Vector2d(BundleProblem::kCentreX_px, BundleProblem::kCentreY_px);
      seen->dt_s = line_time(seen->px);
    }
    return seen->px.x() > 0 && seen->px.x() < 239 && seen->px.y() > 0 && seen->px.y() < 319;
  }
  static double rounded_to_float(double x) {
    volatile float rounded = static_cast<float>(x);  // GCC 12 leaves out the rounding of a pair to float and back
    return static_cast<double>(rounded);
  }
  double line_time(const Eigen::Vector2d& px) const {
    return -(px.x() - BundleProblem::kCentreX_px) * options_.readout_s / 240;
  }

  void add_point(BundleProblem& problem) {
    BundleProblem::Point point;
    point.truth = {uniform(-0.25, 0.25), uniform(-0.3, 0.3), uniform(0.8, 1.2)};  // braces: in this order
    if (options_.exploring) point.truth.x() += uniform(0, 0.06 * options_.views);
    point.start = point.truth + vector(options_.point_error);
    for (int k = 0; k < options_.views; ++k) {
      BundleProblem::Observation o;
      o.view = k;
      if (see(problem.truth[static_cast<size_t>(k)], point.truth, &o)) point.observations.push_back(o);
    }
    if (static_cast<int>(point.observations.size()) <
        std::min(options_.observations_per_point, options_.exploring ? 3 : 99))
      return;
    while (static_cast<int>(point.observations.size()) > options_.observations_per_point)
      point.observations.erase(point.observations.begin() +
                               static_cast<ptrdiff_t>(engine_() % point.observations.size()));
    for (BundleProblem::Observation& o : point.observations) {
      o.px += vector(options_.noise * BundleProblem::kSigma_px).head<2>();
      o.wrong = uniform(0, 1) < options_.outliers;
      if (o.wrong) {
        const double angle = uniform(0, 6.28318), size = uniform(20, 60);
        o.px += size * Eigen::Vector2d(std::cos(angle), std::sin(angle));
      }
      for (double& x : o.px) x = rounded_to_float(x);  // what the map holds
      o.dt_s = line_time(o.px);
    }
    problem.points.push_back(point);
  }

  BundleProblemOptions options_;
  std::mt19937_64 engine_;
};

inline BundleProblem make_bundle_problem(const BundleProblemOptions& options, uint64_t seed) {
  return BundleProblemMaker(options, seed).make();
}

}  // namespace pptam::test
