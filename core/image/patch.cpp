#include "image/patch.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include <pocket_ptam/status.h>
#include "base/assert.h"

namespace pptam {
namespace {

constexpr int kPixels = kPatchSize * kPatchSize;
constexpr int32_t kMaxSquares = kPixels * 255 * 255;  // grey^2: no sum of squared differences over a patch exceeds it

// f (1 - f) in units of 2^-16: its mean of 1/6, for a patch magnified three times in area. Bounds the refinement's
// integers (RefineSample).
constexpr float kMaxBlur = 32768.0f;
// Floor of a warp's determinant, that of a magnification by 8 in area: keeps the blur finite where the warp is
// singular. Not swept.
constexpr float kMinDeterminant = 1.0f / 8;
// Of a predicted position, pixels: twice any image's size, and within the range that converts to int32_t.
constexpr float kMaxCoordinate = 32768.0f;

// Share of the lines' summed squares that tells a slope from a gain: smaller only where all but one line are black.
constexpr float kMinLight = 1e-3f;

}  // namespace

void PatchTemplate::add_up() {
  sum = sum_sq = 0;
  for (int r = 1; r <= kPatchSize; ++r) {
    for (int c = 1; c <= kPatchSize; ++c) {
      const int32_t value = px[r * kPatchFramed + c];
      sum += value;
      sum_sq += value * value;
    }
  }
}

void TemplateMean::add(const PatchTemplate& patch) {
  static_assert(sizeof patch.px == sizeof even_);
  for (int i = 0; i < kWords; ++i) {
    uint32_t four;
    std::memcpy(&four, patch.px + 4 * i, 4);
    even_[i] += four & 0x00ff00ff;
    odd_[i] += (four >> 8) & 0x00ff00ff;
  }
}

// n / count is n * reciprocal / 2^16: exact while n * count < 2^16, and n is at most 6 * 255 + 3.
void TemplateMean::write(int count, PatchTemplate* patch) const {
  PPTAM_ASSERT(count >= 1 && count <= kMost);
  const uint32_t reciprocal = 65536u / static_cast<uint32_t>(count) + 1, half = static_cast<uint32_t>(count) / 2;
  const auto mean = [&](uint32_t sum) { return ((sum + half) * reciprocal) >> 16; };
  const auto both = [&](uint32_t sums) { return mean(sums & 0xffff) | mean(sums >> 16) << 16; };
  for (int i = 0; i < kWords; ++i) {
    const uint32_t four = both(even_[i]) | both(odd_[i]) << 8;
    std::memcpy(patch->px + 4 * i, &four, 4);
  }
  patch->add_up();
}

bool warp_patch(const GreyView& source, const Eigen::Vector2f& centre, const Eigen::Matrix2f& J_src_tpl,
                PatchTemplate* out) {
  if (!warp_pixels(source, centre, J_src_tpl, out)) return false;
  out->add_up();
  return true;
}

bool warp_pixels(const GreyView& source, const Eigen::Vector2f& centre, const Eigen::Matrix2f& J_src_tpl,
                 PatchTemplate* out) {
  // Positions are 16.16 fixed point: up to kMaxSize px of image and 4.5 x 2 x kMaxStep px of patch are together below
  // 2^15 px.
  constexpr int kMaxSize = 16384;    // source pixels
  constexpr float kMaxStep = 64.0f;  // source pixels per template pixel
  constexpr float kOne = 65536.0f;   // one pixel
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
    const int32_t low = start + kLast * (std::min<int32_t>(di, 0) + std::min<int32_t>(dj, 0));
    const int32_t high = start + kLast * (std::max<int32_t>(di, 0) + std::max<int32_t>(dj, 0));
    return low >= 0 && high <= (size - 1) * 65536;
  };
  if (!inside(x_start, dx_di, dx_dj, source.width) || !inside(y_start, dy_di, dy_dj, source.height)) return false;

