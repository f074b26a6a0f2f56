// Where the renderer draws the world: as the core's own projection says, and, at the end of a whole run, where the
// truth has it.
#include <gtest/gtest.h>

#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <vector>

#include "platform/display/house.h"
#include "platform/run/evaluation.h"
#include "platform/run/run.h"
#include "sim_phone/phone_camera.h"
#include "sim_phone/story.h"
#include "sim_phone/story_parts.h"
#include "tests/display/software.h"
#include "tests/support/phone_camera.h"
#include "tests/support/random.h"

namespace pptam {
namespace {

using platform::Eye;
using platform::Scene;
using platform::WorldModel;

constexpr int kScale = 4;  // pixels of the canvas for one of the image

// Each point as a disc of a colour of its own; where its pixels' mean lies, in pixels of the image.
class Marks {
 public:
  explicit Marks(const pptam::Camera& camera)
      : camera_(camera), display_(test::software_display(camera.model.width * kScale, camera.model.height * kScale)) {}

  bool there() const { return display_ != nullptr; }

  // NaN of a point that is not seen whole.
  std::vector<Vector2f> drawn(const std::vector<Vector3f>& points_w, const SE3& T_cw, const Vector6f& velocity) {
    model_.points.clear();
    ++model_.revision;
    constexpr float kDiameter_px = 9;
    for (size_t i = 0; i < points_w.size(); ++i)
      model_.points.push_back({points_w[i], {static_cast<uint8_t>(i + 1), 255, 0, 255}, kDiameter_px});
    Scene scene;
    scene.width = display_->width();
    scene.height = display_->height();
    scene.view = {0, 0, static_cast<float>(scene.width), static_cast<float>(scene.height)};
    Eye eye;
    eye.camera = camera_;
    eye.T_cw = T_cw;
    eye.velocity = velocity;
    scene.eye = eye;
    scene.models = {&model_};
    display_->draw(scene, &rgba_);
    struct Sum {
      double x = 0, y = 0;
      int pixels = 0;
    };
    std::vector<Sum> sums(points_w.size() + 1);
    for (int y = 0; y < scene.height; ++y) {
      for (int x = 0; x < scene.width; ++x) {
        const uint8_t* pixel = &rgba_[4 * static_cast<size_t>(y * scene.width + x)];
        if (pixel[0] == 0 || pixel[0] > points_w.size()) continue;
        Sum& sum = sums[pixel[0]];
        sum.x += x + 0.5;
        sum.y += y + 0.5;
        ++sum.pixels;
      }
    }
    std::vector<Vector2f> means;
    constexpr int kWhole = 55;  // of 64 pixels: the disc's area; fewer where another disc or the border covers it
    for (size_t i = 1; i < sums.size(); ++i) {
      const Sum& sum = sums[i];
      means.emplace_back(static_cast<float>(sum.x / sum.pixels / kScale - 0.5),
                         static_cast<float>(sum.y / sum.pixels / kScale - 0.5));
      if (sum.pixels < kWhole) means.back().setConstant(std::nanf(""));
    }
    return means;
  }

