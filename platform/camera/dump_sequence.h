// Writes what a camera delivers as a sequence on disk, for other programs and for replay.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>

#include "platform/camera.h"

namespace pptam::platform {

// Writes everything that the camera delivers in the TUM RGB-D layout: rgb/*.png, rgb.txt, groundtruth.txt and
// calibration.yaml (Kalibr's form with our readout keys), so that other programs can be run on it. Calls go_on(done,
// total) once the folder is there and after each frame: false ends it like the camera's end. The folder must be new or
// empty. Throws InputError; what was written until then is a shorter sequence, if the list could still be written.
void dump_sequence(Camera& camera, const std::filesystem::path& folder,
                   const std::function<bool(int done, int total)>& go_on);

// A frame's time in its image's name and in rgb.txt: "12.345678901".
std::string timestamp_name(int64_t timestamp_ns);

}  // namespace pptam::platform
