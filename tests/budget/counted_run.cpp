// A run of the emulated phone whose time is its own executed instructions, beside the same run by the work clock.
//
//   counted_run NAME            "desk", as other tests here keep it, or one of the stories
//
// On an emulated ARM1176 with the counting plugin the scheduler runs at the iPhone 3G's speed: frames arrive, are
// tracked or dropped, and mapping gets what is left, by what the processor has really executed. Two runs by the work
// clock are held against that. One does the same frames and the same slices, so that its map must be equal to the last
// bit and each stage's charge is compared with what that very work has cost. The other lives in its own time, as
// `pocket-ptam budget` does: between frames other slices are run, so that maps differ, and the whole is compared.
// Elsewhere the frames are rendered and kept for it (kept_recording.h), and nothing else. tests/budget/counted_run.sh
// runs both.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <pocket_ptam/pocket_ptam.h>
#include "platform/run/names.h"
#include "platform/run/run.h"
#include "platform/run/session.h"
#include "platform/run/statistics.h"
#include "sim_phone/story.h"
#include "tests/budget/count_table.h"
#include "tests/budget/instruction_counter.h"
#include "tests/budget/kept_recording.h"

namespace pptam {
namespace {

using platform::FrameLog;
using platform::RunLog;

// Of the frame's time on the iPhone 3G: sim_phone/profiles/iphone3g.yaml.
constexpr int64_t kCapture_ns = 3'500'000, kDisplay_ns = 12'000'000;
// By how much the work clock's figures may be off: a share of the counted ones, and the least time that is judged, as a
// share of a frame's.
constexpr double kTolerance = 0.1, kSmall = 0.01;

// Time is executed instructions x cycles per instruction / clock rate, plus the idle time skipped.
class CountedClock final : public Clock {
 public:
  int64_t now_ns() const override {
    const double instructions = static_cast<double>(region_.spent().instructions);
    const double ns =
        instructions * static_cast<double>(phone_.cycles_per_instruction) * 1e3 / static_cast<double>(phone_.clock_mhz);
    return skipped_ns_ + static_cast<int64_t>(ns);
  }
  void idle_until(int64_t t_ns) override { skipped_ns_ += std::max<int64_t>(0, t_ns - now_ns()); }
  void forget_since(int64_t t_ns) override { skipped_ns_ -= now_ns() - t_ns; }

