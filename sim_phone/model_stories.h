// The experiments of [vvs 4] as stories of the emulated phone: a known object in a scene of its own, seen by a camera
// that moves round it, with what hides and disturbs it. Made for `pocket-ptam model`, not for a map.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "sim_phone/phone_options.h"
#include "sim_phone/scene.h"
#include "sim_phone/story_parts.h"

namespace pptam::sim {

struct ModelStory {
  const char* name;
  const char* says;  // one line
  int width, height;
  double duration_s;
};
const std::vector<ModelStory>& model_stories();
bool is_model_story(const std::string& name);

// name is one of model_stories(). The scene's model (Scene::model) is in the world's frame.
Scene make_model_scene(const std::string& name, uint64_t seed);
Story make_model_story(const std::string& name, uint64_t seed);
// Size, field of view, rates and length.
PhoneOptions phone_for_model_story(const std::string& name, uint64_t seed);

}  // namespace pptam::sim
