#include "platform/run/live_recording.h"

#include <fcntl.h>

#include <algorithm>
#include <cerrno>
#include <cinttypes>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <sstream>
#include <string_view>
#include <utility>

#include <pocket_ptam/inspection.h>
#include "platform/camera/calibration.h"
#include "platform/camera/dump_sequence.h"
#include "platform/camera/image_files.h"
#include "platform/input_error.h"
#include "platform/run/interruption.h"
#include "platform/text.h"
#include "platform/text_file.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;

constexpr const char* kHead = "pocket-ptam live recording 1";
constexpr const char* kHeadOfAnyVersion = "pocket-ptam live recording ";
constexpr size_t kEndBytes = 32;  // room for the line of the end

const std::string kDistortions[] = {"none", "fov", "radtan", "equidistant"};

std::string number(float value) {
  return format("%.9g", static_cast<double>(value));  // reads as the same bits
}

std::string head_text(const CameraInfo& info, const RunOptions& options) {
  const CameraModel& m = info.model;
  std::string name = info.name;
  for (char& c : name) {
    if (static_cast<unsigned char>(c) < ' ') c = ' ';
  }
  std::string text = std::string(kHead) + "\nname " + name + format("\ncamera %d %d", m.width, m.height);
  for (const float value : {m.fx, m.fy, m.cx, m.cy}) text += " " + number(value);
  text += " " + kDistortions[static_cast<size_t>(m.distortion)];
  for (const float value : m.coeffs) text += " " + number(value);
  text += info.shutter.axis == RollingShutter::Axis::kRows ? " rows " : " columns ";
  text += number(info.shutter.line_time_s) + " " + number(info.exposure_s) + format(" %.9g\n", info.frames_per_s);
  return text + format("settings %d %.9g %d %d %d\n", options.auto_start ? 1 : 0,
                       static_cast<double>(static_cast<float>(options.plane_distance)), options.steady_damping ? 1 : 0,
                       options.max_keyframes.value_or(-1), options.max_erased_keyframes.value_or(-1));
}

class Fnv {
 public:
  template <class T>
  void add(const T& value) {
    unsigned char bytes[sizeof(T)];
    std::memcpy(bytes, &value, sizeof(T));
    for (const unsigned char byte : bytes) value_ = (value_ ^ byte) * 0x100000001b3ULL;
  }
  uint64_t value() const { return value_; }

 private:
  uint64_t value_ = 0xcbf29ce484222325ULL;
};

}  // namespace

uint64_t result_hash(const TrackResult& r) {
  Fnv hash;
  hash.add(r.timestamp_ns);
  for (const int part : {static_cast<int>(r.status.code()), static_cast<int>(r.state), static_cast<int>(r.quality),
                         static_cast<int>(r.hint), r.pose_valid ? 1 : 0, r.points_attempted, r.points_found,
                         r.points_inliers, r.partial_found, r.keyframes, r.map_points}) {
    hash.add(part);
  }
  for (int i = 0; i < 9; ++i) hash.add(r.T_cw.R.data()[i]);
  for (int i = 0; i < 3; ++i) hash.add(r.T_cw.t.data()[i]);
  for (int i = 0; i < 36; ++i) hash.add(r.covariance.data()[i]);
  return hash.value();
}

// ---- Writing -----------------------------------------------------------------------------------------------------

void LiveRecording::check(const fs::path& folder) {
  std::error_code error;
  if (fs::exists(folder, error) && (!fs::is_directory(folder, error) || !fs::is_empty(folder, error)))
    throw InputError("--record " + folder.string() + ": exists and is not an empty folder; name a new one");
}

LiveRecording::LiveRecording(const fs::path& folder, const CameraInfo& camera, const RunOptions& options,
                             FileOperations* files, size_t max_events)
    : folder_(folder), files_(files != nullptr ? *files : system_), max_events_(max_events) {
  check(folder);
  try {
    make(camera, options);
  } catch (...) {
    close_files();
    discard();
    throw;
  }
}

