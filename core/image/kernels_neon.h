// Patch warp and refinement for NEON, 32 and 64 bits, where compilers do not vectorise the plain ones, or not as well.
// The results have the same bits.
#pragma once

#include <arm_neon.h>

#include <cstring>

#include "image/kernels.h"

namespace pptam::neon {

inline int32_t sum_of_four(int32x4_t v) {
  const int32x2_t two = vadd_s32(vget_low_s32(v), vget_high_s32(v));
  return vget_lane_s32(vpadd_s32(two, two), 0);
}

// Four samples at a time. A 16-bit lane holds at most 255 x 256 after the blend along x.
inline WarpBlur warp(WarpGrid grid, uint8_t* framed) {
  constexpr int kSamples = kPatchFramed * 2;  // two rows are five fours
  if (touches_last(grid)) return plain::warp(grid, framed);
  // Positions of two rows; the next two are twice the step between rows further.
  int32_t x_at[kSamples], y_at[kSamples];
  for (int j = 0; j < 2; ++j) {
    for (int i = 0; i < kPatchFramed; ++i) {
      x_at[j * kPatchFramed + i] = grid.x + j * grid.dx_dj + i * grid.dx_di;
      y_at[j * kPatchFramed + i] = grid.y + j * grid.dy_dj + i * grid.dy_di;
    }
  }
  const int32x4_t x_step = vdupq_n_s32(2 * grid.dx_dj), y_step = vdupq_n_s32(2 * grid.dy_dj);
  const uint16x4_t whole = vdup_n_u16(256), byte = vdup_n_u16(255);
  uint32x4_t x_blur = vdupq_n_u32(0), y_blur = vdupq_n_u32(0);
  const auto load_two = [](const uint8_t* px) {
    uint16_t two;
    std::memcpy(&two, px, sizeof two);
    return two;
  };
  for (int rows = 0; rows < kPatchFramed / 2; ++rows) {
    for (int at = 0; at < kSamples; at += 4, framed += 4) {
      const int32x4_t x = vld1q_s32(x_at + at), y = vld1q_s32(y_at + at);
      vst1q_s32(x_at + at, vaddq_s32(x, x_step));
      vst1q_s32(y_at + at, vaddq_s32(y, y_step));
      const int32x4_t offset = vmlaq_n_s32(vshrq_n_s32(x, 16), vshrq_n_s32(y, 16), grid.stride);
      const uint16x4_t x_weight = vand_u16(vreinterpret_u16_s16(vshrn_n_s32(x, 8)), byte);
      const uint16x4_t y_weight = vand_u16(vreinterpret_u16_s16(vshrn_n_s32(y, 8)), byte);
      const uint16x4_t x_rest = vsub_u16(whole, x_weight), y_rest = vsub_u16(whole, y_weight);
      x_blur = vmlal_u16(x_blur, x_weight, x_rest);
      y_blur = vmlal_u16(y_blur, y_weight, y_rest);

      const uint8_t* const px[4] = {grid.image + vgetq_lane_s32(offset, 0), grid.image + vgetq_lane_s32(offset, 1),
                                    grid.image + vgetq_lane_s32(offset, 2), grid.image + vgetq_lane_s32(offset, 3)};
      uint16x4_t upper = vdup_n_u16(load_two(px[0])), lower = vdup_n_u16(load_two(px[0] + grid.stride));
      upper = vset_lane_u16(load_two(px[1]), upper, 1);
      upper = vset_lane_u16(load_two(px[2]), upper, 2);
      upper = vset_lane_u16(load_two(px[3]), upper, 3);
      lower = vset_lane_u16(load_two(px[1] + grid.stride), lower, 1);
      lower = vset_lane_u16(load_two(px[2] + grid.stride), lower, 2);
      lower = vset_lane_u16(load_two(px[3] + grid.stride), lower, 3);
      const auto across = [&](uint16x4_t two) {
        return vmla_u16(vmul_u16(vand_u16(two, byte), x_rest), vshr_n_u16(two, 8), x_weight);
      };
      const uint16x4_t grey = vrshrn_n_u32(vmlal_u16(vmull_u16(across(upper), y_rest), across(lower), y_weight), 16);
      const uint32_t four_px = vget_lane_u32(vreinterpret_u32_u8(vmovn_u16(vcombine_u16(grey, grey))), 0);
      std::memcpy(framed, &four_px, sizeof four_px);
    }
  }
  return {sum_of_four(vreinterpretq_s32_u32(x_blur)), sum_of_four(vreinterpretq_s32_u32(y_blur))};
}

// A row of a framed patch in two vectors, of its columns 0 to 7 and 2 to 9.
struct FramedRow {
  uint16x8_t left, right;
};

inline RefineSums refine_sums(const RefineSample& s, const RefineTemplate& T) {
  const auto x_weight = static_cast<uint8_t>(s.x_weight), y_weight = static_cast<uint8_t>(s.y_weight);
  const uint8x8_t to_right = vdup_n_u8(x_weight), to_left = vdup_n_u8(static_cast<uint8_t>(kSubpixels - s.x_weight));
  const uint16x8_t down = vdupq_n_u16(y_weight), up = vdupq_n_u16(static_cast<uint16_t>(kSubpixels - s.y_weight));
  // Interpolated along x: at most 32 x 255 / 4 = 2040.
  const auto across = [&](int r) {
    const uint8_t* px = s.image + r * s.stride;
    const auto eight = [&](int c) {
      return vshrq_n_u16(vmlal_u8(vmull_u8(vld1_u8(px + c), to_left), vld1_u8(px + c + 1), to_right), 2);
    };
    return FramedRow{eight(0), eight(2)};
  };
  FramedRow above = across(0);
  // I + T. Along y a lane holds at most 32 x 2040 < 2^16.
  const auto next_row = [&](int r) {
    const FramedRow below = across(r + 1);
    const auto with_template = [&](uint16x8_t a, uint16x8_t b, const int16_t* t) {
      const uint16x8_t I = vshrq_n_u16(vmlaq_u16(vmulq_u16(a, up), b, down), 5);
      return vaddq_u16(I, vreinterpretq_u16_s16(vld1q_s16(t)));
    };
    const int16_t* t = T.value + r * kPatchPitch;
    const FramedRow both{with_template(above.left, below.left, t), with_template(above.right, below.right, t + 2)};
    above = below;
    return both;
  };
  const auto middle = [](const FramedRow& row) {  // columns 1 to 8
    return vextq_u16(row.left, vextq_u16(row.right, row.right, 6), 1);
  };
  const auto difference = [](uint16x8_t a, uint16x8_t b) { return vreinterpretq_s16_u16(vsubq_u16(a, b)); };
  const auto add_products = [](int16x8_t a, int16x8_t b, int32x4_t* sum) {
    *sum = vmlal_s16(vmlal_s16(*sum, vget_low_s16(a), vget_low_s16(b)), vget_high_s16(a), vget_high_s16(b));
  };
  const int16x4_t x_blur = vdup_n_s16(static_cast<int16_t>(s.x_blur));
  const int16x4_t y_blur = vdup_n_s16(static_cast<int16_t>(s.y_blur));
  int32x4_t xx = vdupq_n_s32(0), xy = xx, yy = xx, xe = xx, ye = xx, ee = xx;
  int16x8_t x = vdupq_n_s16(0), y = x, e_sum = x;  // of eight rows of at most 4080: under 2^15
  uint16x8_t upper = middle(next_row(0));
  FramedRow row = next_row(1);
  for (int r = 1; r <= kPatchSize; ++r) {
    const FramedRow below = next_row(r + 1);
    const uint16x8_t here = middle(row), lower = middle(below);
    const int16x8_t jx = difference(row.right, row.left), jy = difference(lower, upper);
    const uint16x8_t t = vreinterpretq_u16_s16(vld1q_s16(T.value + r * kPatchPitch + 1));
    const int16x8x2_t k = vld2q_s16(T.curvature + 2 * (r - 1) * kPatchSize);
    const auto blurred = [&](int16x4_t k_xx, int16x4_t k_yy) {
      return vmovn_s32(vrshrq_n_s32(vmlal_s16(vmull_s16(k_xx, x_blur), k_yy, y_blur), 17));
    };
    const int16x8_t blur = vcombine_s16(blurred(vget_low_s16(k.val[0]), vget_low_s16(k.val[1])),
                                        blurred(vget_high_s16(k.val[0]), vget_high_s16(k.val[1])));
    const int16x8_t e = vaddq_s16(difference(vshlq_n_u16(t, 1), here), blur);
    add_products(jx, jx, &xx);
    add_products(jx, jy, &xy);
    add_products(jy, jy, &yy);
    add_products(jx, e, &xe);
    add_products(jy, e, &ye);
    add_products(e, e, &ee);
    x = vaddq_s16(x, jx);
    y = vaddq_s16(y, jy);
    e_sum = vaddq_s16(e_sum, e);
    upper = here;
    row = below;
  }
  const auto sum = [](int16x8_t v) { return sum_of_four(vpaddlq_s16(v)); };
  return {.xx = sum_of_four(xx),
          .xy = sum_of_four(xy),
          .yy = sum_of_four(yy),
          .xe = sum_of_four(xe),
          .ye = sum_of_four(ye),
          .ee = sum_of_four(ee),
          .x = sum(x),
          .y = sum(y),
          .e = sum(e_sum)};
}

}  // namespace pptam::neon
