// Turns and shrinks images, and carries the camera's model, shutter and poses along: first a clockwise rotation by a
// multiple of 90 degrees, then a resize by area weighting.
//
// Pixel centres are integers and the image's edges lie half a pixel further out, so that a resize by s is
// x' = (x + 0.5) * s - 0.5; turning a W x H image clockwise by 90 degrees takes (x, y) to (H - 1 - y, x).
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <vector>

#include <pocket_ptam/camera_model.h>
#include "platform/camera/image_files.h"

namespace pptam::platform {

class FrameTransform {
 public:
  // Output sizes of 0 keep the rotated size. Throws InputError for another angle than 0, 90, 180, 270 and for an
  // enlargement.
  FrameTransform(int source_width, int source_height, int rotate_degrees, int resize_width, int resize_height);

  int width() const { return width_; }
  int height() const { return height_; }

  // Of the output, from those of the source.
  CameraModel model(const CameraModel& source) const;
  RollingShutter shutter(const RollingShutter& source) const;
  Eigen::Vector2d pixel(const Eigen::Vector2d& source_px) const;
  // Turns camera coordinates of the source into those of the output.
  Eigen::Matrix3d rotation() const;

  // image has the source's size; the result is valid until the next call. Each output pixel is the mean of the area
  // that it covers, rounded half up: exactly (a + b + c + d + 2) / 4 when halving.
  GreyView apply(const GreyView& image);

 private:
  int turns_;  // clockwise quarters, 0 to 3
  int rotated_width_;
  int rotated_height_;
  int width_;
  int height_;
  GreyPixels rotated_;
  GreyPixels resized_;
  std::vector<uint32_t> row_;  // one source row shrunk horizontally, times rotated_width_
  std::vector<uint64_t> sum_;  // of one output row, times rotated_width_ * rotated_height_
};

}  // namespace pptam::platform
