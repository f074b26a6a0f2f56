// What videos and pictures say of themselves, and hostile ones: times, turning, pixel shape, depth, formats, limits.

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "platform/camera/image_files.h"
#include "platform/camera/recorded_camera.h"
#include "platform/child_process.h"
#include "tests/support/scratch_folder.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;
using Argv = std::vector<std::string>;

class Media : public ::testing::Test {
 protected:
  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  void write(const std::string& name, const std::string& text) const {
    std::ofstream(folder_ / name, std::ios::binary) << text;
  }
  std::string bytes_of(const std::string& name) const {
    std::ifstream stream(folder_ / name, std::ios::binary);
    return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
  }

  // Runs ffmpeg on 64x48 grey frames; each is one row, repeated.
  void encode(const std::vector<std::string>& rows, const Argv& options, const std::string& name) const {
    Argv argv = {"ffmpeg",   "-v",       "error", "-y",    "-f",
                 "rawvideo", "-pix_fmt", "gray",  "-s",    std::to_string(rows.at(0).size()) + "x48",
                 "-r",       "25",       "-i",    "pipe:0"};
    argv.insert(argv.end(), options.begin(), options.end());
    argv.push_back("file:" + path(name));
    ChildProcess child(argv, ChildProcess::Pipe::kWriteStdin);
    for (const std::string& row : rows) {
      for (int y = 0; y < 48; ++y) ASSERT_TRUE(child.write(row.data(), row.size()));
    }
    ASSERT_EQ(child.finish(), 0) << child.errors();
  }
  // Frame i has the grey 10 + 20 i.
  void encode_flat(int count, const Argv& options, const std::string& name) const {
    std::vector<std::string> rows;
    for (int i = 0; i < count; ++i) rows.emplace_back(64, static_cast<char>(10 + 20 * i));
    encode(rows, options, name);
  }
  void copy(const std::string& from, const Argv& options, const std::string& name) const {
    Argv argv = {"ffmpeg", "-v", "error", "-y", "-i", path(from), "-c", "copy"};
    argv.insert(argv.end(), options.begin(), options.end());
    argv.push_back(path(name));
    ChildProcess child(argv, ChildProcess::Pipe::kReadStdout);
    ASSERT_EQ(child.finish(), 0) << child.errors();
  }

  struct Seen {
    std::vector<int> greys;  // of each frame's first pixel
    std::vector<int64_t> times_ms;
    std::string first_row;
    CameraModel model;
    RollingShutter shutter;
    std::string said;  // warnings (but that of the missing calibration), remarks and the error, one a line
  };
  Seen see(RecordingOptions options) const {
    Seen seen;
    std::vector<std::string> warnings;
    std::unique_ptr<Camera> camera;
    if (options.calibration.empty()) options.fov_degrees = 60;
    std::string error;
    try {
      camera = open_recording(options, &warnings);
      seen.model = camera->info().model;
      seen.shutter = camera->info().shutter;
      for (Frame frame; camera->read(&frame);) {
        if (seen.greys.empty()) seen.first_row.assign(frame.data, frame.data + frame.width);
        seen.greys.push_back(frame.data[0]);
        seen.times_ms.push_back(frame.timestamp_ns / 1000000);
      }
    } catch (const InputError& e) {
      error = std::string("error: ") + e.what() + "\n";
    }
    for (const std::string& warning : warnings) {
      if (!warning.starts_with("no calibration") || warning.find("pixels") != std::string::npos)
        seen.said += warning + "\n";
    }
    if (camera) {
      for (const std::string& remark : camera->remarks()) seen.said += remark + "\n";
    }
    seen.said += error;
    return seen;
  }
  Seen see(const std::string& name) const {
    RecordingOptions options;
    options.source = folder_ / name;
    return see(options);
  }

  const test::ScratchFolder scratch_;
  const fs::path& folder_ = scratch_.path();
};

::testing::AssertionResult says(const std::string& text, const std::string& part) {
  if (text.find(part) != std::string::npos) return ::testing::AssertionSuccess();
  return ::testing::AssertionFailure() << "\"" << part << "\" is not in \"" << text << "\"";
}

