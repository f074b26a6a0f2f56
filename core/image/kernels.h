// The inner loops of pyramid, corner detection, patch warp, search and refinement.
//
// Each is written here in plain C++. That is the specification, and compilers vectorise it for NEON or SSE2. Where it
// is faster there is a second variant by hand (kernels_armv6.h, kernels_neon.h, kernels_sse2.h, kernels_words.h). All
// variants give the same bits; a test compares them. Callers use namespace kernel, which has the target's fastest
// variants.
#pragma once

#include <algorithm>
#include <cstdint>

#include "base/sse2.h"

// Variants in words of 64 bits; the tests define it on other processors, too.
#if defined(__wasm__) && !defined(PPTAM_SSE2) && !defined(PPTAM_PLAIN)
#define PPTAM_WORDS
#endif

namespace pptam {

constexpr int kPatchSize = 8;                 // pixels [ptam 5.3, phone 4]
constexpr int kPatchFramed = kPatchSize + 2;  // pixels, with one more on every side for gradients
constexpr int kPatchPitch = 12;               // int16_t in a row of a framed patch: the next multiple of a 64-bit word
// Patches are sampled at multiples of 1/kSubpixels pixel, in units of 1/kSampleUnit grey level: the sums of RefineSums
// then fit int32_t. Not swept.
constexpr int kSubpixels = 32;
constexpr int kSampleUnit = 8;

// A framed patch as an affine grid of samples in an image. Positions in 1/65536 px, 128 more than what is meant: they
// are rounded down to 1/256. All samples lie in the image, whose sides are at most 16384.
struct WarpGrid {
  const uint8_t* image;
  int stride;            // bytes
  int x_last, y_last;    // the image's last column and row, at least 1
  int32_t x, y;          // of the first sample
  int32_t dx_di, dy_di;  // from column to column of the patch
  int32_t dx_dj, dy_dj;  // from row to row
};

// Sums of f (1 - f) over the samples, f the fraction of a pixel, along the image's axes: units of 2^-16, at most
// 100 x 2^14.
struct WarpBlur {
  int32_t x = 0, y = 0;
};

// Whether a sample lies in the last column or row. There the 2x2 pixels that are blended start one earlier, with a
// weight of 256, and variants by hand leave the patch to the plain one.
inline bool touches_last(const WarpGrid& grid) {
  constexpr int kLast = kPatchFramed - 1;
  const int32_t x_high = grid.x + kLast * (std::max<int32_t>(grid.dx_di, 0) + std::max<int32_t>(grid.dx_dj, 0));
  const int32_t y_high = grid.y + kLast * (std::max<int32_t>(grid.dy_di, 0) + std::max<int32_t>(grid.dy_dj, 0));
  return x_high >> 16 >= grid.x_last || y_high >> 16 >= grid.y_last;
}

// The 8x8 pixels of a template, prepared for zmssd_x64().
struct PackedTemplate {
  alignas(8) int16_t px[kPatchSize * kPatchSize];  // row by row; the order within a row depends on the variant
  int32_t sum_2_rows = 0;                          // sums of the middle 2 and 4 rows, and of all 8
  int32_t sum_4_rows = 0;
  int32_t sum = 0;
  void add_up(const int32_t (&rows)[kPatchSize]) {  // the sums of its rows
    sum_2_rows = rows[3] + rows[4];
    sum_4_rows = rows[2] + sum_2_rows + rows[5];
    sum = rows[0] + rows[1] + sum_4_rows + rows[6] + rows[7];
  }
};

#if defined(PPTAM_WORDS)
constexpr int kCurvatureSize = 4;  // int16_t for both of a pixel's curvatures
#else
constexpr int kCurvatureSize = 2;
#endif

// What refine_sums() needs of the framed template; the same in all iterations of a refinement. The order within a row
// depends on the variant.
struct RefineTemplate {
  alignas(8) int16_t value[kPatchFramed * kPatchPitch];                    // in 1/kSampleUnit grey level
  alignas(8) int16_t curvature[kPatchSize * kPatchSize * kCurvatureSize];  // T_xx, T_yy of the 8x8, same unit
};

// Where and how refine_sums() samples the image.
struct RefineSample {
  const uint8_t* image;        // top-left of 11x11 pixels
  int stride;                  // bytes
  int32_t x_weight, y_weight;  // fraction of a pixel, 0..kSubpixels
  // Blur (see PatchTemplate::x_blur) of the image minus that of the template, units of 2^-16, range -2^15..2^14.
  int32_t x_blur, y_blur;
};

// Sums over the 64 pixels of j = 32 (grad T + grad I) / 2, of e = 8 (T - I) and of their products. Ranges:
//   |j| <= 8 x 255 x 2 = 4080
//   |e| <= 8 x 255 = 2040 from the difference, and 2 x 8 x 510 x 2^15 / 2^17 = 2040 from the blur
//   |sums| <= 64 x 4080^2 = 1.07e9
struct RefineSums {
  int32_t xx = 0, xy = 0, yy = 0, xe = 0, ye = 0, ee = 0, x = 0, y = 0, e = 0;
};

// Sums of products of the gradients I(x+1) - I(x-1), grey^2. |gradient| <= 255: a sum over 7x7 pixels is at most
// 49 x 255^2 = 3.2e6.
struct StructureTensor {
  int32_t xx, xy, yy;
  void operator+=(const StructureTensor& other) {
    xx += other.xx;
    xy += other.xy;
    yy += other.yy;
  }
  friend StructureTensor operator+(StructureTensor a, const StructureTensor& b) {
    a += b;
    return a;
  }
};

// The circle of FAST [ptam 5.1]: 16 pixels 3 pixels away, in order round the centre.
constexpr int kFastRadius = 3;
struct FastCircle {
  int offset[16];  // in an image of this stride, bytes
  explicit constexpr FastCircle(int stride) : offset() {
    constexpr int kX[16] = {0, 1, 2, 3, 3, 3, 2, 1, 0, -1, -2, -3, -3, -3, -2, -1};
    constexpr int kY[16] = {-3, -3, -2, -1, 0, 1, 2, 3, 3, 3, 2, 1, 0, -1, -2, -3};
    for (int i = 0; i < 16; ++i) offset[i] = kY[i] * stride + kX[i];
  }
};

// Whether a circle of 16 bits has ten neighbouring ones.
inline bool ten_in_a_row(uint32_t bits) {
  const uint32_t twice = bits | bits << 16;
  const uint32_t two = twice & twice >> 1, four = two & two >> 2, eight = four & four >> 4;
  return (eight & two >> 8 & 0xffff) != 0;
}

// Whether ten neighbouring pixels of the circle are all brighter, or all darker, than the centre by more than the
// threshold, grey levels.
inline bool is_fast_corner(const uint8_t* centre, const FastCircle& circle, int threshold) {
  const int high = *centre + threshold, low = *centre - threshold;
  uint32_t brighter = 0, darker = 0;
  for (int i = 0; i < 16; ++i) {
    const int value = centre[circle.offset[i]];
    brighter |= static_cast<uint32_t>(value > high) << i;
    darker |= static_cast<uint32_t>(value < low) << i;
  }
  return ten_in_a_row(brighter) || ten_in_a_row(darker);
}

// Luma weights 0.299, 0.587 and 0.114 of ITU-R BT.601, in 1/256; their sum is 256, so that grey stays grey.
constexpr uint32_t kRedWeight = 77, kGreenWeight = 150, kBlueWeight = 29;

namespace plain {

// BGRA, four bytes a pixel, to grey: (77 R + 150 G + 29 B + 128) >> 8. The sum is at most 256 x 255 + 128: 16 bits.
inline void bgra_row(const uint8_t* src, uint8_t* out, int count) {
  for (int x = 0; x < count; ++x) {
    const auto blue = static_cast<uint16_t>(src[4 * x] * kBlueWeight);
    const auto green = static_cast<uint16_t>(src[4 * x + 1] * kGreenWeight);
    const auto red = static_cast<uint16_t>(src[4 * x + 2] * kRedWeight);
    out[x] = static_cast<uint8_t>(static_cast<uint16_t>(blue + green + red + 128) >> 8);
  }
}

// Columns of the FAST-10 corners in first..last of a row, ascending, into out; returns their number. The row and the
// columns are at least kFastRadius inside the image, the threshold is 0 to 254 grey levels.
inline int fast_row(const uint8_t* row, int stride, int first, int last, int threshold, int16_t* out) {
  const FastCircle circle(stride);
  int count = 0;
  for (int x = first; x <= last; ++x)
    if (is_fast_corner(row + x, circle, threshold)) out[count++] = static_cast<int16_t>(x);
  return count;
}

// out(x) = (a + b + c + d + 2) >> 2 over the 2x2 pixels at 2x of two rows: their mean, halves rounded up.
inline void half_row(const uint8_t* upper, const uint8_t* lower, uint8_t* out, int count) {
  for (int x = 0; x < count; ++x)
    out[x] = static_cast<uint8_t>((upper[2 * x] + upper[2 * x + 1] + lower[2 * x] + lower[2 * x + 1] + 2) >> 2);
}

// One component of the nine window sums, from its products at kSpan x kSpan pixels. First sums down the columns, for
// the three windows one row apart, then along the rows.
template <int kSpan>
inline void add_up_windows(const int32_t (&products)[kSpan][kSpan], int32_t StructureTensor::*component,
                           StructureTensor sums[9]) {
  constexpr int kLast = kSpan - 1;
  int32_t columns[3][kSpan];
  for (int c = 0; c < kSpan; ++c) {
    int32_t shared = 0;
    for (int r = 2; r <= kLast - 2; ++r) shared += products[r][c];
    columns[0][c] = shared + products[0][c] + products[1][c];
    columns[1][c] = shared + products[1][c] + products[kLast - 1][c];
    columns[2][c] = shared + products[kLast - 1][c] + products[kLast][c];
  }
  for (int r = 0; r < 3; ++r) {
    int32_t shared = 0;
    for (int c = 2; c <= kLast - 2; ++c) shared += columns[r][c];
    sums[3 * r].*component = shared + columns[r][0] + columns[r][1];
    sums[3 * r + 1].*component = shared + columns[r][1] + columns[r][kLast - 1];
    sums[3 * r + 2].*component = shared + columns[r][kLast - 1] + columns[r][kLast];
  }
}

// Structure tensors of nine windows of (2 kRadius + 1)^2 pixels, whose centres are px and its eight neighbours, in
// row-major order. Reads kRadius + 2 pixels to every side, and may read one more to the right.
template <int kRadius>
inline void window_sums(const uint8_t* px, int stride, StructureTensor sums[9]) {
  constexpr int kSpan = 2 * kRadius + 3;
  int32_t xx[kSpan][kSpan], xy[kSpan][kSpan], yy[kSpan][kSpan];
  for (int r = 0; r < kSpan; ++r) {
    const uint8_t* row = px + (r - kRadius - 1) * stride - kRadius - 1;
    for (int c = 0; c < kSpan; ++c) {
      const int32_t gx = row[c + 1] - row[c - 1], gy = row[c + stride] - row[c - stride];
      xx[r][c] = gx * gx;
      xy[r][c] = gx * gy;
      yy[r][c] = gy * gy;
    }
  }
  add_up_windows<kSpan>(xx, &StructureTensor::xx, sums);
  add_up_windows<kSpan>(xy, &StructureTensor::xy, sums);
  add_up_windows<kSpan>(yy, &StructureTensor::yy, sums);
}

// Linear interpolation, 256 a + (b - a) weight, with weight 0..256: in units of 1/256, between 256 a and 256 b.
inline int32_t blend(int32_t a, int32_t b, int32_t weight) {
  return (a << 8) + (b - a) * weight;
}

// Samples a framed patch, 10x10 pixels row by row, bilinearly: to 1/65536 grey level, then rounded.
// The grid is a copy, so that the compiler knows that no pixel written changes it.
inline WarpBlur warp(WarpGrid grid, uint8_t* framed) {
  WarpBlur blur;
  for (int j = 0; j < kPatchFramed; ++j) {
    int32_t x = grid.x + j * grid.dx_dj, y = grid.y + j * grid.dy_dj;
    for (int i = 0; i < kPatchFramed; ++i, x += grid.dx_di, y += grid.dy_di) {
      const int32_t x0 = std::min<int32_t>(x >> 16, grid.x_last - 1), y0 = std::min<int32_t>(y >> 16, grid.y_last - 1);
      const int32_t x_weight = (x >> 8) - x0 * 256, y_weight = (y >> 8) - y0 * 256;
      blur.x += x_weight * (256 - x_weight);
      blur.y += y_weight * (256 - y_weight);
      const uint8_t* upper_px = grid.image + y0 * grid.stride + x0;
      const uint8_t* lower_px = upper_px + grid.stride;
      const int32_t upper = blend(upper_px[0], upper_px[1], x_weight);  // at most 255 x 2^8
      const int32_t lower = blend(lower_px[0], lower_px[1], x_weight);
      *framed++ = static_cast<uint8_t>((blend(upper, lower, y_weight) + 32768) >> 16);
    }
  }
  return blur;
}

// Prepares a template for zmssd_x64(). framed: 10x10 pixels, row-major.
inline void pack_template(const uint8_t* framed, PackedTemplate* packed) {
  int32_t rows[kPatchSize] = {};
  for (int r = 0; r < kPatchSize; ++r) {
    for (int c = 0; c < kPatchSize; ++c) {
      const uint8_t value = framed[(r + 1) * kPatchFramed + c + 1];
      packed->px[r * kPatchSize + c] = value;
      rows[r] += value;
    }
  }
  packed->add_up(rows);
}

// 64 times the zero-mean sum of squared differences, 64 sum d^2 - (sum d)^2 with d = I - T over the 8x8 pixels at
// image: grey^2, at most 64^2 x 255^2 = 2.7e8. When it is not below limit, any number >= limit may be returned instead:
// the zero-mean sum of some rows is never greater than that of all rows, so most candidates are rejected after two or
// four rows. These are the middle ones, where a corner's template has most of its contrast. Where eight rows take less
// than the branches, all are summed.
inline int32_t zmssd_x64(const uint8_t* image, int stride, const PackedTemplate& patch, int32_t limit) {
  int32_t squares = 0, sum = 0;
  const auto add_two_rows = [&](int r) {  // r and the one as far from the other end
    const int other = kPatchSize - 1 - r;
    int16_t d[2 * kPatchSize];
    for (int c = 0; c < kPatchSize; ++c)
      d[c] = static_cast<int16_t>(image[r * stride + c] - patch.px[r * kPatchSize + c]);
    for (int c = 0; c < kPatchSize; ++c)
      d[c + kPatchSize] = static_cast<int16_t>(image[other * stride + c] - patch.px[other * kPatchSize + c]);
    for (int c = 0; c < 2 * kPatchSize; ++c) squares += d[c] * d[c];
    for (int c = 0; c < 2 * kPatchSize; ++c) sum += d[c];
  };
  add_two_rows(3);
  const int32_t after_2 = 4 * (16 * squares - sum * sum);
  if (after_2 >= limit) return after_2;
  add_two_rows(2);
  const int32_t after_4 = 2 * (32 * squares - sum * sum);
  if (after_4 >= limit) return after_4;
  add_two_rows(1);
  add_two_rows(0);
  return 64 * squares - sum * sum;
}

// zmssd_x64() at image and the three positions to the right of it. False, with out left as it is, when none is below
// limit, which some rows may show already. Only where kFourAtOnce: elsewhere one after the other takes less.
constexpr bool kFourAtOnce = false;
inline bool zmssd_x64_of_four(const uint8_t* image, int stride, const PackedTemplate& patch, int32_t limit,
                              int32_t out[4]) {
  int32_t all[4];
  bool below = false;
  for (int i = 0; i < 4; ++i) {
    all[i] = zmssd_x64(image + i, stride, patch, limit);
    below = below || all[i] < limit;
  }
  if (below) std::copy_n(all, 4, out);
  return below;
}

// Prepares a template for refine_sums(). framed: 10x10 pixels, row-major.
inline void prepare_refinement(const uint8_t* framed, RefineTemplate* prepared) {
  for (int r = 0; r < kPatchFramed; ++r)
    for (int c = 0; c < kPatchFramed; ++c)
      prepared->value[r * kPatchPitch + c] = static_cast<int16_t>(kSampleUnit * framed[r * kPatchFramed + c]);
  for (int r = 0; r < kPatchSize; ++r) {
    const int16_t* T = prepared->value + (r + 1) * kPatchPitch + 1;
    int16_t* curvature = prepared->curvature + 2 * r * kPatchSize;
    for (int c = 0; c < kPatchSize; ++c) {
      curvature[2 * c] = static_cast<int16_t>(T[c - 1] - 2 * T[c] + T[c + 1]);
      curvature[2 * c + 1] = static_cast<int16_t>(T[c - kPatchPitch] - 2 * T[c] + T[c + kPatchPitch]);
    }
  }
}

// One step of ESM [ptam 5.3, phone 4]: samples the framed patch from the image and makes the sums. Sampling is
// bilinear, rounded down to 1/8 grey level along each axis; the bias of that is removed with the mean offset. Sampling
// blurs the image: the template is blurred by the difference, T + (x_blur T_xx + y_blur T_yy) / 2.
inline RefineSums refine_sums(const RefineSample& s, const RefineTemplate& T) {
  int16_t across[(kPatchFramed + 1) * kPatchPitch];  // interpolated along x, at most 32 x 255 / 4 = 2040
  for (int r = 0; r <= kPatchFramed; ++r) {
    const uint8_t* px = s.image + r * s.stride;
    for (int c = 0; c < kPatchFramed; ++c)
      across[r * kPatchPitch + c] =
          static_cast<int16_t>((px[c] * (kSubpixels - s.x_weight) + px[c + 1] * s.x_weight) >> 2);
  }
  int16_t both[kPatchFramed * kPatchPitch];  // I + T
  for (int r = 0; r < kPatchFramed; ++r) {
    const int16_t* upper = across + r * kPatchPitch;
    const int16_t* lower = upper + kPatchPitch;
    for (int c = 0; c < kPatchFramed; ++c) {
      const int32_t I = (upper[c] * (kSubpixels - s.y_weight) + lower[c] * s.y_weight) >> 5;
      both[r * kPatchPitch + c] = static_cast<int16_t>(I + T.value[r * kPatchPitch + c]);
    }
  }
  int16_t jx[kPatchSize * kPatchSize], jy[kPatchSize * kPatchSize], e[kPatchSize * kPatchSize];
  for (int r = 0; r < kPatchSize; ++r) {
    const int16_t* b = both + (r + 1) * kPatchPitch + 1;
    const int16_t* t = T.value + (r + 1) * kPatchPitch + 1;
    const int16_t* k = T.curvature + 2 * r * kPatchSize;
    for (int c = 0; c < kPatchSize; ++c) {
      const int i = r * kPatchSize + c;
      jx[i] = static_cast<int16_t>(b[c + 1] - b[c - 1]);
      jy[i] = static_cast<int16_t>(b[c + kPatchPitch] - b[c - kPatchPitch]);
      const int32_t blur = (k[2 * c] * s.x_blur + k[2 * c + 1] * s.y_blur + (1 << 16)) >> 17;
      e[i] = static_cast<int16_t>(2 * t[c] - b[c] + blur);
    }
  }
  RefineSums sums;
  for (int i = 0; i < kPatchSize * kPatchSize; ++i) {
    sums.xx += jx[i] * jx[i];
    sums.xy += jx[i] * jy[i];
    sums.yy += jy[i] * jy[i];
    sums.xe += jx[i] * e[i];
    sums.ye += jy[i] * e[i];
    sums.ee += e[i] * e[i];
    sums.x += jx[i];
    sums.y += jy[i];
    sums.e += e[i];
  }
  return sums;
}

}  // namespace plain
}  // namespace pptam

