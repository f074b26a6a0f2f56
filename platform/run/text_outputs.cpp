#include "platform/run/text_outputs.h"

#include <cstdio>
#include <fstream>

#include "platform/files.h"
#include "platform/input_error.h"
#include "platform/run/names.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

std::ofstream open_for_writing(const std::filesystem::path& file) {
  std::ofstream stream(file, std::ios::binary);
  if (!stream) throw InputError(file.string() + ": cannot be written");
  return stream;
}

void close_checked(std::ofstream& stream, const std::filesystem::path& file) {
  stream.close();
  if (!stream) throw InputError(file.string() + ": cannot be written, is the disk full?");
}

void write_frames(const RunLog& log, const std::filesystem::path& file) {
  std::ofstream out = open_for_writing(file);
  out << "frame,timestamp,state,quality,hint,progress,attempted,found,inliers,partial_attempted,partial_found,"
         "keyframes,erased_keyframes,"
         "map_points,blurred,keyframe_added,limits,instructions";
  for (int s = 0; s < kStages; ++s) out << ',' << name_of(static_cast<Stage>(s)) << "_us";
  out << ",track_us,late_us,mapping_us,idle_slices\n";
  char line[512];
  for (const FrameLog& f : log.frames) {
    std::snprintf(line, sizeof line, "%d,%.6f,%s,%s,%s,%.3f,%d,%d,%d,%d,%d,%d,%d,%d,%d,%d,", f.index,
                  1e-9 * static_cast<double>(f.timestamp_ns), name_of(f.state), name_of(f.quality), name_of(f.hint),
                  static_cast<double>(f.progress), f.points_attempted, f.points_found, f.points_inliers,
                  f.partial_attempted, f.partial_found, f.keyframes, f.erased_keyframes, f.map_points,
                  f.blurred ? 1 : 0, f.keyframe_added ? 1 : 0);
    out << line << limit_names(f.limits_hit) << ',' << f.instructions;
    for (const int64_t ns : f.stage_ns) out << ',' << ns / 1000;
    out << ',' << f.track_ns / 1000 << ',' << f.late_ns / 1000 << ',' << f.mapping_ns / 1000 << ',' << f.idle_slices
        << '\n';
  }
  close_checked(out, file);
}

}  // namespace

void write_ply(const std::filesystem::path& file, std::span<const MapPointInfo> points) {
  std::string text = format(
      "ply\nformat ascii 1.0\ncomment map points in world units, z = 0 is the dominant plane\nelement vertex %zu\n"
      "property float x\nproperty float y\nproperty float z\n"
      "property float nx\nproperty float ny\nproperty float nz\n"
      "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty int measurements\nend_header\n",
      points.size());
  for (const MapPointInfo& point : points) {
    const int grey = point.grey;
    text += format("%.7g %.7g %.7g %.4f %.4f %.4f %d %d %d %d\n", point.p_w.x(), point.p_w.y(), point.p_w.z(),
                   point.normal_w.x(), point.normal_w.y(), point.normal_w.z(), grey, grey, grey, point.measurements);
  }
  write_text_atomically(file, text);
}

void write_text_outputs(const RunLog& log, const std::filesystem::path& folder) {
  write_tum_trajectory(folder / "trajectory.txt", log.trajectory(),
                       "timestamp tx ty tz qx qy qz qw, camera-to-world, world units");
  write_tum_trajectory(folder / "keyframes.txt", log.keyframe_trajectory(),
                       "timestamp tx ty tz qx qy qz qw, camera-to-world, world units");
  write_ply(folder / "map.ply", log.map_points);
  write_frames(log, folder / "frames.csv");
}

}  // namespace pptam::platform
