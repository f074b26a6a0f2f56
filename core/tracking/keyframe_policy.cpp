#include "tracking/keyframe_policy.h"

#include <algorithm>

namespace pptam {

namespace {

// Distance to the nearest keyframe that calls for a new one, in mean depths. It grows with the number of keyframes: a
// new map needs baselines soon, a full one must not grow. Not swept. Smaller values fill the map sooner.
constexpr float kDistanceNew = 0.004f, kDistanceFull = 0.18f;
// Where few points will stay in view a new keyframe is wanted sooner, from this distance on, in mean depths. Few: less
// than this share of Config::max_measured_points. Not swept. Only inliers count: of a video of a cube on a table, in
// which six of ten points in view are found, 91 to 100 % of the frames were tracked when all points in view counted,
// and 98 to 100 % since (eleven starts).
constexpr float kMinDistance = 0.004f;
constexpr float kSparseViewFraction = 0.6f;
// Interval of keyframes, s, while the map is full: each costs a culling decision. Not swept.
constexpr float kFullInterval_s = 2.0f;
// Inliers that will stay in view under which the view is being replaced, and the interval of keyframes then, in those
// of Config::min_keyframe_interval_s. Of four emulated runs that replace the view within a second, frames tracked: 85 %
// of the worst without, 97 % with half of the interval; a third gave worse maps.
constexpr int kUrgentStaying = 15;
constexpr float kUrgentInterval = 0.5f;
constexpr float kCosTurn = 0.98f;  // optical axes within 11.5 degrees: views turned by more are not near; not swept
constexpr float kNoneNear = 1e9f;  // distance in world units when no keyframe is near
// ARMv6, as counted: a keyframe's distance, and a point looked for half a second ahead (MapMatching::staying).
constexpr int64_t kDistanceInstructions = 100, kStayingInstructions = 150;
constexpr int kMinBelievedForKeyframe = 2;  // believed poses in a row, so that the motion is known

}  // namespace

bool KeyframePolicy::wants(int64_t timestamp_ns, const MotionModel& motion, int staying) const {
  meter_.charge(Work::kOther,
                kStayingInstructions * config_.max_measured_points + kDistanceInstructions * map_.keyframes().size());
  if (!map_.queue().can_hold()) return false;
  float interval_s = config_.min_keyframe_interval_s;
  if (map_.full()) {
    interval_s = std::max(kFullInterval_s, interval_s);
  } else if (staying < kUrgentStaying) {
    interval_s *= kUrgentInterval;
  }
  if (elapsed_s(last_ns_, timestamp_ns) < interval_s) return false;
  if (motion.believed() < kMinBelievedForKeyframe) return false;
  const Vector3f centre = motion.T_cw().centre();
  const Vector3f axis = motion.T_cw().R.row(2).transpose();
  // Distance to the nearest keyframe whose optical axis has nearly the same direction.
  float nearest_alike = kNoneNear;
  const auto consider = [&](const SE3& T_kw) {
    const float distance = (T_kw.centre() - centre).norm();
    if (axis.dot(T_kw.R.row(2).transpose()) > kCosTurn) nearest_alike = std::min(nearest_alike, distance);
  };
  for (const Keyframe& keyframe : map_.keyframes())
    if (keyframe.id != 0) consider(keyframe.T_kw);  // erased keyframes too [phone 3.3, footnote]
  for (int i = 0; i < map_.queue().waiting(); ++i) consider(map_.queue().waiting(i).frame.T_kw);
  const bool sparse =
      static_cast<float>(staying) < kSparseViewFraction * static_cast<float>(config_.max_measured_points);
  const float fill = static_cast<float>(map_.live_count()) / static_cast<float>(map_.max_live());
  const float far = kDistanceNew + (kDistanceFull - kDistanceNew) * fill;
  if (nearest_alike > far * motion.mean_depth()) return true;
  return sparse && nearest_alike > kMinDistance * motion.mean_depth();
}

void KeyframePolicy::hold(const FrameInput& input, const MotionModel& motion, std::span<const Attempt> attempts) {
  KeyframeCandidate& candidate = map_.queue().hold();
  Keyframe& frame = candidate.frame;
  frame.timestamp_ns = input.timestamp_ns();
  frame.T_kw = motion.T_cw();
  frame.velocity = motion.readout_velocity();
  frame.velocity_prior = motion.last_motion();  // until release() knows the central difference
  frame.mean_depth = motion.mean_depth();
  frame.set_images(input.pyramid(), input.small());
  const CameraModel& model = config_.camera.model;
  // A pyramid has 4/3 of level 0's pixels, and two of them are a unit.
  meter_.charge(Work::kKeyframePixel, static_cast<int64_t>(model.width) * model.height * 2 / 3);
  for (const Attempt& attempt : attempts)
    if (attempt.outcome == Attempt::Outcome::kInlier)
      candidate.measurements.push_back({attempt.point, map_.points()[attempt.point].id, attempt.at});
  last_ns_ = input.timestamp_ns();
}

void KeyframePolicy::release_unmeasured() {
  if (map_.queue().holding()) map_.queue().release();
}

void KeyframePolicy::release(const MotionModel& motion) {
  if (!map_.queue().holding()) return;
  if (motion.central_velocity_known()) map_.queue().held().frame.velocity_prior = motion.central_velocity();
  map_.queue().release();
}

}  // namespace pptam
