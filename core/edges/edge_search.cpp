#include "edges/edge_search.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>

#include "base/sse2.h"

namespace pptam {

namespace {

// Grey values: an edge of less contrast is not sought. Below JPEG's and a sensor's noise over three samples. Not swept.
constexpr int kLeastContrast = 3;
// Grey values of contrast at which half of the full likelihood is reached. Not swept.
constexpr float kHalfContrast = 10;
// Squared grey values of a profile's variance, below which its correlation is that of noise. Not swept.
constexpr float kLeastVariance = 4;
// Likelihoods of an edge that looks unlike the remembered one, ratios: with its polarity, and with the other one. They
// matter where nothing looks as it did, such as before a new background. Not swept.
constexpr float kUnlike = 0.05f, kOpposite = 0.02f;
// Likeness from which on an edge counts whole. What is surely the remembered edge is a little more or less like it by
// noise alone, and weights that fluctuate move the pose. With 1 it jitters by a tenth more and is lost a little more
// often behind bars; with 0.67 it jitters less, but is lost as often as with 1.
constexpr float kWholeLikeness = 0.8f;
// Correlation up to which a profile is unlike the remembered one: the best of a texture's edges reach it by chance.
constexpr float kChance = 0.7f;

constexpr int kFraction = 16;     // bits of fixed-point coordinates
constexpr int kWeightShift = 12;  // to the 4 bits of bilinear weights
constexpr int kWeightMask = 15;

// Bilinear, in 1/256 grey: the weights sum to 256, so at most 65280. x, y: 16.16 fixed point.
inline int bilinear(const uint8_t* data, int stride, int32_t x, int32_t y) {
  const uint8_t* p = data + (y >> kFraction) * stride + (x >> kFraction);
  const int wx = (x >> kWeightShift) & kWeightMask, wy = (y >> kWeightShift) & kWeightMask;
  const int top = 16 * p[0] + wx * (p[1] - p[0]);
  const int bottom = 16 * p[stride] + wx * (p[stride + 1] - p[stride]);
  return 16 * top + wy * (bottom - top);
}

inline int32_t fixed(float v) {
  return static_cast<int32_t>(std::lrint(v * 65536.0f));
}

// Where between the neighbours of an extremum the edge is, -0.5 to 0.5. A camera adds up light, and encodes its grey
// values by a gamma of about 2 afterwards: the mean of both sides' light, which an edge in the middle of a pixel gives,
// looks brighter than their mean grey, and edges found in grey values lie a tenth of a pixel or two towards their dark
// side. So the mask is applied to squares here. They are at most 1.5e8, sums of them at most 4.5e8.
float refined(const int16_t* profile, int i) {
  int32_t response[3];
  for (int k = 0; k < 3; ++k) {
    const int16_t* p = profile + i - 1 + k;
    const auto square = [](int v) { return v * v; };
    response[k] = std::abs(square(p[2]) - square(p[-2]) + 2 * (square(p[1]) - square(p[-1])));
  }
  const float before = static_cast<float>(response[0]), here = static_cast<float>(response[1]),
              after = static_cast<float>(response[2]);
  const float curvature = before - 2 * here + after;
  if (!(curvature < 0)) return 0;
  return std::clamp(0.5f * (before - after) / curvature, -1.0f, 1.0f);
}

// Reaches one pixel beyond the last sample, and rounding is within 1/64 px.
constexpr float kReach_px = 1.05f;

}  // namespace

bool profile_inside(const GreyView& image, const Vector2f& px, const Vector2f& normal, int half) {
  const float along = static_cast<float>(half);
  const float x = along * std::abs(normal.x()) + std::abs(normal.y()) + kReach_px;
  const float y = along * std::abs(normal.y()) + std::abs(normal.x()) + kReach_px;
  return px.x() - x >= 0 && px.y() - y >= 0 && px.x() + x <= static_cast<float>(image.width - 1) &&
         px.y() + y <= static_cast<float>(image.height - 1);
}

// Sum of three bilinear samples: at most 195840; shifted by 4 with rounding: at most 12240.
void plain::sample_profile(const GreyView& image, const Vector2f& px, const Vector2f& normal, int half,
                           int16_t* profile) {
  const int32_t nx = fixed(normal.x()), ny = fixed(normal.y());
  int32_t x = fixed(px.x()) - half * nx, y = fixed(px.y()) - half * ny;
  for (int k = 0; k <= 2 * half; ++k) {
    const int sum = bilinear(image.data, image.stride, x, y) + bilinear(image.data, image.stride, x - ny, y + nx) +
                    bilinear(image.data, image.stride, x + ny, y - nx);
    profile[k] = static_cast<int16_t>((sum + 8) >> 4);
    x += nx;
    y += ny;
  }
}

#if defined(PPTAM_SSE2)

// The three samples in a lane each; both pixels of a row, and then both rows, by one multiplication. That bilinear()
// multiplies the difference instead makes none: nothing is rounded.
void sample_profile(const GreyView& image, const Vector2f& px, const Vector2f& normal, int half, int16_t* profile) {
  const int32_t nx = fixed(normal.x()), ny = fixed(normal.y());
  int32_t x = fixed(px.x()) - half * nx, y = fixed(px.y()) - half * ny;
  __m128i lane_x = _mm_set_epi32(0, x + ny, x - ny, x), lane_y = _mm_set_epi32(0, y - nx, y + nx, y);
  const __m128i step_x = _mm_set1_epi32(nx), step_y = _mm_set1_epi32(ny), zero = _mm_setzero_si128();
  const auto weights = [](const __m128i& at) {  // (16 - w, w), w the fraction's 4 bits
    const __m128i w = _mm_and_si128(_mm_srli_epi32(at, kWeightShift), _mm_set1_epi32(kWeightMask));
    return _mm_add_epi32(_mm_sub_epi32(_mm_set1_epi32(16), w), _mm_slli_epi32(w, 16));
  };
  const auto two_pixels = [](const uint8_t* p) {
    uint16_t both;
    std::memcpy(&both, p, sizeof both);
    return static_cast<int>(both);
  };
  for (int k = 0; k <= 2 * half; ++k) {
    const auto at = [&](int32_t u, int32_t v) {
      return image.data + (v >> kFraction) * image.stride + (u >> kFraction);
    };
    const uint8_t *a = at(x, y), *b = at(x - ny, y + nx), *c = at(x + ny, y - nx);
    __m128i pixels = _mm_cvtsi32_si128(two_pixels(a));
    pixels = _mm_insert_epi16(pixels, two_pixels(b), 1);
    pixels = _mm_insert_epi16(pixels, two_pixels(c), 2);
    pixels = _mm_insert_epi16(pixels, two_pixels(a + image.stride), 4);
    pixels = _mm_insert_epi16(pixels, two_pixels(b + image.stride), 5);
    pixels = _mm_insert_epi16(pixels, two_pixels(c + image.stride), 6);
    const __m128i across = weights(lane_x);
    const __m128i top = _mm_madd_epi16(_mm_unpacklo_epi8(pixels, zero), across);  // at most 4080
    const __m128i bottom = _mm_madd_epi16(_mm_unpackhi_epi8(pixels, zero), across);
    __m128i sum = _mm_madd_epi16(_mm_or_si128(top, _mm_slli_epi32(bottom, 16)), weights(lane_y));
    sum = _mm_add_epi32(sum, _mm_shuffle_epi32(sum, _MM_SHUFFLE(1, 0, 3, 2)));
    sum = _mm_add_epi32(sum, _mm_shuffle_epi32(sum, _MM_SHUFFLE(2, 3, 0, 1)));
    profile[k] = static_cast<int16_t>((_mm_cvtsi128_si32(sum) + 8) >> 4);
    lane_x = _mm_add_epi32(lane_x, step_x);
    lane_y = _mm_add_epi32(lane_y, step_y);
    x += nx;
    y += ny;
  }
}

#else

void sample_profile(const GreyView& image, const Vector2f& px, const Vector2f& normal, int half, int16_t* profile) {
  plain::sample_profile(image, px, normal, half, profile);
}

#endif

// Sums of 11 products of values up to 12240: 1.65e9, within int32; of their variances times 11 within int64.
Likeness likeness(const int16_t* profile, int i, const SiteMemory& memory) {
  if (memory.seen == 0) return {kUnknown, 1};
  int sum_a = 0, sum_b = 0;
  int64_t aa = 0, bb = 0, ab = 0;
  for (int k = 0; k < kMatchSize; ++k) {
    const int a = profile[i - kMatchHalf + k], b = memory.profile[k];
    sum_a += a;
    sum_b += b;
    aa += a * a;
    bb += b * b;
    ab += a * b;
  }
  const float var_a = static_cast<float>(aa * kMatchSize - static_cast<int64_t>(sum_a) * sum_a);
  const float var_b = static_cast<float>(bb * kMatchSize - static_cast<int64_t>(sum_b) * sum_b);
  constexpr float kLeast = kLeastVariance * kProfileUnits * kProfileUnits * kMatchSize * kMatchSize;
  if (var_a < kLeast || var_b < kLeast) return {};
  const float covariance = static_cast<float>(ab * kMatchSize - static_cast<int64_t>(sum_a) * sum_b);
  const float shape = (covariance / std::sqrt(var_a * var_b) - kChance) / (1 - kChance);
  return shape > 0 ? Likeness{shape, std::sqrt(var_a / var_b)} : Likeness{};
}

void learn(const int16_t* profile, int i, SiteMemory* memory) {
  for (int k = 0; k < kMatchSize; ++k) {
    const int value = profile[i - kMatchHalf + k];
    int16_t& kept = memory->profile[k];
    kept = static_cast<int16_t>(memory->seen == 0 ? value : (3 * kept + value + 2) >> 2);
  }
  if (memory->seen < 255) ++memory->seen;
}

int find_edges(const int16_t* profile, int range, const SiteMemory& memory, EdgeCandidate (&found)[kMaxCandidates]) {
  int count = 0;
  const int first = kMatchHalf, last = 2 * range + kMatchHalf;  // indices of the offsets -range and range
  int before = std::abs(convolution(profile, first - 1)), here = std::abs(convolution(profile, first));
  for (int i = first; i <= last; ++i) {
    const int after = std::abs(convolution(profile, i + 1));
    if (here > before && here >= after && here >= kLeastContrast * kStepResponse) {
      EdgeCandidate candidate;
      candidate.index = i;
      candidate.offset = static_cast<float>(i - first - range) + refined(profile, i);
      const float contrast = static_cast<float>(here) / kStepResponse;
      candidate.likelihood = candidate.strength = contrast / (contrast + kHalfContrast);
      candidate.known = memory.seen > 0;
      if (candidate.known) {
        const Likeness like = likeness(profile, i, memory);
        candidate.likeness = like.shape;
        candidate.contrast = like.contrast;
        const bool opposite = (convolution(profile, i) > 0) != (convolution(memory.profile, kMatchHalf) > 0);
        const float share = std::min(candidate.likeness / kWholeLikeness, 1.0f);
        candidate.likelihood *= std::max(opposite ? kOpposite : kUnlike, share);
      }
      int place = count;
      while (place > 0 && found[place - 1].likelihood < candidate.likelihood) --place;
      if (place < kMaxCandidates) {
        count = std::min(count + 1, kMaxCandidates);
        for (int k = count - 1; k > place; --k) found[k] = found[k - 1];
        found[place] = candidate;
      }
    }
    before = here;
    here = after;
  }
  return count;
}

}  // namespace pptam
