// What a run amounts to in pictures: report.html, one self-contained file; plots by gnuplot.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "platform/run/evaluation.h"
#include "platform/run/run_log.h"
#include "platform/run/summary.h"

namespace pptam::platform {

// Estimate and truth from above and from the side, after alignment, as SVG. Throws InputError without gnuplot.
std::string plot_trajectories(const Evaluation& evaluation, const Trajectory& truth);

// Shows folder/overlay.png and links folder/overlay.mp4 when they are there. Without gnuplot the plots are missing, and
// warnings says so.
void write_report(const std::filesystem::path& folder, const RunLog& log, const RunSummary& summary,
                  const Trajectory& truth, std::vector<std::string>* warnings);

}  // namespace pptam::platform
