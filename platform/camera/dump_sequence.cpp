#include "platform/camera/dump_sequence.h"

#include <cinttypes>
#include <cstdio>
#include <string>

#include "platform/camera/calibration.h"
#include "platform/camera/image_files.h"
#include "platform/files.h"

namespace pptam::platform {

std::string timestamp_name(int64_t ns) {
  char text[48];
  std::snprintf(text, sizeof text, "%" PRId64 ".%09" PRId64, ns / 1000000000, ns % 1000000000);
  return text;
}

void dump_sequence(Camera& camera, const std::filesystem::path& folder,
                   const std::function<bool(int done, int total)>& go_on) {
  std::error_code error;
  if (std::filesystem::exists(folder, error) &&
      (!std::filesystem::is_directory(folder, error) || !std::filesystem::is_empty(folder, error))) {
    throw InputError(folder.string() + ": exists and is not an empty folder; name a new one");
  }
  make_folder(folder / "rgb");

  std::string list = "# timestamp filename\n";
  Frame frame;
  int done = 0;
  const auto more = [&] { return go_on(done, camera.info().frame_count.value_or(done)); };
  std::string trouble;
  try {
    const bool begun = more();
    write_text_atomically(folder / "calibration.yaml",
                          calibration_yaml({camera.info().model, camera.info().shutter, camera.info().exposure_s}));
    while (begun && camera.read(&frame)) {
      if (frame.format != PixelFormat::kGrey) throw InputError(camera.info().name + ": only grey images can be dumped");
      const std::string stamp = timestamp_name(frame.timestamp_ns);
      const std::string name = "rgb/" + stamp + ".png";
      write_png(folder / name, {frame.data, frame.width, frame.height, frame.stride_bytes});
      list.append(stamp).append(" ").append(name).append("\n");
      ++done;
      if (!more()) break;
    }
  } catch (const InputError& broken) {
    trouble = broken.what();
  }
  write_text_atomically(folder / "rgb.txt", list);
  Trajectory truth = camera.ground_truth();
  if (!truth.empty()) {
    write_tum_trajectory(folder / "groundtruth.txt", truth,
                         "T_world_camera: t tx ty tz qx qy qz qw (camera x right, y down, z forward)");
  }
  if (!trouble.empty()) throw InputError(trouble);
}

}  // namespace pptam::platform
