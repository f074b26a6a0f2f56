// Recorded input: trajectories, images, calibrations, frame transforms, sequences and videos, honest and hostile.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <string>
#include <vector>

#include "platform/camera/calibration.h"
#include "platform/camera/frame_transform.h"
#include "platform/camera/image_files.h"
#include "platform/camera/recorded_camera.h"
#include "platform/camera/video_file.h"
#include "platform/child_process.h"
#include "platform/trajectory.h"
#include "tests/support/random.h"
#include "tests/support/scratch_folder.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;

void write_text(const fs::path& file, const std::string& text) {
  fs::create_directories(file.parent_path());
  std::ofstream(file, std::ios::binary) << text;
}

std::string read_text(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

GreyPixels make_image(int width, int height, const std::function<int(int x, int y)>& grey) {
  GreyPixels image{width, height, {}};
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) image.px.push_back(static_cast<uint8_t>(grey(x, y)));
  }
  return image;
}

GreyPixels flat_image(int width, int height, int grey) {
  return make_image(width, height, [grey](int, int) { return grey; });
}

void write_pgm(const fs::path& file, const GreyPixels& image) {
  write_text(file, "P5\n" + std::to_string(image.width) + " " + std::to_string(image.height) + "\n255\n" +
                       std::string(image.px.begin(), image.px.end()));
}

// Runs what must throw InputError; returns its message, or "" when nothing was thrown. Every message is one line.
std::string input_error(const std::function<void()>& f) {
  try {
    f();
  } catch (const InputError& error) {
    const std::string message = error.what();
    EXPECT_EQ(message.find('\n'), std::string::npos) << message;
    return message;
  }
  ADD_FAILURE() << "nothing was thrown";
  return "";
}

::testing::AssertionResult holds(const std::string& text, const std::string& part) {
  if (text.find(part) != std::string::npos) return ::testing::AssertionSuccess();
  return ::testing::AssertionFailure() << "\"" << part << "\" is not in \"" << text << "\"";
}

class RecordedInput : public ::testing::Test {
 protected:
  RecordingOptions options(const fs::path& source) const {
    RecordingOptions o;
    o.source = source;
    o.fov_degrees = 60;
    return o;
  }

  // The grey of the first pixel of every frame.
  static std::vector<int> greys(Camera* camera) {
    std::vector<int> list;
    for (Frame frame; camera->read(&frame);) list.push_back(frame.data[0]);
    return list;
  }
  static std::vector<int64_t> timestamps(Camera* camera) {
    std::vector<int64_t> list;
    for (Frame frame; camera->read(&frame);) list.push_back(frame.timestamp_ns);
    return list;
  }

  std::string open_error(const RecordingOptions& o) const {
    return input_error([&] { (void)open_recording(o, nullptr); });
  }

  void run(const std::vector<std::string>& argv) {
    ChildProcess child(argv, ChildProcess::Pipe::kReadStdout);
    char discard;
    while (child.read(&discard, 1) == 1) {
    }
    ASSERT_EQ(child.finish(), 0) << child.errors();
  }

  // A video of flat grey frames, frame i of value 10 + 20 i, exact.
  void write_flat_video(const fs::path& file, int frames, const std::string& fps) {
    const std::string size = "64x48";
    ChildProcess child({"ffmpeg", "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "gray", "-s", size, "-r", fps,
                        "-i", "pipe:0", "-c:v", "ffv1", "-f", "matroska", "file:" + file.string()},
                       ChildProcess::Pipe::kWriteStdin);
    for (int i = 0; i < frames; ++i) {
      const GreyPixels image = flat_image(64, 48, 10 + 20 * i);
      ASSERT_TRUE(child.write(image.px.data(), image.px.size()));
    }
    ASSERT_EQ(child.finish(), 0) << child.errors();
  }

  // Noise, so that each of the 30 frames takes a good part of the file; the index comes first.
  void write_noise_mp4(const fs::path& file) {
    test::Random random;
    ChildProcess child({"ffmpeg",    "-v",         "error", "-y",       "-f",
                        "rawvideo",  "-pix_fmt",   "gray",  "-s",       "64x48",
                        "-r",        "30",         "-i",    "pipe:0",   "-c:v",
                        "mpeg4",     "-q:v",       "2",     "-pix_fmt", "yuv420p",
                        "-movflags", "+faststart", "-f",    "mp4",      "file:" + file.string()},
                       ChildProcess::Pipe::kWriteStdin);
    for (int i = 0; i < 30; ++i) {
      const GreyPixels image = make_image(64, 48, [&](int, int) { return random.integer(0, 255); });
      ASSERT_TRUE(child.write(image.px.data(), image.px.size()));
    }
    ASSERT_EQ(child.finish(), 0) << child.errors();
  }

  const test::ScratchFolder scratch_;
  const fs::path& folder_ = scratch_.path();
};

// ---- Trajectories ------------------------------------------------------------------------------------------------

TEST(Timestamp, IsExactToTheNanosecond) {
  const auto ns = [](std::string_view text) {
    int64_t value = -12345;
    return parse_timestamp_s(text, &value) ? value : int64_t{-12345};
  };
  EXPECT_EQ(ns("0"), 0);
  EXPECT_EQ(ns("1305031102.175304"), 1305031102175304000);
  EXPECT_EQ(ns("1403636579.763555584"), 1403636579763555584);  // a double would give ...763555527
  EXPECT_EQ(ns("1.305031102175304000e+09"), 1305031102175304000);
  EXPECT_EQ(ns("-0.5"), -500000000);
  EXPECT_EQ(ns("0.0000000004"), 0);
  EXPECT_EQ(ns("0.0000000005"), 1);
  EXPECT_EQ(ns("1e-9"), 1);
  EXPECT_EQ(ns("9223372036.854775807"), INT64_MAX);
  for (const char* bad : {"", "-", ".", "x", "1.2.3", "1e", "1e999", "9223372036.854775808", "nan", "inf", "1s", "0x10",
                          "99999999999999999999999"}) {
    EXPECT_EQ(ns(bad), -12345) << bad;
  }
}

