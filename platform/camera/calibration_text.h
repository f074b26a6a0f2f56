// The tree of keys and values that a calibration file holds: YAML, JSON or OpenCV's XML.
//
// Any bytes may come: lists that no calibration needs (found corners, images) are emptied before anything is parsed, in
// one pass, so that parsing takes little time and memory at any size of the file; depth is bounded.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "platform/camera/calibration_section.h"

namespace pptam::platform {

// The text of a calibration file from its bytes; spaces of other kinds become plain ones. Throws InputError that says
// what else the file seems to be.
std::string calibration_text(std::vector<std::byte> bytes, const std::string& file);

// The text's root. Throws InputError.
CalibrationSection parse_calibration(const std::string& text, const std::string& file,
                                     std::vector<std::string>* warnings);

}  // namespace pptam::platform