 private:
  const PhoneProfile phone_;
  const test::Region region_;
  int64_t skipped_ns_ = 0;
};

struct Figure {
  std::string name;
  double ms = 0;
};

// Means and percentiles of a run, ms a frame: the first four of the whole, then each stage and job.
constexpr size_t kOfTheWhole = 4;
std::vector<Figure> figures_of(const RunLog& log) {
  std::vector<double> track_ms;
  double stage_ms[kStages] = {}, job_ms[platform::kJobs] = {}, all_ms = 0, mapping_ms = 0;
  for (const FrameLog& frame : log.frames) {
    track_ms.push_back(1e-6 * static_cast<double>(frame.track_ns));
    all_ms += track_ms.back();
    mapping_ms += 1e-6 * static_cast<double>(frame.mapping_ns);
    for (int s = 0; s < kStages; ++s) stage_ms[s] += 1e-6 * static_cast<double>(frame.stage_ns[s]);
    for (int j = 0; j < platform::kJobs; ++j) job_ms[j] += 1e-6 * static_cast<double>(frame.job_ns[j]);
  }
  const double frames = static_cast<double>(log.frames.size());
  std::vector<Figure> figures = {{"tracking, mean", all_ms / frames},
                                 {"tracking, median", platform::percentile(track_ms, 0.5)},
                                 {"tracking, 99 %", platform::percentile(track_ms, 0.99)},
                                 {"mapping, mean", mapping_ms / frames}};
  for (int s = 0; s < kStages; ++s)
    figures.push_back({std::string("  ") + platform::name_of(static_cast<Stage>(s)), stage_ms[s] / frames});
  for (int j = 0; j < platform::kJobs; ++j)
    figures.push_back({std::string("  ") + platform::name_of(platform::span_of_job(j)), job_ms[j] / frames});
  return figures;
}

platform::RunOptions phone_options() {
  platform::RunOptions options;
  options.capture_ns = kCapture_ns;
  options.display_ns = kDisplay_ns;
  return options;
}

RunLog run(const test::Recording& recording, std::function<std::unique_ptr<Clock>()> make_clock) {
  platform::RunOptions options = phone_options();
  options.make_clock = std::move(make_clock);
  test::Replay camera(recording);
  return platform::run_sequence(camera, options, [](const platform::CameraInfo&) {}, {});
}

// The frames, slices and taps of a run once more, in the work clock's time.
RunLog repeat(const test::Recording& recording, const RunLog& done) {
  const platform::RunOptions options = phone_options();
  const platform::Session session = platform::make_session(recording.info, options);
  RunLog log;
  log.dropped = done.dropped;
  for (const FrameLog& frame : done.frames) {
    for (int s = 0; s < frame.idle_slices; ++s) session.system->work_slice();
    if (log.frames.empty() || log.frames.back().state == TrackingState::kWaiting) session.system->tap();
    const int64_t start_ns = session.clock->now_ns();
    FrameLog entry = platform::log_of(session.system->track(recording.frame(frame.index)));
    entry.track_ns = session.clock->now_ns() - start_ns;
    session.tracer->take(&entry);
    log.frames.push_back(entry);
  }
  platform::take_map(*session.system, options, &log);
  return log;
}

int poses_of(const RunLog& log) {
  return static_cast<int>(
      std::count_if(log.frames.begin(), log.frames.end(), [](const FrameLog& f) { return f.pose_valid; }));
}

// Prints so many figures; returns how many are off.
int compare(const RunLog& counted, const RunLog& modelled, size_t figures) {
  const std::vector<Figure> executed = figures_of(counted), charged = figures_of(modelled);
  std::printf("%-18s %10s %10s %8s\n", "ms a frame", "counted", "work", "ratio");
  int wrong = 0;
  for (size_t i = 0; i < figures; ++i) {
    if (executed[i].ms <= 0) continue;
    const double ratio = charged[i].ms / executed[i].ms;
    const bool judged = executed[i].ms > kSmall * (executed[0].ms + executed[3].ms);
    const bool good = !judged || std::abs(ratio - 1) <= kTolerance;
    std::printf("%-18s %10.4f %10.4f %8.3f%s\n", executed[i].name.c_str(), executed[i].ms, charged[i].ms, ratio,
                good ? "" : "  FAILED");
    wrong += !good;
  }
  std::printf("frames %d and %d, dropped %d and %d, poses %d and %d, map %016llx and %016llx\n",
              static_cast<int>(counted.frames.size()), static_cast<int>(modelled.frames.size()), counted.dropped,
              modelled.dropped, poses_of(counted), poses_of(modelled),
              static_cast<unsigned long long>(counted.map_hash), static_cast<unsigned long long>(modelled.map_hash));
  return wrong;
}

// The exit code.
int compare_clocks(const test::Recording& recording) {
  const RunLog counted = run(recording, [] { return std::make_unique<CountedClock>(); });
  const RunLog repeated = repeat(recording, counted);
  std::printf("the same frames and slices\n");
  int wrong = compare(counted, repeated, kOfTheWhole + kStages + platform::kJobs);
  if (counted.map_hash != repeated.map_hash || poses_of(counted) != poses_of(repeated)) {
    std::printf("FAILED: the same work has another result\n");
    ++wrong;
  }
  const RunLog modelled = run(recording, nullptr);
  std::printf("each clock's own slices\n");
  wrong += compare(counted, modelled, kOfTheWhole);
  if (counted.dropped != modelled.dropped || 2 * poses_of(counted) < recording.size()) {
    std::printf("FAILED: frames dropped by one clock alone, or hardly any pose\n");
    ++wrong;
  }
  return wrong == 0 ? 0 : 1;
}

}  // namespace
}  // namespace pptam

int main(int argc, char** argv) {
  const std::string name = argc == 2 ? argv[1] : "";
  if (name != "desk" && pptam::sim::find_story(name) == nullptr) {
    std::fprintf(stderr, "Usage: counted_run desk|STORY\n");
    return 2;
  }
  const pptam::test::Recording recording = pptam::test::kept_recording(
      name, name == "desk" ? pptam::test::desk_options() : pptam::sim::phone_for_story(name, 1));
  if (pptam::test::kPhone && pptam::test::counter_available()) return pptam::compare_clocks(recording);
  std::printf("%d frames; nothing counts instructions here\n", recording.size());
  return 77;
}
