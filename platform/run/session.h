// What every run is made of, be it of a recording or live: its options, a System in its memory with the time that it
// lives in, a frame's line in the log, and what is left at the end.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <pocket_ptam/pocket_ptam.h>
#include "platform/camera.h"
#include "platform/run/clocks.h"
#include "platform/run/run_log.h"
#include "platform/run/trace.h"

namespace pptam::platform {

enum class SystemProfile { kPhone, kTiny, kDesktop };  // Config::phone, Config::tiny, Config::desktop

struct RunOptions {
  SystemProfile profile = SystemProfile::kPhone;
  ClockKind clock = ClockKind::kWork;
  std::function<std::unique_ptr<Clock>()> make_clock;  // another one, in place of `clock`'s; null: none
  // The work clock's phone: its processor (without one the profile's), and what of its time each frame's capture and
  // display take.
  std::optional<PhoneProfile> processor;
  int64_t capture_ns = 0, display_ns = 0;
  bool keep_trace = false;  // RunLog::trace
  double slowdown = 30;     // throttled clock: a desktop core against a 412 MHz ARM1176, roughly
  double max_wait_s = 5;    // for a frame, by the steady clock; longer pauses of a source are cut to it. Not swept
  bool drop_late = true;
  // Seconds after the first frame. Empty: at the first frame, and again whenever initialisation has failed.
  std::vector<double> taps_s;
  bool auto_start = false;    // no taps but those of taps_s: Config::auto_start
  double plane_distance = 0;  // Config::initial_plane_distance
  bool steady_damping = true;
  std::optional<Vector2f> ground;  // System::set_ground() after the first frame with a pose: a pixel of it
  std::string load_map;            // file to begin with; empty: none. The first tap by itself is left out then
  bool lock_map = false;           // System::set_locked
  bool save_map = false;           // into RunLog::saved_map at the end
  int hash_every = 0;              // frames: FrameLog::map_hash; 0: never
  std::optional<int> max_keyframes, max_erased_keyframes;  // Config's own without them
};

// The system in its memory, the time that it lives in, and who listens to what it does.
struct Session {
  std::vector<std::max_align_t> memory;
  int64_t bytes = 0;  // asked for
  MemoryParts parts;  // of these
  System* system = nullptr;
  std::unique_ptr<Clock> clock;
  std::unique_ptr<RunTracer> tracer;
};

// With the map of the options, if they name one. Throws InputError.
Session make_session(const CameraInfo& camera, const RunOptions& options);

FrameLog log_of(const TrackResult& result);

// RunOptions::ground, chosen once, when there is a pose for the first time.
class GroundChoice {
 public:
  using SetGround = std::function<Status(const Vector2f& px, pptam::Similarity* change)>;
  explicit GroundChoice(const std::optional<Vector2f>& px) : px_(px) {}
  bool due(const TrackResult& result) const { return px_ && result.status.ok() && result.pose_valid; }
  // The result's pose follows; no earlier one is in this map.
  void choose(const SetGround& set_ground, TrackResult* result);
  const std::string& trouble() const { return trouble_; }  // why it was not: one line

 private:
  std::optional<Vector2f> px_;
  std::string trouble_;
};

// What is left at the end: the map and what there is to say of it; saved into the log if the options say so.
void take_map(System& system, const RunOptions& options, RunLog* log);

// A saved map, as it is; throws InputError naming the file.
std::vector<std::byte> read_map_file(const std::filesystem::path& file);

}  // namespace pptam::platform
