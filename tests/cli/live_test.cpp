// Live runs without a device: what they record is repeated bit for bit, whatever ended the recording; poses go where
// they were sent and nowhere else; keys, signals and cameras that are pulled out.
#include "platform/run/live.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <fstream>
#include <functional>
#include <iterator>
#include <map>
#include <memory>
#include <numeric>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "platform/calibrate/camera_fit.h"
#include "platform/camera/dump_sequence.h"
#include "platform/run/live_recording.h"
#include "platform/run/pose_lines.h"
#include "tests/support/recording.h"
#include "tests/support/scratch_folder.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;

bool holds(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

std::string read(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

void write(const fs::path& file, const std::string& content) {
  std::ofstream(file, std::ios::binary) << content;
}

std::string message_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

// A recording as a live camera whose frames come when a random number says so, and which can be pulled out.
class HastyCamera : public Camera {
 public:
  HastyCamera(const test::Recording& recording, unsigned seed) : recording_(recording), random_(seed) {}
  const CameraInfo& info() const override { return recording_.info; }
  CameraEvent wait(Frame* frame, int64_t /*deadline_ns*/) override {
    if (silent) return CameraEvent::kTimeout;
    if (next_ == recording_.size()) return CameraEvent::kEnd;
    if (next_ == pull_out_before) {
      pull_out_before = -1;
      gone_ = 3;
      status_.trouble = "hasty: pulled out";
      return CameraEvent::kUnplugged;
    }
    if (gone_ > 0 && stays_away) return CameraEvent::kTimeout;
    if (gone_ > 0) return --gone_ == 0 ? CameraEvent::kReplugged : CameraEvent::kTimeout;
    if (random_() % 25 != 0 && !always) return CameraEvent::kTimeout;
    *frame = recording_.frame(next_++);
    if (stale > 0) status_.arrived_ns = SteadyClock().now_ns() - (next_ <= stale ? 2'000'000'000 : 0);
    return CameraEvent::kFrame;
  }
  CameraStatus status() const override { return status_; }

  int next() const { return next_; }
  int pull_out_before = -1;
  bool stays_away = false;
  bool silent = false;  // no frame ever comes
  bool always = false;  // the next frame is always there
  int stale = 0;        // the first frames, so many, are two seconds old; 0: no age is known

 private:
  const test::Recording& recording_;
  std::mt19937 random_;
  CameraStatus status_;
  int next_ = 0;
  int gone_ = 0;
};

const test::Recording& desk() {
  static const test::Recording recording = [] {
    sim::PhoneOptions options;
    options.duration_s = 5;
    return test::record(options);
  }();
  return recording;
}

std::string timestamp_name_of(int frame) {
  return timestamp_name(desk().timestamps_ns[static_cast<size_t>(frame)]);
}

struct Lived {
  LiveResult result;
  std::vector<std::string> said;
  std::vector<std::byte> map;
};

// With keys before the frames of those numbers.
Lived live(const fs::path& record, unsigned seed, const std::map<int, RunKey>& keys, int pull_out_before = -1) {
  Lived lived;
  HastyCamera camera(desk(), seed);
  camera.pull_out_before = pull_out_before;
  LiveOptions options;
  options.run.auto_start = keys.empty();
  options.run.save_map = true;
  options.keep_frames = true;
  options.record = record.string();
  LiveObserver observer;
  observer.on_start = [](const CameraInfo&) {};
  int pressed = -1;
  observer.key = [&] {
    const auto key = keys.find(camera.next());
    if (key == keys.end() || pressed == camera.next()) return RunKey::kNothing;
    pressed = camera.next();
    return key->second;
  };
  observer.say = [&](const std::string& text) { lived.said.push_back(text); };
  observer.on_save = [&](std::span<const std::byte> map) { lived.map.assign(map.begin(), map.end()); };
  lived.result = run_live(camera, options, observer);
  return lived;
}

RunLog repeat(const fs::path& folder, ClockKind clock = ClockKind::kWork) {
  RunOptions options;
  options.clock = clock;
  return repeat_live_recording(read_live_recording(folder), options, [](const CameraInfo&) {}, {});
}

void expect_same(const RunLog& live, const RunLog& again) {
  EXPECT_EQ(again.differs, "");
  EXPECT_EQ(again.broken, "");
  EXPECT_EQ(live.map_hash, again.map_hash);
  ASSERT_EQ(live.frames.size(), again.frames.size());
  for (size_t i = 0; i < live.frames.size(); ++i) {
    EXPECT_EQ(live.frames[i].state, again.frames[i].state) << i;
    EXPECT_EQ(live.frames[i].idle_slices, again.frames[i].idle_slices) << i;
    EXPECT_TRUE(live.frames[i].T_wc.matrix() == again.frames[i].T_wc.matrix()) << i;
  }
}

class Live : public ::testing::Test {
 protected:
  fs::path at(const std::string& name) const { return scratch_ / name; }
  int code_of(const std::string& arguments) const {
    const int status = std::system(("cd '" + scratch_.path().string() + "' && { " + arguments + "; }").c_str());
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128;
  }
  const test::ScratchFolder scratch_;
};

// ---- Recordings --------------------------------------------------------------------------------------------------

TEST_F(Live, ARecordingIsRepeatedBitForBit) {
  using Key = RunKey;
  const std::map<int, Key> keys[] = {
      {}, {{2, Key::kTap}, {55, Key::kLock}, {65, Key::kLock}}, {{5, Key::kTap}, {60, Key::kReset}, {62, Key::kTap}}};
  uint64_t hashes[3] = {};
  for (unsigned seed = 1; seed <= 3; ++seed) {
    SCOPED_TRACE(seed);
    const fs::path folder = at("recording" + std::to_string(seed));
    const Lived lived = live(folder, seed, keys[seed - 1]);
    EXPECT_EQ(lived.result.status.recorded, desk().size());
    EXPECT_GT(lived.result.status.poses, 10);
    expect_same(lived.result.log, repeat(folder));
    hashes[seed - 1] = lived.result.log.map_hash;
  }
  expect_same(repeat(at("recording1")), repeat(at("recording1"), ClockKind::kThrottled));
  // Not because they would be the same anyway.
  EXPECT_NE(hashes[0], hashes[1]);
  EXPECT_NE(hashes[1], hashes[2]);
}

// Its other keys would not be what was done live.
TEST_F(Live, AKeyEndsARepetitionAndNothingIsSaidOfTheRest) {
  const fs::path folder = at("recording");
  live(folder, 4, {{2, RunKey::kTap}});
  for (const int quit_after : {-1, 20}) {
    Spectator spectator;
    int asked = 0;
    std::vector<std::string> said;
    spectator.key = [&] {
      ++asked;
      return asked == 10 ? RunKey::kReset : asked == quit_after ? RunKey::kQuit : RunKey::kNothing;
    };
    spectator.say = [&](const std::string& text) { said.push_back(text); };
    const RunLog log = repeat_live_recording(
        read_live_recording(folder), {}, [](const CameraInfo&) {}, {}, spectator);
    EXPECT_EQ(log.quit, quit_after > 0);
    EXPECT_EQ(static_cast<int>(log.frames.size()), quit_after > 0 ? quit_after : desk().size());
    EXPECT_EQ(log.differs, "") << "the reset of key r is not obeyed";
    ASSERT_EQ(said.size(), 1u);
    EXPECT_TRUE(holds(said[0], "p, v and q")) << said[0];
  }
}

// Before the first frame, too: a camera may take its time.
TEST_F(Live, AKeyEndsTheWaitForTheFirstFrame) {
  HastyCamera camera(desk(), 1);
  camera.silent = true;
  LiveObserver observer;
  int asked = 0;
  observer.key = [&] { return ++asked == 3 ? RunKey::kQuit : RunKey::kNothing; };
  EXPECT_THROW(run_live(camera, {}, observer), InputError);
  EXPECT_EQ(asked, 3);
}

TEST_F(Live, OtherBitsAreSeen) {
  const fs::path folder = at("recording");
  live(folder, 4, {{2, RunKey::kTap}});
  const std::string events = read(folder / "events.txt");
  std::string fewer = events;
  const size_t tap = fewer.find("\ntap\n");
  ASSERT_NE(tap, std::string::npos);
  fewer.erase(tap, 4);
  write(folder / "events.txt", fewer);
  EXPECT_TRUE(holds(repeat(folder).differs, "other bits"));
  write(folder / "events.txt", events);
  EXPECT_EQ(repeat(folder).differs, "");
  const fs::path image = folder / "rgb" / (timestamp_name_of(40) + ".pgm");
  std::string pixels = read(image);
  ASSERT_GT(pixels.size(), 240u * 320u);
  for (size_t i = 30000; i < 40000; ++i) pixels[i] = static_cast<char>(~pixels[i]);
  write(image, pixels);
  EXPECT_TRUE(holds(repeat(folder).differs, "frame 40"));
}

TEST_F(Live, LoadLengthAndGroundAreRepeatedToo) {
  const Lived first = live("", 5, {{2, RunKey::kTap}, {desk().size() - 1, RunKey::kSave}});
  ASSERT_FALSE(first.map.empty());
  RunOptions options;
  Session session = make_session(desk().info, options);
  const fs::path folder = at("recording");
  {
    LiveRecording recording(folder, desk().info, options);
    NotedSystem system(*session.system, &recording);
    ASSERT_TRUE(system.load_map(first.map).ok());
    const auto track = [&](int from, int to) {
      for (int i = from; i < to; ++i) {
        const Frame frame = desk().frame(i);
        system.note_frame(frame, system.track(frame));
        for (int s = 0; s < 7 && session.system->has_work(); ++s) system.work_slice();
      }
    };
    track(40, 60);
    std::vector<MapPointInfo> points(2);
    session.system->map_points(points);
    EXPECT_FALSE(system.set_length(points[0].id, points[0].id, 1).ok());  // refused: not noted
    ASSERT_TRUE(system.set_length(points[0].id, points[1].id, 0.777f).ok());
    track(60, 70);
    EXPECT_FALSE(system.set_ground(Vector2f(-1, 0), nullptr).ok());  // refused: not noted
    ASSERT_TRUE(system.set_ground(Vector2f(120, 160.25f), nullptr).ok());
    track(70, 75);
    recording.finish(map_hash(*session.system));
  }
  EXPECT_TRUE(holds(read(folder / "events.txt"), " 0.777"));
  EXPECT_TRUE(holds(read(folder / "events.txt"), "\nground 120 160.25\n"));
  const RunLog again = repeat(folder);
  EXPECT_EQ(again.differs, "");
  EXPECT_EQ(again.map_hash, map_hash(*session.system));
  EXPECT_EQ(again.frames.size(), 35u);
}

// Cut anywhere: what is whole can be repeated.
TEST_F(Live, ABrokenOffRecordingIsUsable) {
  const fs::path folder = at("recording");
  live(folder, 6, {});
  const std::string events = read(folder / "events.txt");
  std::mt19937 random(6);
  const size_t head = events.find("\nframe");
  for (int round = 0; round < 5; ++round) {
    const size_t bytes = head + 100 + random() % (events.size() - head - 100);
    write(folder / "events.txt", events.substr(0, bytes));
    const LiveScript script = read_live_recording(folder);
    EXPECT_FALSE(script.map_hash.has_value());
    EXPECT_EQ(repeat(folder).differs, "") << bytes;
  }
  write(folder / "events.txt", events);
  fs::remove(folder / "rgb" / (timestamp_name_of(50) + ".pgm"));
  const RunLog log = repeat(folder);
  EXPECT_EQ(log.frames.size(), 50u);
  EXPECT_TRUE(holds(log.broken, timestamp_name_of(50)));
}

// A disk of so many bytes.
class FullDisk : public FileOperations {
 public:
  explicit FullDisk(ssize_t bytes) : left_(bytes) {}
  ssize_t write(int fd, const void* data, size_t bytes) override {
    if (left_ == 0) {
      errno = ENOSPC;
      return -1;
    }
    const ssize_t written = FileOperations::write(fd, data, std::min<size_t>(bytes, static_cast<size_t>(left_)));
    left_ -= written;
    return written;
  }

 private:
  ssize_t left_;
};

TEST_F(Live, AFullDiskLeavesAUsableRecording) {
  RunOptions options;
  for (const ssize_t bytes : {2000, 100'000, 400'000}) {
    const fs::path folder = at("recording" + std::to_string(bytes));
    FullDisk disk(bytes);
    Session session = make_session(desk().info, options);
    LiveRecording recording(folder, desk().info, options, &disk);
    NotedSystem system(*session.system, &recording);
    system.tap();
    for (int i = 0; i < 20; ++i) {
      const Frame frame = desk().frame(i);
      system.note_frame(frame, system.track(frame));
    }
    recording.finish(map_hash(*session.system));
    EXPECT_TRUE(holds(recording.trouble(), "No space left on device")) << recording.trouble();
    const auto images = std::distance(fs::directory_iterator(folder / "rgb"), fs::directory_iterator());
    EXPECT_GE(images, recording.frames());
    EXPECT_LE(images, recording.frames() + 1);  // its line may be what found no room
    EXPECT_EQ(recording.frames(), bytes / 77'000) << bytes;
    if (recording.frames() == 0) continue;
    const RunLog log = repeat(folder);
    EXPECT_EQ(static_cast<int>(log.frames.size()), recording.frames());
    EXPECT_EQ(log.differs, "");
  }
}

TEST_F(Live, AListOfEventsThatIsWrongIsRefused) {
  const fs::path folder = at("recording");
  live(folder, 7, {});
  const std::string events = read(folder / "events.txt");
  const std::string head = events.substr(0, events.find("\nframe") + 1);
  for (const char* line :
       {"frame 1 ../../etc/passwd 0123456789abcdef", "frame 1 rgb/../x.pgm 0123456789abcdef", "frame 1 rgb/1.0.pgm 0",
        "frame x rgb/1.0.pgm 0123456789abcdef", "slices -1", "slices 99999999999", "jump", "tap tap",
        "load /etc/passwd", "length 1 2", "settings 2 0 1 -1 -1", "camera 0 0",
        "camera 240 320 1 1 1 1 none 0 0 0 0 0 rows nan 0 15", "camera 240 320 1 1 1 1 none 0 0 0 0 0 rows 0 0 nan",
        "camera 240 320 1 1 1 1 none 0 0 0 0 0 rows 0 0 inf", "camera 240 320 1 1 1 1 none 0 0 0 0 0 rows 0 0 1e300",
        "slices 9000000\ntap\nslices 9000000", ""}) {
    write(folder / "events.txt", head + line + "\n");
    const std::string message = message_of([&] { repeat(folder); });
    EXPECT_TRUE(holds(message, "events.txt")) << line << ": " << message;
  }
  write(folder / "events.txt", "something else\n");
  EXPECT_TRUE(holds(message_of([&] { read_live_recording(folder); }), "events.txt:1"));
  EXPECT_TRUE(holds(message_of([&] { LiveRecording(folder, desk().info, {}); }), "not an empty folder"));
}

TEST_F(Live, ListsThatWouldTakeAllMemoryAreRefused) {
  const fs::path folder = at("recording");
  live(folder, 9, {{2, RunKey::kTap}});
  const std::string events = read(folder / "events.txt");
  const size_t frame = events.find("\nframe") + 1;
  const auto with = [&](const std::string& line, int times) {
    std::string many = events.substr(0, frame);
    for (int i = 0; i < times; ++i) many += line;
    write(folder / "events.txt", many + events.substr(frame));
    return message_of([&] { read_live_recording(folder); });
  };
  EXPECT_EQ(with("tap\n", LiveRecording::kMaxCalls - 1), "");  // and the one that is there
  EXPECT_TRUE(holds(with("tap\n", LiveRecording::kMaxCalls), "calls"));
  EXPECT_EQ(with("slices 1\n", 1'000'000), "");
  EXPECT_LT(read_live_recording(folder).events.size(), 1000u);
  EXPECT_TRUE(holds(with("slices 5000001\n", 2), "too many slices"));
}

// Its image is smaller than the camera's: nothing may read beyond it.
TEST_F(Live, AnImageOfAnotherSizeEndsTheRepetition) {
  const fs::path folder = at("recording");
  live(folder, 10, {});
  write(folder / "rgb" / (timestamp_name_of(30) + ".pgm"), "P5\n64 64\n255\n" + std::string(64 * 64, 'x'));
  int seen = 0;
  const RunLog log = repeat_live_recording(
      read_live_recording(folder), {}, [](const CameraInfo&) {},
      [&](const Frame& frame, const TrackResult&, const RunLog&) {
        EXPECT_EQ(frame.width, desk().info.model.width);
        ++seen;
      });
  EXPECT_EQ(seen, 30);
  EXPECT_EQ(log.frames.size(), 30u);
  EXPECT_TRUE(holds(log.broken, timestamp_name_of(30)) && holds(log.broken, "was refused")) << log.broken;
}

TEST_F(Live, ARecordingEndsBeforeItIsTooLongToBeRead) {
  Session session = make_session(desk().info, {});
  {
    LiveRecording recording(at("bytes"), desk().info, {}, nullptr, 1500);
    NotedSystem system(*session.system, &recording);
    for (int i = 0; i < 30; ++i) {
      const Frame frame = desk().frame(i);
      system.note_frame(frame, system.track(frame));
    }
    recording.finish(0);
    EXPECT_TRUE(holds(recording.trouble(), "as long as replay takes it")) << recording.trouble();
    EXPECT_GT(recording.frames(), 5);
    EXPECT_LT(recording.frames(), 30);
    EXPECT_LE(fs::file_size(at("bytes/events.txt")), 1500u);
    EXPECT_EQ(static_cast<int>(repeat(at("bytes")).frames.size()), recording.frames());
  }
  LiveRecording recording(at("calls"), desk().info, {});
  const TrackResult result;
  recording.note_frame(desk().frame(0), result);
  for (int i = 0; i <= LiveRecording::kMaxCalls; ++i) recording.note("tap");
  EXPECT_TRUE(holds(recording.trouble(), "keys")) << recording.trouble();
  recording.note_frame(desk().frame(1), result);
  EXPECT_EQ(recording.frames(), 1);
  EXPECT_EQ(read_live_recording(at("calls")).camera.frame_count, 1);
}

TEST_F(Live, SomebodyElsesEventsAreNoLiveRecording) {
  live(at("recording"), 11, {});
  EXPECT_TRUE(is_live_recording(at("recording")));
  fs::create_directory(at("theirs"));
  EXPECT_FALSE(is_live_recording(at("theirs")));
  write(at("theirs/events.txt"), "");
  EXPECT_FALSE(is_live_recording(at("theirs")));
  write(at("theirs/events.txt"), "0.001 12 34 1\n0.002 12 35 0\n0.003 12 36 0\n");
  EXPECT_FALSE(is_live_recording(at("theirs")));
  write(at("theirs/events.txt"), "pocket-ptam live recording 2\n");  // a later version's, which is told
  EXPECT_TRUE(is_live_recording(at("theirs")));
}

// A disk that is full at once, a map of another camera, and poses that cannot be written: nothing is left of it.
TEST_F(Live, AStartThatFailsLeavesNoRecording) {
  FullDisk disk(10);
  EXPECT_TRUE(holds(message_of([&] { LiveRecording(at("full"), desk().info, {}, &disk); }), "No space left"));
  EXPECT_FALSE(fs::exists(at("full")));
  fs::create_directory(at("there"));
  EXPECT_NE(message_of([&] { LiveRecording(at("there"), desk().info, {}, &disk); }), "");
  EXPECT_TRUE(fs::is_empty(at("there")));

  LiveOptions options;
  options.record = (at("record") / "above" / "it").string();
  LiveObserver observer;
  observer.on_start = [](const CameraInfo&) { throw InputError("no place for poses"); };
  HastyCamera camera(desk(), 12);
  EXPECT_EQ(message_of([&] { run_live(camera, options, observer); }), "no place for poses");
  EXPECT_FALSE(fs::exists(at("record")));

  const Lived lived = live("", 12, {{2, RunKey::kTap}, {desk().size() - 1, RunKey::kSave}});
  ASSERT_FALSE(lived.map.empty());
  write(at("desk.map"), {reinterpret_cast<const char*>(lived.map.data()), lived.map.size()});
  test::Recording other = test::part_of(desk(), 0, 5);
  other.info.model.fx *= 1.5f;
  other.info.model.prepare();
  HastyCamera another(other, 12);
  options.run.load_map = at("desk.map").string();
  observer.on_start = [](const CameraInfo&) {};
  EXPECT_TRUE(holds(message_of([&] { run_live(another, options, observer); }), "desk.map"));
  EXPECT_FALSE(fs::exists(at("record")));
}

TEST_F(Live, ADurationEndsItWhileTheCameraIsGone) {
  HastyCamera camera(desk(), 13);
  camera.pull_out_before = 5;
  camera.stays_away = true;
  LiveOptions options;
  options.duration_s = 0.5;
  LiveObserver observer;
  observer.on_start = [](const CameraInfo&) {};
  const int64_t from_ns = SteadyClock().now_ns();
  const LiveResult result = run_live(camera, options, observer);
  EXPECT_TRUE(result.status.camera_gone);
  EXPECT_EQ(result.status.frames, 5);
  EXPECT_GE(SteadyClock().now_ns() - from_ns, 500'000'000);
}

TEST_F(Live, ACameraThatIsPulledOutIsWaitedFor) {
  const Lived lived = live(at("recording"), 8, {{2, RunKey::kTap}}, 50);
  EXPECT_EQ(lived.result.log.frames.size(), static_cast<size_t>(desk().size()));
  std::string said;
  for (const std::string& line : lived.said) said += line + "\n";
  EXPECT_TRUE(holds(said, "hasty: pulled out; waiting")) << said;
  EXPECT_TRUE(holds(said, "is back")) << said;
  expect_same(lived.result.log, repeat(at("recording")));
}

// What came while the system was built is passed over, but not every frame of a camera whose stamps are late. With one
// frame a second a pause of this busy computer makes none stale.
TEST_F(Live, TheFirstFrameTrackedIsFresh) {
  test::Recording slow = test::part_of(desk(), 0, 20);
  slow.info.frames_per_s = 1;
  for (const auto& [stale, skipped] : {std::pair(3, 3), std::pair(1000, 8)}) {
    HastyCamera camera(slow, 1);
    camera.stale = stale;
    LiveObserver observer;
    observer.on_start = [](const CameraInfo&) {};
    LiveOptions options;
    options.keep_frames = true;
    const LiveResult result = run_live(camera, options, observer);
    ASSERT_FALSE(result.log.frames.empty());
    EXPECT_EQ(result.log.frames.front().timestamp_ns, slow.timestamps_ns[static_cast<size_t>(skipped)]);
    EXPECT_EQ(result.status.stale, skipped);
    EXPECT_EQ(result.log.dropped, skipped);
    EXPECT_EQ(result.log.source_frames, slow.size());
  }
}

TEST_F(Live, ALengthBetweenTwoMarksIsSetAndRecorded) {
  sim::PhoneOptions phone;
  phone.duration_s = 9;
  const test::Recording longer = test::record(phone);
  for (const double length : {0.0, 0.297}) {
    HastyCamera camera(longer, 7);
    LiveOptions options;
    options.length = length;
    options.keep_frames = true;
    options.record = at("record" + std::to_string(length)).string();
    std::vector<std::string> said;
    int pressed = -1;
    LiveObserver observer;
    observer.on_start = [](const CameraInfo&) {};
    observer.say = [&](const std::string& text) { said.push_back(text); };
    observer.key = [&] {
      if (std::exchange(pressed, camera.next()) == camera.next()) return RunKey::kNothing;
      return camera.next() == 2 ? RunKey::kTap : camera.next() >= 50 ? RunKey::kMark : RunKey::kNothing;
    };
    const RunLog log = run_live(camera, options, observer).log;
    const std::string all = std::accumulate(said.begin(), said.end(), std::string());
    SCOPED_TRACE(all);
    if (length == 0) {
      EXPECT_TRUE(holds(all, "no length was given"));
      continue;
    }
    EXPECT_TRUE(holds(all, "one end is marked"));
    EXPECT_TRUE(holds(all, "this end is marked already"));
    EXPECT_TRUE(holds(all, "the two marks are 0.297 apart from now on"));
    EXPECT_TRUE(holds(read(fs::path(options.record) / "events.txt"), "\nlength "));
    expect_same(log, repeat(options.record));
  }
}

// Once its map is forgotten, or its camera is gone, nothing is aimed at.
TEST_F(Live, NoPointIsMarkedThatIsNotSeen) {
  for (const bool unplugged : {false, true}) {
    HastyCamera camera(desk(), 7);
    LiveOptions options;
    options.length = 0.297;
    std::vector<std::string> said;
    bool tapped = false, marked = false, gone = false, over = false;
    LiveObserver observer;
    observer.on_start = [](const CameraInfo&) {};
    observer.say = [&](const std::string& text) {
      said.push_back(text);
      marked = holds(text, "one end is marked");
      if (marked && unplugged) camera.pull_out_before = camera.next();
      gone = gone || holds(text, "reset:") || holds(text, "waiting");
    };
    observer.key = [&] {
      if (over || camera.next() < 2) return RunKey::kNothing;
      if (!std::exchange(tapped, true)) return RunKey::kTap;
      if (gone) {
        over = true;
        return RunKey::kMark;
      }
      if (camera.next() < 50 || (unplugged && marked)) return RunKey::kNothing;
      return marked ? RunKey::kReset : RunKey::kMark;
    };
    run_live(camera, options, observer);
    const std::string all = std::accumulate(said.begin(), said.end(), std::string());
    SCOPED_TRACE(all);
    EXPECT_TRUE(gone && over && holds(all, "one end is marked"));
    const auto last = std::find_if(said.rbegin(), said.rend(), [](const auto& text) { return holds(text, "marked"); });
    ASSERT_NE(last, said.rend());
    EXPECT_TRUE(holds(*last, "no point of the map"));
  }
}

// One slice before each frame, and no more.
TEST_F(Live, MappingGoesOnWithoutAnyIdleTime) {
  HastyCamera camera(desk(), 1);
  camera.always = true;
  LiveObserver observer;
  observer.on_start = [](const CameraInfo&) {};
  LiveOptions options;
  options.run.auto_start = true;
  options.keep_frames = true;
  const LiveResult result = run_live(camera, options, observer);
  int slices = 0;
  for (const FrameLog& frame : result.log.frames) {
    EXPECT_LE(frame.idle_slices, 1);
    slices += frame.idle_slices;
  }
  EXPECT_GT(slices, 20);
}

// What `live --out` looks at when it ends: the points' tracks against the camera that it was told of.
TEST_F(Live, AWrongCameraIsDoubted) {
  sim::PhoneOptions phone;
  phone.duration_s = 12;
  test::Recording recording = test::record(phone);
  const float true_focal = recording.info.model.fx;
  for (const float told : {1.0f, 0.7f}) {
    recording.info.model.fx = recording.info.model.fy = told * true_focal;
    HastyCamera camera(recording, 1);
    PointTracks tracks;
    LiveObserver observer;
    observer.on_start = [](const CameraInfo&) {};
    observer.on_result = [&](const TrackResult& result, int64_t) {
      tracks.add(result);
      return true;
    };
    LiveOptions options;
    options.run.auto_start = true;
    const RunLog log = run_live(camera, options, observer).log;
    tracks.finish(log.map_points);
    const CameraDoubts doubts = doubt_camera(tracks, log.camera.model, log.camera.shutter);
    EXPECT_GT(tracks.views.size(), 100u);
    EXPECT_EQ(doubts.focal, told != 1) << told;
    if (doubts.focal) {
      EXPECT_NEAR(told * doubts.fit.focal.value, 1, 0.05);
    }
  }
}

TEST(AgesOfPoses, Shares) {
  Ages ages;
  EXPECT_EQ(ages.at_ms(0.5), 0);
  for (int ms = 1; ms <= 100; ++ms) ages.add(ms * 1'000'000LL);
  EXPECT_NEAR(ages.at_ms(0.5), 50, 1);
  EXPECT_NEAR(ages.at_ms(0.95), 95, 1);
  EXPECT_EQ(ages.worst_ms(), 100);
  ages.add(5'000'000'000);
  EXPECT_EQ(ages.worst_ms(), 5000);
}

// ---- Pose lines --------------------------------------------------------------------------------------------------

TrackResult a_pose() {
  TrackResult result;
  result.timestamp_ns = 12'345'678'901;
  result.state = TrackingState::kTracking;
  result.quality = TrackingQuality::kGood;
  result.pose_valid = true;
  result.T_cw.t = {-1, -2, -3};  // no rotation: the camera is at 1, 2, 3
  return result;
}

TEST(PoseLinesOf, TumAndJson) {
  EXPECT_EQ(tum_line(a_pose()), "12.345678901 1 2 3 0 0 0 1\n");
  EXPECT_EQ(
      json_line(a_pose(), 4'560'000),
      "{\"t\":12.345678901,\"state\":\"tracking\",\"quality\":\"good\",\"p\":[1,2,3],\"q\":[0,0,0,1],\"points\":0,"
      "\"keyframes\":0,\"age_ms\":4.56}\n");
  TrackResult lost = a_pose();
  lost.state = TrackingState::kLost;
  lost.pose_valid = false;
  EXPECT_EQ(tum_line(lost), "");
  EXPECT_FALSE(holds(json_line(lost, -1), "\"p\""));
}

// A pose in another map is in another world: the lines say so.
TEST(PoseLinesOf, AnotherMapIsTold) {
  int ends[2] = {};
  ASSERT_EQ(::pipe(ends), 0);
  {
    const auto lines = PoseLines::to_descriptor(PoseFormat::kTum, ends[1]);
    for (const int map : {1, 1, 2, 1}) {
      TrackResult result = a_pose();
      result.map = map;
      EXPECT_TRUE(lines->add(result, 0));
    }
  }
  char text[1024] = {};
  ASSERT_GT(::read(ends[0], text, sizeof text - 1), 0);
  ::close(ends[0]);
  const std::string line = tum_line(a_pose());
  EXPECT_EQ(std::string(text), line + line + "# map 2\n" + line + "# map 1\n" + line);
  TrackResult second = a_pose();
  second.map = 2;
  EXPECT_TRUE(holds(json_line(second, -1), "\"map\":2"));
}

TEST_F(Live, UdpGoesToThisComputerOnly) {
  const int receiver = ::socket(AF_INET, SOCK_DGRAM, 0);
  sockaddr_in address = {};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_ANY);
  ASSERT_EQ(::bind(receiver, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
  socklen_t length = sizeof address;
  ASSERT_EQ(::getsockname(receiver, reinterpret_cast<sockaddr*>(&address), &length), 0);
  const auto lines = PoseLines::to_udp(PoseFormat::kTum, ntohs(address.sin_port));
  EXPECT_TRUE(lines->add(a_pose(), 0));
  char text[256] = {};
  sockaddr_in from = {};
  length = sizeof from;
  ASSERT_GT(::recvfrom(receiver, text, sizeof text - 1, 0, reinterpret_cast<sockaddr*>(&from), &length), 0);
  EXPECT_EQ(std::string(text), tum_line(a_pose()));
  EXPECT_EQ(ntohl(from.sin_addr.s_addr), INADDR_LOOPBACK);
  ::close(receiver);
  for (int i = 0; i < 5; ++i) EXPECT_TRUE(lines->add(a_pose(), 0));  // nobody listens: no error
}

TEST_F(Live, AReaderMayBeSlowLateOrGone) {
  int ends[2] = {};
  ASSERT_EQ(::pipe(ends), 0);
  {
    const auto lines = PoseLines::to_descriptor(PoseFormat::kTum, ends[1]);
    for (int i = 0; i < 10'000; ++i) ASSERT_TRUE(lines->add(a_pose(), 0));  // 300 kB, five times what a pipe holds
    EXPECT_GT(lines->left_out(), 1000);
    ::close(ends[0]);
    ::signal(SIGPIPE, SIG_IGN);
    EXPECT_FALSE(lines->add(a_pose(), 0));
    EXPECT_TRUE(holds(lines->trouble(), "nobody reads"));
  }
  write(at("there.txt"), "mine");
  EXPECT_TRUE(holds(message_of([&] { PoseLines::to_file(PoseFormat::kTum, at("there.txt")); }), "exists"));
  EXPECT_EQ(read(at("there.txt")), "mine");

  ASSERT_EQ(::mkfifo(at("pipe").c_str(), 0600), 0);
  const auto lines = PoseLines::to_file(PoseFormat::kTum, at("pipe"));
  EXPECT_TRUE(lines->add(a_pose(), 0));  // nobody yet
  for (int reader = 0; reader < 2; ++reader) {
    const int fd = ::open(at("pipe").c_str(), O_RDONLY | O_NONBLOCK);
    EXPECT_TRUE(lines->add(a_pose(), 0));
    char text[256] = {};
    EXPECT_EQ(::read(fd, text, sizeof text - 1), static_cast<ssize_t>(tum_line(a_pose()).size()));
    ::close(fd);
    EXPECT_TRUE(lines->add(a_pose(), 0));  // gone again
  }
  EXPECT_EQ(lines->left_out(), 3);
  fs::remove(at("pipe"));  // while nobody reads, somebody's file comes there
  write(at("pipe"), "mine");
  EXPECT_FALSE(lines->add(a_pose(), 0));
  EXPECT_TRUE(holds(lines->trouble(), "no named pipe"));
  EXPECT_EQ(read(at("pipe")), "mine");
}

// ---- The program -------------------------------------------------------------------------------------------------

const std::string kProgram = "'" PPTAM_PROGRAM "'";

TEST_F(Live, TheProgramRecordsAndRepeatsByTheRealClock) {
  EXPECT_EQ(
      code_of(kProgram + " live --camera sim:desk --duration 3 --record desk --poses json --to poses.json --save-map "
                         "desk.map </dev/null 2>said.txt"),
      0)
      << read(at("said.txt"));
  EXPECT_TRUE(holds(read(at("poses.json")), "\"age_ms\":"));
  EXPECT_TRUE(holds(read(at("said.txt")), "age of a pose")) << read(at("said.txt"));
  EXPECT_EQ(code_of(kProgram + " replay desk --out out --no-overlay --no-report --save-map again.map >said.txt 2>&1"),
            0)
      << read(at("said.txt"));
  EXPECT_TRUE(holds(read(at("said.txt")), "the same bits as in the live run"));
  EXPECT_EQ(read(at("desk.map")), read(at("again.map")));
  // Other options do not go with it, but for the images alone.
  EXPECT_EQ(code_of(kProgram + " replay desk --tap 1 --out out2 2>said.txt"), 2);
  EXPECT_TRUE(holds(read(at("said.txt")), "--images-only"));
  EXPECT_EQ(code_of(kProgram + " replay desk --images-only --calibration desk/calibration.yaml --out out3 --no-overlay "
                               "--no-report >said.txt 2>&1"),
            0)
      << read(at("said.txt"));
}

TEST_F(Live, KeysThroughAPipeAndSignalsEndItCleanly) {
  EXPECT_EQ(code_of("{ sleep 1; printf xt; sleep 0.3; printf lq; } | " + kProgram +
                    " live --camera sim:desk --no-auto-start >poses.txt 2>said.txt"),
            0);
  const std::string said = read(at("said.txt"));
  EXPECT_TRUE(holds(said, "tap:") && holds(said, "the map is locked")) << said;
  for (const char* signal : {"TERM"}) {
    EXPECT_EQ(code_of(kProgram + " live --camera sim:desk --record r" + signal +
                      " >poses.txt 2>said.txt </dev/null & "
                      "p=$!; for i in $(seq 300); do grep -q hold said.txt && break; sleep 0.1; done; kill -" +
                      signal + " $p; wait $p"),
              0)
        << read(at("said.txt"));
    EXPECT_TRUE(holds(read(at("said.txt")), std::string("stopped by SIG") + signal)) << read(at("said.txt"));
    EXPECT_EQ(code_of(kProgram + " replay r" + signal + " --out out --no-overlay --no-report >said.txt 2>&1"), 0)
        << read(at("said.txt"));
  }
  // A reader that has seen enough ends it.
  EXPECT_EQ(code_of(kProgram + " live --camera sim:desk --poses json 2>said.txt </dev/null | head -n 3 >poses.txt"), 0);
  EXPECT_EQ(code_of("wc -l <poses.txt | grep -qx 3"), 0);
}

TEST_F(Live, SaysWhatIsMissing) {
  const auto said = [&](const std::string& arguments, int code) {
    EXPECT_EQ(code_of(kProgram + " " + arguments + " >/dev/null 2>said.txt </dev/null"), code) << arguments;
    return read(at("said.txt"));
  };
  EXPECT_TRUE(holds(said("live --camera /dev/video987 --fov 60", 2), "pocket-ptam cameras lists"));
  EXPECT_TRUE(holds(said("live --camera /dev/null --fov 60", 2), "is not a Video4Linux device"));
  EXPECT_TRUE(holds(said("live --camera sim:desk --fov 60", 2), "knows its lens"));
  EXPECT_TRUE(holds(said("live --camera sim:nowhere", 2), "scene 'nowhere' is unknown"));
  EXPECT_TRUE(holds(said("live --camera sim:desk --udp 5005 --to x", 2), "choose one"));
  EXPECT_TRUE(holds(said("live --camera sim:desk --to nowhere/x --record r", 2), "there is no folder nowhere"));
  EXPECT_TRUE(holds(said("live --camera sim:desk --to x --save-map ./x", 2), "is where --to writes"));
  for (const char* map : {"r", "./r/", "r/events.txt"})
    EXPECT_TRUE(holds(said(std::string("live --camera sim:desk --record r --save-map ") + map, 2), "--record")) << map;
  EXPECT_FALSE(fs::exists(at("r")) || fs::exists(at("x")));
  // Ended before there is a map: that is no failure.
  EXPECT_TRUE(holds(said("live --camera sim:desk --duration 0.1 --save-map early.map", 0), "nothing is saved"));
  EXPECT_FALSE(fs::exists(at("early.map")));
  write(at("mine.txt"), "mine");
  EXPECT_TRUE(holds(said("live --camera sim:desk --to mine.txt", 2), "exists"));
  EXPECT_TRUE(holds(said("live --camera sim:desk --save-map mine.txt", 2), "mine.txt"));
  fs::create_directory(at("full"));
  write(at("full/file"), "");
  EXPECT_TRUE(holds(said("live --camera sim:desk --record full", 2), "not an empty folder"));
  EXPECT_EQ(read(at("mine.txt")), "mine");
}

}  // namespace
}  // namespace pptam::platform
