// Runs one sequence: frames from a Camera, in time, into a System; everything that happened goes into a RunLog.
//
// A frame arrives at its timestamp on the chosen clock. The time before it belongs to mapping, in slices. When tracking
// was so slow that the next frame has arrived already, the older one is dropped, as a camera does.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <pocket_ptam/pocket_ptam.h>
#include "platform/camera.h"
#include "platform/run/clocks.h"
#include "platform/run/run_log.h"

namespace pptam::platform {

struct RunOptions {
  ClockKind clock = ClockKind::kWork;
  double slowdown = 30;   // throttled clock: a desktop core against a 412 MHz ARM1176, roughly
  double max_wait_s = 5;  // for a frame, by the steady clock; longer pauses of a source are cut to it. Not swept
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

// Called after each tracked frame, while its pixels and the result's points are valid.
using FrameObserver = std::function<void(const Frame&, const TrackResult&, const RunLog&)>;
// Called once, after the first frame was read and the system was built: everything that can be wrong with the input has
// been checked, outputs may be created now.
using StartObserver = std::function<void(const CameraInfo&)>;

// A saved map, as it is; throws InputError naming the file.
std::vector<std::byte> read_map_file(const std::filesystem::path& file);

// Throws InputError when nothing could be tracked (no first frame, a calibration that the system refuses); a
// source that breaks later ends the run and leaves its reason in RunLog::broken, and so does a signal
// (platform/run/interruption.h) after the frame that it meets.
RunLog run_sequence(Camera& camera, const RunOptions& options, const StartObserver& on_start,
                    const FrameObserver& on_frame);

}  // namespace pptam::platform
