// pocket-ptam-window.so: a window of X11 or Wayland. SDL2 owns it and its input; the context is EGL's.
#include <GLES2/gl2.h>
#include <SDL.h>

#include <algorithm>
#include <memory>
#include <string>
#include <utility>

#include "platform/display/display.h"
#include "platform/display/egl.h"
#include "platform/display/renderer.h"
#include "platform/display/x11_errors.h"
#include "platform/input_error.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

InputError no_window(const char* what) {
  return InputError(std::string("a window: ") + what + ": " + SDL_GetError() +
                    " (without a window system: --show=screen)");
}

// Those that are said to run: asked for others, or for none, SDL tries screens, and libraries complain on standard
// error.
std::string window_systems() {
  std::string systems;
  for (const auto& [variable, name] : {std::pair("DISPLAY", "x11"), {"WAYLAND_DISPLAY", "wayland"}}) {
    const char* value = SDL_getenv(variable);
    if (value != nullptr && *value != 0) systems += (systems.empty() ? "" : ",") + std::string(name);
  }
  if (systems.empty())
    throw InputError(
        "a window: there is no window system here, neither DISPLAY nor WAYLAND_DISPLAY is set: use --show=screen");
  return systems;
}

class WindowDisplay : public Display {
 public:
  WindowDisplay(int width, int height) {
    SDL_SetHint(SDL_HINT_NO_SIGNAL_HANDLERS, "1");  // they are the program's
    SDL_SetHint(SDL_HINT_VIDEODRIVER, window_systems().c_str());
    SDL_SetHint(SDL_HINT_VIDEO_X11_FORCE_EGL, "1");       // not GLX
    SDL_SetHint(SDL_HINT_TOUCH_MOUSE_EVENTS, "0");        // a touch is one tap
    SDL_SetHint(SDL_HINT_MOUSE_FOCUS_CLICKTHROUGH, "1");  // the first one, too
    SDL_SetHint(SDL_HINT_VIDEO_ALLOW_SCREENSAVER, "0");   // the hands are at the camera
    if (SDL_InitSubSystem(SDL_INIT_VIDEO) != 0) throw no_window("there is no window system");
    try {
      open(width, height);
    } catch (...) {
      close();
      throw;
    }
  }
  ~WindowDisplay() override { close(); }
  WindowDisplay(const WindowDisplay&) = delete;
  WindowDisplay& operator=(const WindowDisplay&) = delete;

  std::string describe() const override {
    return format("window of %s, %dx%d, %s", SDL_GetCurrentVideoDriver(), width(), height(), driver_.c_str());
  }
  int width() const override { return size().first; }
  int height() const override { return size().second; }
  bool ready() override {
    return !closed_ && !x11_failed() && (SDL_GetWindowFlags(window_) & SDL_WINDOW_MINIMIZED) == 0;
  }

  void draw(const Scene& scene, std::vector<uint8_t>* rgba) override {
    if (SDL_GL_MakeCurrent(window_, context_) != 0) throw no_window("its picture is gone");
    renderer_->draw(scene, false);
    if (rgba != nullptr) read_pixels(width(), height(), true, rgba);
    Renderer::check();
    SDL_GL_SwapWindow(window_);
    SDL_GL_MakeCurrent(window_, nullptr);  // SDL does not see when another display's context becomes current
  }

  bool poll(DisplayEvent* event) override {
    if (x11_failed() && !closed_) {
      closed_ = true;
      *event = {DisplayEvent::Kind::kClosed, 0, "the window is gone"};
      return true;
    }
    SDL_Event happened;
    while (!closed_ && SDL_PollEvent(&happened) != 0) {
      switch (happened.type) {
        case SDL_KEYDOWN: {
          const SDL_Keycode key = happened.key.keysym.sym;
          if (happened.key.repeat != 0 || (key != SDLK_ESCAPE && (key > '~' || key < ' '))) break;
          *event = {DisplayEvent::Kind::kKey, key == SDLK_ESCAPE ? 'q' : static_cast<char>(key), ""};
          return true;
        }
        case SDL_MOUSEBUTTONDOWN:
          if (happened.button.button != SDL_BUTTON_LEFT) break;
          [[fallthrough]];
        case SDL_FINGERDOWN:
          *event = {DisplayEvent::Kind::kTap, 0, ""};
          return true;
        case SDL_QUIT:
          closed_ = true;
          SDL_HideWindow(window_);
          *event = {DisplayEvent::Kind::kClosed, 0, "the window was closed"};
          return true;
        default:
          break;
      }
    }
    return false;
  }

 private:
  void open(int width, int height) {
    for (const auto& [attribute, value] :
         {std::pair(SDL_GL_CONTEXT_PROFILE_MASK, static_cast<int>(SDL_GL_CONTEXT_PROFILE_ES)),
          {SDL_GL_CONTEXT_MAJOR_VERSION, 2},
          {SDL_GL_CONTEXT_MINOR_VERSION, 0},
          {SDL_GL_DEPTH_SIZE, 16}}) {
      SDL_GL_SetAttribute(attribute, value);
    }
    constexpr Uint32 kFlags = SDL_WINDOW_OPENGL | SDL_WINDOW_RESIZABLE | SDL_WINDOW_ALLOW_HIGHDPI;
    SDL_Rect screen;
    if (SDL_GetDisplayUsableBounds(0, &screen) == 0 && (width > screen.w || height > screen.h)) {  // as much as fits
      const double scale = std::min(static_cast<double>(screen.w) / width, static_cast<double>(screen.h) / height);
      width = static_cast<int>(width * scale);
      height = static_cast<int>(height * scale);
    }
    window_ = SDL_CreateWindow("Pocket PTAM", SDL_WINDOWPOS_UNDEFINED, SDL_WINDOWPOS_UNDEFINED, width, height, kFlags);
    if (window_ == nullptr) throw no_window("none can be made");
    context_ = SDL_GL_CreateContext(window_);
    if (context_ == nullptr) throw no_window("there is no OpenGL ES 2.0");
    SDL_GL_SetSwapInterval(0);  // tracking does not wait for the screen
    survive_x11(window_);
    renderer_ = std::make_unique<Renderer>();
    driver_ = Renderer::driver();
    SDL_GL_MakeCurrent(window_, nullptr);
  }
  void close() {
    if (x11_failed()) {  // nothing of it can be asked to go
      static_cast<void>(renderer_.release());
      return;
    }
    if (renderer_) SDL_GL_MakeCurrent(window_, context_);
    renderer_.reset();
    if (context_ != nullptr) SDL_GL_DeleteContext(context_);
    if (window_ != nullptr) SDL_DestroyWindow(window_);
    SDL_QuitSubSystem(SDL_INIT_VIDEO);
  }
  std::pair<int, int> size() const {
    int width = 1;
    int height = 1;
    SDL_GL_GetDrawableSize(window_, &width, &height);
    return {std::max(1, width), std::max(1, height)};
  }

  SDL_Window* window_ = nullptr;
  SDL_GLContext context_ = nullptr;
  std::unique_ptr<Renderer> renderer_;
  std::string driver_;
  bool closed_ = false;
};

std::unique_ptr<Display> make_window(int width, int height) {
  return std::make_unique<WindowDisplay>(width, height);
}

}  // namespace

extern "C" __attribute__((visibility("default"))) const DisplayEntry PPTAM_DISPLAY_ENTRY;
const DisplayEntry PPTAM_DISPLAY_ENTRY = {nullptr, nullptr, make_window};

}  // namespace pptam::platform
