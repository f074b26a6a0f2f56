#include "platform/run/run.h"

#include <algorithm>
#include <exception>
#include <optional>

#include <pocket_ptam/inspection.h>
#include "platform/input_error.h"
#include "platform/run/clocks.h"
#include "platform/run/interruption.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

// A frame with its own copy of the pixels, so that the source can be asked for the next one.
struct OwnedFrame {
  Frame frame;
  std::vector<uint8_t> pixels;

  void copy(const Frame& source) {
    const size_t bytes = static_cast<size_t>(source.stride_bytes) * static_cast<size_t>(source.height);
    pixels.assign(source.data, source.data + bytes);  // the first plane: all that is read of planar formats
    frame = source;
    frame.data = pixels.data();
  }
};

// The frames of a source with one frame of look-ahead: "has the next one arrived already?" needs its timestamp.
class LookAhead {
 public:
  LookAhead(Camera& camera, std::string* broken) : camera_(camera), broken_(broken) {}

  bool advance() {  // false at the end, or when the source broke
    if (!started_) {
      fetch();  // errors of the first frame are the caller's: nothing has been done yet
      started_ = true;
    }
    if (!next_valid_) return false;
    std::swap(current_, next_);
    try {
      fetch();
    } catch (const std::exception& error) {  // no memory, too
      next_valid_ = false;
      *broken_ = error.what();
    }
    return true;
  }
  const Frame& current() const { return current_.frame; }
  std::optional<int64_t> next_timestamp_ns() const {
    if (!next_valid_) return std::nullopt;
    return next_.frame.timestamp_ns;
  }

 private:
  void fetch() {
    Frame frame;
    next_valid_ = camera_.read(&frame);
    if (next_valid_) next_.copy(frame);
  }

  Camera& camera_;
  std::string* broken_;
  OwnedFrame current_, next_;
  bool started_ = false;
  bool next_valid_ = false;
};

// Decides when the user taps.
class Taps {
 public:
  // none_at_first: there is a map already.
  Taps(std::vector<double> taps_s, bool by_itself, bool none_at_first)
      : taps_s_(std::move(taps_s)), by_itself_(by_itself), none_at_first_(none_at_first) {
    std::sort(taps_s_.begin(), taps_s_.end());
  }

  bool due(double seconds, const RunLog& log) {
    if (taps_s_.empty() && by_itself_) return false;
    if (taps_s_.empty() && log.frames.empty()) return !none_at_first_;
    if (taps_s_.empty()) return log.frames.back().state == TrackingState::kWaiting;
    bool due = false;
    for (; next_ < taps_s_.size() && taps_s_[next_] <= seconds; ++next_) due = true;
    return due;
  }

 private:
  std::vector<double> taps_s_;
  bool by_itself_;
  bool none_at_first_;
  size_t next_ = 0;
};

// When frames arrive, by the run's clock.
class Timetable {
 public:
  Timetable(int64_t first_timestamp_ns, int64_t now_ns)
      : origin_ns_(saturated_difference(now_ns, first_timestamp_ns)) {}

  int64_t arrival_ns(int64_t timestamp_ns) const { return saturated_sum(origin_ns_, timestamp_ns); }
  // Nobody shall wait for hours: a frame that comes later than so long from now is brought nearer, and all that follow.
  int64_t arrival_in_time_ns(int64_t timestamp_ns, int64_t now_ns, int64_t max_wait_ns) {
    const int64_t at_ns = arrival_ns(timestamp_ns);
    const int64_t too_long_ns = saturated_difference(saturated_difference(at_ns, now_ns), max_wait_ns);
    if (too_long_ns <= 0) return at_ns;
    passed_over_ns_ = saturated_sum(passed_over_ns_, too_long_ns);
    origin_ns_ = saturated_difference(origin_ns_, too_long_ns);
    return saturated_sum(now_ns, max_wait_ns);
  }
  double passed_over_s() const { return 1e-9 * static_cast<double>(passed_over_ns_); }

 private:
  int64_t origin_ns_;
  int64_t passed_over_ns_ = 0;
};

std::string pauses_text(const Timetable& timetable, const RunOptions& options) {
  return format(
      ": --clock steady: pauses longer than %.3g s were cut to that, by %.0f s in all; --clock work keeps them",
      options.max_wait_s, timetable.passed_over_s());
}

// The time until a frame arrives is mapping's, and then idle. Returns whether mapping has more to do. For a frame that
// comes late there is one slice, as live: where tracking alone takes all the time there would be no map.
bool map_until(int64_t arrival_ns, const Session& session) {
  System& system = *session.system;
  Clock& clock = *session.clock;
  if (clock.now_ns() > arrival_ns && system.has_work()) system.work_slice();
  while (clock.now_ns() < arrival_ns && system.has_work()) system.work_slice();
  const int64_t idle_from_ns = clock.now_ns();
  clock.idle_until(arrival_ns);
  if (idle_from_ns < arrival_ns) session.tracer->add_idle(idle_from_ns);
  return system.has_work();
}

