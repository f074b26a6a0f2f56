// Pocket PTAM in C99: the interface for C, for whatever calls C (Python's ctypes, ...), and for who wants to exchange
// the shared library without compiling again. It does what pocket_ptam.h and model_tracker.h do, with plain numbers.
//
//   pptam_config config;
//   pptam_config_phone(&camera, &config);                          // camera: width, height, fx, fy, cx, cy, ...
//   size_t bytes = pptam_required_bytes(&config);
//   pptam_system* s = NULL;
//   pptam_status status = pptam_create(&config, malloc(bytes), bytes, &s);      // check it: code and message
//   pptam_tap(s);                                                  // start at the next frame, or config.auto_start
//   for (every frame) {
//     pptam_track_result r;
//     status = pptam_track(s, &frame, &r);                                      // high priority, bounded time
//     while (there is time before the next frame && pptam_has_work(s)) pptam_work_slice(s);
//   }
//
// One thread. No heap: everything lives in the caller's block, there is nothing to destroy, and any number of systems
// may live side by side. A call that is refused says why, and has changed nothing: neither the system nor, but for a
// frame's result, what its arguments point to. A null handle is refused like any other bad argument. Messages name the
// fields of the C++ interface, which are called the same here: Config::max_maps is pptam_config.max_maps.
//
// The world's unit is arbitrary; z = 0 is the dominant plane of the first view or the ground, z is up. Camera: x right,
// y down, z forward. Pixels: level 0, centres at integers, (0, 0) is the top-left one. Enumerations are stored as
// int32_t, so that structures are the same for every compiler. Who compiles this needs no option and no other header.
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#if defined(__GNUC__)
#define PPTAM_API __attribute__((visibility("default")))
#else
#define PPTAM_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

// ---- Status ---------------------------------------------------------------------------------------------------------

typedef enum pptam_status_code {
  PPTAM_OK,
  PPTAM_INVALID_ARGUMENT,     // null, a wrong size or stride, an impossible calibration
  PPTAM_OUT_OF_MEMORY,        // the caller's block or buffer is too small
  PPTAM_TIME_WENT_BACKWARDS,  // a frame's timestamp is not later than the one before
  PPTAM_NOT_READY,            // there is no finished map yet
  PPTAM_BAD_FILE,             // not a saved map, one of another version, or a damaged one
  PPTAM_CONFIG_MISMATCH       // a valid saved map, but of another camera, or too large for the capacities
} pptam_status_code;

typedef struct pptam_status {
  int32_t code;         // pptam_status_code
  const char* message;  // what was wrong and what to do; "" when ok. Never null, lives for ever
} pptam_status;

// The library's version, such as "1.2.3".
PPTAM_API const char* pptam_version(void);

// The function that a bug of the library calls, for the whole process; null: trap, as at first. Release builds check
// nothing.
typedef void (*pptam_assert_handler)(const char* expression, const char* file, int line);
PPTAM_API void pptam_set_assert_handler(pptam_assert_handler handler);

// ---- Geometry -------------------------------------------------------------------------------------------------------

// A rigid motion: R p + t. R by rows.
typedef struct pptam_pose {
  float R[9];
  float t[3];
} pptam_pose;

// The inverse as trajectories' files have it: for T_cw the camera's position in the world, and its rotation, camera to
// world, as a unit quaternion x, y, z, w with w >= 0.
PPTAM_API pptam_status pptam_inverse_as_quaternion(const pptam_pose* pose, float position[3], float quaternion_xyzw[4]);

// ---- Camera ---------------------------------------------------------------------------------------------------------

typedef enum pptam_distortion {
  PPTAM_DISTORTION_NONE,
  PPTAM_DISTORTION_FOV,         // coeffs: w, radians
  PPTAM_DISTORTION_RADTAN,      // k1, k2, p1, p2, k3: OpenCV's, ROS' plumb_bob
  PPTAM_DISTORTION_EQUIDISTANT  // k1, k2, k3, k4: fisheye of OpenCV and Kalibr
} pptam_distortion;

