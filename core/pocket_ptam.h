// Pocket PTAM: camera tracking and mapping for one small core. The whole public API.
//
//   pptam::Config config = pptam::Config::phone(camera_model);
//   std::vector<std::byte> memory(pptam::System::required_bytes(config));
//   pptam::System* system = nullptr;
//   pptam::Status status = pptam::System::create(config, memory, &system);   // check it
//   system->tap();                                  // start at the next frame, or set Config::auto_start before
//   for (every frame) {
//     pptam::TrackResult r = system->track(frame);                           // high priority, bounded time
//     while (there is time before the next frame && system->has_work()) system->work_slice();
//   }
//
// One thread. No heap, no exceptions, no operating system; everything lives in the caller's block. The world's unit is
// arbitrary (monocular): the sideways start, from the first view to the farthest of it, is Config::initial_baseline
// long, unless the user knows a distance: Config::initial_plane_distance, System::set_length. The world's z = 0 is the
// dominant plane of the first view, z up towards the camera. Poses are T_cw (world to camera), camera x right, y down,
// z forward, at the frame's timestamp (mid-exposure of the image centre).
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "base/status.h"
#include "base/work_meter.h"
#include "camera/camera.h"
#include "geometry/se3.h"
#include "image/image.h"
#include "scheduler/clock.h"

namespace pptam {

class Arena;
class Background;
class CornerSource;     // image/corner_source.h
class Initialiser;      // tracking/initialiser.h
class KeyframeCulling;  // mapping/culling.h
class Map;
class PointSource;  // mapping/point_source.h
struct Config;

// A profile names its parts by the functions that build them, so that what no profile names is not linked. Each builds
// one part in the arena (Arena::create), which measures first: the part is null then, and what it would have been given
// may be.
using CreateCornerSource = CornerSource*(Arena&, const Config&, WorkMeter&);
using CreateInitialiser = Initialiser*(Arena&, const Config&, WorkMeter&, CornerSource*);
using CreatePointSource = PointSource*(Arena&, const Config&, Map&, WorkMeter&, Background&, CornerSource*);
using CreateKeyframeCulling = KeyframeCulling*(Arena&, const Config&, Map&, WorkMeter&, Background&);

CreateCornerSource create_shi_tomasi_corners;     // multi-scale [phone 3.1]
CreateInitialiser create_homography_initialiser;  // two-stage, from one tap [phone 5.1]
CreatePointSource create_partial_points;          // inverse depth, frame by frame [phone 5.2]
CreateKeyframeCulling create_usefulness_culling;  // by votes [phone 3.3]

// Everything that can be set, passed once. Capacities bound memory and time; a full one shows in
// TrackResult::limits_hit.
struct Config {
  // Parts. A Config of the default constructor has none: begin with phone().
  CreateCornerSource* corner_source = nullptr;  // one, for initialiser and point source
  CreateInitialiser* initialiser = nullptr;
  CreatePointSource* point_source = nullptr;
  CreateKeyframeCulling* culling = nullptr;

  Camera camera;            // lens and shutter; camera.model.prepare() is called by System::create
  float exposure_s = 0.0f;  // 0: unknown; used to predict motion blur

  // Live keyframes: bundle adjusted, measured by the map's points. Beyond, the least useful one is erased for each new
  // one [phone 3.3].
  int max_keyframes = 35;
  // Erased keyframes that keep their images, for patches and to find the way back; the least useful is forgotten then.
  // Each takes 4/3 bytes a pixel.
  int max_erased_keyframes = 35;
  int max_map_points = 1000;  // 35 keyframes with 25 new points each, and the first view's
  // Of all map points together, beyond the two that each point needs and has a place for; 24 bytes each.
  int max_measurements = 6000;
  // Beyond, the least useful one of a point goes [phone 3.2]. 2 to 32.
  int max_measurements_per_point = 8;
  int max_partial_points = 100;
  int max_measured_points = 50;     // per frame [phone 4]
  int max_partial_searches = 12;    // per frame [phone 7]
  int max_new_partial_points = 25;  // per keyframe [phone 5.2]
  int max_initial_points = 100;     // tracked by the homography
  // Measured points are spread over so many cells of the image, across and down. 1 to 16 each.
  int cells_x = 6, cells_y = 8;
  // Pyramid levels searched: of a sharp frame [phone 4], and of a blurred one or in a wide search. 0 to 4.
  int search_level = 1, coarse_search_level = 2;

  float initial_baseline = 0.1f;  // length of the sideways start in world units [ptam 6.1]
  // Distance of the first view's camera centre from the dominant plane, world units, when the user knows it: sets the
  // scale in place of initial_baseline. 0: not known.
  float initial_plane_distance = 0;
  // Initialisation begins by itself, without a tap, when the camera has been held still for 0.3 s before a textured
  // view; again whenever it has failed, until there is a map.
  bool auto_start = false;
  float min_keyframe_interval_s = 0.2f;
  // A camera that stands still is shown still: while the whole image is at rest the pose shown follows the measured one
  // only as far as noise does not explain the difference. Off: every pose as measured.
  bool steady_damping = true;

