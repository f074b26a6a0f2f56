// Video4Linux: webcams (UVC) and whatever else the kernel shows as /dev/video*, by memory-mapped streaming. GREY, YUYV,
// NV12, YU12 and MJPEG.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "platform/camera/camera_device.h"
#include "platform/camera/v4l2_calls.h"

namespace pptam::platform {

// Those that capture, with the modes that can be used (perhaps none). calls: null for the system's own.
std::vector<CameraDescription> list_v4l2_cameras(V4l2Calls* calls = nullptr);

// Throws InputError that says what to do.
std::unique_ptr<CameraDevice> open_v4l2_device(const std::string& path, V4l2Calls* calls = nullptr);

}  // namespace pptam::platform
