// What the processor did during a run, span by span, by the run's clock: sums for frames.csv, summary and report, and
// the text of a trace that Perfetto and Chrome show (ui.perfetto.dev, chrome://tracing).
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <pocket_ptam/pocket_ptam.h>
#include "platform/run/run_log.h"

namespace pptam::platform {

// Listens to a System. One for each run; it must not outlive the clock.
class RunTracer final : public Tracer {
 public:
  // keep: every event, for a trace; else only the sums of take().
  RunTracer(const Clock& clock, bool keep) : clock_(clock), keep_(keep) {}

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
  // At the end.
  std::vector<TraceEvent> events() { return std::move(events_); }

 private:
  struct Open {
    Span span;
    int64_t begin_ns;
    size_t event;  // in events_, if they are kept
  };
  const Clock& clock_;
  bool keep_;
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
