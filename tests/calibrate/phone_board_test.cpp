// The same through the emulated phone's sensor, which shares nothing with BoardCamera: a painted board, vignetting,
// exposure control, noise, motion blur, columns read out from the right.
#include <gtest/gtest.h>

#include <cstdint>
#include <cstdio>
#include <optional>
#include <vector>

#include "platform/calibrate/board_views.h"
#include "platform/calibrate/lens_fit.h"
#include "platform/calibrate/readout_fit.h"
#include "sim_phone/paint.h"
#include "sim_phone/scene.h"
#include "sim_phone/sensor.h"
#include "tests/support/board_camera.h"
#include "tests/support/board_tools.h"

namespace {

using namespace pptam;
using namespace pptam::platform;
using namespace pptam::test;

constexpr double kSquare_m = 0.025;

sim::Scene board_scene(const Board& board) {
  sim::Canvas canvas((board.columns + 2) * kSquare_m, (board.rows + 2) * kSquare_m, 0.0005);
  canvas.rectangle(sim::Place(0, 0, 0), -1, -1, 2, 2, 0.8);
  const sim::Place first(kSquare_m, kSquare_m, 0);
  for (int y = 0; y < board.rows; ++y) {
    for (int x = y % 2; x < board.columns; x += 2)
      canvas.rectangle(first, x * kSquare_m, y * kSquare_m, (x + 1) * kSquare_m, (y + 1) * kSquare_m, 0.05);
  }
  sim::Scene scene;
  const sim::Vector3d corner(-canvas.width_m() / 2, -canvas.height_m() / 2, 0);
  scene.surfaces.push_back(sim::surface_of(canvas, corner, sim::Vector3d::UnitX(), sim::Vector3d::UnitY(), 1));
  return scene;
}

class PhoneSensor : public platform::Camera {
 public:
  // motion: the board's coordinates to the camera's, in squares, as of BoardCamera.
  PhoneSensor(const CameraModel& model, const RollingShutter& shutter, double exposure_s, const Board& board,
              const BoardCamera::Motion& motion, int frames)
      : scene_(board_scene(board)),
        sensor_(
            scene_,
            [motion](double t_s) {
              Eigen::Isometry3d T = motion(t_s);
              T.translation() *= kSquare_m;
              return T.inverse();
            },
            options_of(model, shutter, exposure_s)),
        pixels_(static_cast<size_t>(model.width) * static_cast<size_t>(model.height)) {
    info_.model = model;
    info_.frames_per_s = 30;
    info_.frame_count = frames;
  }
  const platform::CameraInfo& info() const override { return info_; }
  platform::CameraEvent wait(Frame* frame, int64_t) override {
    if (next_ == *info_.frame_count) return platform::CameraEvent::kEnd;
    const double t_s = next_ / info_.frames_per_s;
    sensor_.expose(t_s, static_cast<uint64_t>(next_++), pixels_.data());
    *frame = {pixels_.data(),    info_.model.width,  info_.model.height,
              info_.model.width, PixelFormat::kGrey, std::llround(1e9 * t_s)};
    return platform::CameraEvent::kFrame;
  }

 private:
  static sim::SensorOptions options_of(const CameraModel& model, const RollingShutter& shutter, double exposure_s) {
    sim::SensorOptions options;
    options.model = model;
    options.shutter = shutter;
    options.exposure_s = exposure_s;
    return options;
  }

  sim::Scene scene_;
  sim::Sensor sensor_;
  platform::CameraInfo info_;
  std::vector<uint8_t> pixels_;
  int next_ = 0;
};

BoardViews looked_through(PhoneSensor* camera, const Board& board, bool every_frame) {
  LookOptions look;
  look.every_frame = every_frame;
  return look_for_board(*camera, board, board_vision(PPTAM_OPENCV_MODULE), look,
                        [](const BoardViews&) { return true; });
}

TEST(PhoneBoard, LensAndReadout) {
  if (!have_opencv()) GTEST_SKIP() << "OpenCV was not found at the build: install libopencv-calib3d-dev";
  const Board board;
  const CameraModel truth = lens_named("pinhole");
  PhoneSensor still(truth, {}, 0, board, CarefulViews(truth, board, 21, 30, 20), 20);
  const BoardViews found = looked_through(&still, board, false);
  int blurred = 0;
  const std::vector<BoardView> views = choose_views(found, 40, &blurred);
  Coverage coverage(found.width, found.height);
  for (const BoardView& view : views) coverage.add(view);
  const LensFit fit =
      fit_lens(board, found.width, found.height, views, coverage, board_vision(PPTAM_OPENCV_MODULE), std::nullopt);
  std::printf("phone's sensor: %zu views, %.3f px rms, fx %.2f of %.2f, any pixel %.3f px (told: %.2f)\n",
              fit.views.size(), fit.rms_px, fit.solution.fx, static_cast<double>(truth.fx),
              largest_difference_px(fit.model, truth), fit.uncertain_px.value_or(0));
  EXPECT_NEAR(fit.solution.fx / static_cast<double>(truth.fx), 1, 0.003);
  EXPECT_NEAR(fit.solution.cx, static_cast<double>(truth.cx), 1.5);
  EXPECT_LT(largest_difference_px(fit.model, truth), 0.3);

  RollingShutter shutter;
  shutter.axis = RollingShutter::Axis::kColumns;
  shutter.line_time_s = -0.025f / static_cast<float>(truth.width);
  PhoneSensor moving(truth, shutter, 0.010, board, ShakenViews(truth, board, 21, 1), 60);
  const ReadoutFit readout = fit_readout(board, looked_through(&moving, board, true), fit.model, "both");
  std::printf("phone's sensor: readout %+.2f +- %.2f ms of -25\n", 1000 * readout.readout_s, 1000 * readout.sigma_s);
  EXPECT_EQ(readout.trouble, "");
  EXPECT_EQ(readout.axis, RollingShutter::Axis::kColumns);
  EXPECT_NEAR(readout.readout_s, -0.025, 0.002);
}

}  // namespace