typedef enum pptam_shutter_axis { PPTAM_SHUTTER_ROWS, PPTAM_SHUTTER_COLUMNS } pptam_shutter_axis;

// Lens and rolling shutter. Set all of it: begin with {0}.
typedef struct pptam_camera {
  int32_t width, height;  // pixels
  float fx, fy, cx, cy;   // pixels
  int32_t distortion;     // pptam_distortion
  float coeffs[5];        // those that the distortion does not have are not read
  int32_t shutter_axis;   // pptam_shutter_axis: whether rows or columns are exposed one after the other
  // Signed seconds from one line to the next, positive when larger coordinates are exposed later. 0: global shutter.
  float line_time_s;
} pptam_camera;

// Whether the calibration is possible: see CameraModel::validate() in camera_model.h.
PPTAM_API pptam_status pptam_camera_validate(const pptam_camera* camera);

// ---- Configuration --------------------------------------------------------------------------------------------------

// Units of work that are counted, each with a price: see work_meter.h.
typedef enum pptam_work {
  PPTAM_WORK_GREY_PIXEL,
  PPTAM_WORK_PYRAMID_PIXEL,
  PPTAM_WORK_CORNER_PIXEL,
  PPTAM_WORK_CORNER_ASCENT,
  PPTAM_WORK_ROTATION_PIXEL,
  PPTAM_WORK_POINT_PROJECTED,
  PPTAM_WORK_PATCH_WARP,
  PPTAM_WORK_PATCH_CANDIDATE,
  PPTAM_WORK_PATCH_REFINE_STEP,
  PPTAM_WORK_POSE_POINT,
  PPTAM_WORK_POSE_PROJECTION,
  PPTAM_WORK_HOMOGRAPHY_POINT,
  PPTAM_WORK_KEYFRAME_PIXEL,
  PPTAM_WORK_BUNDLE_ERROR,
  PPTAM_WORK_BUNDLE_PROJECTION,
  PPTAM_WORK_BUNDLE_MOTION,
  PPTAM_WORK_BUNDLE_BLOCK,
  PPTAM_WORK_BUNDLE_SOLVE,
  PPTAM_WORK_BUNDLE_STEP,
  PPTAM_WORK_OTHER,
  PPTAM_WORK_COUNT
} pptam_work;

// Turns work into the modelled time of a device.
typedef struct pptam_phone_profile {
  float clock_mhz;
  float cycles_per_instruction;
  float instructions[PPTAM_WORK_COUNT];  // for a unit of each pptam_work
} pptam_phone_profile;

// All settings. Begin with pptam_config_phone(). Capacities (max_...) bound memory and time; one that was reached shows
// in pptam_track_result.limits_hit. Ranges and what was measured: config.h, whose fields have the same names.
typedef struct pptam_config {
  pptam_camera camera;
  float exposure_s;                    // of a line, predicts motion blur; at most 1. 0: unknown
  int32_t max_keyframes;               // live ones, in bundle adjustment (35)
  int32_t max_erased_keyframes;        // whose images are kept for patches and relocalisation (35)
  int32_t max_maps;                    // kept, the one in use included (3)
  int32_t max_map_points;              // of each map (1000)
  int32_t max_measurements;            // beyond two of each point, all maps together (6000)
  int32_t max_measurements_per_point;  // (8)
  int32_t max_partial_points;          // whose depth is being found (100)
  int32_t max_measured_points;         // searched in a frame (50)
  int32_t max_partial_searches;        // partial points searched in a frame (12)
  int32_t max_new_partial_points;      // of a keyframe (25)
  int32_t max_initial_points;          // of the first view (100)
  int32_t cells_x, cells_y;            // of the image, over which measured points are spread (6, 8)
  int32_t search_level;                // pyramid level of a sharp frame (1)
  int32_t coarse_search_level;         // of a blurred one or a wide search (2)
  // Scale: the length of the sideways start, or, when it is not 0, the distance from the camera to the plane z = 0 in
  // the first view, world units (0.1, 0). See also pptam_set_length().
  float initial_baseline;
  float initial_plane_distance;
  bool auto_start;  // starts without a tap when the camera is held still; when it stays lost, with another map (false)
  float min_keyframe_interval_s;  // (0.2)
  bool steady_damping;            // of the pose while the whole image is at rest (true)
  pptam_phone_profile profile;
} pptam_config;

