// The cameras of this computer, by their addresses: /dev/video0, or any other path of a Video4Linux device, and
// libcamera:0, whose module is loaded when it is asked for.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "platform/camera/camera_device.h"

namespace pptam::platform {

struct CameraList {
  std::vector<CameraDescription> cameras;  // those with modes that can be used first, in the order of preference
  std::vector<std::string> remarks;        // what could not be asked, a line each
};
CameraList list_cameras();

// Empty: the first of the list. Throws InputError that says what to do.
std::unique_ptr<CameraDevice> open_camera_device(const std::string& address);

// What the module gives (its symbol is kLibcameraEntry); both throw InputError.
struct LibcameraEntry {
  std::vector<CameraDescription> (*list)();
  std::unique_ptr<CameraDevice> (*open)(const std::string& which);  // an index or an id
};
constexpr const char* kLibcameraEntry = "pptam_libcamera_entry";

}  // namespace pptam::platform