  const WarpBlur blur_sums = kernel::warp({source.data, source.stride, source.width - 1, source.height - 1,
                                           x_start + 128, y_start + 128, dx_di, dy_di, dx_dj, dy_dj},
                                          out->px);
  // The blur is along the source's axes; the refinement needs it along the template's. With K = J_src_tpl^-1 the second
  // derivative S_xx of the source is K_00^2 T_xx + K_10^2 T_yy and a mixed term. The mixed terms of both axes nearly
  // cancel.
  const float determinant = J_src_tpl(0, 0) * J_src_tpl(1, 1) - J_src_tpl(0, 1) * J_src_tpl(1, 0);
  const float scale =
      1.0f / (kPatchFramed * kPatchFramed * std::max(determinant * determinant, kMinDeterminant * kMinDeterminant));
  const auto in_template = [&](float K_x, float K_y) {
    const float blur =
        scale * (static_cast<float>(blur_sums.x) * K_x * K_x + static_cast<float>(blur_sums.y) * K_y * K_y);
    return static_cast<int32_t>(std::min(blur, kMaxBlur));
  };
  out->x_blur = in_template(J_src_tpl(1, 1), J_src_tpl(0, 1));
  out->y_blur = in_template(J_src_tpl(1, 0), J_src_tpl(0, 0));
  return true;
}

bool search_patch(const GreyView& image, const PatchTemplate& patch, const Eigen::Vector2f& predicted, float radius,
                  int32_t max_zmssd, PatchHit* hit) {
  hit->candidates = 0;
  if (!(radius >= 0) || !(predicted.array().abs() < kMaxCoordinate).all()) return false;
  radius = std::min(radius, kMaxSearchRadius);
  const float left = predicted.x() - kPatchCentre;  // top-left corner of the 8x8 at the prediction
  const float top = predicted.y() - kPatchCentre;
  const int x_first = std::max(0, static_cast<int>(std::ceil(left - radius)));
  const int y_first = std::max(0, static_cast<int>(std::ceil(top - radius)));
  const int x_last = std::min(image.width - kPatchSize, static_cast<int>(std::floor(left + radius)));
  const int y_last = std::min(image.height - kPatchSize, static_cast<int>(std::floor(top + radius)));
  if (x_first > x_last || y_first > y_last) return false;

  PackedTemplate packed;
  kernel::pack_template(patch.px, &packed);
  const int32_t initial = std::clamp<int32_t>(max_zmssd, -1, kMaxSquares) + 1;
  int32_t best = initial;
  bool found = false;
  const auto outside = [radius_sq = radius * radius](float dx, float dy) { return dx * dx + dy * dy > radius_sq; };
  // The position nearest to the prediction first. It is compared again in its turn, but where it is like the template,
  // as it mostly is, the others are rejected sooner.
  const int x_nearest = std::clamp(static_cast<int>(std::floor(left + 0.5f)), x_first, x_last);
  const int y_nearest = std::clamp(static_cast<int>(std::floor(top + 0.5f)), y_first, y_last);
  if (!outside(static_cast<float>(x_nearest) - left, static_cast<float>(y_nearest) - top)) {
    const int32_t zmssd = kernel::zmssd_x64(image.row(y_nearest) + x_nearest, image.stride, packed, initial * kPixels);
    best = std::min(initial, zmssd / kPixels + 1);
  }
  for (int y = y_first; y <= y_last; ++y) {
    const float dy = static_cast<float>(y) - top;
    int from = x_first, to = x_last;  // the part of the row inside the circle
    while (from <= to && outside(static_cast<float>(from) - left, dy)) ++from;
    while (from <= to && outside(static_cast<float>(to) - left, dy)) --to;
    hit->candidates += to - from + 1;
    const uint8_t* row = image.row(y);
    const auto take = [&](int x, int32_t zmssd) {
      if (zmssd >= best * kPixels) return;
      best = zmssd / kPixels;
      found = true;
      hit->x = x;
      hit->y = y;
      hit->zmssd = best;
    };
    int x = from;
    if constexpr (kernel::kFourAtOnce) {
      for (; x + 3 <= to; x += 4) {
        int32_t four[4];
        if (!kernel::zmssd_x64_of_four(row + x, image.stride, packed, best * kPixels, four)) continue;
        for (int i = 0; i < 4; ++i) take(x + i, four[i]);
      }
    }
    for (; x <= to; ++x) take(x, kernel::zmssd_x64(row + x, image.stride, packed, best * kPixels));
  }
  return found;
}

