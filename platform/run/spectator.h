// Who watches a run as it goes, and presses keys: a screen, a terminal, or a test.
#pragma once

#include <cstddef>
#include <functional>
#include <span>
#include <string>

#include <pocket_ptam/pocket_ptam.h>
#include "platform/run/run_log.h"

namespace pptam::platform {

enum class RunKey { kNothing, kTap, kReset, kLock, kMark, kGround, kSave, kQuit };

// Each function may be empty.
struct Spectator {
  std::function<RunKey()> key;                              // asked between slices and frames; does not wait
  std::function<void(const std::string&)> say;              // an event, one line
  std::function<void(std::span<const std::byte>)> on_save;  // the map, as a file's content
  // After each tracked frame, while its pixels and the result's points are valid.
  std::function<void(const Frame&, const TrackResult&, const FrameLog&, const System&)> show;
};

// What a key does to a system: its own functions, or those of who notes each call.
struct SystemCalls {
  std::function<void()> tap, reset;
  std::function<void(bool)> set_locked;
  std::function<Status(const Vector2f&)> set_ground;
};

// Does what the key asks for and says so. False: the run is to end.
bool press(RunKey key, const System& system, const SystemCalls& calls, const Spectator& spectator);

}  // namespace pptam::platform
