// The pose update: exact data, the promised covariance, outliers, the rolling shutter, and what is refused.
#include "camera/pose_update.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>
#include <vector>

#include "geometry/robust.h"
#include "tests/support/map_building.h"
#include "tests/support/phone_camera.h"
#include "tests/support/random.h"

namespace pptam {
namespace {

constexpr int kPoints = 50;
static_assert(kRobustSigmaFloor == 0.15f, "measurements of less noise than that are as good as exact");

using test::phone_camera;
using test::phone_shutter;

Vector6f random_twist(test::Random& random, double translation, double rotation) {
  Vector6f mu;
  for (int i = 0; i < 3; ++i) {
    mu(i) = static_cast<float>(translation * random.gaussian());
    mu(i + 3) = static_cast<float>(rotation * random.gaussian());
  }
  return mu;
}

struct View {
  SE3 T_cw;
  Vector6f velocity = Vector6f::Zero();
  std::vector<PosePoint> points;
};

// Where the point is seen when its own line is exposed; the iteration contracts by the image speed times the line's
// time, under 0.2 here, so that 20 passes leave 1e-12 px.
Vector2f rolling_pixel(const Camera& camera, const SE3& T_cw, const Vector6f& velocity, const Vector3f& p_w) {
  Vector2f px(camera.model.cx, camera.model.cy);
  for (int pass = 0; pass < 20; ++pass) {
    const SE3 T_line = pose_at(T_cw, velocity, camera.dt_s(px));
    if (!camera.project(T_line * p_w, &px)) ADD_FAILURE() << "the test's point is not visible";
  }
  return px;
}

// A random pose and points 0.7 to 1.5 away all over the image, measured with noise of `noise` sigmas.
View random_view(test::Random& random, const RollingShutter& shutter, const Vector6f& velocity, double noise) {
  const Camera camera = {phone_camera(), shutter};
  View view;
  view.T_cw = SE3::exp(random_twist(random, 0.5, 0.7));
  view.velocity = velocity;
  const SE3 T_wc = view.T_cw.inverse();
  for (int i = 0; i < kPoints; ++i) {
    const Vector2f ray = camera.unproject(
        Vector2f(static_cast<float>(random.uniform(15, 225)), static_cast<float>(random.uniform(15, 305))));
    const float z = static_cast<float>(random.uniform(0.7, 1.5));
    PosePoint point;
    point.p_w = T_wc * Vector3f(ray.x() * z, ray.y() * z, z);
    point.found.px = rolling_pixel(camera, view.T_cw, velocity, point.p_w);
    for (int k = 0; k < 2; ++k)
      point.found.px(k) += static_cast<float>(noise) * point.found.sigma() * static_cast<float>(random.gaussian());
    view.points.push_back(point);
  }
  return view;
}

// Root mean square over the points of how far two poses' images of them lie apart, level-0 pixels.
double image_error(const View& view, const SE3& T_cw) {
  const CameraModel camera = phone_camera();
  double sum = 0;
  for (const PosePoint& point : view.points) {
    Vector2f a, b;
    if (!camera.project(view.T_cw * point.p_w, &a) || !camera.project(T_cw * point.p_w, &b)) return 1e9;
    sum += (a - b).cast<double>().squaredNorm();
  }
  return std::sqrt(sum / static_cast<double>(view.points.size()));
}

// A PoseUpdater with its memory.
class Updater {
 public:
  explicit Updater(bool rolling_shutter, int max_rows = kPoints)
      : block_([&](Arena& arena) { updater_.emplace(arena, max_rows, rolling_shutter, meter_); }) {}
  PoseUpdater* operator->() { return &*updater_; }

