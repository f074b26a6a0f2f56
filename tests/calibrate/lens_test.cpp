// The lens from rendered views of a board, against the truth.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <string>
#include <vector>

#include "platform/calibrate/board_views.h"
#include "platform/calibrate/board_vision.h"
#include "platform/calibrate/lens_fit.h"
#include "platform/input_error.h"
#include "platform/text.h"
#include "tests/support/board_camera.h"
#include "tests/support/board_tools.h"

namespace {

using namespace pptam;
using namespace pptam::platform;
using namespace pptam::test;

constexpr int kViews = 20;

// What issue 15 asks for, but of the centre: it asks for 1.5 px, and up to 0.17 are found. Corners that are half a
// pixel off, across and down, move it by 0.71: this lies between 0.17 and 0.71 - 0.17.
constexpr double kMaxFocalError = 0.003;
constexpr double kMaxCentreError_px = 0.4;
constexpr double kMaxPixelError_px = 0.3;

struct LensErrors {
  double focal = 0, centre_px = 0, pixel_px = 0;
};

LensErrors errors_of(const CameraModel& found, const CameraModel& truth) {
  LensErrors errors;
  errors.focal = std::max(std::abs(found.fx / truth.fx - 1), std::abs(found.fy / truth.fy - 1));
  errors.centre_px = std::hypot(found.cx - truth.cx, found.cy - truth.cy);
  errors.pixel_px = largest_difference_px(found, truth);
  return errors;
}

bool good(const LensErrors& e) {
  return e.focal < kMaxFocalError && e.centre_px < kMaxCentreError_px && e.pixel_px < kMaxPixelError_px;
}

struct Looked {
  BoardViews found;
  std::vector<BoardView> views;
  int blurred = 0;
};

Looked looked_at(platform::Camera* camera, const Board& board) {
  Looked looked;
  looked.found =
      look_for_board(*camera, board, board_vision(PPTAM_OPENCV_MODULE), {}, [](const BoardViews&) { return true; });
  looked.views = choose_views(looked.found, 40, &looked.blurred);
  return looked;
}

Looked views_of(const BoardCameraOptions& options, const Board& board, int views) {
  BoardCamera camera(options, CarefulViews(options.model, options.board, options.seed, options.frames_per_s, views),
                     views);
  return looked_at(&camera, board);
}

LensFit fit_of(const Looked& looked, const Board& board) {
  Coverage coverage(looked.found.width, looked.found.height);
  for (const BoardView& view : looked.views) coverage.add(view);
  return fit_lens(board, looked.found.width, looked.found.height, looked.views, coverage,
                  board_vision(PPTAM_OPENCV_MODULE), std::nullopt);
}

int seeds() {
  return std::getenv("PPTAM_ALL") != nullptr ? 10 : 1;
}

class Lens : public ::testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    if (!have_opencv()) GTEST_SKIP() << "OpenCV was not found at the build: install libopencv-calib3d-dev";
  }
};
class LensViews : public Lens {};

BoardCameraOptions camera_named(const char* lens, uint64_t seed) {
  BoardCameraOptions options;
  options.model = lens_named(lens);
  options.seed = seed;
  return options;
}

TEST_P(Lens, ComesFromTwentyViews) {
  LensErrors worst;
  for (uint64_t seed = 1; seed <= static_cast<uint64_t>(seeds()); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const BoardCameraOptions options = camera_named(GetParam(), seed);
    const Looked looked = views_of(options, options.board, kViews);
    EXPECT_GE(looked.views.size(), 18u) << looked.found.without_board << " without board, " << looked.blurred
                                        << " blurred";
    const LensFit fit = fit_of(looked, options.board);
    const LensErrors e = errors_of(fit.model, options.model);
    std::printf(
        "%s, seed %d: %zu views, lens %s, %.3f px rms; focal length %.3f %%, centre %.2f px, any pixel %.3f px "
        "(told: %.2f)\n",
        GetParam(), static_cast<int>(seed), fit.views.size(), name_of(fit.solution.kind), fit.rms_px, 100 * e.focal,
        e.centre_px, e.pixel_px, fit.uncertain_px.value_or(0));
    EXPECT_TRUE(good(e));
    worst.focal = std::max(worst.focal, e.focal);
    worst.centre_px = std::max(worst.centre_px, e.centre_px);
    worst.pixel_px = std::max(worst.pixel_px, e.pixel_px);

    Looked shifted = looked;  // the controls: corners half a pixel off, and another focal length, are noticed
    for (BoardView& view : shifted.views) {
      for (Vector2d& corner : view.corners) corner += Vector2d(0.5, 0.5);
    }
    EXPECT_GT(errors_of(fit_of(shifted, options.board).model, options.model).centre_px, kMaxCentreError_px);
    CameraModel longer = options.model;
    longer.fx *= 1.004f;
    longer.fy *= 1.004f;
    longer.prepare();
    EXPECT_FALSE(good(errors_of(fit.model, longer)));
  }
  std::printf("%s, worst: focal length %.3f %%, centre %.2f px, any pixel %.3f px\n", GetParam(), 100 * worst.focal,
              worst.centre_px, worst.pixel_px);
}