// ---- Times of videos ---------------------------------------------------------------------------------------------

TEST_F(Media, FramesHaveTheirOwnTimes) {
  // 25 per second, from the fifth frame on half of that; reordered for coding.
  encode_flat(9,
              {"-vf", "setpts=if(lt(N\\,4)\\,N\\,2*N-3)/25/TB", "-fps_mode", "passthrough", "-enc_time_base", "1/1000",
               "-c:v", "mpeg4", "-bf", "2", "-q:v", "2", "-f", "matroska"},
              "v.mkv");
  const Seen seen = see("v.mkv");
  EXPECT_EQ(seen.times_ms, (std::vector<int64_t>{0, 40, 80, 120, 200, 280, 360, 440, 520}));
  for (size_t i = 0; i < seen.greys.size(); ++i) EXPECT_NEAR(seen.greys[i], 10 + 20 * int(i), 3) << i;  // lossy
  EXPECT_EQ(seen.said, "");

  RecordingOptions options;  // a given rate overrides them
  options.source = folder_ / "v.mkv";
  options.fps = 100;
  EXPECT_EQ(see(options).times_ms, (std::vector<int64_t>{0, 10, 20, 30, 40, 50, 60, 70, 80}));

  // Trimmed without coding it anew: the edit list hides what comes before; the first frame shown is at 0.
  // One that ffmpeg 7.1 writes also hides the last frame, whose time comes before the one that is stored last.
  copy("v.mkv", {"-f", "mp4"}, "v.mp4");
  std::vector<int64_t> times_ms = see("v.mp4").times_ms;
  ChildProcess version({"ffmpeg", "-version"}, ChildProcess::Pipe::kReadStdout);
  std::string says(64, ' ');
  says.resize(version.read(says.data(), says.size()));
  version.finish();
  const size_t number = says.find("version ");
  ASSERT_NE(number, std::string::npos) << says;
  if (std::atoi(says.c_str() + number + 8) >= 7 && times_ms.size() == 8) times_ms.push_back(520);
  EXPECT_EQ(times_ms, seen.times_ms);
}

TEST_F(Media, DoubledAndBackwardStampsAreNoDamage) {
  encode_flat(10, {"-c:v", "ffv1"}, "good.mkv");
  EXPECT_EQ(see("good.mkv").said, "");
  copy("good.mkv", {"-bsf:v", "setts=ts=if(eq(N\\,5)\\,TS-60\\,TS)"}, "back.mkv");
  copy("good.mkv", {"-bsf:v", "setts=ts=if(eq(N\\,5)\\,TS-40\\,TS)"}, "double.mkv");
  for (const char* name : {"back.mkv", "double.mkv"}) {
    const Seen seen = see(name);
    EXPECT_EQ(seen.greys, (std::vector<int>{10, 30, 50, 70, 90, 130, 150, 170, 190})) << name;
    EXPECT_EQ(seen.times_ms, (std::vector<int64_t>{0, 40, 80, 120, 160, 240, 280, 320, 360})) << name;
    EXPECT_TRUE(says(seen.said, "1 of 10 frames are left out")) << name;
    EXPECT_EQ(seen.said.find("error"), std::string::npos) << seen.said;
  }
  // Set back for good, and a pause.
  copy("good.mkv", {"-bsf:v", "setts=ts=if(gte(N\\,5)\\,TS+1000\\,TS)"}, "gap.mkv");
  const Seen gap = see("gap.mkv");
  EXPECT_EQ(gap.times_ms[5], 1200);
  EXPECT_TRUE(says(gap.said, "the longest gap has 1.04 s"));
}

