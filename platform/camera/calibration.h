// Camera calibration files: Kalibr camchain, OpenCV, ROS camera_info and EuRoC sensor.yaml, told apart by their keys.
//
// All of them put pixel centres at integers, as we do. Any of them may carry our own keys beside the intrinsics:
//   readout_s: 0.030         seconds from the first to the last line, 0 (default): global shutter
//   readout_axis: rows       rows (default): lines are exposed one after the other; columns: likewise
//   readout_direction: 1     1 (default): larger coordinates later; -1: earlier
//   exposure_s: 0.008        0 (default): unknown
// Files come from outside: everything is checked, and every mistake is an InputError of one line that names the file.
#pragma once

#include <Eigen/Geometry>
#include <filesystem>

#include <pocket_ptam/camera_model.h>

namespace pptam::platform {

struct Calibration {
  CameraModel model;
  RollingShutter shutter;
  float exposure_s = 0;
};

Calibration read_calibration(const std::filesystem::path& file);

// EuRoC's T_BS: camera to body.
Eigen::Isometry3d read_camera_to_body(const std::filesystem::path& file);

// A calibration for want of a better one: pinhole, square pixels, principal point in the centre. fov_degrees is
// horizontal, from the left edge of the image to the right.
Calibration guess_calibration(int width, int height, double fov_degrees);

}  // namespace pptam::platform
