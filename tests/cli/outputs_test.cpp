// Nothing of the user's is lost: what is an input or was not made by the program is no output, results are whole when a
// signal, a full disk or a closed stream comes between; the reason reaches the user in words that a terminal can bear.
#include "platform/outputs.h"

#include <elf.h>
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstring>
#include <fstream>
#include <functional>
#include <iterator>
#include <map>
#include <span>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "platform/camera.h"
#include "platform/run/console.h"
#include "platform/run/html.h"
#include "platform/run/run.h"
#include "platform/run/summary.h"
#include "tests/support/scratch_folder.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;

bool holds(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

std::string message_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

struct Answered {
  int code = -1;
  std::string out, err;
};

class Outputs : public ::testing::Test {
 protected:
  fs::path at(const std::string& name) const { return folder_ / name; }
  std::string read(const std::string& name) const {
    std::ifstream stream(at(name), std::ios::binary);
    return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
  }
  void write(const std::string& name, const std::string& content) const {
    fs::create_directories(at(name).parent_path());
    std::ofstream(at(name), std::ios::binary) << content;
  }
  // Every file's and link's content, by name.
  std::map<std::string, std::string> tree() const {
    std::map<std::string, std::string> all;
    for (const auto& entry : fs::recursive_directory_iterator(folder_)) {
      const std::string name = entry.path().lexically_relative(folder_).string();
      if (entry.is_symlink()) all[name] = "-> " + fs::read_symlink(entry.path()).string();
      if (!entry.is_symlink() && entry.is_regular_file()) all[name] = read(name);
    }
    return all;
  }
  bool drafts_left() const {
    for (const auto& [name, content] : tree()) {
      if (holds(name, ".tmp")) return true;
    }
    return false;
  }

  std::string shell(const std::string& arguments) const {
    return "cd '" + folder_.string() + "' && '" PPTAM_PROGRAM "' " + arguments;
  }
  Answered run(const std::string& arguments) const {
    const std::string said = folder_.string() + ".said";
    const int status = std::system((shell(arguments) + " >'" + said + ".out' 2>'" + said + ".err'").c_str());
    Answered answer;
    answer.code = WIFEXITED(status) ? WEXITSTATUS(status) : 128;
    for (const auto& [end, text] : {std::pair(".out", &answer.out), std::pair(".err", &answer.err)}) {
      std::ifstream stream(said + end, std::ios::binary);
      text->assign(std::istreambuf_iterator<char>(stream), {});
      fs::remove(said + end);
    }
    return answer;
  }
  // Started without a shell, its words separated by blanks.
  pid_t start(const std::string& arguments) const {
    const pid_t child = ::fork();
    if (child != 0) return child;
    std::vector<std::string> words = {PPTAM_PROGRAM};
    std::istringstream stream(arguments);
    for (std::string word; stream >> word;) words.push_back(word);
    std::vector<char*> argv;
    for (std::string& word : words) argv.push_back(word.data());
    argv.push_back(nullptr);
    const int nowhere = ::open("/dev/null", O_RDWR);
    for (const int fd : {0, 1, 2}) ::dup2(nowhere, fd);
    if (::chdir(folder_.c_str()) == 0) ::execv(argv[0], argv.data());
    ::_exit(99);
  }

  const test::ScratchFolder scratch_;
  const fs::path& folder_ = scratch_.path();
};

// A second between frames: with the steady clock the program sleeps most of the time.
const std::string kSlow = "replay slow.txt --fov 50 --clock steady ";
std::string slow_list() {
  std::string list;
  for (int i = 0; i < 100; ++i) list += std::to_string(i) + " frame.pgm\n";
  return list;
}
const std::string kImage = "P5 160 120 255\n" + std::string(160 * 120, 'x');

const std::string kTruth = "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n2 1 1 0 0 0 0 1\n3 1 1 1 0 0 0 1\n4 2 1 1 0 0 0 1\n";

// ---- The parts ---------------------------------------------------------------------------------------------------

TEST_F(Outputs, AnInputIsNoOutputThroughLinksToo) {
  write("a/clip.mp4", "clip");
  fs::create_hard_link(at("a/clip.mp4"), at("hard.mp4"));
  fs::create_symlink("a", at("linked"));
  fs::create_symlink("a/clip.mp4", at("soft.mp4"));
  write("copy.mp4", "clip");
  Inputs inputs;
  inputs.add("the recording", at("a/clip.mp4"));
  inputs.add("nothing", "");
  for (const char* name : {"a/clip.mp4", "hard.mp4", "soft.mp4", "linked/clip.mp4", "a/../a/./clip.mp4"}) {
    const std::string message = message_of([&] { inputs.refuse("--ply x", at(name)); });
    EXPECT_TRUE(holds(message, "--ply x") && holds(message, "the recording") && holds(message, "a/clip.mp4")) << name;
  }
  for (const char* same : {"a", "a/", "linked", "linked/."}) EXPECT_TRUE(same_place(at(same), at("a"))) << same;
  for (const char* same : {"n", "n/", "a/../n"})
    EXPECT_TRUE(same_place(at(same), at("n"))) << "not there yet: " << same;
  EXPECT_FALSE(same_place(at("n"), at("a")) || same_place(at("n"), at("a/n")));
  for (const char* name : {"copy.mp4", "new.mp4", "a/new.mp4"})
    EXPECT_EQ(message_of([&] { inputs.refuse("--ply x", at(name)); }), "") << name;
}

TEST_F(Outputs, AFolderKnowsWhatAnEarlierRunMadeThere) {
  const std::vector<std::string> names = {"a.txt", "b.txt", "sub/c.txt"};
  const auto open = [&] { return OutputFolder(at("o"), "--out", names, {}); };
  const auto refusal = [&] { return message_of(open); };
  {
    OutputFolder folder = open();
    EXPECT_FALSE(fs::exists(at("o"))) << "only looked at";
    folder.prepare();
    for (const std::string& name : names) folder.write(name, "first " + name);
    folder.finish();
    EXPECT_EQ(folder.written(), names);
  }
  write("o/mine.txt", "mine");
  {  // again: replaced, and what is not made again goes
    OutputFolder folder = open();
    folder.prepare();
    folder.write("a.txt", "second");
    folder.finish();
  }
  EXPECT_EQ(read("o/a.txt"), "second");
  EXPECT_FALSE(fs::exists(at("o/b.txt")));
  EXPECT_FALSE(fs::exists(at("o/sub/c.txt")));
  EXPECT_EQ(read("o/mine.txt"), "mine");
  EXPECT_FALSE(drafts_left());

  // What is the user's: something else, ours but changed, a link, a folder.
  write("o/b.txt", "first b.txt");
  EXPECT_TRUE(holds(refusal(), "o/b.txt")) << "the list has forgotten what was removed";
  fs::remove(at("o/b.txt"));
  EXPECT_EQ(refusal(), "");
  fs::create_symlink("a.txt", at("o/b.txt"));
  EXPECT_TRUE(holds(refusal(), "o/b.txt"));
  fs::remove(at("o/b.txt"));
  fs::create_symlink("nowhere", at("o/b.txt"));
  EXPECT_TRUE(holds(refusal(), "o/b.txt"));
  fs::remove(at("o/b.txt"));
  fs::create_directory(at("o/b.txt"));
  EXPECT_TRUE(holds(refusal(), "o/b.txt"));
  fs::remove(at("o/b.txt"));
  write("o/a.txt", "seconD");
  EXPECT_TRUE(holds(refusal(), "o/a.txt"));
  write("o/a.txt", "second");
  EXPECT_EQ(refusal(), "");

  // The list itself.
  const std::string list = read(std::string("o/") + OutputFolder::kListName);
  for (const std::string& bad : {std::string("my notes\n"), std::string(), list + "no line\n", list.substr(0, 20)}) {
    write(std::string("o/") + OutputFolder::kListName, bad);
    EXPECT_TRUE(holds(refusal(), OutputFolder::kListName)) << bad;
    EXPECT_EQ(read(std::string("o/") + OutputFolder::kListName), bad);
  }
  write("file", "x");
  EXPECT_TRUE(holds(message_of([&] { OutputFolder(at("file"), "--out", names, {}); }), "not a folder"));
}

TEST_F(Outputs, NamesThatVaryAreClearedBelowTheirFolder) {
  const auto run = [&](const std::vector<std::string>& names) {
    OutputFolder folder(at("o"), "--out", names, {});
    folder.prepare();
    for (const std::string& name : names) folder.write(name, "first " + name);
    folder.finish("images/");
  };
  run({"a.txt", "images/1.png", "images/2.png", "images/3.png", "other/1.png"});
  write("images/9.png", "mine");
  write("o/images/3.png", "changed by the user");
  run({"a.txt", "images/1.png"});
  EXPECT_TRUE(fs::exists(at("o/images/1.png")));
  EXPECT_FALSE(fs::exists(at("o/images/2.png"))) << "an earlier run's";
  EXPECT_EQ(read("o/images/3.png"), "changed by the user");
  EXPECT_TRUE(fs::exists(at("o/other/1.png"))) << "perhaps another command's";
  // A list that names what lies elsewhere has no say there.
  std::ofstream(at("o") / OutputFolder::kListName, std::ios::app) << "0 0 images/../../images/9.png\n";
  run({"a.txt"});
  EXPECT_EQ(read("images/9.png"), "mine");
}

TEST_F(Outputs, WhatAppearsDuringARunStays) {
  OutputFolder folder(at("o"), "--out", {"a.txt", "b.txt"}, {});
  folder.prepare();
  write("o/a.txt", "mine");
  EXPECT_TRUE(holds(message_of([&] { folder.write("a.txt", "ours"); }), "o/a.txt"));
  folder.write("b.txt", "ours");
  folder.finish();
  EXPECT_EQ(read("o/a.txt"), "mine");
  EXPECT_EQ(read("o/b.txt"), "ours");
  EXPECT_EQ(folder.written(), std::vector<std::string>{"b.txt"});
  EXPECT_FALSE(drafts_left());
}

// A process that is killed between the list and the file, or after the file: the next run may replace either.
TEST_F(Outputs, AKilledRunDoesNotBarTheNext) {
  OutputFolder(at("o"), "--out", {"a.txt"}, {}).prepare();
  for (int nth = 0; nth < 2; ++nth) {
    OutputFolder folder(at("o"), "--out", {"a.txt"}, {});
    folder.write("a.txt", "old");  // no finish()
    const std::string before = read("o/a.txt");
    OutputFolder again(at("o"), "--out", {"a.txt"}, {});
    again.write("a.txt", "new");
    if (nth == 1) write("o/a.txt", before);  // as if the rename had not been done
    EXPECT_EQ(message_of([&] { OutputFolder(at("o"), "--out", {"a.txt"}, {}); }), "");
  }
}

TEST_F(Outputs, AFolderThatCannotBeMadeLeavesNothing) {
  write("file", "x");
  const OutputFolder below(at("new/deeper/o"), "--out", {"a.txt", "../../../file/c.txt"}, {});
  EXPECT_NE(message_of([&] { below.prepare(); }), "");
  EXPECT_FALSE(fs::exists(at("new")));
  EXPECT_NE(message_of([&] { OutputFolder("/proc/pptam", "--out", {"a.txt"}, {}).prepare(); }), "");
}

TEST_F(Outputs, ASingleFileIsKnownByItsSeal) {
  const std::string text = sealed("# " + std::string(kOpenSeal) + "\n1 2 3\n");
  const auto sound = [](const std::string& content) { return is_sealed(std::as_bytes(std::span(content))); };
  EXPECT_FALSE(holds(text, std::string(kOpenSeal)));
  EXPECT_TRUE(sound(text));
  for (size_t i = 0; i < text.size(); ++i) {
    std::string changed = text;
    changed[i] = static_cast<char>(changed[i] ^ 1);
    EXPECT_FALSE(sound(changed)) << i;
  }
  EXPECT_FALSE(sound(text + "4 5 6\n"));
  EXPECT_FALSE(sound(text.substr(0, text.size() - 1)));
  EXPECT_FALSE(sound("") || sound("1 2 3\n") || sound(std::string(kOpenSeal)) || sound(std::string(kOpenSeal, 0, 25)));

  const auto refusal = [&](const std::string& name) {
    return message_of([&] { check_output_file("--plot", at(name), {}, "a plot", is_sealed); });
  };
  write("ours.svg", text);
  write("mine.svg", "<svg/>");
  fs::create_symlink("ours.svg", at("to_ours.svg"));
  fs::create_symlink("mine.svg", at("to_mine.svg"));
  fs::create_symlink("nowhere.svg", at("to_nothing.svg"));
  const auto before = tree();
  for (const char* name : {"ours.svg", "new.svg", "to_ours.svg"}) EXPECT_EQ(refusal(name), "") << name;
  for (const char* name : {"mine.svg", "to_mine.svg", "to_nothing.svg", "missing/new.svg", "."})
    EXPECT_TRUE(holds(refusal(name), "--plot")) << name;
  EXPECT_NE(message_of([] { check_output_file("--plot", "/dev/full", {}, "a plot", is_sealed); }), "");
  EXPECT_NE(message_of([] { check_output_file("--plot", "/proc/new.svg", {}, "a plot", is_sealed); }), "");
  EXPECT_TRUE(tree() == before);
}

TEST(Printable, NothingThatATerminalObeysGoesThrough) {
  EXPECT_EQ(printable("plain, Größe 5 µm, 日本, 🙂"), "plain, Größe 5 µm, 日本, 🙂");
  EXPECT_EQ(printable("two\nlines\tand\r"), "two lines and");
  EXPECT_EQ(printable("\x1b[31mred\x07"), "\\x1b[31mred\\x07");
  EXPECT_EQ(printable(std::string("a\0b\x7f", 4)), "a\\x00b\\x7f");
  EXPECT_EQ(printable("\xc2\x9b"
                      "31m"),
            "\\u009b31m")
      << "C1";
  EXPECT_EQ(printable("\xe2\x80\xae"
                      "4pm\xe2\x81\xa6\xe2\x80\xa8"),
            "\\u202e4pm\\u2066\\u2028")
      << "directions, lines";
  // No UTF-8: a bare C1, a cut character, over-long forms, surrogates, beyond the last.
  EXPECT_EQ(printable("\x9b"
                      "31m \xe2\x82"),
            "\\x9b31m \\xe2\\x82");
  EXPECT_EQ(printable("\xc0\x9b \xe0\x80\x9b \xed\xa0\x80"), "\\xc0\\x9b \\xe0\\x80\\x9b \\xed\\xa0\\x80");
  EXPECT_EQ(printable("\xf4\x90\x80\x80"), "\\xf4\\x90\\x80\\x80");
  EXPECT_EQ(html_escaped("<a href='\"'>&\x1b"), "&lt;a href=&#39;&quot;&#39;&gt;&amp;\\x1b");
}

// ---- Why there is no map, and pauses -----------------------------------------------------------------------------

RunLog log_with(const std::vector<std::pair<int, Hint>>& stretches, bool pose) {
  RunLog log;
  for (const auto& [frames, hint] : stretches) {
    for (int i = 0; i < frames; ++i) {
      FrameLog frame;
      frame.timestamp_ns = static_cast<int64_t>(log.frames.size()) * 100'000'000;
      frame.hint = hint;
      frame.pose_valid = pose && hint == Hint::kNone;
      log.frames.push_back(frame);
    }
  }
  return log;
}

std::string rows_of(const RunLog& log, const RunSummary& summary) {
  std::string text;
  for (const SummaryRow& row : summarise(log, summary)) text += row.label + "|" + row.value + "\n";
  return text;
}

TEST(Reasons, AreCountedOverTheRun) {
  const std::string never =
      rows_of(log_with({{81, Hint::kTooLittleTexture}, {14, Hint::kTooFast}, {5, Hint::kOnlyRotating}}, false), {});
  EXPECT_TRUE(holds(never, "initialised|never\n")) << never;
  EXPECT_TRUE(holds(never, "why|in 81 % of 100 frames: too few corners")) << never;
  EXPECT_TRUE(holds(never, "why|in 14 % of 100 frames: the images were blurred")) << never;
  EXPECT_FALSE(holds(never, "only turned")) << "too seldom";
  EXPECT_LT(never.find("81 %"), never.find("14 %"));

  const std::string lost = rows_of(
      log_with({{20, Hint::kNone}, {5, Hint::kReturnToKnownView}, {20, Hint::kNone}, {55, Hint::kReturnToKnownView}},
               true),
      {});
  EXPECT_TRUE(holds(lost, "longest loss|5.4 s, from 4.5 s on\n")) << lost;
  EXPECT_TRUE(holds(lost, "in 100 % of 55 frames: no known view")) << lost;
  const std::string fine = rows_of(log_with({{20, Hint::kNone}, {5, Hint::kReturnToKnownView}}, true), {});
  EXPECT_FALSE(holds(fine, "why|") || holds(fine, "loss")) << fine;

  RunSummary summary;
  summary.warnings = {"one", "two"};
  EXPECT_TRUE(holds(rows_of(RunLog(), summary), "warning|one\nwarning|two\n"));
}

// Grey images at given times.
class Stamped : public Camera {
 public:
  explicit Stamped(std::vector<int64_t> stamps_ns) : stamps_ns_(std::move(stamps_ns)), pixels_(160 * 120) {
    info_.model.width = 160;
    info_.model.height = 120;
    info_.model.fx = info_.model.fy = 150;
    info_.model.cx = 79.5F;
    info_.model.cy = 59.5F;
    info_.frames_per_s = 30;
    info_.name = "stamped";
  }
  const CameraInfo& info() const override { return info_; }
  CameraEvent wait(Frame* frame, int64_t /*deadline_ns*/) override {
    if (next_ == stamps_ns_.size()) return CameraEvent::kEnd;
    *frame = {pixels_.data(), 160, 120, 160, PixelFormat::kGrey, stamps_ns_[next_++]};
    return CameraEvent::kFrame;
  }
  std::vector<std::string> remarks() const override { return {"a remark"}; }

 private:
  CameraInfo info_;
  std::vector<int64_t> stamps_ns_;
  std::vector<uint8_t> pixels_;
  size_t next_ = 0;
};

TEST(SteadyClockRun, PausesOfHoursArePassedOver) {
  constexpr int64_t kHour = 3'600'000'000'000;
  RunOptions options;
  options.clock = ClockKind::kSteady;
  options.max_wait_s = 0.05;
  for (const std::vector<int64_t>& stamps : {std::vector<int64_t>{0, kHour, 2 * kHour, 2 * kHour + 10'000'000},
                                             std::vector<int64_t>{INT64_MIN + 1, -1, INT64_MAX - 2, INT64_MAX - 1}}) {
    Stamped camera(stamps);
    const auto begin = std::chrono::steady_clock::now();
    const RunLog log = run_sequence(
        camera, options, [](const CameraInfo&) {}, nullptr);
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    EXPECT_EQ(log.frames.size() + static_cast<size_t>(log.dropped), 4u);
    EXPECT_GE(seconds, 0.1) << "two waits";
    EXPECT_LT(seconds, 20);
    ASSERT_EQ(log.warnings.size(), 2u);
    EXPECT_EQ(log.warnings[0], "a remark");
    EXPECT_TRUE(holds(log.warnings[1], "--clock steady")) << log.warnings[1];
  }
  Stamped camera({0, 10'000'000, 20'000'000});
  EXPECT_EQ(run_sequence(
                camera, options, [](const CameraInfo&) {}, nullptr)
                .warnings.size(),
            1u)
      << "the remark alone";
}

// ---- The program -------------------------------------------------------------------------------------------------

TEST_F(Outputs, TheProgramRefusesToTouchWhatIsTheUsers) {
  for (const char* name : {"seq/overlay.png", "seq/start.png", "frame.pgm", "overlay.mp4"}) write(name, kImage);
  write("list.txt", "0 frame.pgm\n1 frame.pgm\n");
  write("truth.txt", kTruth);
  write("estimate.txt", kTruth);
  write("o/trajectory.txt", "my own\n");
  write("o/notes.txt", "my notes\n");
  write("mine.map", "my map of the town\n");
  write("mine.svg", "<svg/>\n");
  write("blocked/report.html/x", "a folder in its place\n");
  fs::create_hard_link(at("truth.txt"), at("truth_too.txt"));
  fs::create_symlink("mine.svg", at("link.svg"));
  fs::create_symlink("o", at("linked"));
  const auto before = tree();
  const struct {
    const char* arguments;
    const char* named;
  } kCases[] = {
      {"replay list.txt --fov 50 --out o", "o/trajectory.txt"},
      {"replay list.txt --fov 50 --out linked", "trajectory.txt"},
      {"replay list.txt --fov 50 --out blocked", "report.html"},
      {"replay list.txt --fov 50 --out list.txt", "list.txt"},
      {"replay list.txt --fov 50 --out list.txt/o", "list.txt"},
      {"replay list.txt --fov 50 --out .", "overlay.mp4"},
      {"replay seq --fov 50 --out seq", "seq"},
      {"replay seq --fov 50 --out o/../seq/.", "seq"},
      {"replay list.txt --fov 50 --out n --save-map list.txt", "list.txt"},
      {"replay list.txt --fov 50 --out n --save-map frame.pgm", "frame.pgm"},
      {"replay list.txt --fov 50 --out n --save-map mine.map", "mine.map"},
      {"replay list.txt --fov 50 --out n --save-map n", "--out"},
      {"replay list.txt --fov 50 --out n --save-map /proc/x.map", "/proc/x.map"},
      {"replay list.txt --fov 50 --out /proc/n", "/proc/n"},
      {"eval estimate.txt truth.txt --plot truth.txt", "truth.txt"},
      {"eval estimate.txt truth.txt --plot estimate.txt", "estimate.txt"},
      {"eval estimate.txt truth.txt --plot truth_too.txt", "the truth"},
      {"eval estimate.txt truth.txt --plot mine.svg", "mine.svg"},
      {"eval estimate.txt truth.txt --plot link.svg", "link.svg"},
      {"eval estimate.txt truth.txt --plot o", "o"},
  };
  for (const auto& bad : kCases) {
    const Answered answer = run(bad.arguments);
    EXPECT_EQ(answer.code, 2) << bad.arguments << answer.err;
    EXPECT_TRUE(holds(answer.err, "pocket-ptam: error: ") && holds(answer.err, bad.named)) << bad.arguments << "\n"
                                                                                           << answer.err;
    EXPECT_TRUE(tree() == before) << bad.arguments;
  }
}

TEST_F(Outputs, RunsReplaceTheirOwn) {
  write("frame.pgm", kImage);
  write("list.txt", "0 frame.pgm\n1 frame.pgm\n");
  const std::string replay = "replay list.txt --fov 50 --out o ";
  ASSERT_EQ(run(replay).code, 0);
  const std::vector<std::string> names = {"trajectory.txt", "keyframes.txt", "map.ply", "frames.csv", "report.html"};
  for (const std::string& name : names) EXPECT_TRUE(fs::exists(at("o/" + name))) << name;
  const bool encodes = fs::exists(at("o/overlay.mp4"));
  write("o/notes.txt", "my notes\n");
  write("list.txt", "0 frame.pgm\n1 frame.pgm\n2 frame.pgm\n");
  ASSERT_EQ(run(replay).code, 0);
  EXPECT_EQ(fs::exists(at("o/overlay.mp4")), encodes);
  const std::string frames = read("o/frames.csv");
  EXPECT_EQ(std::count(frames.begin(), frames.end(), '\n'), 4);
  ASSERT_EQ(run(replay + "--no-overlay --no-report").code, 0);
  EXPECT_FALSE(fs::exists(at("o/overlay.mp4")) || fs::exists(at("o/report.html"))) << "no longer of this run";
  EXPECT_EQ(read("o/notes.txt"), "my notes\n");
  write("truth.txt", kTruth);
  ASSERT_EQ(run("eval truth.txt truth.txt --plot p.svg").code, 0);
  ASSERT_EQ(run("eval truth.txt truth.txt --plot p.svg").code, 0);
}

// Waits until the run has begun, and a little longer.
void wait_for_start(const fs::path& list) {
  for (int i = 0; i < 6000 && !fs::exists(list); ++i) ::usleep(5000);
  ::usleep(200'000);
}

TEST_F(Outputs, ASignalEndsARunWithItsResultsWritten) {
  write("frame.pgm", kImage);
  write("slow.txt", slow_list());
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    ::signal(SIGHUP, SIG_DFL);  // nohup's is passed on
    fs::remove_all(at("o"));
    const pid_t child = start(kSlow + "--no-report --out o");
    ASSERT_GT(child, 0);
    wait_for_start(at("o"));
    ::kill(child, signal);
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 1) << signal << " " << status;
    const std::string frames = read("o/frames.csv");
    const auto lines = std::count(frames.begin(), frames.end(), '\n');
    EXPECT_TRUE(lines > 1 && lines < 100) << lines;
    EXPECT_TRUE(fs::exists(at("o/trajectory.txt")));
    EXPECT_FALSE(drafts_left());
  }
}

