// A camera before a printed checkerboard, for tests: any lens of the core, a rolling shutter, motion blur, noise. Its
// truth is known to a fraction of a thousandth of a pixel, because the board is drawn by formula and not by texture.
//
// A pixel is the mean of samples over its area and over its line's exposure, in linear light.
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <vector>

#include "platform/calibrate/board.h"
#include "platform/camera.h"
#include "sim_phone/random.h"

namespace pptam::test {

struct BoardCameraOptions {
  CameraModel model;  // prepared
  RollingShutter shutter;
  double exposure_s = 0;
  platform::Board board;
  double rim = 1;       // white, round the board, in squares; the table beyond is grey
  double aspect = 1;    // height of a square by its width
  double noise = 2;     // standard deviation, of 255
  double focus_px = 0;  // radius of the blur by the lens
  uint64_t seed = 1;
  double frames_per_s = 30;
};

class BoardCamera : public platform::Camera {
 public:
  // The board's coordinates (platform::Board::plane(), z away from who looks at it) to the camera's, at a time.
  using Motion = std::function<Eigen::Isometry3d(double t_s)>;

  BoardCamera(const BoardCameraOptions& options, Motion motion, int frames)
      : options_(options), motion_(std::move(motion)), pixels_(pixel_count()) {
    info_.model = options.model;
    info_.shutter = options.shutter;
    info_.exposure_s = static_cast<float>(options.exposure_s);
    info_.frames_per_s = options.frames_per_s;
    info_.frame_count = frames;
    info_.name = "board, seed " + std::to_string(options.seed);
    for (int y = 0; y < info_.model.height; ++y) {
      for (int x = 0; x < info_.model.width; ++x) {
        const auto at = [&](float dx, float dy) -> Eigen::Vector2d {
          return info_.model.unproject(Vector2f(static_cast<float>(x) + dx, static_cast<float>(y) + dy)).cast<double>();
        };
        rays_.push_back({at(0, 0), at(0.5f, 0) - at(-0.5f, 0), at(0, 0.5f) - at(0, -0.5f)});
      }
    }
  }

  const platform::CameraInfo& info() const override { return info_; }

  platform::CameraEvent wait(Frame* frame, int64_t) override {
    if (next_ == *info_.frame_count) return platform::CameraEvent::kEnd;
    const double t_s = next_ / options_.frames_per_s;
    render(t_s);
    *frame = {pixels_.data(),    info_.model.width,  info_.model.height,
              info_.model.width, PixelFormat::kGrey, std::llround(1e9 * t_s)};
    ++next_;
    return platform::CameraEvent::kFrame;
  }

 private:
  static constexpr int kSamples = 64;           // of a pixel: eight by eight, each at a time of its own
  static constexpr int kStride = 37;            // between the times of neighbouring samples, in 64ths of the exposure
  static constexpr int kFirst = 0, kLast = 19;  // samples at the exposure's ends: 19 * 37 = 63 modulo 64
  static constexpr double kPaper = 0.75, kInk = 0.0625, kTable = 0.25;  // sums of eight are exact

  size_t pixel_count() const {
    return static_cast<size_t>(options_.model.width) * static_cast<size_t>(options_.model.height);
  }

  struct Ray {
    Eigen::Vector2d centre, across, down;  // (x/z, y/z) of the pixel's middle, and how it changes over the pixel
  };

  // Light from where the ray meets the board's plane.
  double light(const Eigen::Matrix3d& H, const Eigen::Vector2d& ray) const {
    const Eigen::Vector3d p = H * ray.homogeneous();
    const double x = p.x() / p.z() + 0.5 * options_.board.columns;
    const double y = p.y() / p.z() / options_.aspect + 0.5 * options_.board.rows;
    const double rim = options_.rim;
    if (!(p.z() > 0) || x < -rim || y < -rim || x > options_.board.columns + rim || y > options_.board.rows + rim)
      return kTable;
    if (x < 0 || y < 0 || x > options_.board.columns || y > options_.board.rows) return kPaper;
    return (static_cast<int>(x) + static_cast<int>(y)) % 2 == 0 ? kInk : kPaper;
  }

  // Rays to the board's plane: (x, y, 1) up to scale. The inverse of [r1 r2 t].
  Eigen::Matrix3d to_board(double t_s) const {
    const Eigen::Isometry3d T = motion_(t_s);
    Eigen::Matrix3d H;
    H << T.linear().col(0), T.linear().col(1), T.translation();
    return H.inverse();
  }

  void render(double t_s) {
    const CameraModel& m = info_.model;
    const bool columns = options_.shutter.axis == RollingShutter::Axis::kColumns;
    const int lines = columns ? m.width : m.height;
    std::vector<Eigen::Matrix3d> planes;  // of each line, at each sample's time
    for (int line = 0; line < lines; ++line) {
      const double line_s = (line - 0.5 * (lines - 1)) * static_cast<double>(options_.shutter.line_time_s);
      for (int k = 0; k < kSamples; ++k)
        planes.push_back(
            to_board(t_s + line_s + options_.exposure_s * ((k * kStride % kSamples + 0.5) / kSamples - 0.5)));
    }
    sim::Random random(options_.seed, 5000 + static_cast<uint64_t>(next_));
    for (size_t i = 0; i < pixels_.size(); ++i) {
      const size_t width = static_cast<size_t>(m.width);
      const size_t line = columns ? i % width : i / width;
      const double spread = 1 + 2 * options_.focus_px;
      const auto at = [&](int k, double x, double y) {
        return light(planes[line * kSamples + static_cast<size_t>(k)],
                     rays_[i].centre + spread * x * rays_[i].across + spread * y * rays_[i].down);
      };
      double sum = 0;
      for (const int k : {kFirst, kLast})
        sum += at(k, -0.5, -0.5) + at(k, 0.5, -0.5) + at(k, -0.5, 0.5) + at(k, 0.5, 0.5);
      sum *= 0.125;
      if (sum != kPaper && sum != kInk && sum != kTable) {  // an edge
        sum = 0;
        for (int k = 0; k < kSamples; ++k) {
          sum += at(k, (k % 8 + random.uniform(0, 1)) / 8 - 0.5, (k / 8 + random.uniform(0, 1)) / 8 - 0.5) / kSamples;
        }
      }
      double gaussian = -2;
      for (int n = 0; n < 4; ++n) gaussian += random.uniform(0, 1);
      const double grey = 255 * std::pow(sum, 1 / 2.2) + options_.noise * std::sqrt(3.0) * gaussian;
      pixels_[i] = static_cast<uint8_t>(std::clamp(grey + 0.5, 0.0, 255.0));
    }
  }

