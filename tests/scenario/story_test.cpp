// Each story of the emulated phone has the property that its line in the table claims, for several seeds.

#include "sim_phone/story.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "sim_phone/hand.h"
#include "sim_phone/phone_camera.h"

namespace pptam::sim {
namespace {

using Eigen::Isometry3d;

constexpr uint64_t kSeeds = 6;
constexpr double kStep_s = 0.005;  // 200 Hz: five samples of a 20 ms half period of tremor

// The stage alone, as the story's scene has it: curves need no surfaces.
Scene stage_of(const std::string& scene, uint64_t seed) {
  Scene empty;
  empty.stage.azimuth_rad = 0.7 * static_cast<double>(seed);
  if (scene == "walls") {
    empty.stage.kind = Stage::Kind::kCorner;
    empty.stage.mirrored = seed % 2 == 0;
  }
  if (scene == "boxes") empty.stage.min_height_m = 0.36;
  return empty;
}

Story story_named(const std::string& name, uint64_t seed) {
  const StoryKind* kind = find_story(name);
  EXPECT_NE(kind, nullptr) << name;
  return make_story(name, stage_of(kind->scene, seed), seed);
}

double rate_deg_s(const MotionCurve& curve, double t_s) {
  return angle_between(curve(t_s - 0.5 * kStep_s), curve(t_s + 0.5 * kStep_s)) / kStep_s / kDegree;
}

bool inside(const std::vector<Interval>& intervals, double t_s, double margin_s = 0) {
  return std::any_of(intervals.begin(), intervals.end(),
                     [&](const Interval& i) { return t_s >= i.from_s - margin_s && t_s <= i.to_s + margin_s; });
}

// Along the optical axis, to the plane z = 0.
double distance_to_table(const Isometry3d& T) {
  return -T.translation().z() / T.linear()(2, 2);
}
double slant_deg(const Isometry3d& T) {
  return std::acos(-T.linear()(2, 2)) / kDegree;
}

TEST(Stories, EverySeedTellsItsOwnAndAlwaysTheSame) {
  for (const StoryKind& kind : stories()) {
    const Story a = story_named(kind.name, 3), again = story_named(kind.name, 3), other = story_named(kind.name, 4);
    double differs = 0;
    for (double t = 0; t < kind.duration_s; t += 0.37) {
      EXPECT_TRUE(a.curve(t).matrix() == again.curve(t).matrix()) << kind.name;
      differs = std::max(differs, (a.curve(t).matrix() - other.curve(t).matrix()).norm());
    }
    EXPECT_GT(differs, 0.05) << kind.name;
    EXPECT_EQ(kind.loses, !a.lost.empty()) << kind.name;
    EXPECT_EQ(phone_for_story(kind.name, 3).scene, kind.scene);
  }
}

TEST(Stories, StartHeldStillThenMoveSidewaysAndStayOverTheTable) {
  for (const StoryKind& kind : stories()) {
    if (kind.map == WantedMap::kNone) continue;  // rests
    for (uint64_t seed = 1; seed <= kSeeds; ++seed) {
      const std::string where = std::string(kind.name) + " " + std::to_string(seed);
      const Story story = story_named(kind.name, seed);
      const Isometry3d first = story.curve(0);
      EXPECT_GE(story.move_s, 0.5) << where;
      if (std::string(kind.name) != "rotation_start") {
        EXPECT_LT((story.curve(0.95 * story.move_s).translation() - first.translation()).norm(), 0.012) << where;
      }
      double length = 0;
      for (double t = story.move_s; t < story.move_s + 3.5; t += 0.1) {
        length = std::max(length, (story.curve(t).translation() - story.curve(story.move_s).translation()).norm());
      }
      EXPECT_GT(length, 0.05) << where;
      if (std::string(kind.scene) == "walls" || std::string(kind.name) == "rotation_start") continue;
      for (double t = 0; t < kind.duration_s; t += 0.1) {
        const Isometry3d T = story.curve(t);
        ASSERT_GT(T.translation().z(), 0.22) << where << " at " << t;
        if (inside(story.lost, t)) continue;
        const Vector3d seen = T.translation() + distance_to_table(T) * T.linear().col(2);
        ASSERT_LT(seen.cwiseAbs().maxCoeff(), 0.95) << where << " at " << t;
      }
    }
  }
}

// No jump of velocity but where a story cuts: over 5 ms the hand accelerates by 5 m/s^2 at most (tremor 0.4, moves and
// zooms under 1, the static story's step 5.8 / 0.2^2 * 0.05 = 7.2).
TEST(Stories, HandsMoveSmoothly) {
  for (const StoryKind& kind : stories()) {
    const Story story = story_named(kind.name, 2);
    for (double t = 0.1; t < kind.duration_s; t += 0.01) {
      if (std::string(kind.name) == "cut" && inside(story.lost, t, 0.05)) continue;
      const Vector3d bend = (story.curve(t + kStep_s).translation() - 2 * story.curve(t).translation() +
                             story.curve(t - kStep_s).translation()) /
                            (kStep_s * kStep_s);
      ASSERT_LT(bend.norm(), 9) << kind.name << " at " << t;
      const bool turns = inside(story.lost, t, 0.05) || std::string(kind.name) == "fast_pans" ||
                         inside(story.pans, t, 0.05) || (story.standstill && t > story.standstill->step_from_s - 0.05);
      if (!turns) {
        ASSERT_LT(rate_deg_s(story.curve, t), 50) << kind.name << " at " << t;
      }
    }
  }
}

TEST(Stories, OrbitGoesRound) {
  for (uint64_t seed = 1; seed <= kSeeds; ++seed) {
    const Story story = story_named("orbit", seed);
    double least = 1e9, most = -1e9, nearest = 1e9, farthest = 0;
    const double zero = 0.7 * static_cast<double>(seed);
    for (double t = 0; t < 20; t += 0.1) {
      const Vector3d p = story.curve(t).translation();
      const double azimuth = std::remainder(std::atan2(p.y(), p.x()) - zero, 2 * std::numbers::pi) / kDegree;
      least = std::min(least, azimuth);
      most = std::max(most, azimuth);
      nearest = std::min(nearest, p.norm());
      farthest = std::max(farthest, p.norm());
    }
    EXPECT_GT(most - least, 100) << seed;
    EXPECT_LT(farthest - nearest, 0.16) << seed;  // the target is up to 7 cm off the middle
  }
}

TEST(Stories, ExplorersReturn) {
  for (uint64_t seed = 1; seed <= kSeeds; ++seed) {
    const Story story = story_named("explore_return", seed);
    const Isometry3d first = story.curve(0), last = story.curve(26);
    double farthest = 0;
    for (double t = 0; t < 26; t += 0.1) {
      farthest = std::max(farthest, (story.curve(t).translation() - first.translation()).norm());
    }
    EXPECT_GT(farthest, 0.4) << seed;
    EXPECT_LT((last.translation() - first.translation()).norm(), 0.04) << seed;
    EXPECT_LT(angle_between(first, last) / kDegree, 5) << seed;
  }
}

TEST(Stories, ZoomIsFourToOne) {
  for (uint64_t seed = 1; seed <= kSeeds; ++seed) {
    const Story story = story_named("zoom", seed);
    double nearest = 1e9, farthest = 0;
    for (double t = 0; t < 20; t += 0.05) {
      nearest = std::min(nearest, distance_to_table(story.curve(t)));
      farthest = std::max(farthest, distance_to_table(story.curve(t)));
    }
    EXPECT_GT(farthest / nearest, 4.0) << seed;
    EXPECT_LT(farthest / nearest, 4.5) << seed;
  }
}

TEST(Stories, ShakesReach200DegreesPerSecondAndOnlyThere) {
  for (uint64_t seed = 1; seed <= kSeeds; ++seed) {
    const Story story = story_named("shake", seed);
    ASSERT_EQ(story.lost.size(), 2u);
    for (const Interval& lost : story.lost) {
      double fastest = 0;
      for (double t = lost.from_s; t < lost.to_s; t += kStep_s) fastest = std::max(fastest, rate_deg_s(story.curve, t));
      EXPECT_GT(fastest, 200) << seed;
      EXPECT_LT(fastest, 300) << seed;
      // The view is back: where it was, but for the sway.
      EXPECT_LT(angle_between(story.curve(lost.from_s), story.curve(lost.to_s)) / kDegree, 1.5) << seed;
      EXPECT_LT(lost.to_s + 1, find_story("shake")->duration_s) << "time to recover";
    }
    for (double t = 0.1; t < 20; t += 0.02) {
      if (!inside(story.lost, t, kStep_s)) {
        EXPECT_LT(rate_deg_s(story.curve, t), 45) << seed << " at " << t;
      }
    }
  }
}

TEST(Stories, RotationStartTurnsOnTheSpotFirst) {
  for (uint64_t seed = 1; seed <= kSeeds; ++seed) {
    const Story story = story_named("rotation_start", seed);
    const Isometry3d first = story.curve(0);
    double turned = 0;
    for (double t = 0; t < story.move_s; t += 0.05) {
      EXPECT_TRUE(story.curve(t).translation() == first.translation()) << seed;
      turned = std::max(turned, angle_between(first, story.curve(t)) / kDegree);
    }
    EXPECT_GT(turned, 7) << seed;
  }
}

TEST(Stories, CutsJumpToAViewSeenBefore) {
  for (uint64_t seed = 1; seed <= kSeeds; ++seed) {
    const Story story = story_named("cut", seed);
    ASSERT_EQ(story.lost.size(), 2u);
    for (const Interval& lost : story.lost) {
      const Isometry3d before = story.curve(lost.from_s), after = story.curve(lost.to_s);
      EXPECT_GT((before.translation() - after.translation()).norm() + angle_between(before, after), 0.15) << seed;
      double nearest = 1e9;
      for (double t = 1; t < lost.from_s; t += 0.02) {
        const Isometry3d seen = story.curve(t);
        nearest =
            std::min(nearest, (seen.translation() - after.translation()).norm() + 0.5 * angle_between(seen, after));
      }
      EXPECT_LT(nearest, 0.06) << seed << ": 6 cm, or 7 degrees";
      EXPECT_LT(lost.to_s + 1, find_story("cut")->duration_s) << "time to recover";
    }
    const Interval covered = story.lost[0], pause = story.lost[1];
    EXPECT_LT(story.light(0.5 * (covered.from_s + covered.to_s)), 0.01);
    EXPECT_EQ(story.light(covered.from_s - 0.01), 1);
    EXPECT_EQ(story.light(pause.from_s), 1);
    PhoneOptions options = phone_for_story("cut", seed);
    const auto truth =
        make_phone_camera(options, std::make_shared<const Scene>(stage_of("desk", seed)))->ground_truth();
    for (const platform::StampedPose& pose : truth) {
      const double t_s = 1e-9 * static_cast<double>(pose.timestamp_ns);
      EXPECT_FALSE(t_s > pause.from_s && t_s < pause.to_s) << seed;
    }
    EXPECT_NEAR(static_cast<double>(truth.size()), 300 - 15 * (pause.to_s - pause.from_s), 1.01) << seed;
  }
}

TEST(Stories, StaticIsStaticThenSteps) {
  for (uint64_t seed = 1; seed <= kSeeds; ++seed) {
    const Story story = story_named("static", seed);
    ASSERT_TRUE(story.standstill);
    const Standstill still = *story.standstill;
    EXPECT_GE(still.step_from_s - still.from_s, 5) << seed;
    EXPECT_LT(still.step_to_s + 1, find_story("static")->duration_s) << seed;
    const Isometry3d rest = story.curve(still.from_s);
    for (double t = still.from_s; t <= still.step_from_s; t += kStep_s) {
      ASSERT_TRUE(story.curve(t).matrix() == rest.matrix()) << seed << " at " << t;
    }
    EXPECT_NEAR(distance_to_table(rest), 1, 1e-9) << seed;
    EXPECT_GE(slant_deg(rest), 29.9) << seed;
    EXPECT_LE(slant_deg(rest), 45.1) << seed;
    const Isometry3d after = story.curve(still.step_to_s);
    EXPECT_NEAR((after.translation() - rest.translation()).norm(), 0.05, 1e-9) << seed;
    EXPECT_NEAR(angle_between(rest, after) / kDegree, 5, 1e-6) << seed;
    EXPECT_NEAR(still.step_to_s - still.step_from_s, 0.2, 1e-9);
    EXPECT_TRUE(story.curve(still.step_to_s + 0.5).matrix() == after.matrix()) << seed;
    EXPECT_FALSE(story.curve(still.from_s - 1).matrix() == rest.matrix()) << seed;
  }
}

TEST(Stories, FastPansAreFastButNotAShake) {
  for (uint64_t seed = 1; seed <= kSeeds; ++seed) {
    const Story story = story_named("fast_pans", seed);
    double fastest = 0;
    for (double t = 0.1; t < 20; t += 0.01) fastest = std::max(fastest, rate_deg_s(story.curve, t));
    EXPECT_GT(fastest, 45) << seed;
    EXPECT_LT(fastest, 90) << seed;
  }
}

TEST(Stories, SlantedStartIsSlanted) {
  for (uint64_t seed = 1; seed <= kSeeds; ++seed) {
    const double slant = slant_deg(story_named("slanted_start", seed).curve(0));
    EXPECT_GT(slant, 47) << seed;
    EXPECT_LT(slant, 61) << seed;
  }
}

// Share of the phone's view that the occluder hides, on a grid of rays.
double covered_share(const Occluder& occluder, double t_s) {
  constexpr int kColumns = 24, kRows = 32;
  const double half_width = std::tan(18.5 * kDegree), half_height = half_width * 320 / 240;
  Scene held;
  held.surfaces = occluder.surfaces;
  const Vector3d at = occluder.position(t_s);
  int hit = 0;
  for (int row = 0; row < kRows; ++row) {
    for (int column = 0; column < kColumns; ++column) {
      const Vector3d ray(half_width * (2 * (column + 0.5) / kColumns - 1), half_height * (2 * (row + 0.5) / kRows - 1),
                         1);
      if (std::isfinite(first_hit(held, -at, ray))) ++hit;
    }
  }
  return static_cast<double>(hit) / (kColumns * kRows);
}

TEST(Stories, TheHandCoversAThirdToAHalfAndGoesAway) {
  for (uint64_t seed = 1; seed <= 3; ++seed) {
    const Story story = story_named("hand", seed);
    ASSERT_NE(story.occluder, nullptr);
    double most = 0;
    int passes = 0;
    bool there = false;
    for (double t = 0; t < 20; t += 0.05) {
      const double share = covered_share(*story.occluder, t);
      if (t < 4.5) {
        EXPECT_EQ(share, 0) << seed << ": the start is free";
      }
      if (!inside(story.obstructed, t)) {
        EXPECT_EQ(share, 0) << seed << " at " << t;
      }
      most = std::max(most, share);
      if (share > 0.2 && !there) {
        ++passes;
        there = true;
      }
      if (share < 0.05) there = false;
    }
    EXPECT_EQ(passes, 3) << seed;
    EXPECT_GT(most, 0.3) << seed;
    EXPECT_LT(most, 0.6) << seed;
    EXPECT_GT(story.occluder->position(6).z(), 0.2);  // half-way to the desk
    EXPECT_LT(story.occluder->position(6).z(), 0.35);
  }
}

TEST(Stories, PansTurnOnTheSpotAndBack) {
  for (const char* const name : {"pan", "pan_corner"}) {
    for (uint64_t seed = 1; seed <= kSeeds; ++seed) {
      const std::string where = std::string(name) + " " + std::to_string(seed);
      const Story story = story_named(name, seed);
      ASSERT_EQ(story.pans.size(), 2U) << where;
      EXPECT_GT(story.pan_depth_m, 0.4) << where;
      for (const Interval& pan : story.pans) {
        EXPECT_GT(pan.from_s, 6) << where << ": time for a map";
        EXPECT_LT(pan.to_s + 0.7, find_story(name)->duration_s) << where;
        const Isometry3d before = story.curve(pan.from_s);
        double fastest = 0, widest = 0;
        for (double t = pan.from_s; t < pan.to_s; t += kStep_s) {
          const Isometry3d now = story.curve(t);
          fastest = std::max(fastest, rate_deg_s(story.curve, t));
          widest = std::max(widest, angle_between(before, now) / kDegree);
          ASSERT_LT((now.translation() - before.translation()).norm(), 0.012) << where;  // the unrest alone
        }
        // With the tremor's 5 degrees/s.
        EXPECT_GT(fastest, 50) << where;
        EXPECT_LT(fastest, 108) << where;
        EXPECT_GT(widest, 45) << where;
        EXPECT_LT(angle_between(before, story.curve(pan.to_s)) / kDegree, 2.5) << where;
      }
    }
  }
}

TEST(Stories, LampsStepAndFlicker) {
  for (uint64_t seed = 1; seed <= kSeeds; ++seed) {
    const Story story = story_named("lamps", seed);
    // The mean of ten mains periods.
    const auto mean = [&](double t_s) {
      double sum = 0;
      for (int i = 0; i < 100; ++i) sum += story.light(t_s + 0.001 * i) / 100;
      return sum;
    };
    double least = 1e9, most = 0;
    int steps = 0;
    for (double t = 0; t < 20; t += 0.1) {
      least = std::min(least, mean(t));
      most = std::max(most, mean(t));
      if (std::abs(std::log(mean(t + 0.2) / mean(t))) > 0.4) ++steps;
    }
    EXPECT_GT(most / least, 1.8) << seed;
    EXPECT_GT(steps, 5) << seed;
    EXPECT_NEAR(mean(1) / mean(3.5), 1, 0.01) << seed << ": the start is undisturbed";
    double ripple = 0;
    for (double t = 1; t < 1.02; t += 0.001) ripple = std::max(ripple, std::abs(story.light(t) / mean(1) - 1));
    EXPECT_GT(ripple, 0.045) << seed;
  }
}

TEST(Stories, DimIsDimSlowAndDropsFrames) {
  const PhoneOptions options = phone_for_story("dim", 1);
  EXPECT_EQ(options.exposure_s, 0.060);
  EXPECT_EQ(options.drop_probability, 0.1);
  const auto camera = make_phone_camera(options, std::make_shared<const Scene>(stage_of("desk", 1)));
  // 300 frames, a tenth dropped: 270, standard deviation sqrt(300 * 0.1 * 0.9) = 5.2; four of them.
  EXPECT_NEAR(static_cast<double>(camera->ground_truth().size()), 270, 21);
  EXPECT_LT(story_named("dim", 1).light(5), 0.45);
}

// Share of a table's texels that look like the one so many columns further right.
double alike(const Texture& texture, int columns) {
  const Texture::Level& level = texture.levels[0];
  int64_t same = 0, all = 0;
  for (int y = 0; y < level.height; y += 7) {
    for (int x = 0; x + columns < level.width; x += 7) {
      const double a = level.texels[static_cast<size_t>(y) * static_cast<size_t>(level.width) + static_cast<size_t>(x)];
      const double b =
          level.texels[static_cast<size_t>(y) * static_cast<size_t>(level.width) + static_cast<size_t>(x + columns)];
      ++all;
      if (std::abs(a - b) < 0.03 * std::max(a, b)) ++same;
    }
  }
  return static_cast<double>(same) / static_cast<double>(all);
}

TEST(StoryScenes, TilesRepeatAndSparseIsBare) {
  const Texture tiles = make_scene("tiles", 1).surfaces[0].texture;
  const Texture sparse = make_scene("sparse", 1).surfaces[0].texture;
  const Texture desk = make_scene("desk", 1).surfaces[0].texture;
  double best_tiles = 0, best_desk = 0, worst_tiles = 1;
  for (int shift = 110; shift <= 170; ++shift) {
    best_tiles = std::max(best_tiles, alike(tiles, shift));
    worst_tiles = std::min(worst_tiles, alike(tiles, shift));
    best_desk = std::max(best_desk, alike(desk, shift));
  }
  std::printf("alike after one tile: %.2f, at another distance %.2f; the desk at best %.2f\n", best_tiles, worst_tiles,
              best_desk);
  EXPECT_GT(best_tiles, 0.75);                // all but the unique things and their surroundings
  EXPECT_LT(best_tiles, 0.99);                // which there are
  EXPECT_LT(worst_tiles, best_tiles - 0.15);  // only whole tiles match
  EXPECT_LT(best_desk, 0.3);
  const double bare = alike(sparse, 30), busy = alike(desk, 30);  // 15 mm
  std::printf("alike over 15 mm: sparse %.2f, desk %.2f\n", bare, busy);
  EXPECT_GT(bare, 0.7);
  EXPECT_LT(busy, 0.35);
}

// Lamps and occluder reach the pixels; a covered lens is black and the exposure waits for it.
TEST(StorySensor, LightAndOccluderReachThePixels) {
  const auto board = std::make_shared<const Scene>(make_scene("checkerboard", 1));
  const auto mean = [](const std::vector<uint8_t>& image) {
    double sum = 0;
    for (const uint8_t grey : image) sum += grey;
    return sum / static_cast<double>(image.size());
  };
  const auto frames_of = [&](const std::string& name) {
    PhoneOptions options = phone_for_story(name, 1);
    options.width = 60;
    options.height = 80;
    const auto camera = make_phone_camera(options, board);
    std::vector<std::pair<double, std::vector<uint8_t>>> frames;
    Frame frame;
    while (camera->read(&frame)) {
      frames.emplace_back(1e-9 * static_cast<double>(frame.timestamp_ns),
                          std::vector<uint8_t>(frame.data, frame.data + frame.width * frame.height));
    }
    return frames;
  };
  const auto cut = frames_of("cut");
  const Interval covered = make_story("cut", *board, 1).lost[0];
  double before = 0, within = 255, after = 0;
  for (const auto& [t_s, image] : cut) {
    if (t_s < covered.from_s - 0.05) before = mean(image);
    if (t_s > covered.from_s + 0.12 && t_s < covered.to_s - 0.12) within = std::min(within, mean(image));
    if (t_s > covered.to_s + 0.05 && after == 0) after = mean(image);
  }
  std::printf("covered lens: mean grey %.0f, then %.0f, then %.0f\n", before, within, after);
  EXPECT_GT(before, 80);
  EXPECT_LT(within, 25);
  EXPECT_NEAR(after, before, 45) << "not washed out";

  const auto with_hand = frames_of("hand");
  const Story story = make_story("hand", *board, 1);
  int hidden = 0;
  for (const auto& [t_s, image] : with_hand) {
    const double share = covered_share(*story.occluder, t_s);
    if (share < 0.3) continue;
    ++hidden;
    // Skin is no checkerboard: its greys lie between black and white.
    const auto middling = std::count_if(image.begin(), image.end(), [](uint8_t g) { return g > 90 && g < 190; });
    EXPECT_GT(static_cast<double>(middling) / static_cast<double>(image.size()), 0.5 * share) << t_s;
  }
  EXPECT_GT(hidden, 3);
  EXPECT_EQ(with_hand, frames_of("hand"));  // to the pixel
}

}  // namespace
}  // namespace pptam::sim
