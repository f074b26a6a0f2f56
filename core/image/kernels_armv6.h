// The kernels for ARMv6 and later without NEON. Media instructions work on two 16-bit numbers in one register.
//
// A pair is such a register, the lower number in bits 0-15. In natural order (c, c + 1) a pair is a word of an int16_t
// array. A word of four pixels splits into the pairs (0, 2) and (1, 3). Words are read unaligned, which ARMv6 allows.
// Ranges are those of kernels.h; the results have the same bits.
#pragma once

#include <arm_acle.h>

#include <bit>
#include <cstring>

#include "image/kernels.h"

namespace pptam::armv6 {

static_assert(std::endian::native == std::endian::little, "pairs are read from memory as little-endian words");

inline uint32_t load_word(const void* from) {
  uint32_t word;
  std::memcpy(&word, from, sizeof word);
  return word;
}
inline void store_word(void* to, uint32_t word) {
  std::memcpy(to, &word, sizeof word);
}
inline uint32_t even_bytes(uint32_t word) {  // bytes (0, 2); compilers make one instruction of it
  return word & 0x00ff00ffu;
}
inline uint32_t odd_bytes(uint32_t word) {  // bytes (1, 3)
  return (word >> 8) & 0x00ff00ffu;
}
inline uint32_t subtract(uint32_t a, uint32_t b) {
  return static_cast<uint32_t>(__ssub16(static_cast<int16x2_t>(a), static_cast<int16x2_t>(b)));
}
inline uint32_t add(uint32_t a, uint32_t b) {
  return static_cast<uint32_t>(__sadd16(static_cast<int16x2_t>(a), static_cast<int16x2_t>(b)));
}
inline uint32_t lower_halves(uint32_t a, uint32_t b) {  // (a0, b0)
  return (a & 0xffffu) | (b << 16);
}
inline uint32_t upper_halves(uint32_t a, uint32_t b) {  // (a1, b1)
  return (a >> 16) | (b & 0xffff0000u);
}
inline int32_t add_products(uint32_t a, uint32_t b, int32_t sum) {  // sum + a0 b0 + a1 b1
  return __smlad(static_cast<int16x2_t>(a), static_cast<int16x2_t>(b), sum);
}
inline int32_t add_four(uint32_t word, int32_t sum) {  // sum + the four bytes of word
  return static_cast<int32_t>(__usada8(word, 0, static_cast<uint32_t>(sum)));
}
inline int32_t add_lower_product(uint32_t a, uint32_t b, int32_t sum) {  // sum + a0 b0
  return __smlabb(static_cast<int32_t>(a), static_cast<int32_t>(b), sum);
}
inline int32_t add_upper_product(uint32_t a, uint32_t b, int32_t sum) {  // sum + a1 b1
  return __smlatt(static_cast<int32_t>(a), static_cast<int32_t>(b), sum);
}
using plain::fast_row;
using plain::kFourAtOnce;
using plain::zmssd_x64_of_four;

constexpr uint32_t kOnes = 0x00010001u;  // the pair (1, 1)

// Gives 256 Y + 128 in the upper half of the word (256 x 255 + 128 < 2^16, so nothing is lost at the top). Red and blue
// share one multiplication: (B + R 2^16) (77 + 29 2^16) has 77 R + 29 B in its upper half and 77 B < 2^16, which
// carries nothing, in its lower half.
inline uint32_t weigh_bgra(uint32_t pixel, uint32_t green_weight) {
  return even_bytes(pixel) * (kRedWeight + (kBlueWeight << 16)) + ((pixel & 0x0000ff00u) * green_weight + (128u << 16));
}
inline void bgra_row(const uint8_t* src, uint8_t* out, int count) {
  // Volatile, because the compiler would replace the multiply-add instruction by four shifts and adds.
  const volatile uint32_t weight = kGreenWeight << 8;
  const uint32_t green = weight;
  int x = 0;
  for (; x + 4 <= count; x += 4) {  // four pixels at a time: one store, a quarter of the loop overhead
    const uint32_t y0 = weigh_bgra(load_word(src + 4 * x), green), y1 = weigh_bgra(load_word(src + 4 * x + 4), green);
    const uint32_t y2 = weigh_bgra(load_word(src + 4 * x + 8), green),
                   y3 = weigh_bgra(load_word(src + 4 * x + 12), green);
    const uint32_t even = (y2 & 0xffff0000u) | (y0 >> 16), odd = (y3 & 0xffff0000u) | (y1 >> 16);
    store_word(out + x, odd_bytes(even) | (odd & 0xff00ff00u));
  }
  plain::bgra_row(src + 4 * x, out + x, count - x);
}

inline void half_row(const uint8_t* upper, const uint8_t* lower, uint8_t* out, int count) {
  // Two means from two words of four pixels, one above the other. A lane holds at most 4 x 255 + 2 = 1022.
  const auto two_means = [](uint32_t a, uint32_t b) {
    const uint32_t even = __uxtab16(__uxtab16(0x00020002u, a), b);
    return (even + odd_bytes(a) + odd_bytes(b)) >> 2 & 0x00ff00ffu;
  };
  int x = 0;
  for (; x + 4 <= count; x += 4) {
    const uint32_t left = two_means(load_word(upper + 2 * x), load_word(lower + 2 * x));
    const uint32_t right = two_means(load_word(upper + 2 * x + 4), load_word(lower + 2 * x + 4));
    store_word(out + x, ((left | left >> 8) & 0xffffu) | (right | right >> 8) << 16);
  }
  plain::half_row(upper + 2 * x, lower + 2 * x, out + x, count - x);
}

// Gradients of one row of a neighbourhood as pairs: columns (0, 2), (1, 3), (4, 6), (5, 7), and column 8 in the lower
// half of the last.
struct GradientRow {
  uint32_t a, b, c, d, e;
};

// Sums of products over the 2 kRadius + 1 columns from column 0, from 1 and from 2 on.
template <int kRadius>
[[gnu::always_inline]] inline void sum_products(const GradientRow& f, const GradientRow& g, int32_t out[3]) {
  if constexpr (kRadius == 3) {
    const int32_t c = add_products(f.c, g.c, 0);
    out[0] = add_products(f.a, g.a, add_products(f.b, g.b, add_lower_product(f.d, g.d, c)));
    const int32_t acd = add_upper_product(f.a, g.a, add_products(f.d, g.d, c));  // column 2 is the upper half of a
    out[1] = add_products(f.b, g.b, acd);
    out[2] = add_upper_product(f.b, g.b, add_lower_product(f.e, g.e, acd));
  } else {
    static_assert(kRadius == 2);
    const int32_t c = add_lower_product(f.c, g.c, 0);
    out[0] = add_products(f.a, g.a, add_products(f.b, g.b, c));
    const int32_t acd = add_upper_product(f.a, g.a, add_lower_product(f.d, g.d, c));
    out[1] = add_products(f.b, g.b, acd);
    out[2] = add_upper_product(f.b, g.b, add_upper_product(f.c, g.c, acd));
  }
}

template <int kRadius>
inline void window_sums(const uint8_t* px, int stride, StructureTensor sums[9]) {
  constexpr int kSpan = 2 * kRadius + 3, kLast = kSpan - 1;
  int32_t rows[3][kSpan][3];  // component, row, window
  const uint8_t* row = px - (kRadius + 1) * stride - kRadius - 1;
  for (int r = 0; r < kSpan; ++r, row += stride) {
    GradientRow x, y;
    const auto four_columns = [&](int c, uint32_t* x_even, uint32_t* x_odd, uint32_t* y_even, uint32_t* y_odd) {
      const uint32_t left = load_word(row + c - 1), right = load_word(row + c + 1);
      *x_even = subtract(even_bytes(right), even_bytes(left));
      *x_odd = subtract(odd_bytes(right), odd_bytes(left));
      const uint32_t upper = load_word(row + c - stride), lower = load_word(row + c + stride);
      *y_even = subtract(even_bytes(lower), even_bytes(upper));
      *y_odd = subtract(odd_bytes(lower), odd_bytes(upper));
    };
    four_columns(0, &x.a, &x.b, &y.a, &y.b);
    four_columns(4, &x.c, &x.d, &y.c, &y.d);
    if constexpr (kRadius == 3) {
      x.e = static_cast<uint32_t>(row[9] - row[7]);
      y.e = static_cast<uint32_t>(row[8 + stride] - row[8 - stride]);
    }
    sum_products<kRadius>(x, x, rows[0][r]);
    sum_products<kRadius>(x, y, rows[1][r]);
    sum_products<kRadius>(y, y, rows[2][r]);
  }
  constexpr int32_t StructureTensor::*kComponent[3] = {&StructureTensor::xx, &StructureTensor::xy,
                                                       &StructureTensor::yy};
#pragma GCC unroll 3
  for (int i = 0; i < 3; ++i) {
    for (int w = 0; w < 3; ++w) {
      const auto at = [&](int r) { return rows[i][r][w]; };
      int32_t shared = at(2);
      for (int r = 3; r <= kLast - 2; ++r) shared += at(r);
      sums[w].*kComponent[i] = shared + at(0) + at(1);
      sums[3 + w].*kComponent[i] = shared + at(1) + at(kLast - 1);
      sums[6 + w].*kComponent[i] = shared + at(kLast - 1) + at(kLast);
    }
  }
}

inline uint32_t load_two(const uint8_t* px) {
  uint16_t two;
  std::memcpy(&two, px, sizeof two);
  return two;
}

// One multiplication blends two rows along x: the pair (upper, lower) holds at most 255 x 256.
inline WarpBlur warp(WarpGrid grid, uint8_t* framed) {
  if (touches_last(grid)) return plain::warp(grid, framed);
  uint32_t weights = 0;  // pair (x, y): at most 100 x 255
  int32_t x_squares = 0, y_squares = 0;
  for (int j = 0; j < kPatchFramed; ++j) {
    int32_t x = grid.x + j * grid.dx_dj, y = grid.y + j * grid.dy_dj;
    for (int i = 0; i < kPatchFramed; ++i, x += grid.dx_di, y += grid.dy_di) {
      const uint8_t* px = grid.image + (y >> 16) * grid.stride + (x >> 16);
      const uint32_t two_rows = load_two(px) | load_two(px + grid.stride) << 16;
      const uint32_t left = even_bytes(two_rows), right = odd_bytes(two_rows);
      const uint32_t x_weight = static_cast<uint32_t>(x) >> 8 & 255, y_weight = static_cast<uint32_t>(y) >> 8 & 255;
      const uint32_t rows = (left << 8) + (right - left) * x_weight;
      const uint32_t upper = rows & 0xffffu;
      *framed++ = static_cast<uint8_t>(((upper << 8) + 32768 + ((rows >> 16) - upper) * y_weight) >> 16);
      weights += x_weight + (y_weight << 16);
      x_squares += static_cast<int32_t>(x_weight * x_weight);
      y_squares += static_cast<int32_t>(y_weight * y_weight);
    }
  }
  // f (1 - f) in units of 2^-16 is 256 w - w^2 for the weight w.
  return {static_cast<int32_t>((weights & 0xffffu) << 8) - x_squares,
          static_cast<int32_t>(weights >> 16 << 8) - y_squares};
}

// Rows are stored as the pairs (0, 2), (1, 3), (4, 6), (5, 7).
inline void pack_template(const uint8_t* framed, PackedTemplate* packed) {
  int32_t rows[kPatchSize] = {};
  for (int r = 0; r < kPatchSize; ++r) {
    for (int half = 0; half < 2; ++half) {
      const uint32_t word = load_word(framed + (r + 1) * kPatchFramed + 1 + 4 * half);
      int16_t* out = packed->px + r * kPatchSize + 4 * half;
      store_word(out, even_bytes(word));
      store_word(out + 2, odd_bytes(word));
      rows[r] = add_four(word, rows[r]);
    }
  }
  packed->add_up(rows);
}

// Adds I and (I - T)^2 over row r of eight pixels and the one as far from the other end.
[[gnu::always_inline]] inline void add_two_rows(const uint8_t* image, int stride, const int16_t* T, int r,
                                                int32_t* squares, int32_t* image_sum) {
#pragma GCC unroll 4
  for (int i = 0; i < 4; ++i) {
    const int row = i < 2 ? r : kPatchSize - 1 - r, column = i % 2 * 4;
    const uint32_t word = load_word(image + row * stride + column);
    const int16_t* four = T + row * kPatchSize + column;
    const uint32_t even = subtract(even_bytes(word), load_word(four));
    const uint32_t odd = subtract(odd_bytes(word), load_word(four + 2));
    *squares = add_products(even, even, *squares);
    *squares = add_products(odd, odd, *squares);
    *image_sum = add_four(word, *image_sum);
  }
}

[[gnu::always_inline]] inline int32_t zmssd_x64(const uint8_t* image, int stride, const PackedTemplate& patch,
                                                int32_t limit) {
  int32_t squares = 0, image_sum = 0;
  add_two_rows(image, stride, patch.px, 3, &squares, &image_sum);
  int32_t sum = image_sum - patch.sum_2_rows;
  const int32_t after_2 = 4 * (16 * squares - sum * sum);
  if (after_2 >= limit) return after_2;
  add_two_rows(image, stride, patch.px, 2, &squares, &image_sum);
  sum = image_sum - patch.sum_4_rows;
  const int32_t after_4 = 2 * (32 * squares - sum * sum);
  if (after_4 >= limit) return after_4;
  add_two_rows(image, stride, patch.px, 1, &squares, &image_sum);
  add_two_rows(image, stride, patch.px, 0, &squares, &image_sum);
  sum = image_sum - patch.sum;
  return 64 * squares - sum * sum;
}

inline void prepare_refinement(const uint8_t* framed, RefineTemplate* prepared) {
  int16_t* out = prepared->value;
  for (int r = 0; r < kPatchFramed; ++r, framed += kPatchFramed, out += kPatchPitch) {
    for (int c = 0; c < 8; c += 4) {
      const uint32_t word = load_word(framed + c);
      const uint32_t even = even_bytes(word) << 3, odd = odd_bytes(word) << 3;
      store_word(out + c, lower_halves(even, odd));
      store_word(out + c + 2, upper_halves(even, odd));
    }
    store_word(out + 8, static_cast<uint32_t>(framed[8] << 3 | framed[9] << 19));
  }
  const int16_t* T = prepared->value + kPatchPitch + 1;
  int16_t* curvature = prepared->curvature;
  for (int r = 0; r < kPatchSize; ++r, T += kPatchPitch) {
    for (int c = 0; c < kPatchSize; c += 2, curvature += 4) {
      const uint32_t twice = load_word(T + c) << 1;
      const uint32_t xx = subtract(load_word(T + c - 1) + load_word(T + c + 1), twice);
      const uint32_t yy = subtract(load_word(T + c - kPatchPitch) + load_word(T + c + kPatchPitch), twice);
      store_word(curvature, lower_halves(xx, yy));
      store_word(curvature + 2, upper_halves(xx, yy));
    }
  }
}

inline RefineSums refine_sums(const RefineSample& s, const RefineTemplate& T) {
  // One multiplication serves two pixels: a 16-bit lane holds at most 32 x 255 along x and 32 x 2040 along y, under
  // 2^16.
  alignas(8) int16_t across[(kPatchFramed + 1) * kPatchPitch];
  {
    const auto left = static_cast<uint32_t>(kSubpixels - s.x_weight), right = static_cast<uint32_t>(s.x_weight);
    // The caller masks the result, because bits shift from one lane into the other.
    const auto blend = [=](uint32_t a, uint32_t b) { return (a * left + b * right) >> 2; };
    constexpr uint32_t kMask = 0x3fff3fffu;  // 14 bits of each lane: results after the shift
    const uint8_t* px = s.image;
    int16_t* out = across;
    for (int r = 0; r <= kPatchFramed; ++r, px += s.stride, out += kPatchPitch) {
      const auto four_columns = [&](int c) {
        const uint32_t word = load_word(px + c);
        const uint32_t odd = odd_bytes(word);
        const uint32_t even_out = blend(even_bytes(word), odd) & kMask;                 // columns (0, 2)
        const uint32_t odd_out = blend(odd, odd_bytes(load_word(px + c + 1))) & kMask;  // columns (1, 3)
        store_word(out + c, lower_halves(even_out, odd_out));
        store_word(out + c + 2, upper_halves(even_out, odd_out));
      };
      four_columns(0);
      four_columns(4);
      const uint32_t last = load_word(px + 7);  // pixels 7 to 10: nothing is read beyond the 11th
      const uint32_t odd = odd_bytes(last);     // (8, 10)
      const uint32_t a = lower_halves(odd, last >> 16 & 0xffu), b = (last >> 16 & 0xffu) | (odd & 0xffff0000u);
      store_word(out + 8, blend(a, b) & kMask);
    }
  }

  alignas(8) int16_t both[kPatchFramed * kPatchPitch];
  {
    const auto upper = static_cast<uint32_t>(kSubpixels - s.y_weight), lower = static_cast<uint32_t>(s.y_weight);
    for (int c = 0; c < kPatchFramed; c += 2) {
      uint32_t above = load_word(across + c);
#pragma GCC unroll 10
      for (int r = 0; r < kPatchFramed; ++r) {
        const uint32_t below = load_word(across + (r + 1) * kPatchPitch + c);
        const uint32_t I = ((above * upper + below * lower) >> 5) & 0x07ff07ffu;
        store_word(both + r * kPatchPitch + c, I + load_word(T.value + r * kPatchPitch + c));
        above = below;
      }
    }
  }

  // In two passes, because the nine sums do not fit the registers in one.
  int16_t errors[kPatchSize * kPatchSize];
  RefineSums sums;
  {
    const uint32_t blur = (static_cast<uint32_t>(s.x_blur) & 0xffffu) | (static_cast<uint32_t>(s.y_blur) << 16);
    const int16_t* b = both + kPatchPitch + 1;
    const int16_t* t = T.value + kPatchPitch + 1;
    const int16_t* k = T.curvature;
    int16_t* out = errors;
    int32_t ee = 0, e_sum = 0;
    for (int r = 0; r < kPatchSize; ++r, b += kPatchPitch, t += kPatchPitch, k += 2 * kPatchSize, out += kPatchSize) {
#pragma GCC unroll 4
      for (int c = 0; c < kPatchSize; c += 2) {
        const int32_t first = add_products(load_word(k + 2 * c), blur, 1 << 16);
        const int32_t second = add_products(load_word(k + 2 * c + 2), blur, 1 << 16);
        const uint32_t blurred =
            (static_cast<uint32_t>(first >> 17) & 0xffffu) | (static_cast<uint32_t>(second >> 17) << 16);
        const uint32_t e = add(subtract(load_word(t + c) << 1, load_word(b + c)), blurred);
        store_word(out + c, e);
        ee = add_products(e, e, ee);
        e_sum = add_products(e, kOnes, e_sum);
      }
    }
    sums.ee = ee;
    sums.e = e_sum;
  }
  const int16_t* b = both + kPatchPitch + 1;
  const int16_t* error = errors;
  int32_t xx = 0, xy = 0, yy = 0, xe = 0, ye = 0;
  for (int r = 0; r < kPatchSize; ++r, b += kPatchPitch, error += kPatchSize) {
#pragma GCC unroll 4
    for (int c = 0; c < kPatchSize; c += 2) {
      const uint32_t e = load_word(error + c);
      const uint32_t jx = subtract(load_word(b + c + 1), load_word(b + c - 1));
      const uint32_t jy = subtract(load_word(b + c + kPatchPitch), load_word(b + c - kPatchPitch));
      xx = add_products(jx, jx, xx);
      xy = add_products(jx, jy, xy);
      yy = add_products(jy, jy, yy);
      xe = add_products(jx, e, xe);
      ye = add_products(jy, e, ye);
    }
  }
  sums.xx = xx, sums.xy = xy, sums.yy = yy, sums.xe = xe, sums.ye = ye;
  // A sum of differences along a row or column leaves only the pixels at its ends.
  for (int i = 1; i <= kPatchSize; ++i) {
    const int16_t* row = both + i * kPatchPitch;
    sums.x += row[9] + row[8] - row[1] - row[0];
    const int16_t* column = both + i;
    sums.y += column[9 * kPatchPitch] + column[8 * kPatchPitch] - column[kPatchPitch] - column[0];
  }
  return sums;
}

}  // namespace pptam::armv6
