#include "platform/run/live.h"

#include <algorithm>
#include <exception>
#include <memory>
#include <new>
#include <optional>
#include <utility>
#include <vector>

#include "platform/input_error.h"
#include "platform/run/interruption.h"
#include "platform/run/names.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

constexpr int64_t kLook_ns = 50'000'000;            // between two looks at keys and signals while nothing happens
constexpr int64_t kFirstFrame_ns = 10'000'000'000;  // for a camera that is not there yet, or takes its time
constexpr int kMostStale = 8;  // frames in a row: more come of a camera whose stamps are late, and are taken

// A point that is marked lies within this share of the image's width from its middle: as near as one aims by hand.
constexpr float kAim = 0.05f;  // not swept

// The map point found nearest to the image's middle.
std::optional<uint32_t> aimed_point(const TrackResult& result, const CameraModel& model) {
  const Vector2f middle(0.5f * static_cast<float>(model.width - 1), 0.5f * static_cast<float>(model.height - 1));
  std::optional<uint32_t> aimed;
  if (!result.pose_valid) return aimed;
  float best_px = kAim * static_cast<float>(model.width);
  for (const ObservedPoint& point : result.points) {
    const float px = (point.px - middle).norm();
    if (point.kind != ObservedKind::kInlier || px > best_px) continue;
    best_px = px;
    aimed = point.point_id;
  }
  return aimed;
}

class LiveRun {
 public:
  LiveRun(Camera& camera, const LiveOptions& options, const LiveObserver& observer)
      : camera_(camera), options_(options), observer_(observer), ground_(options.run.ground) {}

  LiveResult run() {
    camera_.start();
    Frame frame;
    first_frame(&frame);
    build();
    try {
      observer_.on_start(result_.log.camera);
    } catch (...) {
      if (recording_) recording_->discard();
      throw;
    }
    begun_ns_ = clock_.now_ns();
    for (const RunKey key : early_) press(key);
    for (bool there = fresh_frame(&frame); there && !over_; there = next_frame(&frame)) track(frame);
    return finish();
  }

 private:
  void first_frame(Frame* frame);
  bool next_frame(Frame* frame);
  bool fresh_frame(Frame* frame);
  bool stale() const;
  void build();
  void track(const Frame& frame);
  bool meet(CameraEvent event);
  void press(RunKey key);
  Status set_ground(const Vector2f& px);
  void mark();
  void forget_marks() {
    aimed_.reset();
    marked_.reset();
  }
  LiveResult finish();
  void say(const std::string& text) const {
    if (observer_.say) observer_.say(text);
  }

  Camera& camera_;
  const LiveOptions& options_;
  const LiveObserver& observer_;
  SteadyClock clock_;
  Session session_;
  std::unique_ptr<LiveRecording> recording_;
  std::optional<NotedSystem> system_;
  LiveResult result_;
  int64_t first_ns_ = 0;           // timestamp
  int64_t begun_ns_ = 0;           // by clock_
  std::vector<RunKey> early_;      // before the first frame
  std::optional<uint32_t> aimed_;  // in the last frame, with a length; none: there is no such frame or point
  GroundChoice ground_;
  std::optional<uint32_t> marked_;  // one end of the length
  bool over_ = false;
  bool trouble_told_ = false;
};

// Without it nothing has been done yet: what is wrong is thrown.
void LiveRun::first_frame(Frame* frame) {
  const int64_t until_ns = clock_.now_ns() + kFirstFrame_ns;
  for (;;) {
    if (interrupted()) throw InputError(camera_.info().name + ": " + interruption() + " before the first frame");
    const RunKey key = observer_.key ? observer_.key() : RunKey::kNothing;
    if (key == RunKey::kQuit) throw InputError(camera_.info().name + ": ended before the first frame");
    if (key != RunKey::kNothing) early_.push_back(key);
    const CameraEvent event = camera_.wait(frame, clock_.now_ns() + kLook_ns);
    if (event == CameraEvent::kFrame) return;
    if (event == CameraEvent::kEnd) throw InputError(camera_.info().name + ": holds no images");
    if (event == CameraEvent::kUnplugged)
      throw InputError(camera_.status().trouble + ": plug it in again, or try another --mode");
    if (clock_.now_ns() > until_ns)
      throw InputError(camera_.info().name + ": delivers no frames: plug it in again, or try another --mode");
  }
}

