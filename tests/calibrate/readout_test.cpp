// The rolling shutter's readout from a rendered clip that moves before the board, against the truth.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string>

#include "platform/calibrate/readout_fit.h"
#include "tests/support/board_camera.h"
#include "tests/support/board_tools.h"

namespace {

using namespace pptam;
using namespace pptam::platform;
using namespace pptam::test;
using Axis = RollingShutter::Axis;

constexpr double kMaxReadoutError_s = 0.002;  // what issue 15 asks for

struct ClipOptions {
  Axis axis = Axis::kRows;
  double readout_s = 0.020;
  double speed = 1;
  double exposure_s = 0.008;
  uint64_t seed = 1;
  int frames = 60;
  const char* lens = "barrel";
};

BoardViews clip_of(const ClipOptions& o, BoardCameraOptions* options) {
  options->model = lens_named(o.lens);
  options->shutter.axis = o.axis;
  options->shutter.line_time_s =
      static_cast<float>(o.readout_s / (o.axis == Axis::kRows ? options->model.height : options->model.width));
  options->exposure_s = o.exposure_s;
  options->seed = o.seed;
  BoardCamera camera(*options, ShakenViews(options->model, options->board, o.seed, o.speed), o.frames);
  LookOptions look;
  look.every_frame = true;
  return look_for_board(camera, options->board, board_vision(PPTAM_OPENCV_MODULE), look,
                        [](const BoardViews&) { return true; });
}

// As if the motion had gone the other way: the lines' order is the opposite then.
BoardViews reversed(BoardViews clip) {
  std::reverse(clip.views.begin(), clip.views.end());
  const int64_t last_ns = clip.views.front().timestamp_ns;
  for (BoardView& view : clip.views) view.timestamp_ns = last_ns - view.timestamp_ns;
  return clip;
}

class Readout : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!have_opencv()) GTEST_SKIP() << "OpenCV was not found at the build: install libopencv-calib3d-dev";
  }
};

TEST_F(Readout, ComesFromAMovingClip) {
  const int seeds = std::getenv("PPTAM_ALL") != nullptr ? 10 : 1;
  double worst_s = 0;
  for (uint64_t seed = 1; seed <= static_cast<uint64_t>(seeds); ++seed) {
    for (const double readout_s : {0.020, -0.030}) {
      ClipOptions o;
      o.seed = seed;
      o.readout_s = readout_s;
      o.axis = readout_s < 0 ? Axis::kColumns : Axis::kRows;
      BoardCameraOptions options;
      const BoardViews clip = clip_of(o, &options);
      const ReadoutFit fit = fit_readout(options.board, clip, options.model, "both");
      std::printf(
          "seed %d, %+.1f ms: found %+.2f +- %.2f ms, %s, rms %.3f global %.3f, frames %d of %d, %.0f px/s %s\n",
          static_cast<int>(seed), 1000 * readout_s, 1000 * fit.readout_s, 1000 * fit.sigma_s,
          fit.axis == Axis::kRows ? "rows" : "columns", fit.rms_px, fit.global_px, fit.frames, clip.frames,
          fit.speed_px_s, fit.trouble.c_str());
      EXPECT_EQ(fit.trouble, "");
      EXPECT_EQ(fit.axis, o.axis);
      EXPECT_NEAR(fit.readout_s, readout_s, kMaxReadoutError_s);
      const ReadoutFit backward = fit_readout(options.board, reversed(clip), options.model, "both");
      EXPECT_NEAR(backward.readout_s, -readout_s, kMaxReadoutError_s) << "the control: time's direction is noticed";
      worst_s = std::max(worst_s, std::abs(fit.readout_s - readout_s));
    }
  }
  std::printf("worst %.2f ms\n", 1000 * worst_s);
}

// A camera that hardly moves tells nothing, and that is said.
TEST_F(Readout, StillClipCannotTell) {
  ClipOptions o;
  o.speed = 0.005;
  BoardCameraOptions options;
  const BoardViews clip = clip_of(o, &options);
  const ReadoutFit fit = fit_readout(options.board, clip, options.model, "both");
  std::printf("still: %+.1f +- %.2f ms at %.1f px/s: %s\n", 1000 * fit.readout_s, 1000 * fit.sigma_s, fit.speed_px_s,
              fit.trouble.c_str());
  EXPECT_NE(fit.trouble.find("cannot tell"), std::string::npos) << fit.trouble;
}

TEST_F(Readout, GlobalShutterIsZero) {
  ClipOptions o;
  o.readout_s = 0;
  BoardCameraOptions options;
  const BoardViews clip = clip_of(o, &options);
  const ReadoutFit fit = fit_readout(options.board, clip, options.model, "both");
  EXPECT_EQ(fit.trouble, "");
  EXPECT_NEAR(fit.readout_s, 0, 0.0005);
  EXPECT_TRUE(fit.global);
}

// It would be 1.5 ms, and is uncertain by about as much: not to be taken for a global shutter.
TEST_F(Readout, SlowClipCannotTellAGlobalShutter) {
  ClipOptions o;
  o.readout_s = 0.0015;
  o.speed = 0.02;
  BoardCameraOptions options;
  const BoardViews clip = clip_of(o, &options);
  const ReadoutFit fit = fit_readout(options.board, clip, options.model, "rows");
  std::printf("slow: %+.1f +- %.2f ms at %.1f px/s: %s\n", 1000 * fit.readout_s, 1000 * fit.sigma_s, fit.speed_px_s,
              fit.trouble.c_str());
  EXPECT_FALSE(fit.global);
  EXPECT_NE(fit.trouble.find("cannot tell"), std::string::npos) << fit.trouble;
}

TEST_F(Readout, TooFewFramesAreRefused) {
  ClipOptions o;
  o.frames = 12;
  BoardCameraOptions options;
  const BoardViews clip = clip_of(o, &options);
  EXPECT_NE(fit_readout(options.board, clip, options.model, "both").trouble.find("too few frames"), std::string::npos);
}

}  // namespace