TEST_F(Outputs, TheSecondSignalEndsAtOnceWithoutDrafts) {
  write("frame.pgm", kImage);
  write("slow.txt", slow_list());
  const pid_t child = start(kSlow + "--out o");
  ASSERT_GT(child, 0);
  wait_for_start(at("o"));
  ::kill(child, SIGTERM);
  ::kill(child, SIGINT);
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFSIGNALED(status)) << status;  // by either: both may be pending, in no order
  EXPECT_FALSE(drafts_left());
}

TEST_F(Outputs, AFileThatHasTakenTheMapsPlaceStays) {
  write("frame.pgm", kImage);
  write("slow.txt", slow_list());
  const pid_t child = start(kSlow + "--no-overlay --no-report --out o --save-map m.map");
  ASSERT_GT(child, 0);
  wait_for_start(at("o"));
  write("m.map", "my map of the town\n");
  ::kill(child, SIGINT);
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 1) << status;
  EXPECT_EQ(read("m.map"), "my map of the town\n");
  EXPECT_TRUE(fs::exists(at("o/frames.csv")));
}

// What cannot be written of a dump is an output that failed, not bad input.
TEST_F(Outputs, ADumpThatCannotBeWrittenBrokeMidway) {
  const auto code_of = [&](const std::string& limit, const std::string& arguments) {
    const int status = std::system(("ulimit -f " + limit + "; " + shell(arguments) + " >/dev/null 2>&1").c_str());
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128;
  };
  EXPECT_EQ(code_of("0", "sim --duration 0.2 --dump d"), 1) << "not even the calibration";
  EXPECT_EQ(code_of("unlimited", "sim --duration 0.2 --dump e"), 0);
  EXPECT_EQ(code_of("unlimited", "sim --duration 0.2 --dump e"), 2) << "there is something";
}

