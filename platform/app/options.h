// Options that several commands share, and what their values mean.
#pragma once

#include <CLI/CLI.hpp>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "platform/camera/recorded_camera.h"
#include "platform/run/run.h"
#include "platform/run/screen_show.h"
#include "sim_phone/laboratory/phone_profile.h"

namespace pptam::app {

// What becomes of a run's results.
struct OutputOptions {
  std::string out;
  std::string save_map;
  std::string trace;  // file; empty: none
  bool no_overlay = false;
  bool no_report = false;
  bool no_progress = false;  // the run shows its own
  platform::ShowOptions show;
};
void add_run_options(CLI::App* command, platform::RunOptions* run, OutputOptions* output);
// --trace.
void add_trace_option(CLI::App* command, platform::RunOptions* run, OutputOptions* output);
// --phone: its processor into run too.
void add_phone_option(CLI::App* command, platform::RunOptions* run, std::optional<laboratory::Phone>* phone);
std::string phone_option_says();
// --show and what belongs to it.
void add_show_options(CLI::App* command, platform::ShowOptions* show);
// May be repeated.
void add_tap_option(CLI::App* command, platform::RunOptions* run);
void add_ground_option(CLI::App* command, platform::RunOptions* run);

// A recording as named on the command line.
struct RecordingInput {
  platform::RecordingOptions options;
  std::string source, calibration, resize;

  platform::RecordingOptions recording() const;  // throws InputError on a size that is none
  // Opens it and prints its warnings. Throws InputError.
  std::unique_ptr<platform::Camera> open(const platform::RecordingOptions& recording,
                                         std::vector<std::string>* warnings) const;
};
void add_recording_options(CLI::App* command, RecordingInput* input);

struct Readout {
  RollingShutter::Axis axis = RollingShutter::Axis::kRows;
  double seconds = 0;  // signed
};
// "rows:+:0.03". Throws InputError.
Readout parse_readout(const std::string& text);
// "320x240"; option names what it was given to. Throws InputError.
void parse_size(const std::string& option, const std::string& text, int* width, int* height);

}  // namespace pptam::app
