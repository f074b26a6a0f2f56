// Our V4L2 camera on the kernel's driver uvcvideo: every format of usb_camera, which is plugged in and shows the frames
// of the file that PPTAM_SENT names. Runs in the guest of boot.sh: tests/platform/drivers.sh usb.
#include <gtest/gtest.h>

#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include "platform/camera/device_camera.h"
#include "platform/camera/v4l2_device.h"
#include "platform/run/clocks.h"
#include "tests/platform/likeness.h"

namespace pptam::platform {
namespace {

using test::GreyImage, test::Likeness;

// JPEG of the highest quality rounds each coefficient to a whole number: errors spread evenly between -0.5 and 0.5,
// whose rms of 0.29 is that of the pixels, too; their mean is 0.8 of it, 0.23 grey levels, and rounding the pixels adds
// at most 0.5. The frame after it is the control.
TEST(UsbCamera, ShowsItsFramesInEveryFormat) {
  const std::vector<GreyImage> sent = test::read_grey_images(std::getenv("PPTAM_SENT"), size_t{320} * 240);
  ASSERT_GT(sent.size(), 0u);
  for (const char* format : {"YUYV", "NV12", "YU12", "GREY", "MJPG"}) {
    for (const int scale : {1, 2}) {
      DeviceOptions options;
      options.fov_degrees = 60;
      options.sensor.exposure_s = 0.03;
      options.request = {320 * scale, 240 * scale, 15, format};
      const std::unique_ptr<Camera> camera = make_device_camera(open_v4l2_device("/dev/video0"), options, nullptr);
      camera->start();
      Frame frame;
      const int64_t deadline_ns = SteadyClock().now_ns() + 4'000'000'000;
      CameraEvent event = CameraEvent::kTimeout;
      while (event == CameraEvent::kTimeout && SteadyClock().now_ns() < deadline_ns)
        event = camera->wait(&frame, deadline_ns);
      ASSERT_EQ(event, CameraEvent::kFrame) << format << " " << camera->status().trouble;
      ASSERT_EQ(frame.width, 320);
      ASSERT_EQ(frame.height, 240);
      GreyImage seen;
      for (int y = 0; y < frame.height; ++y) {
        const uint8_t* row = frame.data + y * frame.stride_bytes;
        seen.insert(seen.end(), row, row + frame.width);
      }
      const Likeness found = test::find_alike(seen, sent);
      std::printf("%s %dx%d: differs by %.3f grey levels, from the next frame by %.3f\n", format, 320 * scale,
                  240 * scale, found.best, found.next);
      if (format != std::string("MJPG")) {
        EXPECT_EQ(found.best, 0) << format << " " << scale;
      } else {
        EXPECT_LT(found.best, 0.75) << scale;
      }
      EXPECT_GT(found.next, 0.75);
      camera->stop();
    }
  }
}

}  // namespace
}  // namespace pptam::platform
