// A V4L2 sensor's own controls, held still while it is tracked with: what changes by itself from frame to frame costs
// matches (exposure, gain, white balance) or the calibration (focus).
#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "platform/camera/camera_device.h"
#include "platform/camera/v4l2_calls.h"

namespace pptam::platform {

class V4l2Controls {
 public:
  explicit V4l2Controls(V4l2Calls& calls) : calls_(calls) {}

  // The filter against flicker, and the exposure time if one is given.
  void prepare(int fd, const SensorRequest& request);
  // At the values that the device's own control has found; of a device that came back, at those of the first time. A
  // line for each of them.
  std::vector<std::string> lock(int fd, const SensorRequest& request);
  // As they were found.
  void restore(int fd);
  bool has_automatic(int fd);                        // exposure or gain that adjusts itself now
  double exposure_s() const { return exposure_s_; }  // as locked; 0: unknown

 private:
  bool exists(int fd, uint32_t id);
  bool get(int fd, uint32_t id, int32_t* value);
  bool set(int fd, uint32_t id, int32_t value);
  std::string lock_exposure(int fd, double wanted_s);
  std::string set_filter(int fd, int mains_hz);
  // Switches `automatic` to `off` and keeps the value that it had found.
  std::string lock_value(int fd, const std::string& what, uint32_t automatic, int32_t off, uint32_t value);

  V4l2Calls& calls_;
  std::vector<std::pair<uint32_t, int32_t>> before_;  // what was changed, and what it was
  std::vector<std::pair<uint32_t, int32_t>> kept_;    // the values that were locked
  double exposure_s_ = 0;
};

}  // namespace pptam::platform