 private:
  pptam::Camera camera_;
  std::unique_ptr<platform::Display> display_;
  WorldModel model_;
  std::vector<uint8_t> rgba_;
};

CameraModel lens(Distortion distortion) {
  CameraModel model;
  model.width = 320;
  model.height = 240;
  model.fx = 170;
  model.fy = 172;
  model.cx = 161.5f;
  model.cy = 117.5f;
  model.distortion = distortion;
  const std::array<std::array<float, 5>, 4> coeffs = {
      {{}, {0.92f}, {-0.21f, 0.04f, 0.002f, -0.003f, 0.001f}, {-0.02f, 0.01f, -0.006f, 0.001f}}};
  const auto& of_kind = coeffs[static_cast<size_t>(distortion)];
  std::copy(of_kind.begin(), of_kind.end(), model.coeffs);
  model.prepare();
  return model;
}

// The core projects in float32 with the same equations and as many passes: what is left is a disc's mean. Its edge
// takes or leaves whole pixels, of 64: below a tenth of a canvas pixel a coordinate, 0.025 of the image's.
TEST(Projection, IsTheCoresWithEveryLensAndShutter) {
  test::Random random;
  for (const Distortion distortion :
       {Distortion::kNone, Distortion::kFov, Distortion::kRadTan, Distortion::kEquidistant}) {
    for (const float line_time_s : {0.0f, 0.0001f, -0.0002f}) {
      pptam::Camera camera;
      camera.model = lens(distortion);
      camera.shutter = {line_time_s < 0 ? RollingShutter::Axis::kColumns : RollingShutter::Axis::kRows, line_time_s};
      Marks marks(camera);
      if (!marks.there()) GTEST_SKIP() << "nothing can be drawn here";
      double sum_sq = 0;
      double worst = 0;
      double shift = 0;  // by the shutter
      int compared = 0;
      for (int trial = 0; trial < 3; ++trial) {
        Vector6f velocity;
        for (int i = 0; i < 6; ++i) velocity[i] = static_cast<float>(random.uniform(-0.6, 0.6));
        Vector6f pose;
        for (int i = 0; i < 6; ++i) pose[i] = static_cast<float>(random.uniform(-2, 2));
        const SE3 T_cw = SE3::exp(pose);
        const SE3 T_wc = T_cw.inverse();
        std::vector<Vector3f> points_w;
        for (int i = 0; i < 60; ++i) {
          const Vector2f px(static_cast<float>(random.uniform(5, 315)), static_cast<float>(random.uniform(5, 235)));
          const auto depth = static_cast<float>(random.uniform(0.5, 4));
          points_w.push_back(T_wc * Vector3f(depth * camera.unproject(px).homogeneous()));
        }
        const std::vector<Vector2f> drawn = marks.drawn(points_w, T_cw, velocity);
        for (size_t i = 0; i < points_w.size(); ++i) {
          PredictedPoint seen;
          if (!camera.project_rolling(T_cw, velocity, points_w[i], &seen) || !drawn[i].allFinite()) continue;
          const auto error = static_cast<double>((drawn[i] - seen.px).norm());
          sum_sq += error * error;
          worst = std::max(worst, error);
          Vector2f still;
          if (camera.project(T_cw * points_w[i], &still))
            shift = std::max(shift, static_cast<double>((still - seen.px).norm()));
          ++compared;
        }
      }
      const double rms = std::sqrt(sum_sq / compared);
      std::printf("  lens %d, line time %g: %d points, rms %.3f px, worst %.3f; the shutter moves up to %.1f px\n",
                  static_cast<int>(distortion), static_cast<double>(line_time_s), compared, rms, worst, shift);
      EXPECT_GT(compared, 60);
      EXPECT_LT(rms, 0.035);
      EXPECT_LT(worst, 0.1);
      if (line_time_s == 0) continue;
      EXPECT_GT(shift, 1) << "control: without the shutter's motion it would be off";
    }
  }
}

// What is beside or behind the camera stays away from the picture.
TEST(Projection, ShowsNothingFromBehind) {
  for (const Distortion distortion :
       {Distortion::kNone, Distortion::kFov, Distortion::kRadTan, Distortion::kEquidistant}) {
    const pptam::Camera camera = {lens(distortion), {RollingShutter::Axis::kRows, 0.0001f}};
    Marks marks(camera);
    if (!marks.there()) GTEST_SKIP() << "nothing can be drawn here";
    const std::vector<Vector2f> drawn = marks.drawn(
        {{0, 0, -1}, {0.1f, 0.2f, -2}, {30, 0, 1}, {0, -40, 0.5f}, {5, 5, -0.01f}, {0, 0, 2}}, SE3(), Vector6f::Zero());
    for (size_t i = 0; i < 5; ++i) EXPECT_FALSE(drawn[i].allFinite()) << i;
    EXPECT_TRUE(drawn[5].allFinite()) << "control: this one is before it";
  }
}

// ---- A whole run -------------------------------------------------------------------------------------------------

struct DrawnFrame {
  int64_t timestamp_ns = 0;
  SE3 T_cw;
  Vector6f velocity = Vector6f::Zero();
};

// Where the truth sees a point: each line at the camera's true pose at its time.
bool true_pixel(const sim::Story& story, const pptam::Camera& camera, int64_t timestamp_ns, const Eigen::Vector3d& p,
                Vector2f* px) {
  double dt_s = 0;
  for (int pass = 0; pass < 8; ++pass) {
    const Eigen::Isometry3d T_wc = story.curve(1e-9 * static_cast<double>(timestamp_ns) + dt_s);
    const Vector3f p_c = (T_wc.inverse() * p).cast<float>();
    if (!camera.project(p_c, px)) return false;
    dt_s = static_cast<double>(camera.dt_s(*px));
  }
  return true;
}

// From the estimate's world to the truth's. The rotation is the mean of the orientations' differences: positions along
// a path of some decimetres would leave it a third of a degree off, two pixels. Scale and shift are those of least
// squares.
platform::Similarity alignment(const platform::Trajectory& estimate, const sim::Story& story) {
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  Eigen::Vector3d true_mean = Eigen::Vector3d::Zero();
  const auto truth = [&](const platform::StampedPose& pose) {
    return story.curve(1e-9 * static_cast<double>(pose.timestamp_ns));
  };
  for (const platform::StampedPose& pose : estimate) {
    sum += truth(pose).rotation() * pose.T_wc.rotation().transpose();
    mean += pose.T_wc.translation() / static_cast<double>(estimate.size());
    true_mean += truth(pose).translation() / static_cast<double>(estimate.size());
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(sum, Eigen::ComputeFullU | Eigen::ComputeFullV);
  platform::Similarity similarity;
  similarity.R = svd.matrixU() * svd.matrixV().transpose();
  double along = 0;
  double square = 0;
  for (const platform::StampedPose& pose : estimate) {
    const Eigen::Vector3d turned = similarity.R * (pose.T_wc.translation() - mean);
    along += turned.dot(truth(pose).translation() - true_mean);
    square += turned.squaredNorm();
  }
  similarity.scale = along / square;
  similarity.t = true_mean - similarity.scale * (similarity.R * mean);
  return similarity;
}

// The first map rests on few views, which under a rolling shutter are bent by a velocity that is known roughly. Further
// ones mend that: what it costs is told apart.
constexpr double kYoung_s = 3;

struct Registration {
  double rms_px = 0, without_velocity_px = 0;
  double young_px = 0, grown_px = 0;  // rms, before the map is kYoung_s old and from then on
  int corners = 0;
};

// A story is tracked; the house stands where the first pose puts it. Estimate and truth differ by a similarity, which
// comes from the whole path; then the house's corners as drawn are held against where the true camera sees them.
Registration registration(const sim::PhoneOptions& options) {
  const auto scene = std::make_shared<const sim::Scene>(sim::make_scene(options));
  const sim::Story story = sim::story_of(options, *scene);
  const std::unique_ptr<platform::Camera> phone = sim::make_phone_camera(options, scene);
  std::vector<DrawnFrame> frames;
  platform::Spectator spectator;
  spectator.show = [&](const Frame&, const TrackResult& result, const platform::FrameLog&, const System&) {
    if (result.pose_valid) frames.push_back({result.timestamp_ns, result.T_cw, result.velocity});
  };
  const platform::RunLog log = platform::run_sequence(
      *phone, platform::RunOptions(), [](const platform::CameraInfo&) {}, {}, spectator);
  Registration found;
  if (frames.empty()) return found;
  const platform::Similarity to_truth = alignment(log.trajectory(), story);
  const platform::Site site = platform::place_house(frames.front().T_cw, Config().initial_baseline);
  std::vector<Vector3f> corners_w;
  for (const Vector3f& p_h : platform::house_corners()) corners_w.push_back(site.to_world(p_h));
  pptam::Camera camera = {log.camera.model, log.camera.shutter};
  camera.model.prepare();
  Marks marks(camera);
  if (!marks.there()) return found;
  double sums[2] = {0, 0};
  double by_age[2] = {0, 0};
  int corners_by_age[2] = {0, 0};
  for (size_t k = 0; k < frames.size(); k += 5) {
    const DrawnFrame& frame = frames[k];
    const std::vector<Vector2f> drawn = marks.drawn(corners_w, frame.T_cw, frame.velocity);
    const std::vector<Vector2f> at_rest = marks.drawn(corners_w, frame.T_cw, Vector6f::Zero());
    for (size_t i = 0; i < corners_w.size(); ++i) {
      Vector2f truth;
      if (!drawn[i].allFinite() || !at_rest[i].allFinite() ||
          !true_pixel(story, camera, frame.timestamp_ns, to_truth * corners_w[i].cast<double>(), &truth))
        continue;
      sums[0] += static_cast<double>((drawn[i] - truth).squaredNorm());
      sums[1] += static_cast<double>((at_rest[i] - truth).squaredNorm());
      ++found.corners;
      const int64_t age_ns = frame.timestamp_ns - frames.front().timestamp_ns;
      const int grown = 1e-9 * static_cast<double>(age_ns) < kYoung_s ? 0 : 1;
      by_age[grown] += static_cast<double>((drawn[i] - truth).squaredNorm());
      ++corners_by_age[grown];
    }
  }
  found.young_px = std::sqrt(by_age[0] / std::max(corners_by_age[0], 1));
  found.grown_px = std::sqrt(by_age[1] / std::max(corners_by_age[1], 1));
  found.rms_px = std::sqrt(sums[0] / found.corners);
  found.without_velocity_px = std::sqrt(sums[1] / found.corners);
  return found;
}

TEST(House, StandsWithinAPixelOfTheTruthWithEitherShutter) {
  if (Marks({test::phone_camera(), {}}).there() == false) GTEST_SKIP() << "nothing can be drawn here";
  const bool all = std::getenv("PPTAM_ALL") != nullptr;
  for (const double readout_s : {0.0, -0.060}) {
    for (const uint64_t seed : all ? std::vector<uint64_t>{1, 2, 3, 4, 5} : std::vector<uint64_t>{3}) {
      sim::PhoneOptions options;
      options.scene = seed % 2 == 1 ? "desk" : "boxes";
      options.seed = seed;
      options.duration_s = all ? 20 : 14;
      options.readout_s = readout_s;
      const Registration found = registration(options);
      std::printf(
          "  %s, seed %d, readout %g s: %d corners, rms %.2f px (young map %.2f, grown %.2f); with a velocity of zero "
          "%.2f px\n",
          options.scene.c_str(), static_cast<int>(seed), readout_s, found.corners, found.rms_px, found.young_px,
          found.grown_px, found.without_velocity_px);
      EXPECT_GT(found.corners, 100);
      EXPECT_LT(found.rms_px, 1);
      if (readout_s == 0) continue;
      EXPECT_GT(found.without_velocity_px, 1.3 * found.rms_px) << "control: lines are not at their own times";
    }
  }
}

}  // namespace
}  // namespace pptam
