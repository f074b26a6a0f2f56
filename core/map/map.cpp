#include "map/map.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include "base/assert.h"

namespace pptam {

namespace {

// Cosine of the angle between viewing ray and patch normal in a new source keyframe: 60 degrees, stricter than the 75
// degrees at which a warp is given up (patch_search.cpp), so that the patch can be seen from other places. Not swept.
constexpr float kMinSourceCosSlant = 0.5f;
// Searches counted for a point. At this count attempts and finds are halved, so that recent searches weigh more. Not
// swept.
constexpr uint16_t kMaxSearches = 64;
// Keyframes' images that a new start finds: the views that it records, and a few for the map to grow. Not swept.
constexpr int kImagesForStart = kMaxInitialKeyframes + 8;
constexpr int kMinMeasurements = 2;  // of a map point: with one its depth is unknown
// FNV-1a, 64 bits.
constexpr uint64_t kHashPrime = 1099511628211ull, kHashStart = 14695981039346656037ull;

class Hash {
 public:
  void add(const void* data, size_t bytes) {
    const auto* p = static_cast<const uint8_t*>(data);
    for (size_t i = 0; i < bytes; ++i) value_ = (value_ ^ p[i]) * kHashPrime;
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
  uint64_t value_ = kHashStart;
};

}  // namespace

Map::Map(Arena& arena, const Config& config)
    : keyframes_(arena, keyframe_slots(config.max_keyframes, config.max_erased_keyframes)),
      points_(arena, config.max_map_points),
      measurements_(arena, measurement_places(config)),
      partial_points_(arena, config.max_partial_points),
      queue_(arena, config.camera.model, std::max(config.max_measured_points, config.max_initial_points)),
      neighbours_(arena, 2 * kMaxInitialKeyframes),
      max_measurements_per_point_(config.max_measurements_per_point),
      max_shared_(config.max_measurements),
      places_(config.max_maps - 1),
      max_keyframes_(config.max_keyframes),
      max_erased_keyframes_(config.max_erased_keyframes) {
  for (int i = 0; i < keyframe_slots(config.max_keyframes, config.max_erased_keyframes); ++i) {
    const Keyframe keyframe(arena, config.camera.model);
    if (i < keyframes_.capacity()) keyframes_.push_back(keyframe);
  }
  for (int i = 0; i < 2 * kMaxInitialKeyframes; ++i) {
    NeighbourFrame neighbour;
    neighbour.measurements = FixedVector<KeyframeMeasurement>(arena, config.max_initial_points);
    if (i < neighbours_.capacity()) neighbours_.push_back(neighbour);
  }
  keyframes_.resize(0);
  points_.resize(points_.capacity());
  partial_points_.resize(partial_points_.capacity());
  for (int i = 0; i < places_; ++i) {
    Contents& contents = aside_[i];
    contents.keyframes = FixedVector<Keyframe>(arena, keyframe_slots(max_keyframes_, max_erased_keyframes_));
    contents.points = FixedVector<MapPoint>(arena, config.max_map_points);
    contents.partial_points = FixedVector<PartialPoint>(arena, config.max_partial_points);
    contents.points.resize(contents.points.capacity());
    contents.partial_points.resize(contents.partial_points.capacity());
  }
}

bool Map::measured_in(const MapPoint& point, int keyframe) const {
  for (const Measurement& m : measurements(point))
    if (m.keyframe == keyframe) return true;
  return false;
}

int Map::point_count() const {
  int count = 0;
  for (const MapPoint& point : points_) count += point.id != 0;
  return count;
}

int Map::live_count() const {
  int count = 0;
  for (const Keyframe& keyframe : keyframes_) count += keyframe.live();
  return count;
}

int Map::erased_count() const {
  int count = 0;
  for (const Keyframe& keyframe : keyframes_) count += keyframe.id != 0 && keyframe.erased;
  return count;
}

int Map::add_point(const Vector3f& p_w, const PatchSource& source) {
  for (int i = 0; i < points_.size(); ++i) {
    if (points_[i].id != 0) continue;
    points_[i] = MapPoint();
    points_[i].id = next_id_++;
    points_[i].p_w = p_w;
    points_[i].source = source;
    return i;
  }
  limits_hit_ |= kLimitMapPoints;
  return -1;
}

void Map::remove_point(int index) {
  MeasurementPool::List& list = points_[index].measurements;
  shared_used_ -= std::max(list.size() - kMinMeasurements, 0);
  measurements_.erase_all(&list);
  points_[index] = MapPoint();
}

void Map::count_search(int index, bool was_found) {
  MapPoint& point = points_[index];
  ++point.attempts;
  point.found = static_cast<uint16_t>(point.found + was_found);
  if (point.attempts < kMaxSearches) return;
  point.attempts /= 2;
  point.found /= 2;
}

void Map::add_measurement(int point, const Measurement& measurement) {
  MeasurementPool::List& list = points_[point].measurements;
  if (list.size() > max_measurements_per_point_) return;
  if (list.size() >= kMinMeasurements && shared_used_ == max_shared_) {
    limits_hit_ |= kLimitMeasurements;
    return;
  }
  shared_used_ += list.size() >= kMinMeasurements;
  const bool placed = measurements_.push_back(&list, measurement);
  PPTAM_ASSERT(placed);
  (void)placed;
}

void Map::set_measurement(int point, int i, const Measurement& measurement) {
  measurements_.at(&points_[point].measurements, i) = measurement;
}

void Map::set_weights(int point, const float* weights) {
  measurements_.update(points_[point].measurements, [weights](int i, Measurement& m) { m.weight = weights[i]; });
}

void Map::remove_measurement(int point, int i) {
  MeasurementPool::List& list = points_[point].measurements;
  shared_used_ -= list.size() > kMinMeasurements;
  measurements_.erase(&list, i);
}

int Map::add_partial_point(const PatchSource& source, const Vector3f& ray, float inverse_depth) {
  for (int i = 0; i < partial_points_.size(); ++i) {
    if (partial_points_[i].id != 0) continue;
    partial_points_[i] = PartialPoint();
    partial_points_[i].id = next_id_++;
    partial_points_[i].source = source;
    partial_points_[i].ray = ray;
    partial_points_[i].inverse_depth = inverse_depth;
    return i;
  }
  limits_hit_ |= kLimitPartialPoints;
  return -1;
}

void Map::count_partial_search(int index, bool was_found) {
  PartialPoint& partial = partial_points_[index];
  ++partial.attempts;
  partial.found = static_cast<uint16_t>(partial.found + was_found);
}

void Map::set_depth(int index, float inverse_depth, float information) {
  partial_points_[index].inverse_depth = inverse_depth;
  partial_points_[index].information = information;
}

int Map::add_keyframe(Keyframe& frame) {
  int index = 0;
  while (index < keyframes_.size() && keyframes_[index].id != 0) ++index;
  if (index == keyframes_.capacity()) {
    full_ = true;
    return -1;
  }
  const bool grown = index == keyframes_.size();
  if (grown) keyframes_.resize(index + 1);
  if (!bring_images(index)) {
    if (grown) keyframes_.resize(index);
    full_ = true;
    return -1;
  }
  std::swap(keyframes_[index], frame);
  keyframes_[index].id = next_id_++;
  keyframes_[index].erased = false;
  keyframes_[index].anchor = -1;
  return index;
}

int Map::add_neighbour(int keyframe, int64_t timestamp_ns) {
  NeighbourFrame& frame = neighbours_[neighbour_count_];
  frame.keyframe = static_cast<int16_t>(keyframe);
  frame.timestamp_ns = timestamp_ns;
  frame.measurements.clear();
  return neighbour_count_++;
}

float Map::view_distance(const Keyframe& a, const Keyframe& b) {
  const float shift = (a.T_kw.centre() - b.T_kw.centre()).norm() / a.mean_depth;
  const float turn = (a.T_kw.R.row(2) - b.T_kw.R.row(2)).norm();
  return shift + turn;
}

int Map::nearest_live(int index, int except) const {
  int nearest = -1;
  float least = 0;
  for (int k = 0; k < keyframes_.size(); ++k) {
    if (!keyframes_[k].live() || k == index || k == except) continue;
    const float distance = view_distance(keyframes_[index], keyframes_[k]);
    if (nearest >= 0 && !(distance < least)) continue;
    nearest = k;
    least = distance;
  }
  return nearest;
}

void Map::erase_keyframe(int index) {
  PPTAM_ASSERT(index > 0 && keyframes_[index].live());
  for (int i = 0; i < points_.size(); ++i) {
    int j = 0;
    for (const Measurement& m : measurements(points_[i])) {
      if (m.keyframe == index) {
        remove_measurement(i, j);
        if (points_[i].measurements.size() < kMinMeasurements) remove_point(i);
        break;
      }
      ++j;
    }
  }
  keyframes_[index].erased = true;
  for (int k = 0; k < keyframes_.size(); ++k) {
    const Keyframe& keyframe = keyframes_[k];
    if (keyframe.id != 0 && keyframe.erased && (k == index || keyframe.anchor == index)) anchor_keyframe(k);
  }
}

void Map::anchor_keyframe(int index, int except) {
  Keyframe& keyframe = keyframes_[index];
  keyframe.anchor = static_cast<int16_t>(nearest_live(index, except));
  keyframe.T_anchor = keyframe.T_kw * keyframes_[keyframe.anchor].T_kw.inverse();
  keyframe.T_anchor.R = orthonormalised(keyframe.T_anchor.R);
}

void Map::forget_keyframe(int index) {
  Keyframe& gone = keyframes_[index];
  PPTAM_ASSERT(gone.id != 0 && gone.erased);
  for (int i = 0; i < points_.size(); ++i) {
    MapPoint& point = points_[i];
    if (point.id == 0 || point.source.keyframe != index) continue;
    const Measurement* best = nullptr;
    float least = 0;
    for (const Measurement& m : measurements(point)) {
      const float distance = view_distance(gone, keyframes_[m.keyframe]);
      if (best && !(distance < least)) continue;
      best = &m;
      least = distance;
    }
    if (!best) {
      remove_point(i);
      continue;
    }
    const SE3& T_kw = keyframes_[best->keyframe].T_kw;
    const Vector3f p_k = T_kw * point.p_w;
    point.source.normal = T_kw.R * (gone.T_kw.R.transpose() * point.source.normal);
    // Where the new source sees the patch's plane at too steep a slant, the patch is taken to face the new source.
    if (-point.source.normal.dot(p_k) < kMinSourceCosSlant * p_k.norm()) point.source.normal = -p_k.normalized();
    point.source.keyframe = best->keyframe;
    point.source.px = best->at.px;
    point.source.level = std::min<uint8_t>(best->at.level, kPointLevels - 1);
  }
  for (PartialPoint& partial : partial_points_)
    if (partial.id != 0 && partial.source.keyframe == index) partial = PartialPoint();
  gone.id = 0;
  gone.erased = false;
  gone.anchor = -1;
}

int Map::drop_keyframes_since(uint32_t id) {
  PPTAM_ASSERT(exists() && id > keyframes_[0].id);
  queue_.clear();
  int dropped = 0;
  for (int k = 1; k < keyframes_.size(); ++k)
    if (keyframes_[k].live() && keyframes_[k].id >= id) erase_keyframe(k);
  for (int k = 1; k < keyframes_.size(); ++k) {
    if (keyframes_[k].id == 0 || keyframes_[k].id < id) continue;
    forget_keyframe(k);
    ++dropped;
  }
  if (dropped == 0) return 0;
  full_ = false;
  ++epoch_;
  return dropped;
}

void Map::follow_anchors() {
  for (Keyframe& keyframe : keyframes_)
    if (keyframe.id != 0 && keyframe.erased) keyframe.T_kw = keyframe.T_anchor * keyframes_[keyframe.anchor].T_kw;
}

void Map::clear() {
  for (Keyframe& keyframe : keyframes_) keyframe.id = 0;
  keyframes_.resize(0);
  if (aside_count() == 0) {
    for (MapPoint& point : points_) point = MapPoint();
    measurements_.clear();
    shared_used_ = 0;
  } else {
    for (int i = 0; i < points_.size(); ++i) remove_point(i);
  }
  for (PartialPoint& point : partial_points_) point = PartialPoint();
  queue_.clear();
  neighbour_count_ = 0;
  ready_ = full_ = moved_ = false;
  limits_hit_ = number_ = 0;
  ++epoch_;
}

void Map::clear_all() {
  for (int i = 0; i < places_; ++i) {
    if (!is_aside(i)) continue;
    exchange(i);
    clear();
    exchange(i);
  }
  looking_ = false;
  clear();
}

void Map::finish() {
  ready_ = true;
  number_ = ++last_number_;
}

// ---- several maps ----

int Map::aside_count() const {
  int count = 0;
  for (int i = 0; i < places_; ++i) count += is_aside(i);
  return count;
}

int Map::live_aside() const {
  int count = 0;
  for (int i = 0; i < places_; ++i)
    for (const Keyframe& keyframe : aside_[i].keyframes) count += keyframe.live();
  return count;
}

int Map::max_live() const {
  const int left = keyframe_slots(max_keyframes_, max_erased_keyframes_) - 1 - live_aside();
  return std::min(max_keyframes_, left);
}

int Map::max_erased() const {
  const int left = keyframe_slots(max_keyframes_, max_erased_keyframes_) - 1 - live_aside() - live_count();
  return std::clamp(left, 0, max_erased_keyframes_);
}

// A slot with images that no keyframe has, or null.
Keyframe* Map::spare_images(FixedVector<Keyframe>& slots) {
  for (int k = 0; k < slots.capacity(); ++k) {
    Keyframe& slot = slots.data()[k];
    if ((k >= slots.size() || slot.id == 0) && has_images(slot)) return &slot;
  }
  return nullptr;
}

int Map::spare_count() const {
  const auto count_in = [](const FixedVector<Keyframe>& slots) {
    int count = 0;
    for (int k = 0; k < slots.capacity(); ++k)
      count += (k >= slots.size() || slots.data()[k].id == 0) && has_images(slots.data()[k]);
    return count;
  };
  int count = count_in(keyframes_);
  for (int i = 0; i < places_; ++i) {
    count += count_in(aside_[i].keyframes);
    for (const Keyframe& keyframe : aside_[i].keyframes) count += keyframe.id != 0 && keyframe.erased;
  }
  return count;
}

// Images for an empty slot of the map in use: those of another empty slot, or of the oldest erased keyframe among the
// maps that are set aside. False when there are none.
bool Map::bring_images(int index) {
  Keyframe& slot = keyframes_[index];
  if (has_images(slot)) return true;
  Keyframe* spare = spare_images(keyframes_);
  for (int i = 0; !spare && i < places_; ++i) spare = spare_images(aside_[i].keyframes);
  if (!spare) {
    int place = -1, oldest = -1;
    for (int i = 0; i < places_; ++i) {
      const FixedVector<Keyframe>& keyframes = aside_[i].keyframes;
      for (int k = 0; k < keyframes.size(); ++k) {
        if (keyframes[k].id == 0 || !keyframes[k].erased) continue;
        if (place >= 0 && keyframes[k].id > aside_[place].keyframes[oldest].id) continue;
        place = i;
        oldest = k;
      }
    }
    if (place < 0) return false;
    exchange(place);
    forget_keyframe(oldest);
    spare = &keyframes_[oldest];
    exchange(place);  // storage of the slots has not moved
  }
  std::swap(slot, *spare);
  slot.id = spare->id = 0;
  return true;
}

void Map::exchange(int place) {
  looking_ = !looking_;
  Contents& other = aside_[place];
  std::swap(keyframes_, other.keyframes);
  std::swap(points_, other.points);
  std::swap(partial_points_, other.partial_points);
  std::swap(number_, other.number);
  std::swap(ready_, other.ready);
  std::swap(full_, other.full);
  std::swap(limits_hit_, other.limits_hit);
}

void Map::give_up_smallest() {
  int smallest = -1, least = 0;
  for (int i = 0; i < places_; ++i) {
    if (!is_aside(i)) continue;
    int live = 0;
    for (const Keyframe& keyframe : aside_[i].keyframes) live += keyframe.live();
    if (smallest >= 0 && live >= least) continue;
    smallest = i;
    least = live;
  }
  if (smallest < 0) return;
  exchange(smallest);
  clear();
  exchange(smallest);
}

bool Map::can_set_aside() const {
  return places_ > 0 && keyframe_slots(max_keyframes_, max_erased_keyframes_) - live_count() > kImagesForStart;
}

void Map::set_aside() {
  PPTAM_ASSERT(ready_ && can_set_aside());
  if (aside_count() == places_) give_up_smallest();
  for (PartialPoint& point : partial_points_) point = PartialPoint();
  for (int i = 0; i < places_; ++i) {
    if (is_aside(i)) continue;
    exchange(i);
    looking_ = false;
    break;
  }
  while (spare_count() < kImagesForStart && aside_count() > 1) give_up_smallest();
  clear();  // queue, and all else that belongs to the map in use
}

void Map::settle(int place) {
  if (is_aside(place) && !aside_[place].ready) {
    exchange(place);
    clear();
    exchange(place);
  }
  looking_ = false;
  queue_.clear();
  neighbour_count_ = 0;
  moved_ = false;
  ++epoch_;
}

void Map::apply(const Similarity& S) {
  for (Keyframe& keyframe : keyframes_) {
    keyframe.T_kw = S.moved(keyframe.T_kw);
    keyframe.T_anchor.t *= S.scale;
    keyframe.velocity.head<3>() *= S.scale;
    keyframe.velocity_prior.head<3>() *= S.scale;
    keyframe.mean_depth *= S.scale;
  }
  queue_.apply(S);
  for (MapPoint& point : points_) point.p_w = S * point.p_w;
  for (PartialPoint& point : partial_points_) {
    point.inverse_depth /= S.scale;
    point.information *= S.scale * S.scale;
  }
  transform_ = moved_ ? S * transform_ : S;
  moved_ = true;
}

void Map::change_coordinates(const Similarity& S) {
  apply(S);
  ++epoch_;
}

bool Map::can_change_scale(float scale) const {
  const auto small = [scale](const auto& v) { return v.cwiseAbs().maxCoeff() * scale <= kMaxInMap; };
  const auto fits = [&](const Keyframe& k) {
    return small(k.T_kw.t) && small(k.T_anchor.t) && small(k.velocity) && small(k.velocity_prior) &&
           k.mean_depth * scale >= kMinDepthInMap && k.mean_depth * scale <= kMaxInMap;
  };
  for (const Keyframe& keyframe : keyframes_)
    if (keyframe.id != 0 && !fits(keyframe)) return false;
  for (const KeyframeCandidate& candidate : queue_.all())
    if (!fits(candidate.frame)) return false;
  for (const MapPoint& point : points_)
    if (point.id != 0 && !small(point.p_w)) return false;
  for (const PartialPoint& point : partial_points_) {
    if (point.id == 0) continue;
    const float q = point.inverse_depth / scale;
    if (!(q >= kMinDepthInMap && q <= kMaxInMap) || !(point.information * scale * scale <= kMaxInformationInMap))
      return false;
  }
  return true;
}

bool Map::take_transform(Similarity* S) {
  if (!moved_) return false;
  *S = transform_;
  moved_ = false;
  return true;
}

void Map::check_consistency() const {
#ifdef PPTAM_ENABLE_ASSERT
  const auto has_keyframe = [this](int k) { return k >= 0 && k < keyframes_.size() && keyframes_[k].id != 0; };
  PPTAM_ASSERT(!exists() || keyframes_[0].live());
  for (const Keyframe& keyframe : keyframes_)
    PPTAM_ASSERT(keyframe.id == 0 || !keyframe.erased ||
                 (has_keyframe(keyframe.anchor) && keyframes_[keyframe.anchor].live()));
  int shared = 0;
  for (const MapPoint& point : points_) {
    if (point.id == 0) continue;
    shared += point.measurements.size() - kMinMeasurements;
    PPTAM_ASSERT(has_keyframe(point.source.keyframe));
    PPTAM_ASSERT(point.measurements.size() >= kMinMeasurements &&
                 point.measurements.size() <= max_measurements_per_point_ + 1);
    for (const Measurement& m : measurements(point))
      PPTAM_ASSERT(has_keyframe(m.keyframe) && keyframes_[m.keyframe].live());
  }
  for (int i = 0; i < places_; ++i)
    for (const MapPoint& point : aside_[i].points)
      if (point.id != 0) shared += point.measurements.size() - kMinMeasurements;
  PPTAM_ASSERT(shared == shared_used_ && shared <= max_shared_);
  for (const PartialPoint& partial : partial_points_)
    PPTAM_ASSERT(partial.id == 0 || has_keyframe(partial.source.keyframe));
#endif
}

uint64_t Map::hash() const {
  Hash hash;
  for (const Keyframe& keyframe : keyframes_) {
    if (keyframe.id == 0) continue;
    for (int i = 0; i < 9; ++i) hash.add_float(keyframe.T_kw.R(i / 3, i % 3));
    for (int i = 0; i < 3; ++i) hash.add_float(keyframe.T_kw.t[i]);
  }
  for (const MapPoint& point : points_) {
    if (point.id == 0) continue;
    for (int i = 0; i < 3; ++i) hash.add_float(point.p_w[i]);
    for (const Measurement& measurement : measurements(point)) {
      hash.add_float(static_cast<float>(measurement.keyframe));
      hash.add_float(measurement.at.px.x());
      hash.add_float(measurement.at.px.y());
    }
  }
  return hash.value();
}

}  // namespace pptam
