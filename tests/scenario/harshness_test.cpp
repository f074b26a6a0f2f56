// What makes pictures hard: each cause does what its line in the table says, and nothing when it is off.

#include "sim_phone/harshness.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "platform/input_error.h"
#include "sim_phone/bystanders.h"
#include "sim_phone/compression.h"
#include "sim_phone/hand.h"
#include "sim_phone/lamp_and_focus.h"
#include "sim_phone/phone_camera.h"
#include "sim_phone/random.h"
#include "sim_phone/story.h"

namespace pptam::sim {
namespace {

using Eigen::Isometry3d;

TEST(Harshness, NamesAreReadAndToldAgain) {
  EXPECT_EQ(harshness_text({}), "");
  Harshness harsh;
  add_harshness({"people", "dim:0.5", "flicker", "mains:120"}, &harsh);
  EXPECT_EQ(harsh.people, 0.5);
  EXPECT_EQ(harsh.dimness, 0.5);
  EXPECT_EQ(harsh.mains_hz, 120);
  EXPECT_EQ(harshness_text(harsh), "people:0.5,flicker:0.2,dim:0.5,mains:120");
  Harshness all;
  add_harshness({"all"}, &all);
  for (const Cause& cause : causes()) {
    EXPECT_EQ(all.*cause.value, cause.usual) << cause.name;
    EXPECT_GT(cause.usual, 0) << cause.name;
    EXPECT_LE(cause.usual, cause.greatest) << cause.name;
  }
  for (const char* bad : {"fog", "dim:", "dim:x", "dim:2", "people:-1", "people:nan", "mains", "mains:5", ""}) {
    try {
      add_harshness({bad}, &all);
      ADD_FAILURE() << bad;
    } catch (const platform::InputError& error) {
      EXPECT_NE(std::string(error.what()).find(bad), std::string::npos) << error.what();
    }
  }
}

std::vector<uint8_t> pixels_of(const PhoneOptions& options, std::shared_ptr<const Scene> scene) {
  const std::unique_ptr<platform::Camera> camera = make_phone_camera(options, std::move(scene));
  std::vector<uint8_t> all;
  Frame frame;
  while (camera->read(&frame)) {
    const size_t bytes = static_cast<size_t>(frame.stride_bytes) * static_cast<size_t>(frame.height);
    all.insert(all.end(), frame.data, frame.data + bytes);
  }
  return all;
}

double share_that_differs(const std::vector<uint8_t>& a, const std::vector<uint8_t>& b) {
  size_t differing = 0;
  for (size_t i = 0; i < a.size(); ++i) differing += a[i] != b[i] ? 1 : 0;
  return static_cast<double>(differing) / static_cast<double>(a.size());
}

// Nine seconds of a small picture, one a second: arms have come, a hand has hurried on.
TEST(Harshness, EachCauseReachesThePicturesAndNoneLeavesThemAlone) {
  PhoneOptions options;
  options.width = 48;
  options.height = 64;
  options.frames_per_s = 1;
  options.duration_s = 9;
  options.exposure_s = 0.004;
  const auto scene = std::make_shared<const Scene>(make_scene(options));
  const std::vector<uint8_t> plain = pixels_of(options, scene);
  EXPECT_EQ(share_that_differs(pixels_of(options, scene), plain), 0);
  for (const Cause& cause : causes()) {
    PhoneOptions harsh = options;
    harsh.harsh.*cause.value = cause.usual;
    const bool painted = harsh.harsh.bare > 0 || harsh.harsh.repeats > 0;
    const std::vector<uint8_t> pixels = pixels_of(harsh, painted ? nullptr : scene);
    ASSERT_EQ(pixels.size(), plain.size());
    // Of 9 pictures at least two have an arm, the least that a cause changes: over a tenth of them each.
    EXPECT_GT(share_that_differs(pixels, plain), 0.02) << cause.name;
    if (!painted) {
      EXPECT_TRUE(pixels_of(harsh, scene) == pixels) << cause.name << ": the same again";
    }
    if (cause.value == &Harshness::people) {
      // Nothing moves when a map begins.
      const size_t start = 3 * static_cast<size_t>(options.width) * static_cast<size_t>(options.height);
      EXPECT_TRUE(std::equal(plain.begin(), plain.begin() + static_cast<std::ptrdiff_t>(start), pixels.begin()));
    }
    harsh.harsh.*cause.value = 2 * cause.greatest;
    EXPECT_THROW(check_phone_options(harsh), platform::InputError) << cause.name;
  }
}

TEST(Compression, CoarserIsFartherAndFlatStaysFlat) {
  constexpr int kWidth = 50, kHeight = 43;  // not of whole blocks
  std::vector<uint8_t> picture(static_cast<size_t>(kWidth) * kHeight);
  Random random(1, 1);
  for (uint8_t& pixel : picture) pixel = static_cast<uint8_t>(random.integer(60, 200));
  double last = 0;
  for (const double coarseness : {0.01, 0.5, 1.0, 2.0, 4.0}) {
    std::vector<uint8_t> compressed = picture;
    compress(compressed.data(), kWidth, kHeight, coarseness);
    double sum_sq = 0;
    for (size_t i = 0; i < picture.size(); ++i) sum_sq += std::pow(double{1} * compressed[i] - picture[i], 2);
    const double rms = std::sqrt(sum_sq / static_cast<double>(picture.size()));
    // The finest step is a grey level of each coefficient: 1 / sqrt(12) grey levels, and as much from rounding.
    if (coarseness < 0.1) {
      EXPECT_LT(rms, 0.5);
    }
    EXPECT_GT(rms, last);
    last = rms;
    for (int y = 40; y < kHeight; ++y)
      EXPECT_EQ(compressed[static_cast<size_t>(y) * kWidth], picture[static_cast<size_t>(y) * kWidth]);
  }
  std::vector<uint8_t> flat(picture.size(), 128);
  compress(flat.data(), kWidth, kHeight, 8);
  EXPECT_EQ(*std::min_element(flat.begin(), flat.end()), 128);
  EXPECT_EQ(*std::max_element(flat.begin(), flat.end()), 128);
}

TEST(LampAndFocus, FlickerAndBreatheAsTold) {
  Harshness harsh;
  EXPECT_EQ(lamp_light(harsh, 1), nullptr);
  EXPECT_EQ(focus_curve(0, 1), nullptr);
  harsh.flicker = 0.3;
  harsh.dimness = 0.5;
  harsh.mains_hz = 120;
  const auto light = lamp_light(harsh, 3);
  double least = 1e9, most = 0, mean = 0;
  int rises = 0;  // through the mean: periods
  constexpr int kSamples = 20000;
  for (int i = 0; i < kSamples; ++i) {
    const double now = light(1e-4 * i), next = light(1e-4 * (i + 1));
    least = std::min(least, now);
    most = std::max(most, now);
    mean += now / kSamples;
    rises += now < 0.5 && next >= 0.5 ? 1 : 0;
  }
  EXPECT_NEAR(least, 0.35, 0.001);
  EXPECT_NEAR(most, 0.65, 0.001);
  EXPECT_NEAR(mean, 0.5, 0.001);
  EXPECT_NEAR(rises, 240, 1.3);  // two seconds, the mains off by a thousandth
  const auto focus = focus_curve(0.01, 3);
  double nearest = 1, farthest = 1, blur = 0;
  for (double t = 0; t < 60; t += 0.01) {
    const Focus now = focus(t);
    nearest = std::min(nearest, now.scale);
    farthest = std::max(farthest, now.scale);
    blur = std::max(blur, now.blur_px);
    ASSERT_LT(std::abs(focus(t + 0.001).scale - now.scale), 1e-3);  // no jumps
  }
  EXPECT_GT(farthest - nearest, 0.01);
  EXPECT_LT(farthest - nearest, 0.021);
  EXPECT_GT(blur, 1);
  EXPECT_LT(blur, 2);
}

// Share of the phone's view that something moving hides, on a grid of rays.
double hidden_share(const Mover& mover, const Isometry3d& T_wc, double t_s) {
  constexpr int kColumns = 24, kRows = 32;
  const double half_width = std::tan(18.5 * kDegree), half_height = half_width * 320 / 240;
  Scene moving;
  moving.surfaces = mover.surfaces;
  const Isometry3d T_mc = mover.T_wm(t_s).inverse() * T_wc;
  int hit = 0;
  for (int row = 0; row < kRows; ++row) {
    for (int column = 0; column < kColumns; ++column) {
      const Vector3d ray(half_width * (2 * (column + 0.5) / kColumns - 1), half_height * (2 * (row + 0.5) / kRows - 1),
                         1);
      hit += std::isfinite(first_hit(moving, T_mc.translation(), T_mc.linear() * ray)) ? 1 : 0;
    }
  }
  return static_cast<double>(hit) / (kColumns * kRows);
}

TEST(Bystanders, ACarriedThingStaysInSightOfACameraAtRest) {
  for (uint64_t seed = 1; seed <= 3; ++seed) {
    Scene stage;
    stage.stage.azimuth_rad = 0.7 * static_cast<double>(seed);
    const Story story = make_story("carried_thing", stage, seed);
    ASSERT_EQ(story.movers.size(), 1U);
    const Isometry3d T_wc = story.curve(0);
    Vector3d first = story.movers[0]->T_wm(0).translation(), farthest = first;
    for (double t = 0; t < 15; t += 0.25) {
      EXPECT_TRUE(story.curve(t).matrix() == T_wc.matrix());
      const double share = hidden_share(*story.movers[0], T_wc, t);
      EXPECT_GT(share, 0.2) << seed << " at " << t;
      EXPECT_LT(share, 0.36) << seed << " at " << t;
      const Vector3d now = story.movers[0]->T_wm(t).translation();
      if ((now - first).norm() > (farthest - first).norm()) farthest = now;
    }
    EXPECT_GT((farthest - first).norm(), 0.03) << seed;
  }
}

TEST(Bystanders, ArmsAndPeopleAreInTheWayAsLongAsTold) {
  for (const bool walls : {false, true}) {
    for (const double busy : {0.3, 0.6}) {
      Scene scene;
      if (walls) scene.stage.kind = Stage::Kind::kCorner;
      Random random(2, 1);
      const Isometry3d T_wc = first_view(scene.stage, random).pose();
      int seen = 0, samples = 0;
      for (uint64_t seed = 1; seed <= 5; ++seed) {
        const auto movers = make_bystanders(scene.stage, busy, seed);
        for (double t = 10; t < 40; t += 0.5, ++samples) {
          double hidden = 0;
          for (const auto& mover : movers) hidden += hidden_share(*mover, T_wc, t);
          seen += hidden > 0.02 ? 1 : 0;
          EXPECT_LT(hidden, 0.75) << seed << " at " << t;
        }
      }
      // Where a view is just missed, or two are in it at once, differs from seed to seed.
      EXPECT_NEAR(static_cast<double>(seen) / samples, busy, 0.25) << (walls ? "walls " : "table ") << busy;
    }
  }
}

// Hasty hands replace the view, 0.67 of the distance wide, within a second, several times in a story.
TEST(Harshness, HasteReplacesTheViewInASecond) {
  for (uint64_t seed = 1; seed <= 3; ++seed) {
    Scene scene;
    scene.stage.azimuth_rad = 0.7 * static_cast<double>(seed);
    const auto replaced = [&](double haste) {
      Harshness harsh;
      harsh.haste = haste;
      const Story story = make_story("brisk", scene, seed, harsh);
      const auto seen_at = [&](double t_s) {
        const Isometry3d T = story.curve(t_s);
        return Vector3d(T.translation() - T.translation().z() / T.linear()(2, 2) * T.linear().col(2));
      };
      int times = 0;
      for (double t = 4; t < 18; t += 1) {
        const double distance = (seen_at(t) - story.curve(t).translation()).norm();
        double farthest = 0;
        for (double later = t; later <= t + 1; later += 0.1)
          farthest = std::max(farthest, (seen_at(later) - seen_at(t)).norm());
        EXPECT_LT(seen_at(t).cwiseAbs().maxCoeff(), 0.98) << "beside the table";
        times += farthest > 0.67 * distance ? 1 : 0;
      }
      return times;
    };
    EXPECT_EQ(replaced(0), 0) << seed;
    EXPECT_GE(replaced(3.5), 4) << seed;
  }
}

}  // namespace
}  // namespace pptam::sim
