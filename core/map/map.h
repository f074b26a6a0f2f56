// The map: keyframes, map points with their measurements, partial points, and the queue through which the tracker hands
// over new keyframes. Tracking and mapping meet here and nowhere else.
//
// Everything has a fixed capacity from Config. Entries are addressed by their slot's index, which stays valid while the
// entry exists. Empty slots have id 0. Other classes read; every change goes through a function of Map. Between two
// slices of mapping the map is consistent (check_consistency): every measurement's keyframe is live, every point has at
// least two measurements, every patch source exists. Keyframe 0 is the datum: it is live as long as there is a map.
//
// Life: clear() ─▶ keyframes and points are added ─▶ finish(): poses may be shown ─▶ changes, unless locked ─▶ clear()
//
// Several maps: one is in use, and all that follows speaks of it. Another may be set aside when the camera is lost, and
// be taken up again when a view of it returns. Each has a world of its own. They share the keyframes' images and the
// measurements: a map that grows takes the images of erased keyframes of those that are set aside.
//
// Frames: T_kw takes world to keyframe. Pixels are level 0.
#pragma once

#include <cstdint>
#include <span>

#include <pocket_ptam/camera.h>
#include <pocket_ptam/config.h>
#include <pocket_ptam/track_result.h>
#include "base/containers.h"
#include "map/keyframe.h"
#include "map/measurement_pool.h"

namespace pptam {

// The most measurements of one point that a Config may keep. Functions that work on one point's measurements hold one
// more on the stack, the one that culling judges: larger values need a deeper stack. The paper keeps 8 [phone 3.2].
constexpr int kMaxMeasurementsPerPoint = 32;

// Levels that points may have of their own [ptam 4].
constexpr int kPointLevels = 4;

struct PatchSource {
  PatchSource() = default;
  PatchSource(int16_t of_keyframe, const Vector2f& at_px, const Vector3f& normal_k, uint8_t of_level = 1)
      : keyframe(of_keyframe), level(of_level), px(at_px), normal(normal_k) {}

  int16_t keyframe = -1;  // live or erased
  uint8_t level = 1;      // whose 8x8 pixels show the patch, where points have levels of their own (Config::own_levels)
  Vector2f px = Vector2f::Zero();        // level-0 pixels in that keyframe
  Vector3f normal = -Vector3f::UnitZ();  // of the patch's plane, in the keyframe's frame, unit, towards the camera
};

struct MapPoint {
  uint32_t id = 0;  // never reused; 0: empty slot
  Vector3f p_w = Vector3f::Zero();
  PatchSource source;
  MeasurementPool::List measurements;  // Map::measurements() reads them
  uint16_t attempts = 0;  // searches by the tracker and in new keyframes, halved together with `found` at 64
  uint16_t found = 0;     // successful searches: inliers of the pose, or found in a new keyframe
};

// A corner of one keyframe whose depth is not known yet [phone 5.2]: p_k = (x, y, 1) / q.
struct PartialPoint {
  uint32_t id = 0;  // 0: empty slot
  PatchSource source;
  Vector3f ray = Vector3f::UnitZ();  // (x, y, 1): the unprojected source pixel; see exposed_pose()
  float inverse_depth = 1;           // q, world units^-1
  float information = 0;             // lambda = 1 / sigma^2 of q, world units^2; 0: unknown
  uint16_t attempts = 0;             // searches
  uint16_t found = 0;                // successful searches
};

// The video frame before or after an initial keyframe. Its measurements give the camera's velocity [phone 6].
struct NeighbourFrame {
  int16_t keyframe = -1;  // index of the initial keyframe
  int64_t timestamp_ns = 0;
  FixedVector<KeyframeMeasurement> measurements;
};
// Views that a start records for the map. The paper keeps two or three [phone 5.1]; two cannot tell structure from the
// shutter's distortion. Each takes the memory of a keyframe. Not swept.
constexpr int kMaxInitialKeyframes = 8;
constexpr int kMinInitialPoints = 12;  // map points without which a start is given up; not swept

// Bounds of the numbers in a map, so that all of them are usable: a length or speed to the fourth power is still a
// float.
constexpr float kMaxInMap = 1e8f;              // lengths in world units, speeds in world units/s or radians/s
constexpr float kMinDepthInMap = 1e-8f;        // mean depths, and inverse depths
constexpr float kMaxInformationInMap = 1e30f;  // of an inverse depth, world units^2

// Slots of Map::keyframes(): live keyframes, one new keyframe while culling decides, erased keyframes.
constexpr int keyframe_slots(int max_keyframes, int max_erased_keyframes) {
  return max_keyframes + 1 + max_erased_keyframes;
}
// Live keyframes that a Config may allow, and erased ones. Slots stay far below INT16_MAX, and map_parts() and the
// reader of map files hold a few bytes for each slot on the stack.
constexpr int kMaxKeyframes = 1000;
constexpr int kMaxKeyframeSlots = keyframe_slots(kMaxKeyframes, kMaxKeyframes);

constexpr int kMaxMaps = 8;  // that a Config may allow

// Measurements that one map may have: two of each point's own, and those that all points of all maps share.
inline int measurements_of_one_map(const Config& config) {
  return 2 * config.max_map_points + config.max_measurements;
}
// Places for those of all maps.
inline int measurement_places(const Config& config) {
  return 2 * config.max_map_points * (config.max_maps - 1) + measurements_of_one_map(config);
}

class Map {
 public:
  Map() = default;
  Map(Arena& arena, const Config& config);

