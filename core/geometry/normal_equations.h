// Robust Gauss-Newton, for every fit of a few unknowns: the camera's pose, a homography, a relative pose, the
// full-frame rotation. (Bundle adjustment has thousands of unknowns and an engine of its own.)
//
//   NormalEquations  sums of w J^T J and w J^T e, scaled to a unit diagonal, L D L^T with a test of the pivots
//   RobustFit        the loop:  errors ─▶ scale ─▶ weights and sums ─▶ step ─▶ errors ...
//
// Nothing here knows what is being fitted. float32; sums in the order of the residuals; no pivoting, so that every
// target and compiler gives the same bits.
#pragma once

#include <cmath>
#include <cstdint>

namespace pptam {

// A x = b, A = sum w J^T J symmetric positive definite, b = sum w J^T e, of up to N unknowns.
template <int N>
class NormalEquations {
 public:
  void clear(int unknowns = N) {
    unknowns_ = unknowns;
    for (int i = 0; i < unknowns; ++i) {
      for (int j = 0; j <= i; ++j) A_[i][j] = 0;
      b_[i] = 0;
    }
  }
  // A component of a residual: e measured minus predicted, J the prediction's derivative, w its weight.
  void add(const float (&J)[N], float e, float w) {
    for (int i = 0; i < N; ++i) {
      const float wJ = w * J[i];
      for (int j = 0; j <= i; ++j) A_[i][j] += wJ * J[j];
      b_[i] += wJ * e;
    }
  }
  float& A(int i, int j) { return A_[i][j]; }  // j <= i
  float& b(int i) { return b_[i]; }

  // Solves into x. min_pivot: smallest pivot of the system scaled to a unit diagonal, in (0, 1): less is a direction
  // that the residuals do not see. False, x undefined, when there is one, or the solution is not finite. Overwrites A.
  bool solve(float min_pivot, float* x) {
    if (!scale() || !factorise(min_pivot)) return false;
    for (int i = 0; i < unknowns_; ++i) x[i] = b_[i] * unit_[i];
    substitute(x, 0);
    bool finite = true;
    for (int i = 0; i < unknowns_; ++i) {
      x[i] *= unit_[i];
      finite = finite && x[i] - x[i] == 0;
    }
    return finite;
  }

  // After solve(). Column i of the inverse of the lower right block from unknown `first` on, others taken as given to
  // be found: covariance of these unknowns for weights of 1 / variance, those before `first` marginalised. column[j]
  // is of unknown j.
  void covariance_column(int i, int first, float* column) const {
    for (int j = first; j < unknowns_; ++j) column[j] = 0;
    column[i] = 1;
    substitute(column, first);
    for (int j = first; j < unknowns_; ++j) column[j] *= unit_[i] * unit_[j];
  }
  // After solve(): what the residuals tell of unknown i when those before it are unknown too, in its own units.
  float information(int i) const { return D_[i] / (unit_[i] * unit_[i]); }

 private:
  // Keeps the system within float32, and makes the pivots tell its conditioning.
  bool scale() {
    for (int i = 0; i < unknowns_; ++i) {
      if (!(A_[i][i] > 0)) return false;
      unit_[i] = 1 / std::sqrt(A_[i][i]);
    }
    for (int i = 0; i < unknowns_; ++i) {
      for (int j = 0; j < i; ++j) A_[i][j] *= unit_[i] * unit_[j];
      A_[i][i] = 1;
    }
    return true;
  }
  // A = L D L^T in place: L below the diagonal.
  bool factorise(float min_pivot) {
    for (int j = 0; j < unknowns_; ++j) {
      float scaled[N];  // L(j, k) D(k)
      float d = A_[j][j];
      for (int k = 0; k < j; ++k) {
        scaled[k] = A_[j][k] * D_[k];
        d -= scaled[k] * A_[j][k];
      }
      if (!(d > min_pivot)) return false;
      D_[j] = d;
      for (int i = j + 1; i < unknowns_; ++i) {
        float v = A_[i][j];
        for (int k = 0; k < j; ++k) v -= A_[i][k] * scaled[k];
        A_[i][j] = v / d;
      }
    }
    return true;
  }
  // Of the unknowns from `first` on alone.
  void substitute(float* x, int first) const {
    for (int i = first; i < unknowns_; ++i)
      for (int k = first; k < i; ++k) x[i] -= A_[i][k] * x[k];
    for (int i = first; i < unknowns_; ++i) x[i] /= D_[i];
    for (int i = unknowns_ - 1; i >= first; --i)
      for (int k = i + 1; k < unknowns_; ++k) x[i] -= A_[k][i] * x[k];
  }

  int unknowns_ = N;
  float A_[N][N];
  float b_[N];
  float D_[N];
  float unit_[N];
};

enum class FitStep : uint8_t {
  kAgain,      // the state has moved: once more
  kConverged,  // it is where it should be
  kFailed
};

// The loop, in pieces that a background job may pause between. Problem has
//   bool errors(int iteration)        the residuals at the state; false: too few
//   void scale()                      their robust scale, and clears the sums
//   int residuals() const             what sum() counts by
//   void sum(int from, int to)        weights these residuals and adds them to the sums
//   FitStep step(int iteration)       solves, bounds the step and moves the state
// iteration counts from 0.
template <class Problem>
class RobustFit {
 public:
  enum class Piece : uint8_t { kErrors, kScale, kSums, kStep, kEnd };

  // at_once: residuals summed in one piece.
  void start(int at_once) {
    next_ = Piece::kErrors;
    iteration_ = summed_ = 0;
    at_once_ = at_once;
    converged_ = false;
  }
  void give_up() { next_ = Piece::kEnd; }
  bool ended() const { return next_ == Piece::kEnd; }
  bool converged() const { return converged_; }
  int iterations() const { return iteration_; }

  bool advance(Problem& problem) {  // true at the end
    switch (next_) {
      case Piece::kErrors:
        next_ = problem.errors(iteration_) ? Piece::kScale : Piece::kEnd;
        break;
      case Piece::kScale:
        problem.scale();
        summed_ = 0;
        next_ = Piece::kSums;
        break;
      case Piece::kSums: {
        const int all = problem.residuals(), end = all - summed_ < at_once_ ? all : summed_ + at_once_;
        problem.sum(summed_, end);
        summed_ = end;
        if (end == all) next_ = Piece::kStep;
        if (end < all) break;
        [[fallthrough]];  // the step is short
      }
      case Piece::kStep: {
        const FitStep outcome = problem.step(iteration_++);
        converged_ = outcome == FitStep::kConverged;
        next_ = outcome == FitStep::kAgain ? Piece::kErrors : Piece::kEnd;
        break;
      }
      case Piece::kEnd:
        break;
    }
    return ended();
  }
  bool run(Problem& problem, int at_once) {  // false: failed
    start(at_once);
    while (!advance(problem)) {
    }
    return converged_;
  }

 private:
  Piece next_ = Piece::kEnd;
  int iteration_ = 0;
  int summed_ = 0;
  int at_once_ = 1;
  bool converged_ = false;
};

}  // namespace pptam
