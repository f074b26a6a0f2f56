// What mapping costs on the phone's ARM1176, counted: a culling decision, the insertion of a keyframe, and the longest
// slice of idle time in whole runs; and whether the work meter, by which slices end, says the same.
//
// Where nothing counts instructions the work meter's figures are held against the same budgets.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "mapping/keyframe_votes.h"
#include "mapping/mapper.h"
#include "tests/budget/count_table.h"
#include "tests/budget/painted_run.h"
#include "tests/budget/parts.h"
#include "tests/support/map_building.h"
#include "tests/support/phone_camera.h"
#include "tests/support/random.h"

namespace pptam {
namespace {

using test::Counts;
using test::Parts;
using test::Region;

bool counted() {
  return test::kPhone && test::counter_available();
}

// A piece of work, counted if that is possible, and as charged.
struct Spent {
  Counts counts;
  int64_t charged = 0;
  int64_t units[kWorkKinds] = {};
  int64_t instructions() const { return counted() ? counts.instructions : charged; }
  void operator+=(const Spent& other) {
    counts.instructions += other.counts.instructions;
    counts.cycles += other.counts.cycles;
    charged += other.charged;
  }
};

// Charged by the phone's figures, whatever the meter's own are.
Spent spend(const WorkMeter& meter, const std::function<void()>& work) {
  const PhoneProfile phone;
  Spent spent;
  for (int k = 0; k < kWorkKinds; ++k) spent.units[k] = meter.units(static_cast<Work>(k));
  const Region region;
  work();
  spent.counts = region.spent();
  double charged = 0;
  for (int k = 0; k < kWorkKinds; ++k) {
    spent.units[k] = meter.units(static_cast<Work>(k)) - spent.units[k];
    charged += static_cast<double>(spent.units[k]) * static_cast<double>(phone.instructions[static_cast<size_t>(k)]);
  }
  spent.charged = static_cast<int64_t>(charged);
  return spent;
}

bool less(const Spent& a, const Spent& b) {
  return a.instructions() < b.instructions();
}

// ------------------------------------------------------------------------------------------------------------- culling

// The paper's map: 35 keyframes, 300 points, 8 measurements each.
class Culling : public Background {
 public:
  Culling(Arena& arena, const Config& config, WorkMeter& meter)
      : Background(arena, 8192, meter), map(arena, config), culling_(arena, config, map, meter, *this) {}

  void fill(const Camera& camera) {
    test::Random random;
    for (int k = 0; k < 35; ++k)
      test::add_keyframe(map, SE3(Matrix3f::Identity(), Vector3f(-0.005f * static_cast<float>(k), 0, 0)));
    for (int i = 0; i < 300; ++i) {
      const Vector3f p_w = {static_cast<float>(random.uniform(-0.1, 0.1)),
                            static_cast<float>(random.uniform(-0.15, 0.15)),
                            static_cast<float>(random.uniform(0.9, 1.1))};
      const int point = map.add_point(p_w, {});
      for (int k = 0; k < 8; ++k)
        map.add_measurement(point, test::measure_exactly(map, camera, random.integer(0, 3) + 4 * k, p_w));
      MapAccess::point(map, point).source.keyframe = map.measurements(map.points()[point])[0].keyframe;
    }
  }
  std::vector<Spent> decide() {
    done_ = false;
    task_ = Task<>();  // frames are last in, first out
    task_ = decision();
    std::vector<Spent> slices = {pptam::spend(meter_, [this] { task_.start(); })};
    while (!done_) slices.push_back(pptam::spend(meter_, [this] { resume(); }));
    return slices;
  }

  Map map;

