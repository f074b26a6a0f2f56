// The experiments of [ptam 7] as stories of the emulated camera: a webcam with a global shutter before two textured
// walls, and before a desk with things on it. Made for the desktop profile (Config::desktop).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "sim_phone/phone_options.h"
#include "sim_phone/scene.h"
#include "sim_phone/story_parts.h"

namespace pptam::sim {

struct DesktopStory {
  const char* name;
  const char* says;  // one line
  int width, height;
  double horizontal_fov_degrees;
  double exposure_s;
  int frames;  // at 30 frames/s
};
const std::vector<DesktopStory>& desktop_stories();
bool is_desktop_story(const std::string& name);

// name is one of desktop_stories().
Scene make_desktop_scene(const std::string& name, uint64_t seed);
Story make_desktop_story(const std::string& name, const Stage& stage, uint64_t seed);
PhoneOptions phone_for_desktop_story(const std::string& name, uint64_t seed);

}  // namespace pptam::sim