void LiveRecording::make(const CameraInfo& camera, const RunOptions& options) {
  made_ = missing_folders(folder_ / "rgb");
  make_folder(folder_ / "rgb", "--record");
  write_text_atomically(folder_ / "calibration.yaml",
                        calibration_yaml({camera.model, camera.shutter, camera.exposure_s}));
  made_.push_back(folder_ / "calibration.yaml");
  const auto open = [&](const char* name) {
    const int fd = files_.open((folder_ / name).c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (fd < 0) throw InputError("--record " + (folder_ / name).string() + ": " + std::strerror(errno));
    made_.push_back(folder_ / name);
    return fd;
  };
  events_fd_ = open(kEventsName);
  list_fd_ = open("rgb.txt");
  append(list_fd_, "# timestamp filename\n", folder_ / "rgb.txt");
  const std::string head = head_text(camera, options);
  append(events_fd_, head, folder_ / kEventsName);
  events_bytes_ = head.size();
  if (!trouble_.empty()) throw InputError("--record " + trouble_);
}

LiveRecording::~LiveRecording() {
  close_files();
}

void LiveRecording::close_files() noexcept {
  for (int* fd : {&events_fd_, &list_fd_}) {
    if (*fd >= 0) files_.close(*fd);
    *fd = -1;
  }
}

void LiveRecording::discard() noexcept {
  std::error_code ignored;  // a folder that others have put something into stays
  for (auto path = made_.rbegin(); path != made_.rend(); ++path) fs::remove(*path, ignored);
}

void LiveRecording::give_up(const std::string& why) {
  if (trouble_.empty()) trouble_ = why;
}

void LiveRecording::append(int fd, const std::string& text, const fs::path& file) {
  size_t done = 0;
  while (done < text.size()) {
    const ssize_t written = files_.write(fd, text.data() + done, text.size() - done);
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) return give_up(file.string() + ": " + std::strerror(errno));
    done += static_cast<size_t>(written);
  }
}

// Whole or not at all, but for a power cut.
void LiveRecording::write_file(const fs::path& file, std::span<const std::byte> head, std::span<const std::byte> body) {
  const int fd = files_.open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  if (fd < 0) return give_up(file.string() + ": " + std::strerror(errno));
  const std::string before = trouble_;
  for (const std::span<const std::byte> part : {head, body})
    append(fd, {reinterpret_cast<const char*>(part.data()), part.size()}, file);
  const bool closed = files_.close(fd) == 0;
  if (!closed) give_up(file.string() + ": " + std::strerror(errno));
  if (trouble_ != before) files_.unlink(file.c_str());
}

void LiveRecording::note_slice() {
  if (!trouble_.empty()) return;
  ++slices_;
  if (++slices_before_frame_ > kMaxSlices) give_up("no frame came for too long");
}

void LiveRecording::flush_slices() {
  if (slices_ > 0) pending_ += format("slices %d\n", slices_);
  slices_ = 0;
}

void LiveRecording::note(const std::string& call) {
  if (!trouble_.empty()) return;
  if (++calls_ > kMaxCalls) return give_up(format("more than %d keys", kMaxCalls));
  flush_slices();
  pending_ += call + "\n";
}

void LiveRecording::note_load(std::span<const std::byte> map) {
  if (!trouble_.empty()) return;
  const std::string name = format("map-%d.map", maps_++);
  write_file(folder_ / name, {}, map);
  if (trouble_.empty()) made_.push_back(folder_ / name);
  note("load " + name);
}

