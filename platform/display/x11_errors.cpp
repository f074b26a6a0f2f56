// Of its own, as the names in X11's headers go with no others.
#include "platform/display/x11_errors.h"

#include <SDL_syswm.h>
#include <dlfcn.h>

namespace pptam::platform {

#ifdef SDL_VIDEO_DRIVER_X11
namespace {

volatile bool failed = false;

}  // namespace

bool x11_failed() {
  return failed;
}

void survive_x11(SDL_Window* window) {
  SDL_SysWMinfo info;
  SDL_VERSION(&info.version);
  if (SDL_GetWindowWMInfo(window, &info) == SDL_FALSE || info.subsystem != SDL_SYSWM_X11) return;
  void* const xlib = ::dlopen("libX11.so.6", RTLD_LAZY | RTLD_NOLOAD);  // SDL has loaded it
  if (xlib == nullptr) return;
  using ErrorHandler = int (*)(::Display*, XErrorEvent*);
  using SetErrorHandler = ErrorHandler (*)(ErrorHandler);
  using SetExitHandler = void (*)(::Display*, void (*)(::Display*, void*), void*);
  if (const auto set = reinterpret_cast<SetErrorHandler>(::dlsym(xlib, "XSetErrorHandler"))) {
    set([](::Display*, XErrorEvent*) {
      failed = true;
      return 0;
    });
  }
  using IoErrorHandler = int (*)(::Display*);
  if (const auto set = reinterpret_cast<IoErrorHandler (*)(IoErrorHandler)>(::dlsym(xlib, "XSetIOErrorHandler")))
    set([](::Display*) { return 0; });  // Xlib's own ends the program before the next one is called
  if (const auto set = reinterpret_cast<SetExitHandler>(::dlsym(xlib, "XSetIOErrorExitHandler")))  // from 1.7 on
    set(
        info.info.x11.display, [](::Display*, void*) { failed = true; }, nullptr);
}
#else
bool x11_failed() {
  return false;
}

void survive_x11(SDL_Window*) {}
#endif

}  // namespace pptam::platform
