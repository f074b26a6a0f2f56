// A tracer hears of every frame and slice, well nested, and changes no bit.
#include <gtest/gtest.h>

#include <array>
#include <vector>

#include <pocket_ptam/inspection.h>
#include "tests/support/recording.h"

namespace pptam {
namespace {

using test::Phone;
using test::Recording;
using test::Trace;

class Listener final : public Tracer {
 public:
  void begin(Span span) override {
    // What may be inside what.
    if (span == Span::kFrame || span == Span::kSlice) {
      EXPECT_TRUE(open_.empty());
    } else {
      EXPECT_EQ(open_.size(), 1u) << static_cast<int>(span);
      const Span round = span < Span::kSlice ? Span::kFrame : Span::kSlice;
      EXPECT_TRUE(!open_.empty() && open_.back() == round) << static_cast<int>(span);
    }
    open_.push_back(span);
    ++begun_[static_cast<size_t>(span)];
  }
  void end(Span span) override {
    ASSERT_FALSE(open_.empty());
    EXPECT_EQ(open_.back(), span);
    open_.pop_back();
  }
  void count(Counter counter, int64_t value) override {
    EXPECT_TRUE(open_.empty());
    last_[static_cast<size_t>(counter)] = value;
    ++counted_;
  }
  int begun(Span span) const { return begun_[static_cast<size_t>(span)]; }
  int64_t last(Counter counter) const { return last_[static_cast<size_t>(counter)]; }
  int counted() const { return counted_; }
  bool all_ended() const { return open_.empty(); }

 private:
  std::vector<Span> open_;
  std::array<int, kSpans> begun_ = {};
  std::array<int64_t, kCounters> last_ = {};
  int counted_ = 0;
};

const Recording& recording() {
  static const Recording made = [] {
    sim::PhoneOptions options;
    options.duration_s = 6;
    return test::record(options);
  }();
  return made;
}

struct Course {
  Trace trace;
  TrackResult last;
  int frames = 0, slices = 0, keyframes = 0;
};

// stage_ns of each frame and the whole frame's time are added to *stages and *whole, if these are not null.
Course run(Tracer* tracer, std::vector<std::array<int64_t, kStages>>* stages = nullptr,
           std::vector<int64_t>* whole = nullptr) {
  Phone phone(test::config_for(recording()));
  const WorkClock clock(phone->work_meter());
  if (stages != nullptr) phone->set_clock(&clock);
  phone->set_tracer(tracer);
  phone->tap();
  Course done;
  for (int i = 0; i < recording().size(); ++i) {
    const int64_t from_ns = clock.now_ns();
    done.last = phone->track(recording().frame(i));
    if (stages != nullptr) {
      stages->emplace_back();
      std::copy(std::begin(done.last.stage_ns), std::end(done.last.stage_ns), stages->back().begin());
      whole->push_back(clock.now_ns() - from_ns);
    }
    done.trace.add(done.last);
    ++done.frames;
    done.keyframes += done.last.keyframe_added;
    for (int s = 0; s < 40 && phone->has_work(); ++s) {
      phone->work_slice();
      ++done.slices;
    }
    done.trace.add_value(static_cast<int64_t>(map_hash(*phone)));
  }
  EXPECT_EQ(phone->track(recording().frame(0)).status.code(), StatusCode::kTimeWentBackwards);
  return done;
}

TEST(Tracer, HearsEveryFrameAndSliceAndChangesNothing) {
  const Course alone = run(nullptr);
  ASSERT_TRUE(alone.last.pose_valid) << "the run must have a map, or little is heard";
  Listener listener;
  const Course heard = run(&listener);
  EXPECT_TRUE(heard.trace == alone.trace);
  EXPECT_TRUE(listener.all_ended());
  EXPECT_EQ(listener.begun(Span::kFrame), heard.frames) << "and none for the refused one";
  EXPECT_EQ(listener.begun(Span::kPyramid), heard.frames);
  EXPECT_EQ(listener.begun(Span::kSlice), heard.slices);
  for (const Span span : {Span::kRotation, Span::kSearch, Span::kPose, Span::kPartial, Span::kInitialise,
                          Span::kKeyframe, Span::kFinishMap, Span::kInsert, Span::kAdjust, Span::kTidy})
    EXPECT_GT(listener.begun(span), 0) << static_cast<int>(span);
  EXPECT_EQ(listener.counted(), heard.frames * kCounters);
  EXPECT_EQ(listener.last(Counter::kKeyframes), heard.last.keyframes);
  EXPECT_EQ(listener.last(Counter::kMapPoints), heard.last.map_points);
  EXPECT_EQ(listener.last(Counter::kInliers), heard.last.points_inliers);
  EXPECT_EQ(listener.last(Counter::kQuality), static_cast<int64_t>(heard.last.quality));
}

// Every nanosecond of a frame belongs to one stage.
TEST(Tracer, StagesSumUpToTheFrame) {
  std::vector<std::array<int64_t, kStages>> stages;
  std::vector<int64_t> whole;
  run(nullptr, &stages, &whole);
  std::array<int64_t, kStages> all = {};
  for (size_t i = 0; i < stages.size(); ++i) {
    int64_t sum = 0;
    for (int s = 0; s < kStages; ++s) {
      sum += stages[i][static_cast<size_t>(s)];
      all[static_cast<size_t>(s)] += stages[i][static_cast<size_t>(s)];
    }
    EXPECT_EQ(sum, whole[i]) << i;
  }
  for (int s = 0; s < kStages; ++s) EXPECT_GT(all[static_cast<size_t>(s)], 0) << s;
}

}  // namespace
}  // namespace pptam
