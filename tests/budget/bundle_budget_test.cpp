// What bundle adjustment costs on the phone's ARM1176, counted: an iteration of the paper's size, its longest slice,
// and whether the work meter, by which the phone's time is planned, says the same.
#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <vector>

#include "tests/budget/count_table.h"
#include "tests/support/engine_run.h"

namespace pptam {
namespace {

using test::Counts;
using test::Region;

struct Iteration {
  Counts counted;
  int64_t modelled = 0;
  std::vector<Counts> slices;
};

// From one accepted step to the next: scale, linearisation, reduced system, solution, evaluation, acceptance. The
// difference between runs of three iterations and of one, so that nothing else is in it.
Iteration iteration(int views, int points, bool velocities) {
  test::BundleProblemOptions options;
  options.views = views;
  options.points = points;
  const test::BundleProblem problem = test::make_bundle_problem(options, 1);
  Iteration spent;
  const auto run = [&](int steps, int sign) {
    auto engine = test::make_engine<float>(problem, velocities);
    engine->meter().set_profile(PhoneProfile());
    const Region whole;
    Region slice;
    engine->run(BundleOptions(), steps, [&] {
      spent.slices.push_back(slice.spent());
      slice = Region();
    });
    EXPECT_EQ(engine->iterations(), steps);
    EXPECT_EQ(engine->attempts(), steps) << "a rejected step would be counted too";
    spent.modelled += sign * engine->meter().instructions() / 2;
    return whole.spent();
  };
  const Counts one = run(1, -1);
  const Counts three = run(3, 1);
  // Without the reading of the counter in the pauses, which takes a hundredth.
  spent.counted = {(three.instructions - one.instructions) / 2, (three.cycles - one.cycles) / 2};
  return spent;
}

TEST(Budget, OfABundleIteration) {
  if (!test::kPhone || !test::counter_available())
    GTEST_SKIP() << "nothing counts instructions here: tests/run.sh runs this on an emulated ARM1176";
  test::Table table("bundle adjustment on an ARM1176");
  const auto add = [&](const std::string& name, int views, int points, bool velocities, double budget) {
    const Iteration spent = iteration(views, points, velocities);
    table.add(name, spent.counted, budget);
    const double ratio = static_cast<double>(spent.modelled) / static_cast<double>(spent.counted.instructions);
    EXPECT_NEAR(ratio, 1, 0.1) << name << ": the work meter's figures are off";
    return spent;
  };
  const Iteration paper = add("iteration: 35 keyframes, 300 points", 35, 300, false, 15e6);
  table.add("its longest slice", test::worst(paper.slices), static_cast<double>(kSliceInstructions));
  const Iteration moving = add("iteration: 16 keyframes, 150 points, velocities", 16, 150, true, 15e6);
  table.add("its longest slice, velocities", test::worst(moving.slices), static_cast<double>(kSliceInstructions));
  add("iteration: 35 keyframes, 300 points, velocities", 35, 300, true, 45e6);
  table.print();
  table.check(PPTAM_BUNDLE_COUNTS);
}

}  // namespace
}  // namespace pptam
