// Robust Gauss-Newton for every fit of a few unknowns: camera pose, homography, relative pose, full-frame rotation.
// (Bundle adjustment has thousands of unknowns and its own engine.)
//
//   NormalEquations  sums of w J^T J and w J^T e, scaled to a unit diagonal; L D L^T with a test of the pivots
//   RobustFit        the loop:  errors ─▶ scale ─▶ weights and sums ─▶ step ─▶ errors ...
//
// Independent of what is fitted. float32, sums in the order of the residuals, no pivoting: every target and compiler
// gives the same bits.
#pragma once

#include <cmath>
#include <cstdint>

namespace pptam {

// Solves A x = b for up to N unknowns: A = sum w J^T J, symmetric positive definite, b = sum w J^T e.
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
  // Adds one component of a residual: e is measured minus predicted, J the prediction's derivative, w the weight.
  void add(const float (&J)[N], float e, float w) {
    for (int i = 0; i < N; ++i) {
      const float wJ = w * J[i];
      for (int j = 0; j <= i; ++j) A_[i][j] += wJ * J[j];
      b_[i] += wJ * e;
    }
  }
  float& A(int i, int j) { return A_[i][j]; }  // j <= i
  float& b(int i) { return b_[i]; }

  // Solves into x, overwriting A. min_pivot: smallest pivot accepted of the system scaled to a unit diagonal, a ratio
  // in (0, 1); a smaller one means a direction that the residuals do not constrain. False, x undefined, when a pivot is
  // too small or the solution is not finite.
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

  // After solve(): column i of A^-1, rows from unknown `first` on, i >= first. With weights of 1 / variance this is the
  // covariance of these unknowns, those before `first` marginalised. column[j] belongs to unknown j.
  void covariance_column(int i, int first, float* column) const {
    for (int j = first; j < unknowns_; ++j) column[j] = 0;
    column[i] = 1;
    substitute(column, first);
    for (int j = first; j < unknowns_; ++j) column[j] *= unit_[i] * unit_[j];
  }
  // After solve(): information on unknown i, in 1 / its unit^2, with the unknowns before it marginalised and those
  // after it held fixed.
  float information(int i) const { return D_[i] / (unit_[i] * unit_[i]); }

 private:
  // Scales A to a unit diagonal: keeps it within float32's range, and makes the pivots measure its conditioning.
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
  // Factorises A = L D L^T in place, with L below the diagonal.
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
  // Solves L D L^T y = x for the block of the unknowns from `first` on; y replaces x.
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
  float unit_[N];  // scale of each unknown, 1 / sqrt of A's diagonal
};

enum class FitStep : uint8_t {
  kAgain,      // the state has moved: another iteration is needed
  kConverged,  // the fit is finished
  kFailed
};

// The reweighted loop, in pieces between which a background job may pause. Problem has
//   bool errors(int iteration)        computes the residuals at the present state; false: too few
//   void scale()                      computes their robust scale and clears the sums
//   int residuals() const             number of residuals (or groups of them) that sum() is called for
//   void sum(int from, int to)        weights the residuals from..to-1 and adds them to the sums
//   FitStep step(int iteration)       solves, bounds the step and moves the state
// iteration counts from 0. The loop ends with what step() returns: Problem bounds the number of iterations.
template <class Problem>
class RobustFit {
 public:
  enum class Piece : uint8_t { kErrors, kScale, kSums, kStep, kEnd };

  // at_once: largest number of residuals summed in one piece.
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
        [[fallthrough]];  // the step is short enough for the same piece
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
