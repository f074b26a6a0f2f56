// How the hand moves the phone: smooth seeded curves of camera poses, evaluable at any time.
//
// A curve is a sum of minimum-jerk moves (position of the camera and of the point that it looks at), slow sway and the
// 8 to 12 Hz tremor of a hand; all of it twice continuously differentiable.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "sim_phone/scene.h"

namespace pptam::sim {

// T_wc at a time in seconds; camera x right, y down, z forward. Before 0 and after the story the hand holds still.
using MotionCurve = std::function<Eigen::Isometry3d(double t_s)>;

// "calm": hold still, move sideways, then explore. "shaky": the same with four times the tremor. "still": as on a
// tripod. "pure_rotation": turns about a fixed point. "lap": as "calm", but ends as it begins, at the first view.
std::vector<std::string> motion_names();

// name is one of motion_names(); haste: Harshness::haste, of "calm", "shaky" and "pure_rotation".
MotionCurve make_motion(const std::string& name, const Stage& stage, uint64_t seed, double duration_s,
                        double haste = 0);

// How a user begins: holds still, moves sideways, goes on looking at the same place from near by. The view and the
// moves are chosen by the seed alone, in the first camera's frame, so that any slant and roll can occur.
struct Start {
  MotionCurve curve;
  double move_s = 0;                    // when the first sideways movement begins
  double move_end_s = 0;                // and ends
  Vector3d normal = Vector3d::UnitZ();  // world: of the surface that the optical axis first meets
  double slant_deg = 0;                 // between the optical axis and that normal
  double distance_m = 0;                // to it along the axis
  double length_m = 0;                  // of the sideways movement
  double direction_deg = 0;             // of it in the image, from x right to y down
  double turned_deg = 0;                // before it
  double plane_share = 1;               // of the first view's area: the plane that explains most of it, within 2 %
};

// name is one of start_names(): "start" (planes slanted by 0 to 60 degrees), "steep_start" (60 to 70), "turn_start"
// (first turns on the spot by up to 30 degrees, and sometimes back, then moves). In the scenes "clutter" and "walls"
// the first view is one in which no plane explains 60 % of the area, if such a view is found.
std::vector<std::string> start_names();
Start make_start(const std::string& name, const Scene& scene, uint64_t seed);

}  // namespace pptam::sim
