// The map: keyframes, map points with their measurements, partial points, and the queue through which the tracker hands
// over new keyframes. Tracking and mapping meet here and nowhere else.
//
// Everything has a fixed capacity from Config; entries are addressed by index, which stays valid while the entry
// exists; empty slots have id 0. Others read; every change goes through a function here. Between two slices of mapping
// the map is consistent (check_consistency): every measurement's keyframe is live, every point has at least two
// measurements, every patch source exists. Keyframe 0 is the datum: it is live as long as there is a map.
//
// Life: clear() ─▶ keyframes and points are added ─▶ finish(): poses may be shown ─▶ changes, unless locked ─▶ clear()
//
// Frames: T_kw takes world to keyframe. Pixels are level 0.
#pragma once

#include <cstdint>

#include <pocket_ptam/camera.h>
#include <pocket_ptam/config.h>
#include <pocket_ptam/track_result.h>
#include "base/containers.h"
#include "map/keyframe.h"
#include "map/measurement_pool.h"

namespace pptam {

// The most measurements of one point that a Config may keep; what is done with them has room for one more on the stack.
constexpr int kMaxMeasurementsPerPoint = 32;

struct PatchSource {
  int16_t keyframe = -1;                 // live or erased
  Vector2f px = Vector2f::Zero();        // level-0 pixels in that keyframe
  Vector3f normal = -Vector3f::UnitZ();  // of the patch's plane, in the keyframe's frame, unit, towards the camera
};

struct MapPoint {
  uint32_t id = 0;  // never reused; 0: empty slot
  Vector3f p_w = Vector3f::Zero();
  PatchSource source;
  MeasurementPool::List measurements;  // Map::measurements() reads them
  uint16_t attempts = 0;  // searches by the tracker and in new keyframes, halved together with `found` when large
  uint16_t found = 0;     // of these, inliers of the pose, or found in a new keyframe
};

// A corner of one keyframe whose depth is not known yet [phone 5.2]: p_k = (x, y, 1) / q.
struct PartialPoint {
  uint32_t id = 0;  // 0: empty slot
  PatchSource source;
  Vector3f ray = Vector3f::UnitZ();  // (x, y, 1): the unprojected source pixel
  float inverse_depth = 1;           // q, world units^-1
  float information = 0;             // lambda = 1 / sigma^2 of q; 0: unknown
  uint16_t attempts = 0;
  uint16_t found = 0;
};

// A frame next to an initial keyframe: what was measured in it tells how fast the camera was [phone 6].
struct NeighbourFrame {
  int16_t keyframe = -1;
  int64_t timestamp_ns = 0;
  FixedVector<KeyframeMeasurement> measurements;
};
constexpr int kMaxInitialKeyframes = 8;
constexpr int kMinInitialPoints = 15;  // fewer make no map

// What a map may hold, for all of its numbers to be usable: a length or speed to the fourth power is still a float.
constexpr float kMaxInMap = 1e8f;
constexpr float kMinDepthInMap = 1e-8f;
constexpr float kMaxInformationInMap = 1e30f;  // of an inverse depth

// Slots of Map::keyframes(): live ones, the newcomer that culling judges, erased ones.
constexpr int keyframe_slots(int max_keyframes, int max_erased_keyframes) {
  return max_keyframes + 1 + max_erased_keyframes;
}
constexpr int kMaxKeyframes = 1000;  // that a Config may allow, live, and as many erased
constexpr int kMaxKeyframeSlots = keyframe_slots(kMaxKeyframes, kMaxKeyframes);

// Places for measurements: two for each point, and those that are shared.
inline int measurement_places(const Config& config) {
  return 2 * config.max_map_points + config.max_measurements;
}

class Map {
 public:
  Map() = default;
  Map(Arena& arena, const Config& config);

  // What is there.
  const FixedVector<Keyframe>& keyframes() const { return keyframes_; }                // slots
  const FixedVector<MapPoint>& points() const { return points_; }                      // slots
  const FixedVector<PartialPoint>& partial_points() const { return partial_points_; }  // slots
  MeasurementPool::Range measurements(const MapPoint& point) const { return measurements_.range(point.measurements); }
  bool measured_in(const MapPoint& point, int keyframe) const;
  int max_measurements_per_point() const { return max_measurements_per_point_; }
  // Of the initial keyframes, one before and one after each.
  std::span<const NeighbourFrame> neighbours() const {
    return {neighbours_.data(), static_cast<size_t>(neighbour_count_)};
  }
  KeyframeQueue& queue() { return queue_; }
  const KeyframeQueue& queue() const { return queue_; }
  int point_count() const;
  int live_count() const;    // keyframes
  int erased_count() const;  // keyframes
  // How different two views are: the shift in mean depths plus the turn of the optical axis in radians, both of which
  // move the image about as much.
  static float view_distance(const Keyframe& a, const Keyframe& b);
  // The live keyframe whose view is most like that of keyframe `index`, which is not considered itself, nor `except`.
  int nearest_live(int index, int except = -1) const;
  uint64_t hash() const;  // FNV-1a over poses, erased ones' too, positions and measurements in index order
  // LimitBits met since the last clear(); kLimitKeyframes while full(). A report: nothing is decided by it.
  uint32_t limits_hit() const { return limits_hit_ | (full_ ? static_cast<uint32_t>(kLimitKeyframes) : 0u); }