PatchComparison::PatchComparison(const PatchTemplate& patch) {
  kernel::pack_template(patch.px, &packed_);
}

int32_t PatchComparison::zmssd(const GreyView& image, int x, int y, int32_t limit) const {
  if (x < 0 || y < 0 || x > image.width - kPatchSize || y > image.height - kPatchSize) return limit;
  return kernel::zmssd_x64(image.row(y) + x, image.stride, packed_, limit * kPixels) / kPixels;
}

void match_light(const GreyView& image, const Eigen::Vector2f& at, LampLines lines, PatchTemplate* patch) {
  const auto x0 = static_cast<int32_t>(at.x() - kPatchCentre), y0 = static_cast<int32_t>(at.y() - kPatchCentre);
  PPTAM_ASSERT(x0 >= 0 && y0 >= 0 && x0 + kPatchSize < image.width && y0 + kPatchSize < image.height);
  const float x_weight = at.x() - kPatchCentre - static_cast<float>(x0);
  const float y_weight = at.y() - kPatchCentre - static_cast<float>(y0);
  float image_line[kPatchSize] = {}, patch_line[kPatchSize] = {};
  for (int r = 0; r < kPatchSize; ++r) {
    const uint8_t* upper = image.row(y0 + r) + x0;
    const uint8_t* lower = upper + image.stride;
    for (int c = 0; c < kPatchSize; ++c) {
      const float u = static_cast<float>(upper[c]), l = static_cast<float>(lower[c]);
      const float u_next = static_cast<float>(upper[c + 1]), l_next = static_cast<float>(lower[c + 1]);
      const float above = u + x_weight * (u_next - u), below = l + x_weight * (l_next - l);
      const int line = lines == LampLines::kRows ? r : c;
      image_line[line] += above + y_weight * (below - above);
      patch_line[line] += static_cast<float>(patch->px[(r + 1) * kPatchFramed + c + 1]);
    }
  }
  // Least squares of image = (a + b s) patch over the lines, s from the middle.
  float TT = 0, sTT = 0, ssTT = 0, TI = 0, sTI = 0;
  for (int line = 0; line < kPatchSize; ++line) {
    const float s = static_cast<float>(line) - kPatchCentre, T = patch_line[line], I = image_line[line];
    TT += T * T, sTT += s * T * T, ssTT += s * s * T * T;
    TI += T * I, sTI += s * T * I;
  }
  const float determinant = TT * ssTT - sTT * sTT;
  if (!(determinant > kMinLight * TT * TT)) return;  // black
  const float a = (ssTT * TI - sTT * sTI) / determinant, b = (TT * sTI - sTT * TI) / determinant;
  for (int r = 0; r < kPatchFramed; ++r) {
    for (int c = 0; c < kPatchFramed; ++c) {
      const float s = static_cast<float>(lines == LampLines::kRows ? r : c) - (kPatchCentre + 1);
      uint8_t& px = patch->px[r * kPatchFramed + c];
      px = static_cast<uint8_t>(std::clamp((a + b * s) * static_cast<float>(px) + 0.5f, 0.0f, 255.0f));
    }
  }
  patch->add_up();
}

