// How the hand moves the phone: smooth seeded curves of camera poses, evaluable at any time.
//
// A curve is a sum of minimum-jerk moves (position of the camera and of the point that it looks at), slow sway and the
// 8 to 12 Hz tremor of a hand; all of it twice continuously differentiable.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <functional>
#include <string>

#include "sim_phone/scene.h"

namespace pptam::sim {

// T_wc at a time in seconds; camera x right, y down, z forward. Before 0 and after the story the hand holds still.
using MotionCurve = std::function<Eigen::Isometry3d(double t_s)>;

// name is one of motion_names().
MotionCurve make_motion(const std::string& name, const Stage& stage, uint64_t seed, double duration_s);

}  // namespace pptam::sim