  PhoneProfile profile;  // turns charged work into time (the work clock)

  // The 2009 phone's parts and capacities, for a camera of any size from 64x64 to 4096x4096. Its shutter is global
  // until camera.shutter is set.
  static Config phone(const CameraModel& model);
  Status validate() const;
};

enum class TrackingState : uint8_t {
  kWaiting,       // no map: tap() starts initialisation, or it starts by itself (Config::auto_start)
  kInitialising,  // the first view is tracked; move sideways
  kTracking,      // pose is valid
  kLost           // there is a map, but the pose is not known; the relocaliser tries at every frame
};

enum class TrackingQuality : uint8_t { kBad, kPoor, kGood };

enum class Hint : uint8_t {
  kNone,
  kTap,               // tap to start
  kHoldStill,         // about to start: the first view must not be blurred or sheared
  kMoveSideways,      // initialising: translate, keep the first view visible
  kOnlyRotating,      // initialising: rotation alone cannot give depth
  kTooLittleTexture,  // about to start: too few corners in view
  kTooFast,           // initialising: the image is blurred
  kStartLost,         // the first view was lost: back to the start
  kReturnToKnownView
};

// Bits of TrackResult::limits_hit; each names the Config field to raise.
enum LimitBits : uint32_t {
  kLimitKeyframes = 1u << 0,       // max_keyframes: the map is full, none can be spared for a new one
  kLimitMapPoints = 1u << 1,       // max_map_points
  kLimitPartialPoints = 1u << 2,   // max_partial_points
  kLimitMeasuredPoints = 1u << 3,  // max_measured_points: more points were visible than measured (usual)
  kLimitMeasurements = 1u << 4     // max_measurements: what keyframes measured of old points is lost
};

enum class Stage : uint8_t {  // parts of a tracked frame, for TrackResult::stage_ns
  kPyramid,                   // grey conversion and pyramid
  kRotation,                  // full-frame rotation
  kSearch,                    // prediction, visibility, warp, search, refinement
  kPose,                      // pose update
  kPartial,                   // partial points
  kInitialise,                // initialiser or relocaliser
  kKeyframe,                  // copying a new keyframe into the queue
  kCount
};
constexpr int kStages = static_cast<int>(Stage::kCount);

enum class ObservedKind : uint8_t {
  kInlier,   // map point measured and used
  kOutlier,  // measured, zero weight
  kMissed,   // searched and not found; px is the prediction
  kHidden,   // the same, but a neighbour is seen much nearer: it is probably behind
  kPartial,  // partial point measured
  kInitial   // initialisation: point of the first view found in this frame
};
struct ObservedPoint {
  Vector2f px = Vector2f::Zero();  // level-0 pixels
  Vector2f predicted_px = Vector2f::Zero();
  uint32_t point_id = 0;  // map point id (0 for initialisation points)
  ObservedKind kind = ObservedKind::kMissed;
  uint8_t level = 1;  // pyramid level searched
};

struct TrackResult {
  Status status;  // not ok: the frame was refused and nothing changed
  int64_t timestamp_ns = 0;
  TrackingState state = TrackingState::kWaiting;
  TrackingQuality quality = TrackingQuality::kBad;
  Hint hint = Hint::kNone;
  float progress = 0;       // of initialisation, 0 to 1
  uint32_t limits_hit = 0;  // LimitBits
  bool pose_valid = false;  // T_cw and covariance mean something; never true in a state other than kTracking
  bool blurred = false;     // predicted motion blur made the search fall back to L2
  bool keyframe_added = false;
  SE3 T_cw;
  Matrix6f covariance = Matrix6f::Zero();  // of mu in T_cw <- exp(mu) T_cw, world units and radians
  int points_attempted = 0;                // map points searched that should be visible
  int points_found = 0;
  int points_inliers = 0;
  float reprojection_px = 0;  // rms error of an inlier's coordinate, level-0 pixels
  int partial_attempted = 0;
  int partial_found = 0;
  int keyframes = 0;         // in the map, live
  int erased_keyframes = 0;  // kept besides
  int map_points = 0;
  std::span<const ObservedPoint> points;  // valid until the next call of track()
  int64_t stage_ns[kStages] = {};         // by the clock given to set_clock(); zero without one
};

struct KeyframeInfo {
  uint32_t id = 0;
  int64_t timestamp_ns = 0;
  SE3 T_cw;
};
// How well the map explains what its keyframes measured: the bundle's objective at one fixed scale, so that maps of the
// same recording made under different assumptions can be compared.
struct MapFit {
  int measurements = 0;
  // Mean Tukey cost of a measurement at a scale of a quarter of its sigma (half a pixel), and the share of the
  // keyframes' velocities, whose prior is the camera's motion. Squared sigmas.
  float cost = 0;
};
struct MapPointInfo {
  uint32_t id = 0;
  Vector3f p_w = Vector3f::Zero();
  Vector3f normal_w = Vector3f::Zero();
  int measurements = 0;
  uint8_t grey = 0;  // of its source pixel, for pictures
};

// A point found in a keyframe.
struct MeasurementInfo {
  uint32_t point_id = 0;
  uint32_t keyframe_id = 0;
  Vector2f px = Vector2f::Zero();         // level-0 pixels, as measured
  Vector2f global_px = Vector2f::Zero();  // where a global shutter would have seen it: what T_cw alone explains
  float sigma = 1;                        // expected, level-0 pixels
};

// What a saved map says of itself.
struct MapInfo {
  int version = 0;
  Camera camera;  // with which it was made, not prepared; Config's must be the same to load it
  int keyframes = 0, erased_keyframes = 0, map_points = 0, partial_points = 0;
  // Capacities of a Config that can load it.
  int min_keyframes = 0, min_erased_keyframes = 0, min_map_points = 0, min_partial_points = 0;
  int min_measurements = 0, min_measurements_per_point = 0;
};

class System {
 public:
  // Bytes of memory that create() needs for this configuration.
  static size_t required_bytes(const Config& config);
  // Builds the system inside memory (aligned as by malloc, at least required_bytes), which must outlive it. *system is
  // set only on success; there is nothing to destroy.
  static Status create(const Config& config, std::span<std::byte> memory, System** system);

