// Readers of strangers' files on any bytes: each reads what is usable, or says in one line why not. One source for
// several targets: PPTAM_READER names the function.
#include <unistd.h>

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <span>
#include <string>
#include <vector>

#include "platform/camera/calibration.h"
#include "platform/camera/image_files.h"
#include "platform/camera/image_list.h"
#include "platform/camera/luminance.h"
#include "platform/input_error.h"
#include "platform/model/model_file.h"

namespace {

using namespace pptam;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "%s\n", what);
  std::abort();
}

// A file of this content; the same one each time, in a folder of this process.
std::filesystem::path file_of(std::span<const uint8_t> bytes, const char* name) {
  static const std::filesystem::path folder = [] {
    std::filesystem::path made = std::filesystem::is_directory("/dev/shm") ? "/dev/shm" : "/tmp";
    made /= "pptam-fuzz-" + std::to_string(::getpid());
    std::filesystem::create_directories(made);
    std::atexit([] { std::filesystem::remove_all(folder); });
    return made;
  }();
  std::ofstream(folder / name, std::ios::binary)
      .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  return folder / name;
}

[[maybe_unused]] void calibration(std::span<const uint8_t> bytes) {
  const auto content = std::as_bytes(bytes);
  std::vector<std::string> warnings;
  const platform::Calibration read =
      platform::calibration_of({content.begin(), content.end()}, "calibration", &warnings);
  require(read.model.validate().ok(), "an impossible calibration");
  require(std::isfinite(read.shutter.line_time_s) && std::isfinite(read.exposure_s), "times that are no numbers");
  const std::string again = platform::calibration_yaml(read);  // what we write we read
  const auto* text = reinterpret_cast<const std::byte*>(again.data());
  const platform::Calibration reread = platform::calibration_of({text, text + again.size()}, "again", nullptr);
  require(reread.model.fx == read.model.fx && reread.model.width == read.model.width, "written, and read otherwise");
}

[[maybe_unused]] void list(std::span<const uint8_t> bytes) {
  std::vector<std::string> warnings;
  const platform::ImageList read = platform::list_images(file_of(bytes, "rgb.txt"), &warnings);
  require(!read.images.empty(), "a list of nothing");
  for (size_t i = 1; i < read.images.size(); ++i)
    require(
        read.times == platform::ImageTimes::kUnknown || read.images[i].timestamp_ns > read.images[i - 1].timestamp_ns,
        "times that do not rise");
}

[[maybe_unused]] void image(std::span<const uint8_t> bytes) {
  platform::ImageNotes notes;
  const platform::GreyPixels read = platform::read_image(file_of(bytes, "image.png"), &notes);
  require(read.width > 0 && read.height > 0 &&
              read.px.size() == static_cast<size_t>(read.width) * static_cast<size_t>(read.height),
          "an image of another size than its pixels");
}

// An image of a camera: the first bytes say of which kind and size.
[[maybe_unused]] void camera_image(std::span<const uint8_t> bytes) {
  if (bytes.size() < 4) return;
  static platform::Luminance luminance;
  platform::DeviceFrame frame;
  const std::vector<uint8_t> data(bytes.begin() + 4, bytes.end());  // the sanitizer watches its end
  frame.layout = static_cast<platform::PixelLayout>(bytes[0] % 3);
  frame.width = 2 * (bytes[1] % 40) + 2;
  frame.height = 2 * (bytes[2] % 40) + 2;
  frame.stride = frame.width * (1 + bytes[3] % 4);
  frame.data = data.data();
  frame.bytes = data.size();
  GreyView view;
  if (!luminance.read(frame, &view)) {
    require(!luminance.trouble().empty(), "refused without a reason");
    return;
  }
  unsigned sum = 0;
  for (int y = 0; y < view.height; ++y)
    for (int x = 0; x < view.width; ++x) sum += view.at(x, y);
  require(sum <= 255u * 10000u, "more light than there is");
}

[[maybe_unused]] void model(std::span<const uint8_t> bytes) {
  const std::string text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  const platform::ModelFile read = platform::model_of(text, "/nowhere/model.cao");
  (void)read.view().validate().ok();  // looks at all of it
}

[[maybe_unused]] void object_pose(std::span<const uint8_t> bytes) {
  const std::filesystem::path file = file_of(bytes, "object.pos");
  try {
    const SE3 T_co = platform::read_object_pose(file);
    require(T_co.R.allFinite() && T_co.t.allFinite(), "a pose that is no number");
  } catch (const platform::InputError&) {
    const platform::SeenPoints seen = platform::read_seen_points(file);
    require(seen.points_o.size() >= 4 && seen.points_o.size() == seen.px.size(), "fewer points than needed");
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  try {
    PPTAM_READER({data, size});
  } catch (const platform::InputError& error) {
    const std::string said = error.what();
    require(!said.empty() && said.find('\n') == std::string::npos, "not one line");
  }
  return 0;
}
