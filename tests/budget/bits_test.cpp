// The emulated phone looks at a desk, a map is started, and frames are tracked: one hash of all results, the same on
// every processor and by every compiler.
#include <gtest/gtest.h>
#include <unistd.h>

#include "tests/budget/kept_recording.h"
#include "tests/budget/parts.h"
#include "tests/kernels/test_images.h"

namespace pptam {
namespace {

using test::Parts;
using test::Recording;
using test::Trace;

const Recording& recording() {
  static const Recording made = test::kept_recording("desk", test::desk_options());
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

// Kept and read again a sequence is what was rendered; a file that breaks off is none. On this computer it is also the
// one that the emulated processors will read.
TEST(Bits, OfAKeptSequenceAreThoseRendered) {
#ifdef PPTAM_EMULATED
  GTEST_SKIP() << "minutes in emulation";
#endif
  const std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("pptam-recording-" + std::to_string(::getpid()));
  const Recording rendered = test::record(test::clutter_options());
  test::write_recording(folder / "a.frames", rendered);
  const Recording read = test::read_recording(folder / "a.frames", rendered.info);
  EXPECT_EQ(read.images, rendered.images);
  EXPECT_EQ(read.timestamps_ns, rendered.timestamps_ns);
  std::filesystem::resize_file(folder / "a.frames", std::filesystem::file_size(folder / "a.frames") - 1);
  EXPECT_EQ(test::read_recording(folder / "a.frames", rendered.info).size(), 0);
  std::filesystem::remove_all(folder);
  if (const char* kept = std::getenv("PPTAM_RECORDINGS"))
    test::write_recording(std::filesystem::path(kept) / "clutter.frames", rendered);
}

TEST(Bits, AreTheSameOnEveryTarget) {
  const Hashes hashes = run_and_hash(-1);
  EXPECT_GT(hashes.poses, 25) << "the run must have a map, or nothing is compared";
  ASSERT_EQ(hashes.frames, 0xec03541461a0277bu)
      << "the emulated phone's images differ: nothing can be said of the library";
  EXPECT_EQ(hashes.results, 0x6eb1aab0844a1e43u);
#ifndef PPTAM_EMULATED  // half a minute in emulation
  EXPECT_NE(run_and_hash(10).results, hashes.results) << "control: one pixel of one early frame";
#endif
}

// The work clock's times are a function of the input too: frames arrive, are tracked, and mapping has the time between
// them, as in the program's runs. This is what `pocket-ptam budget` tells.
TEST(Bits, OfTheWorkClocksTimesAreTheSameOnEveryTarget) {
  const auto times = [](float cycles_per_instruction) {
    Config config = test::config_for(recording());
    config.profile.cycles_per_instruction = cycles_per_instruction;
    test::Phone phone(config);
    WorkClock clock(phone->work_meter());
    phone->set_clock(&clock);
    phone->tap();
    Trace trace;
    for (int i = 0; i < recording().size(); ++i) {
      const Frame frame = recording().frame(i);
      int slices = 0;
      for (; clock.now_ns() < frame.timestamp_ns && phone->has_work(); ++slices) phone->work_slice();
      trace.add_value(clock.now_ns());
      trace.add_value(slices);
      clock.idle_until(frame.timestamp_ns);
      const TrackResult result = phone->track(frame);
      for (const int64_t ns : result.stage_ns) trace.add_value(ns);
      trace.add_value(clock.now_ns());
    }
    test::Fnv hash;
    hash.add(trace.bytes.data(), trace.bytes.size());
    return hash.value();
  };
  const uint64_t hash = times(1.5f);
  EXPECT_EQ(hash, 0xf2e90debbb938685u);
#ifndef PPTAM_EMULATED
  EXPECT_EQ(times(1.5f), hash) << "twice";
  EXPECT_NE(times(1.501f), hash) << "control: a processor that is slower by a thousandth";
#endif
}

}  // namespace
}  // namespace pptam
