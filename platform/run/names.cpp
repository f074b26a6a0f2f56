#include "platform/run/names.h"

#include <cmath>
#include <iterator>

#include <pocket_ptam/pocket_ptam_c.h>
#include "platform/text.h"

namespace pptam::platform {

const char* name_of(TrackingState state) {
  switch (state) {
    case TrackingState::kWaiting:
      return "waiting";
    case TrackingState::kInitialising:
      return "initialising";
    case TrackingState::kTracking:
      return "tracking";
    case TrackingState::kLost:
      return "lost";
  }
  return "?";
}

const char* name_of(TrackingQuality quality) {
  switch (quality) {
    case TrackingQuality::kBad:
      return "bad";
    case TrackingQuality::kPoor:
      return "poor";
    case TrackingQuality::kGood:
      return "good";
  }
  return "?";
}

const char* name_of(Hint hint) {
  switch (hint) {
    case Hint::kNone:
      return "none";
    case Hint::kTap:
      return "tap";
    case Hint::kHoldStill:
      return "hold_still";
    case Hint::kMoveSideways:
      return "move_sideways";
    case Hint::kOnlyRotating:
      return "only_rotating";
    case Hint::kTooLittleTexture:
      return "too_little_texture";
    case Hint::kTooFast:
      return "too_fast";
    case Hint::kStartLost:
      return "start_lost";
    case Hint::kReturnToKnownView:
      return "return_to_known_view";
  }
  return "?";
}

const char* sentence_for(Hint hint) {
  return pptam_hint_text(static_cast<int32_t>(hint));
}

const char* advice_for(Hint hint) {
  switch (hint) {
    case Hint::kNone:
      break;
    case Hint::kTap:
      return "no start was asked for: --tap SECONDS, or --auto-start";
    case Hint::kHoldStill:
      return "the camera moved when it should start: hold still for a second, then --tap SECONDS at that time";
    case Hint::kMoveSideways:
      return "the start waited for a sideways movement: a tenth of the distance to the scene, the first view in sight";
    case Hint::kOnlyRotating:
      return "the camera only turned, which gives no depth: move it sideways";
    case Hint::kTooLittleTexture:
      return "too few corners in view: more texture, better light, or nearer";
    case Hint::kTooFast:
      return "the images were blurred by the movement: move slower, or with more light";
    case Hint::kStartLost:
      return "the first view was lost: move slower and keep it in sight; --tap SECONDS for another start, or --fov and "
             "--readout when they are guesses";
    case Hint::kReturnToKnownView:
      return "no known view came: go back to where the map was made; a map that is lost at once may have a wrong "
             "--fov, "
             "calibration or --readout";
  }
  return "";
}

const char* name_of(Stage stage) {
  switch (stage) {
    case Stage::kPyramid:
      return "pyramid";
    case Stage::kRotation:
      return "rotation";
    case Stage::kSearch:
      return "search";
    case Stage::kPose:
      return "pose";
    case Stage::kPartial:
      return "partial";
    case Stage::kInitialise:
      return "initialise";
    case Stage::kKeyframe:
      return "keyframe";
    case Stage::kCount:
      break;
  }
  return "?";
}

const char* name_of(ClockKind clock) {
  switch (clock) {
    case ClockKind::kWork:
      return "work";
    case ClockKind::kSteady:
      return "steady";
    case ClockKind::kThrottled:
      return "throttled";
  }
  return "?";
}

const char* name_of(Span span) {
  switch (span) {
    case Span::kFrame:
      return "frame";
    case Span::kPyramid:
      return name_of(Stage::kPyramid);
    case Span::kRotation:
      return name_of(Stage::kRotation);
    case Span::kSearch:
      return name_of(Stage::kSearch);
    case Span::kPose:
      return name_of(Stage::kPose);
    case Span::kPartial:
      return name_of(Stage::kPartial);
    case Span::kInitialise:
      return name_of(Stage::kInitialise);
    case Span::kKeyframe:
      return name_of(Stage::kKeyframe);
    case Span::kSlice:
      return "slice";
    case Span::kFinishMap:
      return "finish_map";
    case Span::kInsert:
      return "insert";
    case Span::kAdjustNew:
      return "adjust_new";
    case Span::kAdjust:
      return "adjust";
    case Span::kCull:
      return "cull";
    case Span::kTidy:
      return "tidy";
    case Span::kCount:
      break;
  }
  return "?";
}

const char* name_of(TraceWhat what) {
  static constexpr const char* kCounterNames[] = {"keyframes", "map points", "inliers", "quality"};
  static_assert(std::size(kCounterNames) == kCounters);
  switch (what) {
    case TraceWhat::kCapture:
      return "capture";
    case TraceWhat::kDisplay:
      return "display";
    case TraceWhat::kIdle:
      return "idle";
    case TraceWhat::kDropped:
      return "dropped";
    case TraceWhat::kFirstSpan:
    case TraceWhat::kFirstCounter:
      break;
  }
  if (what < TraceWhat::kFirstCounter) return name_of(static_cast<Span>(what));
  const size_t counter = static_cast<size_t>(what) - static_cast<size_t>(TraceWhat::kFirstCounter);
  return counter < std::size(kCounterNames) ? kCounterNames[counter] : "?";
}

std::string limit_names(uint32_t limits_hit) {
  constexpr struct {
    LimitBits bit;
    const char* name;
  } kLimits[] = {{kLimitKeyframes, "max_keyframes"},
                 {kLimitMapPoints, "max_map_points"},
                 {kLimitPartialPoints, "max_partial_points"},
                 {kLimitMeasuredPoints, "max_measured_points"},
                 {kLimitMeasurements, "max_measurements"}};
  std::string names;
  for (const auto& limit : kLimits) {
    if ((limits_hit & limit.bit) == 0) continue;
    if (!names.empty()) names += '|';
    names += limit.name;
  }
  return names;
}

const char* name_of(RollingShutter::Axis axis) {
  return axis == RollingShutter::Axis::kRows ? "rows" : "columns";
}

std::string readout_text(RollingShutter::Axis axis, double seconds) {
  return format("%s:%c:%.4f", name_of(axis), seconds < 0 ? '-' : '+', std::abs(seconds));
}

}  // namespace pptam::platform
