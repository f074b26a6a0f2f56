// The result of System::track() for one frame.
#pragma once

#include <cstdint>
#include <span>

#include <pocket_ptam/se3.h>
#include <pocket_ptam/status.h>

namespace pptam {

enum class TrackingState : uint8_t {
  kWaiting,       // no map: tap() starts initialisation, or it starts by itself (Config::auto_start)
  kInitialising,  // the first view is tracked; move sideways
  kTracking,      // the map is tracked; whether this frame has a pose is TrackResult::pose_valid
  kLost           // there is a map, but the pose is unknown; the relocaliser tries in every frame
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
  kStartLost,         // the first view was lost; it begins again by itself with Config::auto_start, else tap again
  kReturnToKnownView  // lost: show a view that a keyframe has seen
};

// Bits of TrackResult::limits_hit. Each names the Config field to raise.
enum LimitBits : uint32_t {
  kLimitKeyframes = 1u << 0,       // max_keyframes: the map is full, no keyframe can be erased for a new one
  kLimitMapPoints = 1u << 1,       // max_map_points
  kLimitPartialPoints = 1u << 2,   // max_partial_points
  kLimitMeasuredPoints = 1u << 3,  // max_measured_points: more points were visible than searched (usual)
  kLimitMeasurements = 1u << 4     // max_measurements: keyframes' further measurements of old points are dropped
};

enum class Stage : uint8_t {  // parts of System::track(), for TrackResult::stage_ns
  kPyramid,                   // grey conversion and pyramid
  kRotation,                  // full-frame rotation
  kSearch,                    // map points: prediction, visibility, warp, search, refinement
  kPose,                      // pose update, and what is made of the pose
  kPartial,                   // partial points, searched and corrected
  kInitialise,                // initialiser; the pose that the relocaliser proposes
  kKeyframe,                  // copying a new keyframe into the queue
  kCount
};
constexpr int kStages = static_cast<int>(Stage::kCount);

enum class ObservedKind : uint8_t {
  kInlier,   // map point measured, used for the pose
  kOutlier,  // map point measured, of zero weight in the pose update
  kMissed,   // map point searched and not found; px is the prediction
  kHidden,   // map point not found, probably occluded: a neighbour is much nearer to the camera; px is the prediction
  kPartial,  // partial point measured
  kInitial   // initialisation: point of the first view found in this frame
};
struct ObservedPoint {
  Vector2f px = Vector2f::Zero();            // level-0 pixels
  Vector2f predicted_px = Vector2f::Zero();  // level-0 pixels; for kInitial the position in the first view
  uint32_t point_id = 0;                     // map point id (0 for initialisation points)
  ObservedKind kind = ObservedKind::kMissed;
  uint8_t level = 1;  // pyramid level searched
};

struct TrackResult {
  Status status;             // not ok: the frame was refused, nothing changed, all else but the timestamp is default
  int64_t timestamp_ns = 0;  // the frame's
  TrackingState state = TrackingState::kWaiting;
  TrackingQuality quality = TrackingQuality::kBad;
  Hint hint = Hint::kNone;
  float progress = 0;       // of initialisation, 0 to 1
  uint32_t limits_hit = 0;  // LimitBits
  bool pose_valid = false;  // whether T_cw and covariance are valid; true only in state kTracking
  // Much motion blur was predicted, so the search used Config::coarse_search_level, and the map took nothing.
  bool blurred = false;
  // The points agree, but far worse than usual: a zoom, a stabiliser's jump, pictures out of order. The quality is
  // poor, and the map took nothing unless few points were left.
  bool misfit = false;
  bool keyframe_added = false;
  bool repeated = false;  // the last picture again, bit for bit: its pose, nothing was searched
  SE3 T_cw;
  // Of the camera during the frame's readout, in its own frame: translation, world units/s, and rotation, radians/s.
  // The line exposed dt seconds after the timestamp is seen from exp(dt velocity) T_cw (camera.h). Zero without a pose.
  Vector6f velocity = Vector6f::Zero();
  Matrix6f covariance = Matrix6f::Zero();  // of mu in T_cw <- exp(mu) T_cw, world units and radians
  int points_attempted = 0;                // map points searched because they should be visible
  int points_found = 0;
  int points_inliers = 0;
  float reprojection_px = 0;  // rms error of an inlier's coordinate, level-0 pixels
  int partial_attempted = 0;
  int partial_found = 0;
  // Which map the pose belongs to, each in a world of its own: 1, 2, ... in the order in which they were finished; 0
  // without a finished map. A number comes again when its map is taken up again.
  int map = 0;
  // How often set_length() and set_ground() have changed the coordinates of the map then in use: what was placed by
  // older ones is to be moved.
  int world_changes = 0;
  int maps = 0;              // finished ones that are kept, that in use included
  int keyframes = 0;         // in the map, live
  int erased_keyframes = 0;  // kept for patches and relocalisation
  int map_points = 0;
  std::span<const ObservedPoint> points;  // valid until the next call of track()
  int64_t stage_ns[kStages] = {};         // time of each Stage by the clock given to set_clock(); zero without one
};

}  // namespace pptam
