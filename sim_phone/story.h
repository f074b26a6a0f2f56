// Stories of the emulated phone: named runs with everything that happens to a hand-held camera, from a calm desk to a
// hand in the view. Name and seed fix all of a story: scene, motion, lamps, what covers the lens.
// Each is a line of the table stories() (`pocket-ptam sim --help` prints it) and a function in story.cpp or
// harsh_stories.cpp, or has only something harsh about it; all are seen by the phone of PhoneOptions' defaults, unless
// the table says otherwise.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "sim_phone/phone_options.h"
#include "sim_phone/scene.h"
#include "sim_phone/story_parts.h"

namespace pptam::sim {

// What the program is to make of what it sees.
enum class WantedMap {
  kRight,
  kRightOrRefused,  // refused with StoryKind::refusal as the hint
  kNone             // nothing but a thing moves
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
  // A story of a harsher life has goals of its own in the suite.
  bool harsh = false;
  WantedMap map = WantedMap::kRight;
  Hint refusal = Hint::kNone;
  double tracked_percent = 98;  // wanted
  double frames_per_s = 15;
  double readout_s = -0.060;
};
const std::vector<StoryKind>& stories();
const StoryKind* find_story(const std::string& name);  // null: there is none

// name is one of stories(); scene is that story's with this seed (its stage alone, without surfaces, gives the same
// story but for "rotation_start"). Of harsh, haste counts in stories that explore calmly.
Story make_story(const std::string& name, const Scene& scene, uint64_t seed, const Harshness& harsh = {});

// What happens with these options: their story or their motion, and what is harsh about it.
Story story_of(const PhoneOptions& options, const Scene& scene);

// The phone's options for a story; what is changed in them afterwards holds.
PhoneOptions phone_for_story(const std::string& name, uint64_t seed);

}  // namespace pptam::sim
