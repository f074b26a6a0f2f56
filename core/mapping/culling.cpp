#include "mapping/culling.h"

#include <algorithm>

namespace pptam {

namespace {

// Lower triangle of a symmetric 3x3 matrix.
struct Symmetric3 {
  float xx = 0, yx = 0, yy = 0, zx = 0, zy = 0, zz = 0;
  float determinant() const { return xx * (yy * zz - zy * zy) - yx * (yx * zz - zx * zy) + zx * (yx * zy - zx * yy); }
};

constexpr int kProtectedKeyframes = 2;  // newest keyframes that are never erased: their corners are not found again yet
constexpr float kNoneNear = 1e9f;       // view distance of a keyframe that has no other

// ARMv6 instructions of the parts of a decision. Their sum is as counted for the ARM1176 (tests/budget); the shares
// follow the compiled code.
constexpr int64_t kUsefulnessInstructions = 210;    // of one measurement
constexpr int64_t kVoteInstructions = 40;           // of one measurement
constexpr int64_t kPairInstructions = 34;           // of two measurements: their order, and the count of common points
constexpr int64_t kPointInstructions = 120;         // of one map point
constexpr int64_t kViewDistanceInstructions = 145;  // of Map::view_distance() for two keyframes
// ARMv6 instructions, estimates.
constexpr int64_t kSlotInstructions = 10;         // of one keyframe slot, to set the votes to zero
constexpr int64_t kEdgeInstructions = 17;         // of one pair of keyframes, in the search for connected parts
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

float keyframe_vote(int observers, int rank) {
  if (observers == 2) return 0.5f;
  const int o = std::min(observers, 4);  // the four best ranks share a point's vote [phone 3.3]
  return static_cast<float>(std::max(0, o - (rank - 1))) / static_cast<float>(o * (o + 1) / 2);
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

UsefulnessCulling::UsefulnessCulling(Arena& arena, const Config& config, Map& map, WorkMeter& meter,
                                     Background& background)
    : config_(config),
      map_(map),
      meter_(meter),
      background_(background),
      live_(arena, config.max_keyframes + 1),
      place_(arena, keyframe_slots(config.max_keyframes, config.max_erased_keyframes)),
      votes_(arena, keyframe_slots(config.max_keyframes, config.max_erased_keyframes)),
      judged_(arena, keyframe_slots(config.max_keyframes, config.max_erased_keyframes)),
      common_(arena, (config.max_keyframes + 1) * (config.max_keyframes + 1)),
      reached_(arena, config.max_keyframes + 1),
      frontier_(arena, config.max_keyframes + 1) {}

Task<int> UsefulnessCulling::choose() {
  co_await count_votes();
  // Number of common points that makes an edge of the keyframe graph: the largest one, up to kMinCommonPoints, at which
  // the graph has as few parts as with edges of one common point. Erasing a keyframe must not add a part.
  const int parts = co_await count_components(-1, 1);
  int common = kMinCommonPoints;
  for (; common > 1; --common) {
    const int parts_now = co_await count_components(-1, common);
    if (parts_now <= parts) break;
  }
  for (int k = 0; k < map_.keyframes().size(); ++k) judged_[k] = !map_.keyframes()[k].live() || k == 0;
  for (int newest = 0; newest < kProtectedKeyframes; ++newest) {
    int youngest = -1;
    for (const int16_t k : live_)
      if (!judged_[k] && (youngest < 0 || map_.keyframes()[k].id > map_.keyframes()[youngest].id)) youngest = k;
    if (youngest >= 0) judged_[youngest] = 1;
  }
  for (;;) {
    int lowest = -1;
    for (const int16_t k : live_)
      if (!judged_[k] && votes_[k] < kMaxVotesToErase && (lowest < 0 || votes_[k] < votes_[lowest])) lowest = k;
    if (lowest < 0) co_return -1;
    judged_[lowest] = 1;
    const int parts_without = co_await count_components(place_[lowest], common);
    if (parts_without <= parts) co_return lowest;
  }
}

Task<> UsefulnessCulling::count_votes() {
  live_.clear();
  place_.resize(map_.keyframes().size());
  votes_.resize(map_.keyframes().size());
  judged_.resize(map_.keyframes().size());
  for (int k = 0; k < map_.keyframes().size(); ++k) {
    votes_[k] = 0;
    place_[k] = -1;
    if (!map_.keyframes()[k].live()) continue;
    place_[k] = static_cast<int16_t>(live_.size());
    live_.push_back(static_cast<int16_t>(k));
  }
  reached_.resize(live_.size());
  common_.resize(live_.size() * live_.size());
  std::fill(common_.begin(), common_.end(), uint8_t{0});
  meter_.charge(Work::kOther, common_.size() + kSlotInstructions * map_.keyframes().size());
  for (const MapPoint& point : map_.points()) {
    if (point.id == 0) continue;
    const int observers = point.measurements.size();
    float m[kMaxMeasurementsPerPoint + 1];
    if (observers > 2) measure_usefulness(map_, config_.camera, point, m);
    int keyframe[kMaxMeasurementsPerPoint + 1], place[kMaxMeasurementsPerPoint + 1];
    int rank[kMaxMeasurementsPerPoint + 1];  // by usefulness, from 0; equal ones in the order of the measurements
    int j = 0;
    for (const Measurement& measurement : map_.measurements(point)) {
      const int b = place_[measurement.keyframe];
      keyframe[j] = measurement.keyframe;
      place[j] = b;
      rank[j] = 0;
      for (int i = 0; i < j; ++i) {
        const int a = place[i];
        if (observers > 2) ++rank[m[j] > m[i] ? i : j];
        if (common(a, b) < 255) common(b, a) = ++common(a, b);
      }
      ++j;
    }
    for (j = 0; j < observers; ++j) votes_[keyframe[j]] += keyframe_vote(observers, rank[j] + 1);
    co_await background_.spend(Work::kOther, kPointInstructions +
                                                 kPairInstructions * (observers * (observers - 1) / 2) +
                                                 (kUsefulnessInstructions + kVoteInstructions) * observers);
  }
}

// Number of connected parts of the graph of live keyframes, in which an edge joins two that share at least
// common_points points. `without`: place of a keyframe that is left out; -1: none is.
Task<int> UsefulnessCulling::count_components(int without, int common_points) {
  int components = 0;
  std::fill(reached_.begin(), reached_.end(), uint8_t{0});
  for (int start = 0; start < live_.size(); ++start) {
    if (start == without || reached_[start]) continue;
    ++components;
    frontier_.clear();
    frontier_.push_back(static_cast<int16_t>(start));
    reached_[start] = 1;
    for (int next = 0; next < frontier_.size(); ++next) {
      const int a = frontier_[next];
      for (int b = 0; b < live_.size(); ++b) {
        if (b == without || reached_[b] || common(a, b) < common_points) continue;
        reached_[b] = 1;
        frontier_.push_back(static_cast<int16_t>(b));
      }
      co_await background_.spend(Work::kOther, kEdgeInstructions * live_.size());
    }
  }
  co_return components;
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

KeyframeCulling* create_usefulness_culling(Arena& arena, const Config& config, Map& map, WorkMeter& meter,
                                           Background& background) {
  return arena.create<UsefulnessCulling>(config, map, meter, background);
}

}  // namespace pptam
