// What happened in a run: a line for each frame, and the map at the end.
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <pocket_ptam/inspection.h>
#include "platform/camera.h"
#include "platform/run/clocks.h"
#include "platform/run/trace_event.h"
#include "platform/trajectory.h"

namespace pptam::platform {

// One line of frames.csv: all that track() returned for a frame and what the call cost, hence so many members.
struct FrameLog {
  int index = 0;  // in the source, counted from 0; gaps are dropped frames
  int64_t timestamp_ns = 0;
  TrackingState state = TrackingState::kWaiting;
  TrackingQuality quality = TrackingQuality::kBad;
  Hint hint = Hint::kNone;
  float progress = 0;
  uint32_t limits_hit = 0;
  bool pose_valid = false;
  bool blurred = false;
  bool misfit = false;
  bool keyframe_added = false;
  Eigen::Isometry3d T_wc = Eigen::Isometry3d::Identity();
  double position_sigma = 0;  // reported: rms error of the camera centre, world units
  double rotation_sigma = 0;  // and of the orientation, radians
  int points_attempted = 0, points_found = 0, points_inliers = 0;
  float reprojection_px = 0;  // rms of the inliers
  int partial_attempted = 0, partial_found = 0;
  int map = 0, maps = 0;  // TrackResult's
  int keyframes = 0, erased_keyframes = 0, map_points = 0;
  int64_t stage_ns[kStages] = {};
  int64_t track_ns = 0;                    // the whole call of track()
  int64_t late_ns = 0;                     // from the frame's arrival to its result
  int64_t capture_ns = 0, display_ns = 0;  // what the phone's camera and display took (RunOptions)
  // Before this frame: slices of mapping, their number, the longest one and what they worked on; and idle time.
  int64_t mapping_ns = 0;
  int idle_slices = 0;
  int64_t longest_slice_ns = 0;
  int64_t job_ns[kJobs] = {};
  int64_t idle_ns = 0;
  bool work_left = false;    // mapping had not finished when the frame came
  int64_t instructions = 0;  // modelled, of track()
  uint64_t map_hash = 0;     // of every RunOptions::hash_every-th frame of the source
};

struct RunLog {
  CameraInfo camera;
  ClockKind clock = ClockKind::kWork;
  std::vector<FrameLog> frames;
  int dropped = 0;
  int source_frames = 0;                 // read, dropped ones included
  std::vector<int> kept_maps;            // at the end
  std::vector<KeyframeInfo> keyframes;   // of main_map()
  std::vector<MapPointInfo> map_points;  // likewise
  std::vector<PlaneInfo> planes;         // likewise: its grounds to choose from
  uint64_t map_hash = 0;                 // of the map in use at the end
  MapFit map_fit;
  int map_parts = 0;  // System::map_parts(kHoldingPoints): 1 for a sound map, 0 without one
  int64_t memory_bytes = 0;
  MemoryParts memory_parts;           // of these, as asked for
  std::vector<TraceEvent> trace;      // in the order in which they began; if RunOptions ask for it
  std::vector<std::byte> saved_map;   // if RunOptions ask for it
  std::string save_trouble;           // why it is empty although they do
  bool quit = false;                  // by a key, before the source's end
  std::string broken;                 // what stopped the source midway; empty: it ran to its end
  std::string differs;                // where a live recording's repetition has other bits; empty: nowhere
  std::vector<std::string> warnings;  // one line each: the camera's remarks, pauses that were cut

  // Moves the poses in the last frame's map into coordinates that have changed since (System::set_ground).
  void move_poses(const pptam::Similarity& change);

  // Which map most poses belong to (TrackResult::map), of those that are left at the end if poses belong to any; 0
  // without a pose. Each map has a world of its own.
  int main_map() const;
  Trajectory trajectory() const;  // the frames with a pose in main_map(), camera-to-world
  Trajectory trajectory_in(int map) const;
  std::vector<int> maps() const;               // that poses belong to, rising
  Trajectory keyframe_trajectory() const;      // in the order of time
  const FrameLog* first_tracked() const;       // null: never initialised
  double seconds(int64_t timestamp_ns) const;  // since the first frame
  double reprojection_px() const;              // rms over the inliers of the frames with a pose; 0 without one
  double tracked_fraction() const;             // of the frames from the first tracked one on; 0 without one
};

// Parts of a map that share fewer points between keyframes are taken to have come apart: three points give a camera's
// pose, one more makes it unique.
constexpr int kHoldingPoints = 4;

// T_wc of a pose as the core gives it.
Eigen::Isometry3d camera_to_world(const SE3& T_cw);

struct CostSummary {  // of the frames tracked with a map
  double mean_ms = 0, worst_ms = 0;
  double stage_ms[kStages] = {};  // mean
  double mean_minstructions = 0;  // millions
};
CostSummary cost_of(const RunLog& log);

// Where the processor's time went, from the first frame to the last.
struct ProcessorTime {
  int64_t tracking_ns = 0, capture_display_ns = 0, mapping_ns = 0, idle_ns = 0;
  int64_t longest_slice_ns = 0;
  int frames = 0;
  int late = 0;       // frames whose result came after the next frame
  int work_left = 0;  // frames that came before mapping was done

  void add(const RunLog& log);
  int64_t all_ns() const {
    return saturated_sum(saturated_sum(tracking_ns, capture_display_ns), saturated_sum(mapping_ns, idle_ns));
  }
  double share(int64_t ns) const { return all_ns() > 0 ? static_cast<double>(ns) / static_cast<double>(all_ns()) : 0; }
  double work_left_share() const { return frames > 0 ? static_cast<double>(work_left) / frames : 0; }
};
// Whether the result came after the next frame.
bool is_late(const FrameLog& frame, const CameraInfo& camera);
// Share of the time that frames must leave to mapping, or it starves. The 412 MHz phone has 27 million instructions in
// a tenth of a second, and a new keyframe in a map of usual size takes a few hundred million until all is adjusted. Not
// swept.
constexpr double kLeastForMapping = 0.1;

}  // namespace pptam::platform
