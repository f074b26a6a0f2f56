#include <pocket_ptam/inspection.h>
#include "camera/pose_update.h"
#include "geometry/robust.h"
#include "map/map.h"

namespace pptam {

namespace {

// Scale of map_fit()'s Tukey cost, units of a measurement's sigma: half a pixel of level 0 for measurements of level 1.
// Fixed, so that maps can be compared.
constexpr float kScale = 0.25f;
constexpr float kUnseen = 1e12f;  // squared error of a measurement that does not project: its cost is saturated

}  // namespace

MapFit map_fit(const System& system) {
  const Map& map = system.map();
  const Camera& camera = system.config().camera;
  MapFit fit;
  double sum = 0;
  for (const MapPoint& point : map.points()) {
    if (point.id == 0) continue;
    for (const Measurement& m : map.measurements(point)) {
      const Keyframe& keyframe = map.keyframes()[m.keyframe];
      const float dt_s = camera.dt_s(m.at.px);
      Vector2f px;
      float error_sq = kUnseen;
      if (camera.project(moved_point(keyframe.T_kw * point.p_w, keyframe.velocity, dt_s), &px))
        error_sq = (m.at.px - px).squaredNorm() / (m.at.sigma() * m.at.sigma());
      sum += static_cast<double>(tukey_cost(error_sq, kScale));
      ++fit.measurements;
    }
  }
  if (fit.measurements == 0) return fit;
  if (camera.shutter.line_time_s != 0) {
    for (const Keyframe& keyframe : map.keyframes()) {
      if (!keyframe.live()) continue;
      const Vector6f difference = keyframe.velocity - keyframe.velocity_prior;
      const float translation =
          difference.head<3>().squaredNorm() /
          (kVelocitySigmaTranslation * kVelocitySigmaTranslation * keyframe.mean_depth * keyframe.mean_depth);
      const float rotation = difference.tail<3>().squaredNorm() / (kVelocitySigmaRotation * kVelocitySigmaRotation);
      sum += static_cast<double>(0.5f * kScale * kScale * (translation + rotation));
    }
  }
  fit.cost = static_cast<float>(sum / fit.measurements);
  return fit;
}

int map_parts(const System& system, int common_points) {
  const Map& map = system.map();
  const auto common = [&map](int a, int b) {
    int count = 0;
    for (const MapPoint& point : map.points()) {
      int seen = 0;
      for (const Measurement& m : map.measurements(point)) seen += m.keyframe == a || m.keyframe == b;
      count += seen == 2;
    }
    return count;
  };
  int16_t reached[kMaxKeyframeSlots];  // keyframes in the order in which they were reached
  bool done[kMaxKeyframeSlots] = {};
  int parts = 0;
  for (int start = 0; start < map.keyframes().size(); ++start) {
    if (!map.keyframes()[start].live() || done[start]) continue;
    ++parts;
    int count = 0;
    reached[count++] = static_cast<int16_t>(start);
    done[start] = true;
    for (int next = 0; next < count; ++next) {
      for (int k = 0; k < map.keyframes().size(); ++k) {
        if (!map.keyframes()[k].live() || done[k] || common(reached[next], k) < common_points) continue;
        done[k] = true;
        reached[count++] = static_cast<int16_t>(k);
      }
    }
  }
  return parts;
}

uint64_t map_hash(const System& system) {
  return system.map().hash();
}

}  // namespace pptam