TEST_F(RecordedInput, TrajectoryRoundTrip) {
  test::Random random;
  Trajectory written;
  for (int i = 0; i < 50; ++i) {
    StampedPose pose;
    pose.timestamp_ns = int64_t{1305031102175304000} + int64_t{33333333} * i;
    Eigen::Quaterniond q(random.gaussian(), random.gaussian(), random.gaussian(), random.gaussian());
    pose.T_wc.linear() = q.normalized().toRotationMatrix();
    pose.T_wc.translation() = Eigen::Vector3d(random.uniform(-9, 9), random.uniform(-9, 9), random.uniform(-9, 9));
    written.push_back(pose);
  }
  write_tum_trajectory(folder_ / "a.txt", written, "one\nline");
  const Trajectory read = read_tum_trajectory(folder_ / "a.txt");
  ASSERT_EQ(read.size(), written.size());
  for (size_t i = 0; i < read.size(); ++i) {
    EXPECT_EQ(read[i].timestamp_ns, written[i].timestamp_ns);
    // Nine significant digits: numbers under 10 are off by at most 5e-9, rotation entries, quadratic in the quaternion,
    // by a few times 5e-10.
    EXPECT_LT((read[i].T_wc.translation() - written[i].T_wc.translation()).cwiseAbs().maxCoeff(), 6e-9);
    EXPECT_LT((read[i].T_wc.linear() - written[i].T_wc.linear()).cwiseAbs().maxCoeff(), 6e-9);
  }
  write_tum_trajectory(folder_ / "b.txt", written, "one line");
  EXPECT_EQ(read_text(folder_ / "a.txt"), read_text(folder_ / "b.txt"));
}

TEST_F(RecordedInput, TrajectoryFormatIsFixed) {
  Trajectory trajectory(2);
  trajectory[0].timestamp_ns = 1500000;
  trajectory[0].T_wc.translation() = Eigen::Vector3d(-0.0, 1.0 / 3, 1e-12);
  trajectory[1].timestamp_ns = 1500001;
  trajectory[1].T_wc.linear() = Eigen::Vector3d(-1, -1, 1).asDiagonal();
  write_tum_trajectory(folder_ / "t.txt", trajectory, "");
  EXPECT_EQ(read_text(folder_ / "t.txt"), "0.001500 0 0.333333333 1e-12 0 0 0 1\n0.001500001 0 0 0 0 0 1 0\n");
}

TEST_F(RecordedInput, TrajectoryErrorsNameFileAndLine) {
  const fs::path file = folder_ / "t.txt";
  const auto error = [&](const std::string& text) {
    write_text(file, text);
    return input_error([&] { (void)read_tum_trajectory(file); });
  };
  const std::string good = "# comment\n\n1 0 0 0 0 0 0 1\r\n";
  write_text(file, good);
  EXPECT_EQ(read_tum_trajectory(file).size(), 1u);
  for (const char* bad :
       {"2 0 0 0 0 0 0", "2 0 0 0 0 0 0 1 5", "2 nan 0 0 0 0 0 1", "2 0 0 0 0 0 0 0", "x 0 0 0 0 0 0 1",
        "1 0 0 0 0 0 0 1", "0.5 0 0 0 0 0 0 1", "2 inf 0 0 0 0 0 1", "2 0,5 0 0 0 0 0 1"}) {
    EXPECT_TRUE(holds(error(good + bad), "t.txt:4: ")) << bad;
  }
  EXPECT_TRUE(holds(input_error([&] { (void)read_tum_trajectory(folder_ / "none.txt"); }), "none.txt"));
  EXPECT_TRUE(holds(input_error([&] { (void)read_tum_trajectory(folder_); }), folder_.string()));
  EXPECT_TRUE(holds(input_error([&] { write_tum_trajectory(folder_ / "no/t.txt", {}, ""); }), "no/t.txt"));
}

// ---- Child processes ---------------------------------------------------------------------------------------------

TEST(ChildProcess, ReadsWritesAndReports) {
  ChildProcess reader({"sh", "-c", "printf abc; echo one >&2; echo two >&2; exit 3"}, ChildProcess::Pipe::kReadStdout);
  char text[8] = {};
  EXPECT_EQ(reader.read(text, sizeof text), 3u);
  EXPECT_STREQ(text, "abc");
  EXPECT_EQ(reader.finish(), 3);
  EXPECT_EQ(reader.errors(), "one; two");

  ChildProcess killed({"sh", "-c", "kill -9 $$"}, ChildProcess::Pipe::kReadStdout);
  EXPECT_EQ(killed.finish(), 128 + 9);

  // A child that ends early: the pipe (64 kB) fills or breaks; SIGPIPE would end this program.
  ChildProcess writer({"true"}, ChildProcess::Pipe::kWriteStdin);
  const std::vector<char> much(1 << 20);
  EXPECT_FALSE(writer.write(much.data(), much.size()));
  EXPECT_EQ(writer.finish(), 0);

  // No shell looks at the arguments.
  ChildProcess echo({"printf", "%s", "$(id) ; `x` \"'"}, ChildProcess::Pipe::kReadStdout);
  char line[32] = {};
  echo.read(line, sizeof line - 1);
  EXPECT_STREQ(line, "$(id) ; `x` \"'");

  // More to stderr than a pipe holds, while nobody reads it.
  ChildProcess chatty({"sh", "-c", "head -c 300000 /dev/zero | tr '\\0' 'x' >&2; echo end"},
                      ChildProcess::Pipe::kReadStdout);
  EXPECT_EQ(chatty.read(line, 4), 4u);
  EXPECT_EQ(chatty.finish(), 0);

  // A destroyed one is ended: this test would last an hour.
  ChildProcess sleeper({"sleep", "3600"}, ChildProcess::Pipe::kReadStdout);
}

TEST(ChildProcess, MissingProgramNamesTheRemedy) {
  const std::string error =
      input_error([] { ChildProcess({"pptam-no-such-program"}, ChildProcess::Pipe::kReadStdout); });
  EXPECT_EQ(error, "cannot run pptam-no-such-program: install it, on Debian with: apt install pptam-no-such-program");
}

// ---- Images ------------------------------------------------------------------------------------------------------

TEST_F(RecordedInput, GreyImagesAreExact) {
  const GreyPixels all = make_image(16, 17, [](int x, int y) { return (16 * y + x) % 256; });
  write_png(folder_ / "a b'\".png", all.view());
  write_pgm(folder_ / "-i.pgm", all);
  EXPECT_EQ(read_image(folder_ / "a b'\".png").px, all.px);
  EXPECT_EQ(read_image(folder_ / "-i.pgm").px, all.px);
}

TEST_F(RecordedInput, ColoursUseTheCoresWeights) {
  test::Random random;
  std::string ppm = "P6\n8 4\n255\n";
  std::vector<uint8_t> expected;
  for (int i = 0; i < 32; ++i) {
    const int r = random.integer(0, 255), g = random.integer(0, 255), b = random.integer(0, 255);
    for (const int c : {r, g, b}) ppm.push_back(static_cast<char>(c));
    expected.push_back(static_cast<uint8_t>((77 * r + 150 * g + 29 * b + 128) >> 8));
  }
  write_text(folder_ / "c.ppm", ppm);
  EXPECT_EQ(read_image(folder_ / "c.ppm").px, expected);
}

