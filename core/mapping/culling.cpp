#include "mapping/culling.h"

#include <algorithm>

namespace pptam {

namespace {

// Lower triangle of a symmetric 3x3 matrix.
struct Symmetric3 {
  float xx = 0, yx = 0, yy = 0, zx = 0, zy = 0, zz = 0;
  float determinant() const { return xx * (yy * zz - zy * zy) - yx * (yx * zz - zx * zy) + zx * (yx * zy - zx * yy); }
};

constexpr float kNoneNear = 1e9f;  // view distance of a keyframe that has no other

// ARMv6 instructions, as counted for the ARM1176.
constexpr int64_t kViewDistanceInstructions = 145;  // of Map::view_distance() for two keyframes
// ARMv6 instructions, estimates.
constexpr int64_t kErasePointInstructions = 35;   // of one slot of map points, when a keyframe is erased
constexpr int64_t kForgetPointInstructions = 15;  // of one slot of points, when a keyframe is forgotten
constexpr int64_t kCountPatchInstructions = 8;    // of one slot of points, to count the patches of keyframes

}  // namespace

void measure_usefulness(const Map& map, const Camera& camera, const MapPoint& point, float* m) {
  const int count = point.measurements.size();
  if (count == 0) return;
  // Lengths are divided by a typical depth: V_j is of order 1 / sigma^2 then, and |V| stays within float32's range.
  const float depth = map.keyframes()[map.measurements(point)[0].keyframe].mean_depth;
  const float aspect = camera.model.fy / camera.model.fx;
  Symmetric3 V_j[kMaxMeasurementsPerPoint + 1], V;
  int next = 0;
  for (const Measurement& measurement : map.measurements(point)) {
    Symmetric3& A = V_j[next++];
    const SE3& T_kw = map.keyframes()[measurement.keyframe].T_kw;
    const Vector3f p_k = T_kw * point.p_w;
    if (!(p_k.z() > 0)) continue;
    const float inverse_z = 1.0f / p_k.z();
    const float u = p_k.x() * inverse_z, v = p_k.y() * inverse_z;
    const float scale = depth * inverse_z / measurement.at.sigma();
    const float s = measurement.weight * scale * scale;
    float a[3], b[3];  // rows of B_j, whose common factor is in s
    for (int i = 0; i < 3; ++i) {
      a[i] = T_kw.R(0, i) - u * T_kw.R(2, i);
      b[i] = aspect * (T_kw.R(1, i) - v * T_kw.R(2, i));
    }
    A.xx = s * (a[0] * a[0] + b[0] * b[0]);
    A.yx = s * (a[1] * a[0] + b[1] * b[0]);
    A.yy = s * (a[1] * a[1] + b[1] * b[1]);
    A.zx = s * (a[2] * a[0] + b[2] * b[0]);
    A.zy = s * (a[2] * a[1] + b[2] * b[1]);
    A.zz = s * (a[2] * a[2] + b[2] * b[2]);
    V.xx += A.xx, V.yx += A.yx, V.yy += A.yy, V.zx += A.zx, V.zy += A.zy, V.zz += A.zz;
  }
  const float all = V.determinant();
  for (int j = 0; j < count; ++j) {
    const Symmetric3& A = V_j[j];
    m[j] = all - Symmetric3{V.xx - A.xx, V.yx - A.yx, V.yy - A.yy, V.zx - A.zx, V.zy - A.zy, V.zz - A.zz}.determinant();
  }
}

void cull_measurements(Map& map, int index, const Camera& camera, WorkMeter& meter) {
  const MapPoint& point = map.points()[index];
  while (point.measurements.size() > map.max_measurements_per_point()) {
    float m[kMaxMeasurementsPerPoint + 1];
    measure_usefulness(map, camera, point, m);
    meter.charge(Work::kOther, kUsefulnessInstructions * point.measurements.size());
    int worst = -1, j = 0;
    for (const Measurement& measurement : map.measurements(point)) {
      if (measurement.keyframe != point.source.keyframe && (worst < 0 || m[j] < m[worst])) worst = j;
      ++j;
    }
    map.remove_measurement(index, worst);
  }
}

KeyframeEraser::KeyframeEraser(Arena& arena, const Config& config, Map& map, Background& background)
    : config_(config),
      map_(map),
      background_(background),
      patches_(arena, keyframe_slots(config.max_keyframes, config.max_erased_keyframes)) {}

Task<> KeyframeEraser::erase(int keyframe) {
  const int64_t anchoring = kViewDistanceInstructions * map_.live_count();
  // Keyframes anchored to it are anchored to others first, one at a time, so that slices stay short.
  for (int k = 0; k < map_.keyframes().size(); ++k) {
    const Keyframe& other = map_.keyframes()[k];
    if (other.id == 0 || !other.erased || other.anchor != keyframe) continue;
    map_.anchor_keyframe(k, keyframe);
    co_await background_.spend(Work::kOther, anchoring);
  }
  map_.erase_keyframe(keyframe);
  co_await background_.spend(Work::kOther, kErasePointInstructions * map_.points().size() + anchoring);
}

Task<> KeyframeEraser::forget_surplus() {
  if (map_.erased_count() <= config_.max_erased_keyframes) co_return;
  const int forgotten = co_await choose_forgotten();
  const auto sources = static_cast<int64_t>(patches_[forgotten]);
  map_.forget_keyframe(forgotten);
  co_await background_.spend(Work::kOther,
                             kForgetPointInstructions * (map_.points().size() + map_.partial_points().size()) +
                                 sources * config_.max_measurements_per_point * kViewDistanceInstructions);
}

Task<int> KeyframeEraser::choose_forgotten() {
  patches_.resize(map_.keyframes().size());
  std::fill(patches_.begin(), patches_.end(), 0.0f);
  for (const MapPoint& point : map_.points())
    if (point.id != 0) patches_[point.source.keyframe] += 1;
  for (const PartialPoint& partial : map_.partial_points())
    if (partial.id != 0) patches_[partial.source.keyframe] += 1;
  co_await background_.spend(Work::kOther,
                             kCountPatchInstructions * (map_.points().size() + map_.partial_points().size()));
  int forgotten = -1;
  float least = 0;
  for (int k = 0; k < map_.keyframes().size(); ++k) {
    const Keyframe& keyframe = map_.keyframes()[k];
    if (keyframe.id == 0 || !keyframe.erased) continue;
    float nearest = kNoneNear;
    for (int other = 0; other < map_.keyframes().size(); ++other)
      if (other != k && map_.keyframes()[other].id != 0)
        nearest = std::min(nearest, Map::view_distance(keyframe, map_.keyframes()[other]));
    const float value = nearest * (1 + patches_[k]);
    if (forgotten < 0 || value < least) {
      forgotten = k;
      least = value;
    }
    co_await background_.spend(Work::kOther, kViewDistanceInstructions * map_.keyframes().size());
  }
  co_return forgotten;
}

}  // namespace pptam