 private:
  WorkMeter meter_;
  std::optional<PoseUpdater> updater_;
  test::Block block_;
};

// rows: as they were last weighted; may be null.
PoseUpdate update(const View& view, const RollingShutter& shutter, const SE3& T_start, const VelocityPrior& prior,
                  std::vector<PoseRow>* rows = nullptr) {
  const Camera camera = {phone_camera(), shutter};
  Updater updater(shutter.line_time_s != 0);
  const PoseUpdate pose = updater->run(T_start, prior, PosePoints(camera, view.points));
  if (rows) rows->assign(updater->rows().begin(), updater->rows().end());
  return pose;
}

// The same without weights, by Gauss-Newton: what outliers do when nothing rejects them.
SE3 least_squares(const View& view, SE3 T) {
  const CameraModel camera = phone_camera();
  for (int iteration = 0; iteration < 20; ++iteration) {
    Eigen::MatrixXd H = Eigen::MatrixXd::Zero(6, 6);
    Eigen::VectorXd g = Eigen::VectorXd::Zero(6);
    for (const PosePoint& point : view.points) {
      const Vector3f p_c = T * point.p_w;
      Vector2f px;
      Matrix23f J_px_p;
      if (!camera.project(p_c, &px, &J_px_p)) continue;
      const Eigen::MatrixXd J = (J_px_p * se3_point_jacobian(p_c)).cast<double>();
      H += J.transpose() * J;
      g += J.transpose() * (point.found.px - px).cast<double>();
    }
    const Eigen::VectorXd step = H.ldlt().solve(g);
    T = SE3::exp(step.cast<float>()) * T;
  }
  return T;
}

bool same_bits(const SE3& a, const SE3& b) {
  return std::memcmp(a.R.data(), b.R.data(), sizeof(float) * 9) == 0 &&
         std::memcmp(a.t.data(), b.t.data(), sizeof(float) * 3) == 0;
}

TEST(PoseUpdate, ExactMeasurementsGiveTheTruePose) {
  test::Random random;
  // The errors of the last step are those of the linearisation, from which all steps since are up to 3.2e-3 away
  // (kLinearSq): what their square leaves out is 1e-5 x f = 0.0036 px. Rounding is a tenth of that: each entry of R and
  // t in every one of up to ten updates 10 x 6e-8 x f = 2e-4 px, the measured pixel 1.5e-5 px.
  const double tolerance_px = 4e-3;
  for (int trial = 0; trial < 200; ++trial) {
    const View view = random_view(random, {}, Vector6f::Zero(), 0);
    const SE3 T_start = SE3::exp(random_twist(random, 0.02, 0.02)) * view.T_cw;  // about 7 px each
    const PoseUpdate pose = update(view, {}, T_start, {});
    ASSERT_TRUE(pose.ok) << trial;
    EXPECT_EQ(pose.inliers, kPoints);
    EXPECT_LT(image_error(view, pose.T_cw), tolerance_px) << trial;
    Vector6f slip = Vector6f::Zero();
    slip(4) = 4e-5f;  // a turn of a hundred-thousandth of a circle
    EXPECT_GT(image_error(view, SE3::exp(slip) * pose.T_cw), tolerance_px) << "the measure must be able to fail";
  }
}

// Mean over many trials of mu^T C^-1 mu, which has 6 degrees of freedom when the covariance C is right.
double mean_nees(test::Random& random, bool rolling, int trials) {
  const RollingShutter shutter = rolling ? phone_shutter() : RollingShutter{};
  double sum = 0;
  for (int trial = 0; trial < trials; ++trial) {
    VelocityPrior prior;
    Vector6f velocity = Vector6f::Zero();
    if (rolling) {
      prior.mean = random_twist(random, 0.1, 0.3);
      prior.sigma_translation = 0.06f;
      prior.sigma_rotation = 0.15f;
      velocity = prior.mean + random_twist(random, prior.sigma_translation, prior.sigma_rotation);
    }
    View view = random_view(random, shutter, velocity, 0.5);
    const SE3 T_start = SE3::exp(random_twist(random, 0.01, 0.01)) * view.T_cw;
    const PoseUpdate pose = update(view, shutter, T_start, prior);
    if (!pose.ok) {
      ADD_FAILURE() << "no pose in trial " << trial;
      return 0;
    }
    const Eigen::Matrix<double, 6, 1> mu = (pose.T_cw * view.T_cw.inverse()).log().cast<double>();
    const Eigen::Matrix<double, 6, 6> covariance = pose.covariance.cast<double>();
    sum += mu.dot(covariance.ldlt().solve(mu));
  }
  return sum / trials;
}

// What to expect of the mean: the reported covariance divides by the mean Tukey weight of Gaussian residuals, 0.859 at
// the cut-off of 5.12 sigma, the estimator's own is 1/0.95 of least squares: 6 x 0.859 / 0.95 = 5.4. The residuals'
// scale is too small by the fitted parameters (6 to 12 of 100 equations): 5.8 to 6.2. A trial's value has a variance
// of 12, and some for the scale's own 20 %: the mean of 400 is good to 0.2. Four of these and 0.3 for curvature.
constexpr double kNeesLow = 4.7, kNeesHigh = 7.1;

TEST(PoseUpdate, ErrorsMatchTheReportedCovariance) {
  test::Random random;
  for (const bool rolling : {false, true}) {
    const double nees = mean_nees(random, rolling, 400);
    EXPECT_GT(nees, kNeesLow) << "rolling " << rolling;
    EXPECT_LT(nees, kNeesHigh) << "rolling " << rolling;
    // A covariance that is wrong by a factor of 1.6 (a standard deviation by 1.26) must show.
    EXPECT_GT(nees * 1.6, kNeesHigh);
    EXPECT_LT(nees / 1.6, kNeesLow);
  }
}

TEST(PoseUpdate, FortyPerCentOutliersAreRejected) {
  test::Random random;
  double worst = 0, unweighted = 0;
  const int trials = 200;
  int lost_inliers = 0;
  for (int trial = 0; trial < trials; ++trial) {
    View view = random_view(random, {}, Vector6f::Zero(), 0.5);
    const int outliers = kPoints * 2 / 5;
    for (int i = 0; i < outliers; ++i) {
      const double angle = random.uniform(0, 6.28318), size = random.uniform(20, 60);
      view.points[static_cast<size_t>(i)].found.px += Vector2f(static_cast<float>(size * std::cos(angle)),  //
                                                               static_cast<float>(size * std::sin(angle)));
    }
    const SE3 T_start = SE3::exp(random_twist(random, 0.005, 0.005)) * view.T_cw;
    std::vector<PoseRow> rows;
    const PoseUpdate pose = update(view, {}, T_start, {}, &rows);
    ASSERT_TRUE(pose.ok) << trial;
    ASSERT_EQ(rows.size(), view.points.size());
    // With 40 % outliers the median sits at 0.83 of the good ones: a scale 1.6 times too large, 5.12 of which are 8 px;
    // even beside a pose error of 1.5 px and noise of 4 sigma none of 20 px is within.
    for (int i = 0; i < outliers; ++i) EXPECT_EQ(rows[static_cast<size_t>(i)].weight, 0.0f) << trial;
    for (int i = outliers; i < kPoints; ++i) lost_inliers += rows[static_cast<size_t>(i)].weight == 0;
    worst = std::max(worst, image_error(view, pose.T_cw));
    unweighted += image_error(view, least_squares(view, T_start)) / trials;
  }
  // 30 points of 1 px: rms over the image sqrt(6 / 60) = 0.32 px (at two coordinates: x sqrt 2 = 0.45); the worst of
  // 200 trials at sqrt(chi2_6 / 6) = 2.1 times that.
  EXPECT_LT(worst, 1.3);
  EXPECT_EQ(lost_inliers, 0);
  EXPECT_GT(unweighted, 2.6) << "least squares must fail here, or the outliers were too easy";
}

TEST(PoseUpdate, RecoversTheVelocityDuringTheReadout) {
  test::Random random;
  const CameraModel camera = phone_camera();
  const RollingShutter shutter = phone_shutter();
  double with_prior = 0, without = 0, flow_error = 0, prior_flow_error = 0;
  const int trials = 100;
  for (int trial = 0; trial < trials; ++trial) {
    // 0.6 radians/s about axes in the image plane, 0.15 units/s sideways: some 270 px/s.
    const double a = random.uniform(0, 6.28318), b = random.uniform(0, 6.28318);
    Vector6f velocity;
    velocity << static_cast<float>(0.15 * std::cos(b)), static_cast<float>(0.15 * std::sin(b)), 0,
        static_cast<float>(0.6 * std::cos(a)), static_cast<float>(0.6 * std::sin(a)), 0.1f;
    View view = random_view(random, shutter, velocity, 0.15);
    const SE3 T_start = SE3::exp(random_twist(random, 0.005, 0.005)) * view.T_cw;
    VelocityPrior prior;
    prior.sigma_translation = 0.06f;
    prior.sigma_rotation = 0.15f;
    prior.mean = velocity + random_twist(random, prior.sigma_translation, prior.sigma_rotation);
    const PoseUpdate pose = update(view, shutter, T_start, prior);
    const PoseUpdate global = update(view, {}, T_start, {});
    ASSERT_TRUE(pose.ok);
    ASSERT_TRUE(global.ok);
    with_prior += image_error(view, pose.T_cw) / trials;
    without += image_error(view, global.T_cw) / trials;
    // Image motion during half the readout, by the estimated and by the prior's velocity.
    for (const PosePoint& point : view.points) {
      const Vector3f p_c = view.T_cw * point.p_w;
      Vector2f px;
      Matrix23f J;
      ASSERT_TRUE(camera.project(p_c, &px, &J));
      const Matrix26f J_v = J * se3_point_jacobian(p_c) * 0.030f;
      flow_error += (J_v * (pose.velocity - velocity)).squaredNorm() / (trials * kPoints);
      prior_flow_error += (J_v * (prior.mean - velocity)).squaredNorm() / (trials * kPoints);
    }
  }
  // Twelve parameters from 100 equations of 0.3 px: the fitted images are good to 0.3 sqrt(2 x 12 / 100) = 0.15 px; the
  // pose alone and the flow over half the readout are the middle and the ends of that fit, at most twice as bad.
  EXPECT_LT(with_prior, 0.30);
  EXPECT_LT(std::sqrt(flow_error), 0.30);
  EXPECT_GT(std::sqrt(prior_flow_error), 1.2) << "the prior must have been wrong";
  EXPECT_GT(without, 4 * with_prior);
}

TEST(PoseUpdate, FixedVelocityStaysAsGiven) {
  test::Random random;
  VelocityPrior prior;
  prior.mean = random_twist(random, 0.1, 0.3);
  View view = random_view(random, phone_shutter(), prior.mean, 0);
  const PoseUpdate pose = update(view, phone_shutter(), view.T_cw, prior);
  ASSERT_TRUE(pose.ok);
  EXPECT_EQ(pose.velocity, prior.mean);
  EXPECT_LT(image_error(view, pose.T_cw), 5e-4);  // as for exact measurements without a rolling shutter
}

void expect_refused(const View& view, const char* why) {
  const SE3 T_start = SE3::exp(Vector6f::Constant(0.001f)) * view.T_cw;
  VelocityPrior prior;
  prior.sigma_translation = 0.06f;
  prior.sigma_rotation = 0.15f;
  for (const RollingShutter& shutter : {RollingShutter{}, phone_shutter()}) {
    const PoseUpdate pose = update(view, shutter, T_start, prior);
    EXPECT_FALSE(pose.ok) << why;
    EXPECT_TRUE(same_bits(pose.T_cw, T_start)) << why;
  }
}

TEST(PoseUpdate, RefusesWhatDoesNotGiveAPose) {
  test::Random random;
  const View good = random_view(random, {}, Vector6f::Zero(), 0.1);
  View view = good;
  view.points.clear();
  expect_refused(view, "no points");
  view.points.assign(good.points.begin(), good.points.begin() + 5);
  expect_refused(view, "five points");
  view = good;
  for (PosePoint& point : view.points) point.p_w = view.T_cw.inverse() * -(view.T_cw * point.p_w);
  expect_refused(view, "all behind");
  for (size_t i = 0; i < 5; ++i) view.points[i] = good.points[i];
  expect_refused(view, "five in front, the others behind");
  view = good;
  for (PosePoint& point : view.points) point = view.points[0];
  expect_refused(view, "one point fifty times");
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinity = std::numeric_limits<float>::infinity();
  for (const float bad : {nan, infinity, -infinity}) {
    view = good;
    for (PosePoint& point : view.points) point.found.px.x() = bad;
    expect_refused(view, "measurements not finite");
    view = good;
    for (PosePoint& point : view.points) point.p_w.y() = bad;
    expect_refused(view, "points not finite");
  }
}

TEST(PoseUpdate, OneBadNumberAmongManyNeverGivesAWildPose) {
  test::Random random;
  const float nan = std::numeric_limits<float>::quiet_NaN();
  for (int trial = 0; trial < 200; ++trial) {
    View view = random_view(random, {}, Vector6f::Zero(), 0.1);
    const int victim = random.integer(0, kPoints - 1);
    PosePoint& point = view.points[static_cast<size_t>(victim)];
    (trial % 2 ? point.found.px.x() : point.p_w.x()) = nan;
    const SE3 T_start = SE3::exp(random_twist(random, 0.005, 0.005)) * view.T_cw;
    std::vector<PoseRow> rows;
    const PoseUpdate pose = update(view, {}, T_start, {}, &rows);
    EXPECT_EQ(rows[static_cast<size_t>(victim)].weight, 0.0f) << trial;
    view.points.erase(view.points.begin() + victim);
    if (pose.ok) {
      EXPECT_LT(image_error(view, pose.T_cw), 0.5) << trial;  // ten sigma of 0.2 px x sqrt(6 / 50)
    } else {
      EXPECT_TRUE(same_bits(pose.T_cw, T_start)) << trial;
    }
  }
}

// Cut into pieces, after another run, with more points than there are rows: the same bits as by itself.
TEST(PoseUpdater, IsTheSameInPiecesAndAfterOthers) {
  test::Random random;
  const Camera camera = {phone_camera(), phone_shutter()};
  VelocityPrior prior;
  prior.mean = random_twist(random, 0.1, 0.3);
  prior.sigma_translation = 0.06f;
  prior.sigma_rotation = 0.15f;
  const View view = random_view(random, camera.shutter, prior.mean, 0.3);
  const View other = random_view(random, camera.shutter, prior.mean, 0.3);
  const SE3 T_start = SE3::exp(random_twist(random, 0.01, 0.01)) * view.T_cw;
  Updater updater(true, 40);
  const PosePoints points(camera, view.points);
  updater->start(T_start, prior, points);
  int pieces = 1;
  while (!updater->advance()) ++pieces;
  const PoseUpdate pose = updater->result();
  ASSERT_TRUE(pose.ok);
  EXPECT_GT(pieces, 6);
  EXPECT_EQ(updater->rows().size(), 40u) << "those beyond the room are left out";
  View first_forty = view;
  first_forty.points.resize(40);
  ASSERT_TRUE(updater->run(other.T_cw, prior, PosePoints(camera, other.points)).ok);
  EXPECT_FALSE(same_bits(updater->result().T_cw, pose.T_cw));
  EXPECT_TRUE(same_bits(updater->run(T_start, prior, points).T_cw, pose.T_cw));
  EXPECT_TRUE(same_bits(update(first_forty, camera.shutter, T_start, prior).T_cw, pose.T_cw));
  EXPECT_FALSE(same_bits(update(view, camera.shutter, T_start, prior).T_cw, pose.T_cw)) << "ten more say something";
}

// Rows of one component: how far a known point's image is from a line of the image on which it was seen, whatever its
// place along that line.
class PointsOnLines final : public PoseRows {
 public:
  struct Line {
    Vector3f p_w;
    Vector2f px, normal;  // of the image line: through px, unit
  };
  std::vector<Line> lines;

