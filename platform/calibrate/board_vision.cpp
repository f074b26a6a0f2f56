#include "platform/calibrate/board_vision.h"

#include <dlfcn.h>

#include <filesystem>

#include "platform/files.h"
#include "platform/input_error.h"

namespace pptam::platform {
namespace {

constexpr const char* kModule = "pocket-ptam-opencv.so";
constexpr const char* kEntry = "pptam_board_vision";

const BoardVision* load_module(std::filesystem::path module) {
  if (module.empty()) module = module_of_program(kModule);
  if (module.empty()) {
    throw InputError(
        "calibrate needs OpenCV, without which this program was built: install it (Debian: libopencv-calib3d-dev), "
        "then configure and build again");
  }
  void* const handle = dlopen(module.c_str(), RTLD_NOW | RTLD_LOCAL);  // for as long as the program runs
  if (handle == nullptr) {
    throw InputError(std::string("calibrate needs OpenCV, which cannot be loaded: ") + dlerror() +
                     "; install what is missing (Debian: libopencv-calib3d-dev)");
  }
  using Entry = const BoardVision* (*)();
  const auto entry = reinterpret_cast<Entry>(dlsym(handle, kEntry));
  if (entry == nullptr) throw InputError(module.string() + " is of another version of the program: build again");
  return entry();
}

}  // namespace

const BoardVision& board_vision(const std::filesystem::path& module) {
  static const BoardVision* const vision = load_module(module);
  return *vision;
}

}  // namespace pptam::platform
