#include "platform/run/spectator.h"

#include <vector>

namespace pptam::platform {
namespace {

// What became of it, one line; empty: who takes the map says it.
std::string save_by_key(const System& system, const Spectator& spectator) {
  if (!spectator.on_save) return "nothing is saved: no file was named by --save-map";
  if (system.map_bytes() == 0) return "nothing is saved: there is no map yet";
  std::vector<std::byte> map(system.map_bytes());
  size_t bytes = 0;
  const Status status = system.save_map(map, &bytes);
  if (!status.ok()) return std::string("nothing is saved: ") + status.message();
  spectator.on_save(std::span(map).first(bytes));
  return "";
}

}  // namespace

bool press(RunKey key, const System& system, const SystemCalls& calls, const Spectator& spectator) {
  std::string text;
  switch (key) {
    case RunKey::kNothing:
      return true;
    case RunKey::kTap:
      calls.tap();
      text = "tap: the next frame is the first view; move sideways";
      break;
    case RunKey::kReset:
      calls.reset();
      text = "reset: everything is forgotten";
      break;
    case RunKey::kLock:
      calls.set_locked(!system.locked());
      text = system.locked() ? "the map is locked" : "the map is unlocked";
      break;
    case RunKey::kMark:  // a live run takes it itself
      text = "nothing is marked: marks give a live run its length (--length)";
      break;
    case RunKey::kGround: {
      const CameraModel& model = system.config().camera.model;
      const Status status =
          calls.set_ground(0.5f * Vector2f(static_cast<float>(model.width - 1), static_cast<float>(model.height - 1)));
      text = status.ok() ? "the ground is what the middle of the image shows"
                         : std::string("the ground stays: ") + status.message();
      break;
    }
    case RunKey::kSave:
      text = save_by_key(system, spectator);
      break;
    case RunKey::kQuit:
      return false;
  }
  if (spectator.say && !text.empty()) spectator.say(text);
  return true;
}

}  // namespace pptam::platform
