// The paper's phone, held upright, without distortion: 240x320, 37x48 degrees; 60 ms readout by columns.
#pragma once

#include <pocket_ptam/camera_model.h>

namespace pptam::test {

inline CameraModel phone_camera() {
  CameraModel camera;
  camera.width = 240;
  camera.height = 320;
  camera.fx = camera.fy = 358.6f;
  camera.cx = 119.5f;
  camera.cy = 159.5f;
  camera.prepare();
  return camera;
}

inline RollingShutter phone_shutter() {
  return {RollingShutter::Axis::kColumns, -0.060f / 240};
}

}  // namespace pptam::test