void LiveRecording::note_frame(const Frame& frame, const TrackResult& result) {
  if (!trouble_.empty()) return;
  const std::string stamp = timestamp_name(frame.timestamp_ns);
  const std::string name = "rgb/" + stamp + ".pgm";
  flush_slices();
  const std::string line =
      format("frame %" PRId64 " ", frame.timestamp_ns) + name + format(" %016" PRIx64, result_hash(result)) + "\n";
  if (events_bytes_ + pending_.size() + line.size() + kEndBytes > max_events_)
    return give_up("events.txt is as long as replay takes it");
  const std::string head = format("P5\n%d %d\n255\n", frame.width, frame.height);
  const auto width = static_cast<size_t>(frame.width);
  packed_.resize(width * static_cast<size_t>(frame.height));
  for (int y = 0; y < frame.height; ++y) {
    std::memcpy(packed_.data() + static_cast<size_t>(y) * width,
                frame.data + static_cast<ptrdiff_t>(y) * frame.stride_bytes, width);
  }
  write_file(folder_ / name, std::as_bytes(std::span(head)), packed_);
  if (!trouble_.empty()) return;
  append(list_fd_, stamp + " " + name + "\n", folder_ / "rgb.txt");
  if (!trouble_.empty()) return;
  pending_ += line;
  append(events_fd_, pending_, folder_ / kEventsName);
  events_bytes_ += pending_.size();
  pending_.clear();
  slices_before_frame_ = 0;
  if (trouble_.empty()) ++frames_;
}

void LiveRecording::finish(uint64_t map_hash) {
  if (!trouble_.empty()) return;
  flush_slices();
  pending_ += format("end %016" PRIx64 "\n", map_hash);
  if (events_bytes_ + pending_.size() > max_events_) return give_up("events.txt is as long as replay takes it");
  append(events_fd_, pending_, folder_ / kEventsName);
  pending_.clear();
}

void NotedSystem::work_slice() {
  system_.work_slice();
  if (recording_ != nullptr) recording_->note_slice();
}

void NotedSystem::tap() {
  system_.tap();
  if (recording_ != nullptr) recording_->note("tap");
}

void NotedSystem::reset() {
  system_.reset();
  if (recording_ != nullptr) recording_->note("reset");
}

void NotedSystem::set_locked(bool locked) {
  system_.set_locked(locked);
  if (recording_ != nullptr) recording_->note(locked ? "lock" : "unlock");
}

Status NotedSystem::set_length(uint32_t point_a, uint32_t point_b, float length) {
  const Status status = system_.set_length(point_a, point_b, length);
  if (status.ok() && recording_ != nullptr)
    recording_->note(format("length %u %u ", point_a, point_b) + number(length));
  return status;
}

Status NotedSystem::set_ground(const Vector2f& px, pptam::Similarity* change) {
  const Status status = system_.set_ground(px, change);
  if (status.ok() && recording_ != nullptr) recording_->note("ground " + number(px.x()) + " " + number(px.y()));
  return status;
}

Status NotedSystem::load_map(std::span<const std::byte> file) {
  const Status status = system_.load_map(file);
  if (status.ok() && recording_ != nullptr) recording_->note_load(file);
  return status;
}

// ---- Reading -----------------------------------------------------------------------------------------------------

namespace {

constexpr double kMaxRate = 10'000;  // frames a second

// The words of a line, each read as what it must be.
class Words {
 public:
  Words(std::string_view line, LineError fail) : stream_(std::string(line)), fail_(std::move(fail)) {}

