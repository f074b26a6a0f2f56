#include "platform/run/run_log.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

namespace pptam::platform {

Eigen::Isometry3d camera_to_world(const SE3& T_cw) {
  Eigen::Isometry3d T_wc = Eigen::Isometry3d::Identity();
  T_wc.linear() = T_cw.R.transpose().cast<double>();
  T_wc.translation() = T_cw.centre().cast<double>();
  return T_wc;
}

std::vector<int> RunLog::maps() const {
  std::set<int> maps;
  for (const FrameLog& frame : frames) {
    if (frame.pose_valid) maps.insert(frame.map);
  }
  return {maps.begin(), maps.end()};
}

void RunLog::move_poses(const pptam::Similarity& change) {
  if (frames.empty()) return;
  const int map = frames.back().map;
  Eigen::Isometry3d T_new_old = Eigen::Isometry3d::Identity();
  T_new_old.linear() = change.T.R.cast<double>();
  T_new_old.translation() = change.T.t.cast<double>();
  const double scale = static_cast<double>(change.scale);
  for (FrameLog& frame : frames) {
    if (!frame.pose_valid || frame.map != map) continue;
    frame.T_wc = T_new_old * frame.T_wc;
    frame.T_wc.translation() *= scale;
    frame.position_sigma *= scale;
  }
}

int RunLog::main_map() const {
  std::map<int, int> poses;
  for (const FrameLog& frame : frames) poses[frame.map] += frame.pose_valid ? 1 : 0;
  int main = 0, most = 0;
  bool main_kept = false;
  for (const auto& [map, count] : poses) {
    const bool kept = std::find(kept_maps.begin(), kept_maps.end(), map) != kept_maps.end();
    if (count == 0 || (main_kept && !kept) || (main_kept == kept && count <= most)) continue;
    main = map;
    most = count;
    main_kept = kept;
  }
  return main;
}

Trajectory RunLog::trajectory() const {
  return trajectory_in(main_map());
}

Trajectory RunLog::trajectory_in(int map) const {
  Trajectory trajectory;
  for (const FrameLog& frame : frames) {
    if (frame.pose_valid && frame.map == map) trajectory.push_back({frame.timestamp_ns, frame.T_wc});
  }
  return trajectory;
}

Trajectory RunLog::keyframe_trajectory() const {
  Trajectory trajectory;
  for (const KeyframeInfo& keyframe : keyframes) {
    trajectory.push_back({keyframe.timestamp_ns, camera_to_world(keyframe.T_cw)});
  }
  std::stable_sort(trajectory.begin(), trajectory.end(),
                   [](const StampedPose& a, const StampedPose& b) { return a.timestamp_ns < b.timestamp_ns; });
  return trajectory;
}

const FrameLog* RunLog::first_tracked() const {
  for (const FrameLog& frame : frames) {
    if (frame.pose_valid) return &frame;
  }
  return nullptr;
}

double RunLog::seconds(int64_t timestamp_ns) const {
  return frames.empty() ? 0
                        : 1e-9 * static_cast<double>(saturated_difference(timestamp_ns, frames.front().timestamp_ns));
}

double RunLog::reprojection_px() const {
  double sum = 0;
  int inliers = 0;
  for (const FrameLog& frame : frames) {
    if (!frame.pose_valid) continue;
    const double error_px = static_cast<double>(frame.reprojection_px);
    sum += frame.points_inliers * error_px * error_px;
    inliers += frame.points_inliers;
  }
  return inliers > 0 ? std::sqrt(sum / inliers) : 0;
}

double RunLog::tracked_fraction() const {
  int after = 0;
  int tracked = 0;
  for (const FrameLog& frame : frames) {
    if (frame.pose_valid) ++tracked;
    if (tracked > 0) ++after;
  }
  return after > 0 ? static_cast<double>(tracked) / after : 0;
}

CostSummary cost_of(const RunLog& log) {
  CostSummary cost;
  int count = 0;
  for (const FrameLog& frame : log.frames) {
    if (frame.state != TrackingState::kTracking) continue;
    const double ms = 1e-6 * static_cast<double>(frame.track_ns);
    cost.mean_ms += ms;
    cost.worst_ms = std::max(cost.worst_ms, ms);
    cost.mean_minstructions += 1e-6 * static_cast<double>(frame.instructions);
    for (int s = 0; s < kStages; ++s) cost.stage_ms[s] += 1e-6 * static_cast<double>(frame.stage_ns[s]);
    ++count;
  }
  if (count > 0) {
    cost.mean_ms /= count;
    cost.mean_minstructions /= count;
    for (double& ms : cost.stage_ms) ms /= count;
  }
  return cost;
}

bool is_late(const FrameLog& frame, const CameraInfo& camera) {
  return camera.frames_per_s > 0 && 1e-9 * static_cast<double>(frame.late_ns) > 1 / camera.frames_per_s;
}

void ProcessorTime::add(const RunLog& log) {
  for (const FrameLog& frame : log.frames) {
    tracking_ns = saturated_sum(tracking_ns, frame.track_ns);
    capture_display_ns = saturated_sum(capture_display_ns, saturated_sum(frame.capture_ns, frame.display_ns));
    mapping_ns = saturated_sum(mapping_ns, frame.mapping_ns);
    idle_ns = saturated_sum(idle_ns, frame.idle_ns);
    longest_slice_ns = std::max(longest_slice_ns, frame.longest_slice_ns);
    ++frames;
    late += is_late(frame, log.camera) ? 1 : 0;
    work_left += frame.work_left ? 1 : 0;
  }
}

}  // namespace pptam::platform
