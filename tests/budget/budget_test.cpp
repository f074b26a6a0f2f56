// What a frame costs in instructions executed on the phone's ARM1176, stage by stage.
//
// An emulated phone looks at a desk, a map is started, and frames are tracked as in use. Whole frames are counted
// through the library's clock interface, kernels alone on one of the frames. The counts come from the emulator and are
// the same in every run of one executable. armv6_counts.txt keeps them, so that a change must be deliberate:
// PPTAM_UPDATE_COUNTS=1 writes it anew. On other processors there is nothing to count.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include <pocket_ptam/image.h>
#include "image/corners.h"
#include "map/patch_search.h"
#include "tests/budget/count_table.h"
#include "tests/budget/instruction_counter.h"
#include "tests/budget/kept_recording.h"
#include "tests/budget/parts.h"
#include "tests/kernels/test_images.h"

namespace pptam {
namespace {

using test::count;
using test::Counts;
using test::median;
using test::Parts;
using test::Recording;
using test::Region;
using test::Table;
using test::worst;

const Recording& recording() {
  static const Recording made = test::kept_recording("desk", test::desk_options());
  return made;
}

// "Time" in executed instructions.
class CountedClock final : public Clock {
 public:
  int64_t now_ns() const override { return region_.spent().instructions; }
  void idle_until(int64_t) override {}

