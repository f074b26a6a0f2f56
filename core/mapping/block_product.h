// The inner loop of bundle adjustment: C -= A B^T. C is a block of 6x6, A and B are panels of 6 rows, stored by
// columns.
//
// Every element of C is summed in the order of the panels' columns, so that the variants give the same bits.
#pragma once

#if defined(__SSE2__) && !defined(PPTAM_PLAIN)
#include <emmintrin.h>
#endif

namespace pptam {

constexpr int kBlock = 6;                       // rows and columns of a block: a pose or a velocity
constexpr int kBlockNumbers = kBlock * kBlock;  // element (r, c) of a block at c * kBlock + r

// C -= A B^T with panels A and B, not null, of `depth` columns, 0 or a multiple of 3. Three columns of C are summed at
// a time: these 18 sums fit into the 32 registers of a VFP, and nine loads serve 18 multiply-subtracts.
template <class Scalar>
inline void subtract_product_plain(Scalar* c, const Scalar* a, const Scalar* b, int depth) {
  constexpr int kColumns = 3;
  for (int half = 0; half < kBlock; half += kColumns, c += kColumns * kBlock) {
    Scalar sum[kColumns][kBlock];
#pragma GCC unroll 6
    for (int s = 0; s < kColumns; ++s)
#pragma GCC unroll 6
      for (int r = 0; r < kBlock; ++r) sum[s][r] = c[s * kBlock + r];
    const Scalar* left = a;
    const Scalar* right = b + half;
    for (const Scalar* const end = a + depth * kBlock; left != end; left += 3 * kBlock, right += 3 * kBlock) {
#pragma GCC unroll 3
      for (int k = 0; k < 3; ++k)
#pragma GCC unroll 6
        for (int r = 0; r < kBlock; ++r)
#pragma GCC unroll 6
          for (int s = 0; s < kColumns; ++s) sum[s][r] -= left[k * kBlock + r] * right[k * kBlock + s];
    }
#pragma GCC unroll 6
    for (int s = 0; s < kColumns; ++s)
#pragma GCC unroll 6
      for (int r = 0; r < kBlock; ++r) c[s * kBlock + r] = sum[s][r];
  }
}

template <class Scalar>
inline void subtract_product(Scalar* c, const Scalar* a, const Scalar* b, int depth) {
  subtract_product_plain(c, a, b, depth);
}

#if defined(__SSE2__) && !defined(PPTAM_PLAIN)
// Two columns of C are three vectors of four numbers: rows 0-3 of the first column; rows 4, 5 of the first and 0, 1 of
// the second; rows 2-5 of the second.
inline void subtract_product(float* c, const float* a, const float* b, int depth) {
  __m128 sum[9];
#pragma GCC unroll 9
  for (int i = 0; i < 9; ++i) sum[i] = _mm_loadu_ps(c + 4 * i);
  for (const float* const end = a + depth * kBlock; a != end; a += kBlock, b += kBlock) {
    const __m128 a0123 = _mm_loadu_ps(a), a2345 = _mm_loadu_ps(a + 2);
    const __m128 a4501 = _mm_shuffle_ps(a2345, a0123, _MM_SHUFFLE(1, 0, 3, 2));
    const __m128 b0123 = _mm_loadu_ps(b), b2345 = _mm_loadu_ps(b + 2);
    const auto subtract = [&](__m128* s, __m128 first, __m128 both, __m128 second) {
      s[0] = _mm_sub_ps(s[0], _mm_mul_ps(a0123, first));
      s[1] = _mm_sub_ps(s[1], _mm_mul_ps(a4501, both));
      s[2] = _mm_sub_ps(s[2], _mm_mul_ps(a2345, second));
    };
    subtract(sum, _mm_shuffle_ps(b0123, b0123, _MM_SHUFFLE(0, 0, 0, 0)),
             _mm_shuffle_ps(b0123, b0123, _MM_SHUFFLE(1, 1, 0, 0)),
             _mm_shuffle_ps(b0123, b0123, _MM_SHUFFLE(1, 1, 1, 1)));
    subtract(sum + 3, _mm_shuffle_ps(b0123, b0123, _MM_SHUFFLE(2, 2, 2, 2)),
             _mm_shuffle_ps(b0123, b0123, _MM_SHUFFLE(3, 3, 2, 2)),
             _mm_shuffle_ps(b0123, b0123, _MM_SHUFFLE(3, 3, 3, 3)));
    subtract(sum + 6, _mm_shuffle_ps(b2345, b2345, _MM_SHUFFLE(2, 2, 2, 2)),
             _mm_shuffle_ps(b2345, b2345, _MM_SHUFFLE(3, 3, 2, 2)),
             _mm_shuffle_ps(b2345, b2345, _MM_SHUFFLE(3, 3, 3, 3)));
  }
#pragma GCC unroll 9
  for (int i = 0; i < 9; ++i) _mm_storeu_ps(c + 4 * i, sum[i]);
}
#endif

}  // namespace pptam
