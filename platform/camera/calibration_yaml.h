// Calibrations written in YAML or JSON: lists that no calibration needs are left out before the parser sees them.
#pragma once

#include <yaml-cpp/yaml.h>

#include <string>

namespace pptam::platform {

// The root of the first document. Throws InputError naming the file.
YAML::Node parse_calibration_yaml(const std::string& text, const std::string& file);

}  // namespace pptam::platform
