// Renders the recording of the microcontroller's test and tracks it on this computer: bare_metal_recording FOLDER.
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "sim_phone/phone_camera.h"
#include "tests/bare_metal/run.h"

namespace pptam::test {
namespace {

std::ifstream input;
std::string said;

// What run_recording() says last of a recording.
std::string result_of(const std::filesystem::path& file, int changed_frame) {
  constexpr size_t kBlockBytes = 7 << 20, kImageBytes = 320 * 240;  // as on the board
  std::vector<std::max_align_t> block(kBlockBytes / sizeof(std::max_align_t));
  std::vector<uint8_t> image(kImageBytes);
  input = std::ifstream(file, std::ios::binary);
  const auto read = [](void* to, size_t bytes) {
    return static_cast<bool>(input.read(static_cast<char*>(to), static_cast<std::streamsize>(bytes)));
  };
  const auto say = [](const char* text) { said = text; };
  const int code = run_recording({read, say, block.data(), kBlockBytes, image.data(), image.size()}, changed_frame);
  return code == 0 ? said : "";
}

int run(const std::filesystem::path& folder) {
  sim::PhoneOptions options;
  options.duration_s = 5;
  const auto camera = sim::make_phone_camera(options);
  const platform::CameraInfo& info = camera->info();
  RecordingHead head = {};
  head.camera.width = info.model.width;
  head.camera.height = info.model.height;
  head.camera.fx = info.model.fx;
  head.camera.fy = info.model.fy;
  head.camera.cx = info.model.cx;
  head.camera.cy = info.model.cy;
  head.camera.shutter_axis = static_cast<int32_t>(info.shutter.axis);
  head.camera.line_time_s = info.shutter.line_time_s;
  head.exposure_s = info.exposure_s;
  std::ostringstream frames;
  Frame frame;
  for (; camera->read(&frame); ++head.frames) {
    frames.write(reinterpret_cast<const char*>(&frame.timestamp_ns), sizeof frame.timestamp_ns);
    for (int y = 0; y < frame.height; ++y)
      frames.write(reinterpret_cast<const char*>(frame.data) + y * frame.stride_bytes, frame.width);
  }
  std::filesystem::create_directories(folder);
  const std::filesystem::path file = folder / "bare_metal.frames";
  {
    std::ofstream out(file, std::ios::binary);
    out.write(reinterpret_cast<const char*>(&head), sizeof head);
    out << frames.str();
  }
  const std::string result = result_of(file, -1);
  std::cout << "here: " << said;
  std::ofstream(folder / "bare_metal.result") << result;
  if (result.empty()) return 1;
  const std::string changed = result_of(file, 10);
  if (changed.empty() || changed == result) {
    std::cout << "FAILED: one pixel of an early frame changes nothing: nothing is compared\n";
    return 1;
  }
  return 0;
}

}  // namespace
}  // namespace pptam::test

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: bare_metal_recording FOLDER\n";
    return 2;
  }
  return pptam::test::run(argv[1]);
}
