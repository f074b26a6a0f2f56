// The kernels for x86-64 and for WebAssembly with vectors, where compilers do not vectorise the plain ones well. The
// results have the same bits.
#pragma once

#include <bit>
#include <cstring>

#include "base/sse2.h"
#include "image/kernels.h"

namespace pptam::sse2 {

using plain::bgra_row;

inline __m128i load_eight(const uint8_t* px) {  // as 16-bit numbers
  return _mm_unpacklo_epi8(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(px)), _mm_setzero_si128());
}
inline int load_two(const uint8_t* px) {
  uint16_t two;
  std::memcpy(&two, px, sizeof two);
  return two;
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

// 16 centres at a time. Ten neighbours of 16 hold one at least of each pair of opposite pixels: where those at 0, 4, 8
// and 12 do not say so, there is no corner. What is left is looked at one by one.
inline int fast_row(const uint8_t* row, int stride, int first, int last, int threshold, int16_t* out) {
  const FastCircle circle(stride);
  const __m128i t = _mm_set1_epi8(static_cast<char>(threshold)), zero = _mm_setzero_si128();
  const auto load = [](const uint8_t* px) { return _mm_loadu_si128(reinterpret_cast<const __m128i*>(px)); };
  int count = 0, x = first;
  for (; x + 15 <= last; x += 16) {
    const __m128i centre = load(row + x);
    const __m128i high = _mm_adds_epu8(centre, t), low = _mm_subs_epu8(centre, t);
    const __m128i north = load(row + x + circle.offset[0]), south = load(row + x + circle.offset[8]);
    const __m128i east = load(row + x + circle.offset[4]), west = load(row + x + circle.offset[12]);
    // Not brighter: the difference saturates to zero. Of both opposite ones: so does the larger.
    const auto none_brighter = [&](__m128i a, __m128i b) {
      return _mm_cmpeq_epi8(_mm_subs_epu8(_mm_max_epu8(a, b), high), zero);
    };
    const auto none_darker = [&](__m128i a, __m128i b) {
      return _mm_cmpeq_epi8(_mm_subs_epu8(low, _mm_min_epu8(a, b)), zero);
    };
    const __m128i not_bright = _mm_or_si128(none_brighter(north, south), none_brighter(east, west));
    const __m128i not_dark = _mm_or_si128(none_darker(north, south), none_darker(east, west));
    auto left = static_cast<uint32_t>(_mm_movemask_epi8(_mm_and_si128(not_bright, not_dark))) ^ 0xffffu;
    for (; left != 0; left &= left - 1) {
      const int at = x + std::countr_zero(left);
      if (is_fast_corner(row + at, circle, threshold)) out[count++] = static_cast<int16_t>(at);
    }
  }
  return count + plain::fast_row(row, stride, x, last, threshold, out + count);
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

// Four samples at a time. A 16-bit lane holds at most 255 x 256 after the blend along x.
inline WarpBlur warp(WarpGrid grid, uint8_t* framed) {
  constexpr int kSamples = kPatchFramed * 2, kFours = kSamples / 4;  // two rows are five fours
  if (touches_last(grid) || grid.stride > INT16_MAX) return plain::warp(grid, framed);
  // Positions of two rows; the next two are twice the step between rows further.
  alignas(16) int32_t x_at[kSamples], y_at[kSamples];
  for (int j = 0; j < 2; ++j) {
    for (int i = 0; i < kPatchFramed; ++i) {
      x_at[j * kPatchFramed + i] = grid.x + j * grid.dx_dj + i * grid.dx_di;
      y_at[j * kPatchFramed + i] = grid.y + j * grid.dy_dj + i * grid.dy_di;
    }
  }
  const __m128i x_step = _mm_set1_epi32(2 * grid.dx_dj), y_step = _mm_set1_epi32(2 * grid.dy_dj);
  const __m128i row_bits = _mm_set1_epi32(-65536), byte = _mm_set1_epi32(255), low_byte = _mm_set1_epi16(255);
  const __m128i one_and_stride = _mm_set1_epi32(1 + (grid.stride << 16));
  const __m128i whole = _mm_set1_epi16(256), sign = _mm_set1_epi16(INT16_MIN);
  const __m128i rounding = _mm_set1_epi32((32768 << 8) + 32768);  // and undoes the change of sign
  __m128i blur = _mm_setzero_si128();                             // x, x, y, y
  for (int rows = 0; rows < kPatchFramed / 2; ++rows) {
    for (int four = 0; four < kFours; ++four, framed += 4) {
      __m128i* const x_four = reinterpret_cast<__m128i*>(x_at) + four;
      __m128i* const y_four = reinterpret_cast<__m128i*>(y_at) + four;
      const __m128i x = _mm_load_si128(x_four), y = _mm_load_si128(y_four);
      _mm_store_si128(x_four, _mm_add_epi32(x, x_step));
      _mm_store_si128(y_four, _mm_add_epi32(y, y_step));
      const __m128i column_and_row = _mm_or_si128(_mm_srli_epi32(x, 16), _mm_and_si128(y, row_bits));
      const __m128i offset = _mm_madd_epi16(column_and_row, one_and_stride);
      const __m128i weight = _mm_packs_epi32(_mm_and_si128(_mm_srli_epi32(x, 8), byte),  // of the four x, then y
                                             _mm_and_si128(_mm_srli_epi32(y, 8), byte));
      const __m128i rest = _mm_sub_epi16(whole, weight);
      blur = _mm_add_epi32(blur, _mm_madd_epi16(weight, rest));

      // Pixels next to each other, of the upper row in the lower four lanes, of the lower row in the upper four.
      const int64_t offset_01 = _mm_cvtsi128_si64(offset),
                    offset_23 = _mm_cvtsi128_si64(_mm_unpackhi_epi64(offset, offset));
      const uint8_t* const px[4] = {grid.image + static_cast<int32_t>(offset_01), grid.image + (offset_01 >> 32),
                                    grid.image + static_cast<int32_t>(offset_23), grid.image + (offset_23 >> 32)};
      __m128i two = _mm_cvtsi32_si128(load_two(px[0]));
      two = _mm_insert_epi16(two, load_two(px[1]), 1);
      two = _mm_insert_epi16(two, load_two(px[2]), 2);
      two = _mm_insert_epi16(two, load_two(px[3]), 3);
      two = _mm_insert_epi16(two, load_two(px[0] + grid.stride), 4);
      two = _mm_insert_epi16(two, load_two(px[1] + grid.stride), 5);
      two = _mm_insert_epi16(two, load_two(px[2] + grid.stride), 6);
      two = _mm_insert_epi16(two, load_two(px[3] + grid.stride), 7);
      const __m128i left = _mm_and_si128(two, low_byte), right = _mm_srli_epi16(two, 8);
      const __m128i x_weight = _mm_unpacklo_epi64(weight, weight), x_rest = _mm_unpacklo_epi64(rest, rest);
      const __m128i across =
          _mm_xor_si128(_mm_add_epi16(_mm_mullo_epi16(left, x_rest), _mm_mullo_epi16(right, x_weight)), sign);
      // Upper and lower in turn; signed numbers, 32768 less.
      const __m128i both = _mm_unpacklo_epi16(across, _mm_unpackhi_epi64(across, across));
      const __m128i sum = _mm_madd_epi16(both, _mm_unpackhi_epi16(rest, weight));
      const __m128i grey = _mm_srli_epi32(_mm_add_epi32(sum, rounding), 16);
      const __m128i packed = _mm_packs_epi32(grey, grey);
      const int32_t four_px = _mm_cvtsi128_si32(_mm_packus_epi16(packed, packed));
      std::memcpy(framed, &four_px, sizeof four_px);
    }
  }
  const __m128i sums = _mm_add_epi32(blur, _mm_srli_epi64(blur, 32));
  return {_mm_cvtsi128_si32(sums), _mm_cvtsi128_si32(_mm_unpackhi_epi64(sums, sums))};
}

inline void pack_template(const uint8_t* framed, PackedTemplate* packed) {
  int32_t rows[kPatchSize];
  for (int r = 0; r < kPatchSize; ++r) {
    const __m128i eight = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(framed + (r + 1) * kPatchFramed + 1));
    _mm_storeu_si128(reinterpret_cast<__m128i*>(packed->px + r * kPatchSize),
                     _mm_unpacklo_epi8(eight, _mm_setzero_si128()));
    rows[r] = _mm_cvtsi128_si32(_mm_sad_epu8(eight, _mm_setzero_si128()));
  }
  packed->add_up(rows);
}

inline int32_t zmssd_x64(const uint8_t* image, int stride, const PackedTemplate& patch, int32_t /*limit*/) {
  __m128i squares = _mm_setzero_si128(), image_sum = _mm_setzero_si128();
  const __m128i zero = _mm_setzero_si128();
  for (int r = 0; r < kPatchSize; r += 2) {
    const __m128i I = _mm_unpacklo_epi64(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(image + r * stride)),
                                         _mm_loadl_epi64(reinterpret_cast<const __m128i*>(image + (r + 1) * stride)));
    const auto* T = reinterpret_cast<const __m128i*>(patch.px + r * kPatchSize);
    const __m128i upper = _mm_sub_epi16(_mm_unpacklo_epi8(I, zero), _mm_loadu_si128(T));
    const __m128i lower = _mm_sub_epi16(_mm_unpackhi_epi8(I, zero), _mm_loadu_si128(T + 1));
    squares = _mm_add_epi32(squares, _mm_add_epi32(_mm_madd_epi16(upper, upper), _mm_madd_epi16(lower, lower)));
    image_sum = _mm_add_epi32(image_sum, _mm_sad_epu8(I, zero));
  }
  const int32_t sum = _mm_cvtsi128_si32(_mm_add_epi32(image_sum, _mm_unpackhi_epi64(image_sum, image_sum))) - patch.sum;
  return kPatchSize * kPatchSize * sum_of_four(squares) - sum * sum;
}