TEST_F(Outputs, OneOutputThatFailsStopsNoOther) {
  write("frame.pgm", kImage);
  write("slow.txt", slow_list());
  const pid_t child = start(kSlow + "--no-overlay --no-report --out o");
  ASSERT_GT(child, 0);
  wait_for_start(at("o"));
  write("o/trajectory.txt/x", "a folder has taken the place of one result\n");
  ::kill(child, SIGINT);
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 1) << status;
  EXPECT_TRUE(fs::exists(at("o/trajectory.txt/x")));
  for (const char* name : {"o/keyframes.txt", "o/map.ply", "o/frames.csv"}) EXPECT_TRUE(fs::exists(at(name))) << name;
}

TEST_F(Outputs, AKilledRunLeavesTheOlderResultsWhole) {
  write("frame.pgm", kImage);
  write("slow.txt", slow_list());
  ASSERT_EQ(run("replay slow.txt --fov 50 --no-overlay --no-report --out o").code, 0);
  const auto before = tree();
  const pid_t child = start(kSlow + "--out o");
  ASSERT_GT(child, 0);
  ::usleep(500'000);
  ::kill(child, SIGKILL);
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  for (const auto& [name, content] : before) EXPECT_TRUE(read(name) == content) << name;
  EXPECT_EQ(run("replay slow.txt --fov 50 --no-overlay --no-report --out o").code, 0) << "and is no bar to the next";
}

TEST_F(Outputs, ResultsThatCannotBePrintedAreNotDone) {
  write("truth.txt", kTruth);
  for (const std::string arguments : {"--help", "--version", "eval truth.txt truth.txt", "replay --help"}) {
    for (const std::string stream : {">/dev/full", ">&-"}) {
      const int status = std::system((shell(arguments) + " 2>err " + stream).c_str());
      EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 1) << arguments << stream;
      EXPECT_TRUE(holds(read("err"), "could not be printed")) << read("err");
    }
  }
  // A reader that has seen enough: no message, and no result is lost.
  write("frame.pgm", kImage);
  write("list.txt", "0 frame.pgm\n1 frame.pgm\n");
  const int status =
      std::system((shell("replay list.txt --fov 50 --no-overlay --no-report --out o 2>err") + " | true").c_str());
  EXPECT_EQ(status, 0);
  EXPECT_FALSE(holds(read("err"), "error"));
  EXPECT_TRUE(fs::exists(at("o/frames.csv")));
}