// ffmpeg closes gaps of over 10 s in some containers unless it is told not to; times begin at 0 in all.
TEST_F(Media, LongGapsStay) {
  for (const char* name : {"v.ts", "v.mts", "v.mkv"}) {
    encode_flat(
        8,
        {"-vf", "setpts=if(lt(N\\,4)\\,N\\,N+375)/25/TB", "-fps_mode", "passthrough", "-c:v", "mpeg2video", "-bf", "0"},
        name);
    const Seen seen = see(name);
    EXPECT_EQ(seen.times_ms, (std::vector<int64_t>{0, 40, 80, 120, 15160, 15200, 15240, 15280})) << name;
    EXPECT_TRUE(says(seen.said, "the longest gap has 15 s")) << name;
  }
}

// A recording cut where no whole picture begins or ends: all that is there comes, and a warning.
TEST_F(Media, StreamsCutAnywhereAreReadToTheirEnd) {
  const Argv options = {"-c:v", "mpeg2video", "-bf", "2", "-g", "6", "-q:v", "2"};
  encode_flat(12, options, "whole.ts");
  EXPECT_EQ(see("whole.ts").greys.size(), 12u);
  EXPECT_EQ(see("whole.ts").said, "");
  const std::string bytes = bytes_of("whole.ts");
  constexpr size_t kPacket = 188;
  const size_t packets = bytes.size() / kPacket;
  write("cut.ts", bytes.substr(0, packets * 3 / 4 * kPacket - 50));
  const Seen cut = see("cut.ts");
  EXPECT_GE(cut.greys.size(), 6u);
  EXPECT_EQ(cut.said.find("error"), std::string::npos) << cut.said;
  // Of a file that promises more than it holds the end is missed.
  std::vector<std::string> rows(12, std::string(64, ' '));
  for (size_t i = 0; i < rows.size(); ++i)
    for (size_t x = 0; x < 64; ++x) rows[i][x] = static_cast<char>((x * 7919 + i * 10473) % 251);
  encode(rows, {"-c:v", "rawvideo"}, "whole.mkv");
  const std::string matroska = bytes_of("whole.mkv");
  write("cut.mkv", matroska.substr(0, matroska.size() / 2));
  EXPECT_TRUE(says(see("cut.mkv").said, "truncated or corrupt after frame"));
}

TEST_F(Media, SlowMotionIsNamed) {
  const auto captured = [&](const char* fps) {
    encode_flat(
        4,
        {"-c:v", "mpeg4", "-movflags", "use_metadata_tags", "-metadata", std::string("com.android.capture.fps=") + fps},
        "s.mp4");
    return see("s.mp4").said;
  };
  EXPECT_TRUE(says(captured("240.000000"), "recorded at 240 frames/s and is played at 25"));
  EXPECT_TRUE(says(captured("240.000000"), "give the true rate with --fps 240"));
  RecordingOptions options;
  options.source = folder_ / "s.mp4";
  options.fps = 240;
  EXPECT_EQ(see(options).said, "");
  EXPECT_EQ(captured("25.000000"), "");
}

TEST_F(Media, RawStreamsSayThatTheirRateIsAGuess) {
  encode_flat(5, {"-c:v", "mjpeg", "-q:v", "2", "-f", "mjpeg"}, "pi.mjpeg");
  EXPECT_TRUE(
      says(see("pi.mjpeg").said, "raw mjpeg stream, which holds no times: assuming 25 frames/s; give the true"));
  RecordingOptions options;
  options.source = folder_ / "pi.mjpeg";
  options.fps = 50;
  const Seen seen = see(options);
  EXPECT_EQ(seen.times_ms, (std::vector<int64_t>{0, 20, 40, 60, 80}));
  EXPECT_EQ(seen.said, "");
}

// ---- What a file says of itself ----------------------------------------------------------------------------------

// Writes the matrix by which an MP4's images are to be shown: a b, c d.
std::string with_display_matrix(std::string mp4, int a, int b, int c, int d) {
  size_t at = mp4.find("tkhd");
  EXPECT_NE(at, std::string::npos);
  at += 44;  // after the name: version, times, track, duration, layer, volume
  const auto put = [&](size_t index, int value) {
    const uint32_t fixed = static_cast<uint32_t>(value) << 16;
    for (size_t i = 0; i < 4; ++i) mp4[at + 4 * index + i] = static_cast<char>(fixed >> (24 - 8 * i));
  };
  put(0, a), put(1, b), put(3, c), put(4, d);
  return mp4;
}

