// That pocket_ptam_c.h says all that the C++ headers say: compiling this file is the test. An enumerator that one side
// lacks, or that has another value there, is an error, and so is a new field of a structure: mirror it, then count it
// here. With PPTAM_CONTROL one is left out, which must not compile.
#include <pocket_ptam/model_tracker.h>
#include <pocket_ptam/pocket_ptam.h>
#include <pocket_ptam/pocket_ptam_c.h>

#pragma GCC diagnostic error "-Wswitch"  // a switch that leaves out an enumerator

namespace pptam {
namespace {

#define CASE_CPP(cpp, c) case cpp:
#define CASE_C(cpp, c) case c:
#define SAME_VALUE(cpp, c) static_assert(static_cast<int64_t>(cpp) == static_cast<int64_t>(c));
#define MIRRORED(list, CppEnum, CEnum)        \
  list(SAME_VALUE);                           \
  [[maybe_unused]] void mirrored(CppEnum v) { \
    switch (v) { list(CASE_CPP) break; }      \
  }                                           \
  [[maybe_unused]] void mirrored(CEnum v) {   \
    switch (v) { list(CASE_C) break; }        \
  }

#define STATUS_CODES(X)                                        \
  X(StatusCode::kOk, PPTAM_OK)                                 \
  X(StatusCode::kInvalidArgument, PPTAM_INVALID_ARGUMENT)      \
  X(StatusCode::kOutOfMemory, PPTAM_OUT_OF_MEMORY)             \
  X(StatusCode::kTimeWentBackwards, PPTAM_TIME_WENT_BACKWARDS) \
  X(StatusCode::kNotReady, PPTAM_NOT_READY)                    \
  X(StatusCode::kBadFile, PPTAM_BAD_FILE)                      \
  X(StatusCode::kConfigMismatch, PPTAM_CONFIG_MISMATCH)
MIRRORED(STATUS_CODES, StatusCode, pptam_status_code)

#define DISTORTIONS(X)                            \
  X(Distortion::kNone, PPTAM_DISTORTION_NONE)     \
  X(Distortion::kFov, PPTAM_DISTORTION_FOV)       \
  X(Distortion::kRadTan, PPTAM_DISTORTION_RADTAN) \
  X(Distortion::kEquidistant, PPTAM_DISTORTION_EQUIDISTANT)
MIRRORED(DISTORTIONS, Distortion, pptam_distortion)

#define AXES(X)                                      \
  X(RollingShutter::Axis::kRows, PPTAM_SHUTTER_ROWS) \
  X(RollingShutter::Axis::kColumns, PPTAM_SHUTTER_COLUMNS)
MIRRORED(AXES, RollingShutter::Axis, pptam_shutter_axis)

#define FORMATS(X)                          \
  X(PixelFormat::kGrey, PPTAM_PIXEL_GREY)   \
  X(PixelFormat::kBgra, PPTAM_PIXEL_BGRA)   \
  X(PixelFormat::kRgb24, PPTAM_PIXEL_RGB24) \
  X(PixelFormat::kYuyv, PPTAM_PIXEL_YUYV)   \
  X(PixelFormat::kNv12, PPTAM_PIXEL_NV12)   \
  X(PixelFormat::kNv21, PPTAM_PIXEL_NV21)   \
  X(PixelFormat::kI420, PPTAM_PIXEL_I420)
MIRRORED(FORMATS, PixelFormat, pptam_pixel_format)

#define STATES(X)                                              \
  X(TrackingState::kWaiting, PPTAM_TRACKING_WAITING)           \
  X(TrackingState::kInitialising, PPTAM_TRACKING_INITIALISING) \
  X(TrackingState::kTracking, PPTAM_TRACKING_TRACKING)         \
  X(TrackingState::kLost, PPTAM_TRACKING_LOST)
MIRRORED(STATES, TrackingState, pptam_tracking_state)

#define QUALITIES(X)                            \
  X(TrackingQuality::kBad, PPTAM_QUALITY_BAD)   \
  X(TrackingQuality::kPoor, PPTAM_QUALITY_POOR) \
  X(TrackingQuality::kGood, PPTAM_QUALITY_GOOD)
MIRRORED(QUALITIES, TrackingQuality, pptam_tracking_quality)

#ifdef PPTAM_CONTROL
#define LAST_HINT(X)
#else
#define LAST_HINT(X) X(Hint::kReturnToKnownView, PPTAM_HINT_RETURN_TO_KNOWN_VIEW)
#endif
#define HINTS(X)                                            \
  X(Hint::kNone, PPTAM_HINT_NONE)                           \
  X(Hint::kTap, PPTAM_HINT_TAP)                             \
  X(Hint::kHoldStill, PPTAM_HINT_HOLD_STILL)                \
  X(Hint::kMoveSideways, PPTAM_HINT_MOVE_SIDEWAYS)          \
  X(Hint::kOnlyRotating, PPTAM_HINT_ONLY_ROTATING)          \
  X(Hint::kTooLittleTexture, PPTAM_HINT_TOO_LITTLE_TEXTURE) \
  X(Hint::kTooFast, PPTAM_HINT_TOO_FAST)                    \
  X(Hint::kStartLost, PPTAM_HINT_START_LOST)                \
  LAST_HINT(X)
MIRRORED(HINTS, Hint, pptam_hint)

#define LIMITS(X)                                      \
  X(kLimitKeyframes, PPTAM_LIMIT_KEYFRAMES)            \
  X(kLimitMapPoints, PPTAM_LIMIT_MAP_POINTS)           \
  X(kLimitPartialPoints, PPTAM_LIMIT_PARTIAL_POINTS)   \
  X(kLimitMeasuredPoints, PPTAM_LIMIT_MEASURED_POINTS) \
  X(kLimitMeasurements, PPTAM_LIMIT_MEASUREMENTS)
MIRRORED(LIMITS, LimitBits, pptam_limit)

#define STAGES(X)                               \
  X(Stage::kPyramid, PPTAM_STAGE_PYRAMID)       \
  X(Stage::kRotation, PPTAM_STAGE_ROTATION)     \
  X(Stage::kSearch, PPTAM_STAGE_SEARCH)         \
  X(Stage::kPose, PPTAM_STAGE_POSE)             \
  X(Stage::kPartial, PPTAM_STAGE_PARTIAL)       \
  X(Stage::kInitialise, PPTAM_STAGE_INITIALISE) \
  X(Stage::kKeyframe, PPTAM_STAGE_KEYFRAME)     \
  X(Stage::kCount, PPTAM_STAGE_COUNT)
MIRRORED(STAGES, Stage, pptam_stage)

#define SPANS(X)                              \
  X(Span::kFrame, PPTAM_SPAN_FRAME)           \
  X(Span::kPyramid, PPTAM_SPAN_PYRAMID)       \
  X(Span::kRotation, PPTAM_SPAN_ROTATION)     \
  X(Span::kSearch, PPTAM_SPAN_SEARCH)         \
  X(Span::kPose, PPTAM_SPAN_POSE)             \
  X(Span::kPartial, PPTAM_SPAN_PARTIAL)       \
  X(Span::kInitialise, PPTAM_SPAN_INITIALISE) \
  X(Span::kKeyframe, PPTAM_SPAN_KEYFRAME)     \
  X(Span::kSlice, PPTAM_SPAN_SLICE)           \
  X(Span::kFinishMap, PPTAM_SPAN_FINISH_MAP)  \
  X(Span::kInsert, PPTAM_SPAN_INSERT)         \
  X(Span::kAdjustNew, PPTAM_SPAN_ADJUST_NEW)  \
  X(Span::kAdjust, PPTAM_SPAN_ADJUST)         \
  X(Span::kCull, PPTAM_SPAN_CULL)             \
  X(Span::kTidy, PPTAM_SPAN_TIDY)             \
  X(Span::kCount, PPTAM_SPAN_COUNT)
MIRRORED(SPANS, Span, pptam_span)

#define COUNTERS(X)                                \
  X(Counter::kKeyframes, PPTAM_COUNTER_KEYFRAMES)  \
  X(Counter::kMapPoints, PPTAM_COUNTER_MAP_POINTS) \
  X(Counter::kInliers, PPTAM_COUNTER_INLIERS)      \
  X(Counter::kQuality, PPTAM_COUNTER_QUALITY)      \
  X(Counter::kCount, PPTAM_COUNTER_COUNT)
MIRRORED(COUNTERS, Counter, pptam_counter)

#define OBSERVED(X)                                 \
  X(ObservedKind::kInlier, PPTAM_OBSERVED_INLIER)   \
  X(ObservedKind::kOutlier, PPTAM_OBSERVED_OUTLIER) \
  X(ObservedKind::kMissed, PPTAM_OBSERVED_MISSED)   \
  X(ObservedKind::kHidden, PPTAM_OBSERVED_HIDDEN)   \
  X(ObservedKind::kPartial, PPTAM_OBSERVED_PARTIAL) \
  X(ObservedKind::kInitial, PPTAM_OBSERVED_INITIAL)
MIRRORED(OBSERVED, ObservedKind, pptam_observed_kind)

#define WORK(X)                                            \
  X(Work::kGreyPixel, PPTAM_WORK_GREY_PIXEL)               \
  X(Work::kPyramidPixel, PPTAM_WORK_PYRAMID_PIXEL)         \
  X(Work::kCornerPixel, PPTAM_WORK_CORNER_PIXEL)           \
  X(Work::kCornerAscent, PPTAM_WORK_CORNER_ASCENT)         \
  X(Work::kRotationPixel, PPTAM_WORK_ROTATION_PIXEL)       \
  X(Work::kPointProjected, PPTAM_WORK_POINT_PROJECTED)     \
  X(Work::kPatchWarp, PPTAM_WORK_PATCH_WARP)               \
  X(Work::kPatchCandidate, PPTAM_WORK_PATCH_CANDIDATE)     \
  X(Work::kPatchRefineStep, PPTAM_WORK_PATCH_REFINE_STEP)  \
  X(Work::kPosePoint, PPTAM_WORK_POSE_POINT)               \
  X(Work::kPoseProjection, PPTAM_WORK_POSE_PROJECTION)     \
  X(Work::kHomographyPoint, PPTAM_WORK_HOMOGRAPHY_POINT)   \
  X(Work::kKeyframePixel, PPTAM_WORK_KEYFRAME_PIXEL)       \
  X(Work::kBundleError, PPTAM_WORK_BUNDLE_ERROR)           \
  X(Work::kBundleProjection, PPTAM_WORK_BUNDLE_PROJECTION) \
  X(Work::kBundleMotion, PPTAM_WORK_BUNDLE_MOTION)         \
  X(Work::kBundleBlock, PPTAM_WORK_BUNDLE_BLOCK)           \
  X(Work::kBundleSolve, PPTAM_WORK_BUNDLE_SOLVE)           \
  X(Work::kBundleStep, PPTAM_WORK_BUNDLE_STEP)             \
  X(Work::kOther, PPTAM_WORK_OTHER)                        \
  X(Work::kCount, PPTAM_WORK_COUNT)
MIRRORED(WORK, Work, pptam_work)

#define MODEL_STATES(X)                          \
  X(ModelState::kWaiting, PPTAM_MODEL_WAITING)   \
  X(ModelState::kTracking, PPTAM_MODEL_TRACKING) \
  X(ModelState::kLost, PPTAM_MODEL_LOST)
MIRRORED(MODEL_STATES, ModelState, pptam_model_state)

#define MODEL_FEATURES(X)                          \
  X(ModelFeature::kLine, PPTAM_MODEL_LINE)         \
  X(ModelFeature::kCylinder, PPTAM_MODEL_CYLINDER) \
  X(ModelFeature::kCircle, PPTAM_MODEL_CIRCLE)     \
  X(ModelFeature::kSphere, PPTAM_MODEL_SPHERE)
MIRRORED(MODEL_FEATURES, ModelFeature, pptam_model_feature)
static_assert(kModelFeatures == PPTAM_MODEL_FEATURES);

#define SITE_KINDS(X)                                        \
  X(SiteKind::kInlier, PPTAM_SITE_INLIER)                    \
  X(SiteKind::kRejectedLocally, PPTAM_SITE_REJECTED_LOCALLY) \
  X(SiteKind::kRejectedRobustly, PPTAM_SITE_REJECTED_ROBUSTLY)
MIRRORED(SITE_KINDS, SiteKind, pptam_site_kind)

// A structure has exactly as many fields as there are names. Behind the names: what the other side has besides.
#define FIELDS(Struct, ...)                           \
  [[maybe_unused]] void fields_of(const Struct& it) { \
    [[maybe_unused]] const auto& [__VA_ARGS__] = it;  \
  }
FIELDS(Camera, model, shutter)                                        // C: one structure
FIELDS(CameraModel, a, b, c, d, e, f, g, h, max_radius_sq, fov_gain)  // C: not the last two, which prepare() fills
FIELDS(RollingShutter, a, b)                                          //
FIELDS(pptam_camera, a, b, c, d, e, f, g, h, i, j)                    //
FIELDS(PhoneProfile, a, b, c)                                         //
FIELDS(pptam_phone_profile, a, b, c)                                  //
FIELDS(Config, corner_source, initialiser, point_source, culling,     // C: the phone's parts
       own_levels, max_coarse_points,                                 // C: as of the phone
       a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r, s, t, u, v, w)  //
FIELDS(pptam_config, a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r, s, t, u, v, w)
FIELDS(MemoryParts, a, b, c, d)
FIELDS(pptam_memory_parts, a, b, c, d)
FIELDS(Frame, a, b, c, d, e, f)
FIELDS(pptam_frame, a, b, c, d, e, f)
FIELDS(TrackResult, status,  // C: what pptam_track() returns
       a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r, s, t, u, v, w, world_changes, x, y, points, z)
FIELDS(pptam_track_result, a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r, s, t, u, v, w, world_changes, x, y,
       points, z)
FIELDS(ObservedPoint, a, b, c, d, e)
FIELDS(pptam_observed_point, a, b, c, d, e)
FIELDS(KeyframeInfo, a, b, c)
FIELDS(pptam_keyframe, a, b, c)
FIELDS(MapPointInfo, a, b, c, d, e)
FIELDS(pptam_map_point, a, b, c, d, e)
FIELDS(MeasurementInfo, a, b, c, d, e)
FIELDS(pptam_measurement, a, b, c, d, e)
FIELDS(PlaneInfo, a, b, c, d)
FIELDS(pptam_plane, a, b, c, d)
FIELDS(MapInfo, a, b, c, d, e, f, g, h, i, j, k, l, m)
FIELDS(pptam_map_info, a, b, c, d, e, f, g, h, i, j, k, l, m)
FIELDS(ModelLine, a, b, c)
FIELDS(pptam_model_line, a, b, c)
FIELDS(ModelFace, a, b, c, d, e)
FIELDS(pptam_model_face, a, b, c, d, e)
FIELDS(ModelCylinder, a, b, c, d)
FIELDS(pptam_model_cylinder, a, b, c, d)
FIELDS(ModelCircle, a, b, c, d, e)
FIELDS(pptam_model_circle, a, b, c, d, e)
FIELDS(ModelSphere, a, b, c)
FIELDS(pptam_model_sphere, a, b, c)
FIELDS(ObjectModel, a, b, c, d, e, f, g, h)
FIELDS(pptam_object_arrays, a, b, c, d, e, f, g, h, point_count, corner_count, line_count, face_count, cylinder_count,
       circle_count, sphere_count)
FIELDS(ModelMethod, a, b, c, d)
FIELDS(pptam_model_method, a, b, c, d)
FIELDS(ModelTrackerConfig, a, b, c, d, e)
FIELDS(pptam_model_tracker_config, a, b, c, d, e)
FIELDS(ModelResult, status, a, b, c, d, e, f, g, h, i, j, k, l, m)
FIELDS(pptam_model_result, a, b, c, d, e, f, g, h, i, j, k, l, m)
FIELDS(ModelSite, a, b, c, d)
FIELDS(pptam_model_site, a, b, c, d)

}  // namespace
}  // namespace pptam