// The 2009 phone's parts and capacities for a camera. The calibration is looked at by pptam_create().
PPTAM_API pptam_status pptam_config_phone(const pptam_camera* camera, pptam_config* config);
// For a small camera of a microcontroller, 192x144 pixels at most: see Config::tiny in config.h.
PPTAM_API pptam_status pptam_config_tiny(const pptam_camera* camera, pptam_config* config);
PPTAM_API pptam_status pptam_config_validate(const pptam_config* config);

// ---- System ---------------------------------------------------------------------------------------------------------

typedef struct pptam_system pptam_system;

// Bytes of memory that pptam_create() needs; 0 when pptam_config_validate() refuses the configuration.
PPTAM_API size_t pptam_required_bytes(const pptam_config* config);
// These bytes by what they are for; a configuration that is refused has changed nothing.
typedef struct pptam_memory_parts {
  size_t map;       // keyframes' images, points, measurements, partial points
  size_t tracking;  // the frame's pyramid, the search, the start, corners
  size_t mapping;   // bundle adjustment, paused jobs
  size_t rest;      // settings and bookkeeping
} pptam_memory_parts;
PPTAM_API pptam_status pptam_required_parts(const pptam_config* config, pptam_memory_parts* parts);
// Builds a system inside memory, aligned as by malloc, which must outlive it. *system is set on success only.
PPTAM_API pptam_status pptam_create(const pptam_config* config, void* memory, size_t bytes, pptam_system** system);
// The configuration that the system was made with.
PPTAM_API pptam_status pptam_get_config(const pptam_system* system, pptam_config* config);

// Nanoseconds from any origin that never decrease; for pptam_track_result.stage_ns. Null: no stage times, as at first.
typedef int64_t (*pptam_clock)(void* user);
PPTAM_API pptam_status pptam_set_clock(pptam_system* system, pptam_clock now_ns, void* user);

// What the system does while it does it, for traces: see tracer.h. Spans are nested, counters are told at the end of
// each frame. Nothing that is tracked or mapped depends on it.
typedef enum pptam_span {
  PPTAM_SPAN_FRAME,  // a call of pptam_track(); in it, one after the other, its stages
  PPTAM_SPAN_PYRAMID,
  PPTAM_SPAN_ROTATION,
  PPTAM_SPAN_SEARCH,
  PPTAM_SPAN_POSE,
  PPTAM_SPAN_PARTIAL,
  PPTAM_SPAN_INITIALISE,
  PPTAM_SPAN_KEYFRAME,
  PPTAM_SPAN_SLICE,  // a call of pptam_work_slice(); in it what it worked on
  PPTAM_SPAN_FINISH_MAP,
  PPTAM_SPAN_INSERT,
  PPTAM_SPAN_ADJUST_NEW,
  PPTAM_SPAN_ADJUST,
  PPTAM_SPAN_CULL,
  PPTAM_SPAN_TIDY,
  PPTAM_SPAN_COUNT
} pptam_span;
typedef enum pptam_counter {
  PPTAM_COUNTER_KEYFRAMES,
  PPTAM_COUNTER_MAP_POINTS,
  PPTAM_COUNTER_INLIERS,
  PPTAM_COUNTER_QUALITY,
  PPTAM_COUNTER_COUNT
} pptam_counter;
typedef struct pptam_tracer {
  void (*begin)(void* user, int32_t span);  // pptam_span
  void (*end)(void* user, int32_t span);    // of the span begun last
  void (*count)(void* user, int32_t counter, int64_t value);
  void* user;
} pptam_tracer;
// Takes a copy; all three functions must be there. Null: no tracer, as at first.
PPTAM_API pptam_status pptam_set_tracer(pptam_system* system, const pptam_tracer* tracer);