TEST_F(Outputs, TerminalsAndPagesAreSentNoCodes) {
  const std::string name = "a\x1b]0;x\x07\xe2\x80\xae.pgm";
  write(name, "P5 160 120 255\n" + std::string(160 * 120, 'x'));
  fs::create_directory(at("i\x1b[31m"));
  fs::rename(at(name), at("i\x1b[31m") / "1.pgm");
  for (const std::string& arguments :
       {std::string("replay 'i\x1b[31m' --fov 50 --no-overlay --out o"),
        std::string("replay '") + name + "' --fov 50 --out p", std::string("sim '--\x1b[31m'"),
        std::string("'\xc2\x9b"
                    "31m'")}) {
    const Answered answer = run(arguments);
    for (const std::string& text : {answer.out, answer.err}) {
      EXPECT_FALSE(holds(text, "\x1b") || holds(text, "\xc2\x9b") || holds(text, "\xe2\x80\xae")) << arguments;
    }
  }
  const std::string page = read("o/report.html");
  EXPECT_TRUE(holds(page, "</html>") && holds(page, "\\x1b[31m") && !holds(page, "\x1b"));
  EXPECT_TRUE(holds(page, "<th>warning</th>") && holds(page, "assuming a field of view")) << "what was assumed";
}

TEST_F(Outputs, LargeImagesAreToldAndTheSizeThatHelps) {
  const auto warned = [&](int width, int height) {
    write("i.pgm", "P5 " + std::to_string(width) + " " + std::to_string(height) + " 255\n" +
                       std::string(static_cast<size_t>(width) * static_cast<size_t>(height), 'x'));
    return run("replay i.pgm --fov 50 --no-overlay --no-report --out o").err;
  };
  EXPECT_TRUE(holds(warned(1280, 720), "--resize 320x180"));
  EXPECT_TRUE(holds(warned(540, 1080), "--resize 160x320"));
  EXPECT_FALSE(holds(warned(960, 720), "--resize"));
}