  std::string word() {
    std::string text;
    if (!(stream_ >> text)) fail_("a word is missing");
    return text;
  }
  int64_t integer(int64_t least, int64_t most) {
    const std::string text = word();
    int64_t value = 0;
    if (!parse_integer(text, &value) || value < least || value > most) fail_("'" + text + "' is no number for here");
    return value;
  }
  double real() {
    const std::string text = word();
    char* end = nullptr;
    const double value = std::strtod(text.c_str(), &end);
    if (end != text.c_str() + text.size()) fail_("'" + text + "' is no number");
    return value;
  }
  float single() {  // not by way of double: that would round twice
    const std::string text = word();
    char* end = nullptr;
    const float value = std::strtof(text.c_str(), &end);
    if (end != text.c_str() + text.size()) fail_("'" + text + "' is no number");
    return value;
  }
  uint64_t hash() {
    const std::string text = word();
    char* end = nullptr;
    const uint64_t value = std::strtoull(text.c_str(), &end, 16);
    if (text.size() != 16 || end != text.c_str() + text.size()) fail_("'" + text + "' is no hash");
    return value;
  }
  // A file in the folder, and nowhere else.
  std::string file(const std::string& before, const std::string& after) {
    std::string text = word();
    const bool framed = text.size() > before.size() + after.size() && text.rfind(before, 0) == 0 &&
                        text.compare(text.size() - after.size(), after.size(), after) == 0;
    const std::string middle =
        framed ? text.substr(before.size(), text.size() - before.size() - after.size()) : std::string("?");
    if (middle.find_first_not_of("0123456789.-") != std::string::npos)
      fail_("'" + text + "' is no file of a recording");
    return text;
  }
  void end() {
    std::string text;
    if (stream_ >> text) fail_("'" + text + "' is one word too many");
  }

 private:
  std::istringstream stream_;
  LineError fail_;
};

void read_camera(Words& words, const LineError& fail, CameraInfo* info) {
  CameraModel& m = info->model;
  m.width = static_cast<int>(words.integer(1, 8192));
  m.height = static_cast<int>(words.integer(1, 8192));
  for (float* value : {&m.fx, &m.fy, &m.cx, &m.cy}) *value = words.single();
  const std::string distortion = words.word();
  size_t kind = 0;
  while (kind < std::size(kDistortions) && kDistortions[kind] != distortion) ++kind;
  if (kind == std::size(kDistortions)) fail("'" + distortion + "' is no distortion");
  m.distortion = static_cast<Distortion>(kind);
  for (float& value : m.coeffs) value = words.single();
  const std::string axis = words.word();
  if (axis != "rows" && axis != "columns") fail("'" + axis + "' is neither rows nor columns");
  info->shutter.axis = axis == "rows" ? RollingShutter::Axis::kRows : RollingShutter::Axis::kColumns;
  info->shutter.line_time_s = words.single();
  info->exposure_s = words.single();
  info->frames_per_s = words.real();
  if (!(info->frames_per_s >= 0 && info->frames_per_s <= kMaxRate)) fail("the rate is not one of frames a second");
  const Status status = m.validate();
  if (!status.ok()) fail(std::string("the camera cannot be used: ") + status.message());
  m.prepare();
}

void read_settings(Words& words, RunOptions* settings) {
  settings->auto_start = words.integer(0, 1) == 1;
  settings->plane_distance = static_cast<double>(words.single());
  settings->steady_damping = words.integer(0, 1) == 1;
  const auto kept = [&](std::optional<int>* count) {
    const int64_t value = words.integer(-1, 1'000'000);
    if (value >= 0) *count = static_cast<int>(value);
  };
  kept(&settings->max_keyframes);
  kept(&settings->max_erased_keyframes);
}

// False: it is none.
bool read_event(const std::string& what, Words& words, LiveScript::Event* event) {
  using Kind = LiveScript::Kind;
  if (what == "slices") {
    event->kind = Kind::kSlices;
    event->slices = static_cast<int>(words.integer(1, LiveRecording::kMaxSlices));
  } else if (what == "tap") {
    event->kind = Kind::kTap;
  } else if (what == "reset") {
    event->kind = Kind::kReset;
  } else if (what == "lock") {
    event->kind = Kind::kLock;
  } else if (what == "unlock") {
    event->kind = Kind::kUnlock;
  } else if (what == "length") {
    event->kind = Kind::kLength;
    event->point_a = static_cast<uint32_t>(words.integer(0, UINT32_MAX));
    event->point_b = static_cast<uint32_t>(words.integer(0, UINT32_MAX));
    event->length = words.single();
  } else if (what == "ground") {
    event->kind = Kind::kGround;
    event->px.x() = words.single();
    event->px.y() = words.single();
  } else if (what == "load") {
    event->kind = Kind::kLoad;
    event->file = words.file("map-", ".map");
  } else if (what == "frame") {
    event->kind = Kind::kFrame;
    event->timestamp_ns = words.integer(INT64_MIN, INT64_MAX);
    event->file = words.file("rgb/", ".pgm");
    event->result = words.hash();
  } else {
    return false;
  }
  return true;
}

// Lines are short and events are not: neither may a list of them take all memory, nor one frame take for ever.
class EventList {
 public:
  EventList(std::vector<LiveScript::Event>* events, LineError fail) : events_(*events), fail_(std::move(fail)) {}

