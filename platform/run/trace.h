// What the processor did during a run, span by span, by the run's clock: sums for frames.csv, summary and report, and
// the text of a trace that Perfetto and Chrome show (ui.perfetto.dev, chrome://tracing).
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <pocket_ptam/pocket_ptam.h>
#include "platform/run/run_log.h"

namespace pptam::platform {

constexpr size_t kMostTraceEvents = 8'000'000;  // 256 MB. Not swept

// Listens to a System. One for each run; it must not outlive the clock. The core calls it and is built without
// exceptions: begin(), end() and count() throw none.
class RunTracer final : public Tracer {
 public:
  // keep: every event up to so many, or as memory lasts, for a trace; else only the sums of take().
  RunTracer(const Clock& clock, bool keep, size_t most_events = kMostTraceEvents)
      : clock_(clock), keep_(keep), most_events_(most_events) {
    open_.reserve(kSpans);  // no span is open twice: begin() asks for no more
  }

  void begin(Span span) override;
  void end(Span span) override;
  void count(Counter counter, int64_t value) override;

  // What is not the System's; add_idle() up to now.
  void add(TraceWhat what, int64_t begin_ns, int64_t end_ns, int64_t value = 0);
  void add_idle(int64_t begin_ns);
  // Of the frame whose spans come next.
  void number(int index) { index_ = index; }

  // Moves into a frame's line what was done of mapping and idling since the last call, which was after the frame
  // before.
  void take(FrameLog* frame);
  // At the end: moves the events into RunLog::trace, with a warning when they end before the run does.
  void give(RunLog* log);

 private:
  struct Open {
    Span span;
    int64_t begin_ns;
    size_t event;  // in events_, or kNotKept
  };
  static constexpr size_t kNotKept = SIZE_MAX;
  bool keep(const TraceEvent& event);  // false: it is not

  const Clock& clock_;
  bool keep_;
  size_t most_events_;
  std::optional<int64_t> cut_ns_;  // when the first event was left out
  int index_ = 0;
  std::vector<Open> open_;
  std::vector<TraceEvent> events_;
  FrameLog sums_;
};

// Trace-event JSON with tracks for frames, mapping and idle time, nested spans and counters; sealed
// (platform/outputs.h). command: how to repeat the run.
std::string trace_text(const RunLog& log, const std::string& command);
// Such a text, as it was written.
bool is_trace(std::span<const std::byte> content);

}  // namespace pptam::platform