TEST_F(Media, TurningAndMirroringAreNamed) {
  encode_flat(2, {"-c:v", "mpeg4", "-f", "mp4"}, "v.mp4");
  const std::string mp4 = bytes_of("v.mp4");
  EXPECT_EQ(see("v.mp4").said, "");
  write("q.mp4", with_display_matrix(mp4, 0, 1, -1, 0));
  EXPECT_TRUE(says(see("q.mp4").said, "rotation by 90 degrees noted in the file is not applied: add --rotate 90"));
  write("h.mp4", with_display_matrix(mp4, -1, 0, 0, -1));
  EXPECT_TRUE(says(see("h.mp4").said, "add --rotate 180"));
  write("m.mp4", with_display_matrix(mp4, -1, 0, 0, 1));
  EXPECT_TRUE(says(see("m.mp4").said, "shown mirrored"));
  RecordingOptions options;
  options.source = folder_ / "q.mp4";
  options.rotate_degrees = 90;
  EXPECT_EQ(see(options).said, "");
  options.rotate_degrees = 270;
  EXPECT_TRUE(says(see(options).said, "the file notes 90"));
}

TEST_F(Media, ExifOrientationIsNamed) {
  encode_flat(1, {"-c:v", "mjpeg", "-f", "image2", "-update", "1"}, "a.jpg");
  std::string jpeg = bytes_of("a.jpg");
  const auto exif = [&](char orientation) {
    const std::string tiff =
        std::string("II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0", 18) + orientation + std::string(7, '\0');
    const std::string content = std::string("Exif\0\0", 6) + tiff;
    std::string segment = "\xff\xe1";
    segment.push_back('\0');
    segment.push_back(static_cast<char>(content.size() + 2));
    return std::string(jpeg).insert(2, segment + content);
  };
  const int rotate[9] = {0, 0, 0, 180, 180, 270, 90, 90, 270};
  for (int orientation = 1; orientation <= 8; ++orientation) {
    write("b.jpg", exif(static_cast<char>(orientation)));
    ImageNotes notes;
    EXPECT_EQ(read_image(folder_ / "b.jpg", &notes).width, 64);  // as stored
    EXPECT_EQ(notes.display.rotate_degrees, rotate[orientation]) << orientation;
    EXPECT_EQ(notes.display.mirrored, orientation == 2 || orientation == 4 || orientation == 5 || orientation == 7);
  }
  write("b.jpg", exif(6));
  EXPECT_TRUE(says(see("b.jpg").said, "add --rotate 90"));
  EXPECT_EQ(see("a.jpg").said, "");
}

std::string kalibr(int width, int height) {
  return "cam0:\n  camera_model: pinhole\n  intrinsics: [70, 71, 25, 30]\n  distortion_model: radtan\n"
         "  distortion_coeffs: [-0.02, 0.007, 0.002, 0.003]\n  resolution: [" +
         std::to_string(width) + ", " + std::to_string(height) + "]\n  readout_s: 0.03\n";
}

