// A symmetric positive definite system S x = b of 6x6 blocks, solved by a blocked Cholesky factorisation in fixed
// order.
//
// Only the lower triangle is kept, block row after block row. A block is stored by columns, so that the blocks
// (i, k) ... (i, j - 1) of a row lie in memory as one panel of 6 (j - k) columns of 6 numbers. Nearly all of the work
// is one operation on two panels: C -= A B^T. A row is computed from its first non-zero block on: the factor is zero
// before it (outside of the envelope).
//
// Factorising and solving advance by one block or row a call, so that the caller can pause in between.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "base/containers.h"
#include "mapping/block_product.h"

namespace pptam {

template <class Scalar>
class BlockSystem {
 public:
  BlockSystem(Arena& arena, int max_rows)
      : blocks_(arena, max_rows * (max_rows + 1) / 2 * kBlockNumbers),
        rhs_(arena, max_rows * kBlock),
        inverse_diagonal_(arena, max_rows * kBlock),
        first_(arena, max_rows) {}

  int max_rows() const { return first_.capacity(); }
  int rows() const { return rows_; }
  // Sets the number of block rows. Each row has to be cleared by clear_row() then.
  void resize(int rows) {
    rows_ = rows;
    blocks_.resize(rows * (rows + 1) / 2 * kBlockNumbers);
    rhs_.resize(rows * kBlock);
    inverse_diagonal_.resize(rows * kBlock);
    first_.resize(rows);
  }
  void clear_row(int row) {
    std::fill_n(block(row, 0), (row + 1) * kBlockNumbers, Scalar(0));
    std::fill_n(rhs(row), kBlock, Scalar(0));
    first_[row] = static_cast<int16_t>(row);
  }

  // Block of S, row >= column. Only the lower triangle of a diagonal block is read.
  Scalar* block(int row, int column) { return blocks_.data() + (row * (row + 1) / 2 + column) * kBlockNumbers; }
  Scalar* rhs(int row) { return rhs_.data() + row * kBlock; }  // after solving: the solution
  // Declares the block (row, column) as non-zero.
  void connect(int row, int column) {
    if (column < first_[row]) first_[row] = static_cast<int16_t>(column);
  }
  int first(int row) const { return first_[row]; }  // column of the row's first non-zero block

  // S = L L^T: replaces the block (row, column) of S by that of L. All rows before and all blocks before it in the row
  // must be factorised. False when S is not positive definite.
  bool factorise(int row, int column) {
    const int from = std::max(first_[row], first_[column]);
    if (from < column)
      subtract_product(block(row, column), block(row, from), block(column, from), (column - from) * kBlock);
    if (row == column) return factorise_diagonal(row);
    divide_by_diagonal(block(row, column), column);
    return true;
  }
  // Block products that factorise(row, column) takes.
  int products(int row, int column) const { return std::max(0, column - std::max(first_[row], first_[column])); }

  // One row of L y = b; rows in ascending order.
  void solve_forward(int row) {
    const int from = first_[row];
    const Scalar* column = block(row, from);
    Scalar x[kBlock];
    std::copy_n(rhs(row), kBlock, x);
    for (const Scalar *y = rhs(from), *end = rhs(row); y != end; ++y, column += kBlock)
#pragma GCC unroll 6
      for (int r = 0; r < kBlock; ++r) x[r] -= column[r] * *y;
    for (int c = 0; c < kBlock; ++c, column += kBlock) {
      x[c] *= inverse_diagonal_[row * kBlock + c];
      for (int r = c + 1; r < kBlock; ++r) x[r] -= column[r] * x[c];
    }
    std::copy_n(x, kBlock, rhs(row));
  }
  // One row of L^T x = y; rows in descending order.
  void solve_backward(int row) {
    Scalar x[kBlock];
    const Scalar* diagonal = block(row, row);
    for (int c = kBlock - 1; c >= 0; --c) {
      Scalar v = rhs(row)[c];
      for (int r = c + 1; r < kBlock; ++r) v -= diagonal[c * kBlock + r] * x[r];
      x[c] = v * inverse_diagonal_[row * kBlock + c];
    }
    std::copy_n(x, kBlock, rhs(row));
    const int from = first_[row];
    const Scalar* column = block(row, from);
    for (Scalar *y = rhs(from), *end = rhs(row); y != end; ++y, column += kBlock) {
      Scalar v = *y;
#pragma GCC unroll 6
      for (int r = 0; r < kBlock; ++r) v -= column[r] * x[r];
      *y = v;
    }
  }

 private:
  // Smallest pivot of a positive definite S, in S's own units: far below any damped diagonal. Not swept.
  static constexpr Scalar kMinPivot = Scalar(1e-12);

  bool factorise_diagonal(int row) {
    Scalar* d = block(row, row);
    for (int c = 0; c < kBlock; ++c) {
      const Scalar pivot = d[c * kBlock + c];
      if (!(pivot > kMinPivot)) return false;
      const Scalar inverse = Scalar(1) / std::sqrt(pivot);
      inverse_diagonal_[row * kBlock + c] = inverse;
      for (int r = c; r < kBlock; ++r) d[c * kBlock + r] *= inverse;
      for (int s = c + 1; s < kBlock; ++s)
        for (int r = s; r < kBlock; ++r) d[s * kBlock + r] -= d[c * kBlock + r] * d[c * kBlock + s];
    }
    return true;
  }
  // C <- C L^-T, where L is the diagonal block (row, row) of the factor.
  void divide_by_diagonal(Scalar* c, int row) {
    const Scalar* d = block(row, row);
    const Scalar* inverse = inverse_diagonal_.data() + row * kBlock;
#pragma GCC unroll 6
    for (int s = 0; s < kBlock; ++s) {
      Scalar* x = c + s * kBlock;
#pragma GCC unroll 6
      for (int k = 0; k < s; ++k)
#pragma GCC unroll 6
        for (int r = 0; r < kBlock; ++r) x[r] -= c[k * kBlock + r] * d[k * kBlock + s];
#pragma GCC unroll 6
      for (int r = 0; r < kBlock; ++r) x[r] *= inverse[s];
    }
  }

  int rows_ = 0;
  FixedVector<Scalar> blocks_, rhs_, inverse_diagonal_;
  FixedVector<int16_t> first_;  // of each row: column of its first non-zero block
};

}  // namespace pptam
