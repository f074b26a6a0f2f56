// Phones to be emulated: processor, camera, and what of its time a frame's capture and display take. Read from small
// YAML files: those of sim_phone/profiles, which are built into the program, or the user's own.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "platform/run/run.h"
#include "sim_phone/phone_options.h"

namespace pptam::laboratory {

struct Phone {
  std::string name;  // the built-in one's, or the file as it was given
  std::string says;  // one line
  PhoneProfile processor;
  int64_t capture_ns = 0, display_ns = 0;  // of the processor's time, each frame
  // The camera; what is not told stays as a story has it.
  std::optional<int> width, height;
  std::optional<double> horizontal_fov_degrees, frames_per_s, readout_s, exposure_s;  // readout_s is signed
  RollingShutter::Axis readout_axis = RollingShutter::Axis::kColumns;
};

const std::vector<std::string>& phone_names();  // of the built-in ones

// A built-in phone's name, or a file. Throws InputError naming the file and what is wrong with it.
Phone load_phone(const std::string& name_or_file);
// A profile's text; name stands for it in messages.
Phone read_phone(const std::string& text, const std::string& name);

void use_camera(const Phone& phone, sim::PhoneOptions* options);
void use_processor(const Phone& phone, platform::RunOptions* options);

// The name of a kind of work in a profile: grey_pixel, ...
const char* work_name(Work kind);

}  // namespace pptam::laboratory
