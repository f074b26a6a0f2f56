// The motion model: what it expects of the next frame, what a frame without a pose leaves, and changes of the world's
// coordinates.
#include "camera/motion_model.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include <pocket_ptam/config.h>
#include "tests/support/phone_camera.h"
#include "tests/support/random.h"

namespace pptam {
namespace {

constexpr float kFrame_s = 1.0f / 15;

Vector6f random_twist(test::Random& random, double translation, double rotation) {
  Vector6f mu;
  for (int i = 0; i < 6; ++i) mu[i] = static_cast<float>((i < 3 ? translation : rotation) * random.gaussian());
  return mu;
}

PoseUpdate measured(const SE3& T_cw, const Vector6f& velocity = Vector6f::Zero()) {
  PoseUpdate pose;
  pose.T_cw = T_cw;
  pose.velocity = velocity;
  pose.ok = true;
  return pose;
}

RotationEstimate seen_rotation(const SE3& T_cp) {
  RotationEstimate rotation;
  rotation.R_cp = T_cp.R;
  rotation.covariance *= 1e-6f;  // 0.001 rad
  rotation.ok = true;
  return rotation;
}

bool same_bits(const SE3& a, const SE3& b) {
  return std::memcmp(a.R.data(), b.R.data(), sizeof(float) * 9) == 0 &&
         std::memcmp(a.t.data(), b.t.data(), sizeof(float) * 3) == 0;
}

// A camera of constant velocity, whose turning the full frame sees.
struct Flight {
  Flight(const SE3& start, const Vector6f& constant_velocity, float interval_s)
      : T_cw(start), velocity(constant_velocity), dt_s(interval_s), T_cp(SE3::exp(velocity * dt_s)) {
    motion.start(T_cw, Vector6f::Zero(), 1);
  }
  // The next frame, up to its prediction.
  void predict() {
    motion.begin_frame(dt_s, true);
    const RotationEstimate rotation = seen_rotation(T_cp);
    motion.turn(&rotation);
    T_cw = T_cp * T_cw;
    T_cw.R = orthonormalised(T_cw.R);
  }
  void measure() { motion.believe(measured(T_cw, velocity), dt_s, 1); }
  void fly(int frames) {
    for (int i = 0; i < frames; ++i) {
      predict();
      measure();
    }
  }
  MotionModel motion;
  SE3 T_cw;  // the truth
  Vector6f velocity;
  float dt_s;
  SE3 T_cp;
};

// A position of up to 4 units is a sum of four products, each rounded by 6e-8 of that; in each component of the
// camera's way and again in the motion that is told of it: 2 x 4 x 4 x 6e-8 x sqrt 3.
constexpr float kRounding = 4e-6f;

TEST(MotionModel, AConstantVelocityIsPredicted) {
  test::Random random;
  for (int trial = 0; trial < 50; ++trial) {
    for (const float dt_s : {kFrame_s, 1e-3f}) {
      const Vector6f velocity = random_twist(random, 0.3, 0.5);
      Flight flight(SE3::exp(random_twist(random, 0.5, 0.7)), velocity, dt_s);
      flight.fly(60);
      flight.predict();
      // Of each measured velocity v the model takes 0.7 v + 0.3 of its own, and lets exp(-1.6 dt) of that live: it
      // comes to rest at this share of v (a factor of 0.3 a frame: nothing is left of its start).
      const double decay = std::exp(-1.6 * static_cast<double>(dt_s));
      const auto share = static_cast<float>(0.7 * decay / (1 - 0.3 * decay));
      const SE3 expected = SE3::exp(share * velocity * dt_s);
      EXPECT_LT((flight.motion.expected_motion().t - expected.t).norm(), kRounding);
      EXPECT_LT((flight.motion.expected_motion().R - expected.R).norm(), kRounding);
      // With the rotation that the full frame shows in place of its own.
      const SE3 T_predicted = flight.motion.T_predicted();
      EXPECT_LT((T_predicted.R - flight.T_cw.R).norm(), kRounding);
      const SE3 without_decay = SE3(flight.T_cp.R, flight.T_cp.t) * (flight.T_cp.inverse() * flight.T_cw);
      // Short of the truth by the share that decays, and by how the turn bends the way (its square).
      const float missing = (1 - share) * flight.T_cp.t.norm() + 0.1f * velocity.squaredNorm() * dt_s * dt_s;
      EXPECT_LT((T_predicted.t - without_decay.t).norm(), missing + kRounding);
      if (dt_s > 0.01f) {
        EXPECT_GT((T_predicted.t - without_decay.t).norm(), 0.7f * (1 - share) * flight.T_cp.t.norm());
      }
      // At the true pose the prior is the true velocity, and follows the pose.
      const VelocityPrior prior = flight.motion.prior(flight.T_cw);
      EXPECT_LT((prior.mean - velocity).norm(), kRounding / dt_s);
      EXPECT_FLOAT_EQ(prior.rate_per_s, 1 / dt_s);
      EXPECT_FLOAT_EQ(prior.sigma_rotation, kVelocitySigmaRotation) << "nothing shakes: the start's jerk is long ago";
      EXPECT_FLOAT_EQ(prior.sigma_translation, kVelocitySigmaTranslation);
      EXPECT_LT((flight.motion.last_motion() - velocity).norm(), kRounding / dt_s);
      EXPECT_LT((flight.motion.central_velocity() - velocity).norm(), kRounding / dt_s);
      EXPECT_EQ(flight.motion.readout_velocity(), velocity);
    }
  }
}

TEST(MotionModel, AfterAMissThePredictionIsThePose) {
  test::Random random;
  Flight flight(SE3::exp(random_twist(random, 0.5, 0.7)), random_twist(random, 0.3, 0.5), kFrame_s);
  flight.fly(10);
  EXPECT_EQ(flight.motion.believed(), 11);
  EXPECT_TRUE(same_bits(flight.motion.T_cw(), flight.T_cw));
  flight.predict();
  const SE3 predicted = flight.motion.T_predicted();
  const Vector3f expected = flight.motion.expected_motion().t;
  flight.motion.miss();
  EXPECT_TRUE(same_bits(flight.motion.T_cw(), predicted));
  EXPECT_FALSE(same_bits(predicted, flight.T_cw)) << "or nothing was told apart";
  EXPECT_EQ(flight.motion.believed(), 0);
  EXPECT_EQ(flight.motion.missed(), 1);
  // The velocity lives on, by 3 a second less.
  flight.predict();
  EXPECT_NEAR(flight.motion.expected_motion().t.norm(), (1 - 3 * kFrame_s) * expected.norm(),
              // the turn bends the way by its square
              flight.velocity.tail<3>().squaredNorm() * kFrame_s * kFrame_s * expected.norm());
  // Without a believed pose the prior is what the full frame shows, whatever the pose.
  const VelocityPrior prior = flight.motion.prior();
  EXPECT_EQ(prior.rate_per_s, 0);
  EXPECT_LT((prior.mean.tail<3>() - flight.velocity.tail<3>()).norm(), kRounding / kFrame_s);
  EXPECT_EQ(flight.motion.prior(SE3()).mean, prior.mean);
  // The pose that is measured next says nothing of how the camera came there: the last one was a guess.
  flight.measure();
  EXPECT_EQ(flight.motion.missed(), 0);
  EXPECT_EQ(flight.motion.believed(), 1);
  EXPECT_EQ(flight.motion.last_motion().head<3>(), Vector3f(0, 0, 0));
  EXPECT_FALSE(flight.motion.central_velocity_known());
  flight.fly(1);
  EXPECT_FALSE(flight.motion.central_velocity_known()) << "one side of two";
  flight.fly(1);
  EXPECT_TRUE(flight.motion.central_velocity_known());
  // A hundred frames without a pose: it stands still.
  for (int i = 0; i < 100; ++i) {
    flight.predict();
    flight.motion.miss();
  }
  flight.predict();
  EXPECT_LT(flight.motion.expected_motion().t.norm(), 1e-6f);
}

TEST(MotionModel, WithoutASeenRotationItsOwnVelocityTurns) {
  test::Random random;
  Flight flight(SE3(), random_twist(random, 0.3, 0.5), kFrame_s);
  flight.fly(10);
  flight.motion.begin_frame(kFrame_s, true);
  RotationEstimate failed = seen_rotation(SE3::exp(random_twist(random, 0, 1)));
  failed.ok = false;
  flight.motion.turn(&failed);
  EXPECT_FALSE(flight.motion.rotation_seen());
  EXPECT_EQ(flight.motion.R_cp(), flight.motion.expected_motion().R);
  flight.motion.turn(nullptr);
  EXPECT_FALSE(flight.motion.rotation_seen());
  EXPECT_EQ(flight.motion.R_cp(), Matrix3f(Matrix3f::Identity())) << "no frame before";
  flight.motion.begin_frame(kFrame_s, false);
  EXPECT_EQ(flight.motion.expected_motion().t, Vector3f(0, 0, 0)) << "no map";
  EXPECT_EQ(flight.motion.expected_shift(), Vector3f(0, 0, 0));
  flight.motion.stop();
  flight.motion.begin_frame(kFrame_s, true);
  EXPECT_EQ(flight.motion.expected_motion().t, Vector3f(0, 0, 0));
}

TEST(MotionModel, ARotationThatIsHardlyKnownDoesNotTurn) {
  test::Random random;
  Flight flight(SE3(), random_twist(random, 0.3, 0.5), kFrame_s);
  flight.fly(10);
  for (const float sigma : {0.004f, 0.006f}) {  // about each axis: 0.0057 and 0.0085 about both
    for (const bool with_map : {true, false}) {
      RotationEstimate rotation = seen_rotation(SE3::exp(random_twist(random, 0, 0.1)));
      rotation.covariance = Matrix3f::Identity() * (sigma * sigma);
      flight.motion.begin_frame(kFrame_s, with_map);
      flight.motion.turn(&rotation);
      EXPECT_TRUE(flight.motion.rotation_seen());
      EXPECT_EQ(flight.motion.R_cp(), sigma < 0.005f ? rotation.R_cp : flight.motion.expected_motion().R);
    }
  }
}

// A rotation that differs from the expected one by more than the search reaches is a surprise. Without it the
// prediction is, bit for bit, the one of a frame whose rotation was not seen.
TEST(MotionModel, ASurprisingRotationCanBeDisregarded) {
  test::Random random;
  Config config = Config::phone(test::phone_camera());
  config.camera.shutter = test::phone_shutter();
  const Vector6f velocity = random_twist(random, 0.2, 0.3);
  Flight told(SE3::exp(random_twist(random, 1, 1)), velocity, kFrame_s);
  told.fly(5);
  const SE3 next = told.T_cp * told.T_cw;
  for (const float off_px : {4.0f, 12.0f}) {
    MotionModel fooled = told.motion, blind = told.motion;
    RotationEstimate rotation = seen_rotation(told.T_cp);
    fooled.begin_frame(kFrame_s, true);
    const Matrix3f off = so3_exp(Vector3f(0, off_px / config.camera.model.fx, 0));
    rotation.R_cp = off * fooled.expected_motion().R;
    fooled.turn(&rotation);
    EXPECT_EQ(fooled.rotation_surprises(config), off_px > 8) << off_px;
    rotation.ok = false;
    blind.begin_frame(kFrame_s, true);
    blind.turn(&rotation);
    EXPECT_FALSE(blind.rotation_surprises(config));
    EXPECT_FALSE(same_bits(fooled.T_predicted(), blind.T_predicted()));
    fooled.disregard_rotation();
    EXPECT_TRUE(same_bits(fooled.T_predicted(), blind.T_predicted()));
    EXPECT_EQ(fooled.prior().mean, blind.prior().mean);
    EXPECT_EQ(fooled.prior().sigma_rotation, blind.prior().sigma_rotation);
    EXPECT_FALSE(fooled.rotation_seen());
    EXPECT_LT((fooled.T_predicted().t - next.t).norm(), 0.02f);
  }
}

// A hand that shakes makes the prior wider, up to a bound.
TEST(MotionModel, ShakingWidensThePrior) {
  test::Random random;
  float last = 0;
  for (const double shake : {0.001, 0.2, 0.5, 50.0}) {
    MotionModel motion;
    motion.start(SE3(), Vector6f::Zero(), 2);
    for (int i = 0; i < 60; ++i) {
      motion.begin_frame(kFrame_s, true);
      const RotationEstimate rotation =
          seen_rotation(SE3::exp(random_twist(random, 0, std::min(shake, 8.0) * static_cast<double>(kFrame_s))));
      motion.turn(&rotation);
      motion.believe(measured(motion.T_predicted()), kFrame_s, 2);
    }
    const VelocityPrior prior = motion.prior();
    EXPECT_FLOAT_EQ(prior.sigma_translation,
                    prior.sigma_rotation * kVelocitySigmaTranslation / kVelocitySigmaRotation * 2);
    if (shake < 0.01) {
      EXPECT_FLOAT_EQ(prior.sigma_rotation, kVelocitySigmaRotation);
    }
    if (shake > 10) {
      EXPECT_FLOAT_EQ(prior.sigma_rotation, 0.3f);
    }
    // Half of the change's rms, sqrt 2 of a rate's: over some ten frames, good to a third at least.
    if (shake > 0.01 && shake < 0.3) {
      EXPECT_NEAR(prior.sigma_rotation, static_cast<float>(0.5 * std::sqrt(2.0) * shake),
                  static_cast<float>(shake / 3));
    }
    EXPECT_GE(prior.sigma_rotation, last);
    last = prior.sigma_rotation;
  }
}

TEST(MotionModel, CentralVelocityIsThatOfTheFrameBetween) {
  test::Random random;
  for (int trial = 0; trial < 50; ++trial) {
    // Uniformly accelerated, without turning: c(t) = v t + a t^2 / 2, whose central difference is exact.
    const Vector3f v = random_twist(random, 0.3, 0).head<3>(), a = random_twist(random, 1, 0).head<3>();
    const auto pose = [&](float t_s) { return SE3(Matrix3f::Identity(), v * t_s + 0.5f * t_s * t_s * a); };
    const float before_s = static_cast<float>(random.uniform(0.02, 0.2));
    const float after_s = static_cast<float>(random.uniform(0.02, 0.2));
    MotionModel motion;
    motion.start_guess(1);
    const auto believe = [&](float t_s, float dt_s) {
      motion.begin_frame(dt_s, true);
      motion.turn(nullptr);
      motion.believe(measured(pose(t_s)), dt_s, 1);
    };
    believe(-before_s, kFrame_s);
    EXPECT_FALSE(motion.central_velocity_known());
    believe(0, before_s);
    EXPECT_FALSE(motion.central_velocity_known());
    believe(after_s, after_s);
    ASSERT_TRUE(motion.central_velocity_known());
    const Vector3f central = motion.central_velocity().head<3>();
    EXPECT_LT((central - v).norm(), kRounding / 0.02f) << "at time 0";
    EXPECT_EQ(motion.central_velocity().tail<3>(), Vector3f(0, 0, 0));
    EXPECT_NEAR((motion.last_motion().head<3>() - v).norm(), 0.5f * after_s * a.norm(), kRounding / 0.02f)
        << "control: the last motion alone is that of another time";
  }
}

TEST(MotionModel, ChangesOfCoordinatesCommuteWithPrediction) {
  test::Random random;
  for (int trial = 0; trial < 50; ++trial) {
    Flight plain(SE3::exp(random_twist(random, 0.5, 0.7)), random_twist(random, 0.3, 0.5), kFrame_s);
    plain.fly(5);
    Flight moved = plain;
    Similarity S;
    S.T = SE3::exp(random_twist(random, 0.5, 0.8));
    S.scale = static_cast<float>(random.uniform(0.2, 5));
    // Coordinates of up to 3 units, scaled by up to 5, and a dozen roundings.
    const float tolerance = 12 * 3 * 6e-8f * std::max(1.0f, S.scale);
    const auto expect_same = [&] {
      const auto same = [&](const SE3& in_new, const SE3& in_old) {
        const SE3 expected = S.moved(in_old);
        EXPECT_LT((in_new.R - expected.R).norm(), tolerance);
        EXPECT_LT((in_new.t - expected.t).norm(), tolerance);
      };
      const auto scaled = [&](const Vector6f& in_new, const Vector6f& in_old) {
        EXPECT_LT((in_new.head<3>() - S.scale * in_old.head<3>()).norm(), tolerance / kFrame_s);
        EXPECT_LT((in_new.tail<3>() - in_old.tail<3>()).norm(), tolerance / kFrame_s);
      };
      same(moved.motion.T_cw(), plain.motion.T_cw());
      same(moved.motion.T_predicted(), plain.motion.T_predicted());
      EXPECT_LT((moved.motion.expected_shift() - plain.motion.expected_shift()).norm(), tolerance);
      EXPECT_FLOAT_EQ(moved.motion.mean_depth(), S.scale * plain.motion.mean_depth());
      scaled(moved.motion.prior().mean, plain.motion.prior().mean);
      EXPECT_FLOAT_EQ(moved.motion.prior().sigma_translation, S.scale * plain.motion.prior().sigma_translation);
      EXPECT_FLOAT_EQ(moved.motion.prior().sigma_rotation, plain.motion.prior().sigma_rotation);
      scaled(moved.motion.last_motion(), plain.motion.last_motion());
      scaled(moved.motion.readout_velocity(), plain.motion.readout_velocity());
      scaled(moved.motion.central_velocity(), plain.motion.central_velocity());
      EXPECT_NEAR(moved.motion.image_speed(), plain.motion.image_speed(), tolerance / kFrame_s);
    };
    moved.motion.apply(S);
    plain.predict();
    moved.predict();
    expect_same();
    // And what follows: the same pose, measured in the new coordinates.
    Vector6f velocity = plain.velocity;
    plain.motion.believe(measured(plain.T_cw, velocity), kFrame_s, 1.2f);
    velocity.head<3>() *= S.scale;
    moved.motion.believe(measured(S.moved(plain.T_cw), velocity), kFrame_s, 1.2f * S.scale);
    plain.predict();
    moved.predict();
    expect_same();
    plain.motion.miss();
    moved.motion.miss();
    plain.predict();
    moved.predict();
    expect_same();
    // Control: a velocity that keeps its length would be seen.
    if (std::abs(S.scale - 1) > 0.1f) {
      EXPECT_GT((moved.motion.expected_motion().t - plain.motion.expected_motion().t).norm(), tolerance);
    }
  }
}

}  // namespace
}  // namespace pptam
