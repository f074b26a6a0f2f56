// The emulated phone looks at a desk, a map is started, and frames are tracked: one hash of all results, the same on
// every processor and by every compiler.
#include <gtest/gtest.h>

#include "tests/budget/parts.h"
#include "tests/kernels/test_images.h"
#include "tests/support/recording.h"

namespace pptam {
namespace {

using test::Parts;
using test::Recording;
using test::Trace;

const Recording& recording() {
  static const Recording made = [] {
    sim::PhoneOptions options;
    options.duration_s = 6;
    return test::record(options);
  }();
  return made;
}

struct Hashes {
  uint64_t frames = 0;   // what the camera saw
  uint64_t results = 0;  // what came out: every result, and the map after every frame
  int poses = 0;
};

Hashes run_and_hash(int changed_frame) {
  Parts parts(test::config_for(recording()));
  test::Fnv frames;
  test::Trace trace;
  Hashes hashes;
  std::vector<uint8_t> pixels;
  for (int i = 0; i < recording().size(); ++i) {
    Frame frame = recording().frame(i);
    pixels.assign(frame.data, frame.data + frame.stride_bytes * frame.height);
    if (i == changed_frame) pixels[pixels.size() / 2] ^= 0x80;
    frame.data = pixels.data();
    frames.add(pixels.data(), pixels.size());
    const TrackResult result = parts.tracker->track(frame, nullptr);
    hashes.poses += result.pose_valid;
    trace.add(result);
    parts.map_a_while();
    trace.add_value(static_cast<int64_t>(parts.map.hash()));
  }
  test::Fnv results;
  results.add(trace.bytes.data(), trace.bytes.size());
  hashes.frames = frames.value();
  hashes.results = results.value();
  return hashes;
}

TEST(Bits, AreTheSameOnEveryTarget) {
  const Hashes hashes = run_and_hash(-1);
  EXPECT_GT(hashes.poses, 25) << "the run must have a map, or nothing is compared";
  ASSERT_EQ(hashes.frames, 0xec03541461a0277bu)
      << "the emulated phone's images differ: nothing can be said of the library";
  EXPECT_EQ(hashes.results, 0xa6b51a72a0422dfeu);
#ifndef __arm__  // minutes in emulation
  EXPECT_NE(run_and_hash(10).results, hashes.results) << "control: one pixel of one early frame";
#endif
}

}  // namespace
}  // namespace pptam