TEST_F(Media, ACalibrationOfTheTurnedImageFitsIt) {
  encode_flat(2, {"-c:v", "ffv1"}, "v.mkv");
  write("turned.yaml", kalibr(48, 64));
  RecordingOptions options;
  options.source = folder_ / "v.mkv";
  options.calibration = folder_ / "turned.yaml";
  EXPECT_TRUE(says(see(options).said, "it fits the turned images, add --rotate 90 or 270"));
  for (const int degrees : {90, 270}) {
    options.rotate_degrees = degrees;
    const Seen seen = see(options);
    EXPECT_EQ(seen.said, "");
    EXPECT_EQ(seen.model.width, 48);
    // What it says, but for the rounding of width - 1 - cx there and back.
    EXPECT_EQ(seen.model.fx, 70.0f);
    EXPECT_EQ(seen.model.fy, 71.0f);
    EXPECT_NEAR(seen.model.cx, 25, 1e-5);
    EXPECT_NEAR(seen.model.cy, 30, 1e-5);
    EXPECT_EQ(seen.model.coeffs[2], 0.002f);
    EXPECT_EQ(seen.model.coeffs[3], 0.003f);
    EXPECT_EQ(seen.shutter.axis, RollingShutter::Axis::kRows);  // of the turned image
    EXPECT_FLOAT_EQ(seen.shutter.line_time_s, 0.03f / 64);
  }
  write("stored.yaml", kalibr(64, 48));  // that of the stored image still is turned along
  options.calibration = folder_ / "stored.yaml";
  options.rotate_degrees = 90;
  EXPECT_EQ(see(options).model.fx, 71.0f);
  EXPECT_EQ(see(options).shutter.axis, RollingShutter::Axis::kColumns);
  options.rotate_degrees = 180;
  EXPECT_TRUE(says(see(options).said, "taken as that of the images as stored"));
  write("other.yaml", kalibr(96, 64));
  options.calibration = folder_ / "other.yaml";
  EXPECT_TRUE(says(see(options).said, "calibrate at that size"));
}

TEST_F(Media, PixelShapeIsHonoured) {
  encode_flat(2, {"-vf", "setsar=4/3", "-c:v", "ffv1"}, "v.mkv");
  const Seen wide = see("v.mkv");
  EXPECT_FLOAT_EQ(wide.model.fy, wide.model.fx * 4 / 3);
  EXPECT_TRUE(says(wide.said, "pixels 1.333 times as wide as high"));
  write("square.yaml", kalibr(64, 48));
  RecordingOptions options;
  options.source = folder_ / "v.mkv";
  options.calibration = folder_ / "square.yaml";
  EXPECT_TRUE(says(see(options).said, "says 1.014, which is taken"));
  // One that agrees with the file says nothing new.
  std::string agreeing = kalibr(64, 48);
  agreeing.replace(agreeing.find("70, 71, 25, 30"), 14, "60, 80, 31, 24");
  write("wide.yaml", agreeing);
  options.calibration = folder_ / "wide.yaml";
  EXPECT_EQ(see(options).said, "");
  encode_flat(2, {"-c:v", "ffv1"}, "square.mkv");
  options.source = folder_ / "square.mkv";
  EXPECT_TRUE(says(see(options).said, "are the pixels that far from square?"));
  EXPECT_EQ(see("square.mkv").model.fy, see("square.mkv").model.fx);
}

TEST_F(Media, GreyLevelsSurviveDepthAndRange) {
  std::string ramp;
  for (int x = 0; x < 256; ++x) ramp.push_back(static_cast<char>(x));
  struct Case {
    const char* pixels;
    const char* range;
  };
  for (const Case& c : {Case{"yuv420p", "tv"},
                        {"yuv420p", "pc"},
                        {"yuv420p10le", "tv"},
                        {"yuv444p12le", "pc"},
                        {"gray16le", "pc"},
                        {"yuva420p", "tv"}}) {
    const std::string scale =
        std::string("scale=in_range=full:out_range=") + c.range + ":flags=accurate_rnd,format=" + c.pixels;
    encode({ramp}, {"-vf", scale, "-color_range", c.range, "-c:v", "ffv1"}, "r.mkv");
    const std::string row = see("r.mkv").first_row;
    ASSERT_EQ(row.size(), 256u);
    int worst = 0;
    for (size_t x = 0; x < 256; ++x) worst = std::max(worst, std::abs(int(uint8_t(row[x])) - int(x)));
    EXPECT_LE(worst, 2) << c.pixels << " " << c.range;
  }
}

TEST_F(Media, InterlacedAndHdrVideosAreNamed) {
  encode_flat(2, {"-vf", "setfield=tff", "-flags", "+ildct+ilme", "-field_order", "tt", "-c:v", "mpeg2video"}, "i.mkv");
  EXPECT_TRUE(says(see("i.mkv").said, "interlaced"));
  encode_flat(2, {"-c:v", "ffv1", "-vf", "setparams=color_trc=arib-std-b67"}, "hlg.mkv");
  EXPECT_TRUE(says(see("hlg.mkv").said, "HDR (HLG)"));
}

