// Culling of measurements and keyframes: usefulness, votes, connection, what erased keyframes go on doing.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "map/patch_search.h"
#include "mapping/keyframe_votes.h"
#include "mapping/measurement_culling.h"
#include "tests/support/map_building.h"
#include "tests/support/phone_camera.h"
#include "tests/support/random.h"
#include "tracking/relocaliser.h"

namespace pptam {
namespace {

Config small_config() {
  Config config = Config::phone(test::phone_camera());
  config.max_keyframes = 12;
  config.max_erased_keyframes = 2;
  config.max_map_points = 400;
  config.max_partial_points = 5;
  return config;
}

class Job : public Background {
 public:
  Job(Arena& arena, WorkMeter& meter) : Background(arena, 8192, meter) {}
  void start(Task<> (*work)(Job&)) {
    done = false;
    resume();
    task_ = Task<>();  // frames are last in, first out
    task_ = work(*this);
    task_.start();
  }
  KeyframeVotes* culling = nullptr;
  KeyframeEraser* eraser = nullptr;
  int to_erase = -1;
  bool done = false;
  int chosen = -1;

 private:
  Task<> task_;
};

Task<> choose_job(Job& job) {
  job.chosen = co_await job.culling->choose();
  job.done = true;
}
Task<> erase_job(Job& job) {
  co_await job.eraser->erase(job.to_erase);
  co_await job.eraser->forget_surplus();
  job.done = true;
}

class CullingTest : public ::testing::Test {
 protected:
  CullingTest() : CullingTest(small_config()) {}
  explicit CullingTest(const Config& config) : config_(config), meter_(config_.profile) {
    Arena measure;
    build(measure);
    block_.resize(measure.used() + 16);
    void* start = block_.data();
    size_t space = block_.size();
    std::align(16, measure.used(), start, space);
    arena_ = Arena({static_cast<std::byte*>(start), measure.used()});
    build(arena_);
  }
  void build(Arena& arena) {
    map_ = Map(arena, config_);
    job_ = std::make_unique<Job>(arena, meter_);
    culling_ = std::make_unique<KeyframeVotes>(arena, config_, map_, meter_, *job_);
    eraser_ = std::make_unique<KeyframeEraser>(arena, config_, map_, *job_);
    job_->culling = culling_.get();
    job_->eraser = eraser_.get();
  }

  // At centre, looking along z.
  int add_keyframe(const Vector3f& centre, const Matrix3f& R = Matrix3f::Identity()) {
    return test::add_keyframe(map_, SE3(R, -(R * centre)));
  }
  // One unit in front of the cameras, seen where it is.
  int add_point(const Vector3f& p_w, const std::vector<int>& keyframes) {
    const auto measure = [&](int k) { return test::measure_exactly(map_, config_.camera, k, p_w); };
    const int index =
        map_.add_point(p_w, {static_cast<int16_t>(keyframes[0]), measure(keyframes[0]).at.px, -Vector3f::UnitZ()});
    for (const int k : keyframes) map_.add_measurement(index, measure(k));
    return index;
  }
  Vector3f random_offset() {
    return {static_cast<float>(random_.gaussian()), static_cast<float>(random_.gaussian()),
            static_cast<float>(random_.gaussian())};
  }
  Vector3f random_point() {
    return {static_cast<float>(random_.uniform(-0.1, 0.1)), static_cast<float>(random_.uniform(-0.15, 0.15)),
            static_cast<float>(random_.uniform(0.9, 1.1))};
  }
  int choose() {
    job_->start(choose_job);
    while (!job_->done) job_->resume();
    return job_->chosen;
  }
  void erase(int keyframe) {
    job_->to_erase = keyframe;
    job_->start(erase_job);
    while (!job_->done) job_->resume();
  }
  // What the header of Map promises between two slices.
  void expect_consistent() {
    for (const MapPoint& point : map_.points()) {
      if (point.id == 0) continue;
      EXPECT_GE(point.measurements.size(), 2);
      EXPECT_LE(point.measurements.size(), map_.max_measurements_per_point() + 1);
      EXPECT_NE(map_.keyframes()[point.source.keyframe].id, 0u);
      for (const Measurement& m : map_.measurements(point)) EXPECT_TRUE(map_.keyframes()[m.keyframe].live());
    }
    for (const PartialPoint& partial : map_.partial_points())
      EXPECT_TRUE(partial.id == 0 || map_.keyframes()[partial.source.keyframe].id != 0);
    for (const Keyframe& keyframe : map_.keyframes())
      EXPECT_TRUE(keyframe.id == 0 || !keyframe.erased || map_.keyframes()[keyframe.anchor].live());
    map_.check_consistency();
  }
  bool measured_in(int point, int keyframe) const { return map_.measured_in(map_.points()[point], keyframe); }

