// Not one allocation from create() to the end of a whole replay, mapping included. An executable of its own: it
// replaces the global operator new, and its link wraps malloc and its relatives (-Wl,--wrap).
#include <gtest/gtest.h>

#include <cstdlib>
#include <new>

#include "tests/support/recording.h"
#include "tests/support/rendered_object.h"
#include "tests/support/tracker_in_memory.h"

namespace {
long allocations = 0;
}  // namespace

extern "C" {
void* __real_malloc(size_t size);
void* __real_calloc(size_t count, size_t size);
void* __real_realloc(void* block, size_t size);
void* __wrap_malloc(size_t size);
void* __wrap_calloc(size_t count, size_t size);
void* __wrap_realloc(void* block, size_t size);
void* __wrap_malloc(size_t size) {
  ++allocations;
  return __real_malloc(size);
}
void* __wrap_calloc(size_t count, size_t size) {
  ++allocations;
  return __real_calloc(count, size);
}
void* __wrap_realloc(void* block, size_t size) {
  ++allocations;
  return __real_realloc(block, size);
}
}

// Never inlined: the compiler would warn of new and free in one function.
[[gnu::noinline]] void* operator new(size_t size) {
  ++allocations;
  void* block = __real_malloc(size > 0 ? size : 1);
  if (!block) throw std::bad_alloc();
  return block;
}
[[gnu::noinline]] void* operator new[](size_t size) {
  return operator new(size);
}
[[gnu::noinline]] void operator delete(void* block) noexcept {
  std::free(block);
}
[[gnu::noinline]] void operator delete[](void* block) noexcept {
  std::free(block);
}
[[gnu::noinline]] void operator delete(void* block, size_t) noexcept {
  std::free(block);
}
[[gnu::noinline]] void operator delete[](void* block, size_t) noexcept {
  std::free(block);
}

namespace pptam {
namespace {

TEST(NoHeap, TrackingAndMappingAllocateNothing) {
  sim::PhoneOptions options;
  options.duration_s = 8;
  const test::Recording recording = test::record(options);
  test::Phone phone(test::config_for(recording));
  std::vector<KeyframeInfo> keyframes(40);
  std::vector<MapPointInfo> points(1000);
  std::vector<MeasurementInfo> measurements(9000);
  std::vector<std::byte> saved(4 * 1000 * 1000);
  size_t saved_bytes = 0;

  const long before = allocations;
  int poses = 0, most_keyframes = 0;
  bool lost = false;
  std::vector<int>* control = nullptr;
  phone->tap();
  for (int i = 0; i < recording.size(); ++i) {
    const TrackResult result = phone->track(recording.frame(i));
    poses += result.pose_valid;
    most_keyframes = std::max(most_keyframes, result.keyframes);
    while (phone->has_work()) phone->work_slice();
    phone->keyframes(keyframes);
    phone->map_points(points);
    phone->measurements(measurements);
  }
  const bool saved_and_loaded =
      phone->save_map(saved, &saved_bytes).ok() && phone->load_map(std::span(saved).first(saved_bytes)).ok();
  int64_t now_ns = recording.timestamps_ns.back();
  for (int i = 0; i < 30; ++i) {  // another place: lost, and the relocaliser at work
    now_ns += 66666667;
    lost |= phone->track(recording.frame(i % 2 ? 0 : recording.size() / 2, now_ns)).state == TrackingState::kLost;
    while (phone->has_work()) phone->work_slice();
  }
  phone->reset();
  phone->tap();
  phone->work_slice();
  const long during = allocations - before;

  EXPECT_EQ(during, 0);
  EXPECT_GT(poses, 20) << "the replay must have a map, or nothing was tested";
  EXPECT_GE(most_keyframes, 4);
  EXPECT_TRUE(saved_and_loaded);
  EXPECT_TRUE(lost) << "the relocaliser must have worked";

  // The counter counts.
  control = new std::vector<int>(100);
  EXPECT_EQ(allocations - before - during, 2);
  delete control;
  void* volatile block = std::malloc(10);
  std::free(block);
  EXPECT_EQ(allocations - before - during, 3);
}

// The model-based tracker: started, followed, lost, and found again.
TEST(NoHeap, AKnownObjectIsTrackedWithoutAllocations) {
  const test::RenderedObject object = test::box();
  test::TrackerInMemory tracker(test::config_of(object, test::small_camera()));
  std::vector<std::vector<uint8_t>> images;
  for (int i = 0; i < 6; ++i)
    images.push_back(object.render(test::small_camera(), test::swaying(static_cast<float>(i))));
  images.emplace_back(320 * 240, uint8_t{90});
  const std::vector<int> shown = {0, 1, 2, 3, 4, 5, 6, 6, 6, 6, 6, 5, 5, 5, 5};
  std::vector<Vector3f> points;
  std::vector<Vector2f> px;
  for (const size_t corner : {size_t{0}, size_t{1}, size_t{3}, size_t{6}}) {
    points.push_back(object.points[corner]);
    px.emplace_back();
    ASSERT_TRUE(test::small_camera().project(test::swaying(0) * points.back(), &px.back()));
  }
  const long before = allocations;
  const bool started = tracker->start(points, px).ok();
  int poses = 0, lost = 0;
  bool back = false;
  for (const int i : shown) {
    const ModelResult r = tracker.track(images[static_cast<size_t>(i)]);
    poses += r.pose_valid;
    lost += r.state == ModelState::kLost;
    back = r.pose_valid;
  }
  const long during = allocations - before;
  EXPECT_EQ(during, 0);
  EXPECT_TRUE(started);
  EXPECT_GE(poses, 6);
  EXPECT_GT(lost, 0) << "the restart must have worked, too";
  EXPECT_TRUE(back);
}

}  // namespace
}  // namespace pptam