  // For stage times and for the slices' length; may be null. The clock must outlive the system or be replaced.
  void set_clock(const Clock* clock);

  // Tracks one frame to completion. Refuses (result.status) incomplete frames, another size than the camera's, and
  // timestamps that do not increase.
  TrackResult track(const Frame& frame);

  bool has_work() const;  // is there anything for idle time?
  void work_slice();      // one slice of mapping, at most about 0.25 million ARMv6 instructions

  // Starts initialisation with the next frame. With a map, or initialising already: forgets it and starts again.
  void tap();
  void reset();  // forgets everything, waits for a tap or for Config::auto_start

  // Scales the world so that two map points (ids as in map_points() or TrackResult::points) are `length` world units
  // apart; poses follow from the next frame on. Refused when there is no finished map, a point does not exist, the
  // length is not within a millionth to a million times what it was, or the map would reach over 1e8 units or under
  // 1e-8; nothing changes then.
  Status set_length(uint32_t point_a, uint32_t point_b, float length);

  // A finished map as bytes, between two slices: a versioned, checksummed format, the same on every target
  // (map/map_file.h describes it). With everything needed to find the pose again and go on; keyframes still in the
  // queue are not in it. All at once: 20 to 30 million ARMv6 instructions for a full map of the phone's.
  size_t map_bytes() const;  // exactly what save_map() writes now; 0: there is no finished map
  // Refused when there is no finished map or out is smaller than map_bytes(); *bytes is set on success.
  Status save_map(std::span<std::byte> out, size_t* bytes) const;
  // Header and checksum of a saved map, for making a Config that can load it. *info is set on success.
  static Status map_info(std::span<const std::byte> file, MapInfo* info);
  // Replaces the map, or whatever was being done, by a saved one. The state is kLost then: the relocaliser finds the
  // pose in the next frames that show a known view. Refused, with nothing changed, unless the whole file is good, was
  // made with this camera and shutter, and fits Config's capacities.
  Status load_map(std::span<const std::byte> file);

  // A locked map is tracked only: no new keyframes or points, no mapping work, until it is unlocked. Without a finished
  // map it waits for one. Stays as set through tap(), reset() and load_map().
  void set_locked(bool locked);
  bool locked() const;

  // Copies up to out.size() entries in the order of their ids (keyframes: live ones); returns how many there are in
  // all.
  int keyframes(std::span<KeyframeInfo> out) const;
  MapFit map_fit() const;
  // Into how many parts the map falls where live keyframes hold together by at least so many common points: 1 for a
  // sound map, 0 without one. For judging maps, slow.
  int map_parts(int common_points) const;
  int map_points(std::span<MapPointInfo> out) const;
  int measurements(std::span<MeasurementInfo> out) const;  // by point, as map_points()
  // Level 0 of a live or erased keyframe, valid until the next call that is not const; empty: no such id.
  GreyView keyframe_image(uint32_t id) const;

  const Config& config() const;
  const WorkMeter& work_meter() const;
  uint64_t map_hash() const;  // of poses, points and measurements: equal maps on every target have equal hashes

 private:
  struct Impl;
  explicit System(Impl* impl) : impl_(impl) {}
  Impl* impl_;
};

}  // namespace pptam
