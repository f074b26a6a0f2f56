// A camera from tracks of points, against the truth: a hand that moves before scattered points, seen through a rolling
// shutter, with noise and wrong matches.
#include "platform/calibrate/camera_fit.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <numbers>
#include <string>

#include "sim_phone/random.h"
#include "tests/support/phone_camera.h"

namespace {

using namespace pptam;
using namespace pptam::platform;
using Axis = RollingShutter::Axis;
using Eigen::Vector3d;

struct ClipOptions {
  uint64_t seed = 1;
  Axis axis = Axis::kRows;
  double readout_s = 0.030;
  double speed = 1;
  double seconds = 20;
  double told_focal = 1;  // relative to the truth
};

// A sum of swings, from half to three a second.
class Swings {
 public:
  Swings(sim::Random& random, double amplitude, double speed) {
    for (Swing& swing : swings_) {
      swing.rate = speed * 2 * std::numbers::pi * (0.3 + 2.7 * random.uniform(0, 1) * random.uniform(0, 1));
      swing.amplitude = amplitude * (random.uniform(0, 1) - 0.5) * std::min(1.0, 4 / swing.rate);
      swing.phase = 2 * std::numbers::pi * random.uniform(0, 1);
    }
  }
  double at(double t_s) const {
    double sum = 0;
    for (const Swing& swing : swings_) sum += swing.amplitude * std::sin(swing.rate * t_s + swing.phase);
    return sum;
  }