// ---- The binary --------------------------------------------------------------------------------------------------

TEST(Hardening, TheProgramIsBuiltWithIt) {
#if defined(__SANITIZE_ADDRESS__) || !defined(__x86_64__)
  GTEST_SKIP() << "not with sanitizers, which do more; read for x86-64 alone";
#else
  std::ifstream stream(PPTAM_PROGRAM, std::ios::binary);
  const std::string bytes{std::istreambuf_iterator<char>(stream), {}};
  const auto get = [&](auto* into, size_t offset) {
    if (offset + sizeof *into > bytes.size()) return false;
    std::memcpy(into, bytes.data() + offset, sizeof *into);
    return true;
  };
  Elf64_Ehdr head;
  ASSERT_TRUE(get(&head, 0));
  EXPECT_EQ(head.e_type, ET_DYN) << "position independent";
  bool relro = false, stack = false, now = false, pie = false;
  for (int i = 0; i < head.e_phnum; ++i) {
    Elf64_Phdr part;
    ASSERT_TRUE(get(&part, head.e_phoff + static_cast<size_t>(i) * head.e_phentsize));
    EXPECT_FALSE((part.p_flags & PF_W) != 0 && (part.p_flags & PF_X) != 0) << "writable code";
    relro = relro || part.p_type == PT_GNU_RELRO;
    stack = stack || part.p_type == PT_GNU_STACK;
    if (part.p_type != PT_DYNAMIC) continue;
    for (size_t at = part.p_offset; at < part.p_offset + part.p_filesz; at += sizeof(Elf64_Dyn)) {
      Elf64_Dyn entry;
      ASSERT_TRUE(get(&entry, at));
      now = now || (entry.d_tag == DT_FLAGS && (entry.d_un.d_val & DF_BIND_NOW) != 0);
      pie = pie || (entry.d_tag == DT_FLAGS_1 && (entry.d_un.d_val & DF_1_PIE) != 0);
    }
  }
  EXPECT_TRUE(relro);
  EXPECT_TRUE(stack);
  EXPECT_TRUE(now);
  EXPECT_TRUE(pie);
  EXPECT_TRUE(holds(bytes, "__stack_chk_fail"));
#ifdef __OPTIMIZE__
  EXPECT_TRUE(holds(bytes, "__snprintf_chk") || holds(bytes, "__vsnprintf_chk")) << "fortified functions";
#endif
#endif
}

}  // namespace
}  // namespace pptam::platform
