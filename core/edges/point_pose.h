// The pose from four or more points of an object and their pixels, for a start by hand: a minimal solver on three of
// them, judged by the others, then servoing on all.
#pragma once

#include <span>

#include <pocket_ptam/camera.h>

namespace pptam {

// False when there are fewer than four points or as many pixels, all are nearly in a line, or no pose brings every
// point within max_error_px of its pixel. All poses of three points are tried: distances l_i along the rays f_i with
// |l_i f_i - l_j f_j| = |p_i - p_j|, by Newton's method from 27 starts.
bool pose_from_points(const Camera& camera, std::span<const Vector3f> points_o, std::span<const Vector2f> px,
                      float max_error_px, SE3* T_co);

}  // namespace pptam
