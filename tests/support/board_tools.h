// What the tests of calibration share: lenses with names, and whether OpenCV is there.
#pragma once

#include <filesystem>
#include <string>

#include <pocket_ptam/camera_model.h>

namespace pptam::test {

#ifdef PPTAM_OPENCV_MODULE
inline bool have_opencv() {
  return std::filesystem::exists(PPTAM_OPENCV_MODULE);
}
#endif

// The principal point is off the middle, as real ones are, so that a mirrored truth is another one.
inline CameraModel lens_named(const std::string& name) {
  CameraModel m;
  m.width = 480, m.height = 360;
  m.fx = 420, m.fy = 421, m.cx = 247, m.cy = 175;
  const auto distort = [&m](Distortion kind, float a, float b, float c, float d, float e) {
    m.distortion = kind;
    m.coeffs[0] = a, m.coeffs[1] = b, m.coeffs[2] = c, m.coeffs[3] = d, m.coeffs[4] = e;
  };
  if (name == "barrel") distort(Distortion::kRadTan, -0.28f, 0.09f, 0.0008f, -0.0005f, 0);
  if (name == "wide") {  // 86 degrees across
    m.fx = 300, m.fy = 300.5f;
    distort(Distortion::kRadTan, -0.22f, 0.06f, 0.0003f, 0.0004f, -0.008f);
  }
  if (name == "fisheye") {  // 115 degrees across
    m.fx = 240, m.fy = 240.5f;
    distort(Distortion::kEquidistant, 0.03f, -0.01f, 0.004f, -0.001f, 0);
  }
  m.prepare();
  return m;
}

}  // namespace pptam::test
