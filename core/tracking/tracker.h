// Tracks every frame [phone 4]: the state machine over the parts of tracking.
//
//            tap, or a still camera           map finished by the mapper
//   kWaiting ──────────────▶ kInitialising ──────────────▶ kTracking ◀──── relocalised, confirmed
//      ▲                          │ first view lost, map discarded   │ three bad frames       │
//      └──────────────────────────┘                                  └──────▶ kLost ──────────┘
//
// With Config::auto_start a camera that stays lost begins anew: its map is set aside (map/map.h), and the states are
// run through again. While there are maps aside, their views are looked for now and then: a map is exchanged for
// the look, and stays in use when the next frame confirms the pose; otherwise all is as before.
//
// FrameInput ─▶ MotionModel, FullFrameRotation ─▶ MapMatching with DepthFilter's partial points ─▶ StillCamera
// ─▶ TrackResult. In sharp frames also KeyframePolicy; without a map the initialiser; when lost the relocaliser. In the
// map the tracker changes search statistics, partial points' depths and the queue of new keyframes. Bounded time; runs
// to completion.
#pragma once

#include <pocket_ptam/clock.h>
#include <pocket_ptam/tracer.h>
#include "tracking/depth_filter.h"
#include "tracking/frame_fit.h"
#include "tracking/frame_input.h"
#include "tracking/initialiser.h"
#include "tracking/keyframe_policy.h"
#include "tracking/map_matching.h"
#include "tracking/stage_timer.h"
#include "tracking/start_trigger.h"
#include "tracking/still_camera.h"

namespace pptam {

class Tracker {
 public:
  Tracker(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Initialiser* initialiser);

  // The frame must be validated. clock may be null: TrackResult::stage_ns is not filled then. So may tracer.
  TrackResult track(const Frame& frame, const Clock* clock, Tracer* tracer = nullptr);
  void tap();
  void reset();
  // To be called after reset() when a map has been loaded: the camera's pose in it is not known.
  void begin_lost();
  // Takes over a change of the map's coordinates. track() does so; to be called after changes between two frames.
  void follow_map();
  // The last frame's pose at the exposure time of a pixel's line. False: it had none in the map in use.
  bool last_pose(const Vector2f& px, SE3* T_cw) const;

 private:
  void predict();
  void choose_rotation();
  void track_with_map(TrackResult* result);
  MapMatch match_with_partials(MapMatching::Search search, bool allowed);
  void accept(const MapMatch& match, bool blurred, TrackResult* result);
  void miss();
  void drop_doubted();
  void relocalise(TrackResult* result);
  bool find_candidate(int* attempt, TrackResult* result);
  void begin_anew_if_lost_long();
  void look_aside();
  void leave_look();
  void settle_look();
  void track_initialiser(TrackResult* result);
  TrackResult repeated(const TrackResult& taken);

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  StageTimer stages_;

  FrameInput frame_;
  FullFrameRotation full_frame_rotation_;
  LampBands lamp_bands_;
  MotionModel motion_;
  MapMatching matching_;
  StillCamera still_camera_;
  DepthFilter depth_filter_;
  FrameFit frame_fit_;
  KeyframePolicy keyframe_policy_;
  Initialiser* initialiser_;
  StartTrigger start_trigger_;
  FixedVector<ObservedPoint> observed_;

  TrackResult last_;  // of the last picture that was not a repeated one
  TrackingState state_ = TrackingState::kWaiting;
  Hint hint_ = Hint::kTap;
  int confirmed_ = 0;                 // good frames in a row since a relocalisation; 0 when none is being confirmed
  int relocalise_attempt_ = 0;        // since the camera was lost
  float lost_s_ = 0;                  // likewise, seconds
  int frames_until_look_ = 0;         // at the maps that are set aside
  int look_place_ = 0;                // the last one looked at; while Map::looking() it is in use
  int look_attempts_[kMaxMaps] = {};  // by place
  MotionModel before_look_;           // as it was, and so on
  TrackingState state_before_look_ = TrackingState::kWaiting;
  Hint hint_before_look_ = Hint::kNone;
};

}  // namespace pptam
