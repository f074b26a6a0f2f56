// Normal equations against double precision, what the pivots tell, and the loop's order and pauses.
#include "geometry/normal_equations.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <string>
#include <vector>

#include "geometry/robust.h"
#include "tests/support/random.h"

namespace pptam {
namespace {

constexpr float kMinPivot = 1e-6f;

// Random rows whose unknowns have sizes from 1e-3 to 1e3, as metres beside radians beside grey levels.
template <int N>
struct Problem {
  explicit Problem(test::Random& random) {
    for (int i = 0; i < N; ++i) unit[i] = std::pow(10.0, random.uniform(-3, 3));
    for (int r = 0; r < 40; ++r) {
      float J[N];
      Eigen::VectorXd row(N);
      for (int i = 0; i < N; ++i) {
        J[i] = static_cast<float>(random.gaussian() * unit[i]);
        row[i] = static_cast<double>(J[i]);
      }
      const auto e = static_cast<float>(random.gaussian()), w = static_cast<float>(random.uniform(0, 1));
      equations.add(J, e, w);
      A += static_cast<double>(w) * row * row.transpose();
      b += static_cast<double>(w) * static_cast<double>(e) * row;
    }
  }
  double unit[N];
  NormalEquations<N> equations = cleared();
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(N, N);
  Eigen::VectorXd b = Eigen::VectorXd::Zero(N);

 private:
  static NormalEquations<N> cleared() {
    NormalEquations<N> equations;
    equations.clear();
    return equations;
  }
};

TEST(NormalEquations, SolvesAsDoublePrecisionDoes) {
  test::Random random;
  for (int trial = 0; trial < 300; ++trial) {
    Problem<7> problem(random);
    float x[7];
    ASSERT_TRUE(problem.equations.solve(kMinPivot, x));
    const Eigen::VectorXd expected = problem.A.ldlt().solve(problem.b);
    const Eigen::MatrixXd inverse = problem.A.inverse();
    // Scaled to a unit diagonal the condition is at most some hundred for forty random rows; rounding of the sums and
    // of the solution, a few times sqrt(40) units, grows by it.
    const double tolerance = 100 * 6e-8 * 20;
    for (int i = 0; i < 7; ++i) {
      const double scale = std::sqrt(inverse(i, i));
      EXPECT_NEAR(static_cast<double>(x[i]), expected[i], tolerance * scale * (1 + std::abs(expected[i] / scale)));
      float column[7];
      problem.equations.covariance_column(i, 0, column);
      for (int j = 0; j < 7; ++j)
        EXPECT_NEAR(static_cast<double>(column[j]), inverse(i, j), tolerance * scale * std::sqrt(inverse(j, j)) * 10);
    }
  }
}

// Those before `first` are marginalised: the block of the full inverse, not the inverse of the block.
TEST(NormalEquations, CovarianceOfTheLastUnknownsMarginalisesTheOthers) {
  test::Random random;
  Problem<6> problem(random);
  float x[6];
  ASSERT_TRUE(problem.equations.solve(kMinPivot, x));
  const Eigen::MatrixXd inverse = problem.A.inverse();
  double worst = 0, worst_alone = 0;
  const Eigen::MatrixXd alone = problem.A.bottomRightCorner(3, 3).inverse();
  for (int i = 3; i < 6; ++i) {
    float column[6];
    problem.equations.covariance_column(i, 3, column);
    for (int j = 3; j < 6; ++j) {
      const double scale = std::sqrt(inverse(i, i) * inverse(j, j));
      worst = std::max(worst, std::abs(static_cast<double>(column[j]) - inverse(i, j)) / scale);
      worst_alone = std::max(worst_alone, std::abs(alone(i - 3, j - 3) - inverse(i, j)) / scale);
    }
  }
  EXPECT_LT(worst, 1e-4);
  EXPECT_GT(worst_alone, 1e-2);
}

TEST(NormalEquations, RefusesWhatTheResidualsDoNotSee) {
  test::Random random;
  for (int kind = 0; kind < 3; ++kind) {
    NormalEquations<3> equations;
    equations.clear();
    for (int r = 0; r < 20; ++r) {
      float J[3] = {static_cast<float>(random.gaussian()), static_cast<float>(random.gaussian()), 0};
      if (kind == 1) J[2] = 1000 * J[0];                                           // seen only together with another
      if (kind == 2) J[2] = J[0] + 0.05f * static_cast<float>(random.gaussian());  // hardly, but seen: the control
      equations.add(J, 1, 1);
    }
    float x[3];
    EXPECT_EQ(equations.solve(kMinPivot, x), kind == 2) << kind;
  }
}

TEST(NormalEquations, RefusesNumbersThatAreNone) {
  for (const float bad : {std::nanf(""), INFINITY}) {
    for (int place = 0; place < 2; ++place) {
      NormalEquations<2> equations;
      equations.clear();
      equations.add({1, 0.5f}, 1, 1);
      equations.add({0.2f, 1}, 1, 1);
      equations.add({place == 0 ? bad : 0, 0}, place == 1 ? bad : 0, 1);
      float x[2];
      EXPECT_FALSE(equations.solve(kMinPivot, x)) << bad << " at " << place;
    }
  }
}

TEST(NormalEquations, InformationIsWhatTheOthersLeave) {
  NormalEquations<2> equations;
  equations.clear();
  // A = [4 2; 2 3]: unknown 1 alone has 3, with unknown 0 unknown 3 - 2 * 2 / 4.
  equations.A(0, 0) = 4;
  equations.A(1, 0) = 2;
  equations.A(1, 1) = 3;
  equations.b(0) = equations.b(1) = 1;
  float x[2];
  ASSERT_TRUE(equations.solve(kMinPivot, x));
  EXPECT_NEAR(equations.information(1), 2, 1e-5f);
  EXPECT_NEAR(x[0], 0.125f, 1e-6f);
  EXPECT_NEAR(x[1], 0.25f, 1e-6f);
}

// Finds a number among others of which a third are wrong, and writes down what it was asked for.
struct RobustMean {
  std::vector<float> values;
  float mean = 0;
  std::vector<float> squared;
  NormalEquations<2> equations;  // one of two unknowns is used: GCC 14 warns of loops that one alone never enters
  float sigma = 1;
  std::string asked;
  int fail_at = -1;

