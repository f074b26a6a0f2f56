// The luminance of a device's raw images, in place where it lies in a plane of its own.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <pocket_ptam/image.h>
#include "platform/camera/camera_device.h"

namespace pptam::platform {

class Luminance {
 public:
  // False, with the reason in trouble(), when bytes are missing or a JPEG is damaged, of another size or progressive.
  // The view is valid as long as the buffer and until the next call.
  bool read(const DeviceFrame& frame, GreyView* view);
  const std::string& trouble() const { return trouble_; }

 private:
  bool read_jpeg(const DeviceFrame& frame);

  std::vector<uint8_t> pixels_;
  std::string trouble_;
};

}  // namespace pptam::platform