typedef enum pptam_pixel_format {
  PPTAM_PIXEL_GREY,
  PPTAM_PIXEL_BGRA,
  PPTAM_PIXEL_RGB24,
  PPTAM_PIXEL_YUYV,
  PPTAM_PIXEL_NV12,  // of this and the following only the Y plane is read
  PPTAM_PIXEL_NV21,
  PPTAM_PIXEL_I420
} pptam_pixel_format;

typedef struct pptam_frame {
  const uint8_t* data;    // the first plane
  int32_t width, height;  // pixels, as the camera's
  int32_t stride_bytes;   // from one row of the first plane to the next
  int32_t format;         // pptam_pixel_format
  int64_t timestamp_ns;   // mid-exposure of the image's centre, from any origin
} pptam_frame;

typedef enum pptam_tracking_state {
  PPTAM_TRACKING_WAITING,       // no map: pptam_tap() starts, or it starts by itself (auto_start)
  PPTAM_TRACKING_INITIALISING,  // the first view is tracked: move sideways
  PPTAM_TRACKING_TRACKING,      // the map is tracked
  PPTAM_TRACKING_LOST           // there is a map, but the pose is unknown; it is sought in every frame
} pptam_tracking_state;

typedef enum pptam_tracking_quality {
  PPTAM_QUALITY_BAD,
  PPTAM_QUALITY_POOR,
  PPTAM_QUALITY_GOOD
} pptam_tracking_quality;

typedef enum pptam_hint {
  PPTAM_HINT_NONE,
  PPTAM_HINT_TAP,
  PPTAM_HINT_HOLD_STILL,
  PPTAM_HINT_MOVE_SIDEWAYS,
  PPTAM_HINT_ONLY_ROTATING,
  PPTAM_HINT_TOO_LITTLE_TEXTURE,
  PPTAM_HINT_TOO_FAST,
  PPTAM_HINT_START_LOST,
  PPTAM_HINT_RETURN_TO_KNOWN_VIEW
} pptam_hint;
// A few words for the user, such as "move sideways"; "" for none and for what is no pptam_hint.
PPTAM_API const char* pptam_hint_text(int32_t hint);

// Bits of limits_hit. Each names the field of pptam_config to raise.
typedef enum pptam_limit {
  PPTAM_LIMIT_KEYFRAMES = 1,        // max_keyframes: the map is full
  PPTAM_LIMIT_MAP_POINTS = 2,       // max_map_points
  PPTAM_LIMIT_PARTIAL_POINTS = 4,   // max_partial_points
  PPTAM_LIMIT_MEASURED_POINTS = 8,  // max_measured_points: more were visible than searched (usual)
  PPTAM_LIMIT_MEASUREMENTS = 16     // max_measurements
} pptam_limit;

typedef enum pptam_stage {  // parts of pptam_track(), for stage_ns
  PPTAM_STAGE_PYRAMID,
  PPTAM_STAGE_ROTATION,
  PPTAM_STAGE_SEARCH,
  PPTAM_STAGE_POSE,
  PPTAM_STAGE_PARTIAL,
  PPTAM_STAGE_INITIALISE,
  PPTAM_STAGE_KEYFRAME,
  PPTAM_STAGE_COUNT
} pptam_stage;

