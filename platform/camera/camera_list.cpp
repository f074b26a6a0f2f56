#include "platform/camera/camera_list.h"

#include <dlfcn.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <filesystem>
#include <utility>

#include "platform/camera/v4l2_calls.h"
#include "platform/camera/v4l2_device.h"
#include "platform/files.h"

namespace pptam::platform {
namespace {

constexpr const char* kModule = "pocket-ptam-libcamera.so";
const std::string kLibcamera = "libcamera:";

// Null, with the reason.
const LibcameraEntry* libcamera_module(std::string* why) {
  const std::filesystem::path file = module_of_program(kModule);
  if (file.empty()) {
    *why = std::string("built without libcamera: there is no ") + kModule +
           " beside the program (install libcamera-dev and build again)";
    return nullptr;
  }
  ::setenv("LIBCAMERA_LOG_LEVELS", "*:ERROR", 0);                // it is read while the library is loaded
  void* module = ::dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL);  // for good: its threads may live on
  if (module == nullptr) {
    *why = std::string("libcamera cannot be used: ") + ::dlerror();
    return nullptr;
  }
  const void* entry = ::dlsym(module, kLibcameraEntry);
  if (entry == nullptr) *why = file.string() + ": is another version's";
  return static_cast<const LibcameraEntry*>(entry);
}

// Nodes of image processors and codecs capture what they were given, not what a sensor sees.
bool is_sensor(const CameraDescription& camera) {
  for (const char* other : {"isp", "codec", "pispbe"}) {
    if (camera.driver.find(other) != std::string::npos) return false;
  }
  return true;
}

}  // namespace

CameraList list_cameras() {
  CameraList list;
  list.cameras = list_v4l2_cameras();
  const auto usable = [](const CameraDescription& camera) { return !camera.modes.empty() && is_sensor(camera); };
  std::stable_partition(list.cameras.begin(), list.cameras.end(), usable);
  const auto first_unusable = std::find_if_not(list.cameras.begin(), list.cameras.end(), usable);
  std::string why;
  if (const LibcameraEntry* module = libcamera_module(&why)) {
    try {
      std::vector<CameraDescription> more = module->list();
      list.cameras.insert(first_unusable, more.begin(), more.end());
    } catch (const InputError& error) {
      why = error.what();
    }
  }
  if (!why.empty()) list.remarks.push_back(why);
  V4l2Calls calls;
  for (const std::string& node : calls.nodes()) {
    const int fd = calls.open(node.c_str());
    if (fd >= 0) {
      calls.close(fd);
    } else if (errno == EACCES) {
      list.remarks.push_back(
          node + ": permission denied: add yourself to the group video (adduser $USER video) and log " + "in again");
    }
  }
  return list;
}

std::unique_ptr<CameraDevice> open_camera_device(const std::string& address) {
  if (address.empty()) {
    const CameraList list = list_cameras();
    if (!list.cameras.empty() && !list.cameras.front().modes.empty())
      return open_camera_device(list.cameras.front().address);
    std::string text = "there is no camera here: plug one in, or name it with --camera";
    for (const std::string& remark : list.remarks) text += "; " + remark;
    throw InputError(text);
  }
  if (address.rfind(kLibcamera, 0) == 0) {
    std::string why;
    const LibcameraEntry* module = libcamera_module(&why);
    if (module == nullptr) throw InputError("camera " + address + ": " + why);
    return module->open(address.substr(kLibcamera.size()));
  }
  return open_v4l2_device(address);
}

}  // namespace pptam::platform
