#include "sim_phone/laboratory/endurance.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <stdexcept>

#include "platform/input_error.h"
#include "platform/run/console.h"
#include "platform/run/evaluation.h"
#include "platform/run/interruption.h"
#include "platform/run/names.h"
#include "platform/run/statistics.h"
#include "platform/text.h"
#include "sim_phone/laboratory/judgement.h"
#include "sim_phone/random.h"

namespace pptam::laboratory {
namespace {

using namespace platform;

constexpr double kLap_s = 60;
constexpr int kJudgedMinute = 1;  // counted from 0: gives the alignment, and what later ones are compared with
constexpr double kMaxAteGrowth = 1.2;
constexpr double kMaxCostGrowth = 1.1;
constexpr double kRefind_s = 1;  // tracking cannot be expected for so long after a cover or a cut

// The lap's images and poses, rendered once.
struct Lap {
  platform::CameraInfo info;
  std::vector<std::vector<uint8_t>> images;
  platform::Trajectory truth;
};

Lap render(const sim::PhoneOptions& options, const std::function<void(int, int)>& progress) {
  Lap lap;
  const std::unique_ptr<platform::Camera> camera = sim::make_phone_camera(options);
  lap.info = camera->info();
  lap.truth = camera->ground_truth();
  Frame frame;
  while (camera->read(&frame)) {
    const size_t bytes = static_cast<size_t>(frame.stride_bytes) * static_cast<size_t>(frame.height);
    lap.images.emplace_back(frame.data, frame.data + bytes);
    progress(static_cast<int>(lap.images.size()), static_cast<int>(lap.truth.size()));
  }
  return lap;
}

// What is seen in each frame: a place of the lap, or nothing.
struct Plan {
  std::vector<int> place;
  std::vector<bool> covered;
  std::vector<bool> expected;
  std::vector<int> returns;  // frames at which a known view is back, or another one suddenly there
};

// One event in every half minute but in the first two minutes and the last, so that the two that are compared see the
// same whole lap: the lens is covered for one to three seconds while the
// hand goes on, or the view jumps to another place of the lap.
Plan make_plan(int frames, int lap_frames, double frames_per_s, uint64_t seed) {
  sim::Random random(seed, 140);
  const auto count = [frames_per_s](double s) { return static_cast<int>(std::lround(s * frames_per_s)); };
  Plan plan;
  plan.covered.assign(static_cast<size_t>(frames), false);
  plan.expected.assign(static_cast<size_t>(frames), true);
  std::vector<int> jump(static_cast<size_t>(frames), 0);
  const int half_minute = count(30);
  for (int begin = 4 * half_minute; begin + 3 * half_minute <= frames; begin += half_minute) {
    const int at = begin + random.integer(count(2), half_minute - count(6));
    int back = at;
    if (random.chance(0.5)) {
      jump[static_cast<size_t>(at)] = random.integer(lap_frames / 8, lap_frames - lap_frames / 8);
    } else {
      back = at + random.integer(count(1), count(3));
      for (int i = at; i < back; ++i) plan.covered[static_cast<size_t>(i)] = true;
    }
    for (int i = at; i < std::min(frames, back + count(kRefind_s)); ++i) plan.expected[static_cast<size_t>(i)] = false;
    plan.returns.push_back(back);
  }
  int place = 0;
  for (int i = 0; i < frames; ++i) {
    place = (place + jump[static_cast<size_t>(i)]) % lap_frames;
    plan.place.push_back(place);
    place = (place + 1) % lap_frames;
  }
  return plan;
}

class LapCamera : public platform::Camera {
 public:
  LapCamera(const Lap& lap, const Plan& plan) : lap_(lap), plan_(plan), info_(lap.info), black_(lap.images[0].size()) {
    info_.frame_count = static_cast<int>(plan.place.size());
    info_.name += ", round and round";
  }
  const platform::CameraInfo& info() const override { return info_; }
  platform::CameraEvent wait(Frame* frame, int64_t /*deadline_ns*/) override {
    if (next_ == plan_.place.size()) return platform::CameraEvent::kEnd;
    const size_t i = next_++;
    const auto place = static_cast<size_t>(plan_.place[i]);
    const std::vector<uint8_t>& image = plan_.covered[i] ? black_ : lap_.images[place];
    *frame = {image.data(), info_.model.width, info_.model.height, info_.model.width, PixelFormat::kGrey, timestamp(i)};
    return platform::CameraEvent::kFrame;
  }
  platform::Trajectory ground_truth() const override {
    platform::Trajectory truth;
    for (size_t i = 0; i < plan_.place.size(); ++i)
      truth.push_back({timestamp(i), lap_.truth[static_cast<size_t>(plan_.place[i])].T_wc});
    return truth;
  }

