// Runs a live camera: its newest frame is tracked as soon as it is there, and until the next one comes mapping gets the
// time, in slices. Keys, pose lines and a recording hang on it; nothing is kept of a frame unless it is asked for, so
// that a run may last for months.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <pocket_ptam/pocket_ptam.h>
#include "platform/camera.h"
#include "platform/run/live_recording.h"
#include "platform/run/run.h"
#include "platform/run/summary.h"

namespace pptam::platform {

struct LiveOptions {
  RunOptions run;         // clock, drop_late and max_wait_s do not matter: time is the camera's
  double duration_s = 0;  // ends by itself; 0: never
  double length = 0;      // between the two points that kMark marks, in the image's middle; 0: none is set
  bool keep_frames = false;
  std::string record;  // folder; empty: none
};

// How many poses were how old when their line was written: by the millisecond.
class Ages {
 public:
  void add(int64_t age_ns);
  int64_t count() const { return count_; }
  double at_ms(double share) const;  // that share of them was not older; 0 without any
  double worst_ms() const { return 1e-6 * static_cast<double>(worst_ns_); }
  double last_ms() const { return 1e-6 * static_cast<double>(last_ns_); }

 private:
  std::array<int64_t, 1000> bins_ = {};  // the last one: a second and more
  int64_t count_ = 0, worst_ns_ = 0, last_ns_ = 0;
};

// So far.
struct LiveStatus {
  TrackingState state = TrackingState::kWaiting;
  Hint hint = Hint::kNone;
  bool locked = false;
  bool camera_gone = false;
  int64_t frames = 0;   // tracked
  int64_t poses = 0;    // of these, with a pose
  int64_t refused = 0;  // by the system
  int64_t stale = 0;    // passed over at the start: they came while the system was built
  int keyframes = 0, map_points = 0;
  int recorded = 0;
  std::string record_trouble;
  double seconds = 0;  // from the first frame to the last
  Ages ages;           // of all results
  CameraStatus camera;
};

struct LiveObserver : Spectator {
  // Once the first frame has come and the system is built: outputs may be made.
  StartObserver on_start;
  // At once after a frame was tracked: its line is to be written. False: nobody reads any more, which ends the run.
  std::function<bool(const TrackResult&, int64_t arrived_ns)> on_result;
  FrameObserver on_frame;                            // afterwards, with keep_frames
  std::function<void(const LiveStatus&)> on_status;  // after each frame
};

struct LiveResult {
  RunLog log;  // frames only with keep_frames
  LiveStatus status;
};

// The camera is started and stopped. Throws InputError when there is no first frame, also because it was ended before,
// with nothing done. Signals end it (platform/run/interruption.h) like a key.
LiveResult run_live(Camera& camera, const LiveOptions& options, const LiveObserver& observer);

std::vector<SummaryRow> summarise(const LiveResult& result);

}  // namespace pptam::platform
