// What a trace is made of: the core's spans and counters (pocket_ptam/tracer.h), and what a run does besides.
#pragma once

#include <cstdint>

#include <pocket_ptam/tracer.h>

namespace pptam::platform {

// First the spans, in their order, then the run's own, then the counters.
enum class TraceWhat : uint8_t {
  kFirstSpan = 0,
  kCapture = kSpans,  // what a phone's camera and display take of its processor (RunOptions)
  kDisplay,
  kIdle,
  kDropped,  // an instant: a newer frame was there before this one was tracked
  kFirstCounter
};
constexpr TraceWhat trace_of(Span span) {
  return static_cast<TraceWhat>(static_cast<int>(TraceWhat::kFirstSpan) + static_cast<int>(span));
}
constexpr TraceWhat trace_of(Counter counter) {
  return static_cast<TraceWhat>(static_cast<int>(TraceWhat::kFirstCounter) + static_cast<int>(counter));
}

struct TraceEvent {
  int64_t begin_ns = 0, end_ns = 0;  // by the run's clock; the end of spans only
  int64_t value = 0;                 // a counter's; else the frame's number in the source
  TraceWhat what = TraceWhat::kFirstSpan;
};

// What slices of mapping work on.
constexpr int kJobs = static_cast<int>(Span::kTidy) - static_cast<int>(Span::kFinishMap) + 1;
constexpr int job_of(Span span) {
  return static_cast<int>(span) - static_cast<int>(Span::kFinishMap);
}
constexpr Span span_of_job(int job) {
  return static_cast<Span>(static_cast<int>(Span::kFinishMap) + job);
}

}  // namespace pptam::platform