  // Contents.
  const FixedVector<Keyframe>& keyframes() const { return keyframes_; }                // slots
  const FixedVector<MapPoint>& points() const { return points_; }                      // slots
  const FixedVector<PartialPoint>& partial_points() const { return partial_points_; }  // slots
  MeasurementPool::Range measurements(const MapPoint& point) const { return measurements_.range(point.measurements); }
  bool measured_in(const MapPoint& point, int keyframe) const;
  int max_measurements_per_point() const { return max_measurements_per_point_; }
  // The frames next to the initial keyframes: at most one before and one after each.
  std::span<const NeighbourFrame> neighbours() const {
    return {neighbours_.data(), static_cast<size_t>(neighbour_count_)};
  }
  KeyframeQueue& queue() { return queue_; }
  const KeyframeQueue& queue() const { return queue_; }
  int point_count() const;
  int live_count() const;    // keyframes
  int erased_count() const;  // keyframes
  // How different two views are: distance of the centres in mean depths of `a`, plus the turn of the optical axis in
  // radians. One unit of either moves the image by about as much.
  static float view_distance(const Keyframe& a, const Keyframe& b);
  // The live keyframe whose view is most like that of keyframe `index`; neither `index` nor `except`. -1: none.
  int nearest_live(int index, int except = -1) const;
  // FNV-1a over the poses of live and erased keyframes, the points' positions and their measurements, in index order.
  uint64_t hash() const;
  // LimitBits met since the last clear(), and kLimitKeyframes while full(). For TrackResult only: no decision uses it.
  uint32_t limits_hit() const { return limits_hit_ | (full_ ? static_cast<uint32_t>(kLimitKeyframes) : 0u); }

  // Life.
  bool exists() const { return keyframes_.size() > 0; }
  bool ready() const { return ready_; }  // initial bundle adjustment and alignment are done: poses may be shown
  void finish();
  bool locked() const { return locked_; }  // by the user: a map that is ready does not change any more
  void set_locked(bool locked) { locked_ = locked; }
  bool full() const { return full_; }  // no keyframe could be erased for the last new one
  void set_full(bool full) { full_ = full; }
  void clear();      // the map in use; keeps storage; ids are not used again
  void clear_all();  // and those that are set aside
  // Counts clear(), settle(), drop_keyframes_since() and changes of coordinates by the user. After any, the mapper
  // drops the job that it was doing.
  uint32_t epoch() const { return epoch_; }

  // Several maps. A finished map has a number, which no other has: 1 for the first one; 0: there is none in use.
  uint32_t number() const { return number_; }
  int places() const { return places_; }  // for maps that are set aside
  bool is_aside(int place) const { return aside_[place].keyframes.size() > 0; }
  int aside_count() const;  // maps set aside
  uint32_t number_aside(int place) const { return aside_[place].number; }
  const FixedVector<Keyframe>& keyframes_aside(int place) const { return aside_[place].keyframes; }
  // Sets the finished map in use aside, and there is none in use. Where there is no place left, or too few images for a
  // new start, the smallest of those that are aside is given up.
  void set_aside();
  // Whether images would be left for a new start.
  bool can_set_aside() const;
  // Makes the map at a place the one in use, and the one in use, if any, that at the place. Twice: nothing has changed.
  // For a look at another map; to be followed by the same again, or by settle(). Until then the mapper does nothing.
  void exchange(int place);
  bool looking() const { return looking_; }
  // After exchange(): the map in use is here to stay. The other one stays aside if it is finished, and is given up
  // otherwise.
  void settle(int place);

  // Changes of the world's coordinates, of all positions, poses and velocities: once after initialisation (mapper),
  // and when the user sets a length or a ground.
  void apply(const Similarity& S);
  void change_coordinates(const Similarity& S);  // by the user
  bool can_change_scale(float scale) const;      // would all of the map's numbers be usable afterwards?
  // All changes of coordinates since the last call, as one similarity; false when there were none. The tracker applies
  // it to its own state.
  bool take_transform(Similarity* S);