 private:
  int64_t timestamp(size_t i) const { return std::llround(1e9 * static_cast<double>(i) / info_.frames_per_s); }

  const Lap& lap_;
  const Plan& plan_;
  platform::CameraInfo info_;
  std::vector<uint8_t> black_;
  size_t next_ = 0;
};

std::vector<EnduranceMinute> judge_minutes(const RunLog& log, const platform::Trajectory& truth, const Plan& plan,
                                           int minute_frames, int minutes) {
  const auto minute_of = [minute_frames](const FrameLog& frame) { return frame.index / minute_frames; };
  platform::Trajectory early, early_truth;
  for (const FrameLog& frame : log.frames) {
    if (minute_of(frame) != kJudgedMinute || !frame.pose_valid) continue;
    early.push_back({frame.timestamp_ns, frame.T_wc});
    early_truth.push_back(truth[static_cast<size_t>(frame.index)]);
  }
  const platform::Similarity alignment = evaluate(early, early_truth, "the second minute", "ground truth").alignment;

  std::vector<EnduranceMinute> judged(static_cast<size_t>(minutes));
  std::vector<std::vector<double>> costs(judged.size());
  std::vector<double> squares(judged.size()), mapping(judged.size());
  std::vector<int> poses(judged.size());
  const double ns_to_m =
      1e-9 * static_cast<double>(PhoneProfile().clock_mhz) / static_cast<double>(PhoneProfile().cycles_per_instruction);
  for (const FrameLog& frame : log.frames) {
    const auto m = static_cast<size_t>(minute_of(frame));
    if (m >= judged.size()) continue;
    EnduranceMinute& minute = judged[m];
    ++minute.frames;
    minute.expected += plan.expected[static_cast<size_t>(frame.index)];
    minute.tracked += plan.expected[static_cast<size_t>(frame.index)] && frame.pose_valid;
    minute.limits_hit |= frame.limits_hit;
    minute.keyframes = frame.keyframes;
    minute.erased_keyframes = frame.erased_keyframes;
    minute.map_points = frame.map_points;
    if (frame.map_hash != 0) minute.map_hash = frame.map_hash;
    mapping[m] += static_cast<double>(frame.mapping_ns) * ns_to_m;
    if (!frame.pose_valid) continue;
    costs[m].push_back(1e-6 * static_cast<double>(frame.instructions));
    const Eigen::Vector3d& position = truth[static_cast<size_t>(frame.index)].T_wc.translation();
    squares[m] += (alignment * frame.T_wc.translation() - position).squaredNorm();
    ++poses[m];
  }
  for (size_t m = 0; m < judged.size(); ++m) {
    double sum = 0;
    for (const double cost : costs[m]) sum += cost;
    judged[m].minstructions = sum / std::max(1, poses[m]);
    judged[m].minstructions99 = percentile(costs[m], 0.99);
    judged[m].mapping_minstructions = mapping[m] / std::max(1, judged[m].frames);
    judged[m].ate_mm = 1e3 * std::sqrt(squares[m] / std::max(1, poses[m]));
  }
  const int limit = static_cast<int>(std::lround(kRefind_s * minute_frames / 60));
  for (const int back : plan.returns) {
    if (back + limit >= minutes * minute_frames) continue;
    EnduranceMinute& minute = judged[static_cast<size_t>(back / minute_frames)];
    ++minute.losses;
    // The frame a second after the return has a pose, and a right one.
    for (const FrameLog& frame : log.frames) {
      if (frame.index < back + limit) continue;
      const Eigen::Vector3d& position = truth[static_cast<size_t>(frame.index)].T_wc.translation();
      minute.recovered += frame.pose_valid && (alignment * frame.T_wc.translation() - position).norm() < 0.05;
      break;
    }
  }
  return judged;
}

}  // namespace

EnduranceReport endure(const EnduranceOptions& options, bool quiet) {
  if (options.minutes < 4 || options.minutes > 24 * 60)
    throw InputError("--endurance: minutes must be within 4 to 1440");
  sim::PhoneOptions phone = options.phone;
  phone.story.clear();
  phone.motion = "lap";
  phone.duration_s = kLap_s;
  phone.drop_probability = 0;
  sim::check_phone_options(phone);
  std::unique_ptr<Progress> progress = quiet ? nullptr : std::make_unique<Progress>();
  const auto show = [&](int done, int total, const std::string& text) {
    if (progress) progress->show(done, total, text);
  };
  const auto next_stage = [&] {
    if (progress) progress = std::make_unique<Progress>();
  };
  const Lap lap = render(phone, [&](int done, int total) { show(done, total, "of the lap rendered"); });
  next_stage();
  const int minute_frames = static_cast<int>(std::lround(60 * phone.frames_per_s));
  const int frames = options.minutes * minute_frames;
  const Plan plan = make_plan(frames, static_cast<int>(lap.images.size()), phone.frames_per_s, phone.seed);
  RunOptions run = options.run;
  run.hash_every = minute_frames - 1;  // near the end of each minute

  stop_on_signals();
  EnduranceReport report;
  for (int round = 0; round < (options.twice ? 2 : 1); ++round) {
    LapCamera camera(lap, plan);
    const RunLog log = run_sequence(
        camera, run, [](const platform::CameraInfo&) {},
        [&](const Frame&, const TrackResult&, const RunLog& so_far) {
          const FrameLog& entry = so_far.frames.back();
          show(so_far.source_frames, frames,
               format("%.0f s  %s, %d keyframes, %d erased, %d points", so_far.seconds(entry.timestamp_ns),
                      name_of(entry.state), entry.keyframes, entry.erased_keyframes, entry.map_points));
        });
    next_stage();
    if (!log.broken.empty()) throw std::runtime_error(log.broken + "; there is no result of a shorter time");
    std::vector<EnduranceMinute> minutes =
        judge_minutes(log, camera.ground_truth(), plan, minute_frames, options.minutes);
    if (round > 0) {
      for (size_t m = 0; m < minutes.size(); ++m)
        report.same_twice = report.same_twice && minutes[m].map_hash == report.minutes[m].map_hash;
      continue;
    }
    report.minutes = std::move(minutes);
    report.memory_bytes = log.memory_bytes;
    report.dropped = log.dropped;
    report.map_parts = log.map_parts;
  }

  const EnduranceMinute& early = report.minutes[kJudgedMinute];
  const EnduranceMinute& last = report.minutes.back();
  if (!(last.ate_mm <= kMaxAteGrowth * early.ate_mm))
    report.faults.push_back(format("the last minute's position error is %.2f times the second's, more than %.1f",
                                   last.ate_mm / early.ate_mm, kMaxAteGrowth));
  if (!(last.minstructions <= kMaxCostGrowth * early.minstructions))
    report.faults.push_back(format("a frame of the last minute costs %.2f times one of the second, more than %.1f",
                                   last.minstructions / early.minstructions, kMaxCostGrowth));
  if (report.map_parts != 1) report.faults.push_back(format("the map has come apart: %d parts", report.map_parts));
  if (!report.same_twice) report.faults.push_back("the second run's map is another one");
  return report;
}

bool run_endurance(const EnduranceOptions& options) {
  const EnduranceReport report = endure(options, false);
  std::vector<std::vector<std::string>> rows;
  for (size_t m = 0; m < report.minutes.size(); ++m) {
    const EnduranceMinute& minute = report.minutes[m];
    rows.push_back(
        {format("%zu", m + 1), format("%.2f", minute.ate_mm),
         format("%.1f", 100.0 * minute.tracked / std::max(1, minute.expected)),
         format("%d/%d", minute.recovered, minute.losses), format("%.2f", minute.minstructions),
         format("%.2f", minute.minstructions99), format("%.2f", minute.mapping_minstructions),
         format("%d", minute.keyframes), format("%d", minute.erased_keyframes), format("%d", minute.map_points),
         format("%016llx", static_cast<unsigned long long>(minute.map_hash)), limit_names(minute.limits_hit)});
  }
  print_table({"minute", "ATE mm", "tracked %", "found", "frame M", "99 %", "mapping M", "keyframes", "erased",
               "points", "map hash", "limits"},
              rows);
  std::printf(
      "\nATE: by the alignment of minute %d. tracked: where it can be expected. found: of the covered and cut views, "
      "with a right pose after %.0f s.\nM: million modelled instructions, of a tracked frame, and of mapping a frame.\n"
      "memory: %.1f MB, all of it from the start. Frames dropped: %d. Parts of the map: %d.%s\n",
      kJudgedMinute + 1, kRefind_s, 1e-6 * static_cast<double>(report.memory_bytes), report.dropped, report.map_parts,
      options.twice ? (report.same_twice ? " The second run gave the same maps." : "") : "");
  for (const std::string& fault : report.faults) print_line("not met: " + fault);
  if (report.faults.empty()) std::printf("all criteria are met\n");
  std::fflush(stdout);
  return report.faults.empty();
}

}  // namespace pptam::laboratory
