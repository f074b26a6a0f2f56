// The program where there is nothing to show pictures on, or nothing to draw them with.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "tests/support/scratch_folder.h"

namespace {

namespace fs = std::filesystem;

bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

struct Answer {
  int code = -1;
  std::string out, err;
};

class Displayless : public ::testing::Test {
 protected:
  // The program alone, without its modules.
  std::string alone() const {
    if (!fs::exists(folder_ / "pocket-ptam")) fs::copy_file(PPTAM_PROGRAM, folder_ / "pocket-ptam");
    return (folder_ / "pocket-ptam").string();
  }
  Answer run(const std::string& program, const std::string& arguments, const std::string& environment = "") const {
    const std::string command = "cd '" + folder_.string() + "' && env -u DISPLAY -u WAYLAND_DISPLAY " + environment +
                                " '" + program + "' " + arguments + " >out.txt 2>err.txt </dev/null";
    const int status = std::system(command.c_str());
    return {WIFEXITED(status) ? WEXITSTATUS(status) : 128, read("out.txt"), read("err.txt")};
  }
  std::string read(const std::string& name) const {
    std::ifstream stream(folder_ / name, std::ios::binary);
    return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
  }

  const pptam::test::ScratchFolder scratch_;
  const fs::path& folder_ = scratch_.path();
};

TEST_F(Displayless, ARunWithoutModulesTracksAndSaysThatThereIsNoOverlay) {
  const Answer answer = run(alone(), "sim --duration 4 --no-report --out o");
  EXPECT_EQ(answer.code, 0) << answer.err;
  EXPECT_TRUE(contains(answer.err, "there is no overlay: drawing: built without it")) << answer.err;
  EXPECT_TRUE(contains(answer.err, "libegl-dev")) << answer.err;
  EXPECT_TRUE(fs::exists(folder_ / "o/trajectory.txt"));
  EXPECT_FALSE(fs::exists(folder_ / "o/overlay.mp4"));
  const Answer live = run(alone(), "live --camera sim:desk --duration 1 --poses none");
  EXPECT_EQ(live.code, 0) << live.err;
}

TEST_F(Displayless, WhatCannotBeShownIsOneLineAndNothingIsDone) {
  const struct {
    std::string program, arguments;
    const char* named;
  } kCases[] = {{alone(), "sim --duration 1 --out o --show=window", "libsdl2-dev"},
                {alone(), "sim --duration 1 --out o --show=screen", "libegl-dev"},
                {alone(), "live --camera sim:desk --duration 1 --show", "libegl-dev"},
                {PPTAM_PROGRAM, "sim --duration 1 --out o --show=window", "window"},
                {PPTAM_PROGRAM, "sim --duration 1 --out o --show=moon", "window, screen or auto"},
                {PPTAM_PROGRAM, "sim --suite --seeds 1 --show", "single run"}};
  for (const auto& of : kCases) {
    const Answer answer = run(of.program, of.arguments);
    EXPECT_EQ(answer.code, 2) << of.arguments << answer.out << answer.err;
    EXPECT_TRUE(contains(answer.err, of.named)) << of.arguments << ": " << answer.err;
    EXPECT_EQ(answer.err.find('\n'), answer.err.size() - 1) << answer.err;
    EXPECT_FALSE(fs::exists(folder_ / "o")) << of.arguments;
  }
}

// The modules are there, and what they need is not: each is made to ask for a library that nobody has.
TEST_F(Displayless, ALibraryThatIsMissingIsToldWithItsPackage) {
  const fs::path build = fs::path(PPTAM_PROGRAM).parent_path();
  const struct {
    const char *module, *library, *arguments, *package;
  } kCases[] = {
      {"pocket-ptam-display.so", "libEGL.so.1", "live --camera sim:desk --duration 1 --show=screen", "libegl1"},
      {"pocket-ptam-window.so", "libSDL2-2.0.so.0", "sim --duration 1 --out o --show=window", "libsdl2-2.0-0"}};
  for (const auto& of : kCases) {
    if (!fs::exists(build / of.module)) continue;
    std::ifstream stream(build / of.module, std::ios::binary);
    std::string module{std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
    const size_t at = module.find(of.library);
    ASSERT_NE(at, std::string::npos) << of.module;
    std::string missing = of.library;
    missing[3] = 'X';
    module.replace(at, missing.size(), missing);
    std::ofstream(folder_ / of.module, std::ios::binary) << module;
    const Answer answer = run(alone(), of.arguments);
    EXPECT_EQ(answer.code, 2) << answer.err;
    EXPECT_TRUE(contains(answer.err, missing) && contains(answer.err, of.package)) << answer.err;
    EXPECT_EQ(answer.err.find('\n'), answer.err.size() - 1) << answer.err;
    EXPECT_FALSE(fs::exists(folder_ / "o"));
  }
  const Answer run_on = run(alone(), "sim --duration 2 --no-report --out o");
  EXPECT_EQ(run_on.code, 0) << run_on.err;
  EXPECT_TRUE(contains(run_on.err, "there is no overlay") && contains(run_on.err, "libegl1")) << run_on.err;
}

// A module of another build, whose pictures may be laid out otherwise, is not asked.
TEST_F(Displayless, AModuleOfAnotherVersionIsNotUsed) {
  std::ifstream stream(fs::path(PPTAM_PROGRAM).parent_path() / "pocket-ptam-display.so", std::ios::binary);
  std::string module{std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
  const std::string name = "pptam_display_";
  ASSERT_NE(module.find(name), std::string::npos);
  for (size_t at = module.find(name); at != std::string::npos; at = module.find(name, at + name.size()))
    module[at + name.size()] = 'x';  // of the hash
  std::ofstream(folder_ / "pocket-ptam-display.so", std::ios::binary) << module;
  const Answer answer = run(alone(), "sim --duration 2 --no-report --out o");
  EXPECT_EQ(answer.code, 0) << answer.err;
  EXPECT_TRUE(contains(answer.err, "of another version of the program: build again")) << answer.err;
}

// EGL is there, a screen is not: so on a computer without /dev/dri.
TEST_F(Displayless, AScreenThatIsNotThereIsToldByName) {
  if (fs::exists("/dev/dri")) GTEST_SKIP() << "this computer has a graphics device";
  for (const char* arguments :
       {"sim --duration 1 --out o --show", "live --camera sim:desk --duration 1 --show=screen"}) {
    const Answer answer = run(PPTAM_PROGRAM, arguments);
    EXPECT_EQ(answer.code, 2) << answer.err;
    EXPECT_TRUE(contains(answer.err, "/dev/dri/card")) << answer.err;
  }
}

// No driver of Mesa's can be loaded: EGL's library is there and cannot draw.
TEST_F(Displayless, WithoutADriverThereIsNoOverlay) {
  fs::create_directory(folder_ / "none");
  const Answer answer = run(PPTAM_PROGRAM, "sim --duration 2 --no-report --out o",
                            "__EGL_VENDOR_LIBRARY_DIRS='" + (folder_ / "none").string() + "'");
  EXPECT_EQ(answer.code, 0) << answer.err;
  EXPECT_TRUE(contains(answer.err, "there is no overlay: EGL")) << answer.err;
}

}  // namespace