TEST_F(RecordedInput, TruncatedImagesAreRefused) {
  test::Random random;
  const GreyPixels image = make_image(48, 32, [&](int, int) { return random.integer(0, 255); });
  write_png(folder_ / "a.png", image.view());
  for (const char* other : {"a.jpg", "a.bmp", "a.pgm"}) {
    run({"ffmpeg", "-v", "error", "-y", "-i", (folder_ / "a.png").string(), (folder_ / other).string()});
  }
  for (const char* name : {"a.png", "a.jpg", "a.bmp", "a.pgm"}) {
    EXPECT_EQ(read_image(folder_ / name).width, 48) << name;  // whole, it is good
    const std::string bytes = read_text(folder_ / name);
    for (size_t length = 0; length < bytes.size(); length += 1 + length / 8) {
      write_text(folder_ / "cut", bytes.substr(0, length));
      EXPECT_TRUE(holds(input_error([&] { (void)read_image(folder_ / "cut"); }), "cut")) << name << " " << length;
    }
    write_text(folder_ / "cut", bytes.substr(0, bytes.size() - 1));
    EXPECT_TRUE(holds(input_error([&] { (void)read_image(folder_ / "cut"); }), "cut")) << name;
  }
}

TEST_F(RecordedInput, TruncatedJpegIsNotSavedByItsThumbnail) {
  test::Random random;
  const GreyPixels image = make_image(48, 32, [&](int, int) { return random.integer(0, 255); });
  write_png(folder_ / "a.png", image.view());
  run({"ffmpeg", "-v", "error", "-y", "-i", (folder_ / "a.png").string(), (folder_ / "a.jpg").string()});
  // A segment whose contents look like the end of an image, as those of a camera's thumbnail do.
  std::string bytes = read_text(folder_ / "a.jpg");
  bytes.insert(2, std::string("\xff\xe1\x00\x04\xff\xd9", 6));
  write_text(folder_ / "a.jpg", bytes);
  EXPECT_EQ(read_image(folder_ / "a.jpg").width, 48);
  write_text(folder_ / "a.jpg", bytes.substr(0, bytes.size() * 3 / 4));
  EXPECT_TRUE(holds(input_error([&] { (void)read_image(folder_ / "a.jpg"); }), "truncated"));
}

TEST_F(RecordedInput, AlteredImagesGiveAnImageOrAnError) {
  test::Random random;
  const GreyPixels image = make_image(24, 16, [&](int, int) { return random.integer(0, 255); });
  write_png(folder_ / "a.png", image.view());
  for (const char* other : {"a.jpg", "a.bmp", "a.pgm", "a.tiff"}) {
    run({"ffmpeg", "-v", "error", "-y", "-i", (folder_ / "a.png").string(), (folder_ / other).string()});
  }
  int refused = 0;
  for (const char* name : {"a.png", "a.jpg", "a.bmp", "a.pgm", "a.tiff"}) {
    const std::string whole = read_text(folder_ / name);
    for (int i = 0; i < 100; ++i) {
      std::string bytes = whole;
      for (int changes = random.integer(1, 4); changes > 0; --changes) {  // mostly in the header
        const int last = random.integer(0, 3) == 0 ? static_cast<int>(bytes.size()) - 1 : 60;
        bytes[static_cast<size_t>(random.integer(0, last))] = static_cast<char>(random.integer(0, 255));
      }
      write_text(folder_ / "altered", bytes);
      try {
        const GreyPixels read = read_image(folder_ / "altered");
        EXPECT_EQ(read.px.size(), static_cast<size_t>(read.width) * static_cast<size_t>(read.height));
      } catch (const InputError&) {
        ++refused;
      }
    }
  }
  EXPECT_GT(refused, 100);
}

TEST_F(RecordedInput, NoImagesAreRefused) {
  const auto error = [&](const fs::path& file) { return input_error([&] { (void)read_image(file); }); };
  EXPECT_TRUE(holds(error(folder_ / "none.png"), "none.png is missing"));
  EXPECT_TRUE(holds(error(folder_), "not a regular file"));
  EXPECT_TRUE(holds(error("/dev/zero"), "not a regular file"));
  write_text(folder_ / "text.png", "hello");
  EXPECT_TRUE(holds(error(folder_ / "text.png"), "text.png"));
  write_text(folder_ / "huge.pgm", "P5\n100000 100000\n255\nx");
  EXPECT_TRUE(holds(error(folder_ / "huge.pgm"), "huge.pgm"));
  write_text(folder_ / "vector.png", "<svg xmlns='http://www.w3.org/2000/svg' width='8' height='8'/>");
  EXPECT_TRUE(holds(error(folder_ / "vector.png"), "vector.png"));
  EXPECT_TRUE(holds(input_error([&] { write_png(folder_ / "no/a.png", flat_image(8, 8, 1).view()); }), "no/a.png"));
  if (::geteuid() != 0) {  // root reads everything
    write_pgm(folder_ / "secret.pgm", flat_image(8, 8, 1));
    fs::permissions(folder_ / "secret.pgm", fs::perms::none);
    EXPECT_TRUE(holds(error(folder_ / "secret.pgm"), "secret.pgm"));
  }
}

// ---- Frame transform ---------------------------------------------------------------------------------------------

TEST(FrameTransform, HalvingIsTheExactBoxMean) {
  test::Random random;
  const GreyPixels image = make_image(34, 22, [&](int, int) { return random.integer(0, 255); });
  FrameTransform transform(34, 22, 0, 17, 11);
  const GreyView half = transform.apply(image.view());
  ASSERT_EQ(half.width, 17);
  ASSERT_EQ(half.height, 11);
  const GreyView full = image.view();
  for (int y = 0; y < 11; ++y) {
    for (int x = 0; x < 17; ++x) {
      const int sum =
          full.at(2 * x, 2 * y) + full.at(2 * x + 1, 2 * y) + full.at(2 * x, 2 * y + 1) + full.at(2 * x + 1, 2 * y + 1);
      EXPECT_EQ(half.at(x, y), (sum + 2) / 4) << x << " " << y;
    }
  }
}

TEST(FrameTransform, AnySizeIsTheMeanOfTheCoveredArea) {
  test::Random random;
  for (int round = 0; round < 20; ++round) {
    const int W = random.integer(1, 40), H = random.integer(1, 40);
    const int w = random.integer(1, W), h = random.integer(1, H);
    const GreyPixels image = make_image(W, H, [&](int, int) { return random.integer(0, 255); });
    FrameTransform transform(W, H, 0, w, h);
    const GreyView small = transform.apply(image.view());
    double worst = 0;
    for (int y = 0; y < h; ++y) {
      for (int x = 0; x < w; ++x) {
        const double x0 = double(x) * W / w, x1 = double(x + 1) * W / w;
        const double y0 = double(y) * H / h, y1 = double(y + 1) * H / h;
        double sum = 0;
        for (int v = 0; v < H; ++v) {
          for (int u = 0; u < W; ++u) {
            const double overlap_x = std::max(0.0, std::min<double>(u + 1, x1) - std::max<double>(u, x0));
            const double overlap_y = std::max(0.0, std::min<double>(v + 1, y1) - std::max<double>(v, y0));
            sum += overlap_x * overlap_y * image.view().at(u, v);
          }
        }
        worst = std::max(worst, std::abs(sum / ((x1 - x0) * (y1 - y0)) - small.at(x, y)));
      }
    }
    EXPECT_LE(worst, 0.5 + 1e-9);  // rounding to whole greys, and double's own error over at most 1600 terms
  }
}

