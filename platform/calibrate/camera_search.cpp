#include "platform/calibrate/camera_search.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace pptam::platform {
namespace {

using Axis = RollingShutter::Axis;

constexpr int kMaxRounds = 4;
constexpr double kSettled_s = 0.002;    // change of the readout between rounds that ends them
constexpr double kSettledFocal = 0.01;  // likewise, of the focal length, relative
constexpr double kEnoughTracked = 0.5;  // of the clip, under an assumption that is good enough to begin with
constexpr double kOtherReadout = 0.6;   // of the time between two frames, tried when the clip's own is not

// Under the clip's own assumption; under others when it does not track by it.
TrackedClip first_clip(const std::function<TrackedClip(const CameraAssumption&)>& track,
                       const CameraFitOptions& options, const std::function<bool()>& stopped,
                       CameraAssumption* assumed) {
  TrackedClip best = track(*assumed);
  if (best.tracked >= kEnoughTracked || !options.readout) return best;
  const CameraModel model = best.camera.model;
  const double interval_s = best.camera.frames_per_s > 0 ? 1 / best.camera.frames_per_s : 1.0 / 30;
  for (const Axis axis : {Axis::kRows, Axis::kColumns}) {
    if (options.axes == (axis == Axis::kRows ? "columns" : "rows")) continue;
    for (const double share : {-kOtherReadout, kOtherReadout}) {
      if (stopped()) return best;
      const CameraAssumption other = {assumed->focal_factor, shutter_of(axis, share * interval_s, model)};
      TrackedClip clip = track(other);
      if (clip.tracked <= best.tracked) continue;
      best = std::move(clip);
      *assumed = other;
    }
  }
  return best;
}

// Whether a fit found what was assumed.
bool is_settled(const CameraFit& fit, const CameraInfo& assumed, const CameraFitOptions& options) {
  const double change_s = readout_change_s(fit, readout_of(assumed.shutter, assumed.model), assumed.shutter.axis);
  // What the clip cannot tell stays as it was assumed.
  return (!options.readout || !fit.readout_s.trouble.empty() || change_s < kSettled_s) &&
         (!options.focal || !fit.focal.trouble.empty() || std::abs(fit.focal.value - 1) < kSettledFocal);
}

}  // namespace

RollingShutter shutter_of(Axis axis, double readout_s, const CameraModel& model) {
  return {axis, static_cast<float>(readout_s / (axis == Axis::kColumns ? model.width : model.height))};
}

TrackedClip track_clip(Camera& camera, const RunOptions& options, const std::function<void(const RunLog&)>& on_frame) {
  TrackedClip clip;
  clip.camera = camera.info();
  const RunLog log = run_sequence(
      camera, options, [](const CameraInfo&) {},
      [&](const Frame&, const TrackResult& result, const RunLog& so_far) {
        clip.tracks.add(result);
        if (on_frame) on_frame(so_far);
      });
  clip.tracks.finish(log.map_points);
  clip.tracked = static_cast<double>(log.trajectory().size()) / std::max(1, log.source_frames);
  clip.reprojection_px = log.reprojection_px();
  clip.broken = log.broken;
  return clip;
}

CameraSearch search_camera(const std::function<TrackedClip(const CameraAssumption&)>& track,
                           const CameraFitOptions& options, const std::function<bool()>& stopped) {
  CameraSearch search;
  CameraAssumption assumed;
  TrackedClip clip = first_clip(track, options, stopped, &assumed);
  for (int round = 0; round < kMaxRounds && !stopped(); ++round) {
    if (round > 0) clip = track(assumed);
    search.broken = clip.broken;
    const CameraFit fit = fit_camera(clip.tracks, clip.camera.model, clip.camera.shutter, options);
    if (round == 0 || fit.trouble.empty()) search.fit = fit;
    if (!fit.trouble.empty()) break;  // under what was found last the clip does not track: that stays, unsettled
    search.rounds.push_back({clip.camera, clip.tracked, clip.reprojection_px, fit});
    search.settled = is_settled(fit, clip.camera, options);
    if (options.focal && fit.focal.trouble.empty()) assumed.focal_factor *= fit.focal.value;
    search.focal_factor = assumed.focal_factor;
    if (search.settled) break;
    if (options.readout && fit.readout_s.trouble.empty())
      assumed.shutter = shutter_of(fit.axis, fit.readout_s.value, clip.camera.model);
  }
  return search;
}

}  // namespace pptam::platform