// What became of a frame: TrackResult of track_result.h, which says more of each field.
typedef struct pptam_track_result {
  int64_t timestamp_ns;
  int32_t state;        // pptam_tracking_state
  int32_t quality;      // pptam_tracking_quality
  int32_t hint;         // pptam_hint
  float progress;       // of initialisation, 0 to 1
  uint32_t limits_hit;  // pptam_limit
  bool pose_valid;      // whether T_cw, velocity and covariance are valid
  bool blurred;         // much motion blur was predicted; the map took nothing
  bool misfit;          // the points agree far worse than usual: a zoom, a stabiliser's jump
  bool keyframe_added;
  bool repeated;         // the last picture again, bit for bit: its pose
  pptam_pose T_cw;       // world to camera at the timestamp
  float velocity[6];     // of the camera in its own frame: translation, units/s, rotation, rad/s
  float covariance[36];  // of mu in T_cw <- exp(mu) T_cw, translation before rotation; 6x6, symmetric
  int32_t points_attempted, points_found, points_inliers;
  float reprojection_px;  // rms error of an inlier's coordinate
  int32_t partial_attempted, partial_found;
  int32_t map;                          // of the pose: 1, 2, ... in the order of their finish; 0: none is finished
  int32_t world_changes;                // by pptam_set_length() and pptam_set_ground(): place anew what was placed
  int32_t maps;                         // kept, that in use included
  int32_t keyframes, erased_keyframes;  // of the map
  int32_t map_points;
  int32_t observed_points;              // what pptam_observed_points() has
  int64_t stage_ns[PPTAM_STAGE_COUNT];  // zero without a clock
} pptam_track_result;

// Tracks one frame to completion; its pixels are not needed afterwards. A frame that is refused leaves a result whose
// timestamp alone is set.
PPTAM_API pptam_status pptam_track(pptam_system* system, const pptam_frame* frame, pptam_track_result* result);

typedef enum pptam_observed_kind {
  PPTAM_OBSERVED_INLIER,
  PPTAM_OBSERVED_OUTLIER,
  PPTAM_OBSERVED_MISSED,   // px is the prediction
  PPTAM_OBSERVED_HIDDEN,   // not found, probably behind something nearer; px is the prediction
  PPTAM_OBSERVED_PARTIAL,  // a point whose depth is being found
  PPTAM_OBSERVED_INITIAL   // of the first view, while the start is made
} pptam_observed_kind;

typedef struct pptam_observed_point {
  float px[2];
  float predicted_px[2];  // of PPTAM_OBSERVED_INITIAL the position in the first view
  uint32_t point_id;      // 0 for initialisation points
  int32_t kind;           // pptam_observed_kind
  int32_t level;          // pyramid level searched
} pptam_observed_point;

// In this and all functions with out, capacity and count: copies up to capacity entries and says in *count how many
// there are in all. out may be null when capacity is 0. Here: of the last frame that was not refused.
PPTAM_API pptam_status pptam_observed_points(const pptam_system* system, pptam_observed_point* out, size_t capacity,
                                             int32_t* count);

// Whether there is mapping work for idle time, and one slice of it: about a millisecond on the phone.
PPTAM_API bool pptam_has_work(const pptam_system* system);
PPTAM_API pptam_status pptam_work_slice(pptam_system* system);

// Starts with the next frame. Maps, or a start in progress, are discarded.
PPTAM_API pptam_status pptam_tap(pptam_system* system);
// Discards everything; then waits for a tap or for auto_start.
PPTAM_API pptam_status pptam_reset(pptam_system* system);
// A locked map is only tracked. A lock without a map takes effect once there is one.
PPTAM_API pptam_status pptam_set_locked(pptam_system* system, bool locked);
PPTAM_API bool pptam_locked(const pptam_system* system);
// Scales the world so that two map points are length apart: see System::set_length().
PPTAM_API pptam_status pptam_set_length(pptam_system* system, uint32_t point_a, uint32_t point_b, float length);
// The plane at pixel px of the last frame becomes z = 0, px the origin: see System::set_ground(). change: takes old
// coordinates to new ones; may be null.
PPTAM_API pptam_status pptam_set_ground(pptam_system* system, const float px[2], pptam_pose* change);