TEST(FrameTransform, RotationMovesPixelsAsItSays) {
  for (const int degrees : {0, 90, 180, 270}) {
    FrameTransform transform(5, 3, degrees, 0, 0);
    EXPECT_EQ(transform.width(), degrees % 180 == 0 ? 5 : 3);
    EXPECT_EQ(transform.height(), degrees % 180 == 0 ? 3 : 5);
    for (int y = 0; y < 3; ++y) {
      for (int x = 0; x < 5; ++x) {
        const GreyPixels dot = make_image(5, 3, [&](int u, int v) { return u == x && v == y ? 255 : 0; });
        const GreyView turned = transform.apply(dot.view());
        const Eigen::Vector2d px = transform.pixel({x, y});
        EXPECT_EQ(turned.at(int(px.x()), int(px.y())), 255) << degrees << " " << x << " " << y;
      }
    }
  }
  // Clockwise: the top-left pixel of the source comes to the top right.
  EXPECT_EQ(FrameTransform(5, 3, 90, 0, 0).pixel({0, 0}), Eigen::Vector2d(2, 0));
}

TEST(FrameTransform, ImpossibleOnesAreRefused) {
  EXPECT_TRUE(holds(input_error([] { FrameTransform(64, 48, 45, 0, 0); }), "45"));
  EXPECT_TRUE(holds(input_error([] { FrameTransform(64, 48, -90, 0, 0); }), "-90"));
  EXPECT_TRUE(holds(input_error([] { FrameTransform(64, 48, 0, 128, 96); }), "128x96"));
  EXPECT_TRUE(holds(input_error([] { FrameTransform(64, 48, 90, 64, 48); }), "48x64"));  // fits only unrotated
  EXPECT_TRUE(holds(input_error([] { FrameTransform(64, 48, 0, 32, 0); }), "32x0"));
  EXPECT_TRUE(holds(input_error([] { FrameTransform(64, 48, 0, -1, -1); }), "-1"));
}

std::vector<CameraModel> example_models() {
  CameraModel m;
  m.width = 640;
  m.height = 480;
  m.fx = 525.0f;
  m.fy = 510.0f;
  m.cx = 308.5f;
  m.cy = 251.25f;
  std::vector<CameraModel> models(4, m);
  models[1].distortion = Distortion::kFov;
  models[1].coeffs[0] = 0.9f;
  models[2].distortion = Distortion::kRadTan;
  const float radtan[5] = {0.1f, -0.18f, 0.004f, -0.007f, 0.02f};
  std::copy(radtan, radtan + 5, models[2].coeffs);
  models[3].distortion = Distortion::kEquidistant;
  const float equidistant[4] = {-0.01f, 0.02f, -0.01f, 0.003f};
  std::copy(equidistant, equidistant + 4, models[3].coeffs);
  for (CameraModel& model : models) model.prepare();
  return models;
}

// Largest distance between where the transformed model and where the transformed pixel say a point is.
double model_error(const CameraModel& source, const FrameTransform& transform, CameraModel changed,
                   test::Random* random) {
  changed.prepare();
  double worst = 0;
  int seen = 0;
  for (int i = 0; i < 300; ++i) {
    const Vector3f p_c(static_cast<float>(random->uniform(-0.5, 0.5)), static_cast<float>(random->uniform(-0.4, 0.4)),
                       1.0f);
    Vector2f px, changed_px;
    if (!source.project(p_c, &px) || !source.in_image(px, 0)) continue;
    const Vector3f turned = transform.rotation().cast<float>() * p_c;
    if (!changed.project(turned, &changed_px)) return 1e9;
    worst = std::max(worst, (transform.pixel(px.cast<double>()) - changed_px.cast<double>()).norm());
    ++seen;
  }
  return seen > 100 ? worst : 1e9;
}

TEST(FrameTransform, ModelFollowsThePixels) {
  test::Random random;
  // Two float32 evaluations of a pixel under 640: a relative 6e-8 for each of some 20 operations, 2 * 640 * 20 * 6e-8.
  constexpr double kTolerance_px = 1.6e-3;
  for (const CameraModel& model : example_models()) {
    ASSERT_TRUE(model.validate().ok()) << model.validate().message();
    for (const int degrees : {0, 90, 180, 270}) {
      const bool upright = degrees % 180 == 0;
      const std::vector<std::pair<int, int>> sizes = {
          {0, 0}, upright ? std::pair(320, 240) : std::pair(240, 320), {300, 211}};
      for (const auto& [w, h] : sizes) {
        const FrameTransform transform(640, 480, degrees, w, h);
        const CameraModel changed = transform.model(model);
        SCOPED_TRACE(std::to_string(int(model.distortion)) + " " + std::to_string(degrees) + " " + std::to_string(w));
        EXPECT_TRUE(changed.validate().ok());
        EXPECT_EQ(changed.width, transform.width());
        EXPECT_EQ(changed.height, transform.height());
        EXPECT_LT(model_error(model, transform, changed, &random), kTolerance_px);

        // The usual mistakes are seen: the half pixel forgotten, the tangential terms left as they were.
        if (w == 240 || w == 320) {
          CameraModel wrong = changed;
          wrong.cx += 0.25f;
          EXPECT_GT(model_error(model, transform, wrong, &random), 0.2);
        }
        if (model.distortion == Distortion::kRadTan && degrees != 0) {
          CameraModel wrong = changed;
          wrong.coeffs[2] = model.coeffs[2];
          wrong.coeffs[3] = model.coeffs[3];
          EXPECT_GT(model_error(model, transform, wrong, &random), 0.2);
        }
      }
    }
  }
}

