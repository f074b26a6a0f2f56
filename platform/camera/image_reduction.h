// From a device's images to those that are tracked: the middle of the wanted shape is cut out, turned, and shrunk by
// area weighting (exactly a 2x2 mean where the size is halved); the camera's model and shutter are carried along.
#pragma once

#include <pocket_ptam/camera_model.h>
#include <pocket_ptam/image.h>
#include "platform/camera/frame_transform.h"

namespace pptam::platform {

class ImageReduction {
 public:
  // wanted: the tracked size, after rotation; 0: no cropping and shrinking. What the source lacks is not made up: of a
  // smaller source the size that it has is tracked. Throws InputError as FrameTransform.
  ImageReduction(int source_width, int source_height, int rotate_degrees, int wanted_width, int wanted_height);

  int width() const { return transform_.width(); }
  int height() const { return transform_.height(); }
  int crop_x() const { return crop_x_; }  // of the source, as what follows
  int crop_y() const { return crop_y_; }
  int cropped_width() const { return crop_width_; }
  int cropped_height() const { return crop_height_; }

  CameraModel model(const CameraModel& source) const;              // of the tracked images, from the source's
  CameraModel model_of_cropped(const CameraModel& cropped) const;  // likewise, from the middle's
  RollingShutter shutter(const RollingShutter& source) const;
  GreyView apply(const GreyView& image);  // valid until the next call, and as long as the image

 private:
  int crop_x_ = 0, crop_y_ = 0;
  int crop_width_, crop_height_;
  FrameTransform transform_;
};

}  // namespace pptam::platform