 private:
  struct Swing {
    double rate, amplitude, phase;
  };
  Swing swings_[4];
};

PointTracks clip_of(const ClipOptions& o) {
  sim::Random random(o.seed, 1);
  const CameraModel model = test::phone_camera();
  const auto noise = [&](double sigma) {  // nearly normal
    double sum = -6;
    for (int i = 0; i < 12; ++i) sum += random.uniform(0, 1);
    return sigma * sum;
  };
  std::vector<Vector3d> points(250);
  for (Vector3d& p : points)
    p = Vector3d(2.4 * random.uniform(0, 1) - 1.2, 2.8 * random.uniform(0, 1) - 1.4, 0.8 + 1.2 * random.uniform(0, 1));
  std::vector<Swings> motion;
  for (int i = 0; i < 6; ++i) motion.emplace_back(random, i < 3 ? 0.5 : 0.6, o.speed);
  const auto pose_at = [&](double t_s) {
    TimedPose pose;
    pose.t_s = t_s;
    pose.R = turn_by(Vector3d(motion[3].at(t_s), motion[4].at(t_s), motion[5].at(t_s)));
    pose.t = Vector3d(motion[0].at(t_s), motion[1].at(t_s), motion[2].at(t_s));
    return pose;
  };
  PointTracks tracks;
  constexpr double kFramesPerSecond = 15;
  for (int i = 0; i < o.seconds * kFramesPerSecond; ++i) {
    PointTracks::View& view = tracks.views.emplace_back();
    const double t_s = i / kFramesPerSecond;
    view.pose = pose_at(t_s);
    view.pose.R = turn_by(Vector3d(noise(0.002), noise(0.002), noise(0.002))) * view.pose.R;
    view.pose.t += Vector3d(noise(0.003), noise(0.003), noise(0.003));
    for (size_t p = 0; p < points.size() && view.seen.size() < 50; ++p) {
      const size_t which = (p * 37 + static_cast<size_t>(i) * 11) % points.size();
      Vector2f px(0.5f * static_cast<float>(model.width), 0.5f * static_cast<float>(model.height));
      bool visible = true;
      for (int pass = 0; pass < 8 && visible; ++pass) {
        const double line = o.axis == Axis::kRows
                                ? (static_cast<double>(px.y()) - 0.5 * (model.height - 1)) / model.height
                                : (static_cast<double>(px.x()) - 0.5 * (model.width - 1)) / model.width;
        const TimedPose pose = pose_at(t_s + o.readout_s * line);
        const Vector3d q = pose.R * points[which] + pose.t;
        visible = q.z() > 0.2 && model.project(q.cast<float>(), &px);
      }
      if (!visible || !model.in_image(px, 4)) continue;
      const bool wrong = random.uniform(0, 1) < 0.05;
      const double sigma = wrong ? 4 : 0.4;
      px += Vector2f(static_cast<float>(noise(sigma)), static_cast<float>(noise(sigma)));
      view.seen.push_back({static_cast<uint32_t>(which + 1), px, 2.0f});
    }
  }
  for (size_t p = 0; p < points.size(); ++p)
    tracks.points[static_cast<uint32_t>(p + 1)] = points[p] + Vector3d(noise(0.01), noise(0.01), noise(0.03));
  return tracks;
}

CameraFit fit_of(const ClipOptions& o, bool focal, const char* axes = "both") {
  CameraModel model = test::phone_camera();
  model.fx *= static_cast<float>(o.told_focal);
  model.fy *= static_cast<float>(o.told_focal);
  CameraFitOptions options;
  options.focal = focal;
  options.axes = axes;
  options.curves = false;
  const CameraFit fit = fit_camera(clip_of(o), model, RollingShutter(), options);
  std::printf("seed %d: readout %+.2f ms: %+.2f +- %.2f %s; focal %.2f: %.4f +- %.4f; rms %.3f global %.3f %s %s %s\n",
              static_cast<int>(o.seed), 1000 * o.readout_s, 1000 * fit.readout_s.value, 1000 * fit.readout_s.sigma,
              fit.axis == Axis::kRows ? "rows" : "columns", 1 / o.told_focal, fit.focal.value, fit.focal.sigma,
              fit.rms_px, fit.global_px, fit.trouble.c_str(), fit.readout_s.trouble.c_str(), fit.focal.trouble.c_str());
  return fit;
}

uint64_t seeds() {
  return std::getenv("PPTAM_ALL") != nullptr ? 20 : 2;
}

TEST(CameraFit, FindsReadoutAndFocalLength) {
  for (uint64_t seed = 1; seed <= seeds(); ++seed) {
    ClipOptions o;
    o.seed = seed;
    o.axis = seed % 2 == 0 ? Axis::kRows : Axis::kColumns;
    o.readout_s = seed % 3 == 0 ? -0.055 : 0.010 * static_cast<double>(seed % 5 + 1);
    o.told_focal = seed % 3 == 1 ? 1.25 : 0.8;
    const CameraFit fit = fit_of(o, true);
    EXPECT_EQ(fit.trouble + fit.readout_s.trouble + fit.focal.trouble, "");
    EXPECT_EQ(fit.axis, o.axis);
    EXPECT_NEAR(fit.readout_s.value, o.readout_s, 0.003);
    EXPECT_NEAR(fit.focal.value * o.told_focal, 1, 0.03);
    EXPECT_NEAR(fit.readout_s.value, o.readout_s, 4 * fit.readout_s.sigma);
    EXPECT_NEAR(fit.focal.value * o.told_focal, 1, 4 * fit.focal.sigma);
  }
}

TEST(CameraFit, GlobalShutterIsToldAsOne) {
  ClipOptions o;
  o.readout_s = 0;
  const CameraFit fit = fit_of(o, false);
  EXPECT_TRUE(fit.global);
  EXPECT_EQ(fit.readout_s.trouble, "");
}

TEST(CameraFit, SlowClipCannotTell) {
  ClipOptions o;
  o.speed = 0.01;
  const CameraFit fit = fit_of(o, true);
  EXPECT_FALSE(fit.global);
  EXPECT_NE(fit.readout_s.trouble, "");
}

TEST(CameraFit, TooLittleIsRefused) {
  ClipOptions o;
  o.seconds = 1.5;
  EXPECT_NE(fit_of(o, true).trouble.find("too few"), std::string::npos);
  EXPECT_NE(fit_camera(PointTracks(), test::phone_camera(), RollingShutter(), CameraFitOptions()).trouble, "");
}

}  // namespace