TEST(FrameTransform, ShutterFollowsThePixels) {
  test::Random random;
  const auto error = [&](const RollingShutter& source, const FrameTransform& transform, const RollingShutter& changed) {
    double worst = 0;
    for (int i = 0; i < 100; ++i) {
      const Eigen::Vector2d px(random.uniform(0, 639), random.uniform(0, 479));
      const double before = source.dt_s(px.cast<float>(), 640, 480);
      const double after = changed.dt_s(transform.pixel(px).cast<float>(), transform.width(), transform.height());
      worst = std::max(worst, std::abs(before - after));
    }
    return worst;
  };
  // Half of the 30 ms readout, times float32's 6e-8 for each of about six operations with coordinates that are twice as
  // large as their difference from the centre.
  constexpr double kTolerance_s = 0.015 * 6e-8 * 6 * 2;
  for (const auto axis : {RollingShutter::Axis::kRows, RollingShutter::Axis::kColumns}) {
    const int lines = axis == RollingShutter::Axis::kRows ? 480 : 640;
    for (const float readout_s : {0.030f, -0.030f}) {
      const RollingShutter shutter = {axis, readout_s / static_cast<float>(lines)};
      for (const int degrees : {0, 90, 180, 270}) {
        for (const int w : {0, 211}) {
          const FrameTransform transform(640, 480, degrees, w, w == 0 ? 0 : 300);
          const RollingShutter changed = transform.shutter(shutter);
          EXPECT_LT(error(shutter, transform, changed), kTolerance_s) << degrees << " " << w;
          const int changed_lines =
              changed.axis == RollingShutter::Axis::kRows ? transform.height() : transform.width();
          EXPECT_NEAR(std::abs(changed.line_time_s) * static_cast<float>(changed_lines), 0.030f, 1e-8f);
          RollingShutter wrong = changed;
          wrong.line_time_s = -wrong.line_time_s;
          EXPECT_GT(error(shutter, transform, wrong), 0.02);
        }
      }
    }
  }
  EXPECT_EQ(FrameTransform(640, 480, 90, 0, 0).shutter({}).line_time_s, 0.0f);
}

// ---- Calibrations ------------------------------------------------------------------------------------------------

const char* const kKalibr =
    "cam0:\n  camera_model: pinhole\n  intrinsics: [461.6, 460.3, 363.0, 248.1]\n  distortion_model: radtan\n"
    "  distortion_coeffs: [-0.27, 0.06, 0.0009, 1.7e-05]\n  resolution: [752, 480]\n  T_cam_imu:\n  - [1, 0, 0, 0]\n";
const char* const kEuroc =
    "sensor_type: camera\ncomment: VI-Sensor cam0\nT_BS:\n  cols: 4\n  rows: 4\n"
    "  data: [0, -1, 0, 1.0,\n         1, 0, 0, 2.0,\n         0, 0, 1, 3.0,\n         0.0, 0.0, 0.0, 1.0]\n"
    "rate_hz: 20\nresolution: [64, 48]\ncamera_model: pinhole\nintrinsics: [60, 61, 31, 24]\n"
    "distortion_model: radial-tangential\ndistortion_coefficients: [-0.02, 0.007, 0.0002, 1.8e-05]\n";
const char* const kRos =
    "image_width: 640\nimage_height: 480\ncamera_name: narrow_stereo\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
    "  data: [520, 0, 310, 0, 510, 240, 0, 0, 1]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n"
    "  cols: 5\n  data: [0.1, -0.18, 0.001, 0.002, 0.03]\nprojection_matrix:\n  rows: 3\n  cols: 4\n  data: [1]\n";

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return at == std::string::npos ? text : text.replace(at, from.size(), to);
}

TEST_F(RecordedInput, FieldOfViewStandsInForACalibration) {
  const CameraModel model = guess_calibration(640, 480, 60).model;
  // The left edge, -0.5, is seen under 30 degrees: tan(30) * fx = 320. Float32 of numbers under 1000: 6e-5.
  EXPECT_NEAR(model.fx * std::tan(M_PI / 6), 320.0, 1e-4);
  EXPECT_EQ(model.fy, model.fx);
  EXPECT_EQ(model.cx, 319.5f);
  EXPECT_EQ(model.cy, 239.5f);
  for (const double bad : {0.0, -5.0, 180.0, std::nan("")}) {
    EXPECT_TRUE(holds(input_error([&] { (void)guess_calibration(640, 480, bad); }), "field of view"));
  }
}

// ---- Sequences of images -----------------------------------------------------------------------------------------

TEST_F(RecordedInput, TumFolder) {
  std::string list = "# color images\n# timestamp filename\n";
  for (int i = 0; i < 5; ++i) {
    const std::string stamp = "1305031102." + std::to_string(175304 + 33333 * i);
    write_pgm(folder_ / ("rgb/" + stamp + ".pgm"), flat_image(64, 48, 50 + i));
    list += stamp + " rgb/" + stamp + ".pgm\r\n";
  }
  write_text(folder_ / "rgb.txt", list);
  write_text(folder_ / "groundtruth.txt", "# ground truth\n1305031102.1 1 2 3 0 0 0 1\n1305031102.2 2 2 3 0 0 0 1\n");
  std::vector<std::string> warnings;
  auto camera = open_recording(options(folder_), &warnings);
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_EQ(warnings[0], "no calibration: assuming a field of view of 60 degrees and no distortion");
  EXPECT_EQ(camera->info().frame_count, 5);
  EXPECT_NEAR(camera->info().frames_per_s, 30.0, 1e-3);  // microseconds of 33 ms
  EXPECT_EQ(camera->info().model.width, 64);
  EXPECT_GT(camera->info().model.max_radius_sq, 0);
  EXPECT_EQ(camera->info().name, folder_.filename());
  EXPECT_EQ(camera->ground_truth().size(), 2u);
  EXPECT_EQ(camera->ground_truth()[0].timestamp_ns, 1305031102100000000);
  Frame frame;
  for (int i = 0; i < 5; ++i) {
    ASSERT_TRUE(camera->read(&frame));
    EXPECT_EQ(frame.width, 64);
    EXPECT_EQ(frame.height, 48);
    EXPECT_EQ(frame.format, PixelFormat::kGrey);
    EXPECT_EQ(frame.data[0], 50 + i);
    EXPECT_EQ(frame.timestamp_ns, 1305031102175304000 + int64_t{33333000} * i);
  }
  EXPECT_FALSE(camera->read(&frame));
  EXPECT_FALSE(camera->read(&frame));

  // The list itself, and every second frame.
  RecordingOptions second = options(folder_ / "rgb.txt");
  second.every = 2;
  camera = open_recording(second, nullptr);
  EXPECT_EQ(camera->info().frame_count, 3);
  EXPECT_NEAR(camera->info().frames_per_s, 15.0, 1e-3);
  EXPECT_EQ(camera->info().name, folder_.filename());
  EXPECT_EQ(greys(camera.get()), (std::vector<int>{50, 52, 54}));

  RecordingOptions timed = options(folder_);
  timed.fps = 10;
  warnings.clear();
  (void)open_recording(timed, &warnings);
  EXPECT_TRUE(holds(warnings.at(0), "frame rate is ignored"));

  for (const char* bad : {"x rgb/a.pgm\n", "1\n", "1e30 a.pgm\n", "stamp name\n", "# none\n"}) {
    write_text(folder_ / "rgb.txt", bad);
    EXPECT_TRUE(holds(open_error(options(folder_)), "rgb.txt")) << bad;
  }
  write_text(folder_ / "rgb.txt", list);
  write_text(folder_ / "groundtruth.txt", "1 2 3\n");
  warnings.clear();
  EXPECT_TRUE(open_recording(options(folder_), &warnings)->ground_truth().empty());
  ASSERT_FALSE(warnings.empty());
  EXPECT_TRUE(holds(warnings[0], "ground truth left out: " + (folder_ / "groundtruth.txt").string() + ":1: "));
}

