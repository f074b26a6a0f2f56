// Problems of the collection "Bundle Adjustment in the Large" (Agarwal et al. 2010) for the bundle adjustment engine.
//
// A text file of numbers: the counts of cameras, points and observations; for every observation camera, point, x, y;
// for every camera its rotation vector, translation, focal length, k1, k2; for every point x, y, z. A camera looks
// along -z:  P = R X + t,  p = -P / P.z,  pixel = f (1 + k1 |p|^2 + k2 |p|^4) p.  The cost is half the sum of the
// squared distances in pixels. Focal lengths and distortions are held as the file has them.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <istream>
#include <memory>
#include <string>
#include <vector>

#include "tests/support/engine_run.h"

namespace pptam::test {

struct BalProblem {
  struct Camera {
    Eigen::Matrix3d R;
    Eigen::Vector3d t;
    double focal_px = 1, k1 = 0, k2 = 0;
  };
  struct Observation {
    int camera = 0, point = 0;
    Eigen::Vector2d px;
  };
  std::vector<Camera> cameras;
  std::vector<Eigen::Vector3d> points;
  std::vector<Observation> observations;  // by point, then camera; a camera observes a point at most once
};

class BalReader {
 public:
  explicit BalReader(std::istream& in) : in_(in) {}

  // False: error() says what is wrong; the problem is then of no use.
  bool read(BalProblem* problem) {
    int64_t cameras = 0, points = 0, observations = 0;
    if (!count("cameras", kMaxCameras, &cameras) || !count("points", kMaxPoints, &points) ||
        !count("observations", kMaxObservations, &observations))
      return false;
    if (observations > cameras * points)
      return fail(std::to_string(observations) + " observations are more than " + std::to_string(cameras) +
                  " cameras can make of " + std::to_string(points) + " points");
    // The file decides how much memory is used, not its first line.
    for (int64_t i = 0; i < observations; ++i) {
      const std::string what = "observation " + std::to_string(i);
      BalProblem::Observation o;
      if (!index(what + ", camera", cameras, &o.camera) || !index(what + ", point", points, &o.point) ||
          !number(what + ", x", &o.px.x()) || !number(what + ", y", &o.px.y()))
        return false;
      problem->observations.push_back(o);
    }
    for (int64_t i = 0; i < cameras; ++i) {
      double v[9];
      for (double& x : v)
        if (!number("camera " + std::to_string(i), &x)) return false;
      BalProblem::Camera camera;
      const Eigen::Vector3d turn(v[0], v[1], v[2]);
      const double angle = turn.norm();
      camera.R = angle > 0 ? Eigen::AngleAxisd(angle, turn / angle).toRotationMatrix() : Eigen::Matrix3d::Identity();
      camera.t = {v[3], v[4], v[5]};
      camera.focal_px = v[6], camera.k1 = v[7], camera.k2 = v[8];
      problem->cameras.push_back(camera);
    }
    for (int64_t i = 0; i < points; ++i) {
      Eigen::Vector3d p;
      for (int k = 0; k < 3; ++k)
        if (!number("point " + std::to_string(i), &p[k])) return false;
      problem->points.push_back(p);
    }
    std::string rest;
    if (in_ >> rest) return fail("after the last point there is more: '" + rest.substr(0, 20) + "'");
    auto& all = problem->observations;
    const auto key = [](const BalProblem::Observation& o) { return std::pair(o.point, o.camera); };
    std::sort(all.begin(), all.end(), [&](const auto& a, const auto& b) { return key(a) < key(b); });
    for (size_t i = 1; i < all.size(); ++i)
      if (key(all[i - 1]) == key(all[i]))
        return fail("camera " + std::to_string(all[i].camera) + " observes point " + std::to_string(all[i].point) +
                    " twice");
    return true;
  }
  const std::string& error() const { return error_; }

 private:
  static constexpr int64_t kMaxCameras = 30'000;  // the engine's indices have 16 bits
  static constexpr int64_t kMaxPoints = 20'000'000, kMaxObservations = 100'000'000;

