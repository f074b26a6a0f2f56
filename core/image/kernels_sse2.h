// The kernels for x86-64, where compilers do not vectorise the plain ones well. The results have the same bits.
#pragma once

#include <emmintrin.h>

#include "image/kernels.h"

namespace pptam::sse2 {

using plain::bgra_row;
using plain::pack_template;
using plain::prepare_refinement;
using plain::refine_sums;

inline __m128i load_eight(const uint8_t* px) {  // as 16-bit numbers
  return _mm_unpacklo_epi8(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(px)), _mm_setzero_si128());
}
inline int32_t sum_of_four(__m128i v) {
  v = _mm_add_epi32(v, _mm_shuffle_epi32(v, _MM_SHUFFLE(1, 0, 3, 2)));
  return _mm_cvtsi128_si32(_mm_add_epi32(v, _mm_shuffle_epi32(v, _MM_SHUFFLE(2, 3, 0, 1))));
}

inline void half_row(const uint8_t* upper, const uint8_t* lower, uint8_t* out, int count) {
  const __m128i even = _mm_set1_epi16(0x00ff), two = _mm_set1_epi16(2);
  const auto eight_means = [&](int x) {
    const __m128i a = _mm_loadu_si128(reinterpret_cast<const __m128i*>(upper + x));
    const __m128i b = _mm_loadu_si128(reinterpret_cast<const __m128i*>(lower + x));
    const __m128i sums = _mm_add_epi16(_mm_add_epi16(_mm_and_si128(a, even), _mm_srli_epi16(a, 8)),
                                       _mm_add_epi16(_mm_and_si128(b, even), _mm_srli_epi16(b, 8)));
    return _mm_srli_epi16(_mm_add_epi16(sums, two), 2);
  };
  int x = 0;
  for (; x + 16 <= count; x += 16)
    _mm_storeu_si128(reinterpret_cast<__m128i*>(out + x),
                     _mm_packus_epi16(eight_means(2 * x), eight_means(2 * x + 16)));
  plain::half_row(upper + 2 * x, lower + 2 * x, out + x, count - x);
}

template <int kRadius>
inline void window_sums(const uint8_t* px, int stride, StructureTensor sums[9]) {
  constexpr int kSpan = 2 * kRadius + 3, kLast = kSpan - 1;
  static_assert(kRadius == 2 || kRadius == 3);
  // Masks that select each window's columns out of eight. Three windows of 7 columns span columns 0..8, so the third is
  // taken from columns 1..8.
  alignas(16) static constexpr int16_t kMask[3][8] = {
      {-1, -1, -1, -1, -1, kRadius == 3 ? -1 : 0, kRadius == 3 ? -1 : 0, 0},
      {0, -1, -1, -1, -1, -1, kRadius == 3 ? -1 : 0, kRadius == 3 ? -1 : 0},
      {0, kRadius == 3 ? -1 : 0, -1, -1, -1, -1, -1, kRadius == 3 ? -1 : 0}};
  __m128i rows[3][3][kSpan];  // by window, component and row: four partial sums
  const uint8_t* row = px - (kRadius + 1) * stride - kRadius - 1;
  for (int r = 0; r < kSpan; ++r, row += stride) {
    __m128i gx = _mm_sub_epi16(load_eight(row + 1), load_eight(row - 1));
    __m128i gy = _mm_sub_epi16(load_eight(row + stride), load_eight(row - stride));
    for (int w = 0; w < 3; ++w) {
      if (kRadius == 3 && w == 2) {
        gx = _mm_sub_epi16(load_eight(row + 2), load_eight(row));
        gy = _mm_sub_epi16(load_eight(row + stride + 1), load_eight(row - stride + 1));
      }
      const __m128i mask = _mm_load_si128(reinterpret_cast<const __m128i*>(kMask[w]));
      const __m128i gx_in = _mm_and_si128(gx, mask), gy_in = _mm_and_si128(gy, mask);
      rows[w][0][r] = _mm_madd_epi16(gx_in, gx);
      rows[w][1][r] = _mm_madd_epi16(gx_in, gy);
      rows[w][2][r] = _mm_madd_epi16(gy_in, gy);
    }
  }
  constexpr int32_t StructureTensor::*kComponent[3] = {&StructureTensor::xx, &StructureTensor::xy,
                                                       &StructureTensor::yy};
  for (int w = 0; w < 3; ++w) {
    for (int i = 0; i < 3; ++i) {
      const __m128i* at = rows[w][i];
      __m128i shared = at[2];
      for (int r = 3; r <= kLast - 2; ++r) shared = _mm_add_epi32(shared, at[r]);
      const __m128i upper = _mm_add_epi32(shared, at[1]), lower = _mm_add_epi32(shared, at[kLast - 1]);
      sums[w].*kComponent[i] = sum_of_four(_mm_add_epi32(upper, at[0]));
      sums[3 + w].*kComponent[i] = sum_of_four(_mm_add_epi32(upper, at[kLast - 1]));
      sums[6 + w].*kComponent[i] = sum_of_four(_mm_add_epi32(lower, at[kLast]));
    }
  }
}

inline int32_t zmssd_x64(const uint8_t* image, int stride, const PackedTemplate& patch, int32_t limit) {
  __m128i squares = _mm_setzero_si128(), image_sum = _mm_setzero_si128();
  const auto add_two_rows = [&](int first) {
    for (int r = first; r < first + 2; ++r) {
      const __m128i I = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(image + r * stride));
      const __m128i T = _mm_loadu_si128(reinterpret_cast<const __m128i*>(patch.px + r * kPatchSize));
      const __m128i d = _mm_sub_epi16(_mm_unpacklo_epi8(I, _mm_setzero_si128()), T);
      squares = _mm_add_epi32(squares, _mm_madd_epi16(d, d));
      image_sum = _mm_add_epi32(image_sum, _mm_sad_epu8(I, _mm_setzero_si128()));
    }
  };
  const auto partial = [&](int pixels, int32_t template_sum) {
    const int32_t sum = _mm_cvtsi128_si32(image_sum) - template_sum;
    return kPatchSize * kPatchSize / pixels * (pixels * sum_of_four(squares) - sum * sum);
  };
  add_two_rows(0);
  const int32_t after_2 = partial(16, patch.sum_2_rows);
  if (after_2 >= limit) return after_2;
  add_two_rows(2);
  const int32_t after_4 = partial(32, patch.sum_4_rows);
  if (after_4 >= limit) return after_4;
  add_two_rows(4);
  add_two_rows(6);
  return partial(64, patch.sum);
}

}  // namespace pptam::sse2