  void add(const LiveScript::Event& event) {
    using Kind = LiveScript::Kind;
    if (event.kind == Kind::kSlices) {
      slices_ += event.slices;
      if (slices_ > LiveRecording::kMaxSlices) fail_("too many slices before one frame");
      if (!events_.empty() && events_.back().kind == Kind::kSlices) {
        events_.back().slices += event.slices;
        return;
      }
    } else if (event.kind == Kind::kFrame) {
      slices_ = 0;
    } else if (++calls_ > LiveRecording::kMaxCalls) {
      fail_(format("more than %d calls", LiveRecording::kMaxCalls));
    }
    events_.push_back(event);
  }

 private:
  std::vector<LiveScript::Event>& events_;
  LineError fail_;
  int64_t slices_ = 0;  // since the last frame
  int calls_ = 0;
};

}  // namespace

bool is_live_recording(const fs::path& folder) {
  const fs::path file = folder / LiveRecording::kEventsName;
  std::error_code ignored;
  if (!fs::is_regular_file(file, ignored)) return false;
  std::ifstream stream(file, std::ios::binary);  // others, too, call a file so
  std::string head(std::strlen(kHeadOfAnyVersion), '\0');
  return stream.read(head.data(), static_cast<std::streamsize>(head.size())) && head == kHeadOfAnyVersion;
}

LiveScript read_live_recording(const fs::path& folder) {
  LiveScript script;
  script.folder = folder;
  const fs::path file = folder / LiveRecording::kEventsName;
  const std::vector<std::byte> bytes = read_file(file, LiveRecording::kMaxEvents);
  std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  int number_of_line = 0;
  const LineError fail = [&](const std::string& what) {
    throw InputError(file.string() + format(":%d: ", number_of_line) + what);
  };
  bool camera = false, settings = false;
  int frames = 0;
  EventList events(&script.events, fail);
  for (size_t end = text.find('\n'); end != std::string_view::npos; end = text.find('\n')) {
    ++number_of_line;
    const std::string_view line = text.substr(0, end);
    text.remove_prefix(end + 1);
    if (number_of_line == 1) {
      if (line != kHead) fail(std::string("is not '") + kHead + "'");
      continue;
    }
    if (script.map_hash) fail("something follows the end");
    Words words(line, fail);
    const std::string what = words.word();
    LiveScript::Event event;
    if (what == "name") {
      script.camera.name = std::string(line.substr(std::min<size_t>(5, line.size())));
      continue;
    }
    if (what == "camera") {
      read_camera(words, fail, &script.camera);
      camera = true;
    } else if (what == "settings") {
      read_settings(words, &script.settings);
      settings = true;
    } else if (what == "end") {
      script.map_hash = words.hash();
    } else if (!camera || !settings) {
      fail("camera and settings come first");
    } else if (read_event(what, words, &event)) {
      events.add(event);
      if (event.kind == LiveScript::Kind::kFrame) ++frames;
    } else {
      fail("'" + what + "' is unknown: a later version's recording?");
    }
    words.end();
  }
  if (number_of_line == 0) throw InputError(file.string() + ": is not a live recording's list of events");
  if (frames == 0) throw InputError(file.string() + ": holds no frames");
  script.camera.frame_count = frames;
  return script;
}

// ---- Repeating ---------------------------------------------------------------------------------------------------

