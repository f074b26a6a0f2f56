#include "image/patch.h"

#include <algorithm>
#include <cmath>

#include "base/status.h"

namespace pptam {
namespace {

constexpr int kPixels = kPatchSize * kPatchSize;
constexpr int32_t kMaxSquares = kPixels * 255 * 255;  // 4.2e6: any sum of squared differences over a patch

constexpr float kMaxBlur = 32768.0f;  // of a patch magnified three times; bounds the refinement's integers

// 256 a + (b - a) weight: linear interpolation with weight 0..256, in units of 1/256. Lies between 256 a and 256 b.
inline int32_t blend(int32_t a, int32_t b, int32_t weight) {
  return (a << 8) + (b - a) * weight;
}

// 4096 times the variance of 64 numbers, from their sum and sum of squares. For pixels both terms are at most
// 64^2 x 255^2 = 2.7e8.
inline int32_t variance_x4096(int32_t sum, int32_t sum_sq) {
  return kPixels * sum_sq - sum * sum;
}

}  // namespace

bool warp_patch(const GreyView& source, const Eigen::Vector2f& centre, const Eigen::Matrix2f& J_src_tpl,
                PatchTemplate* out) {
  // 16.16 positions: up to 16384 px of image and 4.5 x 2 x 64 px of patch, together below 2^15.
  constexpr int kMaxSize = 16384;
  constexpr float kMaxStep = 64.0f;
  constexpr float kOne = 65536.0f;
  constexpr int kLast = kPatchFramed - 1;
  PPTAM_ASSERT(source.width <= kMaxSize && source.height <= kMaxSize);
  if (source.width < 2 || source.height < 2) return false;
  if (!(J_src_tpl.array().abs() < kMaxStep).all()) return false;  // NaN too
  if (!(centre.x() >= 0 && centre.y() >= 0 && centre.x() < source.width && centre.y() < source.height)) return false;
  const auto dx_di = static_cast<int32_t>(J_src_tpl(0, 0) * kOne);
  const auto dx_dj = static_cast<int32_t>(J_src_tpl(0, 1) * kOne);
  const auto dy_di = static_cast<int32_t>(J_src_tpl(1, 0) * kOne);
  const auto dy_dj = static_cast<int32_t>(J_src_tpl(1, 1) * kOne);
  const int32_t x_start = static_cast<int32_t>(centre.x() * kOne) - (dx_di + dx_dj) * kLast / 2;
  const int32_t y_start = static_cast<int32_t>(centre.y() * kOne) - (dy_di + dy_dj) * kLast / 2;

  // An affine grid lies inside the image when its corners do.
  const auto inside = [](int32_t start, int32_t di, int32_t dj, int size) {
    const int32_t low = start + kLast * (std::min(di, 0) + std::min(dj, 0));
    const int32_t high = start + kLast * (std::max(di, 0) + std::max(dj, 0));
    return low >= 0 && high <= (size - 1) * 65536;
  };
  if (!inside(x_start, dx_di, dx_dj, source.width) || !inside(y_start, dy_di, dy_dj, source.height)) return false;

  int32_t x_blur = 0, y_blur = 0;  // at most 100 x 2^14
  for (int j = 0; j < kPatchFramed; ++j) {
    int32_t x = x_start + j * dx_dj;
    int32_t y = y_start + j * dy_dj;
    for (int i = 0; i < kPatchFramed; ++i, x += dx_di, y += dy_di) {
      // On the last column or row the 2x2 starts one earlier, with weight 256.
      const int32_t x0 = std::min(x >> 16, source.width - 2);
      const int32_t y0 = std::min(y >> 16, source.height - 2);
      const int32_t x_weight = (x - x0 * 65536 + 128) >> 8;
      const int32_t y_weight = (y - y0 * 65536 + 128) >> 8;
      x_blur += x_weight * (256 - x_weight);
      y_blur += y_weight * (256 - y_weight);
      const uint8_t* px = source.row(y0) + x0;
      const int32_t upper = blend(px[0], px[1], x_weight);  // at most 255 x 2^8
      const int32_t lower = blend(px[source.stride], px[source.stride + 1], x_weight);
      out->px[j * kPatchFramed + i] = static_cast<uint8_t>((blend(upper, lower, y_weight) + 32768) >> 16);
    }
  }
  // From second derivatives along the source's axes to the template's: with K = J_src_tpl^-1, S_xx has K_00^2 T_xx and
  // K_10^2 T_yy. The mixed terms of both axes nearly cancel.
  const float determinant = J_src_tpl(0, 0) * J_src_tpl(1, 1) - J_src_tpl(0, 1) * J_src_tpl(1, 0);
  const float scale = 1.0f / (kPatchFramed * kPatchFramed * std::max(determinant * determinant, 1.0f / 64));
  const auto in_template = [&](float K_x, float K_y) {
    const float blur = scale * (static_cast<float>(x_blur) * K_x * K_x + static_cast<float>(y_blur) * K_y * K_y);
    return static_cast<int32_t>(std::min(blur, kMaxBlur));
  };
  out->x_blur = in_template(J_src_tpl(1, 1), J_src_tpl(0, 1));
  out->y_blur = in_template(J_src_tpl(1, 0), J_src_tpl(0, 0));
  out->sum = 0;
  out->sum_sq = 0;
  for (int r = 1; r <= kPatchSize; ++r) {
    for (int c = 1; c <= kPatchSize; ++c) {
      const int32_t value = out->px[r * kPatchFramed + c];
      out->sum += value;
      out->sum_sq += value * value;
    }
  }
  return true;
}

bool search_patch(const GreyView& image, const PatchTemplate& patch, const Eigen::Vector2f& predicted, float radius,
                  int32_t max_zmssd, PatchHit* hit) {
  hit->candidates = 0;
  if (!(radius >= 0) || !(predicted.array().abs() < 32768.0f).all()) return false;
  radius = std::min(radius, kMaxSearchRadius);
  const float left = predicted.x() - kPatchCentre;  // the top-left pixel that would be exactly as predicted
  const float top = predicted.y() - kPatchCentre;
  const int x_first = std::max(0, static_cast<int>(std::ceil(left - radius)));
  const int y_first = std::max(0, static_cast<int>(std::ceil(top - radius)));
  const int x_last = std::min(image.width - kPatchSize, static_cast<int>(std::floor(left + radius)));
  const int y_last = std::min(image.height - kPatchSize, static_cast<int>(std::floor(top + radius)));
  if (x_first > x_last || y_first > y_last) return false;

  // Sums of I and I^2 over the 8 rows of every column of the window, updated from one row of candidates to the next.
  constexpr int kMaxColumns = 2 * static_cast<int>(kMaxSearchRadius) + kPatchSize;
  int32_t column_sum[kMaxColumns] = {};
  int32_t column_sq[kMaxColumns] = {};
  const int columns = x_last - x_first + kPatchSize;
  PPTAM_ASSERT(columns <= kMaxColumns);
  const auto add_row = [&](int y) {
    const uint8_t* px = image.row(y) + x_first;
    for (int i = 0; i < columns; ++i) {
      column_sum[i] += px[i];
      column_sq[i] += px[i] * px[i];
    }
  };
  const auto remove_row = [&](int y) {
    const uint8_t* px = image.row(y) + x_first;
    for (int i = 0; i < columns; ++i) {
      column_sum[i] -= px[i];
      column_sq[i] -= px[i] * px[i];
    }
  };

  const int32_t T_energy = variance_x4096(patch.sum, patch.sum_sq);
  const int32_t initial = std::min(max_zmssd, kMaxSquares) + 1;
  int32_t best = initial;
  for (int y = y_first; y < y_first + kPatchSize - 1; ++y) add_row(y);
  for (int y = y_first; y <= y_last; ++y) {
    add_row(y + kPatchSize - 1);
    const float dy = static_cast<float>(y) - top;
    int32_t sum = 0, sum_sq = 0;
    for (int i = 0; i < kPatchSize - 1; ++i) {
      sum += column_sum[i];
      sum_sq += column_sq[i];
    }
    for (int x = x_first; x <= x_last; ++x) {
      const int i = x - x_first;
      sum += column_sum[i + kPatchSize - 1];
      sum_sq += column_sq[i + kPatchSize - 1];
      const int32_t S_I = sum, S_II = sum_sq;
      sum -= column_sum[i];
      sum_sq -= column_sq[i];
      const float dx = static_cast<float>(x) - left;
      if (dx * dx + dy * dy > radius * radius) continue;
      ++hit->candidates;

      // By Cauchy-Schwarz ZMSSD >= (sqrt(E_I) - sqrt(E_T))^2, E the zero-mean energies: when that already reaches the
      // best, which is so if E_I + E_T - best >= 2 sqrt(E_I E_T), the 64 multiplications are spared. All times 64:
      // terms are below 2^29, products below 2^58.
      const int32_t I_energy = variance_x4096(S_I, S_II);
      const int64_t excess = static_cast<int64_t>(I_energy) + T_energy - kPixels * static_cast<int64_t>(best);
      if (excess >= 0 && excess * excess >= 4 * static_cast<int64_t>(I_energy) * T_energy) continue;

      int32_t S_IT = 0;
      const uint8_t* I = image.row(y) + x;
      const uint8_t* T = patch.px + kPatchFramed + 1;
      for (int r = 0; r < kPatchSize; ++r, I += image.stride, T += kPatchFramed)
        S_IT += I[0] * T[0] + I[1] * T[1] + I[2] * T[2] + I[3] * T[3] + I[4] * T[4] + I[5] * T[5] + I[6] * T[6] +
                I[7] * T[7];
      // 64 ZMSSD = 64 sum (I - T)^2 - (S_I - S_T)^2, both at most 64^2 x 255^2 = 2.7e8, the difference not negative.
      const int32_t difference = S_I - patch.sum;
      const int32_t zmssd = (kPixels * (S_II + patch.sum_sq - 2 * S_IT) - difference * difference) >> 6;
      if (zmssd < best) {
        best = zmssd;
        hit->x = x;
        hit->y = y;
        hit->zmssd = zmssd;
      }
    }
    remove_row(y);
  }
  return best < initial;
}

bool refine_patch(const GreyView& image, const PatchTemplate& patch, const Eigen::Vector2f& start, int max_steps,
                  RefinedPatch* refined) {
  constexpr float kMaxDrift = 1.5f;            // px: further than a wrong neighbour, it is another structure
  constexpr float kConverged = 0.03f;          // px
  constexpr float kMinConditioning = 1e-3f;    // det / trace^2: along an edge 30 times less certain than across
  constexpr int32_t kUnit = 8;                 // image samples are kept in 1/8 grey level
  constexpr float kOffset = kPatchCentre + 1;  // from the framed patch's top-left pixel to the reference point
  constexpr int kSpan = kPatchFramed + 1;      // pixels needed to interpolate kPatchFramed samples

  if (image.width < kSpan || image.height < kSpan) return false;
  Eigen::Vector2f position = start;
  refined->steps = 0;
  while (refined->steps < max_steps) {
    // Sampled at multiples of 1/256 px; the step is taken from there, so that nothing is lost by it.
    const Eigen::Vector2f corner = position - Eigen::Vector2f::Constant(kOffset);
    if (!(corner.x() >= 0 && corner.y() >= 0 && corner.x() <= image.width - kPatchFramed &&
          corner.y() <= image.height - kPatchFramed))
      return false;
    const auto x = static_cast<int32_t>(corner.x() * 256.0f + 0.5f);
    const auto y = static_cast<int32_t>(corner.y() * 256.0f + 0.5f);
    const int32_t x0 = std::min(x >> 8, image.width - kSpan);  // at the last column weight 256 takes its place
    const int32_t y0 = std::min(y >> 8, image.height - kSpan);
    const int32_t x_weight = x - x0 * 256;
    const int32_t y_weight = y - y0 * 256;
    uint16_t across[kSpan][kPatchFramed];  // interpolated along x, at most 255 x 2^8
    for (int r = 0; r < kSpan; ++r) {
      const uint8_t* px = image.row(y0 + r) + x0;
      for (int c = 0; c < kPatchFramed; ++c) across[r][c] = static_cast<uint16_t>(blend(px[c], px[c + 1], x_weight));
    }
    int16_t both[kPatchFramed][kPatchFramed];  // I + T in 1/8 grey, at most 2 x 8 x 255
    for (int r = 0; r < kPatchFramed; ++r) {
      const uint8_t* T = patch.px + r * kPatchFramed;
      for (int c = 0; c < kPatchFramed; ++c) {
        const int32_t I = (blend(across[r][c], across[r + 1][c], y_weight) + (1 << 12)) >> 13;
        both[r][c] = static_cast<int16_t>(I + kUnit * T[c]);
      }
    }

    // The template is blurred by as much as the sampling blurs the image more than it: T + (x_blur T_xx + y_blur T_yy)
    // / 2.
    const int32_t x_blur = x_weight * (256 - x_weight) - patch.x_blur;  // between -2^15 and 2^14, as 1 = 2^16
    const int32_t y_blur = y_weight * (256 - y_weight) - patch.y_blur;

    // jx, jy = 32 (grad T + grad I) / 2, at most 8 x 255 x 2 = 4080. e = 8 (T - I), at most 8 x 255 of the difference
    // and 2 x 510 x 2^15 / 2^14 = 2040 of the blur. The sums over 64 pixels stay below 64 x 4080^2 = 1.07e9.
    int32_t xx = 0, xy = 0, yy = 0, x_sum = 0, y_sum = 0, xe = 0, ye = 0, e_sum = 0, ee = 0;
    for (int r = 1; r <= kPatchSize; ++r) {
      const uint8_t* T = patch.px + r * kPatchFramed;
      for (int c = 1; c <= kPatchSize; ++c) {
        const int32_t jx = both[r][c + 1] - both[r][c - 1];
        const int32_t jy = both[r + 1][c] - both[r - 1][c];
        const int32_t T_xx = T[c - 1] - 2 * T[c] + T[c + 1];
        const int32_t T_yy = T[c - kPatchFramed] - 2 * T[c] + T[c + kPatchFramed];
        const int32_t e = 2 * kUnit * T[c] - both[r][c] + ((T_xx * x_blur + T_yy * y_blur + (1 << 13)) >> 14);
        xx += jx * jx;
        xy += jx * jy;
        yy += jy * jy;
        xe += jx * e;
        ye += jy * e;
        ee += e * e;
        x_sum += jx;
        y_sum += jy;
        e_sum += e;
      }
    }
    // The mean offset eliminated: 64 sum a b - sum a sum b, exact, then float.
    const auto central = [](int32_t products, int32_t a, int32_t b) {
      return static_cast<float>(int64_t{kPixels} * products - static_cast<int64_t>(a) * b);
    };
    const float A = central(xx, x_sum, x_sum), B = central(xy, x_sum, y_sum), C = central(yy, y_sum, y_sum);
    const float p = central(xe, x_sum, e_sum), q = central(ye, y_sum, e_sum);
    const float determinant = A * C - B * B;
    if (!(determinant > kMinConditioning * (A + C) * (A + C))) return false;
    constexpr float kInformation = 1.0f / (64 * 32 * 32);
    refined->information << A * kInformation, B * kInformation, B * kInformation, C * kInformation;
    refined->residual = std::sqrt(central(ee, e_sum, e_sum)) / (kPixels * kUnit);
    // sum(j j^T) step = sum(j e) with units of 32 x 32 against 32 x 8.
    const float scale = 4.0f / determinant;
    const Eigen::Vector2f step(scale * (C * p - B * q), scale * (A * q - B * p));
    constexpr float kSampled = 1.0f / 256.0f;
    position = Eigen::Vector2f(static_cast<float>(x) * kSampled + kOffset + step.x(),
                               static_cast<float>(y) * kSampled + kOffset + step.y());
    ++refined->steps;
    if (!((position - start).squaredNorm() <= kMaxDrift * kMaxDrift)) return false;
    if (step.squaredNorm() < kConverged * kConverged) break;
  }
  refined->position = position;
  return refined->steps > 0;
}

}  // namespace pptam
