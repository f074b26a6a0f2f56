#include "mapping/keyframe_pose.h"

namespace pptam {

namespace {

// Points for a keyframe's pose at most: more would not make its velocity better known. Not swept.
constexpr int kMaxPosePoints = 250;
// ARMv6 instructions to look for a keyframe's measurement of one point, and for each of its measurements: estimates.
constexpr int64_t kGatherPointInstructions = 50, kGatherMeasurementInstructions = 20;

}  // namespace

KeyframePose::KeyframePose(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Background& background)
    : config_(config),
      map_(map),
      background_(background),
      points_(arena, kMaxPosePoints),
      updater_(arena, kMaxPosePoints, config.camera.shutter.line_time_s != 0, meter) {}

Task<> KeyframePose::gather(int keyframe, int most) {
  points_.clear();
  for (const MapPoint& point : map_.points()) {
    if (points_.size() >= most) break;
    if (point.id == 0) continue;
    co_await background_.spend(Work::kOther,
                               kGatherPointInstructions + kGatherMeasurementInstructions * point.measurements.size());
    for (const Measurement& m : map_.measurements(point)) {
      if (m.keyframe != keyframe) continue;
      points_.push_back({point.p_w, m.at});
      break;
    }
  }
}

void KeyframePose::gather(const NeighbourFrame& frame, int most) {
  points_.clear();
  for (const KeyframeMeasurement& m : frame.measurements) {
    const MapPoint& point = map_.points()[m.point];
    if (point.id != m.point_id || points_.size() >= most) continue;
    points_.push_back({point.p_w, m.at});
  }
}

Task<PoseUpdate> KeyframePose::find(const SE3& T_start, const VelocityPrior& prior) {
  const PosePoints points(config_.camera, points_);
  updater_.start(T_start, prior, points);
  while (!updater_.advance()) co_await background_.slice();
  co_return updater_.result();
}

VelocityPrior KeyframePose::prior_of(const Keyframe& keyframe, const Vector6f& mean) const {
  VelocityPrior prior;
  prior.mean = mean;
  prior.sigma_translation = kVelocitySigmaTranslation * keyframe.mean_depth;
  prior.sigma_rotation = kVelocitySigmaRotation;
  return prior;
}

Task<> KeyframePose::update_velocities() {
  if (config_.camera.shutter.line_time_s == 0) co_return;
  for (int k = 0; k < map_.keyframes().size(); ++k) {
    const Keyframe& keyframe = map_.keyframes()[k];
    if (!keyframe.live()) continue;
    co_await gather(k, points_.capacity());
    const PoseUpdate update = co_await find(keyframe.T_kw, prior_of(keyframe, keyframe.velocity_prior));
    if (update.ok) map_.set_velocity(k, update.velocity);
    co_await background_.slice();
  }
}

}  // namespace pptam