// With PPTAM_PLAIN the loops above are all there is, on every processor: to compare with.
#if defined(PPTAM_PLAIN)
namespace pptam {
namespace kernel = plain;
}
#elif defined(PPTAM_WORDS)
#include "image/kernels_words.h"
namespace pptam {
namespace kernel = words;
}
#else
#if defined(__ARM_FEATURE_SIMD32)
#include "image/kernels_armv6.h"
#endif
#if defined(__ARM_NEON)
#include "image/kernels_neon.h"
#elif defined(PPTAM_SSE2)
#include "image/kernels_sse2.h"
#endif

namespace pptam {
#if defined(__ARM_NEON)
namespace kernel {  // compilers vectorise the other plain loops well
using neon::refine_sums;
using neon::warp;
using plain::bgra_row;
using plain::fast_row;
using plain::half_row;
using plain::kFourAtOnce;
using plain::pack_template;
using plain::prepare_refinement;
using plain::zmssd_x64;
using plain::zmssd_x64_of_four;
#if defined(__ARM_FEATURE_SIMD32)
using armv6::window_sums;
#else
using plain::window_sums;
#endif
}  // namespace kernel
#elif defined(__ARM_FEATURE_SIMD32)
namespace kernel = armv6;
#elif defined(PPTAM_SSE2)
namespace kernel = sse2;
#else
namespace kernel = plain;
#endif
}  // namespace pptam
#endif
