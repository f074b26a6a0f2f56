// What a run amounts to in pictures: report.html, one self-contained page; plots by gnuplot.
#pragma once

#include <string>
#include <vector>

#include "platform/run/evaluation.h"
#include "platform/run/run_log.h"
#include "platform/run/summary.h"

namespace pptam::platform {

// Estimate and truth from above and from the side, after alignment, as SVG. Throws InputError without gnuplot.
std::string plot_trajectories(const Evaluation& evaluation, const Trajectory& truth);

// report.html. still: overlay.png's content, or empty; video: overlay.mp4 lies beside it. Without gnuplot the plots are
// missing, and warnings says so.
std::string report_page(const RunLog& log, const RunSummary& summary, const Trajectory& truth, const std::string& still,
                        bool video, std::vector<std::string>* warnings);

}  // namespace pptam::platform
