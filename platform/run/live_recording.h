// What a live run did, in the order in which it did it, so that it can be repeated anywhere with the same bits: a
// folder in the TUM layout (rgb/*.pgm as tracked, rgb.txt, calibration.yaml) with events.txt beside it:
//
//   pocket-ptam live recording 1
//   name C270 HD WEBCAM
//   camera WIDTH HEIGHT FX FY CX CY DISTORTION C0 C1 C2 C3 C4 rows|columns LINE_TIME EXPOSURE RATE
//   settings AUTO_START PLANE_DISTANCE STEADY_DAMPING MAX_KEYFRAMES MAX_ERASED_KEYFRAMES    -1: the profile's own
//   slices 12                     slices of mapping
//   tap | reset | lock | unlock
//   length POINT_A POINT_B LENGTH
//   load map-0.map                a map file in the folder
//   frame TIMESTAMP_NS IMAGE RESULT_HASH
//   end MAP_HASH
//
// Numbers have as many digits as it takes to read the same bits. A frame's line is written once its image is there, in
// one piece with what came before it: whatever ends the recording, all up to the last whole line can be repeated.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <pocket_ptam/pocket_ptam.h>
#include "platform/camera.h"
#include "platform/files.h"
#include "platform/run/run.h"

namespace pptam::platform {

class LiveRecording {
 public:
  static constexpr const char* kEventsName = "events.txt";

  // Throws InputError unless the folder is new or empty; changes nothing.
  static void check(const std::filesystem::path& folder);
  // What a list of events may be, so that it can be read again.
  static constexpr size_t kMaxEvents = size_t{256} << 20;  // bytes: a day at 30 frames/s has 200 MB
  static constexpr int kMaxCalls = 100'000;                // taps and the like: more than anybody's keys
  static constexpr int kMaxSlices = 10'000'000;            // before one frame; a map that rests takes thousands

  // Checks likewise; what was made is removed where it throws. files: null for the system's own.
  LiveRecording(const std::filesystem::path& folder, const CameraInfo& camera, const RunOptions& options,
                FileOperations* files = nullptr, size_t max_events = kMaxEvents);
  ~LiveRecording();
  LiveRecording(const LiveRecording&) = delete;
  LiveRecording& operator=(const LiveRecording&) = delete;

  // What cannot be written ends the recording, not the run: trouble() says why, and all that follows is left out.
  void note_slice();
  void note(const std::string& call);
  void note_load(std::span<const std::byte> map);
  void note_frame(const Frame& frame, const TrackResult& result);
  void finish(uint64_t map_hash);
  // Before the first frame: removes what was made.
  void discard() noexcept;

  int frames() const { return frames_; }
  const std::string& trouble() const { return trouble_; }

 private:
  void make(const CameraInfo& camera, const RunOptions& options);
  void close_files() noexcept;
  void flush_slices();
  void write_file(const std::filesystem::path& file, std::span<const std::byte> head, std::span<const std::byte> body);
  void append(int fd, const std::string& text, const std::filesystem::path& file);
  void give_up(const std::string& why);

  std::filesystem::path folder_;
  FileOperations system_;
  FileOperations& files_;
  int events_fd_ = -1;
  int list_fd_ = -1;
  size_t max_events_;
  size_t events_bytes_ = 0;                  // written
  std::vector<std::filesystem::path> made_;  // for discard()
  int slices_ = 0;                           // not in pending_ yet
  int slices_before_frame_ = 0;
  int calls_ = 0;
  int maps_ = 0;
  int frames_ = 0;
  std::string pending_;  // lines since the last frame
  std::vector<std::byte> packed_;
  std::string trouble_;
};

// A System each call of which is noted; recording may be null.
class NotedSystem {
 public:
  NotedSystem(System& system, LiveRecording* recording) : system_(system), recording_(recording) {}
  const System& system() const { return system_; }

  TrackResult track(const Frame& frame) { return system_.track(frame); }
  void note_frame(const Frame& frame, const TrackResult& result) {  // after track(), when there is time
    if (recording_ != nullptr) recording_->note_frame(frame, result);
  }
  void work_slice();
  void tap();
  void reset();
  void set_locked(bool locked);
  Status set_length(uint32_t point_a, uint32_t point_b, float length);
  Status set_ground(const Vector2f& px, pptam::Similarity* change);
  Status load_map(std::span<const std::byte> file);

 private:
  System& system_;
  LiveRecording* recording_;
};

// Of all that a frame's result says of state, pose and map.
uint64_t result_hash(const TrackResult& result);

bool is_live_recording(const std::filesystem::path& folder);

// A recording that was read: what to do, in order.
struct LiveScript {
  enum class Kind { kSlices, kTap, kReset, kLock, kUnlock, kLength, kGround, kLoad, kFrame };
  struct Event {
    Kind kind = Kind::kSlices;
    int slices = 0;
    uint32_t point_a = 0, point_b = 0;
    float length = 0;
    Vector2f px = Vector2f::Zero();  // of kGround
    int64_t timestamp_ns = 0;
    uint64_t result = 0;
    std::string file;  // in the folder
  };
  std::filesystem::path folder;
  CameraInfo camera;
  RunOptions settings;  // those that the bits depend on
  std::vector<Event> events;
  std::optional<uint64_t> map_hash;  // none: it was broken off
};

// Throws InputError naming file and line. A last line that is not whole is left out.
LiveScript read_live_recording(const std::filesystem::path& folder);

// Does all of it again. options: the clock that times it, and whether the map is to be saved. RunLog::broken says where
// an image is missing, RunLog::differs where the bits are not those of the live run. Of the spectator's keys only that
// which quits is obeyed (RunLog::quit): the map at the end is not that of the live run then, and is not compared.
RunLog repeat_live_recording(const LiveScript& script, const RunOptions& options, const StartObserver& on_start,
                             const FrameObserver& on_frame, const Spectator& spectator = {});

}  // namespace pptam::platform
