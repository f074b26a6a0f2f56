// The map: keyframes, map points with their measurements, partial points, and the queue through which the tracker hands
// over new keyframes. Tracking and mapping meet here and nowhere else.
//
// Frames: T_kw takes world to keyframe. Pixels are level 0. Everything has a fixed capacity from Config; entries are
// addressed by index, which stays valid while the entry exists; empty slots have id 0. Between two slices of mapping
// the map is consistent: every measurement's keyframe is live, every point has at least two measurements, every patch
// source exists. Keyframe 0 is the datum: it is live as long as there is a map.
#pragma once

#include <cstdint>

#include "base/containers.h"
#include "geometry/camera_model.h"
#include "geometry/se3.h"
#include "image/pyramid.h"
#include "pocket_ptam.h"

namespace pptam {

// Where a point was found in a keyframe.
struct Measurement {
  Vector2f px = Vector2f::Zero();  // level-0 pixels, as measured (rolling shutter not corrected)
  float sigma = 1;                 // expected standard deviation, level-0 pixels: 2^level
  int16_t keyframe = -1;           // index into Map::keyframes; a live one
  float weight = 1;                // of the M-estimator at the last bundle adjustment, 0 to 1
};

// [phone 3.2]: at most 8 measurements of a point are kept; one place more, for the newcomer that culling judges.
constexpr int kMaxMeasurements = 8;

struct PatchSource {
  int16_t keyframe = -1;                 // live or erased
  Vector2f px = Vector2f::Zero();        // level-0 pixels in that keyframe
  Vector3f normal = -Vector3f::UnitZ();  // of the patch's plane, in the keyframe's frame, unit, towards the camera
};

struct MapPoint {
  uint32_t id = 0;  // never reused; 0: empty slot
  Vector3f p_w = Vector3f::Zero();
  PatchSource source;
  InlineVector<Measurement, kMaxMeasurements + 1> measurements;
  uint16_t attempts = 0;  // searches by the tracker and in new keyframes, halved together with `found` when large
  uint16_t found = 0;     // of these, inliers of the pose, or found in a new keyframe

  void count_search(bool was_found) {
    ++attempts;
    found = static_cast<uint16_t>(found + was_found);
    if (attempts < 64) return;
    attempts /= 2;
    found /= 2;
  }
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

// A small blurred image for relocalisation and full-frame rotation: level 4 with a 3x3 binomial blur.
using SmallImage = GreyImage;

// Erased keyframes [phone 3.3, footnote] have no measurements and no place in bundle adjustment. They keep their
// images, as patch sources and for relocalisation, and their positions, which follow the live keyframe nearest to them.
struct Keyframe {
  uint32_t id = 0;  // never reused; 0: empty slot
  bool erased = false;
  int16_t anchor = -1;  // of an erased one: the live keyframe that it follows,
  SE3 T_anchor;         // T_kw = T_anchor * T_kw of the anchor
  int64_t timestamp_ns = 0;
  SE3 T_kw;
  Vector6f velocity = Vector6f::Zero();        // T_kw(t + dt) = exp(dt * velocity) T_kw: world units/s and radians/s
  Vector6f velocity_prior = Vector6f::Zero();  // what the tracker thought of it
  float mean_depth = 1;                        // of the points that the tracker measured
  PyramidStorage storage;
  Pyramid pyramid;
  SmallImage small;

