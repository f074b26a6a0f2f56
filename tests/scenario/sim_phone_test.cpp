// The emulated phone against its own geometry: where things appear, when, how blurred and how noisy.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <set>
#include <sstream>

#include "platform/camera/dump_sequence.h"
#include "platform/camera/image_files.h"
#include "platform/camera/recorded_camera.h"
#include "sim_phone/motion.h"
#include "sim_phone/phone_camera.h"
#include "sim_phone/scene.h"
#include "sim_phone/sensor.h"
#include "tests/support/random.h"

namespace pptam::sim {
namespace {

using Eigen::Isometry3d;

constexpr double kDegree = std::numbers::pi / 180;

CameraModel phone_model() {
  CameraModel m;
  m.width = 240;
  m.height = 320;
  m.fx = m.fy = static_cast<float>(120 / std::tan(18.5 * kDegree));
  m.cx = 119.5f;
  m.cy = 159.5f;
  return m;
}

// Constant velocity and turn rate (rad/s, in the camera), from a pose that looks at the board's middle from 0.55 m,
// slanted by 25 degrees and turned so that the board's lines cross pixels at all phases.
MotionCurve sweep(const Vector3d& velocity, const Vector3d& turn) {
  const Vector3d centre(0.06, -0.22, 0.5);
  const Vector3d z = (Vector3d(0.01, 0.01, 0) - centre).normalized();
  const Vector3d x = z.cross(Vector3d::UnitZ()).normalized();
  Eigen::Matrix3d R;
  R << x, z.cross(x), z;
  R = R * Eigen::AngleAxisd(17 * kDegree, Vector3d::UnitZ()).toRotationMatrix();
  return [=](double t) {
    Isometry3d T = Isometry3d::Identity();
    T.translation() = centre + velocity * t;
    const double rate = turn.norm();
    T.linear() = rate > 0 ? Eigen::Matrix3d(R * Eigen::AngleAxisd(rate * t, turn / rate).toRotationMatrix()) : R;
    return T;
  };
}

// 0.2 m/s sideways and 20 degrees/s: at 0.55 m both move the image by about 130 px/s.
MotionCurve fast_sweep() {
  return sweep({0.16, 0.1, 0.05}, Vector3d(-8, 14, 12) * kDegree);
}

Vector2d project(const CameraModel& m, const Isometry3d& T_wc, const Vector3d& p) {
  const Vector3d p_c = T_wc.inverse() * p;
  return {static_cast<double>(m.fx) * p_c.x() / p_c.z() + static_cast<double>(m.cx),
          static_cast<double>(m.fy) * p_c.y() / p_c.z() + static_cast<double>(m.cy)};
}

// Where the point is when its own line is exposed: px = project(T(dt(px)) p), by fixed-point iteration, which contracts
// by the image speed over the readout speed, here about 200 px/s * 0.06 s / 240 px = 0.05 a step.
Vector2d true_pixel(const CameraModel& m, const RollingShutter& shutter, const MotionCurve& motion, double t_s,
                    const Vector3d& p) {
  Vector2d px = project(m, motion(t_s), p);
  for (int i = 0; i < 12; ++i) {
    const double dt = static_cast<double>(shutter.dt_s(px.cast<float>(), m.width, m.height));
    px = project(m, motion(t_s + dt), p);
  }
  return px;
}

double bilinear(const std::vector<uint8_t>& image, int width, double x, double y) {
  const int ix = static_cast<int>(std::floor(x));
  const int iy = static_cast<int>(std::floor(y));
  const double fx = x - ix;
  const double fy = y - iy;
  const auto at = [&](int cx, int cy) { return static_cast<double>(image[static_cast<size_t>(cy * width + cx)]); };
  return (1 - fy) * ((1 - fx) * at(ix, iy) + fx * at(ix + 1, iy)) +
         fy * ((1 - fx) * at(ix, iy + 1) + fx * at(ix + 1, iy + 1));
}

// The saddle of a quadratic fitted to a weighted window, re-centred until it stays: where a chessboard's corner is. The
// corner is point symmetric, so the odd terms vanish exactly when the window is centred on it.
bool find_saddle(const std::vector<uint8_t>& image, int width, int height, Vector2d* px) {
  constexpr int kRadius = 5;
  for (int iteration = 0; iteration < 15; ++iteration) {
    if (px->x() < kRadius + 1 || px->y() < kRadius + 1 || px->x() > width - kRadius - 3 ||
        px->y() > height - kRadius - 3) {
      return false;
    }
    Eigen::Matrix<double, 6, 6> A = Eigen::Matrix<double, 6, 6>::Zero();
    Eigen::Matrix<double, 6, 1> b = Eigen::Matrix<double, 6, 1>::Zero();
    for (int y = -kRadius; y <= kRadius; ++y) {
      for (int x = -kRadius; x <= kRadius; ++x) {
        const double weight = std::exp(-(x * x + y * y) / (2 * 2.5 * 2.5));
        Eigen::Matrix<double, 6, 1> row;
        row << x * x, x * y, y * y, x, y, 1;
        A += weight * row * row.transpose();
        b += weight * bilinear(image, width, px->x() + x, px->y() + y) * row;
      }
    }
    const Eigen::Matrix<double, 6, 1> q = A.ldlt().solve(b);
    Eigen::Matrix2d H;
    H << 2 * q[0], q[1], q[1], 2 * q[2];
    if (H.determinant() > -1) return false;  // no saddle
    const Vector2d step = -H.inverse() * Vector2d(q[3], q[4]);
    if (step.norm() > 3) return false;
    *px += step;
    if (step.norm() < 1e-3) return true;
  }
  return false;
}

struct CornerErrors {
  int corners = 0;
  double largest = 0;
  double rms = 0;
};

// Corners of the board found in the image, against where they should be with the assumed shutter.
CornerErrors corner_errors(const std::vector<uint8_t>& image, const CameraModel& m, const RollingShutter& truth,
                           const RollingShutter& assumed, const MotionCurve& motion, double t_s) {
  CornerErrors errors;
  double sum_sq = 0;
  for (int j = 1; j < kCheckerRows; ++j) {
    for (int i = 1; i < kCheckerColumns; ++i) {
      const Vector3d p((i - kCheckerColumns / 2) * kCheckerSquare_m, (j - kCheckerRows / 2) * kCheckerSquare_m, 0);
      Vector2d found = true_pixel(m, truth, motion, t_s, p) + Vector2d(0.8, -0.6);  // not where it belongs
      if (!find_saddle(image, m.width, m.height, &found)) continue;
      const double error = (found - true_pixel(m, assumed, motion, t_s, p)).norm();
      ++errors.corners;
      errors.largest = std::max(errors.largest, error);
      sum_sq += error * error;
    }
  }
  errors.rms = std::sqrt(sum_sq / std::max(errors.corners, 1));
  return errors;
}

SensorOptions plain_sensor(RollingShutter::Axis axis, double readout_s, double exposure_s) {
  SensorOptions options;
  options.model = phone_model();
  options.shutter.axis = axis;
  const int lines = axis == RollingShutter::Axis::kColumns ? options.model.width : options.model.height;
  options.shutter.line_time_s = static_cast<float>(readout_s / lines);
  options.exposure_s = exposure_s;
  options.noise = false;
  return options;
}

std::vector<uint8_t> take(Sensor& sensor, const CameraModel& m, double t_s, uint64_t index) {
  std::vector<uint8_t> image(static_cast<size_t>(m.width) * static_cast<size_t>(m.height));
  sensor.expose(t_s, index, image.data());
  return image;
}

// Eight samples a pixel place an edge to about 1/8 px in each pixel, rms 1/8/sqrt(12) = 0.036 px; the window holds some
// 20 edge pixels of each edge, partly dependent, which leaves about 0.02 px rms (measured 0.013 to 0.021; the same
// board with 32 samples 0.011). The largest of 200 two-dimensional errors is about 3.3 times the rms: 0.07 px.
constexpr double kCornerTolerance_px = 0.1;

TEST(SimPhoneGeometry, GlobalShutter) {
  const Scene scene = make_scene("checkerboard", 1);
  for (const MotionCurve& motion : {sweep(Vector3d::Zero(), Vector3d::Zero()), fast_sweep()}) {
    const SensorOptions options = plain_sensor(RollingShutter::Axis::kColumns, 0, 0.005);
    Sensor sensor(scene, motion, options);
    const auto image = take(sensor, options.model, 0.02, 0);
    const CornerErrors errors = corner_errors(image, options.model, options.shutter, options.shutter, motion, 0.02);
    std::printf("global shutter: %d corners, %.3f px rms, %.3f px largest\n", errors.corners, errors.rms,
                errors.largest);
    EXPECT_GT(errors.corners, 100);
    EXPECT_LT(errors.largest, kCornerTolerance_px);
  }
}

TEST(SimPhoneGeometry, RollingShutterInEveryDirection) {
  const Scene scene = make_scene("checkerboard", 1);
  const MotionCurve motion = fast_sweep();
  for (const RollingShutter::Axis axis : {RollingShutter::Axis::kColumns, RollingShutter::Axis::kRows}) {
    for (const double readout_s : {-0.06, 0.06}) {
      const SensorOptions options = plain_sensor(axis, readout_s, 0.005);
      Sensor sensor(scene, motion, options);
      const auto image = take(sensor, options.model, 0.02, 0);
      const CornerErrors errors = corner_errors(image, options.model, options.shutter, options.shutter, motion, 0.02);
      std::printf("readout %+.3f s by %s: %d corners, %.3f px rms, %.3f px largest\n", readout_s,
                  axis == RollingShutter::Axis::kColumns ? "columns" : "rows", errors.corners, errors.rms,
                  errors.largest);
      EXPECT_GT(errors.corners, 100);
      EXPECT_LT(errors.largest, kCornerTolerance_px);

      // Negative control: the other direction is wrong by twice dt times the image speed, up to 2 * 0.03 s * 100 px/s.
      RollingShutter flipped = options.shutter;
      flipped.line_time_s = -flipped.line_time_s;
      const CornerErrors wrong = corner_errors(image, options.model, options.shutter, flipped, motion, 0.02);
      EXPECT_GT(wrong.rms, 10 * kCornerTolerance_px);
    }
  }
}

// The same through the public interface: frames of the checkerboard against ground_truth().
TEST(SimPhoneGeometry, GroundTruthIsThePoseAtTheTimestamp) {
  PhoneOptions options;
  options.scene = "checkerboard";
  options.duration_s = 3;
  options.readout_s = 0;
  options.exposure_s = 0.001;
  options.noise = false;
  const auto camera = make_phone_camera(options);
  const platform::Trajectory truth = camera->ground_truth();
  Frame frame;
  size_t index = 0;
  int checked = 0;
  while (camera->read(&frame)) {
    ASSERT_LT(index, truth.size());
    ASSERT_EQ(frame.timestamp_ns, truth[index].timestamp_ns);
    if (index % 9 == 8) {
      const std::vector<uint8_t> image(frame.data, frame.data + frame.width * frame.height);
      const Isometry3d T_wc = truth[index].T_wc;
      const CornerErrors errors = corner_errors(
          image, camera->info().model, {}, {}, [&](double) { return T_wc; }, 0);
      EXPECT_GT(errors.corners, 20);
      EXPECT_LT(errors.largest, kCornerTolerance_px);
      // Negative control: the pose of the frame before is not this frame's.
      const Isometry3d before = truth[index - 1].T_wc;
      CornerErrors wrong;
      for (int i = 5; i < 15; ++i) {
        const Vector3d p((i - 10) * kCheckerSquare_m, 0, 0);
        wrong.largest = std::max(
            wrong.largest, (project(camera->info().model, before, p) - project(camera->info().model, T_wc, p)).norm());
      }
      EXPECT_GT(wrong.largest, 2 * kCornerTolerance_px);
      ++checked;
    }
    ++index;
  }
  EXPECT_EQ(index, truth.size());
  EXPECT_GE(checked, 4);
}

double gradient_energy(const std::vector<uint8_t>& image, int width, int height) {
  double sum = 0;
  for (int y = 0; y < height - 1; ++y) {
    for (int x = 0; x < width - 1; ++x) {
      const int here = image[static_cast<size_t>(y * width + x)];
      const double dx = image[static_cast<size_t>(y * width + x + 1)] - here;
      const double dy = image[static_cast<size_t>((y + 1) * width + x)] - here;
      sum += dx * dx + dy * dy;
    }
  }
  return sum;
}

TEST(SimPhoneSensor, BlurGrowsWithExposure) {
  const Scene scene = make_scene("checkerboard", 1);
  const auto energy = [&](const MotionCurve& motion, double exposure_s) {
    const SensorOptions options = plain_sensor(RollingShutter::Axis::kColumns, 0, exposure_s);
    Sensor sensor(scene, motion, options);
    return gradient_energy(take(sensor, options.model, 0, 0), options.model.width, options.model.height);
  };
  // An edge blurred over b pixels (b > 1) has gradient energy 1/b. At about 200 px/s, 1, 15 and 40 ms smear edges that
  // lie across the motion over 1 (the pixel itself), 3 and 8 px, those along it not at all.
  const double sharp = energy(fast_sweep(), 0.001);
  const double middle = energy(fast_sweep(), 0.015);
  const double blurred = energy(fast_sweep(), 0.040);
  std::printf("gradient energy at 15 ms %.2f, at 40 ms %.2f of that at 1 ms\n", middle / sharp, blurred / sharp);
  EXPECT_LT(middle, 0.85 * sharp);
  EXPECT_LT(blurred, 0.75 * middle);
  // Negative control: without motion the exposure changes nothing at all.
  const MotionCurve still = sweep(Vector3d::Zero(), Vector3d::Zero());
  EXPECT_EQ(energy(still, 0.001), energy(still, 0.040));
}

// One grey surface that fills the view, left half three times as bright as the right.
Scene two_greys() {
  Scene scene;
  Surface s;
  s.origin = {-2, 2, 0};
  s.v_axis = -Vector3d::UnitY();
  s.width_m = s.height_m = 4;
  s.texel_m = 0.4;
  Texture::Level level{10, 10, {}};
  for (int i = 0; i < 100; ++i) level.texels.push_back(i % 10 < 5 ? 45000 : 4500);
  s.texture.levels.push_back(level);
  scene.surfaces.push_back(s);
  return scene;
}

TEST(SimPhoneSensor, NoiseIsAsStated) {
  const Scene scene = two_greys();
  SensorOptions options = plain_sensor(RollingShutter::Axis::kColumns, 0, 0.03);
  options.noise = true;
  const MotionCurve still = sweep(Vector3d::Zero(), Vector3d::Zero());
  Sensor sensor(scene, still, options);
  constexpr int kFrames = 20;
  const size_t pixels = static_cast<size_t>(options.model.width * options.model.height);
  std::vector<double> sum(pixels), sum_sq(pixels);
  for (int f = 0; f < kFrames; ++f) {
    const auto image = take(sensor, options.model, 0.0667 * f, static_cast<uint64_t>(f));
    for (size_t i = 0; i < pixels; ++i) {
      sum[i] += image[i];
      sum_sq[i] += static_cast<double>(image[i]) * image[i];
    }
  }
  double mid_variance = 0, dim_variance = 0;
  int mid = 0, dim = 0;
  for (size_t i = 0; i < pixels; ++i) {
    const double mean = sum[i] / kFrames;
    const double variance = (sum_sq[i] - kFrames * mean * mean) / (kFrames - 1);
    if (mean > 30 && mean < 75) {
      dim_variance += variance;
      ++dim;
    } else if (mean > 118 && mean < 200) {
      mid_variance += variance;
      ++mid;
    }
  }
  ASSERT_GT(mid, 2000);
  ASSERT_GT(dim, 2000);
  const double mid_rms = std::sqrt(mid_variance / mid);
  const double dim_rms = std::sqrt(dim_variance / dim);
  std::printf("noise: %.2f grey levels rms at mid grey, %.2f in the shadows\n", mid_rms, dim_rms);
  // 2.05 at grey 128 (1.8 at 180), 3.8 at grey 52 by the sensor's constants, with the nominal gain. The gain here is
  // within a factor 0.7 to 1.4 of it, and noise goes as its root or faster; 40000 samples leave under 1 %.
  EXPECT_GT(mid_rms, 1.3);
  EXPECT_LT(mid_rms, 2.8);
  EXPECT_GT(dim_rms, 1.3 * mid_rms);
  // Negative control: without noise nothing changes from frame to frame.
  options.noise = false;
  Sensor clean(scene, still, options);
  const auto first = take(clean, options.model, 0, 0);
  EXPECT_EQ(first, take(clean, options.model, 0.0667, 1));
}

TEST(SimPhoneSensor, AutoExposureLagsTheScene) {
  // From the dark half to the bright half within one frame: the first image after is too bright, later ones recover.
  const Scene scene = two_greys();
  SensorOptions options = plain_sensor(RollingShutter::Axis::kColumns, 0, 0.001);
  options.noise = true;
  const MotionCurve jump = [](double t) {
    Isometry3d T = Isometry3d::Identity();
    T.linear() = Eigen::AngleAxisd(std::numbers::pi, Vector3d::UnitX()).toRotationMatrix();  // straight down
    T.translation() = Vector3d(t < 1 ? 1 : -1, 0, 0.5);
    return T;
  };
  Sensor sensor(scene, jump, options);
  std::vector<double> mean;
  for (int f = 0; f < 60; ++f) {
    const double t = f / 15.0;
    const auto image = take(sensor, options.model, t + 0.01, static_cast<uint64_t>(f));
    double sum = 0;
    for (const uint8_t g : image) sum += g;
    mean.push_back(sum / static_cast<double>(image.size()));
  }
  EXPECT_NEAR(mean[13], mean[0], 2);    // settled before the jump
  EXPECT_GT(mean[15], mean[13] + 40);   // ten times as much light: saturated
  EXPECT_GT(mean[17], mean[13] + 20);   // 0.13 s later still, with a lag of 0.5 s
  EXPECT_NEAR(mean[59], mean[13], 10);  // 3 s later: exp(-6) of log 10 is left
}

// Bytes of the first frames.
std::vector<uint8_t> footage(const PhoneOptions& options) {
  const auto camera = make_phone_camera(options);
  std::vector<uint8_t> bytes;
  Frame frame;
  while (camera->read(&frame)) bytes.insert(bytes.end(), frame.data, frame.data + frame.width * frame.height);
  return bytes;
}

// Mean absolute difference of two images of equal size.
double difference(const std::vector<uint8_t>& a, const std::vector<uint8_t>& b) {
  double sum = 0;
  for (size_t i = 0; i < a.size(); ++i) sum += std::abs(a[i] - b[i]);
  return sum / static_cast<double>(a.size());
}

TEST(SimPhoneCamera, SameSeedSameBytesOtherSeedOtherWorld) {
  for (const char* scene : {"boxes", "walls", "checkerboard"}) {  // the desk is the boxes' table
    PhoneOptions options;
    options.scene = scene;
    options.duration_s = 0.14;  // two frames
    options.seed = 5;
    const auto first = footage(options);
    EXPECT_EQ(first.size(), 2u * 240 * 320);
    EXPECT_EQ(first, footage(options)) << scene;
    options.seed = 6;
    const auto other = footage(options);
    ASSERT_EQ(first.size(), other.size());
    EXPECT_GT(difference(first, other), 8) << scene;  // noise alone makes 2.3 (1.13 sigma)
  }
}

TEST(SimPhoneCamera, DropsFramesAndKeepsTime) {
  PhoneOptions options;
  options.scene = "checkerboard";
  options.motion = "still";
  options.width = 60;
  options.height = 80;
  options.duration_s = 40;
  options.drop_probability = 0.25;
  const auto camera = make_phone_camera(options);
  const auto truth = camera->ground_truth();
  int delivered = 0;
  int64_t last = -1;
  int gaps = 0;
  Frame frame;
  while (camera->read(&frame)) {
    ASSERT_GT(frame.timestamp_ns, last);
    if (last >= 0 && frame.timestamp_ns - last > 70'000'000) ++gaps;
    ASSERT_EQ(frame.timestamp_ns, truth[static_cast<size_t>(delivered)].timestamp_ns);
    last = frame.timestamp_ns;
    ++delivered;
  }
  EXPECT_EQ(delivered, camera->info().frame_count);
  // 600 frames, a quarter dropped: 450, standard deviation sqrt(600 * 0.25 * 0.75) = 10.6; five of them.
  EXPECT_NEAR(delivered, 450, 53);
  EXPECT_GT(gaps, 50);
  // Negative control: without drops all arrive.
  options.drop_probability = 0;
  EXPECT_EQ(make_phone_camera(options)->info().frame_count, 600);
}

TEST(SimPhoneCamera, BadOptionsAreNamed) {
  const auto message = [](void (*spoil)(PhoneOptions&)) -> std::string {
    PhoneOptions options;
    options.scene = "checkerboard";
    spoil(options);
    try {
      make_phone_camera(options);
    } catch (const platform::InputError& error) {
      return error.what();
    }
    return "accepted";
  };
  const auto names = [&](const char* option, void (*spoil)(PhoneOptions&)) {
    EXPECT_NE(message(spoil).find(option), std::string::npos) << message(spoil);
  };
  names("scene", [](PhoneOptions& o) { o.scene = "moon"; });
  names("motion", [](PhoneOptions& o) { o.motion = ""; });
  names("duration_s", [](PhoneOptions& o) { o.duration_s = std::nan(""); });
  names("duration_s", [](PhoneOptions& o) { o.duration_s = 0; });
  names("width", [](PhoneOptions& o) { o.width = 0; });
  names("height", [](PhoneOptions& o) { o.height = 1 << 20; });
  names("horizontal_fov_degrees", [](PhoneOptions& o) { o.horizontal_fov_degrees = 180; });
  names("frames_per_s", [](PhoneOptions& o) { o.frames_per_s = -15; });
  names("readout_s", [](PhoneOptions& o) { o.readout_s = 0.2; });
  names("exposure_s", [](PhoneOptions& o) { o.exposure_s = -0.01; });
  names("drop_probability", [](PhoneOptions& o) { o.drop_probability = 1; });
  EXPECT_EQ(message([](PhoneOptions&) {}), "accepted");
}

TEST(SimPhoneMotion, CalmHandsStayCalmAndInReach) {
  std::set<int> directions;
  for (uint64_t seed = 1; seed <= 24; ++seed) {
    for (const Stage::Kind kind : {Stage::Kind::kTable, Stage::Kind::kCorner}) {
      Stage stage;
      stage.kind = kind;
      stage.azimuth_rad = 0.5;
      const MotionCurve motion = make_motion("calm", stage, seed, 20);
      double path = 0, fastest = 0, fastest_turn = 0;
      double nearest = 1e9, farthest = 0, lowest = 1e9;
      std::vector<double> turns;
      constexpr double kStep_s = 0.1;
      for (int i = 0; i < 200; ++i) {
        const Isometry3d a = motion(i * kStep_s);
        const Isometry3d b = motion((i + 1) * kStep_s);
        const double step = (b.translation() - a.translation()).norm();
        path += step;
        fastest = std::max(fastest, step / kStep_s);
        const double turn = Eigen::AngleAxisd(a.linear().transpose() * b.linear()).angle() / kStep_s / kDegree;
        fastest_turn = std::max(fastest_turn, turn);
        turns.push_back(turn);
        lowest = std::min(lowest, a.translation().z());
        // Distance along the optical axis to the table, or to the nearer wall.
        const Vector3d d = a.linear().col(2);
        const Vector3d p = a.translation();
        double depth = 1e9;
        if (kind == Stage::Kind::kTable) {
          depth = -p.z() / d.z();
        } else {
          if (d.x() < 0) depth = std::min(depth, -p.x() / d.x());
          if (d.y() < 0) depth = std::min(depth, -p.y() / d.y());
        }
        nearest = std::min(nearest, depth);
        farthest = std::max(farthest, depth);
      }
      std::sort(turns.begin(), turns.end());
      const std::string where = (kind == Stage::Kind::kTable ? "table " : "corner ") + std::to_string(seed);
      // Designed: 1 to 2 m of path with sway and tremor on top, moves of at most 0.2 m/s and 24 degrees/s each, at
      // most two overlapping at their slow ends; tremor adds 2 * amplitude / 0.1 s = 10 mm/s and 3 degrees/s an axis.
      EXPECT_GT(path, 1.0) << where;
      EXPECT_LT(path, 2.3) << where;
      EXPECT_LT(fastest, 0.26) << where;
      EXPECT_LT(fastest_turn, 36) << where;
      EXPECT_LT(turns[190], 30) << where;
      EXPECT_GT(nearest, kind == Stage::Kind::kTable ? 0.30 : 0.45) << where;
      EXPECT_LT(farthest, 1.15) << where;
      EXPECT_GT(lowest, 0.22) << where;
      // It holds still for a second, then moves sideways by 10 to 20 cm.
      EXPECT_LT((motion(0.95).translation() - motion(0).translation()).norm(), 0.012) << where;
      const Vector3d start = motion(0.5).linear().transpose() * (motion(3.2).translation() - motion(0.5).translation());
      EXPECT_GT(start.norm(), 0.07) << where;
      EXPECT_LT(start.norm(), 0.3) << where;
      directions.insert(static_cast<int>(std::floor(4 * std::atan2(start.y(), start.x()) / std::numbers::pi)));
      // Twice continuously differentiable: over 1 ms the acceleration of an 0.5 mm, 10 Hz tremor (2 m/s^2 and axis)
      // changes by 0.06 of itself; a jump of velocity of 1 cm/s would show as 10 m/s^2.
      for (int i = 0; i < 2000; ++i) {
        const double t = 0.01 * i;
        const Vector3d bend =
            (motion(t + 0.001).translation() - 2 * motion(t).translation() + motion(t - 0.001).translation()) / 1e-6;
        ASSERT_LT(bend.norm(), 5) << where << " at " << t;
      }
    }
  }
  EXPECT_GE(directions.size(), 3u);  // seeds start in different directions
}

TEST(SimPhoneMotion, StillAndPureRotation) {
  for (const Stage::Kind kind : {Stage::Kind::kTable, Stage::Kind::kCorner}) {
    Stage stage;
    stage.kind = kind;
    const MotionCurve still = make_motion("still", stage, 3, 10);
    const MotionCurve turning = make_motion("pure_rotation", stage, 3, 10);
    double largest = 0;
    for (double t = 0; t < 10; t += 0.1) {
      EXPECT_TRUE(still(t).matrix() == still(0).matrix());
      EXPECT_TRUE(turning(t).translation() == turning(0).translation());
      largest =
          std::max(largest, Eigen::AngleAxisd(turning(0).linear().transpose() * turning(t).linear()).angle() / kDegree);
    }
    EXPECT_GT(largest, 12);
  }
}

std::string text_of(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::stringstream text;
  text << in.rdbuf();
  return text.str();
}

TEST(SimPhoneCamera, DumpedSequenceReadsBackTheSame) {
  const std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("pptam_sim_phone_test_" + std::to_string(test::Random().seed()));
  std::filesystem::remove_all(folder);
  PhoneOptions options;
  options.scene = "checkerboard";
  options.duration_s = 0.5;
  options.drop_probability = 0.2;
  const auto camera = make_phone_camera(options);
  static int last_done = 0;
  platform::dump_sequence(*camera, folder, [](int done, int total) {
    last_done = done;
    EXPECT_LE(done, total);
    return true;
  });
  EXPECT_EQ(last_done, camera->info().frame_count);
  const std::string calibration = text_of(folder / "calibration.yaml");
  for (const char* key : {"camera_model: pinhole", "resolution: [240, 320]", "readout_s: 0.06", "readout_axis: columns",
                          "readout_direction: -1", "exposure_s: 0.03"}) {
    EXPECT_NE(calibration.find(key), std::string::npos) << key << " in\n" << calibration;
  }

  platform::RecordingOptions recording;
  recording.source = folder;
  recording.calibration = folder / "calibration.yaml";
  const auto replay = platform::open_recording(recording, nullptr);
  const auto original = make_phone_camera(options);
  EXPECT_FLOAT_EQ(replay->info().model.fx, original->info().model.fx);
  EXPECT_FLOAT_EQ(replay->info().model.cy, original->info().model.cy);
  EXPECT_FLOAT_EQ(replay->info().shutter.line_time_s, original->info().shutter.line_time_s);
  EXPECT_TRUE(replay->info().shutter.axis == original->info().shutter.axis);
  Frame a, b;
  int frames = 0;
  while (original->read(&a)) {
    ASSERT_TRUE(replay->read(&b));
    EXPECT_EQ(a.timestamp_ns, b.timestamp_ns);
    for (int y = 0; y < a.height; ++y) {
      ASSERT_TRUE(
          std::equal(a.data + y * a.stride_bytes, a.data + y * a.stride_bytes + a.width, b.data + y * b.stride_bytes));
    }
    ++frames;
  }
  EXPECT_FALSE(replay->read(&b));
  EXPECT_GT(frames, 2);
  const auto truth = original->ground_truth();
  const auto read_back = replay->ground_truth();
  ASSERT_EQ(truth.size(), read_back.size());
  for (size_t i = 0; i < truth.size(); ++i) {
    EXPECT_EQ(truth[i].timestamp_ns, read_back[i].timestamp_ns);
    // Nine significant digits of numbers below 1.
    EXPECT_LT((truth[i].T_wc.matrix() - read_back[i].T_wc.matrix()).cwiseAbs().maxCoeff(), 1e-8);
  }
  // A folder that holds something is refused.
  EXPECT_THROW(platform::dump_sequence(*original, folder, nullptr), platform::InputError);
  std::filesystem::remove_all(folder);
}

TEST(SimPhoneCamera, RendersTwentySecondsInFifteen) {
  PhoneOptions options;
  options.duration_s = 2;
  const auto camera = make_phone_camera(options);
  const std::clock_t start = std::clock();  // processor time: others may use the machine
  Frame frame;
  int frames = 0;
  while (camera->read(&frame)) ++frames;
  const double ms = 1000.0 * static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC / frames;
  std::printf("desk: %.1f ms a frame\n", ms);
  EXPECT_EQ(frames, 30);
#if defined(NDEBUG) && !defined(__SANITIZE_ADDRESS__)
  EXPECT_LT(ms, 50);  // 300 frames in 15 s; measured 11
#endif
}

}  // namespace
}  // namespace pptam::sim
