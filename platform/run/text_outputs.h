// A run's results as texts for other programs.
#pragma once

#include <span>
#include <string>

#include <pocket_ptam/pocket_ptam.h>
#include "platform/run/run_log.h"

namespace pptam::platform {

// Points with normals, grey values and numbers of measurements, for MeshLab or CloudCompare; sealed
// (platform/outputs.h).
std::string ply_text(std::span<const MapPointInfo> points);

// frames.csv: a line for each frame.
std::string frames_text(const RunLog& log);

}  // namespace pptam::platform
