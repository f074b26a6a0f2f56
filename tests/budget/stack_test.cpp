// How deep the stack gets in a frame and in a slice of mapping: embedders give a thread a few kilobytes.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <vector>

#include "tests/budget/painted_run.h"
#include "tests/budget/parts.h"
#include "tests/support/rendered_object.h"
#include "tests/support/tracker_in_memory.h"

namespace pptam {
namespace {

constexpr size_t kPainted = 64 * 1024;
constexpr unsigned char kPaint = 0xA5;

// Fills what lies below the caller's stack frame.
[[gnu::noinline]] void paint() {
  unsigned char below[kPainted];
  std::memset(below, kPaint, kPainted);
  asm volatile("" : : "r"(below) : "memory");  // it is done, though nobody here reads it
}
// How much of it has been written since, from the same caller: the deepest byte that is no longer as painted.
[[gnu::noinline]] size_t used() {
  unsigned char below[kPainted];
  asm volatile("" : : "r"(below) : "memory");  // what is there stays to be seen
  size_t untouched = 0;
  while (untouched < kPainted && below[untouched] == kPaint) ++untouched;
  return kPainted - untouched;
}

template <class Work>
[[gnu::noinline]] size_t stack_of(const Work& work) {
  paint();
  work();
  return used();
}

[[gnu::noinline]] void write_kilobytes(int count) {
  volatile unsigned char bytes[1024];
  for (size_t i = 0; i < sizeof bytes; ++i) bytes[i] = static_cast<unsigned char>(count);
  if (count > 1) write_kilobytes(count - 1);
  bytes[0] = 0;
}

TEST(Stack, IsMeasured) {
  const size_t nothing = stack_of([] {}), ten = stack_of([] { write_kilobytes(10); });
  EXPECT_LT(nothing, 512u);
  EXPECT_GE(ten, 10 * 1024u);
  EXPECT_LE(ten, 13 * 1024u);
}

TEST(Stack, OfAFrameAndOfASlice) {
  test::PaintedRun run;
  test::Parts parts(run.config());
  size_t start = 0, tracked = 0, slice = 0;
  int frames = 0;
  for (int i = 0; i < 75; ++i) {
    const Frame frame = run.frame(i);
    TrackResult result;
    const size_t bytes = stack_of([&] { result = parts.tracker->track(frame, nullptr); });
    size_t& most = result.pose_valid ? tracked : start;
    most = std::max(most, bytes);
    frames += result.pose_valid;
    for (int s = 0; s < 60 && parts.mapper->has_work(); ++s)
      slice = std::max(slice, stack_of([&] { parts.mapper->work_slice(); }));
  }
  ASSERT_GT(frames, 20);
  // The relocaliser's frames are tracked with a map too.
  parts.tracker->begin_lost();
  for (int i = 75; i < 78; ++i) {
    const Frame frame = run.frame(i);
    tracked = std::max(tracked, stack_of([&] { parts.tracker->track(frame, nullptr); }));
  }
  std::printf("stack, bytes: a tracked frame %zu, a frame of the start %zu, a slice of mapping %zu\n", tracked, start,
              slice);
  EXPECT_LE(tracked, 8 * 1024u);
  EXPECT_LE(start, 8 * 1024u);
  EXPECT_LE(slice, 8 * 1024u);
}

TEST(Stack, OfAModelFrame) {
  const test::RenderedObject object = test::box();
  test::TrackerInMemory tracker(test::config_of(object, test::small_camera()));
  ASSERT_TRUE(tracker->start(test::swaying(0)).ok());
  std::vector<std::vector<uint8_t>> images = {object.render(test::small_camera(), test::swaying(0)),
                                              object.render(test::small_camera(), test::swaying(1)),
                                              std::vector<uint8_t>(320 * 240, 90)};
  size_t most = 0;
  int poses = 0;
  for (const int i : {0, 1, 0, 2, 2, 2, 2, 2, 1, 1}) {  // started, followed, lost, sought
    ModelResult r;
    most = std::max(most, stack_of([&] { r = tracker.track(images[static_cast<size_t>(i)]); }));
    poses += r.pose_valid;
  }
  EXPECT_GE(poses, 4);
  std::printf("stack, bytes: a frame of the model-based tracker %zu\n", most);
  EXPECT_LE(most, 8 * 1024u);
}

}  // namespace
}  // namespace pptam