 private:
  Region region_;
};

// -------------------------------------------------------------------------------------------------------------- counts

// The frames from the tap to the first pose in a scene without a dominant plane, where the search for the motion costs
// most.
std::vector<Counts> start_in_clutter() {
  const Recording start = test::kept_recording("clutter", test::clutter_options());
  Parts parts(test::config_for(start));
  std::vector<Counts> frames;
  for (int i = 0; i < start.size(); ++i) {
    const Region region;
    const TrackResult result = parts.tracker->track(start.frame(i), nullptr);
    frames.push_back(region.spent());
    if (result.pose_valid) return frames;
    parts.map_a_while();
  }
  ADD_FAILURE() << "no map in clutter";
  return frames;
}

// Every map point that the last frame's search tried, once more, with its own source, warp and prediction.
void search_again(const Parts& parts, const Pyramid& pyramid, const TrackResult& result, int* searched, int* found) {
  WorkMeter meter;
  const PatchFinder finder(parts.map, parts.config, meter);
  for (const ObservedPoint& observed : result.points) {
    for (const MapPoint& point : parts.map.points()) {
      if (point.id != observed.point_id) continue;
      ImagePoint at;
      *found += finder.find(point.source, point.p_w, {observed.predicted_px, result.T_cw}, pyramid, SearchOptions(),
                            &at) == SearchOutcome::kFound;
      ++*searched;
      break;
    }
  }
}

TEST(Budget, OfAFrame) {
  if (!test::kPhone || !test::counter_available())
    GTEST_SKIP() << "nothing counts instructions here: tests/run.sh runs this on an emulated ARM1176";
  Parts parts(test::config_for(recording()));
  const CountedClock clock;
  std::vector<Counts> initialising, tracked;
  std::vector<Counts> stages[kStages];
  TrackResult result;
  for (int i = 0; i < recording().size(); ++i) {
    const Region region;
    result = parts.tracker->track(recording().frame(i), &clock);
    const Counts spent = region.spent();
    if (result.pose_valid) {
      tracked.push_back(spent);
      for (int s = 0; s < kStages; ++s) stages[s].push_back({result.stage_ns[s], 0});
    } else if (result.state == TrackingState::kInitialising) {
      initialising.push_back(spent);
    }
    parts.map_a_while();
  }
  ASSERT_GT(tracked.size(), 20u);

  constexpr int kWidth = 240, kHeight = 320;
  std::vector<std::max_align_t> memory(1 << 15);
  Arena arena(std::as_writable_bytes(std::span(memory)));
  const PyramidStorage storage(arena, kWidth, kHeight, 1), converted(arena, kWidth, kHeight, 1);
  CornerDetector detector(arena, kWidth, kHeight);
  ASSERT_FALSE(arena.overflowed());
  const Frame last = recording().frame(recording().size() - 1);
  const Pyramid pyramid = build_pyramid({last.data, kWidth, kHeight, kWidth}, storage);
  std::vector<uint8_t> grey(kWidth * kHeight), colours(grey.size() * 4);
  for (size_t i = 0; i < colours.size(); ++i) colours[i] = last.data[i / 4];
  const auto grey_and_pyramid = [&](PixelFormat format, int bytes_per_pixel) {
    return count([&] {
      const Frame frame = {colours.data(), kWidth, kHeight, kWidth * bytes_per_pixel, format, 0};
      build_pyramid(to_grey(frame, {grey.data(), kWidth, kHeight, kWidth}), converted);
    });
  };

  Table table("240x320 on an ARM1176");
  table.add("grey or planar YUV: pyramid", grey_and_pyramid(PixelFormat::kNv12, 1), 0.55e6);
  table.add("BGRA: grey and pyramid", grey_and_pyramid(PixelFormat::kBgra, 4), 1.0e6);
  table.add("YUYV: grey and pyramid", grey_and_pyramid(PixelFormat::kYuyv, 2), 0.65e6);
  table.add("RGB: grey and pyramid", grey_and_pyramid(PixelFormat::kRgb24, 3), 1.4e6);

  int searched = 0, found = 0;
  const Counts points = count([&] { search_again(parts, pyramid, result, &searched, &found); });
  EXPECT_EQ(searched, 50);
  EXPECT_GE(found, 40);
  table.add("50 points warped, searched, refined", points, 1.6e6);

  std::vector<Corner> corners(100);
  size_t corner_count = 0;
  const Counts first_view =
      count([&] { corner_count = static_cast<size_t>(detector.detect(pyramid, CornerParams(), corners)); });
  EXPECT_EQ(corner_count, corners.size());
  table.add("100 corners of a first view", first_view, 1.3e6);
  const Counts keyframe = count([&] {
    corner_count = static_cast<size_t>(detector.detect(pyramid, CornerParams(), std::span(corners).first(25)));
  });
  EXPECT_EQ(corner_count, 25u);
  table.add("25 corners of a keyframe", keyframe, 0.65e6);

  const auto stage = [&](Stage s) -> const std::vector<Counts>& { return stages[static_cast<int>(s)]; };
  table.add("tracked frame: pyramid, small image", median(stage(Stage::kPyramid)), 0.25e6);
  table.add("tracked frame: full-frame rotation", median(stage(Stage::kRotation)), 0.25e6);
  table.add("tracked frame: points", median(stage(Stage::kSearch)), 2.0e6);
  table.add("tracked frame: pose", median(stage(Stage::kPose)), 0.5e6);
  table.add("tracked frame: partial points", median(stage(Stage::kPartial)), 0.7e6);
  table.add("tracked frame, median", median(tracked), 2.2e6);
  table.add("tracked frame, worst", worst(tracked), 3.5e6);
  table.add("initialising frame, median", median(initialising), 3.0e6);
  table.add("initialising frame, worst", worst(initialising), 4.0e6);
  table.add("start in clutter: frame, worst", worst(start_in_clutter()), 6.0e6);
  table.print();
  table.check(PPTAM_COUNTS);
}

TEST(Budget, AChangeOfTwoPerCentIsSeen) {
  EXPECT_TRUE(Table::unchanged(1'009'000, 1'000'000));
  EXPECT_FALSE(Table::unchanged(1'020'000, 1'000'000));
  EXPECT_FALSE(Table::unchanged(980'000, 1'000'000));
}

// The counter itself: an empty region costs next to nothing, a loop the same each time and in proportion.
TEST(Counter, IsProportionalAndRepeatable) {
  if (!test::counter_available()) GTEST_SKIP() << "nothing counts instructions here";
  const auto loop = [](int n) {
    return count([n] {
             [[maybe_unused]] volatile int sink = 0;
             for (int i = 0; i < n; ++i) sink = i;
           })
        .instructions;
  };
  constexpr int64_t kSlack = 20;  // calls and returns round the counted code
  EXPECT_NEAR(count([] {}).instructions, 0, kSlack);
  const int64_t once = loop(1000), twice = loop(2000);
  EXPECT_NEAR(loop(1000), once, 2);
  EXPECT_NEAR(loop(2000), twice, 2);
  EXPECT_GE(once, 3000);  // store, count, branch at least
  EXPECT_NEAR(loop(3000) - twice, twice - once, 4);
}

}  // namespace
}  // namespace pptam
