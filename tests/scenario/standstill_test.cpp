// A camera that comes to rest is shown at rest, and moves at once when it does [Config::steady_damping].
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <memory>

#include "platform/run/run.h"
#include "sim_phone/laboratory/judgement.h"
#include "sim_phone/phone_camera.h"
#include "sim_phone/story.h"
#include "tests/support/sample.h"

namespace pptam {
namespace {

using laboratory::judge;
using laboratory::Judgement;
using platform::RunLog;
using platform::RunOptions;

Judgement stand_still(const sim::PhoneOptions& phone, const std::shared_ptr<const sim::Scene>& scene, bool damped) {
  const auto camera = sim::make_phone_camera(phone, scene);
  RunOptions options;
  options.steady_damping = damped;
  const RunLog log = run_sequence(
      *camera, options, [](const platform::CameraInfo&) {}, nullptr);
  return judge(log, camera->ground_truth(), sim::story_of(phone, *scene), std::abs(phone.readout_s) + phone.exposure_s);
}

// Seed 5 has frames whose smallest image seems to turn although nothing moves: noise that must not let go of the pose.
// The goals are the figures for this story; the undamped run is the control, which misses the first of them.
TEST(Standstill, IsShownStillAndFollowsAStep) {
  double damped_mm = 0, measured_mm = 0;
  for (const uint64_t seed : {5, 1, 9}) {
    if (seed != 5 && !test::all_asked_for()) continue;
    const sim::PhoneOptions phone = sim::phone_for_story("static", seed);
    const auto scene = std::make_shared<const sim::Scene>(sim::make_scene(phone.scene, phone.seed));
    const Judgement damped = stand_still(phone, scene, true);
    const Judgement measured = stand_still(phone, scene, false);
    std::printf(
        "seed %d: %.3f mm, %.4f degrees; as measured %.3f mm, %.4f degrees; a step followed after %.0f frames\n",
        static_cast<int>(seed), damped.jitter_mm, damped.jitter_deg, measured.jitter_mm, measured.jitter_deg,
        damped.lag_frames);
    EXPECT_LE(damped.jitter_mm, 0.15) << seed;
    EXPECT_LE(damped.jitter_deg, 0.01) << seed;
    EXPECT_GT(measured.jitter_mm, 0.15) << seed << ": nothing to damp";
    EXPECT_LE(measured.jitter_mm, 0.3) << seed;
    EXPECT_LE(damped.lag_frames, 2) << seed;
    EXPECT_LE(damped.lag_frames, measured.lag_frames + 1) << seed << ": damping holds the pose back";
    damped_mm += damped.jitter_mm;
    measured_mm += measured.jitter_mm;
  }
  // The mean of ten frames, the damping's length, leaves a third of white noise. What the map moves meanwhile is shown,
  // and takes half of the rest.
  EXPECT_LT(damped_mm, 0.67 * measured_mm);
}

}  // namespace
}  // namespace pptam
