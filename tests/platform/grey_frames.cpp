// Writes a recording's images, as they would be tracked, one behind the other as raw grey pixels, and the calibration
// that belongs to them: food for usb_camera, and what its frames are compared with.
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <string>

#include "platform/camera/calibration.h"
#include "platform/camera/recorded_camera.h"
#include "platform/input_error.h"

using namespace pptam::platform;

int main(int count, char** words) {
  if (count != 4) {
    std::puts(
        "Usage: grey_frames DEGREES SEQUENCE FILE\n"
        "Turns the images clockwise and writes FILE and FILE.yaml.");
    return 2;
  }
  try {
    RecordingOptions options;
    options.rotate_degrees = std::atoi(words[1]);
    options.source = words[2];
    options.calibration = options.source / "calibration.yaml";
    const std::unique_ptr<Camera> camera = open_recording(options, nullptr);
    std::ofstream pixels(words[3], std::ios::binary);
    pptam::Frame frame{};
    while (camera->read(&frame)) {
      for (int y = 0; y < frame.height; ++y)
        pixels.write(reinterpret_cast<const char*>(frame.data) + y * frame.stride_bytes, frame.width);
    }
    const CameraInfo& info = camera->info();
    std::ofstream(std::string(words[3]) + ".yaml") << calibration_yaml({info.model, info.shutter, info.exposure_s});
    return pixels.flush() ? 0 : 1;
  } catch (const InputError& error) {
    std::fprintf(stderr, "grey_frames: %s\n", error.what());
    return 1;
  }
}