  // Life.
  bool exists() const { return keyframes_.size() > 0; }
  bool ready() const { return ready_; }  // initial bundle adjustment and alignment are done: poses may be shown
  void finish() { ready_ = true; }
  bool locked() const { return locked_; }  // by the user: once it is ready it does not change any more
  void set_locked(bool locked) { locked_ = locked; }
  bool full() const { return full_; }  // no keyframe could be spared for the last newcomer
  void set_full(bool full) { full_ = full; }
  void clear();  // keeps storage; ids go on
  // Counts clear() and changes of scale by the user: tells the mapper that what it was doing has no object any more.
  uint32_t epoch() const { return epoch_; }

  // Changes of the world's coordinates, of all positions, poses and velocities: once after initialisation (mapper),
  // and when the user sets a length.
  void apply(const Similarity& S);
  void change_scale(float scale);            // by the user
  bool can_change_scale(float scale) const;  // would all of the map's numbers be usable afterwards?
  // All changes of coordinates since the last call, as one; false when there were none. The tracker moves its own
  // state along.
  bool take_transform(Similarity* S);

  // Keyframes. add_keyframe moves images and state into a new one; its index, or -1 when all slots are taken. `frame`
  // gets the slot's old storage in exchange.
  int add_keyframe(Keyframe& frame);
  void move_keyframe(int index, const SE3& T_kw) { keyframes_[index].T_kw = T_kw; }
  void set_velocity(int index, const Vector6f& velocity) { keyframes_[index].velocity = velocity; }
  void set_velocity_prior(int index, const Vector6f& velocity) { keyframes_[index].velocity_prior = velocity; }
  // Live to erased: its measurements go, and with them points that are left with fewer than two; it is anchored, and
  // what was anchored to it anew. Not the datum.
  void erase_keyframe(int index);
  // Ties an erased keyframe to the live one nearest to it, which is not `except`.
  void anchor_keyframe(int index, int except = -1);
  // Empties the slot of an erased keyframe for good. Points whose patch source it was get another one among the
  // keyframes that measure them; partial points go.
  void forget_keyframe(int index);
  // Erased keyframes to where their anchors have moved: to be called after every change of live poses.
  void follow_anchors();
  // A frame next to an initial keyframe; its index.
  int add_neighbour(int keyframe, int64_t timestamp_ns);
  void add_neighbour_measurement(int neighbour, const KeyframeMeasurement& measurement) {
    neighbours_[neighbour].measurements.push_back(measurement);
  }

  // Points: the index of the new one, without measurements so far, or -1 when full.
  int add_point(const Vector3f& p_w, const PatchSource& source);
  void remove_point(int index);
  void move_point(int index, const Vector3f& p_w) { points_[index].p_w = p_w; }
  void set_normal(int index, const Vector3f& normal_k) { points_[index].source.normal = normal_k; }
  void count_search(int index, bool was_found);
  // Not when the point has one more than max_measurements_per_point, or, from the third on, when all shared places are
  // taken (limits_hit).
  void add_measurement(int point, const Measurement& measurement);
  void set_measurement(int point, int i, const Measurement& measurement);
  void set_weights(int point, const float* weights);  // one for each measurement, in order
  void remove_measurement(int point, int i);

  // Partial points: the index of the new one, its depth unknown, or -1 when full.
  int add_partial_point(const PatchSource& source, const Vector3f& ray, float inverse_depth);
  void remove_partial_point(int index) { partial_points_[index] = PartialPoint(); }
  void count_partial_search(int index, bool was_found);
  void set_depth(int index, float inverse_depth, float information);

  // Asserts what the opening promises, where assertions are compiled in.
  void check_consistency() const;

 private:
  friend struct MapAccess;

  FixedVector<Keyframe> keyframes_;
  FixedVector<MapPoint> points_;
  MeasurementPool measurements_;
  FixedVector<PartialPoint> partial_points_;
  KeyframeQueue queue_;
  FixedVector<NeighbourFrame> neighbours_;  // size is the capacity
  int neighbour_count_ = 0;
  int max_measurements_per_point_ = 0;
  int max_further_ = 0, further_ = 0;  // measurements beyond the first two of each point
  uint32_t next_id_ = 1;
  bool ready_ = false, locked_ = false, full_ = false;
  uint32_t limits_hit_ = 0;
  uint32_t epoch_ = 0;
  bool moved_ = false;  // transform_ has not been taken
  Similarity transform_;
};

}  // namespace pptam