// Pixel of a world point at the exposure time of its own line: for drawing. *visible: whether it is before the lens and
// not too far outside the image; px is set only then.
PPTAM_API pptam_status pptam_project(const pptam_system* system, const pptam_pose* T_cw, const float velocity[6],
                                     const float p_w[3], float px[2], bool* visible);
// The ray (x/z, y/z) of a pixel, in the camera's frame.
PPTAM_API pptam_status pptam_unproject(const pptam_system* system, const float px[2], float ray[2]);

// ---- The map --------------------------------------------------------------------------------------------------------

typedef struct pptam_keyframe {
  uint32_t id;
  int64_t timestamp_ns;
  pptam_pose T_cw;
} pptam_keyframe;

typedef struct pptam_map_point {
  uint32_t id;
  float p_w[3];
  float normal_w[3];     // unit normal of the patch
  int32_t measurements;  // count
  int32_t grey;          // of its source pixel, 0 to 255
} pptam_map_point;

// A map point measured in a keyframe.
typedef struct pptam_measurement {
  uint32_t point_id;
  uint32_t keyframe_id;
  float px[2];         // as measured
  float global_px[2];  // corrected to a global shutter at the keyframe's timestamp
  float sigma;         // expected standard deviation of a coordinate, pixels
} pptam_measurement;

// map: which one, as in pptam_track_result.map; 0: that in use. One that is not kept has nothing. Keyframes are live
// ones by ascending id; measurements are grouped by point, in the order of the map points.
PPTAM_API pptam_status pptam_keyframes(const pptam_system* system, int32_t map, pptam_keyframe* out, size_t capacity,
                                       int32_t* count);
PPTAM_API pptam_status pptam_map_points(const pptam_system* system, int32_t map, pptam_map_point* out, size_t capacity,
                                        int32_t* count);
PPTAM_API pptam_status pptam_measurements(const pptam_system* system, int32_t map, pptam_measurement* out,
                                          size_t capacity, int32_t* count);

// A plane of the map, a ground that could be chosen; the largest first, four at most: see System::planes().
typedef struct pptam_plane {
  float normal_w[3];  // unit, towards the map's first camera
  float middle_w[3];  // mean of its points
  float threshold;    // distance up to which a point lies on it, world units
  int32_t points;
} pptam_plane;
PPTAM_API pptam_status pptam_planes(const pptam_system* system, int32_t map, pptam_plane* out, size_t capacity,
                                    int32_t* count);

typedef struct pptam_image {
  const uint8_t* data;    // grey
  int32_t width, height;  // pixels
  int32_t stride_bytes;
} pptam_image;
// Image of a keyframe, erased ones included, valid until the next call with a system that is not const. Refused when no
// keyframe has the id.
PPTAM_API pptam_status pptam_keyframe_image(const pptam_system* system, uint32_t keyframe_id, pptam_image* image);

// Judging the map in use, for tests and studies; slow: see inspection.h. The hash is the same on every target.
PPTAM_API uint64_t pptam_map_hash(const pptam_system* system);  // 0 of a null handle
PPTAM_API pptam_status pptam_map_fit(const pptam_system* system, int32_t* measurements, float* cost);
PPTAM_API pptam_status pptam_map_parts(const pptam_system* system, int32_t common_points, int32_t* parts);

// ---- Saved maps -----------------------------------------------------------------------------------------------------

// Bytes that pptam_save_map() writes now; 0 without a finished map.
PPTAM_API size_t pptam_map_bytes(const pptam_system* system);
// All finished maps, in a checksummed format that is the same on every target. *bytes: what was written.
PPTAM_API pptam_status pptam_save_map(const pptam_system* system, void* out, size_t capacity, size_t* bytes);
// Replaces all maps by those of a file with the same camera; the pose is found when a known view comes. A file that is
// refused has changed nothing.
PPTAM_API pptam_status pptam_load_map(pptam_system* system, const void* file, size_t bytes);

