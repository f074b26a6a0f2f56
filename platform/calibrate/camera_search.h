// Finds a camera from a clip: the clip is tracked under an assumption, what its tracks say of the camera is assumed
// next, until it stays. Under a wrong assumption fewer points are found, and those that fit it.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "platform/calibrate/camera_fit.h"
#include "platform/camera.h"
#include "platform/run/run.h"

namespace pptam::platform {

struct CameraAssumption {
  double focal_factor = 1;                // of the clip's own focal lengths
  std::optional<RollingShutter> shutter;  // of the images as tracked; empty: the clip's own
};

struct TrackedClip {
  CameraInfo camera;  // as assumed
  PointTracks tracks;
  double tracked = 0;  // share of its frames
  double reprojection_px = 0;
  std::string broken;  // what ended the clip too early
};

// One run over a camera's frames. on_frame: after each of them, or null.
TrackedClip track_clip(Camera& camera, const RunOptions& options, const std::function<void(const RunLog&)>& on_frame);

struct CameraSearch {
  struct Round {
    CameraInfo camera;  // as assumed
    double tracked = 0, reprojection_px = 0;
    CameraFit fit;
  };
  std::vector<Round> rounds;  // with a fit
  CameraFit fit;              // the last one; that which failed when none did better
  double focal_factor = 1;    // found, of the clip's own
  bool settled = false;       // the last round found what it had assumed
  std::string broken;
};

// track: the whole clip under an assumption. stopped: asked between runs.
CameraSearch search_camera(const std::function<TrackedClip(const CameraAssumption&)>& track,
                           const CameraFitOptions& options, const std::function<bool()>& stopped);

// The shutter that has a readout of so many signed seconds.
RollingShutter shutter_of(RollingShutter::Axis axis, double readout_s, const CameraModel& model);

}  // namespace pptam::platform
