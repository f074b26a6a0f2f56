// The kernels for WebAssembly without vectors: numbers side by side in words of 64 bits, which every function here
// treats alike, as lanes of 16 or of 32 bits. The results have the same bits as the plain ones.
//
// Sums and differences of words are those of their lanes wherever each lane's result is at least 0 and fits: what one
// lane borrows or carries on the way cancels. Products of two: with Y = 2^32
//
//   (a0 + a1 Y) (b1 + b0 Y) = a0 b1 + (a0 b0 + a1 b1) Y   mod Y^2
//
// so that the upper half of a sum of such products is a scalar product, as long as the lower half is under 2^32.
#pragma once

#include <bit>
#include <cstring>

#include "image/kernels.h"

namespace pptam::words {

static_assert(std::endian::native == std::endian::little, "lanes are read from memory as little-endian words");

using plain::bgra_row;
using plain::fast_row;
using plain::kFourAtOnce;
using plain::window_sums;
using plain::zmssd_x64_of_four;

constexpr uint64_t kLow8 = 0x00ff00ff00ff00ff, kLow16 = 0x0000ffff0000ffff;  // of each 16 bits, of each 32
constexpr uint64_t kInEach16 = 0x0001000100010001;                           // times it: a number in each lane

inline uint64_t load_word(const void* from) {
  uint64_t word;
  std::memcpy(&word, from, sizeof word);
  return word;
}
inline void store_word(void* to, uint64_t word) {
  std::memcpy(to, &word, sizeof word);
}
inline uint64_t even_bytes(uint64_t word) {
  return word & kLow8;
}
inline uint64_t odd_bytes(uint64_t word) {
  return word >> 8 & kLow8;
}
inline uint64_t load_two(const uint8_t* px) {
  uint16_t two;
  std::memcpy(&two, px, sizeof two);
  return two;
}

// Lanes of 16 bits split into those of even and of odd number, which have 32 each; and their scalar products.
struct Lanes {
  uint64_t even, odd;
  explicit Lanes(uint64_t word) : even(word & kLow16), odd(word >> 16 & kLow16) {}
  Lanes swapped() const {
    Lanes other = *this;
    other.even = std::rotl(even, 32);
    other.odd = std::rotl(odd, 32);
    return other;
  }
  uint64_t times(const Lanes& swapped) const { return even * swapped.even + odd * swapped.odd; }
  uint32_t sum() const {
    const uint64_t two = even + odd;
    return static_cast<uint32_t>(two + (two >> 32));
  }
};

inline void half_row(const uint8_t* upper, const uint8_t* lower, uint8_t* out, int count) {
  const auto four_means = [&](int x) {  // as four bytes
    const uint64_t a = load_word(upper + 2 * x), b = load_word(lower + 2 * x);
    const uint64_t sums = even_bytes(a) + odd_bytes(a) + even_bytes(b) + odd_bytes(b) + 2 * kInEach16;
    const uint64_t means = sums >> 2 & kLow8, both = means | means >> 8;
    return (both & 0xffff) | (both >> 16 & 0xffff0000);
  };
  int x = 0;
  for (; x + 8 <= count; x += 8) store_word(out + x, four_means(x) | four_means(x + 4) << 32);
  plain::half_row(upper + 2 * x, lower + 2 * x, out + x, count - x);
}

// The two rows of a sample side by side. A lane holds at most 255 x 256 after the blend along x.
inline WarpBlur warp(WarpGrid grid, uint8_t* framed) {
  if (touches_last(grid)) return plain::warp(grid, framed);
  constexpr uint64_t kByte = 0x000000ff000000ff, kRounding = uint64_t{32768} << 32;
  WarpBlur blur;
  for (int j = 0; j < kPatchFramed; ++j) {
    int32_t x = grid.x + j * grid.dx_dj, y = grid.y + j * grid.dy_dj;
    for (int i = 0; i < kPatchFramed; ++i, x += grid.dx_di, y += grid.dy_di) {
      const int32_t x_weight = x >> 8 & 255, x_rest = 256 - x_weight, y_weight = y >> 8 & 255, y_rest = 256 - y_weight;
      blur.x += x_weight * x_rest;
      blur.y += y_weight * y_rest;
      const uint8_t* px = grid.image + (y >> 16) * grid.stride + (x >> 16);
      const uint64_t two = load_two(px) | load_two(px + grid.stride) << 32;
      const uint64_t across =
          (two & kByte) * static_cast<uint64_t>(x_rest) + (two >> 8 & kByte) * static_cast<uint64_t>(x_weight);
      const uint64_t down = static_cast<uint64_t>(y_weight) | static_cast<uint64_t>(y_rest) << 32;
      *framed++ = static_cast<uint8_t>((across * down + kRounding) >> 48);
    }
  }
  return blur;
}

// Of each row a word of the even pixels and one of the odd ones: 256 - T.
inline void pack_template(const uint8_t* framed, PackedTemplate* packed) {
  for (int r = 0; r < kPatchSize; ++r) {
    const uint64_t row = load_word(framed + (r + 1) * kPatchFramed + 1);
    store_word(packed->px + r * kPatchSize, 256 * kInEach16 - even_bytes(row));
    store_word(packed->px + r * kPatchSize + 4, 256 * kInEach16 - odd_bytes(row));
  }
}

// Of d + 256 in place of d = I - T: the mean does not matter. At most 511, and their sum 64 x 511 < 2^15.
inline int32_t zmssd_x64(const uint8_t* image, int stride, const PackedTemplate& patch, int32_t limit) {
  uint64_t all_squares = 0, sums = 0;
  const auto add_four = [&](uint64_t I, const int16_t* T) {
    const uint64_t d = I + load_word(T);
    const Lanes lanes(d);
    sums += d;
    all_squares += lanes.times(lanes.swapped());
  };
  const auto add_two_rows = [&](int r) {  // r and the one as far from the other end
    for (const int row : {r, kPatchSize - 1 - r}) {
      const uint64_t I = load_word(image + row * stride);
      add_four(even_bytes(I), patch.px + row * kPatchSize);
      add_four(odd_bytes(I), patch.px + row * kPatchSize + 4);
    }
  };
  const auto zero_mean = [&](int32_t count) {
    const auto squares = static_cast<int32_t>(all_squares >> 32);
    const auto sum = static_cast<int32_t>(sums * kInEach16 >> 48);
    return kPatchSize * kPatchSize / count * (count * squares - sum * sum);
  };
  add_two_rows(3);
  const int32_t after_2 = zero_mean(2 * kPatchSize);
  if (after_2 >= limit) return after_2;
  add_two_rows(2);
  const int32_t after_4 = zero_mean(4 * kPatchSize);
  if (after_4 >= limit) return after_4;
  add_two_rows(1);
  add_two_rows(0);
  return zero_mean(8 * kPatchSize);
}

// A framed row's columns are kept as the even ones, 0 to 8, and kOddColumns further the odd ones, 1 to 9.
constexpr int kOddColumns = kPatchPitch / 2;

// Curvatures as T_xx + T_yy 2^32, of a row's odd columns first, then of its even ones: the order of refine_sums().
inline void prepare_refinement(const uint8_t* framed, RefineTemplate* prepared) {
  static_assert(sizeof prepared->curvature == 8 * kPatchSize * kPatchSize);
  for (int r = 0; r < kPatchFramed; ++r)
    for (int c = 0; c < kPatchFramed; ++c)
      prepared->value[r * kPatchPitch + c / 2 + c % 2 * kOddColumns] =
          static_cast<int16_t>(kSampleUnit * framed[r * kPatchFramed + c]);
  int16_t* out = prepared->curvature;
  for (int r = 1; r <= kPatchSize; ++r) {
    for (int i = 0; i < kPatchSize; ++i, out += 4) {
      const uint8_t* T = framed + r * kPatchFramed + (i < 4 ? 2 * i + 1 : 2 * i - 6);
      const int64_t xx = kSampleUnit * (T[-1] - 2 * T[0] + T[1]);
      const int64_t yy = kSampleUnit * (T[-kPatchFramed] - 2 * T[0] + T[kPatchFramed]);
      store_word(out, static_cast<uint64_t>(xx + yy * (int64_t{1} << 32)));
    }
  }
}

// A framed row as words of four columns: 0 to 6, 2 to 8, 1 to 7 and 3 to 9, every other one.
struct FramedRow {
  uint64_t even, even_right, odd, odd_right;
};

// Sums over the lanes of j + kBias and e + kBias, which are 16 to 8176: their products' sums are at most 64 x 8176^2
// < 2^32.
class RefineAccumulator {
 public:
  static constexpr int64_t kBias = 4096;
  void add(uint64_t jx, uint64_t jy, uint64_t e) {
    x_ += jx, y_ += jy, e_ += e;
    const Lanes x_lanes(jx), y_lanes(jy), e_lanes(e), x_swapped = x_lanes.swapped(), y_swapped = y_lanes.swapped();
    xx_ += x_lanes.times(x_swapped);
    xy_ += x_lanes.times(y_swapped);
    yy_ += y_lanes.times(y_swapped);
    xe_ += e_lanes.times(x_swapped);
    ye_ += e_lanes.times(y_swapped);
    ee_ += e_lanes.times(e_lanes.swapped());
  }
  // After at most eight words, before a lane of the sums is full.
  void empty_lanes() {
    x_sum_ += Lanes(x_).sum(), y_sum_ += Lanes(y_).sum(), e_sum_ += Lanes(e_).sum();
    x_ = y_ = e_ = 0;
  }
  RefineSums sums() const {
    constexpr int64_t kCount = kPatchSize * kPatchSize;
    const auto product = [](uint64_t biased, int64_t a_sum, int64_t b_sum) {
      return static_cast<int32_t>(static_cast<int64_t>(biased >> 32) - kBias * (a_sum + b_sum) +
                                  kCount * kBias * kBias);
    };
    const auto sum = [](int64_t biased) { return static_cast<int32_t>(biased - kCount * kBias); };
    return {.xx = product(xx_, x_sum_, x_sum_),
            .xy = product(xy_, x_sum_, y_sum_),
            .yy = product(yy_, y_sum_, y_sum_),
            .xe = product(xe_, x_sum_, e_sum_),
            .ye = product(ye_, y_sum_, e_sum_),
            .ee = product(ee_, e_sum_, e_sum_),
            .x = sum(x_sum_),
            .y = sum(y_sum_),
            .e = sum(e_sum_)};
  }