  int count() const override { return static_cast<int>(lines.size()); }
  void linearise(const SE3& T_cw, const Vector6f&, std::span<PoseRow> rows) const override {
    ASSERT_EQ(rows.size(), lines.size());
    const CameraModel camera = phone_camera();
    for (size_t i = 0; i < rows.size(); ++i) {
      const Line& line = lines[i];
      PoseRow& row = rows[i];
      const Vector3f p_c = T_cw * line.p_w;
      Vector2f px;
      Matrix23f J_px_p;
      row.components = camera.project(p_c, &px, &J_px_p) ? 1 : 0;
      if (row.components == 0) continue;
      row.dt_s = 0;
      row.depth = i % 2 == 0 ? p_c.z() : 0;  // not all rows need one
      const Eigen::Matrix<float, 1, 6> J = line.normal.transpose() * J_px_p * se3_point_jacobian(p_c);
      for (int k = 0; k < 6; ++k) {
        row.J[0][k] = J[k] / kSigma_px;
        row.J[1][k] = 0;
      }
      row.e_0[0] = line.normal.dot(line.px - px) / kSigma_px;
      row.e_0[1] = 0;
    }
  }

 private:
  static constexpr float kSigma_px = 2;
};

TEST(PoseUpdater, RowsOfOneComponentGiveThePose) {
  test::Random random;
  double worst = 0, worst_start = 1e9;
  for (int trial = 0; trial < 200; ++trial) {
    const View view = random_view(random, {}, Vector6f::Zero(), 0);
    PointsOnLines rows;
    for (const PosePoint& point : view.points) {
      const double angle = random.uniform(0, 6.28318), along = random.uniform(-50, 50);
      const Vector2f normal(static_cast<float>(std::cos(angle)), static_cast<float>(std::sin(angle)));
      // Another point of the line than that which belongs to p_w.
      rows.lines.push_back(
          {point.p_w, point.found.px + static_cast<float>(along) * Vector2f(-normal.y(), normal.x()), normal});
    }
    const SE3 T_start = SE3::exp(random_twist(random, 0.02, 0.02)) * view.T_cw;  // about 7 px each
    Updater updater(false);
    const PoseUpdate& pose = updater->run(T_start, {}, rows);
    ASSERT_TRUE(pose.ok) << trial;
    EXPECT_EQ(pose.inliers, kPoints);
    for (const PoseRow& row : updater->rows()) EXPECT_EQ(row.error_sq, row.e[0] * row.e[0]);
    worst = std::max(worst, image_error(view, pose.T_cw));
    worst_start = std::min(worst_start, image_error(view, T_start));
    // A single wrong line is rejected.
    rows.lines[7].px += 40 * rows.lines[7].normal;
    const PoseUpdate& with_outlier = updater->run(T_start, {}, rows);
    ASSERT_TRUE(with_outlier.ok) << trial;
    EXPECT_EQ(updater->rows()[7].weight, 0);
    worst = std::max(worst, image_error(view, with_outlier.T_cw));
  }
  // As for exact points, 4e-3 px; fifty equations in place of a hundred, so that what each has wrong tells sqrt 2 as
  // much.
  EXPECT_LT(worst, 6e-3);
  EXPECT_GT(worst_start, 7e-3) << "or nothing was to be done";
}

TEST(PoseUpdater, OneComponentInOneDirectionIsNoPose) {
  test::Random random;
  const View view = random_view(random, {}, Vector6f::Zero(), 0);
  PointsOnLines rows;
  for (int i = 0; i < 12; ++i)  // one point, seen on many lines
    rows.lines.push_back({view.points[0].p_w, view.points[0].found.px, Vector2f::UnitX()});
  Updater updater(false);
  EXPECT_FALSE(updater->run(view.T_cw, {}, rows).ok);
  EXPECT_TRUE(same_bits(updater->result().T_cw, view.T_cw));
}

}  // namespace
}  // namespace pptam
