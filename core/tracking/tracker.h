// What happens to every frame [phone 4]: the state machine over the parts of tracking.
//
//            tap, or a still camera           map finished by the mapper
//   kWaiting ──────────────▶ kInitialising ──────────────▶ kTracking ◀──── found again, confirmed
//      ▲                          │ first view lost, map given up    │ three bad frames       │
//      └──────────────────────────┘                                  └──────▶ kLost ──────────┘
//
// FrameInput ─▶ MotionModel, FullFrameRotation ─▶ MapMatching ─▶ StillCamera ─▶ TrackResult; with a good pose also
// DepthFilter and KeyframePolicy; without a map the initialiser; lost, the relocaliser. Of the map it changes
// search statistics, partial points' depths and the queue of new keyframes. Bounded time; runs to completion.
#pragma once

#include <pocket_ptam/clock.h>
#include "tracking/depth_filter.h"
#include "tracking/frame_input.h"
#include "tracking/initialiser.h"
#include "tracking/keyframe_policy.h"
#include "tracking/map_matching.h"
#include "tracking/start_trigger.h"
#include "tracking/still_camera.h"

namespace pptam {

class Tracker {
 public:
  Tracker(Arena& arena, const Config& config, Map& map, WorkMeter& meter, Initialiser* initialiser);

  // The frame has been validated. clock may be null (no stage times).
  TrackResult track(const Frame& frame, const Clock* clock);
  void tap();
  void reset();
  // After reset() a map was loaded: where in it the camera is has to be found.
  void begin_lost();
  // Takes over a change of the map's coordinates; by itself at every frame, and to be called after one in between.
  void follow_map();

 private:
  void predict();
  void track_with_map(TrackResult* result);
  void accept(const MapMatch& match, bool blurred, TrackResult* result);
  void miss();
  void relocalise(TrackResult* result);
  void track_initialiser(TrackResult* result);
  void mark_stage(Stage stage, TrackResult* result);

  const Config& config_;
  Map& map_;
  WorkMeter& meter_;
  const Clock* clock_ = nullptr;
  int64_t stage_start_ns_ = 0;

  FrameInput frame_;
  FullFrameRotation full_frame_rotation_;
  MotionModel motion_;
  MapMatching matching_;
  StillCamera still_camera_;
  DepthFilter depth_filter_;
  KeyframePolicy keyframe_policy_;
  Initialiser* initialiser_;
  StartTrigger start_trigger_;
  FixedVector<ObservedPoint> observed_;

  TrackingState state_ = TrackingState::kWaiting;
  Hint hint_ = Hint::kTap;
  int confirmed_ = 0;  // frames of a relocalisation that have held
  int relocalise_attempt_ = 0;
};

}  // namespace pptam
