// A Camera made of a CameraDevice: the mode is chosen, images are reduced to the tracked size, times become those of
// mid-exposure, the newest frame wins, and a device that fails or is pulled out is looked for until it is there again.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "platform/camera.h"
#include "platform/camera/camera_device.h"

namespace pptam::platform {

struct DeviceOptions {
  CameraRequest request;              // of the device's images; what is not said is chosen
  std::filesystem::path calibration;  // empty: fov_degrees is used
  double fov_degrees = 0;             // horizontal, of the device's image
  int width = 0;                      // tracked size, after rotation; 0: 320x240, upright 240x320
  int height = 0;
  int rotate_degrees = 0;  // clockwise
  // Rolling shutter of the device's image, before rotation; overrides the calibration's.
  std::optional<RollingShutter::Axis> readout_axis;
  std::optional<double> readout_s;  // signed
  SensorRequest sensor;
};

// The mode for images of width x height (the device's, before rotation) at so many frames per second: what the request
// names must be as named; then a mode of the calibration's size (0: none), one that is quick enough, one that is not
// smaller, and the smallest of these; uncompressed before JPEG. Null: none fits the request.
const CameraMode* choose_mode(const std::vector<CameraMode>& modes, const CameraRequest& request, int width, int height,
                              int calibrated_width, int calibrated_height);

// Configures the device. Throws InputError that says what to do. warnings: lines for the user about what was assumed
// or adjusted.
std::unique_ptr<Camera> make_device_camera(std::unique_ptr<CameraDevice> device, const DeviceOptions& options,
                                           std::vector<std::string>* warnings);

}  // namespace pptam::platform