 private:
  uint64_t xx_ = 0, xy_ = 0, yy_ = 0, xe_ = 0, ye_ = 0, ee_ = 0;
  uint64_t x_ = 0, y_ = 0, e_ = 0;
  int64_t x_sum_ = 0, y_sum_ = 0, e_sum_ = 0;
};

inline RefineSums refine_sums(const RefineSample& s, const RefineTemplate& T) {
  constexpr uint64_t kLow11 = 0x7ff * kInEach16;
  const auto left = static_cast<uint64_t>(kSubpixels - s.x_weight), right = static_cast<uint64_t>(s.x_weight);
  const auto up = static_cast<uint64_t>(kSubpixels - s.y_weight), down = static_cast<uint64_t>(s.y_weight);
  // Interpolated along x: at most 32 x 255 / 4 = 2040.
  const auto across = [&](int r) {
    const uint8_t* px = s.image + r * s.stride;
    const uint64_t from_0 = load_word(px), from_2 = load_word(px + 2), from_3 = load_word(px + 3);
    const uint64_t px_0 = even_bytes(from_0), px_1 = odd_bytes(from_0);  // and every other one to the right
    const uint64_t px_2 = even_bytes(from_2), px_3 = odd_bytes(from_2), px_4 = odd_bytes(from_3);
    const auto between = [&](uint64_t a, uint64_t b) { return (a * left + b * right) >> 2 & kLow11; };
    return FramedRow{between(px_0, px_1), between(px_2, px_3), between(px_1, px_2), between(px_3, px_4)};
  };
  FramedRow above = across(0);
  // I + T. Along y a lane holds at most 32 x 2040 < 2^16.
  const auto next_row = [&](int r) {
    const FramedRow below = across(r + 1);
    const auto between = [&](uint64_t a, uint64_t b, const int16_t* t) {
      return ((a * up + b * down) >> 5 & kLow11) + load_word(t);
    };
    const int16_t *even = T.value + r * kPatchPitch, *odd = even + kOddColumns;
    const FramedRow both{between(above.even, below.even, even), between(above.even_right, below.even_right, even + 1),
                         between(above.odd, below.odd, odd), between(above.odd_right, below.odd_right, odd + 1)};
    above = below;
    return both;
  };
  const uint64_t blur_weights = static_cast<uint64_t>(s.y_blur + s.x_blur * (int64_t{1} << 32));
  const auto blur = [&](const int16_t* four) {
    const auto of = [&](int i) {  // of the product's upper half, rounded, in 2^-17; its lower half is within 2^31
      constexpr int64_t kHalf = (int64_t{1} << 48) + (int64_t{1} << 31);
      return static_cast<uint64_t>((static_cast<int64_t>(load_word(four + 4 * i) * blur_weights) + kHalf) >> 49);
    };
    return of(0) + (of(1) << 16) + (of(2) << 32) + (of(3) << 48);
  };
  constexpr uint64_t kBias = RefineAccumulator::kBias * kInEach16;
  RefineAccumulator sums;
  FramedRow upper = next_row(0), row = next_row(1);
  const int16_t* curvature = T.curvature;
  for (int r = 1; r <= kPatchSize; ++r, curvature += 4 * kPatchSize) {
    const FramedRow below = next_row(r + 1);
    const int16_t *t_even = T.value + r * kPatchPitch + 1, *t_odd = T.value + r * kPatchPitch + kOddColumns;
    sums.add(row.even_right - row.even + kBias, below.odd - upper.odd + kBias,
             2 * load_word(t_odd) - row.odd + kBias + blur(curvature));
    sums.add(row.odd_right - row.odd + kBias, below.even_right - upper.even_right + kBias,
             2 * load_word(t_even) - row.even_right + kBias + blur(curvature + 16));
    if (r % 4 == 0) sums.empty_lanes();
    upper = row;
    row = below;
  }
  return sums.sums();
}

}  // namespace pptam::words
