// What a System does while it does it, for profiles and traces of an embedder's own: named spans, nested, and counters.
//
//   struct Printer final : pptam::Tracer {                 // on what the embedder calls time
//     void begin(pptam::Span span) override { note('B', span, my_clock()); }
//     void end(pptam::Span span) override { note('E', span, my_clock()); }
//     void count(pptam::Counter counter, int64_t value) override { plot(counter, value); }
//   };
//   system->set_tracer(&printer);
//
// Nothing that is tracked or mapped depends on whether there is a tracer. Without one each span costs a test.
#pragma once

#include <cstdint>

#include <pocket_ptam/track_result.h>

namespace pptam {

enum class Span : uint8_t {
  kFrame,    // a call of System::track() that was not refused; in it, one after the other, its stages:
  kPyramid,  // as Stage, and in its order
  kRotation,
  kSearch,
  kPose,
  kPartial,
  kInitialise,
  kKeyframe,
  kSlice,      // a call of System::work_slice() that had work; in it, one after the other, what it worked on:
  kFinishMap,  // a map that an initialiser has made
  kInsert,     // a new keyframe: points measured in it, and new points
  kAdjustNew,  // bundle adjustment of the newest keyframe and its neighbours
  kAdjust,     // bundle adjustment of the whole map
  kCull,       // which keyframe is the least useful one, and its erasure
  kTidy,       // points' planes, points that are the same one; and a look for work
  kCount
};
constexpr int kSpans = static_cast<int>(Span::kCount);
constexpr Span span_of(Stage stage) {
  return static_cast<Span>(static_cast<int>(Span::kPyramid) + static_cast<int>(stage));
}
static_assert(span_of(Stage::kKeyframe) == Span::kKeyframe);

enum class Counter : uint8_t {  // told at the end of each frame
  kKeyframes,                   // in the map, live
  kMapPoints,                   // in the map
  kInliers,                     // TrackResult::points_inliers
  kQuality,                     // TrackResult::quality: 0 bad, 1 poor, 2 good
  kCount
};
constexpr int kCounters = static_cast<int>(Counter::kCount);

class Tracer {
 public:
  virtual void begin(Span span) = 0;
  virtual void end(Span span) = 0;  // of the span begun last
  virtual void count(Counter counter, int64_t value) = 0;

 protected:
  ~Tracer() = default;  // the system does not own it
};

}  // namespace pptam