// Header of a saved map: see MapInfo in map_info.h.
typedef struct pptam_map_info {
  int32_t version;
  pptam_camera camera;  // with which it was made
  int32_t maps;
  int32_t keyframes, erased_keyframes, map_points, partial_points;  // of all of them
  // Smallest capacities (max_... of pptam_config) with which it can be loaded.
  int32_t min_keyframes, min_erased_keyframes, min_map_points, min_partial_points;
  int32_t min_measurements, min_measurements_per_point;
} pptam_map_info;
PPTAM_API pptam_status pptam_read_map_info(const void* file, size_t bytes, pptam_map_info* info);

// ---- Work -----------------------------------------------------------------------------------------------------------

// What was charged so far: units of one pptam_work, ARMv6 instructions, and the profile's time for them; -1 of a null
// handle and of what is no pptam_work.
PPTAM_API int64_t pptam_work_units(const pptam_system* system, int32_t work);
PPTAM_API int64_t pptam_work_instructions(const pptam_system* system);
PPTAM_API int64_t pptam_work_ns(const pptam_system* system);

// ---- A known object, tracked by its edges ---------------------------------------------------------------------------

// The parts of an object: see ModelLine and so on in model_tracker.h, whose fields have the same names. a, b and
// corners are indices of points. Lengths are in the model's unit.
typedef struct pptam_model_line {
  int32_t a, b;
  float min_length_px;  // left out where it is shorter in the image
} pptam_model_line;

typedef struct pptam_model_face {
  int32_t first, count;  // corners[first] to corners[first + count - 1], counter-clockwise seen from outside
  bool open;             // no side between the last corner and the first
  float min_area_px2;    // left out where it is smaller in the image
  float min_length_px;   // of its sides
} pptam_model_face;

typedef struct pptam_model_cylinder {
  int32_t a, b;
  float radius;
  float min_length_px;
} pptam_model_cylinder;

typedef struct pptam_model_circle {
  float centre[3];
  float normal[3];  // of any length
  float radius;
  bool both_sides;
  float min_area_px2;
} pptam_model_circle;

typedef struct pptam_model_sphere {
  float centre[3];
  float radius;
  float min_area_px2;
} pptam_model_sphere;

// The caller's arrays; where a count is 0 the array may be null. Begin with {0}.
typedef struct pptam_object_arrays {
  const float* points;  // x, y, z of each
  const int32_t* corners;
  const pptam_model_line* lines;
  const pptam_model_face* faces;
  const pptam_model_cylinder* cylinders;
  const pptam_model_circle* circles;
  const pptam_model_sphere* spheres;
  size_t point_count, corner_count, line_count, face_count, cylinder_count, circle_count, sphere_count;
  bool outlines_of_smooth;  // sides under 30 degrees count only where they are the outline
} pptam_object_arrays;

// An object in a block of its own, which must outlive the trackers of it; the arrays need not.
typedef struct pptam_object_model pptam_object_model;

// 0 when a count is absurd or its array null.
PPTAM_API size_t pptam_object_model_required_bytes(const pptam_object_arrays* arrays);
// Refuses what cannot be tracked: see ObjectModel::validate() in model_tracker.h. *model is set on success only.
PPTAM_API pptam_status pptam_object_model_create(const pptam_object_arrays* arrays, void* memory, size_t bytes,
                                                 pptam_object_model** model);

// Other ways than the usual one, to be compared: see ModelMethod in model_tracker.h.
typedef struct pptam_model_method {
  bool no_weights;
  float likelihood_threshold;
  bool scale_once;
  bool constant_jacobian;
} pptam_model_method;

typedef struct pptam_model_tracker_config {
  pptam_camera camera;
  const pptam_object_model* model;
  float site_spacing_px;  // between sites along a contour, pixels of a pyramid level (4)
  int32_t max_sites;      // 50 to 5000 (800)
  pptam_model_method method;
} pptam_model_tracker_config;