bool refine_patch(const GreyView& image, const PatchTemplate& patch, const Eigen::Vector2f& start, int max_steps,
                  RefinedPatch* refined) {
  constexpr float kMaxDrift = 1.5f;            // px, more than the diagonal neighbour: another structure. Not swept
  constexpr float kConverged = 0.03f;          // px, step after which it ends; not swept
  constexpr float kMaxRatio = 0.6f;            // of successive steps; a larger ratio is no geometric series. Not swept
  constexpr float kMinConditioning = 1e-3f;    // det / trace^2: along an edge sigma is 30 times that across. Not swept
  constexpr float kOffset = kPatchCentre + 1;  // pixels from the framed patch's top-left pixel to the reference point
  constexpr int kSpan = kPatchFramed + 1;      // pixels needed to interpolate kPatchFramed samples

  if (image.width < kSpan || image.height < kSpan) return false;
  RefineTemplate prepared;
  kernel::prepare_refinement(patch.px, &prepared);
  RefineSample sample;
  sample.stride = image.stride;
  Eigen::Vector2f position = start, last_step = Eigen::Vector2f::Zero();
  bool last_is_plain = false;  // whether there was a last step and it was not extrapolated
  refined->steps = 0;
  while (refined->steps < max_steps) {
    // The image is sampled at multiples of 1/32 px. The step is added to that position, so rounding loses nothing.
    const Eigen::Vector2f corner = position - Eigen::Vector2f::Constant(kOffset);
    if (!(corner.x() >= 0 && corner.y() >= 0 && corner.x() <= static_cast<float>(image.width - kPatchFramed) &&
          corner.y() <= static_cast<float>(image.height - kPatchFramed)))
      return false;
    const auto x = static_cast<int32_t>(corner.x() * kSubpixels + 0.5f);
    const auto y = static_cast<int32_t>(corner.y() * kSubpixels + 0.5f);
    const int32_t x0 =
        std::min<int32_t>(x / kSubpixels, image.width - kSpan);  // in the last column the weight is kSubpixels
    const int32_t y0 = std::min<int32_t>(y / kSubpixels, image.height - kSpan);
    sample.image = image.row(y0) + x0;
    sample.x_weight = x - x0 * kSubpixels;
    sample.y_weight = y - y0 * kSubpixels;
    constexpr int32_t kBlurUnit = 65536 / (kSubpixels * kSubpixels);  // to units of 2^-16
    sample.x_blur = sample.x_weight * (kSubpixels - sample.x_weight) * kBlurUnit - patch.x_blur;
    sample.y_blur = sample.y_weight * (kSubpixels - sample.y_weight) * kBlurUnit - patch.y_blur;
    const RefineSums sums = kernel::refine_sums(sample, prepared);

    // Sum of products with the mean offset eliminated, times 64: 64 sum a b - sum a sum b, exact (at most 6.8e10 each:
    // in double, because converting 64-bit integers takes ARMs without that instruction long), then float.
    const auto central = [](int32_t products, int32_t a, int32_t b) {
      return static_cast<float>(double{kPixels} * products - static_cast<double>(a) * b);
    };
    const float A = central(sums.xx, sums.x, sums.x), B = central(sums.xy, sums.x, sums.y);
    const float C = central(sums.yy, sums.y, sums.y);
    const float p = central(sums.xe, sums.x, sums.e), q = central(sums.ye, sums.y, sums.e);
    const float determinant = A * C - B * B;
    if (!(determinant > kMinConditioning * (A + C) * (A + C))) return false;
    constexpr float kInformation = 1.0f / (64 * 32 * 32);  // 64 from central(), 32 from each gradient (RefineSums)
    refined->information << A * kInformation, B * kInformation, B * kInformation, C * kInformation;
    refined->residual = std::sqrt(central(sums.ee, sums.e, sums.e)) / (kPixels * kSampleUnit);
    // sum(j j^T) step = sum(j e). Gradients j are in 1/32, errors e in 1/8 (RefineSums): a factor of 4.
    const float scale = 4.0f / determinant;
    Eigen::Vector2f step(scale * (C * p - B * q), scale * (A * q - B * p));
    // Central differences underestimate the gradient of a sharp edge, so that steps overshoot and return, in a nearly
    // constant ratio. Every second step is therefore extrapolated to the limit of the geometric series (Aitken): 3.0
    // steps in place of 4.1 on a phone's frames.
    if (last_is_plain) {
      const float ratio = step.dot(last_step) / last_step.squaredNorm();
      step *= 1 / (1 - std::clamp(ratio, -kMaxRatio, kMaxRatio));
    }
    last_step = step;
    last_is_plain = !last_is_plain;
    constexpr float kSampled = 1.0f / kSubpixels;  // pixels
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