  // Keyframes. add_keyframe moves images and state into an empty slot and returns its index, or -1 when all slots are
  // taken. `frame` gets the slot's old storage in exchange.
  int add_keyframe(Keyframe& frame);
  void move_keyframe(int index, const SE3& T_kw) { keyframes_[index].T_kw = T_kw; }
  void set_velocity(int index, const Vector6f& velocity) { keyframes_[index].velocity = velocity; }
  void set_velocity_prior(int index, const Vector6f& velocity) { keyframes_[index].velocity_prior = velocity; }
  // Turns a live keyframe into an erased one. Its measurements are removed, and so are points left with fewer than two.
  // It is anchored to a live keyframe, and so are the keyframes that were anchored to it. Not for the datum.
  void erase_keyframe(int index);
  // Anchors an erased keyframe to the live keyframe nearest to it; not to `except`.
  void anchor_keyframe(int index, int except = -1);
  // Live and erased keyframes that the map in use may have: Config's numbers, as far as other maps leave images for it.
  int max_live() const;
  int max_erased() const;
  // Empties the slot of an erased keyframe. Points whose patch source it was get another source among the keyframes
  // that measure them. Partial points of the keyframe are removed.
  void forget_keyframe(int index);
  // Ids grow: the next one that is given to a keyframe or a point.
  uint32_t next_id() const { return next_id_; }
  // Removes the keyframes that have ids from `id` on, erased ones too, with the points left with fewer than two
  // measurements, and those that wait in the queue. Not for the datum. Returns how many were removed from the map.
  int drop_keyframes_since(uint32_t id);
  // Moves erased keyframes along with their anchors: to be called after every change of live poses.
  void follow_anchors();
  // Adds a frame next to an initial keyframe; returns its index.
  int add_neighbour(int keyframe, int64_t timestamp_ns);
  void add_neighbour_measurement(int neighbour, const KeyframeMeasurement& measurement) {
    neighbours_[neighbour].measurements.push_back(measurement);
  }

  // Points. add_point returns the index of the new point, without measurements so far, or -1 when the map is full.
  int add_point(const Vector3f& p_w, const PatchSource& source);
  void remove_point(int index);
  void move_point(int index, const Vector3f& p_w) { points_[index].p_w = p_w; }
  void set_normal(int index, const Vector3f& normal_k) { points_[index].source.normal = normal_k; }
  void count_search(int index, bool was_found);
  // Does nothing when the point has more than max_measurements_per_point already, or when it has two and all shared
  // places are taken (limits_hit).
  void add_measurement(int point, const Measurement& measurement);
  void set_measurement(int point, int i, const Measurement& measurement);
  void set_weights(int point, const float* weights);  // one for each measurement, in order
  void remove_measurement(int point, int i);

  // Partial points. add_partial_point returns the index of the new one, its depth unknown, or -1 when the map is full.
  int add_partial_point(const PatchSource& source, const Vector3f& ray, float inverse_depth);
  void remove_partial_point(int index) { partial_points_[index] = PartialPoint(); }
  void count_partial_search(int index, bool was_found);
  void set_depth(int index, float inverse_depth, float information);

  // Asserts the rules of a consistent map (top of this file), where assertions are compiled in.
  void check_consistency() const;

 private:
  friend struct MapAccess;

  // A map that is set aside: what the members of the same names are of the one in use.
  struct Contents {
    FixedVector<Keyframe> keyframes;
    FixedVector<MapPoint> points;
    FixedVector<PartialPoint> partial_points;
    uint32_t number = 0;
    bool ready = false, full = false;
    uint32_t limits_hit = 0;
  };
  static bool has_images(const Keyframe& slot) { return slot.storage.level[0].data != nullptr; }
  Keyframe* spare_images(FixedVector<Keyframe>& slots);
  bool bring_images(int index);
  int spare_count() const;
  void give_up_smallest();
  int live_aside() const;

  FixedVector<Keyframe> keyframes_;
  FixedVector<MapPoint> points_;
  MeasurementPool measurements_;
  FixedVector<PartialPoint> partial_points_;
  KeyframeQueue queue_;
  FixedVector<NeighbourFrame> neighbours_;  // size is the capacity
  int neighbour_count_ = 0;
  int max_measurements_per_point_ = 0;
  int max_shared_ = 0, shared_used_ = 0;  // places for measurements beyond the first two of each point
  uint32_t next_id_ = 1;
  bool ready_ = false, locked_ = false, full_ = false;
  uint32_t limits_hit_ = 0;
  uint32_t epoch_ = 0;
  uint32_t number_ = 0, last_number_ = 0;
  Contents aside_[kMaxMaps - 1];  // the first places_ of them
  int places_ = 0;
  bool looking_ = false;  // at another map: exchange()
  int max_keyframes_ = 0, max_erased_keyframes_ = 0;
  bool moved_ = false;  // transform_ has not been taken
  Similarity transform_;
};

}  // namespace pptam