// Lets so much of the phone's time pass. Returns how much did.
int64_t spend(TraceWhat what, int64_t ns, int frame, const Session& session) {
  if (ns <= 0) return 0;
  const int64_t from_ns = session.clock->now_ns();
  session.clock->idle_until(saturated_sum(from_ns, ns));
  const int64_t to_ns = session.clock->now_ns();
  session.tracer->add(what, from_ns, to_ns, frame);
  return saturated_difference(to_ns, from_ns);
}

void choose_ground(System* system, GroundChoice* ground, TrackResult* result) {
  if (!ground->due(*result)) return;
  ground->choose([system](const Vector2f& px, pptam::Similarity* change) { return system->set_ground(px, change); },
                 result);
}

// Whether the spectator's key, if any, is to end the run; another one is obeyed.
bool quits(const Spectator& spectator, System* system, RunLog* log) {
  const SystemCalls calls = {[system] { system->tap(); }, [system] { system->reset(); },
                             [system](bool locked) { system->set_locked(locked); },
                             [=](const Vector2f& px) {
                               pptam::Similarity change;
                               const Status status = system->set_ground(px, &change);
                               if (status.ok()) log->move_poses(change);
                               return status;
                             }};
  return spectator.key && !press(spectator.key(), *system, calls, spectator);
}

}  // namespace

RunLog run_sequence(Camera& camera, const RunOptions& options, const StartObserver& on_start,
                    const FrameObserver& on_frame, const Spectator& spectator) {
  RunLog log;
  log.camera = camera.info();
  log.clock = options.clock;
  const Session session = make_session(log.camera, options);
  System* const system = session.system;
  Clock* const clock = session.clock.get();
  RunTracer* const tracer = session.tracer.get();
  log.memory_bytes = session.bytes;
  log.memory_parts = session.parts;

  LookAhead source(camera, &log.broken);
  if (!source.advance()) throw InputError(log.camera.name + ": holds no images");
  on_start(log.camera);
  GroundChoice ground(options.ground);
  Taps taps(options.taps_s, options.auto_start, !options.load_map.empty());
  const int64_t first_timestamp_ns = source.current().timestamp_ns;
  Timetable timetable(first_timestamp_ns, clock->now_ns());
  const int64_t max_wait_ns = static_cast<int64_t>(1e9 * options.max_wait_s);
  const auto advance = [&](int64_t since_ns) {
    const bool more = source.advance();
    clock->forget_since(since_ns);  // reading the source and drawing
    return more;
  };
  int64_t end_ns = clock->now_ns();
  do {
    const int index = log.source_frames++;
    const Frame& frame = source.current();
    const auto next_ns = source.next_timestamp_ns();
    if (options.drop_late && next_ns && clock->now_ns() >= timetable.arrival_ns(*next_ns)) {
      ++log.dropped;
      end_ns = clock->now_ns();
      tracer->add(TraceWhat::kDropped, end_ns, end_ns, index);
      continue;
    }
    const int64_t arrival_ns = options.clock == ClockKind::kSteady
                                   ? timetable.arrival_in_time_ns(frame.timestamp_ns, clock->now_ns(), max_wait_ns)
                                   : timetable.arrival_ns(frame.timestamp_ns);
    const bool work_left = map_until(arrival_ns, session);
    const int64_t capture_ns = spend(TraceWhat::kCapture, options.capture_ns, index, session);

    if (taps.due(1e-9 * static_cast<double>(saturated_difference(frame.timestamp_ns, first_timestamp_ns)), log))
      system->tap();
    tracer->number(index);
    const int64_t start_ns = clock->now_ns();
    const int64_t start_instructions = system->work_meter().instructions();
    TrackResult result = system->track(frame);
    end_ns = clock->now_ns();
    const int64_t end_instructions = system->work_meter().instructions();
    choose_ground(system, &ground, &result);
    if (!result.status.ok()) {
      log.broken = log.camera.name + ": frame " + std::to_string(index) + " was refused: " + result.status.message();
      break;
    }
    FrameLog entry = log_of(result);
    entry.index = index;
    entry.track_ns = end_ns - start_ns;
    entry.late_ns = saturated_difference(end_ns, arrival_ns);
    tracer->take(&entry);
    entry.work_left = work_left;
    entry.capture_ns = capture_ns;
    entry.display_ns = spend(TraceWhat::kDisplay, options.display_ns, index, session);
    end_ns = clock->now_ns();
    entry.instructions = end_instructions - start_instructions;
    if (options.hash_every > 0 && index % options.hash_every == 0) entry.map_hash = map_hash(*system);
    log.frames.push_back(entry);
    if (on_frame) on_frame(frame, result, log);
    if (spectator.show) spectator.show(frame, result, entry, *system);
    log.quit = !interrupted() && quits(spectator, system, &log);
  } while (!interrupted() && !log.quit && advance(end_ns));
  if (interrupted() && log.broken.empty()) log.broken = log.camera.name + ": " + interruption();

  log.warnings = camera.remarks();
  if (!ground.trouble().empty()) log.warnings.push_back(ground.trouble());
  if (timetable.passed_over_s() > 0) log.warnings.push_back(log.camera.name + pauses_text(timetable, options));
  take_map(*system, options, &log);
  tracer->give(&log);
  return log;
}

}  // namespace pptam::platform
