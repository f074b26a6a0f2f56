#include "platform/camera/image_reduction.h"

#include <algorithm>
#include <cstdint>
#include <utility>

namespace pptam::platform {
namespace {

// Of the source, with the shape of wanted: as large as fits.
int cropped_side(int side, int other_side, int wanted, int wanted_other) {
  return static_cast<int>(std::min<int64_t>(side, int64_t{other_side} * wanted / wanted_other));
}

struct Sides {
  int width, height;
};

Sides turned(int width, int height, int rotate_degrees) {
  return rotate_degrees % 180 == 0 ? Sides{width, height} : Sides{height, width};
}

}  // namespace

ImageReduction::ImageReduction(int source_width, int source_height, int rotate_degrees, int wanted_width,
                               int wanted_height)
    : crop_width_(source_width), crop_height_(source_height), transform_(1, 1, 0, 0, 0) {
  Sides wanted = turned(wanted_width, wanted_height, rotate_degrees);  // before rotation
  if (wanted_width <= 0 || wanted_height <= 0) wanted = {source_width, source_height};
  wanted.width = std::min(wanted.width, source_width);
  wanted.height = std::min(wanted.height, source_height);
  crop_width_ = cropped_side(source_width, source_height, wanted.width, wanted.height);
  crop_height_ = cropped_side(source_height, source_width, wanted.height, wanted.width);
  crop_x_ = (source_width - crop_width_) / 2;
  crop_y_ = (source_height - crop_height_) / 2;
  const Sides out = turned(wanted.width, wanted.height, rotate_degrees);
  transform_ = FrameTransform(crop_width_, crop_height_, rotate_degrees, out.width, out.height);
}

CameraModel ImageReduction::model(const CameraModel& source) const {
  CameraModel cropped = source;
  cropped.width = crop_width_;
  cropped.height = crop_height_;
  cropped.cx -= static_cast<float>(crop_x_);
  cropped.cy -= static_cast<float>(crop_y_);
  return transform_.model(cropped);
}

CameraModel ImageReduction::model_of_cropped(const CameraModel& cropped) const {
  return transform_.model(cropped);
}

// A line takes as long as before where lines are cut away.
RollingShutter ImageReduction::shutter(const RollingShutter& source) const {
  return transform_.shutter(source);
}

GreyView ImageReduction::apply(const GreyView& image) {
  return transform_.apply({image.row(crop_y_) + crop_x_, crop_width_, crop_height_, image.stride});
}

}  // namespace pptam::platform