  bool fail(const std::string& message) {
    error_ = "not a BAL problem: " + message;
    return false;
  }
  bool number(const std::string& what, double* value) {
    std::string word;
    if (!(in_ >> word)) return fail("the file ends before " + what + "; is it complete, and unpacked?");
    char* end = nullptr;
    *value = std::strtod(word.c_str(), &end);
    if (*end != 0 || !std::isfinite(*value))
      return fail(what + " is '" + word.substr(0, 20) + "', which is not a finite number");
    return true;
  }
  bool whole(const std::string& what, int64_t least, int64_t most, int64_t* value) {
    double x = 0;
    if (!number(what, &x)) return false;
    if (!(x >= static_cast<double>(least) && x <= static_cast<double>(most)) || x != std::floor(x))
      return fail(what + " must be a whole number from " + std::to_string(least) + " to " + std::to_string(most));
    *value = static_cast<int64_t>(x);
    return true;
  }
  bool count(const std::string& what, int64_t most, int64_t* value) {
    return whole("the number of " + what, 1, most, value);
  }
  bool index(const std::string& what, int64_t count, int* value) {
    int64_t i = 0;
    if (!whole(what, 0, count - 1, &i)) return false;
    *value = static_cast<int>(i);
    return true;
  }

  std::istream& in_;
  std::string error_;
};

struct BalProjection {
  const std::vector<BalProblem::Camera>* cameras = nullptr;

  bool project(int index, const Eigen::Vector3d& p, Eigen::Vector2d* px) const {
    if (!(p.z() < 0)) return false;
    const BalProblem::Camera& c = (*cameras)[static_cast<size_t>(index)];
    const Eigen::Vector2d x = -p.head<2>() / p.z();
    const double s = x.squaredNorm();
    *px = c.focal_px * (1 + s * (c.k1 + s * c.k2)) * x;
    return true;
  }
  bool project(int index, const Eigen::Vector3d& p, Eigen::Vector2d* px, Eigen::Matrix<double, 2, 3>* J) const {
    if (!project(index, p, px)) return false;
    const BalProblem::Camera& c = (*cameras)[static_cast<size_t>(index)];
    const Eigen::Vector2d x = -p.head<2>() / p.z();
    const double s = x.squaredNorm();
    const Eigen::Matrix2d D = c.focal_px * ((1 + s * (c.k1 + s * c.k2)) * Eigen::Matrix2d::Identity() +
                                            2 * (c.k1 + 2 * s * c.k2) * x * x.transpose());
    // d(x)/d(p) = [-I, -x] / z
    J->leftCols<2>() = -D / p.z();
    J->col(2) = -(D * x) / p.z();
    return true;
  }
};

// The engine in double at the problem's start, all poses but the first free. `problem` must outlive it.
inline std::unique_ptr<EngineRun<double, BalProjection>> make_engine(const BalProblem& problem) {
  BundleCapacity capacity;
  capacity.cameras = capacity.columns = capacity.observations_per_point = static_cast<int>(problem.cameras.size());
  capacity.points = static_cast<int>(problem.points.size());
  capacity.observations = static_cast<int>(problem.observations.size());
  auto run = std::make_unique<EngineRun<double, BalProjection>>(capacity, BalProjection{&problem.cameras});
  auto& engine = run->engine();
  using Engine = std::remove_reference_t<decltype(engine)>;
  for (const BalProblem::Camera& from : problem.cameras) {
    Engine::Camera camera;
    camera.now.R = from.R;
    camera.now.t = from.t;
    camera.pose_free = engine.cameras().size() > 0;
    engine.cameras().push_back(camera);
  }
  for (const Eigen::Vector3d& p : problem.points) {
    Engine::Point point;
    point.p = p;
    engine.points().push_back(point);
  }
  for (const BalProblem::Observation& from : problem.observations) {
    Engine::Observation o;
    o.px = from.px;
    o.camera = static_cast<int16_t>(from.camera);
    Engine::Point& point = engine.points()[from.point];
    if (point.count == 0) point.first = engine.observations().size();
    ++point.count;
    engine.observations().push_back(o);
  }
  engine.assign_columns();
  return run;
}

}  // namespace pptam::test
