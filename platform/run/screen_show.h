// A run on a display: each frame's picture as it comes, keys and taps from there, pictures of it as files.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "platform/display/display.h"
#include "platform/run/composer.h"
#include "platform/run/keys.h"
#include "platform/run/spectator.h"

namespace pptam::platform {

struct ShowOptions {
  DisplayChoice where = DisplayChoice::kNone;
  int turn_degrees = 0;  // clockwise, for a screen that is mounted sideways
  bool predict = false;  // the pose for the time at which the picture is seen; the frame's times are CLOCK_MONOTONIC
  bool paced = false;    // of what is faster than it was: waits until each frame is due
};

class ScreenShow {
 public:
  // Opens the display. Throws InputError. say: lines for the terminal; they are shown on the display, too.
  ScreenShow(const ShowOptions& options, const CameraInfo& camera, std::function<void(const std::string&)> say);

  // A key of the terminal's; the display's own are asked for by key().
  void press(char character);
  // Of keys that this class does not answer itself: those of the run. A tap by hand starts a map, but does not end one.
  RunKey key();
  void show(const Frame& frame, const TrackResult& result, const FrameLog& log, const System& system);
  void say(const std::string& text);

  std::string describe() const { return display_ ? display_->describe() : "no display"; }

 private:
  void answer_all();
  void answer(const DisplayEvent& event);
  void wait_until_due(int64_t timestamp_ns);
  Canvas canvas() const;
  const Scene& compose(const Frame& frame, const TrackResult& result, const FrameLog& log, const System& system);
  void store_picture(const std::vector<uint8_t>& rgba, int width, int height);
  void leave(const std::string& why);

  ShowOptions options_;
  std::function<void(const std::string&)> say_;
  Composer composer_;
  std::unique_ptr<Display> display_;  // null: closed, the run goes on
  std::vector<RunKey> keys_;          // not asked for yet, the oldest first
  bool from_above_ = false;
  bool picture_wanted_ = false;
  bool has_map_ = false;
  std::string notice_;
  int64_t notice_until_ns_ = 0;       // by CLOCK_MONOTONIC
  int64_t rest_until_ns_ = 0;         // likewise: no picture before, so that drawing takes half of the time at most
  std::optional<int64_t> origin_ns_;  // CLOCK_MONOTONIC less timestamp, when paced
  std::vector<uint8_t> pixels_;
  std::vector<MapPointInfo> points_;
  std::vector<KeyframeInfo> keyframes_;
};

// "t" and so on, of the terminal or a display.
RunKey run_key_of(char character);

// The display and the terminal's keys as one. Both live as long.
Spectator spectator_of(ScreenShow* show, Keys* keys);

}  // namespace pptam::platform