// The middle four rows of all four positions first, which most often reject them.
constexpr bool kFourAtOnce = true;
inline bool zmssd_x64_of_four(const uint8_t* image, int stride, const PackedTemplate& patch, int32_t limit,
                              int32_t out[4]) {
  const __m128i zero = _mm_setzero_si128();
  __m128i squares[4] = {zero, zero, zero, zero}, sums[4] = {zero, zero, zero, zero};  // four partial sums; even lanes
  const auto add_two_rows = [&](int r) {
    const auto* T = reinterpret_cast<const __m128i*>(patch.px + r * kPatchSize);
    const __m128i upper = _mm_loadu_si128(T), lower = _mm_loadu_si128(T + 1);
    const uint8_t* px = image + r * stride;
    for (int i = 0; i < 4; ++i, ++px) {
      const __m128i I = _mm_unpacklo_epi64(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(px)),
                                           _mm_loadl_epi64(reinterpret_cast<const __m128i*>(px + stride)));
      const __m128i a = _mm_sub_epi16(_mm_unpacklo_epi8(I, zero), upper);
      const __m128i b = _mm_sub_epi16(_mm_unpackhi_epi8(I, zero), lower);
      squares[i] = _mm_add_epi32(squares[i], _mm_add_epi32(_mm_madd_epi16(a, a), _mm_madd_epi16(b, b)));
      sums[i] = _mm_add_epi32(sums[i], _mm_sad_epu8(I, zero));
    }
  };
  // 64 squares - times sum^2 of the four positions. Sums are under 2^14.
  const auto zero_mean = [&](int32_t template_sum, uint32_t times_bits) {
    const auto halves = [](__m128i a, __m128i b) {
      return _mm_add_epi32(_mm_unpacklo_epi64(a, b), _mm_unpackhi_epi64(a, b));
    };
    const auto quarters = [](__m128i a, __m128i b) {
      return _mm_add_epi32(_mm_unpacklo_epi32(a, b), _mm_unpackhi_epi32(a, b));
    };
    const __m128i all = halves(quarters(squares[0], squares[1]), quarters(squares[2], squares[3]));
    const __m128i image_sum = _mm_packs_epi32(halves(sums[0], sums[1]), halves(sums[2], sums[3]));  // in lower halves
    const __m128i sum = _mm_sub_epi16(image_sum, _mm_set1_epi32(template_sum));
    return _mm_sub_epi32(_mm_slli_epi32(all, 6), _mm_slli_epi32(_mm_madd_epi16(sum, sum), times_bits));
  };
  add_two_rows(2);
  add_two_rows(4);
  const __m128i after_4 = zero_mean(patch.sum_4_rows, 1);
  if (_mm_movemask_epi8(_mm_cmpgt_epi32(_mm_set1_epi32(limit), after_4)) == 0) return false;
  add_two_rows(0);
  add_two_rows(6);
  _mm_storeu_si128(reinterpret_cast<__m128i*>(out), zero_mean(patch.sum, 0));
  return true;
}

