// The rolling shutter's readout from a moving clip of the board, with a lens that is known.
//
// A corner is exposed when its line is: at t + readout (line - middle) / lines. For a readout assumed, each frame's
// pose is found by least squares, its corners being seen from where the camera was at their lines' times; that motion
// is the polynomial through the poses of the frames before and after. The readout under which the corners fit best is
// it: the minimum of a parabola. How far it can be trusted is told by leaving out a tenth of the clip at a time
// (jackknife).
#pragma once

#include <string>
#include <vector>

#include "platform/calibrate/board_views.h"
#include "platform/calibrate/readout_plot.h"

namespace pptam::platform {

struct ReadoutFit {
  std::string trouble;  // why this clip cannot tell, and what to do; empty: it does
  RollingShutter::Axis axis = RollingShutter::Axis::kRows;
  double readout_s = 0;              // signed: positive when larger coordinates are exposed later
  double sigma_s = 0;                // one standard deviation
  bool global = false;               // that is as of a global shutter: nothing, and known well enough to say so
  double rms_px = 0;                 // of the corners, under that readout
  double global_px = 0;              // and under a global shutter
  int frames = 0;                    // that took part
  double speed_px_s = 0;             // of the corners, median of these frames
  std::vector<ReadoutTrial> trials;  // for a plot: rows first, readouts rising
};

// clip: of every frame (LookOptions). model: prepared, of the same size. axes: "rows", "columns" or "both".
ReadoutFit fit_readout(const Board& board, const BoardViews& clip, const CameraModel& model, const std::string& axes);

}  // namespace pptam::platform