 private:
  Task<> decision() {
    co_await culling_.choose();
    done_ = true;
  }
  KeyframeVotes culling_;
  Task<> task_;
  bool done_ = false;
};

void count_culling(test::Table* table) {
  Config config = Config::phone(test::phone_camera());
  config.camera.model.prepare();
  Arena measure;
  WorkMeter meter;
  { const Culling nothing(measure, config, meter); }
  std::vector<std::max_align_t> memory(measure.used() / sizeof(std::max_align_t) + 1);
  Arena arena(std::as_writable_bytes(std::span(memory)));
  Culling culling(arena, config, meter);
  culling.fill(config.camera);
  culling.resume();  // nothing to do: a slice begins

  const std::vector<Spent> slices = culling.decide();
  Spent decision;
  for (const Spent& slice : slices) decision += slice;
  const Spent longest = *std::max_element(slices.begin(), slices.end(), less);
  EXPECT_LE(decision.instructions(), 2'000'000);
  EXPECT_LE(longest.instructions(), kSliceInstructions);
  EXPECT_GE(slices.size(), 3u);

  Similarity turn;
  turn.T = SE3::exp(Vector6f::Constant(0.01f));
  const Counts coordinates = test::count([&] { culling.map.apply(turn); });
  if (!counted()) return;
  EXPECT_NEAR(static_cast<double>(decision.charged) / static_cast<double>(decision.counts.instructions), 1, 0.15);
  table->add("culling decision: 35 keyframes, 300 points", decision.counts, 2e6);
  table->add("its longest slice", longest.counts, static_cast<double>(kSliceInstructions));
  table->add("new coordinates for that map", coordinates, kSliceInstructions / 2.0);  // cannot pause

  // Control: slices that do not end are seen.
  PhoneProfile free;
  free.instructions.fill(0);
  meter.set_profile(free);
  const std::vector<Spent> endless = culling.decide();
  EXPECT_EQ(endless.size(), 1u);
  EXPECT_GT(endless[0].counts.instructions, kSliceInstructions);
}

// ---------------------------------------------------------------------------------------------------------- whole runs

constexpr int kFrames = 165;
constexpr int kKeyframes = 18;  // few, so that the run ends with culling
constexpr int kSlices = 60;     // of 0.25 million instructions: 15 of the 18 million between frames

Config run_config(const test::PaintedRun& run) {
  Config config = run.config();
  config.max_keyframes = kKeyframes;
  config.max_erased_keyframes = 1;
  return config;
}

const char* name_of(Work kind) {
  constexpr const char* kNames[] = {"kGreyPixel",       "kPyramidPixel",   "kCornerPixel",      "kCornerAscent",
                                    "kRotationPixel",   "kPointProjected", "kPatchWarp",        "kPatchCandidate",
                                    "kPatchRefineStep", "kPosePoint",      "kPoseProjection",   "kHomographyPoint",
                                    "kKeyframePixel",   "kBundleError",    "kBundleProjection", "kBundleMotion",
                                    "kBundleBlock",     "kBundleSolve",    "kBundleStep",       "kOther"};
  static_assert(std::size(kNames) == kWorkKinds);
  return kNames[static_cast<int>(kind)];
}

// A run in which the phone has as much idle time as usual: a start, a growing map, culling.
void count_slices(test::Table* table) {
  test::PaintedRun run;
  Parts parts(run_config(run));
  std::vector<Spent> slices;
  int most_erased = 0, tracked = 0;
  for (int i = 0; i < kFrames; ++i) {
    tracked += parts.tracker->track(run.frame(i), nullptr).pose_valid;
    for (int s = 0; s < kSlices && parts.mapper->has_work(); ++s)
      slices.push_back(spend(parts.meter, [&] { parts.mapper->work_slice(); }));
    most_erased = std::max(most_erased, parts.map.erased_count());
  }
  // Thirty frames before the map; of the others nearly all.
  EXPECT_GT(tracked, 110);
  EXPECT_GT(most_erased, 0) << "the run must come to culling";
  Spent all;
  for (const Spent& slice : slices) all += slice;
  const Spent longest = *std::max_element(slices.begin(), slices.end(), less);
  EXPECT_LE(longest.instructions(), kSliceInstructions);
  if (!counted()) return;
  EXPECT_NEAR(static_cast<double>(all.charged) / static_cast<double>(all.counts.instructions), 1, 0.1);
  std::printf("the longest slice charged, of %lld instructions:", static_cast<long long>(longest.charged));
  for (int k = 0; k < kWorkKinds; ++k)
    if (longest.units[k] != 0)
      std::printf(" %lld %s", static_cast<long long>(longest.units[k]), name_of(static_cast<Work>(k)));
  std::printf("\n");
  table->add("longest slice of a run", longest.counts, static_cast<double>(kSliceInstructions));
}

// The same with idle time without end, so that each keyframe finds the mapper at rest and its insertion begins a slice.
void count_insertions(test::Table* table) {
  test::PaintedRun run;
  Parts parts(run_config(run));
  PhoneProfile dear;  // everything that is charged ends the slice
  dear.instructions.fill(1e6f);
  struct Insertion {
    Spent spent;
    int points = 0;
  };
  std::vector<Insertion> insertions;
  for (int i = 0; i < kFrames; ++i) {
    parts.tracker->track(run.frame(i), nullptr);
    while (parts.mapper->has_work()) {
      const bool inserts = parts.map.ready() && parts.map.queue().waiting() > 0 && parts.map.live_count() <= kKeyframes;
      Spent spent = spend(parts.meter, [&] { parts.mapper->work_slice(); });
      if (!inserts) continue;
      ASSERT_EQ(parts.map.queue().waiting(), 0);
      // The corners come last. From the first one's slice on the slices are as short as can be, so that the first that
      // seeks none, bundle adjustment's, is told apart.
      Insertion insertion;
      insertion.points = parts.map.point_count();
      bool corners = false;
      for (;;) {
        const bool seeks = spent.units[static_cast<int>(Work::kCornerPixel)] > 0 ||
                           spent.units[static_cast<int>(Work::kCornerAscent)] > 0;
        if (corners && !seeks) break;
        insertion.spent += spent;
        if (seeks && !corners) parts.meter.set_profile(dear);
        corners = corners || seeks;
        ASSERT_TRUE(parts.mapper->has_work());
        spent = spend(parts.meter, [&] { parts.mapper->work_slice(); });
      }
      parts.meter.set_profile(PhoneProfile());
      insertions.push_back(insertion);
    }
  }
  EXPECT_GT(parts.map.erased_count(), 0) << "the run must come to culling";
  ASSERT_GE(insertions.size(), 10u);
  std::sort(insertions.begin(), insertions.end(),
            [](const Insertion& a, const Insertion& b) { return less(a.spent, b.spent); });
  Spent all;
  for (const Insertion& insertion : insertions) all += insertion.spent;
  const Insertion& worst = insertions.back();
  EXPECT_GE(worst.points, 200) << "a map of the usual size";
  EXPECT_LE(worst.spent.instructions(), 4'000'000);
  if (!counted()) return;
  EXPECT_NEAR(static_cast<double>(all.charged) / static_cast<double>(all.counts.instructions), 1, 0.1);
  table->add("keyframe inserted, median", insertions[insertions.size() / 2].spent.counts, 4e6);
  table->add("keyframe inserted, worst", worst.spent.counts, 4e6);
}

TEST(Budget, OfMapping) {
  test::Table table("mapping on an ARM1176");
  count_culling(&table);
  count_insertions(&table);
  count_slices(&table);
  if (!counted()) GTEST_SKIP() << "nothing counts instructions here: tests/run.sh runs this on an emulated ARM1176";
  table.print();
  table.check(PPTAM_MAPPING_COUNTS);
}

}  // namespace
}  // namespace pptam
