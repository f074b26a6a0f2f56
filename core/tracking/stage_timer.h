// Where a frame's time goes: a stage lasts until the next one is entered. Told to the embedder's tracer, and summed by
// the clock into TrackResult::stage_ns; either may be missing. Nothing in a result depends on it but stage_ns.
#pragma once

#include <algorithm>
#include <iterator>

#include <pocket_ptam/clock.h>
#include <pocket_ptam/tracer.h>

namespace pptam {

class StageTimer {
 public:
  // A frame begins, with its first stage.
  void begin(const Clock* clock, Tracer* tracer) {
    clock_ = clock;
    tracer_ = tracer;
    std::fill(std::begin(ns_), std::end(ns_), 0);
    stage_ = Stage::kPyramid;
    if (tracer_) tracer_->begin(span_of(stage_));
    if (clock_) since_ns_ = clock_->now_ns();
  }
  void enter(Stage stage) {
    if (stage == stage_) return;
    leave();
    stage_ = stage;
    if (tracer_) tracer_->begin(span_of(stage_));
  }
  void end(TrackResult* result) {
    leave();
    std::copy(std::begin(ns_), std::end(ns_), std::begin(result->stage_ns));
  }

 private:
  void leave() {
    if (tracer_) tracer_->end(span_of(stage_));
    if (!clock_) return;
    const int64_t now_ns = clock_->now_ns();
    ns_[static_cast<int>(stage_)] += now_ns - since_ns_;
    since_ns_ = now_ns;
  }

  const Clock* clock_ = nullptr;
  Tracer* tracer_ = nullptr;
  Stage stage_ = Stage::kPyramid;
  int64_t since_ns_ = 0;
  int64_t ns_[kStages] = {};
};

}  // namespace pptam