namespace {

// All but frames; what is wrong with it is thrown.
void repeat_call(System& system, const LiveScript& script, const LiveScript::Event& event, RunLog* log) {
  using Kind = LiveScript::Kind;
  const auto require = [&](const Status& status) {
    if (!status.ok()) throw InputError((script.folder / event.file).string() + ": " + status.message());
  };
  switch (event.kind) {
    case Kind::kSlices:
      for (int i = 0; i < event.slices && system.has_work(); ++i) system.work_slice();
      return;
    case Kind::kTap:
      return system.tap();
    case Kind::kReset:
      return system.reset();
    case Kind::kLock:
    case Kind::kUnlock:
      return system.set_locked(event.kind == Kind::kLock);
    case Kind::kLength:
      return require(system.set_length(event.point_a, event.point_b, event.length));
    case Kind::kGround: {
      pptam::Similarity change;
      require(system.set_ground(event.px, &change));
      return log->move_poses(change);
    }
    case Kind::kLoad:
      return require(system.load_map(read_map_file(script.folder / event.file)));
    case Kind::kFrame:
      return;
  }
}

}  // namespace

RunLog repeat_live_recording(const LiveScript& script, const RunOptions& options, const StartObserver& on_start,
                             const FrameObserver& on_frame, const Spectator& spectator) {
  RunOptions settings = script.settings;
  settings.clock = options.clock;
  settings.slowdown = options.slowdown;
  settings.save_map = options.save_map;
  settings.keep_trace = options.keep_trace;
  RunLog log;
  log.camera = script.camera;
  log.clock = options.clock;
  const Session session = make_session(script.camera, settings);
  System& system = *session.system;
  Clock& clock = *session.clock;
  log.memory_bytes = session.bytes;
  on_start(log.camera);
  for (const LiveScript::Event& event : script.events) {
    if (interrupted() || log.quit) break;
    try {
      if (event.kind != LiveScript::Kind::kFrame) {
        repeat_call(system, script, event, &log);
        continue;
      }
      const GreyPixels image = read_image(script.folder / event.file);
      session.tracer->number(log.source_frames);
      const int64_t start_ns = clock.now_ns();
      const int64_t start_instructions = system.work_meter().instructions();
      const Frame frame = {image.px.data(), image.width,        image.height,
                           image.width,     PixelFormat::kGrey, event.timestamp_ns};
      const TrackResult result = system.track(frame);
      if (!result.status.ok()) {  // such as an image of another size
        log.broken = (script.folder / event.file).string() + " was refused: " + result.status.message();
        break;
      }
      if (log.differs.empty() && result_hash(result) != event.result) {
        log.differs =
            format("frame %d, %s, has other bits than in the live run: was it changed, or recorded by another version?",
                   log.source_frames, event.file.c_str());
      }
      FrameLog entry = log_of(result);
      entry.index = log.source_frames++;
      entry.track_ns = saturated_difference(clock.now_ns(), start_ns);
      entry.late_ns = entry.track_ns;
      session.tracer->take(&entry);
      entry.instructions = system.work_meter().instructions() - start_instructions;
      log.frames.push_back(entry);
      if (on_frame) on_frame(frame, result, log);
      if (spectator.show) spectator.show(frame, result, entry, system);
      const RunKey key = spectator.key ? spectator.key() : RunKey::kNothing;
      log.quit = key == RunKey::kQuit;
      if (key != RunKey::kNothing && !log.quit && spectator.say)
        spectator.say("only p, v and q do something here: what was done live is repeated");
    } catch (const std::exception& error) {
      if (log.frames.empty()) throw;
      log.broken = error.what();
      break;
    }
  }
  if (interrupted()) log.broken = log.camera.name + ": " + interruption();
  take_map(system, settings, &log);
  session.tracer->give(&log);
  if (!log.quit && log.broken.empty() && script.map_hash && *script.map_hash != log.map_hash && log.differs.empty())
    log.differs = "the map has other bits than that of the live run: was it recorded by another version?";
  return log;
}

}  // namespace pptam::platform
