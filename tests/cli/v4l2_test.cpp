// The V4L2 camera before a device that is made up: what is chosen, locked, timed, counted and survived.
#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "platform/camera/calibration.h"
#include "platform/camera/camera_device.h"
#include "platform/camera/device_camera.h"
#include "platform/camera/v4l2_device.h"
#include "platform/files.h"
#include "tests/support/fake_v4l2.h"
#include "tests/support/scratch_folder.h"

namespace pptam::platform {
namespace {

using test::FakeV4l2;

constexpr int64_t kMs = 1'000'000;

std::string message_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

bool holds(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

class V4l2 : public ::testing::Test {
 protected:
  std::unique_ptr<Camera> open() {
    warnings_.clear();
    return make_device_camera(open_v4l2_device(driver_.path, &driver_), options_, &warnings_);
  }
  // A picture of one grey, `after_ns` after the one before.
  void add(int after_ms, uint8_t grey = 100) {
    FakeV4l2::Picture picture;
    next_ns_ += after_ms * kMs;
    picture.stamp_ns = next_ns_;
    picture.at_ns = next_ns_ + 25 * kMs;
    picture.sequence = sequence_++;
    const size_t bytes = size_t{driver_.now.bytesperline} * driver_.now.height;
    picture.bytes.assign(bytes, grey);
    driver_.pictures.push_back(picture);
  }
  CameraEvent wait(Camera& camera, int ms = 1000) { return camera.wait(&frame_, driver_.time_ns + ms * kMs); }
  // The first one only tells what the sensor was held at.
  void start(Camera& camera) {
    next_ns_ = driver_.time_ns;
    camera.start();
    add(33);
  }

  FakeV4l2 driver_;
  DeviceOptions options_ = [] {
    DeviceOptions options;
    options.fov_degrees = 60;
    return options;
  }();
  std::vector<std::string> warnings_;
  Frame frame_;
  int64_t next_ns_ = 0;
  uint32_t sequence_ = 10;
};

TEST_F(V4l2, ListsSizesAndRates) {
  driver_.sizes.push_back({V4L2_PIX_FMT_SBGGR8, 640, 480, {30}});  // raw: cannot be read
  const auto list = list_v4l2_cameras(&driver_);
  ASSERT_EQ(list.size(), 1u);
  EXPECT_EQ(list[0].address, "/dev/video0");
  EXPECT_EQ(list[0].name, "Made-up camera");
  ASSERT_EQ(list[0].modes.size(), 2u);
  EXPECT_EQ(list[0].modes[0].format, "YUYV");
  EXPECT_EQ(list[0].modes[0].width, 320);
  EXPECT_EQ(list[0].modes[0].frames_per_s, (std::vector<double>{30, 15}));
  EXPECT_EQ(driver_.opened, 0);
  driver_.capabilities = V4L2_CAP_VIDEO_OUTPUT | V4L2_CAP_STREAMING;
  EXPECT_TRUE(list_v4l2_cameras(&driver_).empty());
}

TEST_F(V4l2, SaysWhatToDoAboutWhatCannotBeOpened) {
  EXPECT_TRUE(holds(message_of([&] { open_v4l2_device("/dev/video9", &driver_); }), "there is no such device"));
  driver_.sizes = {{V4L2_PIX_FMT_SBGGR8, 640, 480, {30}}};
  EXPECT_TRUE(holds(message_of([&] { open(); }), "libcamera:0"));
  driver_.sizes = {{V4L2_PIX_FMT_GREY, 640, 480, {30}}};
  driver_.capabilities = V4L2_CAP_VIDEO_CAPTURE_MPLANE | V4L2_CAP_STREAMING;
  EXPECT_TRUE(holds(message_of([&] { open(); }), "several planes"));
  driver_.capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
  driver_.fails[VIDIOC_S_FMT] = EBUSY;
  EXPECT_TRUE(holds(message_of([&] { open(); }), "another program"));
  driver_.fails.clear();
  options_.fov_degrees = 0;
  const std::string message = message_of([&] { open(); });
  EXPECT_TRUE(holds(message, "--calibration") && holds(message, "--fov")) << message;
  EXPECT_EQ(driver_.opened, 0);
  EXPECT_EQ(driver_.mapped, 0);
}

TEST_F(V4l2, ConfigurationIsValidAdjustedOrInvalid) {
  const auto device = open_v4l2_device(driver_.path, &driver_);
  const Configuration valid = device->configure({640, 480, 30, "YUYV"});
  EXPECT_EQ(valid.answer, ConfigurationAnswer::kValid) << valid.text;
  EXPECT_EQ(valid.mode.width, 640);
  EXPECT_EQ(valid.mode.frames_per_s, std::vector<double>{30});

  const Configuration adjusted = device->configure({400, 300, 30, "YUYV"});
  EXPECT_EQ(adjusted.answer, ConfigurationAnswer::kAdjusted);
  EXPECT_EQ(adjusted.mode.width, 320);
  EXPECT_TRUE(holds(adjusted.text, "400x300 YUYV became 320x240 YUYV")) << adjusted.text;

  driver_.on_format = [](v4l2_pix_format* pix) { pix->pixelformat = V4L2_PIX_FMT_SBGGR8; };
  const Configuration raw = device->configure({640, 480, 30, "YUYV"});
  EXPECT_EQ(raw.answer, ConfigurationAnswer::kInvalid);
  EXPECT_TRUE(holds(raw.text, "cannot be read")) << raw.text;
  driver_.on_format = [](v4l2_pix_format* pix) { pix->field = V4L2_FIELD_INTERLACED; };
  EXPECT_EQ(device->configure({640, 480, 30, "YUYV"}).answer, ConfigurationAnswer::kInvalid);
  driver_.on_format = [](v4l2_pix_format* pix) { pix->width = 32; };
  EXPECT_EQ(device->configure({640, 480, 30, "YUYV"}).answer, ConfigurationAnswer::kInvalid);
  driver_.on_format = [](v4l2_pix_format*) {};
  driver_.fails[VIDIOC_S_FMT] = EINVAL;
  EXPECT_EQ(device->configure({640, 480, 30, "YUYV"}).answer, ConfigurationAnswer::kInvalid);
}

TEST(Adjustments, TellWhatWasWantedOnly) {
  const CameraMode given = {"MJPG", 640, 480, {}};
  EXPECT_EQ(adjustment({}, given), "");
  EXPECT_EQ(adjustment({640, 480, 15, "MJPG"}, given), "");
  EXPECT_EQ(adjustment({700, 500, 0, "YUYV"}, given), "700x500 YUYV became 640x480 MJPG");
  EXPECT_EQ(adjustment({700, 500, 0, ""}, given), "700x500 became 640x480");
  EXPECT_EQ(adjustment({0, 0, 0, "YUYV"}, given), "YUYV became MJPG");
  EXPECT_EQ(adjustment({700, 0, 0, ""}, given), "width 700 became width 640");
  EXPECT_EQ(adjustment({0, 500, 0, ""}, given), "height 500 became height 480");
  EXPECT_EQ(adjustment({640, 0, 0, ""}, given), "");
}

TEST_F(V4l2, HalvesAndCarriesTheIntrinsicsAlong) {
  driver_.sizes = {{V4L2_PIX_FMT_GREY, 640, 480, {30}}};
  driver_.extra_stride = 64;
  const auto camera = open();
  EXPECT_EQ(camera->info().model.width, 320);
  EXPECT_EQ(camera->info().model.height, 240);
  // 640 px of 60 degrees: fx = 320 / tan(30 degrees) = 554.256, halved; the centre stays the centre.
  EXPECT_NEAR(camera->info().model.fx, 277.128f, 1e-3f);
  EXPECT_FLOAT_EQ(camera->info().model.cx, 159.5f);
  start(*camera);
  add(33, 77);
  driver_.pictures.back().bytes[0] = 80;  // one of the four: (77 * 3 + 80 + 2) / 4 = 78
  ASSERT_EQ(wait(*camera), CameraEvent::kFrame);
  EXPECT_EQ(frame_.width, 320);
  EXPECT_EQ(frame_.data[0], 78);
  EXPECT_EQ(frame_.data[1], 77);
}

TEST_F(V4l2, CutsOutTheMiddle) {
  driver_.sizes = {{V4L2_PIX_FMT_GREY, 640, 360, {30}}};
  const auto camera = open();
  // 480x360 of the middle, two thirds of it: fx = 554.256 * 2 / 3.
  EXPECT_EQ(camera->info().model.width, 320);
  EXPECT_EQ(camera->info().model.height, 240);
  EXPECT_NEAR(camera->info().model.fx, 369.504f, 1e-3f);
  EXPECT_FLOAT_EQ(camera->info().model.cx, 159.5f);
  start(*camera);
  add(33, 50);
  for (size_t y = 0; y < 360; ++y) {  // what is cut away
    for (size_t x = 0; x < 80; ++x) driver_.pictures.back().bytes[640 * y + x] = 255;
  }
  ASSERT_EQ(wait(*camera), CameraEvent::kFrame);
  EXPECT_EQ(frame_.data[0], 50);
}

TEST_F(V4l2, LocksWhatCanBeLockedAndSaysIt) {
  driver_.controls = {{V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_APERTURE_PRIORITY},
                      {V4L2_CID_EXPOSURE_ABSOLUTE, 123},
                      {V4L2_CID_AUTOGAIN, 1},
                      {V4L2_CID_GAIN, 9},
                      {V4L2_CID_FOCUS_AUTO, 1},
                      {V4L2_CID_POWER_LINE_FREQUENCY, 0}};
  driver_.refuses = {{V4L2_CID_FOCUS_AUTO, EACCES}};
  options_.sensor.mains_hz = 50;
  const auto before = driver_.controls;
  {
    const auto camera = open();
    start(*camera);
    for (int i = 0; i < 40; ++i) add(33);
    ASSERT_EQ(wait(*camera, 3000), CameraEvent::kFrame);
    // The device's own control had 0.7 s to find its values.
    EXPECT_GE(frame_.timestamp_ns, 1'000'000'000 + 700 * kMs);
    EXPECT_EQ(driver_.controls[V4L2_CID_EXPOSURE_AUTO], V4L2_EXPOSURE_MANUAL);
    EXPECT_EQ(driver_.controls[V4L2_CID_EXPOSURE_ABSOLUTE], 123);
    EXPECT_EQ(driver_.controls[V4L2_CID_AUTOGAIN], 0);
    EXPECT_EQ(driver_.controls[V4L2_CID_POWER_LINE_FREQUENCY], V4L2_CID_POWER_LINE_FREQUENCY_50HZ);
    EXPECT_FLOAT_EQ(camera->info().exposure_s, 0.0123f);
    std::string said;
    for (const std::string& line : camera->status().locks) said += line + "\n";
    EXPECT_TRUE(holds(said, "exposure: locked at 123 (12.3 ms)")) << said;
    EXPECT_TRUE(holds(said, "gain: locked at 9")) << said;
    EXPECT_TRUE(holds(said, "white balance: not locked, the device has no such control")) << said;
    EXPECT_TRUE(holds(said, "focus: not locked, the device refuses it")) << said;
    EXPECT_TRUE(holds(said, "power-line filter: 50 Hz")) << said;
  }
  EXPECT_EQ(driver_.controls, before);  // as they were found
}

// What the light and the user say comes before the device's own control finds the rest.
TEST_F(V4l2, SettlesUnderTheFilterAndTheExposureGiven) {
  driver_.controls = {{V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_APERTURE_PRIORITY},
                      {V4L2_CID_EXPOSURE_ABSOLUTE, 123},
                      {V4L2_CID_AUTOGAIN, 1},
                      {V4L2_CID_GAIN, 9},
                      {V4L2_CID_POWER_LINE_FREQUENCY, 0}};
  options_.sensor.mains_hz = 60;
  options_.sensor.exposure_s = 0.02;
  const auto before = driver_.controls;
  const auto camera = open();
  for (int run = 0; run < 2; ++run) {  // a second one likewise
    SCOPED_TRACE(run);
    driver_.pictures.clear();
    start(*camera);
    EXPECT_EQ(driver_.controls[V4L2_CID_POWER_LINE_FREQUENCY], V4L2_CID_POWER_LINE_FREQUENCY_60HZ);
    EXPECT_EQ(driver_.controls[V4L2_CID_EXPOSURE_ABSOLUTE], 200);
    EXPECT_EQ(driver_.controls[V4L2_CID_AUTOGAIN], 1);
    driver_.controls[V4L2_CID_GAIN] = 31 + run;  // what it finds
    const int64_t from_ns = driver_.time_ns;
    for (int i = 0; i < 40; ++i) add(33);
    ASSERT_EQ(wait(*camera, 3000), CameraEvent::kFrame);
    EXPECT_GE(driver_.time_ns, from_ns + 700 * kMs);
    EXPECT_EQ(driver_.controls[V4L2_CID_AUTOGAIN], 0);
    EXPECT_EQ(driver_.controls[V4L2_CID_GAIN], 31 + run);
    EXPECT_EQ(driver_.controls[V4L2_CID_EXPOSURE_ABSOLUTE], 200);
    camera->stop();
    driver_.controls[V4L2_CID_GAIN] = 9;
    EXPECT_EQ(driver_.controls, before);
  }
}

// A readout of 24 ms for the 360 lines of the device.
TEST_F(V4l2, AReadoutCalibratedInTheMiddleIsThatOfTheWholeImage) {
  driver_.sizes = {{V4L2_PIX_FMT_GREY, 640, 360, {30}}};
  const test::ScratchFolder scratch;
  Calibration middle = guess_calibration(240, 360, 40);  // upright: all lines, less of the columns
  middle.shutter.line_time_s = 0.024f / 360;
  options_.fov_degrees = 0;
  options_.width = 160;
  options_.height = 240;
  options_.calibration = scratch / "camera.yaml";
  write_text_atomically(options_.calibration, calibration_yaml(middle));
  EXPECT_NEAR(open()->info().shutter.line_time_s, 0.024f / 240, 1e-9f);
  // All columns, and 240 of the lines, which take two thirds of it.
  middle = guess_calibration(640, 240, 60);
  middle.shutter.line_time_s = 0.016f / 240;
  options_.width = 320;
  options_.height = 120;
  write_text_atomically(options_.calibration, calibration_yaml(middle));
  const auto camera = open();
  EXPECT_NEAR(camera->info().shutter.line_time_s, 0.016f / 120, 1e-9f);
  start(*camera);
  driver_.pictures.back().flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_EOF;
  add(33);
  driver_.pictures.back().flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_EOF;
  const int64_t stamp_ns = driver_.pictures.back().stamp_ns;
  ASSERT_EQ(wait(*camera), CameraEvent::kFrame);
  EXPECT_EQ(frame_.timestamp_ns, stamp_ns - 12 * kMs);  // half of 24 ms before the end
}

// The image's centre, in the middle of its exposure: 10 ms of exposure and 20 ms of readout.
TEST_F(V4l2, TimesAreThoseOfMidExposure) {
  options_.sensor.exposure_s = 0.010;
  options_.readout_s = -0.020;
  const struct {
    const char* driver;
    uint32_t flags;
    int64_t seen_ms, from_stamp_ms, arrived_ms;  // after the stamp
    const char* clock;
  } cases[] = {
      {"fake", V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_SOE, 40, 15, 30, "start of exposure"},
      {"fake", V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_EOF, 40, -15, 0, "end of frame"},
      {"fake", V4L2_BUF_FLAG_TIMESTAMP_COPY, 25, 25 - 15, 25, "when a frame is seen"},
      {"uvcvideo", V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_SOE, 40, 5, 20, "first packet"},
      // What was said of its readout cannot be: it is not later than it is seen.
      {"uvcvideo", V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_SOE, 12, 5, 12, "first packet"},
  };
  for (const auto& expected : cases) {
    driver_.driver = expected.driver;
    const auto camera = open();
    start(*camera);
    driver_.pictures.back().flags = expected.flags;
    const int64_t stamp_ns = driver_.pictures.back().stamp_ns;
    driver_.pictures.back().at_ns = stamp_ns + expected.seen_ms * kMs;
    ASSERT_EQ(wait(*camera), CameraEvent::kFrame);
    EXPECT_EQ(frame_.timestamp_ns, stamp_ns + expected.from_stamp_ms * kMs) << expected.clock;
    EXPECT_EQ(camera->status().arrived_ns, stamp_ns + expected.arrived_ms * kMs) << expected.clock;
    EXPECT_TRUE(holds(camera->status().clock, expected.clock)) << camera->status().clock;
  }
}

TEST_F(V4l2, TheNewestFrameWinsAndGapsAreCounted) {
  const auto camera = open();
  start(*camera);
  add(33, 1);
  sequence_ += 5;
  add(33, 2);
  add(33, 3);
  driver_.time_ns = next_ns_ + 25 * kMs;  // all are there
  const auto first = wait(*camera);       // tells how the sensor is held
  ASSERT_EQ(first, CameraEvent::kTimeout);
  EXPECT_EQ(camera->status().dropped, 3);
  EXPECT_EQ(camera->status().missed, 5);
  next_ns_ = driver_.time_ns;
  for (const uint8_t grey : {4, 5}) add(200, grey);
  ASSERT_EQ(wait(*camera), CameraEvent::kFrame);
  EXPECT_EQ(frame_.data[0], 4);
  camera->give_back();
  EXPECT_EQ(std::count(driver_.queued.begin(), driver_.queued.end(), true), 4);
}

// What a display draws: the device's own image, with the part that is tracked.
TEST_F(V4l2, ColoursAreThoseOfTheImageThatIsTracked) {
  const struct {
    uint32_t fourcc;
    PixelFormat format;
    int planes;  // of chroma
    bool coloured;
  } kCases[] = {{V4L2_PIX_FMT_YUYV, PixelFormat::kYuyv, 0, true},
                {V4L2_PIX_FMT_NV12, PixelFormat::kNv12, 1, true},
                {V4L2_PIX_FMT_YUV420, PixelFormat::kI420, 2, true},
                {V4L2_PIX_FMT_GREY, PixelFormat::kGrey, 0, false}};
  options_.sensor.exposure_s = 0.01;  // known: the first frame is taken
  for (const bool whole : {true, false}) {
    for (const auto& of : kCases) {
      SCOPED_TRACE(static_cast<int>(of.format));
      driver_.sizes = {{of.fourcc, 640, 360, {30}}};
      driver_.extra_stride = 32;
      options_.rotate_degrees = 90;
      const auto camera = open();
      Picture picture;
      EXPECT_FALSE(camera->picture(&picture)) << "there is no frame yet";
      start(*camera);
      const auto stride = static_cast<size_t>(driver_.now.bytesperline);
      auto& bytes = driver_.pictures.back().bytes;
      if (whole && of.planes > 0) bytes.resize(stride * 360 * 3 / 2);
      for (size_t i = stride * 360; i < bytes.size(); ++i) bytes[i] = i < stride * 360 * 5 / 4 ? 70 : 90;
      ASSERT_EQ(wait(*camera), CameraEvent::kFrame);
      // A driver that does not deliver the chroma: grey.
      ASSERT_EQ(camera->picture(&picture), of.coloured && (whole || of.planes == 0));
      if (!of.coloured || (!whole && of.planes > 0)) continue;
      EXPECT_EQ(picture.frame.format, of.format);
      EXPECT_EQ(picture.frame.width, 640);
      EXPECT_EQ(picture.frame.height, 360);
      EXPECT_EQ(picture.frame.stride_bytes, static_cast<int>(stride));
      EXPECT_EQ(picture.turn_degrees, 90);
      EXPECT_EQ(picture.x, 80);  // the middle of 4 to 3, which is 240x320 once turned
      EXPECT_EQ(picture.y, 0);
      EXPECT_EQ(picture.width, 480);
      EXPECT_EQ(picture.height, 360);
      if (of.planes > 0) {
        const size_t row = of.planes == 1 ? stride : stride / 2;
        EXPECT_EQ(picture.chroma_stride_bytes, static_cast<int>(row));
        EXPECT_EQ(picture.chroma[0][0], 70);
        EXPECT_EQ(picture.chroma[of.planes - 1][row * 180 - 1], 90) << "the last byte";
      }
      camera->give_back();
      EXPECT_FALSE(camera->picture(&picture)) << "the driver has it again";
    }
  }
}

TEST_F(V4l2, BrokenBuffersAreSkippedAndCounted) {
  const auto camera = open();
  start(*camera);
  add(33);
  driver_.pictures.back().flags |= V4L2_BUF_FLAG_ERROR;
  add(33);
  driver_.pictures.back().bytes.resize(100);  // cut off
  add(33);
  driver_.pictures.back().stamp_ns = 0;  // its time goes back
  add(33, 42);
  ASSERT_EQ(wait(*camera), CameraEvent::kFrame);
  EXPECT_EQ(frame_.data[0], 42);
  EXPECT_EQ(camera->status().broken, 3);
  ASSERT_FALSE(camera->remarks().empty());
  EXPECT_TRUE(holds(camera->remarks()[0], "3 broken frames"));
}

// Every refusal of a buffer is made good with the next frame: five of them would leave a stream of four without any.
TEST_F(V4l2, ABufferThatIsRefusedIsGivenAgain) {
  const auto camera = open();
  start(*camera);
  for (int i = 0; i < 10; ++i) {
    add(33);
    ASSERT_EQ(wait(*camera), CameraEvent::kFrame) << i;
    driver_.fails[VIDIOC_QBUF] = EINVAL;
    camera->give_back();
    driver_.fails.clear();
  }
}

TEST_F(V4l2, AStalledStreamIsToldWithinTwoSecondsAndRestarted) {
  const auto camera = open();
  start(*camera);
  add(33);
  ASSERT_EQ(wait(*camera), CameraEvent::kFrame);
  const int64_t from_ns = driver_.time_ns;
  CameraEvent event = CameraEvent::kTimeout;
  while (event == CameraEvent::kTimeout && driver_.time_ns < from_ns + 5000 * kMs) event = wait(*camera, 100);
  EXPECT_EQ(event, CameraEvent::kUnplugged);
  EXPECT_LE(driver_.time_ns - from_ns, 2000 * kMs);
  EXPECT_TRUE(holds(camera->status().trouble, "/dev/video0: no frame for 1.5 s")) << camera->status().trouble;
  next_ns_ = driver_.time_ns + 500 * kMs;
  add(33);
  add(33);
  event = CameraEvent::kTimeout;
  while (event == CameraEvent::kTimeout && driver_.time_ns < from_ns + 9000 * kMs) event = wait(*camera, 100);
  EXPECT_EQ(event, CameraEvent::kReplugged);
  EXPECT_EQ(wait(*camera), CameraEvent::kFrame);
}

TEST_F(V4l2, ReplugsByItselfUnderAnotherName) {
  driver_.controls = {{V4L2_CID_EXPOSURE_AUTO, 3}, {V4L2_CID_EXPOSURE_ABSOLUTE, 50}};
  options_.sensor.exposure_s = 0.02;
  const auto camera = open();
  start(*camera);
  ASSERT_EQ(wait(*camera), CameraEvent::kFrame);
  driver_.unplug();
  EXPECT_EQ(wait(*camera), CameraEvent::kUnplugged);
  EXPECT_TRUE(holds(camera->status().trouble, "the device has gone")) << camera->status().trouble;
  EXPECT_EQ(driver_.mapped, 0);
  for (int i = 0; i < 20; ++i) EXPECT_EQ(wait(*camera, 100), CameraEvent::kTimeout);

  driver_.plugged = true;
  driver_.path = "/dev/video3";
  driver_.card = "Another camera";  // stays where it is
  for (int i = 0; i < 10; ++i) EXPECT_EQ(wait(*camera, 100), CameraEvent::kTimeout);
  driver_.card = "Made-up camera";
  driver_.controls[V4L2_CID_EXPOSURE_AUTO] = 3;
  driver_.controls[V4L2_CID_EXPOSURE_ABSOLUTE] = 77;
  const int64_t from_ns = next_ns_ = driver_.time_ns;
  for (int i = 0; i < 100; ++i) add(33);
  CameraEvent event = CameraEvent::kTimeout;
  while (event == CameraEvent::kTimeout && driver_.time_ns < from_ns + 9000 * kMs) event = wait(*camera, 100);
  EXPECT_EQ(event, CameraEvent::kReplugged);
  EXPECT_EQ(wait(*camera), CameraEvent::kFrame);
  EXPECT_LE(driver_.time_ns - from_ns, 2000 * kMs);
  EXPECT_EQ(driver_.controls[V4L2_CID_EXPOSURE_ABSOLUTE], 200);  // 20 ms, as before
  EXPECT_EQ(camera->status().unplugged, 1);
}

TEST_F(V4l2, ReplugsInAnotherSocketUnlessItMayBeAnother) {
  driver_.twins = {{"/dev/video7", "usb-7"}};  // is there all the time: it is not taken for the one that has gone
  const auto camera = open();
  start(*camera);
  add(33);
  ASSERT_EQ(wait(*camera), CameraEvent::kFrame);
  driver_.unplug();
  EXPECT_EQ(wait(*camera), CameraEvent::kUnplugged);
  for (int i = 0; i < 20; ++i) EXPECT_EQ(wait(*camera, 100), CameraEvent::kTimeout);
  EXPECT_EQ(driver_.twin_calls, 0);
  driver_.plugged = true;
  driver_.path = "/dev/video3";
  driver_.bus = "usb-2.2";
  driver_.twins["/dev/video8"] = "usb-8";  // and one more comes: which of them it is nobody knows
  next_ns_ = driver_.time_ns;
  for (int i = 0; i < 300; ++i) add(33);
  for (int i = 0; i < 20; ++i) EXPECT_EQ(wait(*camera, 100), CameraEvent::kTimeout);
  EXPECT_FALSE(driver_.streaming);
  driver_.twins.erase("/dev/video8");
  CameraEvent event = CameraEvent::kTimeout;
  for (int i = 0; i < 20 && event == CameraEvent::kTimeout; ++i) event = wait(*camera, 100);
  EXPECT_EQ(event, CameraEvent::kReplugged);
  EXPECT_EQ(wait(*camera), CameraEvent::kFrame);
}

// Its images would be read beyond their end.
TEST_F(V4l2, AnotherSizeAfterAReplugIsNotTaken) {
  const std::vector<FakeV4l2::Size> sizes = driver_.sizes;
  options_.request.width = 640;
  options_.request.height = 480;
  const auto camera = open();
  start(*camera);
  add(33);
  ASSERT_EQ(wait(*camera), CameraEvent::kFrame);
  driver_.unplug();
  EXPECT_EQ(wait(*camera), CameraEvent::kUnplugged);
  driver_.plugged = true;
  driver_.sizes.resize(1);  // 320x240
  next_ns_ = driver_.time_ns;
  for (int i = 0; i < 300; ++i) add(33);
  for (int i = 0; i < 40; ++i) EXPECT_EQ(wait(*camera, 100), CameraEvent::kTimeout) << i;
  driver_.sizes = sizes;
  driver_.pictures.clear();
  driver_.now = {};
  driver_.now.bytesperline = 1280;
  driver_.now.height = 480;
  next_ns_ = driver_.time_ns + 300 * kMs;
  for (int i = 0; i < 100; ++i) add(33);
  CameraEvent event = CameraEvent::kTimeout;
  for (int i = 0; i < 40 && event == CameraEvent::kTimeout; ++i) event = wait(*camera, 100);
  EXPECT_EQ(event, CameraEvent::kReplugged);
  EXPECT_EQ(wait(*camera), CameraEvent::kFrame);
}

// A device that delivers another size than it was configured for.
TEST(DeviceCamera, FramesOfAnotherSizeAreBroken) {
  class Shrinks : public CameraDevice {
   public:
    CameraDescription describe() override { return {"shrinks", "", "", {{"GREY", 640, 480, {30}}}}; }
    Configuration configure(const CameraRequest&) override { return {{}, {"GREY", 640, 480, {30}}, ""}; }
    void prepare(const SensorRequest&) override {}
    void start() override {}
    void stop() noexcept override {}
    Wake wait(int64_t deadline_ns) override {
      time_ns_ = deadline_ns;
      return Wake::kDeadline;
    }
    bool take(DeviceFrame* frame) override {
      if (taken_++ > 0) return false;
      *frame = {pixels_.data(), pixels_.size(), 320, 240, 320, PixelLayout::kGrey, 1, Stamp::kEndOfFrame};
      frame->buffer = 0;
      return true;
    }
    void give_back(int) override {}
    bool find_again() override { return false; }
    std::vector<std::string> lock(const SensorRequest&) override { return {}; }
    bool can_lock() const override { return false; }
    double exposure_s() const override { return 0; }
    std::string clock() const override { return ""; }
    int64_t now_ns() const override { return time_ns_; }

   private:
    std::vector<uint8_t> pixels_ = std::vector<uint8_t>(320 * 240);
    int taken_ = 0;
    int64_t time_ns_ = 1'000'000'000;
  };
  DeviceOptions options;
  options.fov_degrees = 60;
  const auto camera = make_device_camera(std::make_unique<Shrinks>(), options, nullptr);
  camera->start();
  Frame frame;
  EXPECT_EQ(camera->wait(&frame, 10'000'000'000), CameraEvent::kUnplugged);
  EXPECT_TRUE(holds(camera->status().trouble, "its images are 320x240 now")) << camera->status().trouble;
}

// Each call of the driver fails once, while opening and while streaming: an error or a later frame, never a hang.
TEST_F(V4l2, EveryCallMayFail) {
  for (const unsigned long request :
       {VIDIOC_QUERYCAP, VIDIOC_ENUM_FMT, VIDIOC_ENUM_FRAMESIZES, VIDIOC_ENUM_FRAMEINTERVALS, VIDIOC_G_FMT,
        VIDIOC_S_FMT, VIDIOC_G_PARM, VIDIOC_S_PARM, VIDIOC_REQBUFS, VIDIOC_QUERYBUF, VIDIOC_QBUF, VIDIOC_DQBUF,
        VIDIOC_STREAMON}) {
    for (const int error : {EIO, EINVAL, ENODEV, ENOMEM}) {
      driver_.fails = {{request, error}};
      const std::string message = message_of([&] {
        const auto camera = open();
        start(*camera);
        const CameraEvent event = wait(*camera, 2000);
        if (event == CameraEvent::kUnplugged) throw InputError(camera->status().trouble);
      });
      EXPECT_EQ(message.find('\n'), std::string::npos);
      driver_.fails.clear();
      driver_.pictures.clear();
      EXPECT_EQ(driver_.opened, 0) << request << " " << error << " " << message;
      EXPECT_EQ(driver_.mapped, 0) << request << " " << error << " " << message;
    }
  }
}

TEST_F(V4l2, FiftyStartsLeaveNothingOpen) {
  for (int i = 0; i < 50; ++i) {
    const auto camera = open();
    for (int again = 0; again < 2; ++again) {
      start(*camera);
      add(33);
      ASSERT_EQ(wait(*camera), CameraEvent::kFrame);
      camera->stop();
      driver_.pictures.clear();
    }
  }
  EXPECT_EQ(driver_.opened, 0);
  EXPECT_EQ(driver_.mapped, 0);
}

TEST(ChooseMode, TheNearestThatIsNotSmaller) {
  const std::vector<CameraMode> modes = {{"MJPG", 640, 480, {60, 30}}, {"YUYV", 640, 480, {15}},
                                         {"YUYV", 160, 120, {60, 30}}, {"YUYV", 352, 288, {30}},
                                         {"NV12", 352, 288, {30}},     {"YUYV", 1280, 720, {10}}};
  const auto chosen = [&](CameraRequest request, int width, int height, int calibrated_width, int calibrated_height) {
    const CameraMode* mode = choose_mode(modes, request, width, height, calibrated_width, calibrated_height);
    return mode == nullptr ? -1 : static_cast<int>(mode - modes.data());
  };
  EXPECT_EQ(chosen({}, 320, 240, 0, 0), 4);                  // the smallest that covers, without colour between
  EXPECT_EQ(chosen({}, 320, 240, 640, 480), 0);              // that of the calibration, quick enough
  EXPECT_EQ(chosen({0, 0, 15, ""}, 320, 240, 640, 480), 1);  // at 15 a second without JPEG
  EXPECT_EQ(chosen({0, 0, 60, ""}, 320, 240, 0, 0), 0);      // the only quick one that covers
  EXPECT_EQ(chosen({0, 0, 0, "YUYV"}, 320, 240, 0, 0), 3);
  EXPECT_EQ(chosen({1280, 720, 0, ""}, 320, 240, 0, 0), 5);
  EXPECT_EQ(chosen({}, 4000, 3000, 0, 0), 0);  // all are smaller: the largest quick one
  EXPECT_EQ(chosen({333, 222, 0, ""}, 320, 240, 0, 0), -1);
}

}  // namespace
}  // namespace pptam::platform
