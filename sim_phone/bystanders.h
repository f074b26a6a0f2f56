// What moves in the scene while the camera looks at it: arms over a table, people before a wall, a thing carried past.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "sim_phone/scene.h"
#include "sim_phone/sensor.h"

namespace pptam::sim {

// busy: share of the time in which something is in the way of a view, 0 to 1; from about the fourth second on, when a
// map has begun. Tables: arms that reach in from the sides, 4 to 10 cm above the table, some with a thing in the hand.
// Walls: people who pass below the line of sight, 0.2 to 0.35 m before the wall.
std::vector<std::shared_ptr<const Mover>> make_bystanders(const Stage& stage, double busy, uint64_t seed);

// A printed thing, parallel to the image of a camera at T_wc and half-way to what it sees at depth_m. It rests in the
// view and from start_s on is swung to and fro, always in sight; it hides between a quarter and a third of the view.
std::shared_ptr<const Mover> make_carried_thing(const Eigen::Isometry3d& T_wc, double depth_m, double start_s,
                                                uint64_t seed);

}  // namespace pptam::sim
