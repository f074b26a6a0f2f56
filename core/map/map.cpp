#include "map/map.h"

#include <cstring>

namespace pptam {

namespace {

constexpr int kQueueLength = 2;  // the tracker makes at most one keyframe per min_keyframe_interval_s

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
    : keyframes(arena, config.max_keyframes),
      points(arena, config.max_map_points),
      partial_points(arena, config.max_partial_points),
      queue(arena, kQueueLength),
      neighbours(arena, 2 * kMaxInitialKeyframes) {
  for (int i = 0; i < config.max_keyframes; ++i) {
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

int Map::add_keyframe(KeyframeCandidate& candidate) {
  if (keyframes.full()) {
    limits_hit |= kLimitKeyframes;
    return -1;
  }
  const int index = keyframes.size();
  keyframes.resize(index + 1);
  std::swap(keyframes[index], candidate.frame);
  keyframes[index].id = next_id++;
  return index;
}

void Map::pop_queue() {
  PPTAM_ASSERT(queued > 0);
  for (int i = 0; i + 1 < queue.size(); ++i) std::swap(queue[i], queue[i + 1]);
  --queued;
}

void Map::clear() {
  keyframes.resize(0);
  for (MapPoint& point : points) point = MapPoint();
  for (PartialPoint& point : partial_points) point = PartialPoint();
  queued = 0;
  held = false;
  neighbour_count = 0;
  ready = false;
  limits_hit = 0;
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
  transform = S;
  ++transform_count;
}

uint64_t Map::hash() const {
  Hash hash;
  for (const Keyframe& keyframe : keyframes) {
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

void cull_measurements(const Map& map, const CameraModel& camera, MapPoint& point) {
  const int count = point.measurements.size();
  if (count <= kMaxMeasurements) return;
  // V_j = B^T B / sigma^2 with B scaled by the depth, which makes every V_j of order f^2 and keeps |V| within float32.
  Matrix3f V_j[kMaxMeasurements + 1];
  Matrix3f V = Matrix3f::Zero();
  for (int j = 0; j < count; ++j) {
    const Measurement& m = point.measurements[j];
    const Keyframe& keyframe = map.keyframes[m.keyframe];
    const Vector3f p_k = keyframe.T_kw * point.p_w;
    Vector2f px;
    Matrix23f J;
    V_j[j].setZero();
    if (camera.project(p_k, &px, &J)) {
      const Matrix23f B = J * keyframe.T_kw.R * (keyframe.mean_depth / (m.sigma * camera.fx));
      V_j[j] = B.transpose() * B;
    }
    V += V_j[j];
  }
  const float all = V.determinant();
  int worst = 1;
  float least = 0;
  for (int j = 1; j < count; ++j) {
    const float usefulness = all - (V - V_j[j]).determinant();
    if (j == 1 || usefulness < least) {
      least = usefulness;
      worst = j;
    }
  }
  point.measurements.erase_at(worst);
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
