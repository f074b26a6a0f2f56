// What the work meter charges beside what an ARM1176 executes, over a whole run: stage by stage of its frames, and by
// what mapping works on. Times of the work clock are as good as this.
#include <gtest/gtest.h>

#include <array>
#include <cstdio>
#include <iterator>
#include <vector>

#include <pocket_ptam/tracer.h>
#include "tests/budget/count_table.h"
#include "tests/budget/instruction_counter.h"
#include "tests/budget/kept_recording.h"
#include "tests/budget/parts.h"

namespace pptam {
namespace {

using test::Parts;
using test::Recording;
using test::Region;

constexpr const char* kSpanNames[] = {"frame",     "  pyramid",    "  rotation", "  search", "  pose",
                                      "  partial", "  initialise", "  keyframe", "slice",    "  finish map",
                                      "  insert",  "  adjust new", "  adjust",   "  cull",   "  tidy"};
static_assert(std::size(kSpanNames) == kSpans);

struct Spent {
  int64_t executed = 0, charged = 0;
};

// Adds up both in each span.
class Comparer final : public Tracer {
 public:
  explicit Comparer(const WorkMeter& meter) : meter_(meter) {}
  void begin(Span span) override { open_.push_back({span, now()}); }
  void end(Span span) override {
    ASSERT_FALSE(open_.empty());
    ASSERT_EQ(open_.back().span, span);
    const Spent at = now();
    Spent& sum = sums_[static_cast<size_t>(span)];
    sum.executed += at.executed - open_.back().at.executed;
    sum.charged += at.charged - open_.back().at.charged;
    open_.pop_back();
  }
  void count(Counter, int64_t) override {}
  const Spent& of(Span span) const { return sums_[static_cast<size_t>(span)]; }

 private:
  struct Open {
    Span span;
    Spent at;
  };
  Spent now() const { return {region_.spent().instructions, meter_.instructions()}; }

  const WorkMeter& meter_;
  Region region_;
  std::vector<Open> open_;
  std::array<Spent, kSpans> sums_ = {};
};

double ratio(const Spent& work) {
  return static_cast<double>(work.charged) / static_cast<double>(work.executed);
}

TEST(Budget, OfTheWorkMeter) {
  if (!test::kPhone || !test::counter_available())
    GTEST_SKIP() << "nothing counts instructions here: tests/run.sh runs this on an emulated ARM1176";
  constexpr double kStage = 0.1, kAll = 0.05;
  // Stages below this share of all work are told, not judged: the estimates of small things are rough.
  constexpr double kSmall = 0.01;
  const Recording recording = test::kept_recording("desk", test::desk_options());
  Parts parts(test::config_for(recording));
  Comparer comparer(parts.meter);
  int poses = 0;
  for (int i = 0; i < recording.size(); ++i) {
    comparer.begin(Span::kFrame);
    poses += parts.tracker->track(recording.frame(i), nullptr, &comparer).pose_valid;
    comparer.end(Span::kFrame);
    for (int s = 0; s < 60 && parts.mapper->has_work(); ++s) parts.mapper->work_slice(&comparer);
  }
  ASSERT_GT(poses, 25) << "the run must have a map, or little is compared";
  Spent all = comparer.of(Span::kFrame);
  all.executed += comparer.of(Span::kSlice).executed;
  all.charged += comparer.of(Span::kSlice).charged;
  std::printf("\n%-14s %14s %14s %8s\n", "million", "executed", "charged", "ratio");
  for (int s = 0; s < kSpans; ++s) {
    const Spent& work = comparer.of(static_cast<Span>(s));
    if (work.executed == 0) continue;
    std::printf("%-14s %14.2f %14.2f %8.3f\n", kSpanNames[s], 1e-6 * static_cast<double>(work.executed),
                1e-6 * static_cast<double>(work.charged), ratio(work));
    if (static_cast<double>(work.executed) > kSmall * static_cast<double>(all.executed)) {
      EXPECT_NEAR(ratio(work), 1, kStage) << kSpanNames[s];
    }
  }
  std::printf("%-14s %14.2f %14.2f %8.3f\n\n", "all", 1e-6 * static_cast<double>(all.executed),
              1e-6 * static_cast<double>(all.charged), ratio(all));
  EXPECT_NEAR(ratio(all), 1, kAll);
}

}  // namespace
}  // namespace pptam
