// What a story of the emulated phone consists of: how the camera moves and all that happens meanwhile.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "sim_phone/motion.h"
#include "sim_phone/sensor.h"

namespace pptam::sim {

struct Interval {
  double from_s = 0;
  double to_s = 0;
};

struct Standstill {
  double from_s = 0;  // at rest as on a tripod, to the bit
  double step_from_s = 0;
  double step_to_s = 0;  // a small quick move; at rest again from here on
};

struct Story {
  MotionCurve curve;
  double move_s = 0;           // the first sideways movement begins
  std::vector<Interval> lost;  // tracking cannot be expected; a known view is back at the end of each
  // Something hides a part of the view: tracking can be expected, but a view that was lost is not back before the end.
  std::vector<Interval> obstructed;
  std::vector<Interval> no_frames;  // the camera delivers nothing
  std::vector<Interval> pans;       // on the spot over what was not seen before, and back at the end of each
  double pan_depth_m = 0;           // of the scene where they begin
  std::optional<Standstill> standstill;
  std::function<double(double t_s)> light;   // SensorOptions::light; may be null
  std::shared_ptr<const Occluder> occluder;  // may be null
  std::vector<std::shared_ptr<const Mover>> movers;
};

}  // namespace pptam::sim