TEST_F(Media, SixteenBitPictures) {
  const auto pnm = [&](int maxval, int value) {
    std::string text = "P5\n64 48\n" + std::to_string(maxval) + "\n";
    for (int i = 0; i < 64 * 48; ++i) {
      text.push_back(static_cast<char>(value >> 8));
      text.push_back(static_cast<char>(value & 255));
    }
    write("a.pgm", text);
    ImageNotes notes;
    const int grey = read_image(folder_ / "a.pgm", &notes).px[1000];
    return std::pair(grey, notes.dark);
  };
  EXPECT_NEAR(pnm(4095, 2048).first, 127.5, 1);  // by the file's own largest value
  EXPECT_NEAR(pnm(65535, 32768).first, 127.5, 1);
  EXPECT_EQ(pnm(65535, 32768).second, "");
  EXPECT_EQ(pnm(4095, 100).second.empty(), false);
  EXPECT_TRUE(says(pnm(65535, 4095).second, "darkest 16 of 256 grey levels"));
  EXPECT_TRUE(says(see("a.pgm").said, "16 bits per pixel"));
}

// ---- Hostile files -----------------------------------------------------------------------------------------------

TEST_F(Media, PlaylistsOpenNothing) {
  encode_flat(3, {"-c:v", "ffv1"}, "private.mkv");
  EXPECT_EQ(see("private.mkv").greys.size(), 3u);  // there is something to steal
  write("a.mp4", "ffconcat version 1.0\nfile private.mkv\n");
  write("b.mp4", "#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:2,\nfile://" + path("private.mkv") + "\n#EXT-X-ENDLIST\n");
  write("c.mp4", "<?xml version=\"1.0\"?><MPD xmlns=\"urn:mpeg:dash:schema:mpd:2011\" type=\"static\"></MPD>");
  for (const char* name : {"a.mp4", "b.mp4"}) {
    const Seen seen = see(name);
    EXPECT_TRUE(seen.greys.empty()) << name;
    EXPECT_TRUE(says(seen.said, "is a playlist or in another format")) << name;
  }
  EXPECT_TRUE(says(see("c.mp4").said, "error: video"));
}

TEST_F(Media, ForeignPicturesReachNoDecoder) {
  const auto error = [&](const std::string& name, const std::string& bytes) {
    write(name, bytes);
    return see(name).said;
  };
  const std::string pgm = std::string("P5\n# <svg\n64 48\n255\n") + std::string(size_t{64} * 48, 'x');
  EXPECT_EQ(error("good.png", pgm), "");  // told by its content, not by its name
  for (const std::string& text :
       {std::string("<svg xmlns='http://www.w3.org/2000/svg' width='64' height='64'/>"),
        std::string("/* XPM */ static char* a[] = {\"64 48 1 1\"};"), std::string("GIF89a@\0000\0\0\0", 12),
        std::string("RIFF\0\0\0\0WEBPVP8 ", 16), std::string("II+\0\x08\0\0\0", 8)}) {
    EXPECT_TRUE(says(error("a.png", text), "not in a format that is read (PNG, JPEG, PNM, TIFF, BMP)")) << text;
  }
  EXPECT_TRUE(says(error("a.png", ""), "empty"));
  // A chunk as long as numbers go: past the end, and not back to the beginning.
  const std::string png = "\x89PNG\r\n\x1a\n" + std::string("\0\0\0\rIHDR\0\0\0\1\0\0\0\1\x8\0\0\0\0", 21) + "sums";
  EXPECT_TRUE(says(error("a.png", png + "\xff\xff\xff\xf4" + "IDAT" + std::string(40, 'x')), "truncated"));
  EXPECT_TRUE(says(error("a.png", "P5\n100000 100000\n255\n"), "too large"));
  EXPECT_TRUE(says(error("a.png", std::string("\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\1\0\0\0\1\0\0\x8\0\0\0\0", 29)),
                   "65536x65536 pixels: too large"));
  EXPECT_TRUE(says(
      error("a.tif", std::string("II*\0\x08\0\0\0\x02\0\0\1\4\0\1\0\0\0\xff\xff\xff\x7f\1\1\4\0\1\0\0\0\1\0\0\0", 34)),
      "too large"));
  EXPECT_TRUE(says(
      error("a.tif",
            std::string(
                "II*\0\x08\0\0\0\x03\0\0\1\4\0\1\0\0\0\x40\0\0\0\1\1\4\0\1\0\0\0\x30\0\0\0\x53\1\3\0\1\0\0\0\3\0\0\0",
                46)),
      "floating point"));
  EXPECT_TRUE(
      says(error("a.jpg",
                 std::string("\xff\xd8\xff\xc0\0\x14\x8\0\x30\0\x40\4\1\x11\0\2\x11\0\3\x11\0\4\x11\0\xff\xd9", 26)),
           "CMYK"));
}

