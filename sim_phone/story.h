// Stories of the emulated phone: named runs with everything that happens to a hand-held camera, from a calm desk to a
// hand in the view. Name and seed fix all of a story: scene, motion, lamps, what covers the lens.
// Each is a line of the table stories() (`pocket-ptam sim --help` prints it) and a function in story.cpp; all are seen
// by the phone of PhoneOptions' defaults, unless the table says otherwise.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "sim_phone/motion.h"
#include "sim_phone/phone_options.h"
#include "sim_phone/scene.h"
#include "sim_phone/sensor.h"

namespace pptam::sim {

struct Interval {
  double from_s = 0;
  double to_s = 0;
};

struct StoryKind {
  const char* name;
  const char* says;   // one line
  const char* scene;  // one of scene_names()
  double duration_s;
  double exposure_s;
  double drop_probability;
  bool explores;  // or orbits: the position error is judged
  bool loses;     // tracking cannot be expected at times: Story::lost
};
const std::vector<StoryKind>& stories();
const StoryKind* find_story(const std::string& name);  // null: there is none

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
  std::optional<Standstill> standstill;
  std::function<double(double t_s)> light;   // SensorOptions::light; may be null
  std::shared_ptr<const Occluder> occluder;  // may be null
  std::vector<std::shared_ptr<const Mover>> movers;
};

// name is one of stories(); scene is that story's with this seed (its stage alone, without surfaces, gives the same
// story but for "rotation_start"). Of harsh, haste counts in stories that explore calmly.
Story make_story(const std::string& name, const Scene& scene, uint64_t seed, const Harshness& harsh = {});

// What happens with these options: their story or their motion, and what is harsh about it.
Story story_of(const PhoneOptions& options, const Scene& scene);

// The phone's options for a story; what is changed in them afterwards holds.
PhoneOptions phone_for_story(const std::string& name, uint64_t seed);

}  // namespace pptam::sim