INSTANTIATE_TEST_SUITE_P(Kinds, Lens, ::testing::Values("pinhole", "barrel"),
                         [](const auto& kind) { return std::string(kind.param); });

// Further than was asked for: in the image's corners, where the board is never seen, it may be pixels off, and tells
// so.
TEST_F(LensViews, FisheyeComesFromTwentyViews) {
  for (uint64_t seed = 1; seed <= static_cast<uint64_t>(seeds()); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const BoardCameraOptions options = camera_named("fisheye", seed);
    const LensFit fit = fit_of(views_of(options, options.board, kViews), options.board);
    const LensErrors e = errors_of(fit.model, options.model);
    std::printf("fisheye, seed %d: focal length %.3f %%, centre %.2f px, any pixel %.3f px (told: %.2f)\n",
                static_cast<int>(seed), 100 * e.focal, e.centre_px, e.pixel_px, fit.uncertain_px.value_or(0));
    EXPECT_EQ(fit.solution.kind, LensKind::kFisheye);
    EXPECT_LT(e.focal, kMaxFocalError);
    EXPECT_LT(e.centre_px, kMaxCentreError_px);
    if (fit.uncertain_px) {
      EXPECT_LT(e.pixel_px, 4 * *fit.uncertain_px) << "four standard deviations";
    } else {
      EXPECT_FALSE(fit.warnings.empty()) << "with fewer views no lens is found, which must be told";
    }
  }
}

// Five coefficients, of which the last only shows in the image's corners, where the board is never seen: what is not
// known there is told.
TEST_F(LensViews, WideLensTellsWhatItDoesNotKnow) {
  const BoardCameraOptions options = camera_named("wide", 1);
  const LensFit fit = fit_of(views_of(options, options.board, kViews), options.board);
  const LensErrors e = errors_of(fit.model, options.model);
  EXPECT_EQ(fit.solution.kind, LensKind::kWide);
  EXPECT_LT(e.focal, kMaxFocalError);
  EXPECT_LT(e.centre_px, kMaxCentreError_px);
  ASSERT_TRUE(fit.uncertain_px);
  EXPECT_LT(e.pixel_px, 4 * *fit.uncertain_px) << "four standard deviations";
  EXPECT_EQ(*fit.uncertain_px > 1, !fit.warnings.empty());
}

// Lenses that are made up: the normal one fits to 0.04 px, but not the first five views, which it leaves out; the
// fisheye fits all of them to `fisheye_px`.
class TwoLenses : public BoardVision {
 public:
  explicit TwoLenses(double fisheye_px) : fisheye_px_(fisheye_px) {}
  bool find(const GreyView&, int, int, bool, std::vector<Vector2d>*) const override { return false; }
  bool find_any(const GreyView&, int*, int*) const override { return false; }
  LensSolution solve(int, int, const std::vector<Vector2d>&, const std::vector<std::vector<Vector2d>>& views,
                     LensKind kind) const override {
    LensSolution solution;
    solution.kind = kind;
    solution.fx = solution.fy = 400, solution.cx = 239.5, solution.cy = 179.5;
    if (kind == LensKind::kWide) solution.trouble = "not tried";
    for (const std::vector<Vector2d>& view : views) {
      const double off_px = kind == LensKind::kFisheye ? fisheye_px_ : view[0].x() < 5 ? 1 : 0.04;
      solution.predicted.push_back(view);
      for (Vector2d& corner : solution.predicted.back()) corner.y() += off_px;
    }
    return solution;
  }

 private:
  double fisheye_px_;
};

TEST(LensChoice, ALensThatLeavesViewsOutIsNoBetterForIt) {
  const Board board;
  std::vector<BoardView> views(20);
  for (size_t i = 0; i < views.size(); ++i) {
    views[i].corners.assign(board.plane().size(), Vector2d(static_cast<double>(i), 0));
    views[i].tilt = Vector2d(0.02 * static_cast<double>(i), 0);
  }
  const auto chosen = [&](double fisheye_px) {
    return fit_lens(board, 480, 360, views, Coverage(480, 360), TwoLenses(fisheye_px), std::nullopt).solution.kind;
  };
  EXPECT_EQ(chosen(0.1), LensKind::kFisheye);
  EXPECT_EQ(chosen(0.4), LensKind::kNormal) << "the control: it fits all views, but worse";
}