  BoardCameraOptions options_;
  Motion motion_;
  platform::CameraInfo info_;
  std::vector<Ray> rays_;
  std::vector<uint8_t> pixels_;
  int next_ = 0;
};

// Poses that a careful person takes: the board in every part of the image, near, tilted and turned. One a frame.
class CarefulViews {
 public:
  CarefulViews(const CameraModel& model, const platform::Board& board, uint64_t seed, double frames_per_s, int views)
      : model_(model), board_(board), frames_per_s_(frames_per_s) {
    for (int view = 0; view < views; ++view) poses_.push_back(pose_of(view, seed));
  }

  Eigen::Isometry3d operator()(double t_s) const {
    const auto view = std::clamp<long>(std::lround(t_s * frames_per_s_), 0, static_cast<long>(poses_.size()) - 1);
    return poses_[static_cast<size_t>(view)];
  }

 private:
  Eigen::Isometry3d pose_of(int view, uint64_t seed) const {
    sim::Random random(seed, 100 + static_cast<uint64_t>(view));
    for (double share = random.uniform(0.5, 0.8);; share *= 0.95) {  // of the image's width, by the board
      const double tilt = random.uniform(0.2, 0.7), towards = 2 * M_PI * (view * 0.618 + random.uniform(-0.1, 0.1));
      const double roll = random.uniform(-0.3, 0.3) + (view % 5 == 4 ? M_PI / 2 : 0);
      Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
      T.linear() = (Eigen::AngleAxisd(tilt, Eigen::Vector3d(std::cos(towards), std::sin(towards), 0)) *
                    Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitZ()))
                       .toRotationMatrix();
      const double z = board_.columns * static_cast<double>(model_.fx) / (share * model_.width);
      for (double out = 0.45; out > 0.02; out -= 0.02) {  // nine places over the image, as far out as fits
        const Vector2f px(static_cast<float>(model_.width * (0.5 + (view % 3 - 1) * out)),
                          static_cast<float>(model_.height * (0.5 + (view / 3 % 3 - 1) * out)));
        T.translation() = z * model_.unproject(px).homogeneous().cast<double>();
        if (in_view(T)) return T;
      }
    }
  }

  bool in_view(const Eigen::Isometry3d& T) const {
    for (int i = 0; i < 4; ++i) {
      const Eigen::Vector3d corner((i % 2 - 0.5) * (board_.columns + 0.6), (i / 2 - 0.5) * (board_.rows + 0.6), 0);
      Vector2f px;
      if (!model_.project((T * corner).cast<float>(), &px) || !model_.in_image(px, 0)) return false;
    }
    return true;
  }

  CameraModel model_;
  platform::Board board_;
  double frames_per_s_;
  std::vector<Eigen::Isometry3d> poses_;
};

// A hand that moves the camera to and fro before the board, which fills half of the width: sideways, up and down, near
// and far, turning. speed 1: about an image width a second at its fastest.
class ShakenViews {
 public:
  ShakenViews(const CameraModel& model, const platform::Board& board, uint64_t seed, double speed)
      : distance_(board.columns * static_cast<double>(model.fx) / (0.5 * model.width)), speed_(speed) {
    sim::Random random(seed, 9);
    for (int i = 0; i < kWaves; ++i) {
      hertz_[i] = kHertz[i] * random.uniform(0.8, 1.25);
      phase_[i] = random.uniform(0, 2 * M_PI);
    }
  }

  Eigen::Isometry3d operator()(double t_s) const {
    const auto wave = [&](int i) { return std::sin(2 * M_PI * hertz_[i] * t_s + phase_[i]) / hertz_[i]; };
    const double amplitude = speed_ * distance_ / 6;
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.linear() = (Eigen::AngleAxisd(0.15 * speed_ * wave(0), Eigen::Vector3d::UnitZ()) *
                  Eigen::AngleAxisd(0.3 + 0.1 * speed_ * wave(1), Eigen::Vector3d(0.8, 0.6, 0)))
                     .toRotationMatrix();
    T.translation() =
        Eigen::Vector3d(amplitude * wave(2), 0.6 * amplitude * wave(3), distance_ + 0.8 * amplitude * wave(4));
    return T;
  }

 private:
  static constexpr int kWaves = 5;
  static constexpr double kHertz[kWaves] = {0.9, 1.1, 1.2, 1.5, 0.7};  // turn, tilt, sideways, up and down, depth
  double distance_, speed_;
  double hertz_[kWaves], phase_[kWaves];
};

}  // namespace pptam::test