// The usual settings for a camera and an object.
PPTAM_API pptam_status pptam_model_tracker_config_usual(const pptam_camera* camera, const pptam_object_model* model,
                                                        pptam_model_tracker_config* config);
PPTAM_API pptam_status pptam_model_tracker_config_validate(const pptam_model_tracker_config* config);

typedef struct pptam_model_tracker pptam_model_tracker;

// As pptam_required_bytes() and pptam_create().
PPTAM_API size_t pptam_model_tracker_required_bytes(const pptam_model_tracker_config* config);
PPTAM_API pptam_status pptam_model_tracker_create(const pptam_model_tracker_config* config, void* memory, size_t bytes,
                                                  pptam_model_tracker** tracker);
PPTAM_API pptam_status pptam_model_tracker_get_config(const pptam_model_tracker* tracker,
                                                      pptam_model_tracker_config* config);

// Where the object is in the next frame: near T_co (object to camera); by 4 to 100 of its points (x, y, z) and where
// they are seen (x, y); or anywhere. See ModelTracker in model_tracker.h.
PPTAM_API pptam_status pptam_model_start(pptam_model_tracker* tracker, const pptam_pose* T_co);
PPTAM_API pptam_status pptam_model_start_from_points(pptam_model_tracker* tracker, const float* points_o,
                                                     const float* px, size_t count);
PPTAM_API pptam_status pptam_model_start_anywhere(pptam_model_tracker* tracker);
PPTAM_API pptam_status pptam_model_reset(pptam_model_tracker* tracker);  // waits for a start

typedef enum pptam_model_state { PPTAM_MODEL_WAITING, PPTAM_MODEL_TRACKING, PPTAM_MODEL_LOST } pptam_model_state;

typedef enum pptam_model_feature {
  PPTAM_MODEL_LINE,
  PPTAM_MODEL_CYLINDER,
  PPTAM_MODEL_CIRCLE,
  PPTAM_MODEL_SPHERE
} pptam_model_feature;
enum { PPTAM_MODEL_FEATURES = 4 };  // count

typedef struct pptam_model_result {
  int64_t timestamp_ns;
  int32_t state;  // pptam_model_state
  bool pose_valid;
  bool restarted;        // the pose was found anew in this frame
  pptam_pose T_co;       // object to camera
  float covariance[36];  // of mu in T_co <- exp(mu) T_co, model units and radians
  float quality;         // share of the visible contours that look as they should, 0 to 1
  float error_px;        // rms distance of inliers from their contours
  float feature_error_px[PPTAM_MODEL_FEATURES];
  int32_t feature_inliers[PPTAM_MODEL_FEATURES];
  int32_t sites_visible, sites_inliers;
  int32_t sites;  // what pptam_model_sites() has
} pptam_model_result;

// As pptam_track().
PPTAM_API pptam_status pptam_model_track(pptam_model_tracker* tracker, const pptam_frame* frame,
                                         pptam_model_result* result);

typedef enum pptam_site_kind {
  PPTAM_SITE_INLIER,
  PPTAM_SITE_REJECTED_LOCALLY,  // nothing along the normal is like what the site has shown before
  PPTAM_SITE_REJECTED_ROBUSTLY  // an edge was found, but the pose does not agree with it
} pptam_site_kind;

// A place on a visible contour.
typedef struct pptam_model_site {
  float px[2];        // of the edge found
  float model_px[2];  // on the model's contour at T_co
  int32_t contour;    // sites of the same contour follow each other along it
  int32_t kind;       // pptam_site_kind
} pptam_model_site;
// Of the last frame that was not refused.
PPTAM_API pptam_status pptam_model_sites(const pptam_model_tracker* tracker, pptam_model_site* out, size_t capacity,
                                         int32_t* count);

#ifdef __cplusplus
}
#endif