TEST_F(LensViews, TooFewAreRefused) {
  const BoardCameraOptions options = camera_named("pinhole", 3);
  const Looked looked = views_of(options, options.board, 5);
  try {
    fit_of(looked, options.board);
    FAIL() << "five views were taken";
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("at least 6"), std::string::npos) << error.what();
  }
}

TEST_F(LensViews, AllFromOneSideAreRefused) {
  const BoardCameraOptions options = camera_named("pinhole", 4);
  const auto upright = [&](double t_s) {  // the same view, shifted a little
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.translation() = Eigen::Vector3d(0.3 * std::sin(90 * t_s), 0.3 * std::cos(90 * t_s), 14);
    return T;
  };
  BoardCamera camera(options, upright, 10);
  const Looked looked = looked_at(&camera, options.board);
  ASSERT_EQ(looked.views.size(), 10u);
  try {
    fit_of(looked, options.board);
    FAIL() << "views from one side were taken";
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("tilt the board"), std::string::npos) << error.what();
  }
  Coverage coverage(looked.found.width, looked.found.height);
  for (const BoardView& view : looked.views) coverage.add(view);
  const std::string missing = joined(coverage.missing());
  for (const char* part : {"upper left", "lower right", "left", "upper"})
    EXPECT_NE(missing.find(part), std::string::npos) << missing;
}

// The squares miscounted: nothing is found, and the right count is told.
TEST_F(LensViews, AnotherBoardIsTold) {
  const BoardCameraOptions options = camera_named("pinhole", 5);
  Board wrong;
  wrong.columns = 9, wrong.rows = 8;
  const Looked looked = views_of(options, wrong, 1);
  EXPECT_TRUE(looked.views.empty());
  EXPECT_TRUE(looked.found.other_board == "10x7" || looked.found.other_board == "7x10") << looked.found.other_board;
}

TEST_F(LensViews, BlurredOnesAreSkipped) {
  BoardCameraOptions options = camera_named("pinhole", 6);
  options.exposure_s = 0.02;
  const CarefulViews still(options.model, options.board, 6, options.frames_per_s, 12);
  BoardCamera camera(
      options,
      [&](double t_s) {  // every third frame is taken while the camera moves by some 12 px
        Eigen::Isometry3d T = still(t_s);
        const double frame = std::round(t_s * options.frames_per_s);
        if (std::fmod(frame, 3) == 2) {
          const double since_s = t_s - frame / options.frames_per_s;
          T.translation().x() +=
              12 * T.translation().z() / static_cast<double>(options.model.fx) * since_s / options.exposure_s;
          T.translation().y() +=
              12 * T.translation().z() / static_cast<double>(options.model.fy) * since_s / options.exposure_s;
        }
        return T;
      },
      12);
  const Looked looked = looked_at(&camera, options.board);
  EXPECT_EQ(looked.found.without_board + looked.blurred, 4);
  for (const BoardView& view : looked.views) EXPECT_NE(view.frame % 3, 2);
}

// The words and the picture name the edge that is nearer.
TEST_F(LensViews, TiltsAreNamedByTheNearerEdge) {
  const BoardCameraOptions options = camera_named("pinhole", 8);
  for (const double turn : {-0.5, 0.5}) {
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.linear() = Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitY()).toRotationMatrix();  // positive: the right one
    T.translation().z() = 16;
    BoardCamera camera(
        options, [T](double) { return T; }, 1);
    const Looked looked = looked_at(&camera, options.board);
    ASSERT_EQ(looked.views.size(), 1u);
    EXPECT_GT(-turn * looked.views[0].tilt.x(), 0.1);
    EXPECT_NEAR(looked.views[0].tilt.y(), 0, 0.02);
  }
}

// Squares that are not square look like pixels that are not: told, with the remedy.
TEST_F(LensViews, StretchedPrintIsTold) {
  BoardCameraOptions options = camera_named("pinhole", 7);
  options.aspect = 1.04;
  const LensFit fit = fit_of(views_of(options, options.board, 12), options.board);
  bool told = false;
  for (const std::string& warning : fit.warnings)
    told = told || warning.find("not; measure its sides") != std::string::npos;
  EXPECT_TRUE(told);
}

}  // namespace
