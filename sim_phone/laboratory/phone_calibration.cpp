#include "sim_phone/laboratory/phone_calibration.h"

#include <algorithm>
#include <cmath>
#include <ctime>
#include <filesystem>
#include <memory>
#include <string_view>

#include "platform/input_error.h"
#include "platform/outputs.h"
#include "platform/run/console.h"
#include "platform/run/interruption.h"
#include "platform/run/names.h"
#include "platform/run/session.h"
#include "platform/text.h"
#include "platform/text_file.h"
#include "sim_phone/laboratory/keeping_camera.h"
#include "sim_phone/phone_camera.h"

namespace pptam::laboratory {
namespace {

using namespace platform;

constexpr int kRepeats = 3;                               // of which each stage's least time counts. Not swept
constexpr int kFitRounds = 300;                           // made-up spans agree to 0.1 % after some fifty
constexpr double kMost = 1e5;                             // instructions a unit, and
constexpr double kMostCycles = 100, kLeastCycles = 0.01;  // of an instruction, as a profile may hold them
constexpr double kUnknownClock_mhz = 1000;
constexpr std::string_view kProfileHead = "# pocket-ptam phone 1";

int64_t thread_ns() {
  timespec time = {};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<int64_t>(time.tv_sec) * 1'000'000'000 + time.tv_nsec;
}

double armv6_instructions(const SpanWork& work) {
  const PhoneProfile armv6;
  double sum = 0;
  for (size_t k = 0; k < kWorkKinds; ++k) sum += work.units[k] * static_cast<double>(armv6.instructions[k]);
  return sum;
}

// Every stage and slice in turn. The same frames give the same ones again, whatever they took.
class Stopwatch final : public Tracer {
 public:
  explicit Stopwatch(const System& system) : meter_(system.work_meter()) {}

  void begin(Span span) override {
    if (span == Span::kFrame || span == Span::kSlice) return;  // what is in them is told apart
    now_.span = span;
    for (size_t k = 0; k < kWorkKinds; ++k) now_.units[k] = meter_.units(static_cast<Work>(k));
    begun_ns_ = thread_ns();
  }
  void end(Span span) override {
    const int64_t end_ns = thread_ns();
    if (span != now_.span) return;
    now_.ns = end_ns - begun_ns_;
    for (size_t k = 0; k < kWorkKinds; ++k) now_.units[k] = meter_.units(static_cast<Work>(k)) - now_.units[k];
    try {
      pieces_.push_back(now_);
    } catch (const std::bad_alloc&) {  // the core is built without exceptions
      full_ = true;
    }
  }
  void count(Counter, int64_t) override {}

  struct Piece {
    Span span = Span::kFrame;
    int64_t ns = 0;
    std::array<int64_t, kWorkKinds> units = {};
  };
  const std::vector<Piece>& pieces() const { return pieces_; }
  bool full() const { return full_; }