TEST_F(RecordedInput, RotationTurnsGroundTruthToo) {
  write_pgm(folder_ / "a.pgm", flat_image(64, 48, 7));
  write_text(folder_ / "rgb.txt", "1 a.pgm\n");
  write_text(folder_ / "groundtruth.txt", "1 1 2 3 0.5 0.5 0.5 0.5\n");
  const Eigen::Isometry3d T_wc = open_recording(options(folder_), nullptr)->ground_truth().at(0).T_wc;
  RecordingOptions turned = options(folder_);
  turned.rotate_degrees = 90;
  auto camera = open_recording(turned, nullptr);
  EXPECT_EQ(camera->info().model.width, 48);
  const Eigen::Isometry3d T_wt = camera->ground_truth().at(0).T_wc;
  // What the source camera has to its right, the clockwise image has below.
  const Eigen::Vector3d right = T_wc * Eigen::Vector3d(1, 0, 0);
  EXPECT_LT((right - T_wt * Eigen::Vector3d(0, 1, 0)).norm(), 1e-12);
  EXPECT_GT((right - T_wt * Eigen::Vector3d(1, 0, 0)).norm(), 1.0);
}

TEST_F(RecordedInput, EurocFolder) {
  const fs::path root = folder_ / "MH_01";
  std::string list = "#timestamp [ns],filename\r\n";
  for (int i = 0; i < 3; ++i) {
    const std::string stamp = std::to_string(int64_t{1403636579763555584} + int64_t{50000000} * i);
    write_png((fs::create_directories(root / "mav0/cam0/data"), root / "mav0/cam0/data" / (stamp + ".png")),
              flat_image(64, 48, 10 + i).view());
    list += stamp + "," + stamp + ".png\r\n";
  }
  write_text(root / "mav0/cam0/data.csv", list);
  write_text(root / "mav0/cam0/sensor.yaml", kEuroc);
  // A body at (10, 20, 30), turned by 180 degrees about z; the camera sits at (1, 2, 3) in it.
  write_text(root / "mav0/state_groundtruth_estimate0/data.csv",
             "#timestamp, p_RS_R_x [m], ...\n1403636580838555648,10,20,30,0,0,0,1,0.1,0.2,0.3,1,2,3,4,5,6\n");
  for (const fs::path& source : {root, root / "mav0", root / "mav0/cam0", root / ""}) {
    RecordingOptions o;
    o.source = source;
    std::vector<std::string> warnings;
    auto camera = open_recording(o, &warnings);
    EXPECT_TRUE(warnings.empty());
    EXPECT_EQ(camera->info().name, "MH_01");
    EXPECT_EQ(camera->info().model.fx, 60.0f);
    EXPECT_NEAR(camera->info().frames_per_s, 20.0, 1e-9);
    ASSERT_EQ(camera->ground_truth().size(), 1u);
    const StampedPose pose = camera->ground_truth()[0];
    EXPECT_EQ(pose.timestamp_ns, 1403636580838555648);
    EXPECT_LT((pose.T_wc.translation() - Eigen::Vector3d(10 - 1, 20 - 2, 30 + 3)).norm(), 1e-12);
    // T_BS takes the camera's x to the body's y, the body's half turn that to the world's -y.
    EXPECT_LT((pose.T_wc.linear() * Eigen::Vector3d(1, 0, 0) - Eigen::Vector3d(0, -1, 0)).norm(), 1e-12);
    EXPECT_EQ(timestamps(camera.get()),
              (std::vector<int64_t>{1403636579763555584, 1403636579813555584, 1403636579863555584}));
  }
  RecordingOptions own;
  own.source = root;
  own.calibration = folder_ / "own.yaml";
  write_text(own.calibration, replaced(kEuroc, "[60,", "[70,"));
  EXPECT_EQ(open_recording(own, nullptr)->info().model.fx, 70.0f);

  RecordingOptions o;
  o.source = root;
  write_text(root / "mav0/cam0/sensor.yaml", replaced(kEuroc, "[0, -1,", "[0, -3,"));
  std::vector<std::string> warnings;
  EXPECT_TRUE(open_recording(o, &warnings)->ground_truth().empty());
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_TRUE(holds(warnings[0], "rigid"));
  write_text(root / "mav0/cam0/sensor.yaml", kEuroc);
  write_text(root / "mav0/state_groundtruth_estimate0/data.csv", "14,10,20\n");
  warnings.clear();
  EXPECT_TRUE(open_recording(o, &warnings)->ground_truth().empty());
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_TRUE(holds(warnings[0], "data.csv:1"));
}

TEST_F(RecordedInput, FolderOfImagesInNaturalOrder) {
  int grey = 1;
  for (const char* name : {"-1.pgm", "a1.PGM", "a2.pgm", "a02b.pgm", "a10.pgm", "b 'x\"1.pgm"}) {
    write_pgm(folder_ / name, flat_image(64, 48, grey));
    ++grey;
  }
  write_pgm(folder_ / "._a1.pgm", flat_image(64, 48, 99));
  write_text(folder_ / "notes.txt", "no image");
  RecordingOptions o = options(folder_);
  o.fps = 20;
  auto camera = open_recording(o, nullptr);
  EXPECT_EQ(camera->info().frame_count, 6);
  EXPECT_EQ(greys(camera.get()), (std::vector<int>{1, 2, 3, 4, 5, 6}));
  o.every = 3;
  EXPECT_EQ(timestamps(open_recording(o, nullptr).get()), (std::vector<int64_t>{0, 150000000}));
}

