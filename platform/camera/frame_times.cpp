#include "platform/camera/frame_times.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <numeric>

#include <pocket_ptam/clock.h>
#include "platform/text.h"
#include "platform/trajectory.h"

namespace pptam::platform {
namespace {

// None of these is swept.
constexpr double kMinStepS = 1.0 / 500;  // seconds; faster cameras are not held in a hand
constexpr double kMaxStepS = 2;          // seconds; with less than a frame in that time nothing can be tracked
constexpr double kMaxSlowStepS = 3600;   // seconds; time lapses are not slower
constexpr size_t kJumpFrames = 3;        // stamps in a row that rise from a new base: not a single bad one
constexpr size_t kRecent = 32;           // frames before a jump whose usual step bridges it
constexpr double kGapSteps = 3;          // usual steps, and
constexpr double kGapS = 0.2;            // seconds, over which frames are missing
constexpr double kGapShare = 0.1;        // of all steps; where more are that long, the rate just varies
constexpr size_t kBurstSpan = 8;         // steps whose mean tells the rate though frames come in bursts
constexpr double kShortStep = 0.25;      // of that mean: within a burst, and
constexpr double kBurstShare = 0.2;      // of the steps, from which on the stamps are those of arrival
constexpr ptrdiff_t kMinPauses = 3;      // between bursts: fewer are gaps
constexpr size_t kMaxMixedSteps = 2;     // steps that sorting may shorten: a swapped pair, not two clocks

constexpr std::array kUnits = {TimeUnit::kSeconds, TimeUnit::kMilliseconds, TimeUnit::kMicroseconds,
                               TimeUnit::kNanoseconds};
constexpr std::array kUnitNames = {"seconds", "milliseconds", "microseconds", "nanoseconds"};

const char* unit_name(TimeUnit unit) {
  return kUnitNames[static_cast<size_t>(unit)];
}

double step_s(int64_t from_ns, int64_t to_ns) {
  return 1e-9 * static_cast<double>(saturated_difference(to_ns, from_ns));
}

double middle(std::vector<double> values) {
  if (values.empty()) return 0;
  std::nth_element(values.begin(), values.begin() + static_cast<ptrdiff_t>(values.size() / 2), values.end());
  return values[values.size() / 2];
}

struct Pace {
  double usual_s = 0;  // from one frame to the next; 0: unknown
  bool bursts = false;
};

Pace pace_of(const std::vector<int64_t>& times_ns) {
  Pace pace;
  if (times_ns.size() < 2) return pace;
  std::vector<double> steps;
  for (size_t i = 1; i < times_ns.size(); ++i) steps.push_back(step_s(times_ns[i - 1], times_ns[i]));
  pace.usual_s = middle(steps);
  if (times_ns.size() <= kBurstSpan) return pace;
  std::vector<double> means;
  for (size_t i = kBurstSpan; i < times_ns.size(); ++i) {
    means.push_back(step_s(times_ns[i - kBurstSpan], times_ns[i]) / static_cast<double>(kBurstSpan));
  }
  const double mean = middle(means);
  const auto short_steps = std::count_if(steps.begin(), steps.end(), [&](double s) { return s < kShortStep * mean; });
  const auto long_steps = static_cast<ptrdiff_t>(steps.size()) - short_steps;
  const bool pauses_recur = long_steps * static_cast<ptrdiff_t>(kBurstSpan + 1) >= static_cast<ptrdiff_t>(steps.size());
  const bool many_short = static_cast<double>(short_steps) > kBurstShare * static_cast<double>(steps.size());
  if (many_short && pauses_recur && long_steps >= kMinPauses) pace = {mean, true};
  return pace;
}

std::string rate_text(double usual_s) {
  return usual_s > 0 ? format("%.3g frames/s", 1 / usual_s) : "endlessly many frames/s";
}

// All of them sorted, each once; false when one cannot be read, or they differ by less than can be told.
bool read_stamps(const std::vector<std::string>& stamps, TimeUnit unit, std::vector<int64_t>* times_ns) {
  times_ns->clear();
  for (const std::string& text : stamps) {
    int64_t stamp_ns = 0;
    if (!parse_stamp(text, unit, &stamp_ns)) return false;
    times_ns->push_back(stamp_ns);
  }
  std::sort(times_ns->begin(), times_ns->end());
  times_ns->erase(std::unique(times_ns->begin(), times_ns->end()), times_ns->end());
  return times_ns->size() >= 2 || stamps.size() < 2;
}

// Between 2001 and 2100, as times since 1970.
bool is_since_1970(int64_t time_ns) {
  return time_ns >= 1000000000 * int64_t{1000000000} && time_ns < 4102444800 * int64_t{1000000000};
}

size_t short_steps_of(const std::vector<int64_t>& times_ns, double usual_s) {
  size_t count = 0;
  for (size_t i = 1; i < times_ns.size(); ++i) {
    const double step = step_s(times_ns[i - 1], times_ns[i]);
    if (step >= 0 && step < 0.5 * usual_s) ++count;
  }
  return count;
}

}  // namespace

std::optional<int64_t> FrameTimes::next(int64_t stamp_ns) {
  ++frames_;
  const bool rises = stamp_ns > last_stamp_ns_;
  last_stamp_ns_ = stamp_ns;
  int64_t time_ns = saturated_sum(stamp_ns, offset_ns_);
  if (!times_ns_.empty() && time_ns <= times_ns_.back()) {
    rising_ = rises ? rising_ + 1 : 1;
    const std::vector<int64_t> recent(times_ns_.end() - static_cast<ptrdiff_t>(std::min(times_ns_.size(), kRecent)),
                                      times_ns_.end());
    const double usual_s = rising_ < kJumpFrames ? 0 : std::min(pace_of(recent).usual_s, kMaxStepS);
    const int64_t behind_ns = saturated_sum(times_ns_.back(), std::max<int64_t>(std::llround(1e9 * usual_s), 1));
    if (rising_ < kJumpFrames || behind_ns <= times_ns_.back()) {
      if (left_out_++ == 0) first_left_out_ = frames_;
      return std::nullopt;
    }
    if (jumps_++ == 0) first_jump_ = frames_;
    joints_.push_back(times_ns_.size());
    offset_ns_ = saturated_difference(behind_ns, stamp_ns);
    time_ns = behind_ns;
  }
  rising_ = 0;
  times_ns_.push_back(time_ns);
  return time_ns;
}

double FrameTimes::frames_per_s() const {
  const double usual_s = pace_of(times_ns_).usual_s;
  return usual_s > 0 ? 1 / usual_s : 0;
}

std::vector<std::string> FrameTimes::remarks() const {
  std::vector<std::string> lines;
  if (left_out_ > 0) {
    lines.push_back(format("%zu of %zu frames are left out: their times are not later than the one before (first: %zu)",
                           left_out_, frames_, first_left_out_));
  }
  if (jumps_ > 0) {
    lines.push_back(format("the times jump back at frame %zu%s: what follows is put behind what came before",
                           first_jump_, jumps_ > 1 ? format(" and %zu more", jumps_ - 1).c_str() : ""));
  }
  const Pace pace = pace_of(times_ns_);
  if (times_ns_.size() < 2) return lines;
  if (pace.usual_s < kMinStepS || pace.usual_s > kMaxStepS) {
    lines.push_back("its times mean " + rate_text(pace.usual_s) + ", which is not plausible: check their unit");
    return lines;
  }
  if (pace.bursts) {
    lines.push_back("frames come in bursts of " + rate_text(pace.usual_s) +
                    " on average: these look like times of arrival, and poses suffer; record the camera's own times");
    return lines;
  }
  size_t gaps = 0;
  double longest_s = 0;
  size_t longest_at = 0;
  for (size_t i = 1; i < times_ns_.size(); ++i) {
    const double step = step_s(times_ns_[i - 1], times_ns_[i]);
    if (step <= kGapSteps * pace.usual_s || step <= kGapS) continue;
    if (std::binary_search(joints_.begin(), joints_.end(), i)) continue;
    ++gaps;
    if (step > longest_s) {
      longest_s = step;
      longest_at = i;
    }
  }
  if (gaps > 0 && static_cast<double>(gaps) <= std::max(1.0, kGapShare * static_cast<double>(times_ns_.size()))) {
    lines.push_back(format("frames are missing at %zu place%s, the longest gap has %.3g s (%.2f s after the start)",
                           gaps, gaps > 1 ? "s" : "", longest_s, step_s(times_ns_[0], times_ns_[longest_at - 1])));
  }
  return lines;
}

bool is_plausible(const std::vector<int64_t>& times_ns) {
  const Pace pace = pace_of(times_ns);
  return pace.usual_s == 0 ? times_ns.size() < 2 : pace.usual_s >= kMinStepS && pace.usual_s <= kMaxStepS;
}

bool in_bursts(const std::vector<int64_t>& times_ns) {
  return pace_of(times_ns).bursts;
}

std::vector<int64_t> evened_out(const std::vector<int64_t>& times_ns) {
  // Half weight at both ends: pairs, and bursts of four and of eight, vanish exactly. Beyond the first and the last
  // frame times go on as if mirrored there.
  constexpr auto kReach = static_cast<ptrdiff_t>(kBurstSpan / 2);
  const auto last = static_cast<ptrdiff_t>(times_ns.size()) - 1;
  const auto since = [&](ptrdiff_t from, ptrdiff_t i) {
    const ptrdiff_t inside = std::clamp<ptrdiff_t>(i < 0 ? -i : (i > last ? 2 * last - i : i), 0, last);
    const auto at = [&](ptrdiff_t k) {
      return saturated_difference(times_ns[static_cast<size_t>(k)], times_ns[static_cast<size_t>(from)]);
    };
    const ptrdiff_t edge = i < 0 ? 0 : last;
    return static_cast<double>(i == inside ? at(i)
                                           : saturated_difference(saturated_sum(at(edge), at(edge)), at(inside)));
  };
  std::vector<int64_t> evened;
  for (ptrdiff_t i = 0; i <= last; ++i) {
    double sum = 0.5 * (since(i, i - kReach) + since(i, i + kReach));
    for (ptrdiff_t k = 1 - kReach; k < kReach; ++k) sum += since(i, i + k);
    const double shift =
        std::clamp(sum / static_cast<double>(kBurstSpan), -1e15, 1e15);  // 12 days: for llround's range
    evened.push_back(saturated_sum(times_ns[static_cast<size_t>(i)], std::llround(shift)));
  }
  return evened;
}

bool parse_stamp(std::string_view text, TimeUnit unit, int64_t* stamp_ns) {
  const size_t mark = std::min(text.find_first_of("eE"), text.size());
  int exponent = 0;
  if (mark < text.size()) {  // 1.305031102e+18, as numpy writes it
    const size_t digits = mark + (text.substr(mark + 1).starts_with('+') ? 2 : 1);
    const auto [end, error] = std::from_chars(text.data() + digits, text.data() + text.size(), exponent);
    if (error != std::errc() || end != text.data() + text.size() || std::abs(exponent) > 90) return false;
  }
  exponent -= 3 * static_cast<int>(unit);
  return parse_timestamp_s(std::string(text.substr(0, mark)) + "e" + std::to_string(exponent), stamp_ns);
}

TimeUnit recognised_unit(const std::vector<std::string>& stamps, TimeUnit documented, std::string* remark) {
  std::vector<int64_t> times_ns;
  const bool fits = read_stamps(stamps, documented, &times_ns);
  if (fits && is_plausible(times_ns)) return documented;
  const double usual_s = fits ? pace_of(times_ns).usual_s : 0;
  const auto choose = [&](TimeUnit unit) {
    if (unit != documented) {
      const std::string why = fits ? "mean " + rate_text(usual_s) : "do not fit";
      *remark = std::string("its times ") + why + " as " + unit_name(documented) + ": read as " + unit_name(unit);
    }
    return unit;
  };
  const auto dated = [&](TimeUnit unit) {  // also slow ones, such as a picture a minute
    return read_stamps(stamps, unit, &times_ns) && pace_of(times_ns).usual_s <= kMaxSlowStepS &&
           is_since_1970(times_ns[times_ns.size() / 2]);
  };
  for (const TimeUnit unit : kUnits) {
    if (dated(unit) && (unit == documented || is_plausible(times_ns))) return choose(unit);
  }
  for (const TimeUnit unit : kUnits) {
    if (read_stamps(stamps, unit, &times_ns) && is_plausible(times_ns)) return choose(unit);
  }
  for (const TimeUnit unit : kUnits) {
    if (dated(unit)) return choose(unit);
  }
  return documented;
}

std::vector<size_t> order_in_time(const std::vector<int64_t>& stamps_ns) {
  std::vector<size_t> order(stamps_ns.size());
  std::iota(order.begin(), order.end(), size_t{0});
  if (std::is_sorted(stamps_ns.begin(), stamps_ns.end())) return order;

  std::vector<double> rising_steps;
  for (size_t i = 1; i < stamps_ns.size(); ++i) {
    const double step = step_s(stamps_ns[i - 1], stamps_ns[i]);
    if (step > 0) rising_steps.push_back(step);
  }
  const size_t runs = stamps_ns.size() - rising_steps.size();
  const double usual_s = middle(rising_steps);
  std::vector<size_t> sorted = order;
  std::stable_sort(sorted.begin(), sorted.end(), [&](size_t a, size_t b) { return stamps_ns[a] < stamps_ns[b]; });
  std::vector<int64_t> sorted_ns;
  sorted_ns.reserve(sorted.size());
  for (const size_t i : sorted) sorted_ns.push_back(stamps_ns[i]);
  const bool long_runs = kJumpFrames * runs <= stamps_ns.size();
  const bool mixes = short_steps_of(sorted_ns, usual_s) > short_steps_of(stamps_ns, usual_s) + kMaxMixedSteps;
  return long_runs && mixes ? order : sorted;
}

}  // namespace pptam::platform