inline void prepare_refinement(const uint8_t* framed, RefineTemplate* prepared) {
  static_assert(kSampleUnit == 1 << 3);
  const auto load = [](const int16_t* from) { return _mm_loadu_si128(reinterpret_cast<const __m128i*>(from)); };
  const auto store = [](int16_t* to, __m128i v) { _mm_storeu_si128(reinterpret_cast<__m128i*>(to), v); };
  for (int r = 0; r < kPatchFramed; ++r)
    for (const int c : {0, kPatchFramed - 8})  // two columns are the first eight's, too
      store(prepared->value + r * kPatchPitch + c, _mm_slli_epi16(load_eight(framed + r * kPatchFramed + c), 3));
  for (int r = 0; r < kPatchSize; ++r) {
    const int16_t* T = prepared->value + (r + 1) * kPatchPitch + 1;
    const __m128i here = load(T), twice = _mm_add_epi16(here, here);
    const __m128i xx = _mm_sub_epi16(_mm_add_epi16(load(T - 1), load(T + 1)), twice);
    const __m128i yy = _mm_sub_epi16(_mm_add_epi16(load(T - kPatchPitch), load(T + kPatchPitch)), twice);
    store(prepared->curvature + 2 * r * kPatchSize, _mm_unpacklo_epi16(xx, yy));
    store(prepared->curvature + (2 * r + 1) * kPatchSize, _mm_unpackhi_epi16(xx, yy));
  }
}