  bool errors(int iteration) {
    asked += 'e';
    squared.clear();
    for (const float v : values) squared.push_back((v - mean) * (v - mean));
    return iteration != fail_at;
  }
  void scale() {
    asked += 's';
    std::vector<float> copy = squared;
    sigma = std::max(robust_sigma_1d(copy), 0.01f);
    equations.clear(1);
  }
  int residuals() const { return static_cast<int>(values.size()); }
  void sum(int from, int to) {
    asked += '+';
    const Tukey tukey(sigma, kTukeyCutoff1d);
    for (int i = from; i < to; ++i)
      equations.add({1, 0}, values[static_cast<size_t>(i)] - mean, tukey.weight(squared[static_cast<size_t>(i)]));
  }
  FitStep step(int iteration) {
    asked += '>';
    float x[1] = {};
    if (!equations.solve(kMinPivot, x)) return FitStep::kFailed;
    mean += x[0];
    return std::abs(x[0]) < 1e-5f || iteration == 30 ? FitStep::kConverged : FitStep::kAgain;
  }
};

TEST(RobustFit, FindsTheMajorityHoweverItIsCut) {
  test::Random random;
  RobustMean problem;
  for (int i = 0; i < 60; ++i)
    problem.values.push_back(static_cast<float>(i % 3 == 0 ? random.uniform(20, 40) : 5 + 0.1 * random.gaussian()));
  problem.mean = 8;
  RobustMean in_pieces = problem;
  RobustFit<RobustMean> loop;
  ASSERT_TRUE(loop.run(problem, 1000));
  EXPECT_TRUE(loop.converged());
  // 40 good values of sigma 0.1: five sigmas of their mean.
  EXPECT_NEAR(problem.mean, 5, 5 * 0.1 / std::sqrt(40.0));
  EXPECT_EQ(problem.asked.substr(0, 8), "es+>es+>");

  RobustFit<RobustMean> cut;
  cut.start(7);
  int pieces = 1;
  while (!cut.advance(in_pieces)) ++pieces;
  EXPECT_EQ(in_pieces.mean, problem.mean);
  EXPECT_EQ(in_pieces.asked.substr(0, 12), "es+++++++++>");
  // Nine pieces of sums, the last one with the step, and two before, in each iteration.
  EXPECT_EQ(pieces, 11 * cut.iterations());
  float mean_of_all = 0;
  for (const float v : problem.values) mean_of_all += v / 60;
  EXPECT_GT(mean_of_all, 10) << "the plain mean is far off";
}

TEST(RobustFit, EndsWhereTheProblemCannotGoOn) {
  RobustMean problem;
  problem.values = {1, 2, 3};
  problem.fail_at = 1;
  RobustFit<RobustMean> loop;
  EXPECT_FALSE(loop.run(problem, 10));
  EXPECT_EQ(problem.asked, "es+>e");
  problem = RobustMean();  // nothing to sum: no solution
  EXPECT_FALSE(loop.run(problem, 10));
  EXPECT_EQ(problem.asked, "es+>");
}

}  // namespace
}  // namespace pptam
