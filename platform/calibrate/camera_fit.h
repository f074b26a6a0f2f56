// A camera's field of view and rolling shutter from what a run has tracked, without a board (self-calibration).
//
// The map points' positions in the images do not depend much on what the tracker believed of the camera: they were
// found by their patches. For a focal length and a readout assumed, all poses and points are adjusted to one fixed set
// of them (bundle adjustment; the frames are eliminated, since they outnumber the points), each line being seen from
// where the camera was at its time: the polynomial through the poses of the frames before and after. What fits best is
// it. How far a readout can be trusted is told by leaving out a tenth of the clip at a time (jackknife), a focal length
// by the least squares' own covariance.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <vector>

#include <pocket_ptam/pocket_ptam.h>
#include "platform/calibrate/motion_curve.h"

namespace pptam::platform {

// What a run has tracked: where it saw its map's points.
struct PointTracks {
  struct Sighting {
    uint32_t point = 0;  // id
    Vector2f px = Vector2f::Zero();
    float sigma = 1;  // level-0 pixels
  };
  struct View {
    TimedPose pose;  // world to camera
    std::vector<Sighting> seen;
  };
  static constexpr size_t kMaxViews = 900;     // so many to twice as many are kept, the latest: a minute or two
  std::vector<View> views;                     // in the order of time
  std::map<uint32_t, Eigen::Vector3d> points;  // by id; sightings of others count for nothing

  void add(const TrackResult& result);                    // of every frame
  void finish(std::span<const MapPointInfo> map_points);  // of the map at the end: sightings of other points go
};

struct CameraFitOptions {
  bool focal = false, readout = true;  // which of them are unknown
  std::string axes = "both";           // rows, columns or both
  bool curves = true;                  // try many readouts and focal lengths, for a plot
  int max_points = 150;                // those seen most often; the cost grows with their cube
};

struct CameraFit {
  struct Estimate {
    double value = 0, sigma = 0;  // sigma: one standard deviation
    std::string trouble;          // why this clip cannot tell it, and what to do; empty: it does
  };
  struct Trial {
    RollingShutter::Axis axis;
    double readout_s, focal, rms_px;
  };

  std::string trouble;  // there is too little to fit anything; empty: the rest holds
  RollingShutter::Axis axis = RollingShutter::Axis::kRows;
  Estimate readout_s;                // signed: positive when larger coordinates are exposed later
  Estimate focal;                    // relative to the model's
  bool global = false;               // the readout is none, and known well enough to say so
  double rms_px = 0, global_px = 0;  // of a coordinate, robust, under the best readout and under a global shutter
  double interval_s = 0;             // between two frames
  int frames = 0, points = 0;
  std::vector<Trial> readouts, focals;  // each with all else adjusted; by axis and value, rising
};

// Signed seconds of a whole readout.
double readout_of(const RollingShutter& shutter, const CameraModel& model);
// By how much a fit's readout differs from another one; along another axis nothing is common.
double readout_change_s(const CameraFit& fit, double assumed_s, RollingShutter::Axis assumed_axis);

// model: what the run was tracked with. shutter: likewise, what holds where the readout is not unknown.
CameraFit fit_camera(const PointTracks& tracks, const CameraModel& model, const RollingShutter& shutter,
                     const CameraFitOptions& options);

// Whether a run's tracks contradict the camera that it was told of; cheap when they do not.
struct CameraDoubts {
  bool focal = false, readout = false;  // contradicted
  CameraFit fit;                        // what fits better; only where one of them is
};
CameraDoubts doubt_camera(const PointTracks& tracks, const CameraModel& model, const RollingShutter& shutter);

}  // namespace pptam::platform
