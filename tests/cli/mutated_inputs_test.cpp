// Files with bytes, words and lines changed at random, for every reader: each is read or refused by an InputError, with
// finite numbers, in little time and memory. PPTAM_ALL (tests/run.sh --all) takes 100 000 of each. With sanitizers:
// cmake --preset sanitize && cmake --build --preset sanitize --target cli_tests, then PPTAM_ALL=1
// build/sanitize/tests/cli/cli_tests --gtest_filter='MutatedInputs*'.
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "platform/camera/calibration.h"
#include "platform/camera/ground_truth.h"
#include "platform/camera/image_files.h"
#include "platform/camera/image_list.h"
#include "platform/camera/recorded_camera.h"
#include "platform/files.h"
#include "platform/trajectory.h"
#include "tests/support/random.h"
#include "tests/support/sample.h"
#include "tests/support/scratch_folder.h"

namespace pptam {
namespace {

using platform::InputError;

constexpr double kMaxSeconds = 10;
constexpr int64_t kMaxMegabytes = 256;  // of the process, where no sanitizer takes its own

#if defined(__SANITIZE_ADDRESS__)
constexpr bool kSanitized = true;
#elif defined(__has_feature)
constexpr bool kSanitized = __has_feature(address_sanitizer);
#else
constexpr bool kSanitized = false;
#endif

const char* const kWords[] = {"nan",
                              "-inf",
                              "1e308",
                              "-1e-308",
                              "9223372036854775807",
                              "-9223372036854775808",
                              "0",
                              "1,5",
                              "\"",
                              "[",
                              "{",
                              "&a",
                              "*a",
                              ":",
                              "- ",
                              "%s%n",
                              "\x1b[2J",
                              "\xff\xfe",
                              "#",
                              "!!float",
                              "~",
                              "\r",
                              "../../x",
                              "<!--",
                              "]]>",
                              "1e400",
                              "18446744073709551616",
                              "-0"};

void change(test::Random& random, const std::string& other, std::string* file) {
  const auto place = [&] { return static_cast<size_t>(random.integer(0, static_cast<int>(file->size()))); };
  const auto some = [&](int most) { return static_cast<size_t>(random.integer(1, most)); };
  if (file->empty()) *file = "x";
  switch (random.integer(0, 9)) {
    case 0:
      (*file)[std::min(place(), file->size() - 1)] ^= static_cast<char>(1 << random.integer(0, 7));
      break;
    case 1:
      (*file)[std::min(place(), file->size() - 1)] = static_cast<char>(random.integer(0, 255));
      break;
    case 2:
      file->resize(place());
      break;
    case 3:
      file->erase(place(), some(40));
      break;
    case 4: {
      const size_t at = place();
      file->insert(at, file->substr(place(), some(200)));
      break;
    }
    case 5: {  // a word in place of a word
      const size_t from = std::min(file->find_first_not_of(" \t\n,:[]<>", place()), file->size());
      const size_t to = std::min(file->find_first_of(" \t\n,:[]<>", from), file->size());
      file->replace(from, to - from, kWords[random.integer(0, static_cast<int>(std::size(kWords)) - 1)]);
      break;
    }
    case 6:
      file->insert(place(), kWords[random.integer(0, static_cast<int>(std::size(kWords)) - 1)]);
      break;
    case 7:
      file->insert(place(), some(2000), static_cast<char>(random.integer(0, 255)));
      break;
    case 8: {  // four bytes of a binary number
      const uint32_t values[] = {0, 1, 0x7fffffff, 0x80000000, 0xffffffff, 0x00010000};
      const uint32_t value = values[random.integer(0, 5)];
      for (size_t at = place(), i = 0; i < 4 && at < file->size(); ++i, ++at)
        (*file)[at] = static_cast<char>(value >> (8 * i));
      break;
    }
    default:  // the end of another file
      file->replace(place(), std::string::npos, other.substr(std::min(place(), other.size())));
      break;
  }
}

// Without waiting for the disk.
void write_quickly(const std::filesystem::path& file, const std::string& content) {
  std::ofstream(file, std::ios::binary) << content;
}

struct Counts {
  int read = 0, refused = 0;
};

// reader: throws InputError or returns true; false when what it read is not usable. few, all: inputs of the daily run
// and of the whole.
void read_mutated(const char* what, const std::vector<std::string>& seeds, const std::string& name,
                  const std::function<bool(const std::filesystem::path&)>& reader, int few = 400, int all = 100000) {
  test::Random random;
  const test::ScratchFolder folder;
  const std::filesystem::path file = folder / name;
  const auto write = [&](const std::string& content) { write_quickly(file, content); };
  for (const std::string& seed : seeds) {
    write(seed);
    bool good = false;
    ASSERT_NO_THROW(good = reader(file)) << what << ": an unchanged one";
    ASSERT_TRUE(good) << what << ": an unchanged one";
  }
  Counts counts;
  double longest_s = 0;
  const int inputs = test::sampled(few, all);
  for (int i = 0; i < inputs; ++i) {
    std::string content = seeds[static_cast<size_t>(random.integer(0, static_cast<int>(seeds.size()) - 1))];
    const std::string& other = seeds[static_cast<size_t>(random.integer(0, static_cast<int>(seeds.size()) - 1))];
    for (int changes = random.integer(1, 4); changes > 0; --changes) change(random, other, &content);
    write(content);
    const auto start = std::chrono::steady_clock::now();
    try {
      EXPECT_TRUE(reader(file)) << what << ", input " << i << ": read, but not usable";
      ++counts.read;
    } catch (const InputError& error) {
      ++counts.refused;
      const std::string said = error.what();
      EXPECT_EQ(said.find('\n'), std::string::npos) << said;
    } catch (const std::exception& error) {
      ADD_FAILURE() << what << ", input " << i << ": " << error.what();
    }
    longest_s = std::max(longest_s, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
    if (::testing::Test::HasFailure()) {
      const std::filesystem::path kept = std::filesystem::temp_directory_path() / ("pptam-finding-" + name);
      write_quickly(kept, content);
      std::printf("the input is kept as %s\n", kept.c_str());
      return;
    }
  }
  EXPECT_LT(longest_s, kMaxSeconds);
  rusage used = {};
  getrusage(RUSAGE_SELF, &used);
  if (!kSanitized) {
    EXPECT_LT(used.ru_maxrss / 1024, kMaxMegabytes);
  }
  std::printf("%s: %d read, %d refused, %.3f s at most, process %ld MB\n", what, counts.read, counts.refused, longest_s,
              used.ru_maxrss / 1024);
  EXPECT_GT(100 * counts.read, inputs) << "changes so heavy that nothing is read test little";
  EXPECT_GT(100 * counts.refused, inputs);
}

bool usable(const platform::Trajectory& trajectory) {
  for (size_t i = 0; i < trajectory.size(); ++i) {
    if (!trajectory[i].T_wc.matrix().allFinite()) return false;
    if (i > 0 && trajectory[i].timestamp_ns <= trajectory[i - 1].timestamp_ns) return false;
  }
  return true;
}

bool usable(const platform::ImageList& list) {
  for (size_t i = 1; i < list.images.size(); ++i)
    if (list.times != platform::ImageTimes::kUnknown && list.images[i].timestamp_ns <= list.images[i - 1].timestamp_ns)
      return false;
  return !list.images.empty();
}

const char kKalibr[] =
    "cam0:\n  cam_overlaps: [1]\n  camera_model: pinhole\n  distortion_coeffs: [-0.2, 0.05, 0.001, -0.0002]\n"
    "  distortion_model: radtan\n  intrinsics: [458.6, 457.3, 367.2, 248.4]\n  resolution: [752, 480]\n"
    "  rostopic: /cam0/image_raw\n";
const char kOpenCv[] =
    "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n"
    "   dt: d\n   data: [ 525., 0., 319.5, 0., 524., 239.5, 0., 0., 1. ]\n"
    "distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n"
    "   data: [ 0.1, -0.2, 0.001, 0.002, 0.01 ]\nreadout_s: 0.03\nreadout_axis: rows\n";
const char kRos[] =
    "image_width: 640\nimage_height: 480\ncamera_name: c\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
    "  data: [525, 0, 319.5, 0, 524, 239.5, 0, 0, 1]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n"
    "  rows: 1\n  cols: 5\n  data: [0.1, -0.2, 0, 0, 0]\n";
const char kEuroc[] =
    "sensor_type: camera\ncomment: c\nT_BS:\n  cols: 4\n  rows: 4\n"
    "  data: [0, -1, 0, 0.1, 1, 0, 0, 0.2, 0, 0, 1, 0.3, 0, 0, 0, 1]\nrate_hz: 20\nresolution: [752, 480]\n"
    "camera_model: pinhole\nintrinsics: [458.6, 457.3, 367.2, 248.4]\ndistortion_model: radial-tangential\n"
    "distortion_coefficients: [-0.28, 0.07, 0.0002, 1.8e-05]\n";

TEST(MutatedInputs, Calibrations) {
  read_mutated("calibration", {kKalibr, kOpenCv, kRos, kEuroc}, "calibration.yaml",
               [](const std::filesystem::path& file) {
                 std::vector<std::string> warnings;
                 const platform::Calibration calibration = platform::read_calibration(file, &warnings);
                 return calibration.model.validate().ok() && std::isfinite(calibration.shutter.line_time_s) &&
                        std::isfinite(calibration.exposure_s);
               });
}

TEST(MutatedInputs, BodiesOfCameras) {
  read_mutated("T_BS", {kEuroc}, "sensor.yaml", [](const std::filesystem::path& file) {
    return platform::read_camera_to_body(file).matrix().allFinite();
  });
}

std::string poses(const char* separator, bool nanoseconds) {
  std::string text = "# t x y z q\n";
  for (int i = 0; i < 12; ++i) {
    text += nanoseconds ? std::to_string(1403636579763555584 + int64_t{i} * 50000000)
                        : "1305031102." + std::to_string(100000 + i * 33333);
    for (const char* number : {"0.1", "-2.5e-1", "3", nanoseconds ? "1" : "0", "0", "0", nanoseconds ? "0" : "1"})
      text += std::string(separator) + number;
    text += "\n";
  }
  return text;
}

TEST(MutatedInputs, Trajectories) {
  read_mutated("trajectory", {poses(" ", false)}, "trajectory.txt", [](const std::filesystem::path& file) {
    std::vector<std::string> warnings;
    return usable(platform::read_tum_trajectory(file, &warnings));
  });
}

TEST(MutatedInputs, GroundTruthOfEuroc) {
  const test::ScratchFolder folder;
  write_quickly(folder / "sensor.yaml", kEuroc);
  read_mutated("ground truth", {poses(",", true)}, "data.csv", [&](const std::filesystem::path& file) {
    std::vector<std::string> warnings;
    const platform::Trajectory truth =
        platform::read_ground_truth({.euroc = file, .euroc_sensor = folder / "sensor.yaml"},
                                    {1403636579763555584, 1403636579763555584 + 550000000}, &warnings);
    if (truth.empty() && !warnings.empty()) throw InputError(warnings.back());  // it is left out
    return usable(truth);
  });
}

platform::ImageList listed(const std::filesystem::path& source) {
  std::vector<std::string> warnings;
  return platform::list_images(source, &warnings);
}

TEST(MutatedInputs, ListsOfImages) {
  std::string tum = "# timestamp filename\n";
  for (int i = 0; i < 12; ++i)
    tum += "1305031102." + std::to_string(100000 + i * 33333) + " rgb/" + std::to_string(i) + ".png\n";
  read_mutated("list", {tum}, "rgb.txt", [](const std::filesystem::path& file) { return usable(listed(file)); });
  std::string euroc = "#timestamp [ns],filename\n";
  for (int i = 0; i < 12; ++i) {
    const std::string stamp = std::to_string(1403636579763555584 + int64_t{i} * 50000000);
    euroc += stamp + "," + stamp + ".png\n";
  }
  read_mutated("EuRoC list", {euroc}, "data.csv",
               [](const std::filesystem::path& file) { return usable(listed(file.parent_path())); });
}

std::string content_of(const std::filesystem::path& file) {
  const std::vector<std::byte> bytes = platform::read_file(file, size_t{1} << 20);
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

TEST(MutatedInputs, Images) {
  const test::ScratchFolder folder;
  const std::string command = "ffmpeg -nostdin -v error -f lavfi -i testsrc=size=37x29 -frames:v 1 -y ";
  std::vector<std::string> seeds;
  for (const char* name : {"a.png", "a.jpg", "a.bmp", "a.tif", "a.pgm", "a.ppm"}) {
    ASSERT_EQ(std::system((command + (folder / name).string()).c_str()), 0);
    seeds.push_back(content_of(folder / name));
  }
  read_mutated("image", seeds, "image.png", [](const std::filesystem::path& file) {
    const platform::GreyPixels image = platform::read_image(file);
    return image.width > 0 && image.height > 0 &&
           image.px.size() == static_cast<size_t>(image.width) * static_cast<size_t>(image.height);
  });
}

// Through ffprobe and ffmpeg, as a recording: to its end, or to where it breaks off.
TEST(MutatedInputs, Videos) {
  const test::ScratchFolder folder;
  const std::string command = "ffmpeg -nostdin -v error -f lavfi -i testsrc=size=64x64:rate=15 -frames:v 12 ";
  std::vector<std::string> seeds;
  for (const char* name : {"-c:v libx264 -pix_fmt yuv420p a.mp4", "-c:v libx264 -bf 0 a.mkv", "-c:v mjpeg a.avi",
                           "-c:v libx264 -pix_fmt yuv420p a.h264", "-c:v mpeg4 a.mp4"}) {
    const std::string words = name;
    const size_t cut = words.rfind(' ') + 1;
    const std::filesystem::path file = folder / words.substr(cut);
    ASSERT_EQ(std::system((command + words.substr(0, cut) + "-y " + file.string()).c_str()), 0);
    seeds.push_back(content_of(file));
  }
  const auto reader = [](const std::filesystem::path& file) {
    platform::RecordingOptions options;
    options.source = file;
    options.fov_degrees = 60;
    std::vector<std::string> warnings;
    const std::unique_ptr<platform::Camera> camera = platform::open_recording(options, &warnings);
    Frame frame;
    int64_t last_ns = std::numeric_limits<int64_t>::min();
    int frames = 0;
    for (; camera->read(&frame); ++frames) {
      if (frame.timestamp_ns <= last_ns || frame.width != camera->info().model.width) return false;
      last_ns = frame.timestamp_ns;
    }
    return frames > 0;
  };
  read_mutated("video", seeds, "video.mp4", reader, 12, 2000);
}

}  // namespace
}  // namespace pptam
