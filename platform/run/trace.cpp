#include "platform/run/trace.h"

#include <algorithm>
#include <cinttypes>
#include <new>
#include <string_view>
#include <utility>

#include "platform/outputs.h"
#include "platform/run/console.h"
#include "platform/run/names.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

constexpr std::string_view kTraceHead = "{\"displayTimeUnit\":\"ms\",\n\"otherData\":{\"file\":\"";

// Tracks, as Chrome calls them threads.
enum Track { kFrames = 1, kMapping = 2, kIdling = 3 };

Track track_of(TraceWhat what) {
  if (what == TraceWhat::kIdle) return kIdling;
  if (what >= trace_of(Span::kSlice) && what <= trace_of(Span::kTidy)) return kMapping;
  return kFrames;
}

// As JSON's text: printable() leaves no control characters and nothing but UTF-8.
std::string quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : printable(text)) {
    if (c == '"' || c == '\\') out += '\\';
    out += c;
  }
  return out + '"';
}

std::string microseconds(int64_t ns) {
  return format("%.3f", 1e-3 * static_cast<double>(ns));  // to the nanosecond for 52 days
}

std::string metadata(const char* name, int track, const std::string& value) {
  return format("{\"ph\":\"M\",\"pid\":1,\"tid\":%d,\"name\":\"%s\",\"args\":{\"name\":%s}}", track, name,
                quoted(value).c_str());
}

std::string event_text(const TraceEvent& event, int64_t origin_ns) {
  const std::string at = microseconds(saturated_difference(event.begin_ns, origin_ns));
  const char* name = name_of(event.what);
  if (event.what >= TraceWhat::kFirstCounter) {
    return format("{\"ph\":\"C\",\"pid\":1,\"ts\":%s,\"name\":\"%s\",\"args\":{\"value\":%" PRId64 "}}", at.c_str(),
                  name, event.value);
  }
  const int track = track_of(event.what);
  if (event.what == TraceWhat::kDropped) {
    return format(
        "{\"ph\":\"i\",\"s\":\"t\",\"pid\":1,\"tid\":%d,\"ts\":%s,\"name\":\"%s\",\"args\":{\"frame\":%" PRId64 "}}",
        track, at.c_str(), name, event.value);
  }
  std::string text = format("{\"ph\":\"X\",\"pid\":1,\"tid\":%d,\"ts\":%s,\"dur\":%s,\"name\":\"%s\"", track,
                            at.c_str(), microseconds(saturated_difference(event.end_ns, event.begin_ns)).c_str(), name);
  if (event.what == trace_of(Span::kFrame)) text += format(",\"args\":{\"frame\":%" PRId64 "}", event.value);
  return text + "}";
}

// Where nothing was done of a stage or a job.
bool is_empty(const TraceEvent& event) {
  const bool span = event.what < TraceWhat::kDropped && event.what != trace_of(Span::kFrame);
  return span && event.end_ns == event.begin_ns;
}

}  // namespace

bool RunTracer::keep(const TraceEvent& event) {
  if (!keep_) return false;
  try {
    if (events_.size() < most_events_) {
      events_.push_back(event);
      return true;
    }
  } catch (const std::bad_alloc&) {  // those before it stay
  }
  keep_ = false;
  cut_ns_ = event.begin_ns;
  return false;
}

void RunTracer::begin(Span span) {
  const int64_t now_ns = clock_.now_ns();
  const bool kept = keep({now_ns, now_ns, index_, trace_of(span)});
  open_.push_back({span, now_ns, kept ? events_.size() - 1 : kNotKept});
}

void RunTracer::end(Span span) {
  if (open_.empty() || open_.back().span != span) return;
  const int64_t now_ns = clock_.now_ns();
  const Open ended = open_.back();
  open_.pop_back();
  if (ended.event != kNotKept) events_[ended.event].end_ns = now_ns;
  const int64_t ns = saturated_difference(now_ns, ended.begin_ns);
  if (span == Span::kSlice) {
    sums_.mapping_ns += ns;
    sums_.longest_slice_ns = std::max(sums_.longest_slice_ns, ns);
    ++sums_.idle_slices;
  } else if (span > Span::kSlice) {
    sums_.job_ns[job_of(span)] += ns;
  }
}

void RunTracer::count(Counter counter, int64_t value) {
  if (keep_) keep({clock_.now_ns(), 0, value, trace_of(counter)});
}

void RunTracer::add(TraceWhat what, int64_t begin_ns, int64_t end_ns, int64_t value) {
  keep({begin_ns, end_ns, value, what});
}

void RunTracer::add_idle(int64_t begin_ns) {
  const int64_t now_ns = clock_.now_ns();
  sums_.idle_ns = saturated_sum(sums_.idle_ns, saturated_difference(now_ns, begin_ns));
  add(TraceWhat::kIdle, begin_ns, now_ns);
}

void RunTracer::take(FrameLog* frame) {
  frame->mapping_ns = sums_.mapping_ns;
  frame->longest_slice_ns = sums_.longest_slice_ns;
  frame->idle_slices = sums_.idle_slices;
  frame->idle_ns = sums_.idle_ns;
  std::copy(std::begin(sums_.job_ns), std::end(sums_.job_ns), std::begin(frame->job_ns));
  sums_ = {};
}

void RunTracer::give(RunLog* log) {
  log->trace = std::move(events_);
  if (!cut_ns_) return;
  const int64_t origin_ns = log->trace.empty() ? *cut_ns_ : log->trace.front().begin_ns;
  log->warnings.push_back(format("the trace ends at %.1f s: too long, %zu events were kept",
                                 1e-9 * static_cast<double>(saturated_difference(*cut_ns_, origin_ns)),
                                 log->trace.size()));
}

std::string trace_text(const RunLog& log, const std::string& command) {
  std::string text = std::string(kTraceHead) + std::string(kOpenSeal) + "\",\"run\":" + quoted(log.camera.name) +
                     ",\"clock\":\"" + name_of(log.clock) + "\",\"command\":" + quoted(command) +
                     "},\n\"traceEvents\":[\n";
  text += metadata("process_name", 0, "Pocket PTAM: " + log.camera.name);
  for (const auto& [track, name] : {std::pair(kFrames, "frames"), {kMapping, "mapping"}, {kIdling, "idle"}})
    text += ",\n" + metadata("thread_name", track, name);
  const int64_t origin_ns = log.trace.empty() ? 0 : log.trace.front().begin_ns;
  for (const TraceEvent& event : log.trace)
    if (!is_empty(event)) text += ",\n" + event_text(event, origin_ns);
  text += "\n]}\n";
  return sealed(std::move(text));
}

bool is_trace(std::span<const std::byte> content) {
  const std::string_view text(reinterpret_cast<const char*>(content.data()), content.size());
  return text.starts_with(kTraceHead) && is_sealed(content);
}

}  // namespace pptam::platform