void LiveRun::build() {
  RunLog& log = result_.log;
  log.camera = camera_.info();
  log.clock = ClockKind::kSteady;
  RunOptions bare = options_.run;  // the map and the lock are to be noted
  bare.clock = ClockKind::kSteady;
  bare.load_map.clear();
  bare.lock_map = false;
  session_ = make_session(log.camera, bare);
  log.memory_bytes = session_.bytes;
  std::vector<std::byte> map;
  if (!options_.run.load_map.empty()) {
    map = read_map_file(options_.run.load_map);
    MapInfo info;
    const Status status = System::map_info(map, &info);
    if (!status.ok()) throw InputError(options_.run.load_map + ": " + status.message());
  }
  if (!map.empty()) {
    const Status status = session_.system->load_map(map);
    if (!status.ok()) throw InputError(options_.run.load_map + ": " + status.message());
  }
  if (!options_.record.empty()) recording_ = std::make_unique<LiveRecording>(options_.record, log.camera, bare);
  if (recording_ && !map.empty()) recording_->note_load(map);
  system_.emplace(*session_.system, recording_.get());
  if (options_.run.lock_map) system_->set_locked(true);
}

// False at the end. The time until it comes is mapping's, a slice at least: where frames come faster than they are
// tracked there would be no map.
bool LiveRun::next_frame(Frame* frame) {
  for (;;) {
    if (interrupted() || over_) return false;
    if (observer_.key) press(observer_.key());
    const bool busy = session_.system->has_work();
    if (busy) system_->work_slice();
    const int64_t wait_from_ns = clock_.now_ns();
    const CameraEvent event = camera_.wait(frame, busy ? 0 : wait_from_ns + kLook_ns);
    if (!busy) session_.tracer->add_idle(wait_from_ns);
    if (event == CameraEvent::kFrame) return true;
    if (!meet(event)) return false;
    // A camera that has gone has no times.
    if (result_.status.camera_gone && options_.duration_s > 0 &&
        1e-9 * static_cast<double>(clock_.now_ns() - begun_ns_) >= options_.duration_s) {
      return false;
    }
  }
}

// Of a live source, by now.
bool LiveRun::stale() const {
  const double rate = camera_.info().frames_per_s;
  const int64_t arrived_ns = camera_.status().arrived_ns;
  return arrived_ns != 0 && rate > 0 && 1e-9 * static_cast<double>(clock_.now_ns() - arrived_ns) > 1 / rate;
}

// While the system was built the driver ran out of buffers: what lies in them is older than the next frame to come.
bool LiveRun::fresh_frame(Frame* frame) {
  for (int i = 0; i < kMostStale && stale(); ++i) {
    camera_.give_back();
    ++result_.status.stale;
    if (!next_frame(frame)) return false;
  }
  return true;
}

bool LiveRun::meet(CameraEvent event) {
  LiveStatus& status = result_.status;
  switch (event) {
    case CameraEvent::kUnplugged:
      status.camera_gone = true;
      aimed_.reset();
      say(camera_.status().trouble + "; waiting for it to come back");
      break;
    case CameraEvent::kReplugged:
      status.camera_gone = false;
      say(camera_.info().name + ": is back");
      break;
    case CameraEvent::kEnd:
      return false;
    case CameraEvent::kFrame:
    case CameraEvent::kTimeout:
      return true;
  }
  status.camera = camera_.status();
  if (observer_.on_status) observer_.on_status(status);
  return true;
}

