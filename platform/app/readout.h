// Finds a recording's rolling shutter by trying: the recording is tracked under many assumptions, and the one under
// which the tracked frames' points fit best is it. Frames tell more than the finished map's objective (System::map_fit,
// printed beside): there are many more frames than keyframes.
#pragma once

#include <string>

#include "platform/camera/recorded_camera.h"
#include "platform/run/run.h"

namespace pptam::app {

struct ReadoutOptions {
  platform::RecordingOptions recording;
  platform::RunOptions run;
  std::string axes = "both";  // rows, columns or both
  int jobs = 1;
};

// Prints each trial and what to write for --readout. False when too few trials gave a map.
bool find_readout(const ReadoutOptions& options);

}  // namespace pptam::app
