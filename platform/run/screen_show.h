// A run on a display: each frame's picture as it comes, keys and taps from there, pictures of it as files.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "platform/display/display.h"
#include "platform/run/composer.h"
#include "platform/run/keys.h"
#include "platform/run/spectator.h"

namespace pptam::platform {

struct ShowOptions {
  DisplayChoice where = DisplayChoice::kNowhere;
  int turn_degrees = 0;  // clockwise, for a screen that is mounted sideways
  bool predict = false;  // the pose for the time at which the picture is seen; the frame's times are CLOCK_MONOTONIC
  bool paced = false;    // of what is faster than it was: waits until each frame is due
};

class ScreenShow {
 public:
  // Opens the display. Throws InputError. say: lines for the terminal; they are shown on the display, too. source:
  // asked for the colours of its frames; null: pictures are as what is tracked, grey.
  ScreenShow(const ShowOptions& options, const CameraInfo& camera, std::function<void(const std::string&)> say,
             const Camera* source = nullptr);
  ~ScreenShow();
  ScreenShow(const ScreenShow&) = delete;
  ScreenShow& operator=(const ScreenShow&) = delete;

  // Keys of the terminal, beside those of the display.
  void listen_to(Keys* keys) { typed_ = keys; }
  // Of keys that this class does not answer itself: those of the run. A tap by hand starts a map, but does not end one.
  // Asked often, it also draws anew what has been standing for long: another size, or something to say.
  RunKey key();
  void show(const Frame& frame, const TrackResult& result, const FrameLog& log, const System& system);
  void say(const std::string& text);

 private:
  // The last frame and what was found in it.
  struct Shown {
    Picture picture;  // its pixels are null once they may be gone
    TrackResult result;
    std::vector<ObservedPoint> points;
    FrameLog log;
    const System* system;
  };

  void answer_all();
  void answer(const DisplayEvent& event);
  void press(char character);
  bool quit_waits() const;
  void wait_until_due(int64_t timestamp_ns);
  Canvas canvas() const;
  const Scene& compose();
  bool due();
  void draw();
  void store_picture(int width, int height);
  bool storing() const { return storing_.joinable(); }
  std::string wait_until_stored();
  void leave(const std::string& why);

  ShowOptions options_;
  std::function<void(const std::string&)> say_;
  const Camera* source_;
  Keys* typed_ = nullptr;
  Composer composer_;
  std::unique_ptr<Display> display_;  // null: closed, the run goes on
  std::vector<RunKey> keys_;          // not asked for yet, the oldest first
  bool from_above_ = false;
  bool picture_wanted_ = false;
  bool has_map_ = false;
  std::optional<Shown> last_;
  std::string notice_;
  int64_t notice_until_ns_ = 0;       // by CLOCK_MONOTONIC
  int64_t rest_until_ns_ = 0;         // likewise: no picture before, so that drawing takes half of the time at most
  int64_t drawn_ns_ = 0;              // likewise, the last picture
  std::optional<int64_t> origin_ns_;  // CLOCK_MONOTONIC less timestamp, when paced
  std::vector<uint8_t> pixels_;
  // Stores a picture; no std::future, which Debian's libstdc++ for armel lacks.
  std::thread storing_;
  std::atomic<bool> stored_ = false;  // by now, or not: stored_text_ says it
  std::string stored_text_;
  std::vector<MapPointInfo> points_;
  std::vector<KeyframeInfo> keyframes_;
};

// "t" and so on, of the terminal or a display.
RunKey run_key_of(char character);

// The display and the terminal's keys as one. Both live as long.
Spectator spectator_of(ScreenShow* show, Keys* keys);

}  // namespace pptam::platform
