#include "tests/bench/ratio_report.h"

#include <algorithm>
#include <cstdio>

namespace pptam::bench {
namespace {

// Who stands beside whom. opencv_bench.cpp says what each peer does.
struct Comparison {
  const char* ours;
  const char* theirs;
};
constexpr Comparison kComparisons[] = {
    {"ours/grey_bgra", "opencv/cvtColor_bgra"},
    {"ours/grey_rgb", "opencv/cvtColor_rgb"},
    {"ours/grey_yuyv", "opencv/cvtColor_yuyv"},
    {"ours/pyramid", "opencv/pyrDown"},
    {"ours/pyramid", "opencv/resize_area"},
    {"ours/corners", "opencv/goodFeaturesToTrack"},
    {"ours/pyramid_corners", "opencv/goodFeaturesToTrack"},
    {"ours/warp_50", "opencv/warpAffine_50"},
    {"ours/search_50", "opencv/matchTemplate_50"},
    {"ours/refine_50", "opencv/LK_refine_50"},
    {"ours/points_50", "opencv/LK_prebuilt"},
    {"ours/points_50", "opencv/LK_8x8_prebuilt"},
    {"ours/points_50", "opencv/LK_8x8_as_ours"},
    {"ours/pyramid_points_50", "opencv/LK"},
    {"ours/pyramid_points_50", "opencv/LK_8x8"},
};

// The stricter reading of each: the faster of two pyramids; points with the pyramids on both sides and on neither. LK's
// defaults have a window of 21 pixels: ours, 8 in L1, covers 16 of the image.
struct Target {
  const char* what;
  double ratio;
  std::vector<Comparison> against;
};
const Target kTargets[] = {
    {"corners at least 5 times faster than goodFeaturesToTrack at equal count",
     5,
     {{"ours/corners", "opencv/goodFeaturesToTrack"}}},
    {"50 points at least 2 times faster than calcOpticalFlowPyrLK with its defaults",
     2,
     {{"ours/points_50", "opencv/LK_prebuilt"}, {"ours/pyramid_points_50", "opencv/LK"}}},
    {"50 points no slower than calcOpticalFlowPyrLK with a window of 8x8 and three levels",
     1,
     {{"ours/points_50", "opencv/LK_8x8_prebuilt"}, {"ours/pyramid_points_50", "opencv/LK_8x8"}}},
    {"pyramid no slower than OpenCV's",
     1,
     {{"ours/pyramid", "opencv/pyrDown"}, {"ours/pyramid", "opencv/resize_area"}}},
};

}  // namespace

bool RatioReport::ReportContext(const Context& context) {
  // Not PrintBasicContext(): it takes Debian's library, which is optimised but keeps its assertions, for a debug build.
  std::printf("%d processors at %.0f MHz", context.cpu_info.num_cpus, context.cpu_info.cycles_per_second * 1e-6);
  if (!context.cpu_info.load_avg.empty()) std::printf(", load average %.1f", context.cpu_info.load_avg[0]);
  std::printf("\n");
  std::fflush(stdout);
  return true;
}

void RatioReport::ReportRuns(const std::vector<Run>& runs) {
  for (const Run& run : runs) {
    if (run.error_occurred) {
      std::fprintf(stderr, "error: %s: %s\n", run.benchmark_name().c_str(), run.error_message.c_str());
      failed_ = true;
    } else if (run.run_type == Run::RT_Iteration) {
      const std::string name = run.run_name.function_name;
      times_[name].push_back(run.cpu_accumulated_time / static_cast<double>(run.iterations) * 1e6);
    }
  }
}

double RatioReport::median(const std::string& name) const {
  const auto it = times_.find(name);
  if (it == times_.end()) return 0;
  std::vector<double> times = it->second;
  std::sort(times.begin(), times.end());
  return 0.5 * (times[(times.size() - 1) / 2] + times[times.size() / 2]);
}

double RatioReport::fastest(const std::string& name) const {
  const auto it = times_.find(name);
  return it == times_.end() ? 0 : *std::min_element(it->second.begin(), it->second.end());
}

bool RatioReport::print() const {
  std::printf("\n%-28s %12s %12s\n", "CPU time, microseconds", "median", "fastest");
  for (const auto& [name, times] : times_)
    std::printf("%-28s %12.2f %12.2f\n", name.c_str(), median(name), fastest(name));

  bool heading = false;
  for (const Comparison& c : kComparisons) {
    if (median(c.ours) == 0 || median(c.theirs) == 0) continue;
    if (!heading) std::printf("\n%-24s %-28s %10s %14s\n", "theirs / ours", "", "median", "fastest");
    heading = true;
    std::printf("%-24s %-28s %10.2f %14.2f\n", c.ours, c.theirs, median(c.theirs) / median(c.ours),
                fastest(c.theirs) / fastest(c.ours));
  }

  std::printf("\ntargets (medians, with the peer that decides)\n");
  bool all_met = !failed_;
  for (const Target& target : kTargets) {
    double worst = 0;
    const Comparison* decides = nullptr;
    bool measured = true;
    for (const Comparison& c : target.against) {
      measured = measured && median(c.ours) > 0 && median(c.theirs) > 0;
      if (!measured) break;
      const double ratio = median(c.theirs) / median(c.ours);
      if (!decides || ratio < worst) {
        worst = ratio;
        decides = &c;
      }
    }
    const bool met = measured && worst >= target.ratio;
    all_met = all_met && met;
    if (measured) {
      std::printf("%-10s %s: %.2f (%s)\n", met ? "met" : "not met", target.what, worst, decides->theirs);
    } else {
      std::printf("%-10s %s\n", "unmeasured", target.what);
    }
  }
  return all_met;
}

}  // namespace pptam::bench