void LiveRun::press(RunKey key) {
  if (key == RunKey::kMark) return mark();
  if (key == RunKey::kTap || key == RunKey::kReset) forget_marks();
  const SystemCalls calls = {[this] { system_->tap(); }, [this] { system_->reset(); },
                             [this](bool locked) { system_->set_locked(locked); },
                             [this](const Vector2f& px) { return set_ground(px); }};
  if (!platform::press(key, system_->system(), calls, observer_)) over_ = true;
}

Status LiveRun::set_ground(const Vector2f& px) {
  pptam::Similarity change;
  const Status status = system_->set_ground(px, &change);
  if (status.ok()) result_.log.move_poses(change);
  return status;
}

void LiveRun::mark() {
  if (options_.length <= 0) return say("nothing is marked: no length was given by --length");
  if (!aimed_) return say("nothing is marked: no point of the map is in the middle of the image");
  if (!marked_) {
    marked_ = aimed_;
    return say("one end is marked: aim at the other one, and mark it");
  }
  if (*aimed_ == *marked_) return say("this end is marked already: aim at the other one, and mark it");
  const Status status = system_->set_length(*marked_, *aimed_, static_cast<float>(options_.length));
  marked_.reset();
  say(status.ok() ? format("the two marks are %.6g apart from now on", options_.length)
                  : std::string("the length is not set: ") + status.message());
}

void LiveRun::track(const Frame& frame) {
  RunLog& log = result_.log;
  LiveStatus& status = result_.status;
  session_.tracer->number(log.source_frames);
  const int64_t start_ns = clock_.now_ns();
  const int64_t start_instructions = session_.system->work_meter().instructions();
  TrackResult result = system_->track(frame);
  const int64_t tracked_ns = clock_.now_ns();
  const int index = log.source_frames++;
  if (!result.status.ok()) {
    if (status.refused++ == 0) say(std::string("a frame was refused: ") + result.status.message());
    aimed_.reset();
    camera_.give_back();
    return;
  }
  const bool choose_ground = ground_.due(result);
  if (choose_ground) {
    system_->note_frame(frame, result);  // the choice comes after it
    ground_.choose([this](const Vector2f& px, pptam::Similarity* change) { return system_->set_ground(px, change); },
                   &result);
    if (!ground_.trouble().empty()) say(ground_.trouble());
  }
  if (result.map_points == 0) forget_marks();
  if (options_.length > 0) aimed_ = aimed_point(result, camera_.info().model);
  status.camera = camera_.status();
  if (observer_.on_result && !observer_.on_result(result, status.camera.arrived_ns)) over_ = true;
  const int64_t written_ns = clock_.now_ns();
  const int64_t age_ns = saturated_difference(written_ns, status.camera.arrived_ns);
  if (status.camera.arrived_ns != 0) status.ages.add(age_ns);
  if (!choose_ground) system_->note_frame(frame, result);
  if (recording_ && !recording_->trouble().empty() && !trouble_told_) {
    trouble_told_ = true;
    status.record_trouble = recording_->trouble();
    say("the recording ends here, with " + std::to_string(recording_->frames()) + " frames: " + recording_->trouble());
  }
  if (status.frames++ == 0) first_ns_ = frame.timestamp_ns;
  if (result.pose_valid) ++status.poses;
  status.state = result.state;
  status.hint = result.hint;
  status.locked = session_.system->locked();
  status.keyframes = result.keyframes;
  status.map_points = result.map_points;
  status.recorded = recording_ ? recording_->frames() : 0;
  status.seconds = 1e-9 * static_cast<double>(saturated_difference(frame.timestamp_ns, first_ns_));
  if (options_.duration_s > 0 && status.seconds >= options_.duration_s) over_ = true;
  FrameLog entry = log_of(result);
  session_.tracer->take(&entry);
  if (options_.keep_frames || observer_.show) {
    entry.index = index;
    entry.track_ns = tracked_ns - start_ns;
    entry.late_ns = age_ns;
    entry.instructions = session_.system->work_meter().instructions() - start_instructions;
    if (options_.keep_frames) {
      log.frames.push_back(entry);
      if (observer_.on_frame) observer_.on_frame(frame, result, log);
    }
    if (observer_.show) observer_.show(frame, result, entry, *session_.system);
  }
  camera_.give_back();
  if (observer_.on_status) observer_.on_status(status);
}

