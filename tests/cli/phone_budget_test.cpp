// Does it fit a phone: profiles and what is refused of them, baselines that tell which stage has become dearer, traces,
// and a phone that is too slow.
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "platform/input_error.h"
#include "platform/run/names.h"
#include "platform/run/trace.h"
#include "platform/text.h"
#include "sim_phone/laboratory/budget_baseline.h"
#include "sim_phone/laboratory/phone_calibration.h"
#include "sim_phone/phone_camera.h"
#include "tests/support/scratch_folder.h"

namespace pptam::laboratory {
namespace {

namespace fs = std::filesystem;
using platform::format;
using platform::InputError;

bool holds(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

// ------------------------------------------------------------------------------------------------------------ profiles

TEST(PhoneProfiles, OfThePaperIsTheWorkClocksOwn) {
  const Phone phone = load_phone("iphone3g");
  const PhoneProfile own;
  EXPECT_EQ(phone.processor.clock_mhz, own.clock_mhz);
  EXPECT_EQ(phone.processor.cycles_per_instruction, own.cycles_per_instruction);
  EXPECT_EQ(phone.processor.instructions, own.instructions);
  sim::PhoneOptions camera;
  use_camera(phone, &camera);
  EXPECT_EQ(camera.readout_s, sim::PhoneOptions().readout_s);
  EXPECT_EQ(camera.width, sim::PhoneOptions().width);
  EXPECT_EQ(camera.horizontal_fov_degrees, sim::PhoneOptions().horizontal_fov_degrees);
}

TEST(PhoneProfiles, BuiltInOnesAreSound) {
  EXPECT_GE(phone_names().size(), 6u);
  for (const std::string& name : phone_names()) {
    const Phone phone = load_phone(name);
    EXPECT_TRUE(holds(phone.says, "assumed")) << name << ": nothing of it was measured on a device";
    sim::PhoneOptions camera;
    use_camera(phone, &camera);
    EXPECT_NO_THROW(sim::check_phone_options(camera)) << name;
  }
}

const std::string kLeast = "processor:\n  clock_mhz: 100\n  cycles_per_instruction: 2\n";

TEST(PhoneProfiles, HoldWhatIsWritten) {
  const Phone phone = read_phone(kLeast +
                                     "says: mine\ncamera:\n  width: 320\n  readout_s: 0.02\n  readout_axis: rows\n"
                                     "  readout_direction: -1\nframe:\n  capture_ms: 1.5\n"
                                     "instructions:\n  patch_warp: 5000.5\n  other: 2\n",
                                 "mine.yaml");
  EXPECT_EQ(phone.says, "mine");
  EXPECT_EQ(phone.processor.clock_mhz, 100);
  EXPECT_EQ(phone.processor.instructions[static_cast<size_t>(Work::kPatchWarp)], 5000.5f);
  EXPECT_EQ(phone.processor.instructions[static_cast<size_t>(Work::kOther)], 2);
  EXPECT_EQ(phone.processor.instructions[0], PhoneProfile().instructions[0]);
  EXPECT_EQ(phone.capture_ns, 1'500'000);
  sim::PhoneOptions camera;
  use_camera(phone, &camera);
  EXPECT_EQ(camera.width, 320);
  EXPECT_EQ(camera.height, 320) << "as it was";
  EXPECT_EQ(camera.readout_s, -0.02);
  EXPECT_EQ(camera.readout_axis, RollingShutter::Axis::kRows);
}

TEST(PhoneProfiles, BadOnesAreRefusedWithTheReason) {
  const std::pair<std::string, const char*> bad[] = {
      {"", "lines of `key: value`"},
      {"- 1\n- 2\n", "lines of `key: value`"},
      {"says: x\n", "clock_mhz: is missing"},
      {"processor:\n  clock_mhz: 100\n", "cycles_per_instruction: is missing"},
      {kLeast + "procesor: 1\n", "procesor: is unknown"},
      {kLeast + "camera: 320\n", "camera: lines of"},
      {kLeast + "camera:\n  widht: 320\n", "camera.widht: is unknown; there are width"},
      {kLeast + "camera:\n  width: 320\n  width: 320\n", "width is there twice"},
      {kLeast + "camera:\n  width: 3e9\n", "is not a number from 64 to 4096"},
      {kLeast + "camera:\n  width: 320 px\n", "'320 px' is not a number"},
      {kLeast + "camera:\n  width: [320]\n", "is no single value"},
      {kLeast + "camera:\n  readout_axis: diagonal\n", "neither rows nor columns"},
      {kLeast + "camera:\n  readout_direction: -1\n", "says nothing without readout_s"},
      {kLeast + "camera:\n  readout_axis: rows\n", "readout_axis: says nothing without readout_s"},
      {kLeast + "camera:\n  width: 320.5\n", "camera.width: '320.5' is not a whole number"},
      {kLeast + "camera:\n  height: 240.5\n", "camera.height: '240.5' is not a whole number"},
      {kLeast + "frame:\n  capture_ms: -1\n", "from 0 to 1000"},
      {kLeast + "instructions:\n  grey_pixel: 100001\n", "from 0 to 100000"},
      {"processor: {clock_mhz: 1, cycles_per_instruction: 101}\n", "from 0.01 to 100"},
      {kLeast + "instructions:\n  grey_pixel: nan\n", "'nan' is not a number"},
      {kLeast + "instructions:\n  grey_pixel: inf\n", "'inf' is not a number"},
      {kLeast + "instructions:\n  grey: 1\n", "there are grey_pixel"},
      {"processor: {clock_mhz: 0, cycles_per_instruction: 1}\n", "from 1 to 100000"},
      {"processor: [\n", "not readable as YAML: line"},
      {std::string(2000, '['), "not readable as YAML"},
      {std::string(2000, '-') + "\n", "lines of `key: value`"},
      {"? ? ? ? a\n", "a key is no word"},
      {kLeast + "? [a]\n: b\n", "a key is no word"},
      {"a: &a b\nc: *d\n", "not readable as YAML"},
      {kLeast + "#" + std::string(20000, 'x') + "\n", "longer than 16 kB"},
      {kLeast + "says: " + std::string(300, 'x') + "\n", "longer than 200"},
  };
  for (const auto& [text, reason] : bad) {
    try {
      read_phone(text, "mine.yaml");
      ADD_FAILURE() << "accepted: " << text.substr(0, 100);
    } catch (const InputError& error) {
      EXPECT_TRUE(holds(error.what(), reason)) << text.substr(0, 100) << ": " << error.what();
      EXPECT_TRUE(holds(error.what(), "phone mine.yaml: ")) << error.what();
      EXPECT_LT(std::string(error.what()).size(), 700u);
    }
  }
  EXPECT_THROW(load_phone("no_such_phone"), InputError);
}

// --------------------------------------------------------------------------------------------------------- calibration

// Spans of a processor on which some kinds of work take longer than ARMv6 has them and others less.
SpanWorks made_up_spans(const PhoneProfile& processor) {
  SpanWorks spans;
  const auto charge = [&](Span span, Work kind, double units) {
    SpanWork& work = spans[static_cast<size_t>(span)];
    const auto k = static_cast<size_t>(kind);
    work.units[k] += units;
    work.ns += units * static_cast<double>(processor.instructions[k]) *
               static_cast<double>(processor.cycles_per_instruction) * 1e3 / static_cast<double>(processor.clock_mhz);
  };
  charge(Span::kPyramid, Work::kPyramidPixel, 1e6);
  charge(Span::kPyramid, Work::kOther, 1e5);
  charge(Span::kRotation, Work::kRotationPixel, 1e4);
  charge(Span::kSearch, Work::kPatchWarp, 1e3);
  charge(Span::kSearch, Work::kPatchCandidate, 5e4);
  charge(Span::kSearch, Work::kOther, 2e6);
  charge(Span::kPartial, Work::kPatchWarp, 1e3);
  charge(Span::kPartial, Work::kPatchCandidate, 1e4);
  charge(Span::kAdjust, Work::kBundleBlock, 1e4);
  charge(Span::kAdjust, Work::kOther, 1e6);
  charge(Span::kTidy, Work::kOther, 3e6);
  return spans;
}

TEST(Calibrations, TellTheProcessorThatTookTheTimes) {
  PhoneProfile truth;
  truth.clock_mhz = 600;
  truth.cycles_per_instruction = 0.8f;
  for (const auto& [kind, factor] : {std::pair(Work::kPyramidPixel, 0.25f),
                                     {Work::kPatchWarp, 2.0f},
                                     {Work::kPatchCandidate, 0.5f},
                                     {Work::kBundleBlock, 1.7f}})
    truth.instructions[static_cast<size_t>(kind)] *= factor;
  Calibration found;
  found.measured = made_up_spans(truth);
  found.processor = fit_processor(found.measured, 600);
  double worst = 0;
  for (int s = 0; s < kSpans; ++s) {
    const double ns = found.measured[static_cast<size_t>(s)].ns;
    if (ns > 0) worst = std::max(worst, std::abs(found.modelled_ns(static_cast<Span>(s)) / ns - 1));
  }
  EXPECT_LT(worst, 0.01);
  const auto ns_of = [](const PhoneProfile& p, Work kind) {
    return static_cast<double>(p.instructions[static_cast<size_t>(kind)] * p.cycles_per_instruction / p.clock_mhz);
  };
  for (const Work kind : {Work::kPatchWarp, Work::kPatchCandidate, Work::kBundleBlock, Work::kRotationPixel})
    EXPECT_NEAR(ns_of(found.processor, kind) / ns_of(truth, kind), 1, 0.1) << work_name(kind);
  // Control: ARMv6's own figures do not say the same.
  PhoneProfile plain;
  plain.clock_mhz = 600;
  Calibration control = {plain, found.measured};
  const auto searched = static_cast<size_t>(Span::kPyramid);
  EXPECT_GT(std::abs(control.modelled_ns(Span::kPyramid) / found.measured[searched].ns - 1), 0.5);
  EXPECT_THROW(fit_processor({}, 600), InputError);
}

TEST(Calibrations, AreWrittenAsProfiles) {
  Calibration calibration;
  calibration.processor = fit_processor(made_up_spans(PhoneProfile()), 412);
  for (const char* like : {"iphone3g", "pi_zero", "desktop"}) {
    const Phone before = load_phone(like);
    const std::string text = profile_text(before, calibration);
    EXPECT_TRUE(is_profile(std::as_bytes(std::span(text))));
    const Phone phone = read_phone(text, "board.yaml");
    EXPECT_NEAR(phone.processor.cycles_per_instruction, 1.5f, 1e-3f);
    EXPECT_EQ(phone.width, before.width);
    EXPECT_EQ(phone.readout_s, before.readout_s);
    EXPECT_EQ(phone.readout_axis, before.readout_axis);
    EXPECT_EQ(phone.display_ns, before.display_ns);
    for (size_t k = 0; k < kWorkKinds; ++k)
      EXPECT_NEAR(phone.processor.instructions[k] / PhoneProfile().instructions[k], 1, 1e-3) << k;
  }
}

// ----------------------------------------------------------------------------------------------------------- baselines

// A frame of 10 ms, of which most is search, and a keyframe's copy is next to nothing.
BudgetReport made_up() {
  constexpr double kMs[kStages] = {0.8, 0.7, 6, 1.5, 0.9, 8, 0.05};
  BudgetReport report;
  report.period_ms = 66.7;
  report.width = 240;
  report.height = 320;
  for (int s = 0; s < kStages; ++s) report.stages[s].mean = 1e6 * kMs[s];
  report.tracking.mean = 1e7;
  return report;
}

TEST(Baselines, ASlowdownOfAnyStageIsNamed) {
  BudgetOptions options;
  options.stories = {"desk_calm"};
  const Baseline before = read_baseline(baseline_text(options, made_up()), "b", options);
  EXPECT_TRUE(compare(before, made_up()).dearer.empty());
  for (int s = 0; s < kStages; ++s) {
    const std::string name = platform::name_of(static_cast<Stage>(s));
    for (const double grown_ns : {0.2 * made_up().stages[s].mean, 0.05 * made_up().tracking.mean}) {
      BudgetReport now = made_up();
      now.stages[s].mean += grown_ns;
      now.tracking.mean += grown_ns;
      const std::vector<std::string> dearer = compare(before, now).dearer;
      ASSERT_FALSE(dearer.empty()) << name;
      EXPECT_TRUE(dearer[0].starts_with(name + " takes ")) << dearer[0];
    }
    // What is within the tolerance of both, and what has become cheaper, is none.
    BudgetReport now = made_up();
    now.stages[s].mean *= 1.02;
    EXPECT_TRUE(compare(before, now).dearer.empty()) << name;
    now.stages[s].mean = 0;
    EXPECT_TRUE(compare(before, now).dearer.empty()) << name;
  }
}

TEST(Baselines, OfSomethingElseAreRefused) {
  BudgetOptions options;
  options.stories = {"desk_calm"};
  const std::string text = baseline_text(options, made_up());
  const auto refused = [](const std::string& before, const BudgetOptions& now) {
    try {
      read_baseline(before, "b.csv", now);
      return std::string("accepted");
    } catch (const InputError& error) {
      return std::string(error.what());
    }
  };
  BudgetOptions other = options;
  other.seed = 2;
  EXPECT_TRUE(holds(refused(text, other), "--compare b.csv: was made of something else"));
  other = options;
  other.stories = {"orbit"};
  EXPECT_TRUE(holds(refused(text, other), "something else"));
  other = options;
  other.phone.width = 320;
  EXPECT_TRUE(holds(refused(text, other), "something else"));
  const sim::PhoneOptions own = phone_of(options, "desk_calm");
  other = options;
  other.phone.horizontal_fov_degrees = own.horizontal_fov_degrees + 1;
  EXPECT_TRUE(holds(refused(text, other), "something else"));
  other = options;
  other.phone.exposure_s = 0.5 * own.exposure_s;
  EXPECT_TRUE(holds(refused(text, other), "something else"));
  other = options;
  other.phone.readout_s = own.readout_s;
  other.phone.readout_axis = own.readout_axis;
  EXPECT_EQ(refused(text, other), "accepted") << "told, but the same";
  other.phone.readout_s = -own.readout_s;
  EXPECT_TRUE(holds(refused(text, other), "something else")) << "the sign alone";
  other.phone.readout_s = own.readout_s;
  other.phone.readout_axis = RollingShutter::Axis::kRows;
  EXPECT_TRUE(holds(refused(text, other), "something else")) << "the axis alone";
  EXPECT_TRUE(holds(refused("", options), "is not a baseline"));
  EXPECT_TRUE(holds(refused("a\nb\nc\n", options), "is not a baseline"));
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string changed = text;
    return changed.replace(changed.find(from), from.size(), to);
  };
  EXPECT_TRUE(holds(refused(with("\nsearch,6", "\nsearch,x"), options), "holds no time"));
  EXPECT_TRUE(holds(refused(with("\nsearch,6", "\nsearch,-6"), options), "holds no time"));
  EXPECT_TRUE(holds(refused(with("\nsearch,", "\nsuch,"), options), "has no line for search"));
  EXPECT_EQ(refused(with("search,6.000000\n", "search,6.000000\r\n"), options), "accepted");
  EXPECT_TRUE(holds(refused(with("\nsearch,", "\nsearch,6\nsearch,"), options), "has two lines for search"));
  EXPECT_TRUE(holds(refused(with("\nsearch,6.0", "\nsearch,9.0"), options), "was changed since --save has written it"));
  EXPECT_TRUE(holds(refused(with("\n# phone ", "\n# tablet "), options), "does not name its phone"));
  EXPECT_TRUE(holds(refused(text.substr(0, text.size() - 1), options), "its last line is cut off"));
  EXPECT_TRUE(holds(refused(text.substr(0, text.size() - 4), options), "its last line is cut off"));
}

TEST(Baselines, NameTheirPhone) {
  BudgetOptions options;
  options.stories = {"desk_calm"};
  options.phone.name = "mine.yaml";
  const Baseline before = read_baseline(baseline_text(options, made_up()), "b", options);
  EXPECT_EQ(compare(before, made_up()).phone, "mine.yaml");
}

// ------------------------------------------------------------------------------------------------------------ verdicts

// 300 frames that leave nine tenths of their time to mapping and idling.
BudgetReport that_fits() {
  BudgetReport report = made_up();
  report.frames = 300;
  report.worst.ns = 30'000'000;
  report.time.tracking_ns = 1'000'000'000;
  report.time.mapping_ns = 3'000'000'000;
  report.time.idle_ns = 6'000'000'000;
  return report;
}

TEST(Verdicts, EachReasonIsGivenAlone) {
  const auto faults = [](BudgetReport report) {
    give_verdict(&report);
    return platform::joined(report.faults);
  };
  EXPECT_EQ(faults(that_fits()), "");
  BudgetReport report = that_fits();
  report.dropped = 3;
  EXPECT_EQ(faults(report), "3 frames were dropped because the one before was not done");
  report = that_fits();
  report.worst.ns = 66'800'000;
  EXPECT_EQ(faults(report), "the worst frame takes 66.8 ms, and one comes every 66.7 ms");
  report.worst.ns = 66'600'000;
  EXPECT_EQ(faults(report), "");
  report = that_fits();
  report.time = {};
  report.time.tracking_ns = 92, report.time.mapping_ns = 5, report.time.idle_ns = 3;
  EXPECT_EQ(faults(report), "frames leave 8 % of the time to mapping, which starves below 10 %");
  report.time.tracking_ns = 88, report.time.mapping_ns = 5, report.time.idle_ns = 7;
  EXPECT_EQ(faults(report), "");
  // Times of several runs of a phone that is absurdly slow.
  report.time = {};
  report.time.mapping_ns = report.time.idle_ns = INT64_MAX;
  EXPECT_EQ(faults(report), "") << "their sum is more than int64_t holds";
}

TEST(ShellWords, AreQuotedWhereTheyHaveToBe) {
  EXPECT_EQ(platform::shell_word("phones/mine-2.yaml"), "phones/mine-2.yaml");
  EXPECT_EQ(platform::shell_word("my phone.yaml"), "'my phone.yaml'");
  EXPECT_EQ(platform::shell_word("it's"), "'it'\\''s'");
  EXPECT_EQ(platform::shell_word(""), "''");
}

// --------------------------------------------------------------------------------------------------------- the program

constexpr double kRounding_us = 0.0015;  // times in traces are written to the nanosecond

struct Answer {
  int code = -1;
  std::string out, err;
};

std::string read_all(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

class PhoneBudget : public ::testing::Test {
 protected:
  Answer run(const std::string& arguments) const {
    const fs::path out = folder_ / "stdout.txt", err = folder_ / "stderr.txt";
    const int status = std::system(("cd '" + folder_.string() + "' && '" PPTAM_PROGRAM "' " + arguments + " >'" +
                                    out.string() + "' 2>'" + err.string() + "'")
                                       .c_str());
    return {WIFEXITED(status) ? WEXITSTATUS(status) : 128, read_all(out), read_all(err)};
  }
  void write(const std::string& name, const std::string& content) const {
    std::ofstream(folder_ / name, std::ios::binary) << content;
  }
  std::string read(const std::string& name) const { return read_all(folder_ / name); }
  // The paper's phone with another figure for one kind of work.
  void write_phone(const std::string& name, Work work, double factor) const {
    const double instructions = factor * static_cast<double>(PhoneProfile().instructions[static_cast<size_t>(work)]);
    write(name, "processor:\n  clock_mhz: 412\n  cycles_per_instruction: 1.5\ninstructions:\n  " +
                    std::string(work_name(work)) + format(": %.3f\n", instructions));
  }

  const pptam::test::ScratchFolder scratch_;
  const fs::path& folder_ = scratch_.path();
};

// The whole way: through a changed table of units in a profile to a verdict that names the stage.
TEST_F(PhoneBudget, ASlowdownFailsAndIsNamed) {
  const std::string budget = "budget --story desk_calm ";
  const Answer first = run(budget + "--phone iphone3g --save b.csv");
  ASSERT_EQ(first.code, 0) << first.out << first.err;
  EXPECT_TRUE(holds(first.out, "fits: ")) << first.out;
  // Full-frame rotation is charged by the pixel, and by nothing else.
  write_phone("dear.yaml", Work::kRotationPixel, 1.2);
  const Answer dear = run(budget + "--phone dear.yaml --compare b.csv");
  EXPECT_EQ(dear.code, 1) << dear.out << dear.err;
  EXPECT_TRUE(holds(dear.out, "dearer: rotation takes ")) << dear.out;
  EXPECT_FALSE(holds(dear.out, "dearer: search")) << dear.out;
  // The same phone: the same figures, and the same words but for what was compared.
  const Answer same = run(budget + "--phone iphone3g --compare b.csv");
  EXPECT_EQ(same.code, 0) << same.out << same.err;
  EXPECT_EQ(same.out.substr(0, same.out.find("verdict")), first.out.substr(0, first.out.find("verdict")));
  const Answer other = run("budget --story static --phone iphone3g --compare b.csv");
  EXPECT_EQ(other.code, 2) << other.out << other.err;
}

TEST_F(PhoneBudget, CalibratesThisComputer) {
  const std::string calibrate = "budget --story desk_calm --calibrate ";
  for (int round = 0; round < 2; ++round) {
    const Answer answer = run(calibrate + "here.yaml --clock-mhz 2000");
    ASSERT_EQ(answer.code, 0) << answer.err;
    EXPECT_TRUE(holds(answer.out, "profile written to here.yaml")) << answer.out;
  }
  const Phone here = load_phone((folder_ / "here.yaml").string());
  EXPECT_EQ(here.processor.clock_mhz, 2000);
  const Answer budget = run("budget --story desk_calm --phone here.yaml");
  EXPECT_TRUE(holds(budget.out, "calibrated by pocket-ptam")) << budget.out << budget.err;
  write("here.yaml", read("here.yaml") + "# mine\n");
  EXPECT_EQ(run(calibrate + "here.yaml").code, 2) << "somebody has changed it";
  EXPECT_EQ(run(calibrate + "a.yaml --save b.csv").code, 2);
  EXPECT_EQ(run("budget --clock-mhz 100 --story desk_calm").code, 2);
}

TEST_F(PhoneBudget, BadInputIsToldBeforeAnythingIsDone) {
  write("notes.csv", "mine\n");
  write("bad.yaml", "processor: 1\n");
  write("least.yaml", kLeast);
  for (const auto& [arguments, reason] : std::vector<std::pair<std::string, std::string>>{
           {"budget --phone nokia", "is neither a file nor one of iphone3g"},
           {"budget --phone bad.yaml", "phone bad.yaml: processor: lines of"},
           {"budget --story nothing", "story 'nothing' is unknown"},
           {"budget --phone least.yaml --story desk_calm --story bands_30fps", "have different cameras"},
           {"budget --save notes.csv", "notes.csv"},
           {"budget --compare missing.csv", "missing.csv"},
           {"budget --phone bad.yaml --save bad.yaml", "bad.yaml"},
           {"sim --phone nokia", "is neither a file nor one of"},
           {"sim --phone iphone3g --clock steady", "--clock"},
           {"sim --trace notes.csv --duration 1", "notes.csv"},
           {"sim --trace out/t.csv --out out/t.csv", "--trace"},
           {"sim --suite --trace t.json", "--trace belongs to a single run"},
           {"sim --study harsh --phone pi_zero", "--phone belongs to a single run"}}) {
    const Answer answer = run(arguments);
    EXPECT_EQ(answer.code, 2) << arguments << "\n" << answer.out;
    EXPECT_TRUE(holds(answer.err, reason)) << arguments << ": " << answer.err;
    EXPECT_EQ(std::count(answer.err.begin(), answer.err.end(), '\n'), 1) << answer.err;
    EXPECT_TRUE(answer.out.empty()) << answer.out;
  }
  EXPECT_EQ(read("notes.csv"), "mine\n");
}

// A phone that tracks at a third of the camera's rate: frames are dropped, the newest is kept, mapping gets its slices,
// and all that is said.
TEST_F(PhoneBudget, APhoneThatIsTooSlowDropsFramesAndSaysSo) {
  write("slow.yaml", "processor:\n  clock_mhz: 25\n  cycles_per_instruction: 1.5\n");
  const Answer answer = run("sim --phone slow.yaml --duration 8 --no-overlay --no-report --out o --trace t.json");
  EXPECT_EQ(answer.code, 0) << answer.err;
  EXPECT_TRUE(holds(answer.out, "dropped because tracking took longer")) << answer.out;
  EXPECT_TRUE(holds(answer.out, "results came after the next frame")) << answer.out;
  EXPECT_TRUE(holds(answer.out, "mapping starves")) << answer.out;
  const YAML::Node events = YAML::Load(read("t.json"))["traceEvents"];
  int dropped = 0, slices = 0;
  double busy_until_us = 0;
  for (const YAML::Node& event : events) {
    const std::string name = event["name"].as<std::string>();
    if (name == "dropped") ++dropped;
    if (name == "slice") ++slices;
    if (name != "frame") continue;
    // Never queued: a frame that is begun came within the period before, and the next one had not come.
    const double begin_us = event["ts"].as<double>(), number = event["args"]["frame"].as<double>();
    EXPECT_GE(begin_us, busy_until_us - kRounding_us);
    EXPECT_LT(begin_us - number * 1e6 / 15, 1e6 / 15 + 20'000) << "older than a period and a slice of mapping";
    busy_until_us = begin_us + event["dur"].as<double>();
  }
  EXPECT_GT(dropped, 30);
  EXPECT_GT(slices, 10);
  const Answer budget = run("budget --phone slow.yaml --story desk_calm");
  EXPECT_EQ(budget.code, 1) << budget.err;
  EXPECT_TRUE(holds(budget.out, "does not fit: ") && holds(budget.out, "frames were dropped")) << budget.out;
}

// -------------------------------------------------------------------------------------------------------------- traces

TEST(Traces, EndWhereTheyBecomeTooLong) {
  WorkMeter meter;
  WorkClock clock(meter);
  platform::RunTracer tracer(clock, true, 2);
  const auto pass = [&] { clock.idle_until(clock.now_ns() + 1'000'000'000); };
  tracer.begin(Span::kFrame);
  pass();
  tracer.count(Counter::kKeyframes, 1);
  pass();
  tracer.begin(Span::kSearch);  // the first one too many
  pass();
  tracer.end(Span::kSearch);
  tracer.count(Counter::kKeyframes, 2);
  tracer.end(Span::kFrame);
  pass();
  tracer.begin(Span::kSlice);
  pass();
  tracer.end(Span::kSlice);
  platform::FrameLog sums;
  tracer.take(&sums);
  EXPECT_EQ(sums.mapping_ns, 1'000'000'000) << "is told to the end";
  platform::RunLog log;
  tracer.give(&log);
  ASSERT_EQ(log.trace.size(), 2u);
  EXPECT_EQ(log.trace[0].what, platform::trace_of(Span::kFrame));
  EXPECT_EQ(log.trace[0].end_ns - log.trace[0].begin_ns, 3'000'000'000) << "a span that was open keeps its end";
  EXPECT_EQ(log.trace[1].value, 1);
  ASSERT_EQ(log.warnings.size(), 1u);
  EXPECT_EQ(log.warnings[0], "the trace ends at 2.0 s: too long, 2 events were kept");
}

TEST_F(PhoneBudget, ATraceMayLieInTheFolderOfResults) {
  const std::string sim = "sim --duration 1 --no-overlay --no-report --out run ";
  for (const char* which : {"the folder is made", "it is there, with an earlier trace"}) {
    const Answer answer = run(sim + "--trace run/t.json");
    EXPECT_EQ(answer.code, 0) << which << ": " << answer.err;
    EXPECT_TRUE(YAML::Load(read("run/t.json"))["traceEvents"].IsSequence()) << which;
    EXPECT_FALSE(read("run/frames.csv").empty());
  }
  for (const char* elsewhere : {"--trace other/t.json", "--trace run/below/t.json", "--trace other/run/t.json"}) {
    const Answer answer = run(sim + elsewhere);
    EXPECT_EQ(answer.code, 2) << elsewhere;
    EXPECT_TRUE(holds(answer.err, "there is no folder")) << answer.err;
  }
}

struct SpanSeen {
  double begin_us, end_us;
  std::string name;
};

TEST_F(PhoneBudget, TracesAreWellFormedAndTheSameTwice) {
  const std::string sim = "sim --phone iphone3g --scene boxes --duration 5 --no-overlay --no-report ";
  ASSERT_EQ(run(sim + "--out a --trace t.json").code, 0);
  const std::string first = read("t.json");
  ASSERT_EQ(run(sim + "--out a --trace t.json").code, 0) << "an earlier trace is replaced";
  EXPECT_EQ(read("t.json"), first);
  const YAML::Node trace = YAML::Load(first);  // JSON is YAML
  EXPECT_EQ(trace["displayTimeUnit"].as<std::string>(), "ms");
  EXPECT_EQ(trace["otherData"]["clock"].as<std::string>(), "work");
  std::map<int, std::vector<SpanSeen>> tracks;
  std::map<std::string, int> names;
  std::map<int, std::string> track_names;
  for (const YAML::Node& event : trace["traceEvents"]) {
    const std::string phase = event["ph"].as<std::string>(), name = event["name"].as<std::string>();
    ++names[name];
    EXPECT_TRUE(phase == "M" || phase == "X" || phase == "C") << phase;
    if (phase == "M") {
      if (name == "thread_name") track_names[event["tid"].as<int>()] = event["args"]["name"].as<std::string>();
      continue;
    }
    const double begin_us = event["ts"].as<double>();
    EXPECT_GE(begin_us, 0);
    if (phase == "X") tracks[event["tid"].as<int>()].push_back({begin_us, begin_us + event["dur"].as<double>(), name});
  }
  EXPECT_EQ(track_names, (std::map<int, std::string>{{1, "frames"}, {2, "mapping"}, {3, "idle"}}));
  EXPECT_EQ(names["frame"], 75);
  EXPECT_EQ(names["capture"], 75);
  EXPECT_EQ(names["display"], 75);
  for (const char* counter : {"keyframes", "map points", "inliers", "quality"})
    EXPECT_EQ(names[counter], 75) << counter;
  for (const char* name : {"pyramid", "rotation", "search", "pose", "partial", "initialise", "keyframe", "slice",
                           "finish_map", "insert", "adjust", "idle"})
    EXPECT_GT(names[name], 0) << name;
  // Within a track spans are nested or apart; and the processor does one thing at a time.
  std::vector<SpanSeen> all;
  for (const auto& [track, spans] : tracks) {
    std::vector<SpanSeen> open;
    for (const SpanSeen& span : spans) {
      while (!open.empty() && open.back().end_us <= span.begin_us + kRounding_us) open.pop_back();
      if (!open.empty()) {
        EXPECT_LE(span.end_us, open.back().end_us + kRounding_us) << span.name << " in " << open.back().name;
      } else {
        all.push_back(span);
      }
      open.push_back(span);
    }
  }
  std::sort(all.begin(), all.end(), [](const SpanSeen& a, const SpanSeen& b) { return a.begin_us < b.begin_us; });
  for (size_t i = 1; i < all.size(); ++i)
    EXPECT_GE(all[i].begin_us, all[i - 1].end_us - kRounding_us) << all[i].name << " after " << all[i - 1].name;
}

TEST_F(PhoneBudget, ALiveRunIsTracedToo) {
  const Answer answer = run("live --camera sim:desk --duration 1 --poses none --trace t.json </dev/null");
  ASSERT_EQ(answer.code, 0) << answer.err;
  const YAML::Node trace = YAML::Load(read("t.json"));
  EXPECT_EQ(trace["otherData"]["clock"].as<std::string>(), "steady");
  int frames = 0;
  double idle_us = 0;
  for (const YAML::Node& event : trace["traceEvents"]) {
    if (event["name"].as<std::string>() == "frame") ++frames;
    if (event["name"].as<std::string>() == "idle") idle_us += event["dur"].as<double>();
  }
  EXPECT_GE(frames, 2);
  EXPECT_GT(idle_us, 0);
  EXPECT_LT(idle_us, 60e6);
  write("t.json", read("t.json") + " ");
  EXPECT_EQ(run("live --camera sim:desk --duration 1 --poses none --trace t.json </dev/null").code, 2)
      << "somebody has changed it: it is not replaced";
}

}  // namespace
}  // namespace pptam::laboratory