TEST_F(RecordedInput, NumberedPattern) {
  for (int i = 8; i < 12; ++i) {
    write_pgm(folder_ / ("x" + std::to_string(i) + ".pgm"), flat_image(64, 48, i));
    write_pgm(folder_ / ("y" + std::string(i < 10 ? "000" : "00") + std::to_string(i) + ".pgm"),
              flat_image(64, 48, 100 + i));
  }
  write_pgm(folder_ / "x012.pgm", flat_image(64, 48, 77));  // not what %d writes
  EXPECT_EQ(greys(open_recording(options(folder_ / "x%d.pgm"), nullptr).get()), (std::vector<int>{8, 9, 10, 11}));
  auto padded = open_recording(options(folder_ / "y%04d.pgm"), nullptr);
  EXPECT_EQ(timestamps(padded.get()), (std::vector<int64_t>{0, 33333333, 66666667, 100000000}));
  for (const char* bad : {"x%s.pgm", "x%d%d.pgm", "x%", "x%0d.pgm", "x%12d.pgm", "x%n.pgm", "%%d.pgm"}) {
    EXPECT_TRUE(holds(open_error(options(folder_ / bad)), "exactly one %d")) << bad;
  }
  EXPECT_TRUE(holds(open_error(options(folder_ / "z%d.pgm")), "no image matches"));
  EXPECT_TRUE(holds(open_error(options(folder_ / "none/z%d.pgm")), "none"));
  fs::remove(folder_ / "x10.pgm");
  EXPECT_TRUE(holds(open_error(options(folder_ / "x%d.pgm")), "x10.pgm is missing"));
}

TEST_F(RecordedInput, BrokenImagesEndTheRecordingAfterTheGoodOnes) {
  for (const char* name : {"1.png", "2.png", "3.png"}) write_png(folder_ / name, flat_image(64, 48, 9).view());
  const auto error_after = [&](int good_frames) {
    auto camera = open_recording(options(folder_), nullptr);
    Frame frame;
    for (int i = 0; i < good_frames; ++i) EXPECT_TRUE(camera->read(&frame));
    return input_error([&] { (void)camera->read(&frame); });
  };
  const std::string whole = read_text(folder_ / "3.png");
  write_text(folder_ / "3.png", whole.substr(0, whole.size() / 2));
  EXPECT_TRUE(holds(error_after(2), "3.png"));
  write_png(folder_ / "3.png", flat_image(48, 64, 9).view());
  const std::string size_error = error_after(2);
  EXPECT_TRUE(holds(size_error, "3.png is 48x64"));
  EXPECT_TRUE(holds(size_error, "64x48"));
  write_text(folder_ / "3.png", "");
  EXPECT_TRUE(holds(error_after(2), "3.png"));
  fs::remove(folder_ / "3.png");
  fs::create_directory(folder_ / "3.png");
  EXPECT_TRUE(holds(error_after(2), "3.png"));
  write_text(folder_ / "rgb.txt", "1 1.png\n2 gone.png\n");
  EXPECT_TRUE(holds(error_after(1), "gone.png is missing"));
}

TEST_F(RecordedInput, MistakesOfTheUserAreNamed) {
  EXPECT_TRUE(holds(open_error(options(folder_ / "nowhere")), "no such file or folder"));
  EXPECT_TRUE(holds(open_error(options("")), "no such file or folder"));
  EXPECT_TRUE(holds(open_error(options("/dev/null")), "regular file"));
  EXPECT_TRUE(holds(open_error(options(folder_ / std::string(5000, 'a'))), "recording"));
  EXPECT_TRUE(holds(open_error(options(folder_)), "holds no images"));

  write_pgm(folder_ / "1.pgm", flat_image(128, 96, 5));
  RecordingOptions o = options(folder_);
  o.fov_degrees = 0;
  EXPECT_TRUE(holds(open_error(o), "give --calibration FILE or --fov DEGREES"));
  o.calibration = folder_ / "c.yaml";
  write_text(o.calibration, kKalibr);
  const std::string size_error = open_error(o);
  EXPECT_TRUE(holds(size_error, "752x480"));
  EXPECT_TRUE(holds(size_error, "128x96"));

  using Change = std::function<void(RecordingOptions*)>;
  const std::vector<Change> changes = {[](auto* r) { r->every = 0; },
                                       [](auto* r) { r->every = -3; },
                                       [](auto* r) { r->fps = -1; },
                                       [](auto* r) { r->fps = NAN; },
                                       [](auto* r) { r->fps = 1e12; },
                                       [](auto* r) { r->fov_degrees = 200; },
                                       [](auto* r) { r->rotate_degrees = 1; },
                                       [](auto* r) { r->readout_s = NAN; },
                                       [](auto* r) { r->readout_s = 5; },
                                       [](auto* r) { r->resize_width = 10; },
                                       [](auto* r) { r->resize_width = r->resize_height = 500; },
                                       [](auto* r) { r->fov_degrees = NAN; }};
  for (size_t i = 0; i < changes.size(); ++i) {
    RecordingOptions bad = options(folder_);
    changes[i](&bad);
    EXPECT_NE(open_error(bad), "") << i;
  }
}

TEST_F(RecordedInput, RotationComesBeforeResizing) {
  write_pgm(folder_ / "1.pgm", make_image(128, 96, [](int x, int y) { return x < 64 && y < 48 ? 200 : 0; }));
  RecordingOptions o = options(folder_);
  o.rotate_degrees = 90;
  o.resize_width = 48;
  o.resize_height = 64;
  o.readout_s = 0.064;
  auto camera = open_recording(o, nullptr);
  EXPECT_EQ(camera->info().model.width, 48);
  EXPECT_EQ(camera->info().model.height, 64);
  // Rows of the source, top first, are columns of the output, right first; 0.064 s over 48 columns.
  EXPECT_EQ(camera->info().shutter.axis, RollingShutter::Axis::kColumns);
  EXPECT_FLOAT_EQ(camera->info().shutter.line_time_s, -0.064f / 48);
  Frame frame;
  ASSERT_TRUE(camera->read(&frame));
  EXPECT_EQ(frame.data[0], 0);
  EXPECT_EQ(frame.data[47], 200);  // top left has come to the top right
  EXPECT_EQ(frame.data[63 * frame.stride_bytes + 47], 0);
}

TEST_F(RecordedInput, ReadoutOptionsOverrideTheCalibration) {
  write_pgm(folder_ / "1.pgm", flat_image(640, 480, 5));
  RecordingOptions o;
  o.source = folder_;
  o.calibration = folder_ / "c.yaml";
  write_text(o.calibration, std::string(kRos) + "readout_s: 0.024\nreadout_direction: -1\n");
  EXPECT_FLOAT_EQ(open_recording(o, nullptr)->info().shutter.line_time_s, -0.024f / 480);
  o.readout_axis = RollingShutter::Axis::kColumns;
  EXPECT_FLOAT_EQ(open_recording(o, nullptr)->info().shutter.line_time_s, -0.024f / 640);
  o.readout_s = 0.064;
  EXPECT_FLOAT_EQ(open_recording(o, nullptr)->info().shutter.line_time_s, 0.064f / 640);
  o.readout_s = 0.0;
  EXPECT_EQ(open_recording(o, nullptr)->info().shutter.line_time_s, 0.0f);
}

