// The curve of residuals over the readout that is assumed.
#pragma once

#include <string>
#include <vector>

#include <pocket_ptam/camera_model.h>

namespace pptam::platform {

struct ReadoutTrial {
  RollingShutter::Axis axis;
  double readout_s, rms_px;
};

// SVG; trials: by axis, readouts rising; what: whose residuals. Throws InputError without gnuplot.
std::string readout_plot(const std::vector<ReadoutTrial>& trials, double best_s, const std::string& what);

}  // namespace pptam::platform
