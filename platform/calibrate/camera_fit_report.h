// report.html of a camera's fit: how well each readout and each focal length fits.
#pragma once

#include <string>
#include <vector>

#include "platform/calibrate/camera_fit.h"

namespace pptam::platform {

struct CameraFitPage {
  std::string name, command, version;
};

// Without gnuplot there are no curves, and a warning.
std::string camera_fit_page(const CameraFitPage& page, const CameraFit& fit, std::vector<std::string>* warnings);

}  // namespace pptam::platform