LiveResult LiveRun::finish() {
  RunLog& log = result_.log;
  result_.status.camera = camera_.status();
  log.warnings = camera_.remarks();
  camera_.stop();
  log.dropped = static_cast<int>(std::min<int64_t>(result_.status.camera.dropped + result_.status.stale, INT32_MAX));
  log.source_frames += log.dropped;
  RunOptions wanted = options_.run;
  if (wanted.save_map && session_.system->map_bytes() == 0) {  // nobody's fault: it was ended when it was
    wanted.save_map = false;
    log.warnings.emplace_back("--save-map: nothing is saved, there was no map at the end");
  }
  take_map(*session_.system, wanted, &log);
  session_.tracer->give(&log);
  if (recording_) {
    recording_->finish(log.map_hash);
    result_.status.record_trouble = recording_->trouble();
    result_.status.recorded = recording_->frames();
  }
  return std::move(result_);
}

}  // namespace

void Ages::add(int64_t age_ns) {
  last_ns_ = age_ns;
  worst_ns_ = std::max(worst_ns_, age_ns);
  ++count_;
  const int64_t bin = std::clamp<int64_t>(age_ns / 1'000'000, 0, static_cast<int64_t>(bins_.size()) - 1);
  ++bins_[static_cast<size_t>(bin)];
}

double Ages::at_ms(double share) const {
  const auto wanted = static_cast<int64_t>(share * static_cast<double>(count_));
  int64_t below = 0;
  for (size_t bin = 0; bin < bins_.size(); ++bin) {
    below += bins_[bin];
    if (below > 0 && below >= wanted) return static_cast<double>(bin) + 0.5;
  }
  return 0;
}

LiveResult run_live(Camera& camera, const LiveOptions& options, const LiveObserver& observer) {
  return LiveRun(camera, options, observer).run();
}

std::vector<SummaryRow> summarise(const LiveResult& result) {
  const LiveStatus& status = result.status;
  const CameraInfo& camera = result.log.camera;
  const auto count = [](int64_t value) { return std::to_string(value); };
  std::vector<SummaryRow> rows;
  rows.push_back({"camera", camera.name + format(", %d x %d", camera.model.width, camera.model.height)});
  const double rate = status.seconds > 0 ? static_cast<double>(status.frames - 1) / status.seconds : 0;
  rows.push_back({"frames", count(status.frames) + format(" tracked in %.1f s, %.1f a second; ", status.seconds, rate) +
                                count(status.camera.dropped) + " dropped for newer ones, " +
                                count(status.camera.missed) + " missing, " + count(status.camera.broken) + " broken, " +
                                count(status.stale) + " too old at the start"});
  if (!status.camera.clock.empty()) rows.push_back({"times", status.camera.clock});
  if (status.camera.unplugged > 0)
    rows.push_back({"interruptions", count(status.camera.unplugged) + ", the last one: " + status.camera.trouble});
  rows.push_back({"poses", count(status.poses) + format(", %s at the end", name_of(status.state))});
  if (status.ages.count() > 0) {
    rows.push_back({"age of a pose", format("%.1f ms (median), %.1f (95 %%), %.1f at worst, from its last line",
                                            status.ages.at_ms(0.5), status.ages.at_ms(0.95), status.ages.worst_ms())});
  }
  rows.push_back({"map", format("%d keyframes, %d points", status.keyframes, status.map_points)});
  rows.push_back({"map hash", format("%016llx", static_cast<unsigned long long>(result.log.map_hash))});
  if (status.recorded > 0) rows.push_back({"recorded", count(status.recorded) + " frames"});
  return rows;
}

}  // namespace pptam::platform
