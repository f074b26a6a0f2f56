// The lens from views of the board: which distortion, which views to leave out, and whether to believe the result.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "platform/calibrate/board_views.h"
#include "platform/calibrate/board_vision.h"

namespace pptam::platform {

struct LensFit {
  LensSolution solution;
  CameraModel model;                // prepared
  std::vector<BoardView> views;     // those that count, as of solution.predicted
  std::vector<int> left_out;        // frames of views that do not fit the others
  double rms_px = 0;                // over both coordinates, as OpenCV tells it
  std::vector<double> view_rms_px;  // likewise, of each view
  // One standard deviation of where the lens shows a direction, pixels, in the part of the image where it is worst,
  // once a turn of the camera has taken up what it can: from the lenses that four fifths of the views give (jackknife).
  // Nothing: too few views.
  std::optional<double> uncertain_px;
  std::vector<std::string> warnings;  // each with its remedy
};

// kind: nothing chooses the simplest that fits as well as the others. Throws InputError that says what to add or to
// change when the views do not tell, or what they tell is absurd.
LensFit fit_lens(const Board& board, int width, int height, std::vector<BoardView> views, const Coverage& coverage,
                 const BoardVision& vision, std::optional<LensKind> kind);

// As --lens takes it: normal, wide, fisheye.
const char* name_of(LensKind kind);
// In the core's terms; not validated.
CameraModel model_of(const LensSolution& solution, int width, int height);
// The largest distance over the image between where two cameras show the same direction, pixels, after the turn between
// them that makes it least in the mean. Both prepared.
double largest_difference_px(const CameraModel& a, const CameraModel& b);

}  // namespace pptam::platform
