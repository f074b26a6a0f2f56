// What a calibration looks like: pictures of what was covered and of the residuals, and report.html.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "platform/calibrate/board_views.h"
#include "platform/calibrate/lens_fit.h"
#include "platform/calibrate/readout_fit.h"
#include "platform/run/summary.h"

namespace pptam::platform {

// PNG: where in the image the board was seen, in how many views, and how it was tilted; what is missing in red.
std::string coverage_png(const Board& board, int width, int height, const std::vector<BoardView>& views);

// PNG: what is left between the corners and where the lens shows them, over the image and as a cloud.
std::string residuals_png(const LensFit& fit);

struct CalibrationReport {
  std::string name, command, version;
  std::vector<SummaryRow> rows;
  std::vector<std::string> advice;  // what would make it better
  std::string coverage_png, residuals_png;
  const LensFit* lens = nullptr;        // null: not solved here
  const ReadoutFit* readout = nullptr;  // null: no moving clip
};

// report.html. Without gnuplot there is no curve of the readout, and a warning.
std::string calibration_page(const CalibrationReport& report, std::vector<std::string>* warnings);

}  // namespace pptam::platform