 private:
  const WorkMeter& meter_;
  Piece now_;
  int64_t begun_ns_ = 0;
  std::vector<Piece> pieces_;
  bool full_ = false;
};

// By the work clock of the paper's phone, so that every repetition has the same stages and slices.
std::vector<Stopwatch::Piece> timed(KeepingCamera* camera) {
  const Session session = make_session(camera->info(), RunOptions());
  System& system = *session.system;
  WorkClock clock(system.work_meter());
  Stopwatch stopwatch(system);
  system.set_clock(nullptr);
  system.set_tracer(&stopwatch);
  camera->again();
  bool waiting = true;
  for (Frame frame; camera->read(&frame);) {
    while (clock.now_ns() < frame.timestamp_ns && system.has_work()) system.work_slice();
    clock.idle_until(frame.timestamp_ns);
    if (waiting) system.tap();
    waiting = system.track(frame).state == TrackingState::kWaiting;
    if (interrupted()) throw InputError("budget --calibrate: " + interruption() + ", nothing was written");
  }
  if (stopwatch.full()) throw InputError("budget --calibrate: not enough memory for the times of a story");
  return stopwatch.pieces();
}

// What one reading of the clock costs, ns.
double clock_cost_ns() {
  constexpr int kReadings = 1000;
  const int64_t from_ns = thread_ns();
  for (int i = 1; i < kReadings; ++i) thread_ns();
  return static_cast<double>(thread_ns() - from_ns) / kReadings;
}

void add_story(KeepingCamera* camera, SpanWorks* sums) {
  std::vector<Stopwatch::Piece> least = timed(camera);
  for (int i = 1; i < kRepeats; ++i) {
    const std::vector<Stopwatch::Piece> again = timed(camera);
    for (size_t p = 0; p < std::min(least.size(), again.size()); ++p) least[p].ns = std::min(least[p].ns, again[p].ns);
  }
  const double cost_ns = clock_cost_ns();
  for (const Stopwatch::Piece& piece : least) {
    SpanWork& sum = (*sums)[static_cast<size_t>(piece.span)];
    sum.ns += std::max(0.0, static_cast<double>(piece.ns) - cost_ns);
    for (size_t k = 0; k < kWorkKinds; ++k) sum.units[k] += static_cast<double>(piece.units[k]);
  }
}

double modelled_by(const PhoneProfile& processor, const SpanWork& work) {
  double instructions = 0;
  for (size_t k = 0; k < kWorkKinds; ++k)
    instructions += work.units[k] * static_cast<double>(processor.instructions[k]);
  return instructions * static_cast<double>(processor.cycles_per_instruction) * 1e3 /
         static_cast<double>(processor.clock_mhz);
}

std::string camera_lines(const Phone& like) {
  std::string text;
  const auto add = [&](const char* key, const auto& value) {
    if (value) text += format("  %s: %.9g\n", key, static_cast<double>(*value));
  };
  add("width", like.width);
  add("height", like.height);
  add("horizontal_fov_degrees", like.horizontal_fov_degrees);
  add("frames_per_s", like.frames_per_s);
  if (like.readout_s) {
    text += format("  readout_s: %.9g\n  readout_axis: %s\n  readout_direction: %d\n", std::abs(*like.readout_s),
                   name_of(like.readout_axis), *like.readout_s < 0 ? -1 : 1);
  }
  add("exposure_s", like.exposure_s);
  return text.empty() ? text : "camera:\n" + text;
}

}  // namespace

double Calibration::modelled_ns(Span span) const {
  return modelled_by(processor, measured[static_cast<size_t>(span)]);
}

PhoneProfile fit_processor(const SpanWorks& measured, double clock_mhz) {
  const PhoneProfile armv6;
  double all_ns = 0, all = 0;
  for (const SpanWork& work : measured) {
    const double instructions = armv6_instructions(work);
    if (!(work.ns > 0) || !(instructions > 0)) continue;
    all_ns += work.ns;
    all += instructions;
  }
  if (!(all_ns > 0)) throw InputError("budget --calibrate: nothing of it took any time");
  PhoneProfile fitted = armv6;
  fitted.clock_mhz = static_cast<float>(clock_mhz);
  const double cycles = std::clamp(1e-3 * clock_mhz * all_ns / all, kLeastCycles, kMostCycles);
  fitted.cycles_per_instruction = static_cast<float>(cycles);
  std::array<double, kWorkKinds> factor;
  factor.fill(1);
  for (int round = 0; round < kFitRounds; ++round) {
    std::array<double, kWorkKinds> off = {}, weight = {};
    for (const SpanWork& work : measured) {
      const double modelled_ns = modelled_by(fitted, work);
      if (!(work.ns > 0) || !(modelled_ns > 0)) continue;
      const double ratio = std::log(work.ns / modelled_ns);
      for (size_t k = 0; k < kWorkKinds; ++k) {
        const double share = work.units[k] * static_cast<double>(fitted.instructions[k]);
        off[k] += share * ratio;
        weight[k] += share;
      }
    }
    for (size_t k = 0; k < kWorkKinds; ++k) {
      if (weight[k] > 0) factor[k] *= std::exp(off[k] / weight[k]);
      fitted.instructions[k] =
          static_cast<float>(std::min(kMost, factor[k] * static_cast<double>(armv6.instructions[k])));
    }
  }
  return fitted;
}

Calibration calibrate(const BudgetOptions& options, double clock_mhz) {
  check_budget(options);
  Calibration calibration;
  for (const std::string& story : options.stories) {
    KeepingCamera camera(sim::make_phone_camera(phone_of(options, story)));
    camera.keep_all();  // rendered before anything is timed
    add_story(&camera, &calibration.measured);
  }
  calibration.processor = fit_processor(calibration.measured, clock_mhz);
  return calibration;
}

double clock_rate_mhz() {
  constexpr const char* kFile = "/sys/devices/system/cpu/cpu0/cpufreq/cpuinfo_max_freq";
  std::error_code ignored;
  if (!std::filesystem::exists(kFile, ignored)) return kUnknownClock_mhz;
  int64_t khz = 0;
  const std::string text = read_text(kFile, 4096);
  if (!parse_integer(trimmed(std::string_view(text).substr(0, text.find('\n'))), &khz) || khz < 1000 ||
      khz > 100'000'000)
    return kUnknownClock_mhz;
  return 1e-3 * static_cast<double>(khz);
}

std::string profile_text(const Phone& like, const Calibration& calibration) {
  const PhoneProfile& processor = calibration.processor;
  std::string text = std::string(kProfileHead).append(", ").append(kOpenSeal);
  text +=
      "\n# Its processor is a computer on which stages and slices were timed. Camera, capture and display are those "
      "of\n";
  text += "# another phone: change them to what they are.\n";
  text += "says: calibrated by pocket-ptam budget --calibrate; capture and display assumed\n";
  text += format("processor:\n  clock_mhz: %.9g\n  cycles_per_instruction: %.6g\n",
                 static_cast<double>(processor.clock_mhz), static_cast<double>(processor.cycles_per_instruction));
  text += camera_lines(like);
  text += format("frame:\n  capture_ms: %.9g\n  display_ms: %.9g\ninstructions:\n",
                 1e-6 * static_cast<double>(like.capture_ns), 1e-6 * static_cast<double>(like.display_ns));
  for (size_t k = 0; k < kWorkKinds; ++k)
    text += format("  %s: %.6g\n", work_name(static_cast<Work>(k)), static_cast<double>(processor.instructions[k]));
  return sealed(std::move(text));
}

bool is_profile(std::span<const std::byte> content) {
  const std::string_view text(reinterpret_cast<const char*>(content.data()), content.size());
  return text.starts_with(kProfileHead) && is_sealed(content);
}

void print_calibration(const Calibration& calibration) {
  std::vector<std::vector<std::string>> rows;
  rows.reserve(kSpans);
  for (int s = 0; s < kSpans; ++s) {
    const double ns = calibration.measured[static_cast<size_t>(s)].ns;
    if (!(ns > 0)) continue;
    const double modelled_ns = calibration.modelled_ns(static_cast<Span>(s));
    rows.push_back({name_of(static_cast<Span>(s)), format("%.3f", 1e-6 * ns), format("%.3f", 1e-6 * modelled_ns),
                    format("%.2f", modelled_ns / ns)});
  }
  print_table({"stage, ms in all", "timed", "by the profile", "ratio"}, rows);
}

}  // namespace pptam::laboratory
