// Templates blurred by the motion of their point during the exposure, and the place of a moving keyframe's patch.
#include "map/patch_search.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "tests/kernels/test_images.h"
#include "tests/support/map_building.h"
#include "tests/support/phone_camera.h"
#include "tests/support/random.h"
#include "tracking/kept_templates.h"

namespace pptam {
namespace {

// A texture as a camera sees it that moves by `streak` px while it exposes.
test::OwnedImage exposed(const test::Texture& texture, const Vector2f& streak, int width = 64, int height = 64) {
  constexpr int kInstants = 24;
  return test::OwnedImage(width, height).fill([&](int x, int y) {
    double sum = 0;
    for (int i = 0; i < kInstants; ++i) {
      const double share = (i + 0.5) / kInstants - 0.5;
      sum += texture.value(x - share * static_cast<double>(streak.x()), y - share * static_cast<double>(streak.y()));
    }
    return 128 + sum / kInstants;
  });
}

// A template blurred as its point moves is found in the blurred image, within 0.15 px: a sixth of the error
// that the pose expects of a point. Control: the sharp template differs from the image several times as much.
TEST(Streaks, ABlurredTemplateMatchesABlurredImage) {
  test::Random random;
  WorkMeter meter;
  double sharp_sum = 0, blurred_sum = 0;
  int found_blurred = 0, found_sharp = 0, tried = 0;
  for (int trial = 0; trial < test::trials(100); ++trial) {
    const test::Texture texture(random, 40, 0.15, 0.6);
    const float length = static_cast<float>(random.uniform(3, 6)), angle = static_cast<float>(random.uniform(0, 6.28));
    const Vector2f streak = length * Vector2f(std::cos(angle), std::sin(angle));
    const test::OwnedImage sharp = exposed(texture, Vector2f::Zero()), blurred = exposed(texture, streak);
    Pyramid source, target;
    source.level[0] = sharp.view();
    target.level[0] = blurred.view();
    const Vector2f at(32.3f, 31.6f);
    PatchTemplate plain, smeared;
    ASSERT_TRUE(warp_template(source, at, Matrix2f::Identity(), 0, &plain));
    EXPECT_EQ(streak_parts(streak, 0), std::max(2, static_cast<int>(length / 2 + 0.5f)));
    if (!warp_template(source, at, Matrix2f::Identity(), 0, &smeared, streak)) continue;  // the blur took all contrast
    ++tried;
    SearchOptions options;
    options.level = 0;
    ImagePoint found;
    const auto error = [&](const PatchTemplate& patch, int* count) {
      if (find_template(target, patch, at, options, meter, &found) != SearchOutcome::kFound) return 4.0f;
      *count += (found.px - at).norm() < 0.15f;
      return (found.px - at).norm();
    };
    blurred_sum += static_cast<double>(error(smeared, &found_blurred));
    sharp_sum += static_cast<double>(error(plain, &found_sharp));
  }
  ASSERT_GT(tried, test::trials(100) / 2);
  EXPECT_GT(found_blurred, 0.95 * tried);
  EXPECT_LT(found_sharp, 0.7 * tried) << "control: the streaks matter";
  EXPECT_LT(3 * blurred_sum, sharp_sum);
}

// A short streak costs nothing, and its template is the sharp one.
TEST(Streaks, ShortOnesAreLeftAlone) {
  test::Random random;
  const test::Texture texture(random, 40, 0.15, 0.6);
  const test::OwnedImage image = exposed(texture, Vector2f::Zero());
  Pyramid source;
  source.level[0] = image.view();
  PatchTemplate plain, smeared;
  ASSERT_TRUE(warp_template(source, {32, 32}, Matrix2f::Identity(), 0, &plain));
  ASSERT_TRUE(warp_template(source, {32, 32}, Matrix2f::Identity(), 0, &smeared, {1.9f, 0}));
  EXPECT_TRUE(std::equal(std::begin(plain.px), std::end(plain.px), std::begin(smeared.px)));
}

// The finder blurs templates by the camera's motion while the point is exposed, less what the source's own motion has
// blurred: a sharp keyframe's patches, and those of one that moved alike, are found in a moving camera's image within
// half a pixel, a quarter of a measurement's sigma. Control: predicted without the motion, the sharp one's are not.
TEST(Streaks, FollowFromTheVelocities) {
  test::Random random;
  constexpr float kExposure_s = 0.03f, kStreak_px = 10;
  Config config = Config::phone(test::phone_camera());
  config.camera.shutter = {};
  config.exposure_s = kExposure_s;
  Map* map = nullptr;
  const test::Block block([&](Arena& arena) { map = arena.create<Map>(config); });
  const test::Texture texture(random, 40, 0.08, 0.3);
  const test::OwnedImage sharp = exposed(texture, Vector2f::Zero(), 240, 320),
                         blurred = exposed(texture, {kStreak_px, 0}, 240, 320);
  Vector6f velocity = Vector6f::Zero();
  velocity[0] = kStreak_px / (kExposure_s * config.camera.model.fx);  // of points one unit away
  const auto add = [&](const test::OwnedImage& image, const Vector6f& moving) {
    const int index = test::add_keyframe(*map, SE3());
    Keyframe& keyframe = MapAccess::keyframe(*map, index);
    keyframe.velocity = moving;
    const GreyImage& level = keyframe.storage.level[0];
    for (int y = 0; y < level.height; ++y) std::copy_n(image.view().row(y), level.width, &level.at(0, y));
    keyframe.pyramid = build_pyramid(level, keyframe.storage);
    return index;
  };
  const int still = add(sharp, Vector6f::Zero()), moving = add(blurred, velocity);
  WorkMeter meter;
  const PatchFinder finder(*map, config, meter);
  const auto found = [&](int source_keyframe, const Vector6f& told) {
    int count = 0;
    for (int i = 0; i < 63; ++i) {
      const Vector2f px(40.0f + 20 * static_cast<float>(i % 9), 40.0f + 40 * static_cast<float>(i / 9));
      const Vector3f p_w = config.camera.unproject(px).homogeneous();
      const PatchSource source{static_cast<int16_t>(source_keyframe), px, -p_w.normalized()};
      ImagePoint at;
      count += finder.find(source, p_w, {px, SE3(), told}, map->keyframes()[moving].pyramid, SearchOptions(), &at) ==
                   SearchOutcome::kFound &&
               (at.px - px).norm() < 0.5f;
    }
    return count;
  };
  const int from_still = found(still, velocity), control = found(still, Vector6f::Zero());
  EXPECT_GE(from_still, 45);
  EXPECT_GE(found(moving, velocity), 55);
  EXPECT_LT(control, from_still - 15);
}

// A template serves until its warp, or the streak by which it was blurred, has changed by an eighth of a pixel, and
// only for its own patch.
TEST(KeptTemplates, ServeWhileTheyShowThePatch) {
  test::Random random;
  constexpr float kEighth_px = 0.125f, kCorner_px = 4.9497f;  // the corner's distance from the middle, 3.5 x sqrt 2
  constexpr int kLevel = 1;
  Keyframe source;
  source.id = 3;
  for (int trial = 0; trial < 100; ++trial) {
    Matrix2f A;
    for (int i = 0; i < 4; ++i)
      A.data()[i] = static_cast<float>(random.uniform(-0.3, 0.3)) + (i % 3 == 0 ? 1.0f : 0.0f);
    KeptTemplate kept;
    const Vector2f px(50, 60);
    EXPECT_FALSE(kept.shows(source, px, A, kLevel, {0, 0})) << "there is none yet";
    kept.keyframe_id = source.id;
    kept.source_px = px;
    kept.A_s_t = A.inverse();
    kept.searched_level = kLevel;
    for (const float share : {0.95f, 1.05f}) {
      const bool serves = share < 1;
      const float turn = share * kEighth_px / kCorner_px;
      Matrix2f turned, larger = (1 + turn) * A;
      turned << 1, -turn, turn, 1;
      EXPECT_EQ(kept.shows(source, px, larger, kLevel, {0, 0}), serves) << share;
      EXPECT_EQ(kept.shows(source, px, turned * A, kLevel, {0, 0}), serves) << share;
      EXPECT_EQ(kept.shows(source, px, A, kLevel, {0, 2 * share * kEighth_px}), serves) << share;
    }
    EXPECT_FALSE(kept.shows(source, px + Vector2f(1, 0), A, kLevel, {0, 0}));
    EXPECT_FALSE(kept.shows(source, px, A, kLevel + 1, {0, 0})) << "searched in another level";
    source.id = 4;
    EXPECT_FALSE(kept.shows(source, px, A, kLevel, {0, 0}));
    source.id = 3;
  }
}

// Of more points than there are places, those that are asked for in every search keep theirs; a slot's next point has
// another.
TEST(KeptTemplates, GiveWayInTurn) {
  constexpr int kPoints = 12, kPlaces = 6;
  KeptTemplates* kept = nullptr;
  const test::Block block([&](Arena& arena) { kept = arena.create<KeptTemplates>(kPoints, kPlaces); });
  const auto id = [](int slot) { return static_cast<uint32_t>(100 + slot); };
  const auto note = [&](int slot) { kept->of(slot, id(slot))->keyframe_id = id(slot); };
  const auto has = [&](int slot) { return kept->of(slot, id(slot))->keyframe_id == id(slot); };
  for (const int slot : {0, 1, 2}) note(slot);
  for (int search = 0; search < 40; ++search) {
    kept->begin_search();
    for (const int slot : {0, 1, 2}) EXPECT_TRUE(has(slot)) << search;
    EXPECT_FALSE(has(3 + search % 9)) << search;
    note(3 + search % 9);
  }
  EXPECT_EQ(kept->of(0, id(0) + 50)->keyframe_id, 0u) << "another point in the same slot";
  note(1);
  kept->forget();
  EXPECT_FALSE(has(1));
}

// A point on the ray of a partial point is seen at the source pixel, wherever on the ray, by a camera that moved while
// it read the image out. The tolerance is what project_rolling()'s two passes leave at up to 450 px/s. Control: taken
// from the pose at the keyframe's timestamp it lies pixels off.
TEST(ExposedPose, PutsTheRayWhereTheSourceSawIt) {
  test::Random random;
  const Config config = [] {
    Config phone = Config::phone(test::phone_camera());
    phone.camera.shutter = test::phone_shutter();
    return phone;
  }();
  Map* map = nullptr;
  const test::Block block([&](Arena& arena) { map = arena.create<Map>(config); });
  Vector6f velocity;
  for (int i = 0; i < 6; ++i) velocity[i] = static_cast<float>(random.uniform(-0.2, 0.2));
  velocity[4] = 0.4f;
  const int keyframe = test::add_keyframe(*map, [&](Keyframe& frame) {
    frame.T_kw = SE3::exp(0.3f * velocity);
    frame.velocity = velocity;
    frame.mean_depth = 1;
  });
  float worst_control_px = 0;
  for (int trial = 0; trial < 200; ++trial) {
    PatchSource source;
    source.keyframe = static_cast<int16_t>(keyframe);
    source.px = {static_cast<float>(random.uniform(20, 220)), static_cast<float>(random.uniform(20, 300))};
    const Vector3f ray = config.camera.unproject(source.px).homogeneous();
    const float depth = static_cast<float>(random.uniform(0.7, 3));
    const Keyframe& frame = map->keyframes()[keyframe];
    PredictedPoint seen;
    const auto seen_from = [&](const SE3& T_ws) {
      EXPECT_TRUE(config.camera.project_rolling(frame.T_kw, velocity, T_ws * Vector3f(depth * ray), &seen));
      return (seen.px - source.px).norm();
    };
    EXPECT_LT(seen_from(exposed_pose(*map, config.camera, source)), 0.3f) << source.px.transpose() << " " << depth;
    worst_control_px = std::max(worst_control_px, seen_from(frame.T_kw.inverse()));
  }
  EXPECT_GT(worst_control_px, 2.0f);
}

}  // namespace
}  // namespace pptam