  bool live() const { return id != 0 && !erased; }
};

// A tracked frame on its way to becoming a keyframe.
struct KeyframeMeasurement {
  int32_t point = -1;     // index into Map::points
  uint32_t point_id = 0;  // checked on insertion: the point may have gone meanwhile
  Vector2f px = Vector2f::Zero();
  float sigma = 1;
};
struct KeyframeCandidate {
  Keyframe frame;
  FixedVector<KeyframeMeasurement> measurements;
};

// A frame next to an initial keyframe: what was measured in it tells how fast the camera was [phone 6].
struct NeighbourFrame {
  int16_t keyframe = -1;
  int64_t timestamp_ns = 0;
  FixedVector<KeyframeMeasurement> measurements;
};
constexpr int kMaxInitialKeyframes = 8;

// x -> scale * (R x + t): a change of world coordinates.
struct Similarity {
  SE3 T;
  float scale = 1;
  Vector3f operator*(const Vector3f& p) const { return scale * (T * p); }
  // First the other, then this one: s2 (R2 s1 (R1 p + t1) + t2).
  Similarity operator*(const Similarity& first) const {
    return {SE3(T.R * first.T.R, T.R * first.T.t + T.t / first.scale), scale * first.scale};
  }
};

// What a map may hold, for all of its numbers to be usable: a length or speed to the fourth power is still a float.
constexpr float kLargestInMap = 1e8f;
constexpr float kLeastDepthInMap = 1e-8f;
constexpr float kMostInformationInMap = 1e30f;  // of an inverse depth

// Slots of Map::keyframes: live ones, the newcomer that culling judges, erased ones.
constexpr int keyframe_slots(int max_keyframes, int max_erased_keyframes) {
  return max_keyframes + 1 + max_erased_keyframes;
}
constexpr int kMostKeyframes = 1000;  // that a Config may allow, live, and as many erased
constexpr int kMostKeyframeSlots = keyframe_slots(kMostKeyframes, kMostKeyframes);

struct Map {
  Map() = default;
  Map(Arena& arena, const Config& config);

  FixedVector<Keyframe> keyframes;  // slots
  FixedVector<MapPoint> points;     // slots; empty ones have id 0
  FixedVector<PartialPoint> partial_points;
  FixedVector<KeyframeCandidate> queue;  // size is the capacity; the first `queued` are waiting, oldest first
  int queued = 0;
  // The slot after these is filled too, but the tracker still learns how fast the camera was there; it joins the queue
  // at the next frame.
  bool held = false;
  // Of the initial keyframes, one before and one after each; size is the capacity, the first `neighbour_count` are
  // used.
  FixedVector<NeighbourFrame> neighbours;
  int neighbour_count = 0;
  uint32_t next_id = 1;
  bool ready = false;       // initial bundle adjustment and alignment are done: poses may be shown
  bool locked = false;      // by the user: once it is ready it does not change any more
  uint32_t limits_hit = 0;  // LimitBits since the last reset; kLimitKeyframes while the map is full
  // Counts clear() and changes of scale: tells the mapper that what it was doing has no object any more.
  uint32_t epoch = 0;
  // The world's coordinates change once after initialisation (mapper), and when the user sets a length. All changes
  // that the tracker has not applied to its own state yet, as one.
  bool moved = false;
  Similarity transform;

  bool exists() const { return keyframes.size() > 0; }
  int point_count() const;
  int live_count() const;    // keyframes
  int erased_count() const;  // keyframes
  // Index of a free slot that now belongs to a point with a fresh id, or -1 when full.
  int add_point();
  int add_partial_point();
  void remove_point(int index) { points[index] = MapPoint(); }
  // Moves the candidate's images and state into a new keyframe; its index, or -1 when all slots are taken. The
  // candidate gets the slot's old storage in exchange.
  int add_keyframe(KeyframeCandidate& candidate);
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
  // How different two views are: the shift in mean depths plus the turn of the optical axis in radians, both of which
  // move the image about as much.
  static float view_distance(const Keyframe& a, const Keyframe& b);
  // The live keyframe whose view is most like that of keyframe `index`, which is not considered itself, nor `except`.
  int nearest_live(int index, int except = -1) const;
  void pop_queue();
  void clear();  // keeps storage; ids go on
  // Applies S to all positions and poses; velocities' translation and depths scale along.
  void apply(const Similarity& S);
  // Would all of the map's numbers be usable after a change of scale?
  bool can_scale(float scale) const;
  // The change of coordinates since the last call; false when there was none.
  bool take_transform(Similarity* S);
  uint64_t hash() const;  // FNV-1a over poses, erased ones' too, positions and measurements in index order
};

// The pixel at which a global shutter would have seen the point: px - J * velocity * dt [phone 6]. p_c: the point in
// the camera's frame at the frame's timestamp.
Vector2f global_shutter_px(const CameraModel& camera, const RollingShutter& shutter, const Vector6f& velocity,
                           const Vector3f& p_c, const Vector2f& px);

}  // namespace pptam
