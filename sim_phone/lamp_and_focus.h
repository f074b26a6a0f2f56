// What is unsteady about a lamp on the mains and about a lens that focuses by itself.
#pragma once

#include <cstdint>
#include <functional>

#include "sim_phone/harshness.h"

namespace pptam::sim {

// Factor on all light at a time: how dim it is, and the lamp's flicker. Null without either. The mains' frequency is
// off by up to 0.1 % (their tolerance in Europe is 0.4 %), so that bands drift even when a frame takes whole periods.
std::function<double(double t_s)> lamp_light(const Harshness& harshness, uint64_t seed);

// How the focus is at a time.
struct Focus {
  double scale = 1;    // of the image about its centre
  double blur_px = 0;  // radius of the blur, of an image 240 pixels wide
};
// breathing: Harshness::breathing. Every few seconds the focus hunts: there and back through a blur.
std::function<Focus(double t_s)> focus_curve(double breathing, uint64_t seed);

}  // namespace pptam::sim
