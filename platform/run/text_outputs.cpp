#include "platform/run/text_outputs.h"

#include <cinttypes>
#include <cstdio>
#include <utility>

#include "platform/outputs.h"
#include "platform/run/names.h"
#include "platform/text.h"

namespace pptam::platform {

std::string ply_text(std::span<const MapPointInfo> points) {
  std::string text = format(
      "ply\nformat ascii 1.0\ncomment map points in world units, z = 0 is the ground\ncomment %s\n"
      "element vertex %zu\n"
      "property float x\nproperty float y\nproperty float z\n"
      "property float nx\nproperty float ny\nproperty float nz\n"
      "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty int measurements\nend_header\n",
      std::string(kOpenSeal).c_str(), points.size());
  for (const MapPointInfo& point : points) {
    const int grey = point.grey;
    text += format("%.7g %.7g %.7g %.4f %.4f %.4f %d %d %d %d\n", point.p_w.x(), point.p_w.y(), point.p_w.z(),
                   point.normal_w.x(), point.normal_w.y(), point.normal_w.z(), grey, grey, grey, point.measurements);
  }
  return sealed(std::move(text));
}

std::string frames_text(const RunLog& log) {
  std::string out =
      "frame,timestamp,state,quality,hint,progress,attempted,found,inliers,partial_attempted,partial_found,"
      "map,maps,keyframes,erased_keyframes,"
      "map_points,blurred,misfit,keyframe_added,limits,instructions";
  for (int s = 0; s < kStages; ++s) out.append(",").append(name_of(static_cast<Stage>(s))).append("_us");
  out += ",track_us,late_us,capture_us,display_us,mapping_us,idle_slices,longest_slice_us";
  for (int job = 0; job < kJobs; ++job) out.append(",").append(name_of(span_of_job(job))).append("_us");
  out += ",idle_us,work_left\n";
  char line[512];
  for (const FrameLog& f : log.frames) {
    std::snprintf(line, sizeof line, "%d,%.6f,%s,%s,%s,%.3f,%d,%d,%d,%d,%d,%d,%d,%d,%d,%d,%d,%d,%d,", f.index,
                  1e-9 * static_cast<double>(f.timestamp_ns), name_of(f.state), name_of(f.quality), name_of(f.hint),
                  static_cast<double>(f.progress), f.points_attempted, f.points_found, f.points_inliers,
                  f.partial_attempted, f.partial_found, f.map, f.maps, f.keyframes, f.erased_keyframes, f.map_points,
                  f.blurred ? 1 : 0, f.misfit ? 1 : 0, f.keyframe_added ? 1 : 0);
    out += line + limit_names(f.limits_hit) + format(",%" PRId64, f.instructions);
    for (const int64_t ns : f.stage_ns) out += format(",%" PRId64, ns / 1000);
    for (const int64_t ns : {f.track_ns, f.late_ns, f.capture_ns, f.display_ns, f.mapping_ns})
      out += format(",%" PRId64, ns / 1000);
    out += format(",%d,%" PRId64, f.idle_slices, f.longest_slice_ns / 1000);
    for (const int64_t ns : f.job_ns) out += format(",%" PRId64, ns / 1000);
    out += format(",%" PRId64 ",%d\n", f.idle_ns / 1000, f.work_left ? 1 : 0);
  }
  return out;
}

}  // namespace pptam::platform
