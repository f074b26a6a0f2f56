// COLMAP's cameras.txt: a camera a line. Its pixel centres lie half a pixel further than ours: the image's corner is
// (0, 0) there.
#pragma once

#include <string>
#include <vector>

#include <pocket_ptam/camera_model.h>

namespace pptam::platform {

bool is_colmap(const std::string& text);

// Of the first camera, not validated; a warning when there are more. Throws InputError, also for lenses that are not
// supported.
CameraModel read_colmap_lens(const std::string& text, const std::string& file, std::vector<std::string>* warnings);

}  // namespace pptam::platform