TEST_F(Media, FilesOfOtherKindsAndSizesAreNotRead) {
  ASSERT_EQ(::mkfifo(path("fifo.png").c_str(), 0600), 0);
  EXPECT_TRUE(says(see("fifo.png").said, "neither a folder nor a regular file"));
  write("list.txt", "1.0 fifo.png\n");
  EXPECT_TRUE(says(see("list.txt").said, "not a regular file"));
  write("large.bmp", "BM");
  fs::resize_file(folder_ / "large.bmp", uintmax_t{8} << 30);  // sparse
  EXPECT_TRUE(says(see("large.bmp").said, "larger than 256 MB"));
}

TEST(ChildLimitsTest, SilenceAndHungerEndAChild) {
  const auto start = std::chrono::steady_clock::now();
  char byte = 0;
  ChildProcess silent({"sleep", "60"}, ChildProcess::Pipe::kReadStdout, {.silence_s = 1});
  try {
    silent.read(&byte, 1);
    ADD_FAILURE() << "nothing was thrown";
  } catch (const InputError& error) {
    EXPECT_STREQ(error.what(), "sleep gave nothing for 1 seconds and was ended");
  }
  ChildProcess deaf({"sleep", "60"}, ChildProcess::Pipe::kWriteStdin, {.silence_s = 1});
  const std::string much(1 << 20, 'x');
  EXPECT_FALSE(deaf.write(much.data(), much.size()));
  ChildProcess endless({"sh", "-c", "exec >&- 3>&-; exec sleep 60"}, ChildProcess::Pipe::kReadStdoutAndLines,
                       {.silence_s = 1});
  EXPECT_EQ(endless.read(&byte, 1), 0u);
  EXPECT_EQ(endless.finish(), 128 + 9);
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(30));

  const auto hold = [](size_t limit) {  // 40 MB in memory; the pause lets the limit be set
    ChildProcess child({"sh", "-c", "sleep 0.1; head -c 40000000 /dev/zero | tail -c 40000000 | wc -c"},
                       ChildProcess::Pipe::kReadStdout, {.memory_bytes = limit});
    char text[16] = {};
    child.read(text, sizeof text - 1);
    return std::atoi(text);
  };
  EXPECT_EQ(hold(0), 40000000);
  EXPECT_LT(hold(20000000), 40000000);
}

TEST(ChildLimitsTest, LinesComeBesideTheOutput) {
  ChildProcess child({"sh", "-c", "printf 'one\\ntwo\\nhalf' >&3; printf abc"},
                     ChildProcess::Pipe::kReadStdoutAndLines);
  char text[4] = {};
  EXPECT_EQ(child.read(text, 3), 3u);
  std::string line;
  EXPECT_TRUE(child.read_line(&line));
  EXPECT_EQ(line, "one");
  EXPECT_TRUE(child.read_line(&line));
  EXPECT_EQ(line, "two");
  EXPECT_FALSE(child.read_line(&line));
  EXPECT_EQ(child.finish(), 0);
}

}  // namespace
}  // namespace pptam::platform
