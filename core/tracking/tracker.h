// What happens to every frame: pyramid, full-frame rotation, prediction, patch search, pose [phone 4].
//
// Owns the camera's state (pose, velocity, quality) and the initialiser. Reads the map, writes only points' search
// statistics, partial points' filters and the queue of new keyframes. Bounded time; runs to completion.
#pragma once

#include "base/work_meter.h"
#include "geometry/pose_update.h"
#include "map/map.h"
#include "pocket_ptam.h"
#include "tracking/full_frame_rotation.h"
#include "tracking/map_initialiser.h"

namespace pptam {

class Tracker {
 public:
  Tracker(Arena& arena, const Config& config, Map& map, WorkMeter& meter);

  // The frame has been validated. clock may be null (no stage times).
  TrackResult track(const Frame& frame, const Clock* clock);
  void tap();
  void reset();
  // After reset() a map was loaded: where in it the camera is has to be found.
  void begin_lost();
  // Takes over a change of the map's coordinates; by itself at every frame, and to be called after one in between.
  void follow_map();

 private:
  struct Candidate {  // a map point that should be visible
    int32_t point = -1;
    int16_t cell = 0;
    bool taken = false;
    float score = 0;
  };
  struct MapTracking {  // what one pass of tracking against the map gave
    PoseUpdate pose;
    int attempted = 0;
    int found = 0;
    int visible = 0;
    TrackingQuality quality = TrackingQuality::kBad;
  };
  enum class SearchMode : uint8_t { kNormal, kBlurred, kWide };

  void prepare_frame(const Frame& frame);
  void predict(float dt_s);
  VelocityPrior velocity_prior(const SE3& T_cw) const;
  MapTracking track_map(const SE3& T_predicted, const VelocityPrior& prior, SearchMode mode);
  MapTracking search_and_update(const SE3& T_start, const VelocityPrior& prior, int level, float radius_px);
  float reprojection_px() const;
  int excuse_hidden_points(const SE3& T_cw);
  void select_points(const SE3& T_cw);
  void track_with_map(float dt_s, TrackResult* result);
  void relocalise(TrackResult* result);
  void track_initialiser(float dt_s, TrackResult* result);
  bool wants_start(float dt_s);
  void update_partial_points(TrackResult* result);
  bool wants_keyframe(const MapTracking& tracking) const;
  void hold_keyframe();
  void release_keyframe(const Vector6f* motion_since, float dt_s);
  SE3 shown_pose(const PoseUpdate& pose);
  void accept(const PoseUpdate& pose, float dt_s);
  void mark_stage(Stage stage, TrackResult* result);

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  const Clock* clock_ = nullptr;
  int64_t stage_start_ns_ = 0;

  GreyImage grey_storage_;
  PyramidStorage pyramid_storage_;
  Pyramid pyramid_;
  GreyImage small_, small_previous_;
  bool have_previous_ = false;
  int64_t timestamp_ns_ = 0;

  FullFrameRotation full_frame_rotation_;
  MapInitialiser initialiser_;
  TrackingState state_ = TrackingState::kWaiting;
  Hint hint_ = Hint::kTap;
  bool tap_pending_ = false;
  float steady_s_ = 0;  // for how long the camera has been held still, while waiting
  bool gap_ = false;    // the last frame is too long ago for its motion to tell anything

  // Camera state.
  SE3 T_cw_;                                  // last believed or predicted pose
  Vector6f velocity_ = Vector6f::Zero();      // motion model: world units/s and radians/s, camera frame
  SE3 T_shown_;                               // the last one in a TrackResult
  int turning_frames_ = 2;                    // successive ones that seem to turn; 2 or more are 2
  Vector6f difference_ = Vector6f::Zero();    // mean of the measured poses' differences to it, while still
  Vector6f velocity_now_ = Vector6f::Zero();  // of the last pose update, at its frame's timestamp
  Vector6f last_motion_ = Vector6f::Zero();   // between the last two believed poses, per second
  float last_interval_s_ = 0;                 // between these two
  float mean_depth_ = 1;
  int bad_frames_ = 0;
  int good_frames_ = 0;  // in a row
  int confirm_ = 0;      // frames of a relocalisation that have held
  int relocalise_attempt_ = 0;
  int64_t last_keyframe_ns_ = 0;

  Vector3f last_turn_ = Vector3f::Zero();  // rotation rate that the full frame showed, radians/s
  float unrest_sq_ = 0;                    // mean square of its change from frame to frame, of each component

  // This frame's prediction.
  Matrix3f R_cp_ = Matrix3f::Identity();
  bool rotation_ok_ = false;
  float frame_interval_s_ = 0;
  SE3 T_predicted_;
  VelocityPrior prior_;
  float blur_px_ = 0;

  FixedVector<Candidate> candidates_;
  FixedVector<int> selected_;
  FixedVector<PosePoint> pose_points_;
  FixedVector<int> pose_indices_;  // map point of each of observed_, until partial points join these
  FixedVector<ObservedPoint> observed_;
  int next_partial_ = 0;
};

}  // namespace pptam
