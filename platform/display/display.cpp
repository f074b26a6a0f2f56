#include "platform/display/display.h"

#include <dlfcn.h>

#include <cstdlib>
#include <filesystem>

#include "platform/files.h"
#include "platform/input_error.h"

namespace pptam::platform {
namespace {

constexpr const char* kModule = "pocket-ptam-display.so";
constexpr const char* kWindowModule = "pocket-ptam-window.so";

const DisplayEntry& module_entry(const char* name, const std::string& what, const char* build_packages,
                                 const char* run_packages) {
  const std::filesystem::path file = module_of_program(name);
  if (file.empty()) {
    throw InputError(what + ": built without it, there is no " + name + " beside the program (Debian: install " +
                     build_packages + " and build again)");
  }
  ::setenv("EGL_LOG_LEVEL", "fatal", 0);  // Mesa tells on standard error of each driver that it tries
  void* const module = ::dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL);  // for good: drivers do not like to be unloaded
  if (module == nullptr)
    throw InputError(what + ": cannot be used: " + ::dlerror() + " (Debian: install " + run_packages + ")");
  const auto* entry = static_cast<const DisplayEntry*>(::dlsym(module, PPTAM_DISPLAY_ENTRY));
  if (entry == nullptr) throw InputError(file.string() + " is of another version of the program: build again");
  return *entry;
}

const DisplayEntry& display_module(const std::string& what) {
  return module_entry(kModule, what, "libegl-dev libgles-dev libgbm-dev libdrm-dev", "libegl1 libgles2 libgbm1");
}

std::unique_ptr<Display> open_screen() {
  const DisplayEntry& module = display_module("a screen");
  if (module.screen == nullptr)
    throw InputError("a screen: built without GBM (Debian: install libgbm-dev libdrm-dev and build again)");
  return module.screen();
}

std::unique_ptr<Display> open_window(int width, int height) {
  return module_entry(kWindowModule, "a window", "libsdl2-dev libgles-dev", "libsdl2-2.0-0 libgles2")
      .window(width, height);
}

}  // namespace

std::unique_ptr<Display> open_offscreen(int width, int height) {
  return display_module("drawing").offscreen(width, height);
}

std::unique_ptr<Display> open_display(DisplayChoice choice, int width, int height) {
  if (choice == DisplayChoice::kAuto) {
    const auto set = [](const char* name) {
      const char* value = std::getenv(name);
      return value != nullptr && *value != 0;
    };
    choice = set("DISPLAY") || set("WAYLAND_DISPLAY") ? DisplayChoice::kWindow : DisplayChoice::kScreen;
  }
  return choice == DisplayChoice::kWindow ? open_window(width, height) : open_screen();
}

}  // namespace pptam::platform
