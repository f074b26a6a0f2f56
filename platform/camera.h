// What every source of images implements: recorded sequences, real cameras and the emulated phone.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <pocket_ptam/pocket_ptam.h>
#include "platform/input_error.h"
#include "platform/trajectory.h"

namespace pptam::platform {

struct CameraInfo {
  CameraModel model;               // of the images that read() delivers (after rotation, cropping and resizing)
  RollingShutter shutter;          // likewise
  float exposure_s = 0;            // 0: unknown
  double frames_per_s = 0;         // nominal
  std::optional<int> frame_count;  // known length, for progress
  std::string name;                // for reports: "tag_desk", "desk, seed 3"
};

class Camera {
 public:
  virtual ~Camera() = default;
  virtual const CameraInfo& info() const = 0;

  // Delivers the next frame; its pixels stay valid until the next call. False at the end. Throws InputError when the
  // source is broken (a truncated file, an unplugged camera); frames delivered so far remain good.
  virtual bool read(Frame* frame) = 0;

  // Camera-to-world poses with the frames' time base, empty when unknown.
  virtual Trajectory ground_truth() const { return {}; }

  // One-line warnings about the frames delivered so far, such as times that ran backwards; asked for at a run's end.
  virtual std::vector<std::string> remarks() const { return {}; }
};

}  // namespace pptam::platform
