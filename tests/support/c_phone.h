// A system of the C interface with its memory, and what tests give it.
#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include <pocket_ptam/pocket_ptam_c.h>
#include "tests/support/recording.h"

namespace pptam::test {

inline pptam_camera c_camera_of(const Camera& camera) {
  pptam_camera c = {};
  c.width = camera.model.width;
  c.height = camera.model.height;
  c.fx = camera.model.fx;
  c.fy = camera.model.fy;
  c.cx = camera.model.cx;
  c.cy = camera.model.cy;
  c.distortion = static_cast<int32_t>(camera.model.distortion);
  std::memcpy(c.coeffs, camera.model.coeffs, sizeof c.coeffs);
  c.shutter_axis = static_cast<int32_t>(camera.shutter.axis);
  c.line_time_s = camera.shutter.line_time_s;
  return c;
}

inline pptam_config c_config_for(const Recording& recording) {
  const Config config = config_for(recording);
  const pptam_camera camera = c_camera_of(config.camera);
  pptam_config c = {};
  EXPECT_EQ(pptam_config_phone(&camera, &c).code, PPTAM_OK);
  c.exposure_s = config.exposure_s;
  return c;
}

inline pptam_frame c_frame(const Frame& frame) {
  return {frame.data,        frame.width, frame.height, frame.stride_bytes, static_cast<int32_t>(frame.format),
          frame.timestamp_ns};
}

// A block as malloc gives it, filled with rubbish.
class Block {
 public:
  explicit Block(size_t bytes) : bytes_(bytes), memory_(bytes / sizeof(std::max_align_t) + 2) {
    std::memset(memory_.data(), 0xa5, memory_.size() * sizeof(std::max_align_t));
  }
  unsigned char* data() { return reinterpret_cast<unsigned char*>(memory_.data()); }
  size_t bytes() const { return bytes_; }

 private:
  size_t bytes_;
  std::vector<std::max_align_t> memory_;
};

class CPhone {
 public:
  explicit CPhone(const pptam_config& config) : block_(pptam_required_bytes(&config)) {
    const pptam_status status = pptam_create(&config, block_.data(), block_.bytes(), &system_);
    EXPECT_EQ(status.code, PPTAM_OK) << status.message;
  }
  operator pptam_system*() { return system_; }

 private:
  Block block_;
  pptam_system* system_ = nullptr;
};

}  // namespace pptam::test
