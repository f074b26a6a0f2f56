// Calibrations written as OpenCV's XML, as the tree that YAML would give.
#pragma once

#include <yaml-cpp/yaml.h>

#include <string>

namespace pptam::platform {

// What is inside the root element. Throws InputError naming the file, also for XML of other programs.
YAML::Node parse_calibration_xml(const std::string& text, const std::string& file);

}  // namespace pptam::platform
