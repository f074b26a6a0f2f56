// Our V4L2 camera on the kernel's driver vivid, whose controls inject faults. Runs in the guest of boot.sh, where vivid
// is the only camera: tests/platform/drivers.sh vivid.
#include <dirent.h>
#include <fcntl.h>
#include <gtest/gtest.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <cstdlib>
#include <ctime>
#include <fstream>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "platform/camera/device_camera.h"
#include "platform/camera/v4l2_device.h"

namespace pptam::platform {
namespace {

const char* const kNode = "/dev/video0";
constexpr int64_t kSecond = 1'000'000'000;
constexpr int64_t kLongest_ns = 2 * kSecond;  // that any fault may stop the frames or hide itself
constexpr double kFps = 25;                   // that vivid offers at 640x480

// drivers/media/test-drivers/vivid/vivid-ctrls.c
enum Control : uint32_t {
  kTestPattern = 0x00f0f000,
  kTextMode = 0x00f0f001,
  kTimestampSource = 0x00f0f018,
  kDroppedPercent = 0x00f0f040,
  kDisconnect = 0x00f0f041,
  kErroneousBuffer = 0x00f0f042,
  kReqbufsError = 0x00f0f043,
  kQbufError = 0x00f0f044,
  kStreamonError = 0x00f0f045,
  kFatalError = 0x00f0f046,
};
constexpr int kGreyRamp = 20, kNoText = 2;

int64_t now_ns() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * kSecond + now.tv_nsec;
}

// As another program would: the device is opened for this alone.
void set_control(Control id, int value = 1) {
  const int device = open(kNode, O_RDWR | O_CLOEXEC);
  ASSERT_GE(device, 0);
  v4l2_control control = {id, value};
  EXPECT_EQ(ioctl(device, VIDIOC_S_CTRL, &control), 0) << std::hex << id;
  close(device);
}

int count_entries(const char* folder) {
  int count = 0;
  DIR* listing = opendir(folder);
  while (readdir(listing) != nullptr) ++count;
  closedir(listing);
  return count;
}

int count_mappings() {
  std::ifstream maps("/proc/self/maps");
  int count = 0;
  for (std::string line; std::getline(maps, line);) count += line.find("/dev/video") != std::string::npos;
  return count;
}

std::unique_ptr<Camera> open_camera(const std::string& pixels = "", double fps = kFps) {
  DeviceOptions options;
  options.fov_degrees = 60;
  options.request = {640, 480, fps, pixels};
  return make_device_camera(open_v4l2_device(kNode), options, nullptr);
}

// The next frame's pixels; empty when another event comes first, or none in time.
std::vector<uint8_t> next_image(Camera& camera, int64_t* timestamp_ns = nullptr) {
  Frame frame;
  const int64_t until_ns = now_ns() + kLongest_ns;
  CameraEvent event = CameraEvent::kTimeout;
  while (event == CameraEvent::kTimeout && now_ns() < until_ns) event = camera.wait(&frame, until_ns);
  EXPECT_EQ(event, CameraEvent::kFrame);
  std::vector<uint8_t> pixels;
  if (event != CameraEvent::kFrame) return pixels;
  for (int y = 0; y < frame.height; ++y)
    pixels.insert(pixels.end(), frame.data + y * frame.stride_bytes, frame.data + y * frame.stride_bytes + frame.width);
  if (timestamp_ns != nullptr) *timestamp_ns = frame.timestamp_ns;
  return pixels;
}

// Frames may come meanwhile. How long the event took.
int64_t wait_for(Camera& camera, CameraEvent wanted) {
  Frame frame;
  const int64_t from_ns = now_ns();
  while (now_ns() < from_ns + 2 * kLongest_ns) {
    if (camera.wait(&frame, now_ns() + kLongest_ns / 20) == wanted) break;
  }
  return now_ns() - from_ns;
}

void expect_one_line(const std::string& text) {
  EXPECT_NE(text, "");
  EXPECT_EQ(text.find('\n'), std::string::npos) << text;
  EXPECT_NE(text.find(kNode), std::string::npos) << text;
  std::printf("  told: %s\n", text.c_str());
}

// A failure while frames come is told within two seconds, and within two more they come again.
void expect_back(Camera& camera) {
  const int64_t gone_ns = wait_for(camera, CameraEvent::kUnplugged);
  EXPECT_LT(gone_ns, kLongest_ns);
  expect_one_line(camera.status().trouble);
  const int64_t back_ns = wait_for(camera, CameraEvent::kReplugged);
  EXPECT_LT(back_ns, kLongest_ns);
  std::printf("  told after %.2f s, back after %.2f s\n", 1e-9 * static_cast<double>(gone_ns),
              1e-9 * static_cast<double>(back_ns));
  EXPECT_FALSE(next_image(camera).empty());
  EXPECT_EQ(camera.status().unplugged, 1);
}

class Vivid : public testing::Test {
 protected:
  void SetUp() override {
    set_control(kTextMode, kNoText);
    set_control(kTestPattern, kGreyRamp);
    set_control(kDroppedPercent, 0);
    set_control(kTimestampSource, 0);
  }
};

TEST_F(Vivid, IsListedWithTheFormatsThatCanBeRead) {
  const std::vector<CameraDescription> cameras = list_v4l2_cameras();
  ASSERT_EQ(cameras.size(), 1u);
  EXPECT_EQ(cameras[0].address, kNode);
  EXPECT_EQ(cameras[0].driver, "vivid");
  std::set<std::string> formats;
  for (const CameraMode& mode : cameras[0].modes) {
    formats.insert(mode.format);
    EXPECT_FALSE(mode.frames_per_s.empty());
  }
  EXPECT_EQ(formats, (std::set<std::string>{"GREY", "NV12", "YU12", "YUYV"}));
}

// A ramp from the left to the right. The luminances are those of the standard, 16 to 235; vivid's GREY uses all values:
// y = 16 + 219/255 grey. The driver rounds each, and so does the halving of each: up to 0.5 (1 + 219/255) twice, 1.86.
TEST_F(Vivid, AllFormatsGiveTheSameImage) {
  std::vector<uint8_t> first;
  for (const char* pixels : {"YUYV", "NV12", "YU12", "GREY"}) {
    const std::unique_ptr<Camera> camera = open_camera(pixels);
    EXPECT_EQ(camera->info().model.width, 320);
    EXPECT_EQ(camera->info().model.height, 240);
    camera->start();
    const std::vector<uint8_t> image = next_image(*camera);
    camera->stop();
    ASSERT_EQ(image.size(), 320u * 240) << pixels;
    EXPECT_GT(image[319] - image[0], 190) << pixels;  // else everything would be alike
    if (first.empty()) first = image;
    if (pixels != std::string("GREY")) {
      EXPECT_EQ(image, first) << pixels;
      continue;
    }
    double worst = 0;
    for (size_t i = 0; i < image.size(); ++i) worst = std::max(worst, std::abs(16 + 219.0 / 255 * image[i] - first[i]));
    EXPECT_LT(worst, 1.87);
  }
}

TEST_F(Vivid, SizesThatItHasNotBecomeTheNearest) {
  const std::unique_ptr<Camera> camera = open_camera();
  const Configuration same = camera->configure({640, 480, kFps, "YUYV"});
  EXPECT_EQ(same.answer, ConfigurationAnswer::kValid) << same.text;
  const Configuration snapped = camera->configure({700, 500, kFps, "YUYV"});
  EXPECT_EQ(snapped.answer, ConfigurationAnswer::kAdjusted);
  EXPECT_EQ(snapped.mode.width, 640);
  EXPECT_EQ(snapped.mode.height, 480);
  expect_one_line(snapped.text);
  camera->start();
  EXPECT_EQ(next_image(*camera).size(), 320u * 240);
}

// The driver's own pace, however late this program is: its interval is a multiple of a jiffy, 4 ms, at either end.
TEST_F(Vivid, TimesAreTheKernelsAndFollowTheRate) {
  for (const int source : {0, 1}) {
    set_control(kTimestampSource, source);
    const std::unique_ptr<Camera> camera = open_camera("YUYV", 15);
    camera->start();
    int64_t first_ns = 0, last_ns = 0;
    ASSERT_FALSE(next_image(*camera, &first_ns).empty());
    const CameraStatus before = camera->status();
    for (int i = 0; i < 20; ++i) {
      int64_t timestamp_ns = 0;
      ASSERT_FALSE(next_image(*camera, &timestamp_ns).empty());
      EXPECT_GT(timestamp_ns, last_ns);
      EXPECT_LE(camera->status().arrived_ns, now_ns() + kSecond / 15);  // vivid hands a frame over before its time
      EXPECT_GT(camera->status().arrived_ns, now_ns() - kSecond);
      last_ns = timestamp_ns;
    }
    const CameraStatus after = camera->status();
    const auto intervals = 20 + (after.missed - before.missed) + (after.dropped - before.dropped);
    EXPECT_NEAR(static_cast<double>(last_ns - first_ns) / static_cast<double>(intervals), 1e9 / 15, 2 * 4e6 / 20);
    EXPECT_NE(after.clock.find(source == 1 ? "start of exposure" : "end of frame"), std::string::npos) << after.clock;
  }
}

// 50 % until 20 frames have come: that fewer than 4 are missed before has a chance of 1e-4.
TEST_F(Vivid, MissedBuffersAreCounted) {
  const std::unique_ptr<Camera> camera = open_camera();
  camera->start();
  ASSERT_FALSE(next_image(*camera).empty());
  set_control(kDroppedPercent, 50);
  const int64_t before = camera->status().missed;
  for (int i = 0; i < 20; ++i) ASSERT_FALSE(next_image(*camera).empty());
  EXPECT_GE(camera->status().missed - before, 4);
  set_control(kDroppedPercent, 0);
  EXPECT_FALSE(next_image(*camera).empty());
  EXPECT_EQ(camera->status().unplugged, 0);
}

TEST_F(Vivid, ErroneousBuffersAreLeftOutAndCounted) {
  const std::unique_ptr<Camera> camera = open_camera();
  camera->start();
  for (int i = 1; i <= 3; ++i) {
    ASSERT_FALSE(next_image(*camera).empty());
    set_control(kErroneousBuffer);
    for (int k = 0; k < 3; ++k) ASSERT_FALSE(next_image(*camera).empty());
    EXPECT_EQ(camera->status().broken, i);
  }
  EXPECT_EQ(camera->status().unplugged, 0);
}

TEST_F(Vivid, AStartThatFailsIsToldAndTheNextOneWorks) {
  const std::unique_ptr<Camera> camera = open_camera();
  for (const Control fault : {kStreamonError, kReqbufsError, kQbufError}) {
    const int open_files = count_entries("/proc/self/fd");
    set_control(fault);
    try {
      camera->start();
      ADD_FAILURE() << "started in spite of " << std::hex << fault;
    } catch (const InputError& error) {
      expect_one_line(error.what());
    }
    EXPECT_EQ(count_entries("/proc/self/fd"), open_files);
    EXPECT_EQ(count_mappings(), 0);
    camera->start();
    EXPECT_FALSE(next_image(*camera).empty());
    camera->stop();
  }
}

// There are four buffers: without giving the refused ones again there would be none left.
TEST_F(Vivid, BuffersThatAreNotTakenBackDoNotStopTheFrames) {
  const std::unique_ptr<Camera> camera = open_camera();
  camera->start();
  for (int i = 0; i < 10; ++i) {
    ASSERT_FALSE(next_image(*camera).empty());
    set_control(kQbufError);
  }
  for (int i = 0; i < 10; ++i) ASSERT_FALSE(next_image(*camera).empty());
  EXPECT_EQ(camera->status().unplugged, 0);
}

TEST_F(Vivid, AStreamThatFailsIsToldAndComesBack) {
  const std::unique_ptr<Camera> camera = open_camera();
  camera->start();
  ASSERT_FALSE(next_image(*camera).empty());
  set_control(kFatalError);
  expect_back(*camera);
}

TEST_F(Vivid, ADeviceThatIsPulledOutIsToldAndComesBack) {
  const std::unique_ptr<Camera> camera = open_camera();
  camera->start();
  ASSERT_FALSE(next_image(*camera).empty());
  set_control(kDisconnect);
  expect_back(*camera);
}

TEST_F(Vivid, FiftyStartsLeaveNothingBehind) {
  const std::unique_ptr<Camera> camera = open_camera();
  camera->start();
  ASSERT_FALSE(next_image(*camera).empty());  // the sensor has been locked
  camera->stop();
  const int open_files = count_entries("/proc/self/fd");
  for (int i = 0; i < 50; ++i) {
    camera->start();
    EXPECT_GT(count_mappings(), 0);
    ASSERT_FALSE(next_image(*camera).empty());
    camera->stop();
    EXPECT_EQ(count_mappings(), 0);
    EXPECT_EQ(count_entries("/proc/self/fd"), open_files);
  }
}

}  // namespace
}  // namespace pptam::platform
