#include "map/map.h"

#include <cstring>

namespace pptam {

namespace {

constexpr int kQueueLength = 2;             // the tracker makes at most one keyframe per min_keyframe_interval_s
constexpr float kMinSourceCosSlant = 0.5f;  // between viewing ray and a patch's normal in its new source: 60 degrees

Keyframe make_keyframe(Arena& arena, const Config& config) {
  Keyframe keyframe;
  keyframe.storage = PyramidStorage(arena, config.camera.width, config.camera.height, 0);
  const int width = config.camera.width >> (kPyramidLevels - 1);
  const int height = config.camera.height >> (kPyramidLevels - 1);
  keyframe.small = {arena.allocate_array<uint8_t>(static_cast<size_t>(width) * height), width, height, width};
  return keyframe;
}

class Hash {
 public:
  void add(const void* data, size_t bytes) {
    const auto* p = static_cast<const uint8_t*>(data);
    for (size_t i = 0; i < bytes; ++i) value_ = (value_ ^ p[i]) * 1099511628211ull;
  }
  void add_float(float x) {
    uint32_t bits;
    std::memcpy(&bits, &x, 4);
    const uint8_t bytes[4] = {static_cast<uint8_t>(bits), static_cast<uint8_t>(bits >> 8),
                              static_cast<uint8_t>(bits >> 16), static_cast<uint8_t>(bits >> 24)};
    add(bytes, 4);
  }
  uint64_t value() const { return value_; }

