// pocket-ptam calibrate as its users meet it: folders of rendered images in, a calibration that replay reads out.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "platform/calibrate/lens_fit.h"
#include "platform/camera/calibration.h"
#include "platform/camera/dump_sequence.h"
#include "tests/support/board_camera.h"
#include "tests/support/board_tools.h"
#include "tests/support/scratch_folder.h"

namespace {

namespace fs = std::filesystem;
using namespace pptam;
using namespace pptam::test;

std::string text_of(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

bool has(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

struct Answered {
  int code = -1;
  std::string out, err;
};

class CalibrateProgram : public ::testing::Test {
 protected:
  Answered run(const std::string& arguments) const {
    const fs::path out = scratch_ / "stdout.txt", err = scratch_ / "stderr.txt";
    const std::string command = "cd '" + scratch_.path().string() + "' && '" PPTAM_PROGRAM "' calibrate " + arguments +
                                " >'" + out.string() + "' 2>'" + err.string() + "'";
    const int status = std::system(command.c_str());
    return {WIFEXITED(status) ? WEXITSTATUS(status) : 128, text_of(out), text_of(err)};
  }

  void dump(const std::string& folder, const BoardCameraOptions& options, BoardCamera::Motion motion,
            int frames) const {
    BoardCamera camera(options, std::move(motion), frames);
    platform::dump_sequence(camera, scratch_ / folder, [](int, int) { return true; });
  }

  const ScratchFolder scratch_;
};

TEST_F(CalibrateProgram, PrintsABoardAndKeepsForeignFiles) {
  EXPECT_EQ(run("--print-board board.pdf").code, 0);
  EXPECT_EQ(text_of(scratch_ / "board.pdf").substr(0, 5), "%PDF-");
  EXPECT_EQ(run("--print-board board.pdf --paper Letter --board 8x6 --square 20").code, 0)
      << "an earlier one is replaced";
  std::ofstream(scratch_ / "mine.pdf") << "%PDF- of the user's";
  const Answered refused = run("--print-board mine.pdf");
  EXPECT_EQ(refused.code, 2) << refused.err;
  EXPECT_EQ(text_of(scratch_ / "mine.pdf"), "%PDF- of the user's");
  const Answered large = run("--print-board large.pdf --square 60");
  EXPECT_EQ(large.code, 2);
  EXPECT_TRUE(has(large.err, "do not fit on A4 paper: at most 24.0 mm")) << large.err;
  EXPECT_FALSE(fs::exists(scratch_ / "large.pdf"));
}

TEST_F(CalibrateProgram, SaysWhatIsWrong) {
  EXPECT_TRUE(has(run("").err, "name the views")) << "nothing to do";
  EXPECT_TRUE(has(run("--board 3x9 .").err, "from 4 to 40 squares"));
  EXPECT_TRUE(has(run("--board ten .").err, "for example 10x7"));
  EXPECT_TRUE(has(run("--board 8x8 .").err, "turned by 90 degrees"));
  EXPECT_TRUE(has(run("nowhere").err, have_opencv() ? "no such file or folder" : "libopencv-calib3d-dev"));
}

// Views and a moving clip to a calibration, which is read again and then serves for the clip alone.
TEST_F(CalibrateProgram, WritesWhatReplayReads) {
  if (!have_opencv()) GTEST_SKIP() << "OpenCV was not found at the build: install libopencv-calib3d-dev";
  BoardCameraOptions options;
  options.model = lens_named("barrel");
  options.seed = 11;
  dump("views", options, CarefulViews(options.model, options.board, 11, options.frames_per_s, 20), 20);
  options.shutter.line_time_s = -0.016f / 360;
  options.exposure_s = 0.005;
  dump("quick", options, ShakenViews(options.model, options.board, 11, 1), 45);

  const Answered first = run("views --moving quick --out made");
  EXPECT_EQ(first.code, 0) << first.out << first.err;
  EXPECT_FALSE(has(first.err, "warning")) << first.err;
  for (const char* name : {"made/calibration.yaml", "made/report.html", "made/coverage.png", "made/residuals.png"})
    EXPECT_TRUE(fs::exists(scratch_ / name)) << name;
  std::vector<std::string> warnings;
  platform::Calibration made = platform::read_calibration(scratch_ / "made/calibration.yaml", &warnings);
  EXPECT_TRUE(warnings.empty());
  made.model.prepare();
  EXPECT_LT(platform::largest_difference_px(made.model, options.model), 0.3);
  EXPECT_EQ(made.shutter.axis, RollingShutter::Axis::kRows);
  EXPECT_NEAR(static_cast<double>(made.shutter.line_time_s) * 360, -0.016, 0.002);

  const Answered again = run("--calibration made/calibration.yaml --moving quick --axis rows --out again");
  EXPECT_EQ(again.code, 0) << again.err;
  const platform::Calibration second = platform::read_calibration(scratch_ / "again/calibration.yaml", nullptr);
  EXPECT_EQ(second.model.fx, made.model.fx) << "to the bit";
  EXPECT_EQ(second.model.coeffs[1], made.model.coeffs[1]);

  // Outputs are no inputs, and what somebody has edited stays.
  EXPECT_EQ(run("--calibration made/calibration.yaml --moving quick --out made").code, 2);
  EXPECT_EQ(run("views --out views/rgb").code, 2);
  std::ofstream(scratch_ / "made/calibration.yaml", std::ios::app) << "# mine\n";
  EXPECT_EQ(run("views --out made").code, 2);
  EXPECT_TRUE(has(text_of(scratch_ / "made/calibration.yaml"), "# mine"));
}

// What does not suffice is drawn and said, the exit code is 1, and an earlier calibration stays.
TEST_F(CalibrateProgram, GuidesWhereViewsAreTooFew) {
  if (!have_opencv()) GTEST_SKIP() << "OpenCV was not found at the build: install libopencv-calib3d-dev";
  BoardCameraOptions options;
  options.model = lens_named("pinhole");
  dump("good", options, CarefulViews(options.model, options.board, 1, options.frames_per_s, 12), 12);
  dump("views", options, CarefulViews(options.model, options.board, 1, options.frames_per_s, 4), 4);
  EXPECT_EQ(run("good --out made").code, 0);
  const std::string earlier = text_of(scratch_ / "made/calibration.yaml");
  EXPECT_TRUE(has(earlier, "intrinsics"));
  const Answered few = run("views --out made");
  EXPECT_EQ(few.code, 1);
  EXPECT_TRUE(has(few.err, "only 4 usable views")) << few.err;
  EXPECT_TRUE(has(few.err, "hardly seen in the")) << few.err;
  EXPECT_TRUE(fs::exists(scratch_ / "made/coverage.png"));
  EXPECT_EQ(text_of(scratch_ / "made/calibration.yaml"), earlier);
  EXPECT_EQ(run("views --out new").code, 1);
  EXPECT_FALSE(fs::exists(scratch_ / "new/calibration.yaml"));
}

}  // namespace
