// Recorded sequences as cameras: TUM RGB-D folders, EuRoC folders, folders and lists of images, video files.
//
// Frames have the times of the list, of their names or of the video, whose first frame is at 0. Images and raw streams
// that carry no times are evenly spaced from 0, and a warning says so.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>

#include "platform/camera.h"

namespace pptam::platform {

// What the user said about a recording; everything else is read from the source.
struct RecordingOptions {
  // A folder (TUM with rgb.txt; EuRoC, also its mav0 or cam0; or images, by the times they are named by or in natural
  // order), a list like TUM's rgb.txt or EuRoC's data.csv,
  // an image pattern with one %d or %0Nd, or a video file. EuRoC's sensor.yaml is used when no calibration is given.
  std::filesystem::path source;
  std::filesystem::path calibration;  // empty: fov_degrees is used
  double fov_degrees = 0;             // horizontal field of view of the source image, when there is no calibration
  bool uncalibrated = false;          // the images alone count: any calibration is as good as none
  int resize_width = 0;               // after rotation; 0: keep
  int resize_height = 0;
  int every = 1;           // keep one frame of so many
  double fps = 0;          // of the source, for images without timestamps (default 30); overrides a video's, and names'
  int rotate_degrees = 0;  // clockwise: 0, 90, 180, 270
  // Rolling shutter of the source image, before rotation and resizing; overrides the calibration's.
  std::optional<RollingShutter::Axis> readout_axis;
  std::optional<double> readout_s;  // signed: positive when larger coordinates are exposed later
  // For a search: what is assumed of the images delivered, after rotation and resizing, whatever was said above.
  double focal_factor = 1;  // of their focal lengths
  std::optional<RollingShutter> shutter;
};

// Opens a recording. Throws InputError naming the file and the remedy. warnings (may be null) receives one-line remarks
// for the user, such as "no calibration: assuming a field of view of 50 degrees".
std::unique_ptr<Camera> open_recording(const RecordingOptions& options, std::vector<std::string>* warnings);

}  // namespace pptam::platform
