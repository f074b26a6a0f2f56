// Runs one sequence: frames from a Camera, in time, into a System; everything that happened goes into a RunLog.
//
// A frame arrives at its timestamp on the chosen clock. The time before it belongs to mapping, in slices. When tracking
// was so slow that the next frame has arrived already, the older one is dropped, as a camera does.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "platform/camera.h"
#include "platform/trajectory.h"
#include "pocket_ptam.h"

namespace pptam::app {

enum class ClockKind {
  kWork,      // modelled time of the work charged: repeatable bit for bit
  kSteady,    // real time
  kThrottled  // CPU time times RunOptions::slowdown
};

struct RunOptions {
  ClockKind clock = ClockKind::kWork;
  double slowdown = 30;  // throttled clock: a desktop core against a 412 MHz ARM1176, roughly
  bool drop_late = true;
  // Seconds after the first frame. Empty: at the first frame, and again whenever initialisation has failed.
  std::vector<double> taps_s;
  bool auto_start = false;    // no taps but those of taps_s: Config::auto_start
  double plane_distance = 0;  // Config::initial_plane_distance
  bool steady_damping = true;
  std::string load_map;   // file to begin with; empty: none. The first tap by itself is left out then
  bool lock_map = false;  // System::set_locked
  bool save_map = false;  // into RunLog::saved_map at the end
  int hash_every = 0;     // frames: FrameLog::map_hash; 0: never
  std::optional<int> max_keyframes, max_erased_keyframes;  // Config's own without them
};

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
  bool keyframe_added = false;
  Eigen::Isometry3d T_wc = Eigen::Isometry3d::Identity();
  double position_sigma = 0;  // reported: rms error of the camera centre, world units
  double rotation_sigma = 0;  // and of the orientation, radians
  int points_attempted = 0, points_found = 0, points_inliers = 0;
  float reprojection_px = 0;  // rms of the inliers
  int partial_attempted = 0, partial_found = 0;
  int keyframes = 0, erased_keyframes = 0, map_points = 0;
  int64_t stage_ns[kStages] = {};
  int64_t track_ns = 0;      // the whole call of track()
  int64_t late_ns = 0;       // from the frame's arrival to its result
  int64_t mapping_ns = 0;    // slices given before this frame
  int idle_slices = 0;       // their number
  int64_t instructions = 0;  // modelled, of track()
  uint64_t map_hash = 0;     // of every RunOptions::hash_every-th frame of the source
};

struct RunLog {
  platform::CameraInfo camera;
  ClockKind clock = ClockKind::kWork;
  std::vector<FrameLog> frames;
  int dropped = 0;
  int source_frames = 0;  // read, dropped ones included
  std::vector<KeyframeInfo> keyframes;
  std::vector<MapPointInfo> map_points;
  uint64_t map_hash = 0;
  MapFit map_fit;
  int map_parts = 0;  // System::map_parts(kHoldingPoints): 1 for a sound map, 0 without one
  int64_t memory_bytes = 0;
  std::vector<std::byte> saved_map;  // if RunOptions ask for it
  std::string save_trouble;          // why it is empty although they do
  std::string broken;                // what stopped the source midway; empty: it ran to its end

  platform::Trajectory trajectory() const;           // the frames with a pose, camera-to-world
  platform::Trajectory keyframe_trajectory() const;  // in the order of time
  const FrameLog* first_tracked() const;             // null: never initialised
  double seconds(int64_t timestamp_ns) const;        // since the first frame
  double reprojection_px() const;                    // rms over the inliers of the frames with a pose; 0 without one
  double tracked_fraction() const;                   // of the frames from the first tracked one on; 0 without one
};

// Parts of a map that share fewer points between keyframes are taken to have come apart: three points give a camera's
// pose, one more makes it unique.
constexpr int kHoldingPoints = 4;

struct CostSummary {  // of the frames tracked with a map
  double mean_ms = 0, worst_ms = 0;
  double mean_minstructions = 0;  // millions
};
CostSummary cost_of(const RunLog& log);

// Called after each tracked frame, while its pixels and the result's points are valid.
using FrameObserver = std::function<void(const Frame&, const TrackResult&, const RunLog&)>;
// Called once, after the first frame was read and the system was built: everything that can be wrong with the input has
// been checked, outputs may be created now.
using StartObserver = std::function<void(const platform::CameraInfo&)>;

// Throws platform::InputError when nothing could be tracked (no first frame, a calibration that the system refuses); a
// source that breaks later ends the run and leaves its reason in RunLog::broken.
RunLog run_sequence(platform::Camera& camera, const RunOptions& options, const StartObserver& on_start,
                    const FrameObserver& on_frame);

const char* name_of(TrackingState state);
const char* name_of(TrackingQuality quality);
const char* name_of(Hint hint);
const char* name_of(Stage stage);
const char* name_of(ClockKind clock);
const char* sentence_for(Hint hint);           // what the user should do; "" for none
std::string limit_names(uint32_t limits_hit);  // Config fields joined by '|'; "" for none

// trajectory.txt, keyframes.txt, map.ply and frames.csv. Throws InputError when one cannot be written.
void write_text_outputs(const RunLog& log, const std::filesystem::path& folder);

}  // namespace pptam::app