  test::Random random_;
  Config config_;
  WorkMeter meter_;
  std::vector<std::byte> block_;
  Arena arena_;
  Map map_;
  std::unique_ptr<Job> job_;
  std::unique_ptr<KeyframeVotes> culling_;
  std::unique_ptr<KeyframeEraser> eraser_;
};

// ---- measurements ----

// In double, by the definition.
std::vector<double> usefulness_by_definition(const Map& map, const Camera& camera, const MapPoint& point,
                                             double* trace) {
  std::vector<Eigen::Matrix3d> V_j;
  Eigen::Matrix3d V = Eigen::Matrix3d::Zero();
  for (const Measurement& m : map.measurements(point)) {
    Vector2f px;
    Matrix23f J;
    EXPECT_TRUE(camera.project(map.keyframes()[m.keyframe].T_kw * point.p_w, &px, &J));
    const Eigen::Matrix<double, 2, 3> B =
        (J * map.keyframes()[m.keyframe].T_kw.R).cast<double>() / static_cast<double>(m.at.sigma() * camera.model.fx);
    V_j.emplace_back(static_cast<double>(m.weight) * B.transpose() * B);
    V += V_j.back();
  }
  std::vector<double> m;
  *trace = V.trace();
  for (const Eigen::Matrix3d& V_i : V_j) m.push_back(V.determinant() - (V - V_i).determinant());
  return m;
}

TEST_F(CullingTest, UsefulnessIsTheInformationThatWouldBeLost) {
  double changes = 0, tolerances = 0;
  for (int trial = 0; trial < 50; ++trial) {
    map_.clear();
    const int views = random_.integer(3, 9);
    std::vector<int> seen_by;
    for (int k = 0; k < views; ++k) {
      Vector6f mu;
      for (int i = 0; i < 6; ++i) mu[i] = static_cast<float>((i < 3 ? 0.1 : 0.03) * random_.uniform(-1, 1));
      const SE3 T = SE3::exp(mu);
      seen_by.push_back(add_keyframe(T.centre(), T.R));
      MapAccess::keyframe(map_, k).mean_depth = static_cast<float>(random_.uniform(0.5, 2));  // must not matter
    }
    const int index = add_point(random_point(), seen_by);
    const MapPoint& point = map_.points()[index];
    for (int j = 0; j < views; ++j) {
      MapAccess::measurement(map_, index, j).at.level = static_cast<uint8_t>(random_.integer(1, 2));
      MapAccess::measurement(map_, index, j).weight = static_cast<float>(random_.uniform(0, 1));
    }
    float m[kMaxMeasurementsPerPoint + 1];
    measure_usefulness(map_, config_.camera, point, m);
    double trace = 0;
    const std::vector<double> truth = usefulness_by_definition(map_, config_.camera, point, &trace);
    // One factor for all: that of the depth's sixth power. Determinants are sums of products of three numbers, each of
    // which is at most the trace; a dozen roundings of 6e-8.
    const double factor = std::pow(static_cast<double>(map_.keyframes()[seen_by[0]].mean_depth), 6);
    const double tolerance = 12 * 6e-8 * factor * trace * trace * trace;
    for (int j = 0; j < views; ++j)
      EXPECT_NEAR(static_cast<double>(m[j]), factor * truth[static_cast<size_t>(j)], tolerance) << j;
    // Another weight is another usefulness.
    const double before = static_cast<double>(m[1]);
    MapAccess::measurement(map_, index, 1).weight *= 0.5f;
    measure_usefulness(map_, config_.camera, point, m);
    changes += std::abs(static_cast<double>(m[1]) - before);
    tolerances += tolerance;
  }
  EXPECT_GT(changes, 10 * tolerances) << "the tolerance must be able to fail";
}

TEST_F(CullingTest, CullingKeepsEightAndDropsTheRedundantOne) {
  // Nine cameras on a wide arc, except that one stands where another stands: of two equal views one is redundant.
  for (int trial = 0; trial < 50; ++trial) {
    map_.clear();
    const int twin = random_.integer(2, 8);
    Vector3f centres[9];
    for (int k = 0; k < 9; ++k)
      centres[k] = Vector3f(0.25f * static_cast<float>(k % 3 - 1), 0.25f * static_cast<float>(k / 3 - 1), 0) +
                   0.01f * random_offset();
    centres[twin] = centres[twin == 2 ? 3 : 2] + Vector3f(1e-3f, 0, 0);
    for (int k = 0; k < 9; ++k) {
      const Vector3f z = (Vector3f(0, 0, 1) - centres[k]).normalized();
      const Vector3f x = Vector3f::UnitY().cross(z).normalized();
      SE3 T_kw;
      T_kw.R.row(0) = x.transpose();
      T_kw.R.row(1) = z.cross(x).transpose();
      T_kw.R.row(2) = z.transpose();
      T_kw.t = -(T_kw.R * centres[k]);
      ASSERT_EQ(add_keyframe(centres[k], T_kw.R), k);
    }
    const int index = map_.add_point(Vector3f(0, 0, 1), {0, Vector2f::Zero(), -Vector3f::UnitZ()});
    const MapPoint& point = map_.points()[index];
    for (int16_t k = 0; k < 8; ++k) map_.add_measurement(index, {{Vector2f::Zero(), 1}, k});
    cull_measurements(map_, index, config_.camera, meter_);
    EXPECT_EQ(point.measurements.size(), 8) << "eight are kept";
    map_.add_measurement(index, {{Vector2f::Zero(), 1}, 8});
    // The definition, in double: the measurement whose |V| - |V - V_j| is least.
    Eigen::Matrix3d V_j[9], V = Eigen::Matrix3d::Zero();
    for (int j = 0; j < 9; ++j) {
      Vector2f px;
      Matrix23f J;
      ASSERT_TRUE(config_.camera.project(map_.keyframes()[j].T_kw * point.p_w, &px, &J));
      const Eigen::Matrix<double, 2, 3> B = (J * map_.keyframes()[j].T_kw.R).cast<double>() / (2 * 358.6);
      V_j[j] = B.transpose() * B;
      V += V_j[j];
    }
    cull_measurements(map_, index, config_.camera, meter_);
    ASSERT_EQ(point.measurements.size(), 8);
    bool left[9] = {};
    for (const Measurement& m : map_.measurements(point)) left[m.keyframe] = true;
    EXPECT_TRUE(left[0]) << "the source's stays";
    int gone = 0;
    while (left[gone]) ++gone;
    double least = 1e9;
    for (int j = 1; j < 9; ++j) least = std::min(least, V.determinant() - (V - V_j[j]).determinant());
    // Determinants of order 10 lose 1e-6 of it in float32; two that are nearer than that are equally useful.
    EXPECT_LT(V.determinant() - (V - V_j[gone]).determinant(), least + 1e-5 * V.determinant());
  }
}

TEST_F(CullingTest, AMeasurementFarMorePreciseIsNotDropped) {
  std::vector<int> seen_by;
  for (int k = 0; k < 9; ++k) seen_by.push_back(add_keyframe(0.06f * random_offset()));
  const int point = add_point({0, 0, 1}, seen_by);
  ASSERT_EQ(map_.points()[point].measurements.size(), 9);
  for (int j = 0; j < 9; ++j) MapAccess::measurement(map_, point, j).at.level = j == 5 ? 0 : 3;
  cull_measurements(map_, point, config_.camera, meter_);
  EXPECT_EQ(map_.points()[point].measurements.size(), 8);
  EXPECT_TRUE(measured_in(point, 5));
}

// The source's measurement stays, wherever it is in the list; without one any may go.
TEST_F(CullingTest, TheSourcesMeasurementStays) {
  std::vector<int> seen_by;
  for (int k = 0; k < 9; ++k) seen_by.push_back(add_keyframe(0.06f * random_offset()));
  for (const bool measured : {true, false}) {
    const int point = add_point({0, 0, 1}, seen_by);
    MapAccess::measurement(map_, point, 4).weight = 0;  // the least useful by far
    MapAccess::point(map_, point).source.keyframe = measured ? 4 : -1;
    cull_measurements(map_, point, config_.camera, meter_);
    EXPECT_EQ(map_.points()[point].measurements.size(), 8);
    EXPECT_EQ(measured_in(point, 4), measured);
  }
}

// ---- votes ----

TEST_F(CullingTest, VotesAreThePapersClippedAtZero) {
  EXPECT_EQ(keyframe_vote(2, 1), 0.5f);
  EXPECT_EQ(keyframe_vote(2, 2), 0.5f);
  for (int rank = 1; rank <= 3; ++rank) EXPECT_FLOAT_EQ(keyframe_vote(3, rank), static_cast<float>(4 - rank) / 6);
  for (int o = 4; o <= 9; ++o) {
    float sum = 0;
    for (int rank = 1; rank <= o; ++rank) {
      EXPECT_FLOAT_EQ(keyframe_vote(o, rank), rank <= 4 ? static_cast<float>(5 - rank) / 10 : 0) << o << ' ' << rank;
      sum += keyframe_vote(o, rank);
    }
    EXPECT_FLOAT_EQ(sum, 1);
  }
  // As printed in the paper the ninth of nine would take half a vote away.
  const float as_printed = static_cast<float>(4 - (9 - 1)) / 10;
  EXPECT_LT(as_printed, keyframe_vote(9, 9));
}

TEST_F(CullingTest, VotesOfAMapCountedByHand) {
  // Six cameras side by side on a circle about the point, so that only their precision tells them apart: the more
  // precise, the more useful.
  for (int k = 0; k < 6; ++k) {
    const float angle = static_cast<float>(k) * 1.0472f;
    add_keyframe({0.2f * std::cos(angle), 0.2f * std::sin(angle), 0});
  }
  const auto precise = [&](int index, const std::vector<float>& weights) {
    for (size_t j = 0; j < weights.size(); ++j)
      MapAccess::measurement(map_, index, static_cast<int>(j)).weight = weights[j];
  };
  add_point({0, 0, 1}, {0, 1});                                                               // 0: 1/2, 1: 1/2
  precise(add_point({0, 0, 1}, {0, 2, 4}), {0.01f, 1, 0.1f});                                 // 2: 3/6, 4: 2/6, 0: 1/6
  precise(add_point({0, 0, 1}, {0, 1, 2, 3, 4, 5}), {1, 1e-5f, 1e-2f, 1e-4f, 1e-3f, 1e-1f});  // 0, 5, 2, 4: 4 to 1 / 10
  choose();
  EXPECT_NEAR(culling_->votes(0), 0.5 + 1.0 / 6 + 0.4, 1e-6);
  EXPECT_NEAR(culling_->votes(1), 0.5, 1e-6) << "rank six of six takes nothing away";
  EXPECT_NEAR(culling_->votes(2), 0.5 + 0.2, 1e-6);
  EXPECT_NEAR(culling_->votes(3), 0, 1e-6);
  EXPECT_NEAR(culling_->votes(4), 2.0 / 6 + 0.1, 1e-6);
  EXPECT_NEAR(culling_->votes(5), 0.3, 1e-6);
}

TEST_F(CullingTest, TheLeastUsefulUnderTheThresholdGoes) {
  for (int k = 0; k < 6; ++k) add_keyframe({0.05f * static_cast<float>(k), 0, 0});
  for (const int k : {1, 2, 4, 5})
    for (int i = 0; i < 60; ++i) add_point(random_point(), {0, k});  // thirty votes each
  for (int i = 0; i < 20; ++i) add_point(random_point(), {0, 3});    // ten votes for 3
  EXPECT_EQ(choose(), 3);
  EXPECT_FLOAT_EQ(culling_->votes(3), 10);
  for (int i = 0; i < 50; ++i) add_point(random_point(), {0, 3});
  EXPECT_NE(choose(), 3) << "over the threshold now";
  EXPECT_FLOAT_EQ(culling_->votes(3), 35);
}

TEST_F(CullingTest, TheDatumAndTheTwoNewestStay) {
  for (int k = 0; k < 3; ++k) add_keyframe({0.05f * static_cast<float>(k), 0, 0});
  for (int i = 0; i < 20; ++i) add_point(random_point(), {0, 1, 2});
  EXPECT_EQ(choose(), -1);
  add_keyframe({0.2f, 0, 0});
  EXPECT_EQ(choose(), 1) << "not among the two newest any more";
}

// Two halves of a map that only one keyframe holds together.
TEST_F(CullingTest, NeverSplitsTheMap) {
  for (int k = 0; k < 11; ++k) add_keyframe({0.05f * static_cast<float>(k), 0, 0});
  const int bridge = 5;
  const auto add = [&](int count, const std::vector<int>& seen_by) {
    for (int i = 0; i < count; ++i)
      add_point(random_point() + Vector3f(0.05f * static_cast<float>(seen_by[0]), 0, 0), seen_by);
  };
  for (const int first : {0, 6})
    for (int k = 0; k < 5; ++k) add(35, {first + k, first + (k + 1) % 5, first + (k + 2) % 5});  // at least 17.5 votes
  add(16, {4, 5});
  add(16, {5, 6});  // sixteen votes for the bridge
  // The bridge has the fewest votes, and would go by the paper's rule.
  const int chosen = choose();
  for (int k = 1; k < 9; ++k) EXPECT_TRUE(k == bridge || culling_->votes(k) > culling_->votes(bridge)) << k;
  EXPECT_LT(culling_->votes(bridge), kMaxVotesToErase);
  EXPECT_NE(chosen, bridge);
  // 4 and 6 hold it up too.
  EXPECT_NE(chosen, 4);
  EXPECT_NE(chosen, 6);
  // Fewer common points than the guard asks for are still a connection while there is no better one.
  for (int i = 0, left = 2 * 6; i < map_.points().size() && left > 0; ++i)
    if (map_.points()[i].id != 0 && map_.points()[i].measurements.size() == 2) map_.remove_point(i), --left;
  EXPECT_NE(choose(), bridge);
  // With another way round it may go.
  for (int i = 0; i < kMinCommonPoints; ++i) add_point(random_point() + Vector3f(0.25f, 0, 0), {3, 7});
  EXPECT_EQ(choose(), bridge);
}

TEST_F(CullingTest, ADecisionIsCheapAndInSlices) {
  const Config config = Config::phone(config_.camera.model);
  // The map of the paper's figures: 35 keyframes, 300 points, 8 measurements each.
  struct Big : CullingTest {
    explicit Big(const Config& c) : CullingTest(c) {}
    void TestBody() override {}
    void run() {
      for (int k = 0; k < 35; ++k) add_keyframe({0.005f * static_cast<float>(k), 0, 0});
      for (int i = 0; i < 300; ++i) {
        std::vector<int> seen_by;
        for (int k = 0; k < 8; ++k) seen_by.push_back(random_.integer(0, 3) + 4 * k);
        add_point(random_point(), seen_by);
      }
      const int64_t start = meter_.instructions();
      int64_t slice_start = start, longest = 0;
      job_->start(choose_job);
      for (;;) {
        longest = std::max(longest, meter_.instructions() - slice_start);
        if (job_->done) break;
        slice_start = meter_.instructions();
        job_->resume();
      }
      EXPECT_LT(meter_.instructions() - start, 2'000'000);
      EXPECT_GT(meter_.instructions() - start, 300'000) << "charged at all";
      EXPECT_LT(longest, kSliceInstructions);
      RecordProperty("instructions", std::to_string(meter_.instructions() - start));
    }
  };
  Big big(config);
  big.run();
}

// ---- erased keyframes ----

TEST_F(CullingTest, ErasingTakesMeasurementsAndPointsThatLoseTheirSecond) {
  for (int k = 0; k < 5; ++k) add_keyframe({0.05f * static_cast<float>(k), 0, 0});
  const int keeps = add_point(random_point(), {1, 2, 3});
  const int goes = add_point(random_point(), {0, 2});
  const int other = add_point(random_point(), {0, 1});
  map_.erase_keyframe(2);
  expect_consistent();
  EXPECT_EQ(map_.points()[keeps].measurements.size(), 2);
  EXPECT_EQ(map_.points()[goes].id, 0u);
  EXPECT_EQ(map_.points()[other].measurements.size(), 2);
  EXPECT_EQ(map_.live_count(), 4);
  EXPECT_EQ(map_.erased_count(), 1);
}

TEST_F(CullingTest, ErasedKeyframesFollowTheirAnchors) {
  for (int k = 0; k < 5; ++k) add_keyframe({0.1f * static_cast<float>(k), 0, 0});
  const SE3 before = map_.keyframes()[2].T_kw;
  map_.erase_keyframe(2);
  ASSERT_TRUE(map_.keyframes()[2].anchor == 1 || map_.keyframes()[2].anchor == 3);
  const int anchor = map_.keyframes()[2].anchor;
  const SE3 relative = before * map_.keyframes()[anchor].T_kw.inverse();
  Vector6f mu;
  mu << 0.3f, -0.2f, 0.1f, 0.2f, 0.1f, -0.3f;
  map_.move_keyframe(anchor, SE3::exp(mu) * map_.keyframes()[anchor].T_kw);
  map_.follow_anchors();
  const auto expect_same = [&](const SE3& a, const SE3& b) {
    // Products of a few rotations and positions of order one: ten roundings of 6e-8.
    EXPECT_LT((a.R - b.R).norm(), 2e-6f);
    EXPECT_LT((a.t - b.t).norm(), 2e-6f);
  };
  const SE3 after = relative * map_.keyframes()[anchor].T_kw;
  expect_same(map_.keyframes()[2].T_kw, after);
  EXPECT_GT((map_.keyframes()[2].T_kw.t - before.t).norm(), 0.1f) << "it has moved";
  // Its anchor goes: it stays where it is, and follows another.
  map_.erase_keyframe(anchor);
  expect_same(map_.keyframes()[2].T_kw, after);
  EXPECT_NE(map_.keyframes()[2].anchor, anchor);
  map_.follow_anchors();
  expect_same(map_.keyframes()[2].T_kw, after);
  // A change of coordinates, and what follows still fits.
  Similarity S;
  S.T = SE3::exp(mu);
  S.scale = 2.5f;
  map_.apply(S);
  const SE3 moved = map_.keyframes()[2].T_kw;
  map_.follow_anchors();
  EXPECT_LT((map_.keyframes()[2].T_kw.t - moved.t).norm(), 1e-5f);
  EXPECT_LT((map_.keyframes()[2].T_kw.R - moved.R).norm(), 1e-5f);
  expect_consistent();
}

// A plane one unit away, painted with smooth noise, seen by cameras that look straight at it.
class PaintedCullingTest : public CullingTest {
 protected:
  PaintedCullingTest() {
    for (float& value : paint_) value = static_cast<float>(random_.uniform(40, 215));
  }
  float paint(float x, float y) const {  // bilinear on a grid of a hundredth of a unit
    const float u = 100 * x + 200, v = 100 * y + 200;
    const int i = static_cast<int>(u), j = static_cast<int>(v);
    const float a = u - static_cast<float>(i), b = v - static_cast<float>(j);
    const auto at = [&](int ii, int jj) { return paint_[static_cast<size_t>(jj * kGrid + ii)]; };
    return (1 - b) * ((1 - a) * at(i, j) + a * at(i + 1, j)) + b * ((1 - a) * at(i, j + 1) + a * at(i + 1, j + 1));
  }
  int add_painted(const Vector3f& centre) {
    const int index = add_keyframe(centre);
    Keyframe& keyframe = MapAccess::keyframe(map_, index);
    const GreyImage& image = keyframe.storage.level[0];
    for (int y = 0; y < image.height; ++y) {
      for (int x = 0; x < image.width; ++x) {
        const Vector2f ray = config_.camera.unproject({static_cast<float>(x), static_cast<float>(y)});
        image.at(x, y) = static_cast<uint8_t>(paint(ray.x() + centre.x(), ray.y() + centre.y()) + 0.5f);
      }
    }
    keyframe.pyramid = build_pyramid(image, keyframe.storage);
    make_small_image(keyframe.pyramid, keyframe.small);
    return index;
  }
  // Where the point's patch is found in a keyframe, level-0 px off its projection; -1: not found.
  float patch_error_px(const MapPoint& point, int keyframe) {
    Vector2f px;
    EXPECT_TRUE(config_.camera.project(map_.keyframes()[keyframe].T_kw * point.p_w, &px));
    ImagePoint found;
    const PatchFinder finder(map_, config_, meter_);
    if (finder.find(point.source, point.p_w, {px, map_.keyframes()[keyframe].T_kw}, map_.keyframes()[keyframe].pyramid,
                    SearchOptions(), &found) != SearchOutcome::kFound)
      return -1;
    return (found.px - px).norm();
  }

  static constexpr int kGrid = 401;
  std::vector<float> paint_ = std::vector<float>(kGrid * kGrid);
};

TEST_F(PaintedCullingTest, ErasedKeyframesServePatchesAndRelocalisation) {
  for (int k = 0; k < 5; ++k) add_painted({0.04f * static_cast<float>(k), 0.01f * static_cast<float>(k), 0});
  std::vector<int> points;
  for (int i = 0; i < 20; ++i) {
    const Vector3f p_w(static_cast<float>(random_.uniform(-0.05, 0.2)), static_cast<float>(random_.uniform(-0.2, 0.2)),
                       1);
    points.push_back(add_point(p_w, {2, 1, 3}));
  }
  map_.erase_keyframe(2);
  expect_consistent();
  int found = 0;
  for (const int i : points) {
    EXPECT_EQ(map_.points()[i].source.keyframe, 2);
    const float error = patch_error_px(map_.points()[i], 4);
    found += error >= 0;
    // Rendered to one grey level, patches of contrast 25 and more: [tests/kernels] a tenth of a pixel of level 1.
    EXPECT_LT(error, 0.5f) << i;
  }
  EXPECT_GE(found, 15);
  // Seen from where the erased one stood: it is the best match, and its pose comes back.
  Arena measure;
  const FullFrameRotation measured(measure, config_.camera);
  std::vector<std::max_align_t> memory(measure.used() / sizeof(std::max_align_t) + 1);
  Arena arena(std::as_writable_bytes(std::span(memory)));
  FullFrameRotation rotation(arena, config_.camera);
  const RelocalisationCandidate candidate =
      propose_pose(map_, config_.camera, rotation, false, map_.keyframes()[2].small, 0, meter_);
  EXPECT_EQ(candidate.keyframe, 2);
  EXPECT_LT((candidate.T_cw.t - map_.keyframes()[2].T_kw.t).norm(), 1e-3f);
}

TEST_F(PaintedCullingTest, ForgettingGivesPointsAnotherSource) {
  for (int k = 0; k < 5; ++k) add_painted({0.04f * static_cast<float>(k), 0.01f * static_cast<float>(k), 0});
  std::vector<int> points;
  for (int i = 0; i < 20; ++i) {
    const Vector3f p_w(static_cast<float>(random_.uniform(-0.05, 0.2)), static_cast<float>(random_.uniform(-0.2, 0.2)),
                       1);
    points.push_back(add_point(p_w, {2, 1, 3}));
  }
  const auto add_partial = [&](int16_t k) {
    return map_.add_partial_point({k, Vector2f::Zero(), -Vector3f::UnitZ()}, Vector3f::UnitZ(), 1);
  };
  const int partial = add_partial(2), other_partial = add_partial(1);
  uint32_t ids[5];
  for (int k = 0; k < 5; ++k) ids[k] = map_.keyframes()[k].id;

  map_.erase_keyframe(2);
  EXPECT_NE(map_.partial_points()[partial].id, 0u) << "its patch is still there";
  map_.forget_keyframe(2);
  expect_consistent();
  EXPECT_EQ(map_.partial_points()[partial].id, 0u);
  EXPECT_NE(map_.partial_points()[other_partial].id, 0u);
  int found = 0;
  for (const int i : points) {
    const MapPoint& point = map_.points()[i];
    ASSERT_NE(point.id, 0u);
    EXPECT_TRUE(point.source.keyframe == 1 || point.source.keyframe == 3);
    EXPECT_LT((point.source.normal - Vector3f(0, 0, -1)).norm(), 1e-6f) << "the same plane";
    const float error = patch_error_px(point, 4);
    found += error >= 0;
    EXPECT_LT(error, 0.5f);
  }
  EXPECT_GE(found, 15);
  // The slot is free, the others are where they were.
  for (int k = 0; k < 5; ++k) EXPECT_EQ(map_.keyframes()[k].id, k == 2 ? 0 : ids[k]);
  EXPECT_EQ(map_.live_count(), 4);
  EXPECT_EQ(add_painted({0.3f, 0, 0}), 2);
  EXPECT_GT(map_.keyframes()[2].id, ids[4]) << "an id is never used again";
}

TEST_F(CullingTest, ErasedOnesAreBounded) {
  for (int k = 0; k < 9; ++k) add_keyframe({0.02f * static_cast<float>(k), 0, 0});
  add_keyframe({0.061f, 0, 0});  // 9: nearly where 3 stands
  for (int i = 0; i < 20; ++i) add_point(random_point(), {0, 1, 2, 4, 5, 6, 7, 8});
  // Two are kept; of the third erasure on, the one whose view another keyframe has too is forgotten.
  uint32_t id3 = map_.keyframes()[3].id;
  erase(3);
  erase(5);
  EXPECT_EQ(map_.erased_count(), 2);
  EXPECT_EQ(map_.keyframes()[3].id, id3);
  erase(7);
  EXPECT_EQ(map_.erased_count(), config_.max_erased_keyframes);
  EXPECT_EQ(map_.keyframes()[3].id, 0u);
  EXPECT_TRUE(map_.keyframes()[5].erased);
  EXPECT_TRUE(map_.keyframes()[7].erased);
  expect_consistent();
}

// However keyframes come and go, what the map promises holds.
TEST_F(CullingTest, AnyHistoryLeavesAConsistentMap) {
  add_keyframe({0, 0, 0});
  for (int step = 0; step < test::trials(400); ++step) {
    std::vector<int> live, erased;
    for (int k = 0; k < map_.keyframes().size(); ++k) {
      if (map_.keyframes()[k].live()) live.push_back(k);
      if (map_.keyframes()[k].id != 0 && map_.keyframes()[k].erased) erased.push_back(k);
    }
    const auto any = [&](const std::vector<int>& of) {
      return of[static_cast<size_t>(random_.integer(0, static_cast<int>(of.size()) - 1))];
    };
    const int what = random_.integer(0, 3);
    if (what == 0 && static_cast<int>(live.size()) <= config_.max_keyframes) {
      const int k = add_keyframe(
          {static_cast<float>(random_.uniform(-0.1, 0.1)), static_cast<float>(random_.uniform(-0.1, 0.1)), 0});
      ASSERT_GE(k, 0);
      for (int i = 0; i < map_.points().size(); ++i) {
        const MapPoint& point = map_.points()[i];
        if (point.id == 0 || random_.uniform(0, 1) < 0.5) continue;
        Measurement m;
        m.keyframe = static_cast<int16_t>(k);
        if (!config_.camera.project(map_.keyframes()[k].T_kw * point.p_w, &m.at.px)) continue;
        map_.add_measurement(i, m);
        cull_measurements(map_, i, config_.camera, meter_);
      }
    } else if (what == 1 && live.size() >= 2) {
      const int a = any(live), b = any(live);
      if (a != b && map_.point_count() < config_.max_map_points) add_point(random_point(), {a, b});
    } else if (what == 2) {
      if (map_.point_count() > 0)
        map_.add_partial_point(
            {static_cast<int16_t>(any(erased.empty() ? live : erased)), Vector2f::Zero(), -Vector3f::UnitZ()},
            Vector3f::UnitZ(), 1);
    } else if (live.size() > 8) {
      int k = any(live);
      if (k == 0) k = live.back();
      erase(k);
    }
    expect_consistent();
    ASSERT_TRUE(map_.keyframes()[0].live());
    ASSERT_LE(map_.erased_count(), config_.max_erased_keyframes);
    if (HasFailure()) break;
  }
}

}  // namespace
}  // namespace pptam
