// A run's results as text files for other programs.
#pragma once

#include <filesystem>
#include <span>

#include <pocket_ptam/pocket_ptam.h>
#include "platform/run/run_log.h"

namespace pptam::platform {

// Points with normals, grey values and numbers of measurements, as a text file for MeshLab or CloudCompare.
void write_ply(const std::filesystem::path& file, std::span<const MapPointInfo> points);

// trajectory.txt, keyframes.txt, map.ply and frames.csv. Throws InputError when one cannot be written.
void write_text_outputs(const RunLog& log, const std::filesystem::path& folder);

}  // namespace pptam::platform