// A row of a framed patch in two vectors, of its columns 0 to 7 and 2 to 9.
struct FramedRow {
  __m128i left, right;
};

inline RefineSums refine_sums(const RefineSample& s, const RefineTemplate& T) {
  const auto times = [](__m128i a, int32_t weight) {
    return _mm_mullo_epi16(a, _mm_set1_epi16(static_cast<int16_t>(weight)));
  };
  // Interpolated along x: at most 32 x 255 / 4 = 2040.
  const auto across = [&](int r) {
    const uint8_t* px = s.image + r * s.stride;
    const auto eight = [&](int c) {
      return _mm_srli_epi16(
          _mm_add_epi16(times(load_eight(px + c), kSubpixels - s.x_weight), times(load_eight(px + c + 1), s.x_weight)),
          2);
    };
    return FramedRow{eight(0), eight(2)};
  };
  const auto load = [](const int16_t* from) { return _mm_loadu_si128(reinterpret_cast<const __m128i*>(from)); };
  FramedRow above = across(0);
  // I + T. Along y a lane holds at most 32 x 2040 < 2^16.
  const auto next_row = [&](int r) {
    const FramedRow below = across(r + 1);
    const auto down = [&](__m128i a, __m128i b, const int16_t* t) {
      const __m128i I = _mm_srli_epi16(_mm_add_epi16(times(a, kSubpixels - s.y_weight), times(b, s.y_weight)), 5);
      return _mm_add_epi16(I, load(t));
    };
    const int16_t* t = T.value + r * kPatchPitch;
    const FramedRow both{down(above.left, below.left, t), down(above.right, below.right, t + 2)};
    above = below;
    return both;
  };
  // Columns 1 to 8.
  const __m128i last_lane = _mm_slli_si128(_mm_set1_epi16(-1), 14);
  const auto middle = [&](const FramedRow& row) {
    return _mm_or_si128(_mm_srli_si128(row.left, 2), _mm_and_si128(_mm_slli_si128(row.right, 2), last_lane));
  };

  const __m128i blur_weights =
      _mm_set1_epi32((s.x_blur & 0xffff) | static_cast<int32_t>(static_cast<uint32_t>(s.y_blur) << 16));
  const __m128i half = _mm_set1_epi32(1 << 16);
  __m128i xx = _mm_setzero_si128(), xy = xx, yy = xx, xe = xx, ye = xx, ee = xx;
  __m128i x = xx, y = xx, e_sum = xx;  // of eight rows of at most 4080: under 2^15
  const auto add_products = [](__m128i a, __m128i b, __m128i* sum) {
    *sum = _mm_add_epi32(*sum, _mm_madd_epi16(a, b));
  };
  __m128i upper = middle(next_row(0));
  FramedRow row = next_row(1);
  for (int r = 1; r <= kPatchSize; ++r) {
    const FramedRow below = next_row(r + 1);
    const __m128i here = middle(row), lower = middle(below);
    const __m128i jx = _mm_sub_epi16(row.right, row.left), jy = _mm_sub_epi16(lower, upper);
    const __m128i t = load(T.value + r * kPatchPitch + 1);
    const int16_t* k = T.curvature + 2 * (r - 1) * kPatchSize;
    const auto blurred = [&](const int16_t* four) {
      return _mm_srai_epi32(_mm_add_epi32(_mm_madd_epi16(load(four), blur_weights), half), 17);
    };
    const __m128i blur = _mm_packs_epi32(blurred(k), blurred(k + kPatchSize));
    const __m128i e = _mm_add_epi16(_mm_sub_epi16(_mm_add_epi16(t, t), here), blur);
    add_products(jx, jx, &xx);
    add_products(jx, jy, &xy);
    add_products(jy, jy, &yy);
    add_products(jx, e, &xe);
    add_products(jy, e, &ye);
    add_products(e, e, &ee);
    x = _mm_add_epi16(x, jx);
    y = _mm_add_epi16(y, jy);
    e_sum = _mm_add_epi16(e_sum, e);
    upper = here;
    row = below;
  }
  const __m128i ones = _mm_set1_epi16(1);
  return {.xx = sum_of_four(xx),
          .xy = sum_of_four(xy),
          .yy = sum_of_four(yy),
          .xe = sum_of_four(xe),
          .ye = sum_of_four(ye),
          .ee = sum_of_four(ee),
          .x = sum_of_four(_mm_madd_epi16(x, ones)),
          .y = sum_of_four(_mm_madd_epi16(y, ones)),
          .e = sum_of_four(_mm_madd_epi16(e_sum, ones))};
}

}  // namespace pptam::sse2
