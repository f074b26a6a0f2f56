// The stories of a harsher life: how the hand moves in those that do not simply explore, and what is harsh in each.
// They stand in the table stories() like the others.
#pragma once

#include <cstdint>
#include <string>

#include "sim_phone/harshness.h"
#include "sim_phone/story_parts.h"

namespace pptam::sim {

constexpr double kBandsExposure_s = 0.004;  // of stories with a lamp's bands: longer ones take whole periods

// What is harsh in a story with this seed; nothing in the stories that story.cpp tells.
Harshness harshness_of_story(const std::string& name, uint64_t seed);

// False when the story has nothing of its own to tell.
bool tell_harsh_story(const std::string& name, const Stage& stage, Random& random, uint64_t seed, Story* story);

}  // namespace pptam::sim
