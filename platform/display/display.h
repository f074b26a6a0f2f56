// Where pictures go: memory, a window, or a screen without a window system.
//
// Displays live in modules of the program that are loaded when one is asked for (module_of_program()), so that it
// starts and tracks on computers without any library for displays: pocket-ptam-display.so draws by EGL and OpenGL
// ES 2.0 off-screen and, by GBM and KMS, full screen; pocket-ptam-window.so has a window of SDL2's. One thread.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "platform/display/scene.h"

namespace pptam::platform {

struct DisplayEvent {
  enum class Kind {
    kKey,     // a character
    kTap,     // by mouse or touch
    kNotice,  // something to tell, one line: the screen was unplugged, is back
    kClosed   // nobody sees it any more: nothing more is drawn, and nothing comes from it
  };
  Kind kind = Kind::kKey;
  char key = 0;
  std::string text;
};

class Display {
 public:
  virtual ~Display() = default;
  virtual std::string describe() const = 0;  // "screen HDMI-A-1, 1920x1080, V3D 4.2"
  // Pixels; a window's may change. At least 1.
  virtual int width() const = 0;
  virtual int height() const = 0;
  // Whether a picture would be shown now: not while the last one waits for the screen, and not without a screen.
  virtual bool ready() = 0;
  // Draws, and shows it where there is something to show it on; does not wait for that. rgba: null, or what was drawn,
  // in rows of width() times 4 bytes from the top. Throws InputError when the driver gives up.
  virtual void draw(const Scene& scene, std::vector<uint8_t>* rgba) = 0;
  // What has happened; false: nothing. Does not wait.
  virtual bool poll(DisplayEvent* event) = 0;
};

// What the modules have, by the C name PPTAM_DISPLAY_ENTRY.
struct DisplayEntry {
  std::unique_ptr<Display> (*offscreen)(int width, int height) = nullptr;
  std::unique_ptr<Display> (*screen)() = nullptr;                       // null: built without it
  std::unique_ptr<Display> (*window)(int width, int height) = nullptr;  // null: not this module's
};

enum class DisplayChoice { kNowhere, kAuto, kWindow, kScreen };

// Both throw InputError of one line when it cannot be: which package is missing, or who has the screen.
std::unique_ptr<Display> open_offscreen(int width, int height);
// kAuto: a window where a window system runs, else the screen. Not of kNowhere.
std::unique_ptr<Display> open_display(DisplayChoice choice, int width, int height);

}  // namespace pptam::platform