// ---- Videos ------------------------------------------------------------------------------------------------------

TEST_F(RecordedInput, VideoFrames) {
  const fs::path file = folder_ / "a 'b\" $(c).mkv";
  write_flat_video(file, 10, "25");
  std::vector<std::string> warnings;
  auto camera = open_recording(options(file), &warnings);
  EXPECT_EQ(warnings.size(), 1u);  // no calibration
  EXPECT_EQ(camera->info().model.width, 64);
  EXPECT_EQ(camera->info().model.height, 48);
  EXPECT_NEAR(camera->info().frames_per_s, 25, 1e-6);
  EXPECT_EQ(camera->info().frame_count, 10);
  EXPECT_EQ(greys(camera.get()), (std::vector<int>{10, 30, 50, 70, 90, 110, 130, 150, 170, 190}));

  RecordingOptions o = options(file);
  o.every = 4;
  camera = open_recording(o, nullptr);
  EXPECT_EQ(camera->info().frame_count, 3);
  EXPECT_EQ(timestamps(camera.get()), (std::vector<int64_t>{0, 160000000, 320000000}));
  EXPECT_EQ(greys(open_recording(o, nullptr).get()), (std::vector<int>{10, 90, 170}));
  o.fps = 100;
  EXPECT_EQ(timestamps(open_recording(o, nullptr).get()), (std::vector<int64_t>{0, 40000000, 80000000}));

  // Closed before its end, no child process is left behind.
  Frame frame;
  camera = open_recording(options(file), nullptr);
  EXPECT_TRUE(camera->read(&frame));
  camera.reset();
}

TEST_F(RecordedInput, VideoNamesAreNeverOptionsOrUrls) {
  const fs::path before = fs::current_path();
  write_flat_video(folder_ / "v.mkv", 3, "30");
  fs::current_path(folder_);
  for (const char* name :
       {"-i.mkv", "-version", "file:x.mkv", "http:x.mkv", "concat:v.mkv|v.mkv", "pipe:0", "%d.mkv"}) {
    fs::copy_file("v.mkv", name);
    EXPECT_EQ(greys(open_recording(options(name), nullptr).get()).size(), 3u) << name;
  }
  fs::current_path(before);
}

TEST_F(RecordedInput, NoVideosAreRefusedAtOpening) {
  write_text(folder_ / "empty.mp4", "");
  write_text(folder_ / "text.mp4", "This is no video.\nNot at all.\n");
  write_text(folder_ / "script.mp4", "ffconcat version 1.0\nfile http://127.0.0.1:9/a.mp4\n");
  write_text(folder_ / "list.m3u8", "#EXTM3U\n#EXTINF:10,\nhttp://127.0.0.1:9/a.ts\n#EXT-X-ENDLIST\n");
  write_text(folder_ / "noise.bin", std::string("\x01\x02\x03\x04\xff\xfe", 6));
  run({"ffmpeg", "-v", "error", "-f", "lavfi", "-i", "sine=duration=0.1", (folder_ / "sound.wav").string()});
  for (const char* name : {"empty.mp4", "text.mp4", "script.mp4", "list.m3u8", "noise.bin", "sound.wav"}) {
    EXPECT_TRUE(holds(open_error(options(folder_ / name)), name)) << name;
  }
  fs::create_directory(folder_ / "folder.mp4");
  EXPECT_TRUE(holds(open_error(options(folder_ / "folder.mp4")), "holds no images"));
}

TEST_F(RecordedInput, TruncatedVideoGivesItsFramesAndThenAnError) {
  const fs::path file = folder_ / "noise.mp4";
  write_noise_mp4(file);
  std::vector<std::vector<uint8_t>> frames;
  {
    auto camera = open_recording(options(file), nullptr);
    for (Frame frame; camera->read(&frame);) frames.emplace_back(frame.data, frame.data + 64 * 48);
  }
  ASSERT_EQ(frames.size(), 30u);  // whole, it is read to its end without an error
  const std::string bytes = read_text(file);
  const fs::path cut = folder_ / "cut.mp4";
  int last_good = 0;
  for (const double part : {0.1, 0.3, 0.5, 0.7, 0.9, 0.99}) {
    write_text(cut, bytes.substr(0, static_cast<size_t>(part * static_cast<double>(bytes.size()))));
    int good = 0;
    const std::string error = input_error([&] {
      auto camera = open_recording(options(cut), nullptr);
      for (Frame frame; camera->read(&frame); ++good) {
        EXPECT_TRUE(std::equal(frame.data, frame.data + 64 * 48, frames.at(static_cast<size_t>(good)).begin()))
            << part << " frame " << good;
      }
    });
    EXPECT_TRUE(holds(error, "cut.mp4")) << part;
    EXPECT_GE(good, last_good) << part;
    EXPECT_GE(good, static_cast<int>(30 * part) - 4) << part;  // the index takes a few per cent of the file
    EXPECT_LT(good, 30) << part;
    last_good = good;
  }

  // Altered, it gives frames of its size or an error.
  test::Random random;
  for (int i = 0; i < 8; ++i) {
    std::string altered = bytes;
    for (int change = 0; change < 20; ++change) {
      const int at = random.integer(0, static_cast<int>(bytes.size()) - 1) / (i % 2 == 0 ? 1 : 20);
      altered[static_cast<size_t>(at)] = static_cast<char>(random.integer(0, 255));
    }
    write_text(cut, altered);
    try {
      auto camera = open_recording(options(cut), nullptr);
      for (Frame frame; camera->read(&frame);) EXPECT_EQ(frame.width, camera->info().model.width);
    } catch (const InputError& error) {
      EXPECT_TRUE(holds(error.what(), "cut.mp4"));
    }
  }

  // Trimmed without coding it anew: an edit list hides the frames between the last key frame and the cut; no error.
  run({"ffmpeg", "-v", "error", "-y", "-ss", "0.5", "-i", file.string(), "-c", "copy",
       (folder_ / "trim.mp4").string()});
  auto trimmed = open_recording(options(folder_ / "trim.mp4"), nullptr);
  EXPECT_NEAR(static_cast<int>(greys(trimmed.get()).size()), 15, 1);

  // Without its index (at the end of the file) nothing can be read: an error at opening.
  run({"ffmpeg", "-v", "error", "-y", "-i", file.string(), "-c", "copy", (folder_ / "late.mp4").string()});
  const std::string late = read_text(folder_ / "late.mp4");
  write_text(cut, late.substr(0, late.size() / 2));
  EXPECT_TRUE(holds(open_error(options(cut)), "cut.mp4"));
}

}  // namespace
}  // namespace pptam::platform
