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

// What the report shows beside its plots; PNG files' contents, empty for none.
struct Pictures {
  std::string good_png;    // overlay.png
  bool video = false;      // whether overlay.mp4 lies beside it
  std::string ground_png;  // GroundView's, with its note
  std::string ground_note;
};

// report.html. Without gnuplot the plots are missing, and warnings says so.
std::string report_page(const RunLog& log, const RunSummary& summary, const Trajectory& truth, const Pictures& pictures,
                        std::vector<std::string>* warnings);

}  // namespace pptam::platform
