// Camera intrinsics with three distortion models, and the rolling shutter's timing.
//
// Pinhole with FOV [ptam eq. 3-5], radial-tangential (OpenCV, ROS plumb_bob) or equidistant (Kannala-Brandt)
// distortion. Frames: camera x right, y down, z forward. Pixels: centres at integers, level 0. All functions are pure.
#pragma once

#include <cstdint>

#include <pocket_ptam/se3.h>
#include <pocket_ptam/status.h>

namespace pptam {

enum class Distortion : uint8_t { kNone, kFov, kRadTan, kEquidistant };

struct CameraModel {
  int width = 0;  // pixels
  int height = 0;
  float fx = 0, fy = 0, cx = 0, cy = 0;  // pixels
  Distortion distortion = Distortion::kNone;
  // kFov: {w} radians.  kRadTan: {k1, k2, p1, p2, k3}.  kEquidistant: {k1, k2, k3, k4}.
  float coeffs[5] = {0, 0, 0, 0, 0};

  // Finite fields, size from 1 to 8192, positive focal lengths, principal point inside the image, every corner's ray
  // within 85 degrees of the axis, w in (0, 3.1), and a distortion that does not fold over inside the image
  // and can be undone at its border to 0.01 px.
  Status validate() const;

  // Square of the largest undistorted radius |(x/z, y/z)| that project() accepts: 1.5 times that of the farthest image
  // corner, or where the distortion folds over. Filled by prepare(); 0 = not prepared.
  float max_radius_sq = 0;
  float fov_gain = 0;  // 2 tan(w / 2), kFov only; filled by prepare()
  // Computes max_radius_sq and fov_gain. Call once after filling the fields, before project() and unproject().
  // validate() must be ok.
  void prepare();

  // p_c: camera frame, any unit. False (outputs unchanged) behind the camera (z <= 0) or beyond max_radius_sq. The
  // pixel (level 0) may lie outside the image.
  bool project(const Vector3f& p_c, Vector2f* px) const;
  // Also gives the Jacobian d(px)/d(p_c), 2x3, pixels per unit of p_c. px has the same bits with and without it.
  bool project(const Vector3f& p_c, Vector2f* px, Matrix23f* J_px_p) const;
  // Normalised image coordinates (x/z, y/z) of a level-0 pixel. The iterative models take at most ten Newton steps.
  // Accurate to 1e-3 px over the image (float32 rounding of the pixel itself is up to 1e-4 px). Pixels so far outside
  // that nothing projects there are moved to the largest radius that does.
  Vector2f unproject(const Vector2f& px) const;

  // Whether level-0 pixel px is at least `border` pixels inside the outermost pixel centres.
  bool in_image(const Vector2f& px, float border) const {
    return px.x() >= border && px.y() >= border && px.x() <= static_cast<float>(width - 1) - border &&
           px.y() <= static_cast<float>(height - 1) - border;
  }
};

// When each image line is exposed, relative to the frame's timestamp, which is the exposure of the image centre.
struct RollingShutter {
  enum class Axis : uint8_t { kRows, kColumns };
  Axis axis = Axis::kRows;
  // Signed seconds per line: positive when larger coordinates are exposed later. 0 is a global shutter.
  // readout = |line_time_s| * lines.
  float line_time_s = 0;

  // Time of pixel px relative to the frame's timestamp, seconds: dt(u) = (u - (W - 1)/2) * line_time along the axis.
  float dt_s(const Vector2f& px, int width, int height) const {
    return axis == Axis::kColumns ? (px.x() - 0.5f * static_cast<float>(width - 1)) * line_time_s
                                  : (px.y() - 0.5f * static_cast<float>(height - 1)) * line_time_s;
  }
};

}  // namespace pptam
