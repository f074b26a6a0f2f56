// Camera calibration files, told apart by their keys: Kalibr, EuRoC, OpenCV (YAML, XML, JSON), ROS (files and printed
// messages), ORB-SLAM, stella_vslam, camodocal, COLMAP's cameras.txt. platform/README.md has the table.
//
// Pixel centres become integers, as ours. All but COLMAP's may carry our own keys beside the intrinsics:
//   readout_s: 0.030         seconds from the first to the last line, 0 (default): global shutter
//   readout_axis: rows       rows (default): lines are exposed one after the other; columns: likewise
//   readout_direction: 1     1 (default): larger coordinates later; -1: earlier
//   exposure_s: 0.008        0 (default): unknown
// Files come from outside: everything is checked, and every mistake is an InputError of one line that names the file.
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include <pocket_ptam/camera_model.h>

namespace pptam::platform {

struct Calibration {
  CameraModel model;
  RollingShutter shutter;
  float exposure_s = 0;
};

// What was assumed, or read but hardly meant, is added to `warnings` unless it is null, a line each that names the
// file. pixel_aspect: width of a pixel by its height, as the recording says.
Calibration read_calibration(const std::filesystem::path& file, std::vector<std::string>* warnings,
                             double pixel_aspect = 1);

// The same from a file's bytes; `name` stands for the file in messages.
Calibration calibration_of(std::vector<std::byte> bytes, const std::string& name, std::vector<std::string>* warnings,
                           double pixel_aspect = 1);

// Camera to body: EuRoC's T_BS, or the inverse of T_cam_imu of Kalibr's first camera.
Eigen::Isometry3d read_camera_to_body(const std::filesystem::path& file);

// What --calibration reads again, the lens with the same bits: Kalibr's form with our keys.
std::string calibration_yaml(const Calibration& calibration);

// A calibration for want of a better one: pinhole, square pixels, principal point in the centre. fov_degrees is
// horizontal, from the left edge of the image to the right.
Calibration guess_calibration(int width, int height, double fov_degrees);

}  // namespace pptam::platform
