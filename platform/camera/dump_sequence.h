// Writes what a camera delivers as a sequence on disk, for other programs and for replay.
#pragma once

#include <filesystem>
#include <functional>

#include "platform/camera.h"

namespace pptam::platform {

// Writes everything that the camera delivers in the TUM RGB-D layout: rgb/*.png, rgb.txt, groundtruth.txt and
// calibration.yaml (Kalibr's form with our readout keys), so that other programs can be run on it. Calls progress(done,
// total) after each frame. The folder must be new or empty.
void dump_sequence(Camera& camera, const std::filesystem::path& folder,
                   const std::function<void(int done, int total)>& progress);

}  // namespace pptam::platform