 private:
  uint64_t value_ = 14695981039346656037ull;
};

}  // namespace

Map::Map(Arena& arena, const Config& config)
    : keyframes(arena, keyframe_slots(config.max_keyframes, config.max_erased_keyframes)),
      points(arena, config.max_map_points),
      partial_points(arena, config.max_partial_points),
      queue(arena, kQueueLength),
      neighbours(arena, 2 * kMaxInitialKeyframes) {
  for (int i = 0; i < keyframe_slots(config.max_keyframes, config.max_erased_keyframes); ++i) {
    const Keyframe keyframe = make_keyframe(arena, config);
    if (i < keyframes.capacity()) keyframes.push_back(keyframe);
  }
  for (int i = 0; i < kQueueLength; ++i) {
    KeyframeCandidate candidate;
    candidate.frame = make_keyframe(arena, config);
    candidate.measurements =
        FixedVector<KeyframeMeasurement>(arena, std::max(config.max_measured_points, config.max_initial_points));
    if (i < queue.capacity()) queue.push_back(candidate);
  }
  for (int i = 0; i < 2 * kMaxInitialKeyframes; ++i) {
    NeighbourFrame neighbour;
    neighbour.measurements = FixedVector<KeyframeMeasurement>(arena, config.max_initial_points);
    if (i < neighbours.capacity()) neighbours.push_back(neighbour);
  }
  keyframes.resize(0);
  points.resize(points.capacity());
  partial_points.resize(partial_points.capacity());
}

int Map::point_count() const {
  int count = 0;
  for (const MapPoint& point : points) count += point.id != 0;
  return count;
}

int Map::add_point() {
  for (int i = 0; i < points.size(); ++i) {
    if (points[i].id != 0) continue;
    points[i] = MapPoint();
    points[i].id = next_id++;
    return i;
  }
  limits_hit |= kLimitMapPoints;
  return -1;
}

int Map::add_partial_point() {
  for (int i = 0; i < partial_points.size(); ++i) {
    if (partial_points[i].id != 0) continue;
    partial_points[i] = PartialPoint();
    partial_points[i].id = next_id++;
    return i;
  }
  limits_hit |= kLimitPartialPoints;
  return -1;
}

int Map::live_count() const {
  int count = 0;
  for (const Keyframe& keyframe : keyframes) count += keyframe.live();
  return count;
}

int Map::erased_count() const {
  int count = 0;
  for (const Keyframe& keyframe : keyframes) count += keyframe.id != 0 && keyframe.erased;
  return count;
}

int Map::add_keyframe(KeyframeCandidate& candidate) {
  int index = 0;
  while (index < keyframes.size() && keyframes[index].id != 0) ++index;
  if (index == keyframes.capacity()) {
    limits_hit |= kLimitKeyframes;
    return -1;
  }
  if (index == keyframes.size()) keyframes.resize(index + 1);
  std::swap(keyframes[index], candidate.frame);
  keyframes[index].id = next_id++;
  keyframes[index].erased = false;
  keyframes[index].anchor = -1;
  return index;
}

float Map::view_distance(const Keyframe& a, const Keyframe& b) {
  const float shift = (a.T_kw.centre() - b.T_kw.centre()).norm() / a.mean_depth;
  const float turn = (a.T_kw.R.row(2) - b.T_kw.R.row(2)).norm();
  return shift + turn;
}

int Map::nearest_live(int index, int except) const {
  int nearest = -1;
  float least = 0;
  for (int k = 0; k < keyframes.size(); ++k) {
    if (!keyframes[k].live() || k == index || k == except) continue;
    const float distance = view_distance(keyframes[index], keyframes[k]);
    if (nearest >= 0 && !(distance < least)) continue;
    nearest = k;
    least = distance;
  }
  return nearest;
}

void Map::erase_keyframe(int index) {
  PPTAM_ASSERT(index > 0 && keyframes[index].live());
  for (int i = 0; i < points.size(); ++i) {
    MapPoint& point = points[i];
    for (int j = 0; j < point.measurements.size(); ++j) {
      if (point.measurements[j].keyframe != index) continue;
      point.measurements.erase_at(j);
      if (point.measurements.size() < 2) remove_point(i);
      break;
    }
  }
  keyframes[index].erased = true;
  for (int k = 0; k < keyframes.size(); ++k) {
    const Keyframe& keyframe = keyframes[k];
    if (keyframe.id != 0 && keyframe.erased && (k == index || keyframe.anchor == index)) anchor_keyframe(k);
  }
}

void Map::anchor_keyframe(int index, int except) {
  Keyframe& keyframe = keyframes[index];
  keyframe.anchor = static_cast<int16_t>(nearest_live(index, except));
  keyframe.T_anchor = keyframe.T_kw * keyframes[keyframe.anchor].T_kw.inverse();
  keyframe.T_anchor.R = orthonormalised(keyframe.T_anchor.R);
}

void Map::forget_keyframe(int index) {
  Keyframe& gone = keyframes[index];
  PPTAM_ASSERT(gone.id != 0 && gone.erased);
  for (int i = 0; i < points.size(); ++i) {
    MapPoint& point = points[i];
    if (point.id == 0 || point.source.keyframe != index) continue;
    const Measurement* best = nullptr;
    float least = 0;
    for (const Measurement& m : point.measurements) {
      const float distance = view_distance(gone, keyframes[m.keyframe]);
      if (best && !(distance < least)) continue;
      best = &m;
      least = distance;
    }
    if (!best) {
      remove_point(i);
      continue;
    }
    const SE3& T_kw = keyframes[best->keyframe].T_kw;
    const Vector3f p_k = T_kw * point.p_w;
    point.source.normal = T_kw.R * (gone.T_kw.R.transpose() * point.source.normal);
    // Seen too much from the side the old plane explains nothing: it faces the new camera then.
    if (-point.source.normal.dot(p_k) < kMinSourceCosSlant * p_k.norm()) point.source.normal = -p_k.normalized();
    point.source.keyframe = best->keyframe;
    point.source.px = best->px;
  }
  for (PartialPoint& partial : partial_points)
    if (partial.id != 0 && partial.source.keyframe == index) partial = PartialPoint();
  gone.id = 0;
  gone.erased = false;
  gone.anchor = -1;
}

void Map::follow_anchors() {
  for (Keyframe& keyframe : keyframes)
    if (keyframe.id != 0 && keyframe.erased) keyframe.T_kw = keyframe.T_anchor * keyframes[keyframe.anchor].T_kw;
}

void Map::pop_queue() {
  PPTAM_ASSERT(queued > 0);
  for (int i = 0; i + 1 < queue.size(); ++i) std::swap(queue[i], queue[i + 1]);
  --queued;
}

void Map::clear() {
  for (Keyframe& keyframe : keyframes) keyframe.id = 0;
  keyframes.resize(0);
  for (MapPoint& point : points) point = MapPoint();
  for (PartialPoint& point : partial_points) point = PartialPoint();
  queued = 0;
  held = false;
  neighbour_count = 0;
  ready = false;
  limits_hit = 0;
  moved = false;
  ++epoch;
}

void Map::apply(const Similarity& S) {
  // p' = s (R p + t); T' = [R_kw R^T, s (t_kw - R_kw R^T t)]
  const auto transform_pose = [&S](SE3& T_kw) {
    T_kw = T_kw * S.T.inverse();
    T_kw.t *= S.scale;
  };
  for (Keyframe& keyframe : keyframes) {
    transform_pose(keyframe.T_kw);
    keyframe.T_anchor.t *= S.scale;
    keyframe.velocity.head<3>() *= S.scale;
    keyframe.velocity_prior.head<3>() *= S.scale;
    keyframe.mean_depth *= S.scale;
  }
  for (int i = 0; i < queued + held; ++i) {
    transform_pose(queue[i].frame.T_kw);
    queue[i].frame.velocity.head<3>() *= S.scale;
    queue[i].frame.velocity_prior.head<3>() *= S.scale;
    queue[i].frame.mean_depth *= S.scale;
  }
  for (MapPoint& point : points) point.p_w = S * point.p_w;
  for (PartialPoint& point : partial_points) {
    point.inverse_depth /= S.scale;
    point.information *= S.scale * S.scale;
  }
  transform = moved ? S * transform : S;
  moved = true;
}

bool Map::can_scale(float scale) const {
  const auto small = [scale](const auto& v) { return v.cwiseAbs().maxCoeff() * scale <= kLargestInMap; };  // not NaN
  const auto fits = [&](const Keyframe& k) {
    return small(k.T_kw.t) && small(k.T_anchor.t) && small(k.velocity) && small(k.velocity_prior) &&
           k.mean_depth * scale >= kLeastDepthInMap && k.mean_depth * scale <= kLargestInMap;
  };
  for (const Keyframe& keyframe : keyframes)
    if (keyframe.id != 0 && !fits(keyframe)) return false;
  for (int i = 0; i < queued + held; ++i)
    if (!fits(queue[i].frame)) return false;
  for (const MapPoint& point : points)
    if (point.id != 0 && !small(point.p_w)) return false;
  for (const PartialPoint& point : partial_points) {
    if (point.id == 0) continue;
    const float q = point.inverse_depth / scale;
    if (!(q >= kLeastDepthInMap && q <= kLargestInMap) || !(point.information * scale * scale <= kMostInformationInMap))
      return false;
  }
  return true;
}

bool Map::take_transform(Similarity* S) {
  if (!moved) return false;
  *S = transform;
  moved = false;
  return true;
}

uint64_t Map::hash() const {
  Hash hash;
  for (const Keyframe& keyframe : keyframes) {
    if (keyframe.id == 0) continue;
    for (int i = 0; i < 9; ++i) hash.add_float(keyframe.T_kw.R(i / 3, i % 3));
    for (int i = 0; i < 3; ++i) hash.add_float(keyframe.T_kw.t[i]);
  }
  for (const MapPoint& point : points) {
    if (point.id == 0) continue;
    for (int i = 0; i < 3; ++i) hash.add_float(point.p_w[i]);
    for (const Measurement& measurement : point.measurements) {
      hash.add_float(static_cast<float>(measurement.keyframe));
      hash.add_float(measurement.px.x());
      hash.add_float(measurement.px.y());
    }
  }
  return hash.value();
}

Vector2f global_shutter_px(const CameraModel& camera, const RollingShutter& shutter, const Vector6f& velocity,
                           const Vector3f& p_c, const Vector2f& px) {
  if (shutter.line_time_s == 0) return px;
  Vector2f projected;
  Matrix23f J;
  if (!camera.project(p_c, &projected, &J)) return px;
  const float dt_s = shutter.dt_s(px, camera.width, camera.height);
  return px - J * (se3_point_jacobian(p_c) * velocity) * dt_s;
}

}  // namespace pptam
