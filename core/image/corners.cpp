#include "image/corners.h"

#include <algorithm>
#include <cmath>

#include <pocket_ptam/config.h>
#include "base/assert.h"
#include "base/sort.h"

namespace pptam {
namespace {

// Radii of the score's windows, pixels of each level: 3x3 where all pixels are scored, and in the ascent 5x5 in the
// finest level scored and 7x7 in the one below, L0. Measured: see corners.h.
constexpr int kScoreRadius = 1;
constexpr int kScoredRadius = 2;
constexpr int kRadiusL0 = 3;
constexpr int kMinBorder = kRadiusL0 + 2;  // pixels: windows of a 3x3 neighbourhood and their gradients stay inside
// Steps in one level. From 2 x kMinBorder on, five lead to 5 from the edge of a level, which is kMinBorder.
constexpr int kMaxAscentSteps = 5;
constexpr int kMinDistance = 3;  // between corners, pixels of the finest level scored; not swept
// Bound of the threshold on the smaller eigenvalue of a 3x3 window's sums, grey^2: more than the 9 x 255^2 that it
// reaches; twice of it is within int32_t.
constexpr float kMaxThreshold = 2e6f;

// Scale from a sum of gradient products to the structure tensor, the mean over the window in grey^2/px^2. Integer
// gradients are I(x+1) - I(x-1), twice the central difference. |gradient| <= 255, so a sum of products over 49 pixels
// is at most 49 x 255^2 = 3.2e6: exact in int32_t and (below 2^24) in float, as is the sum of two.
constexpr float tensor_scale(int radius) {
  return 1.0f / static_cast<float>(4 * (2 * radius + 1) * (2 * radius + 1));
}

inline StructureTensor gradient_products(const uint8_t* px, int stride) {
  const int32_t gx = px[1] - px[-1];
  const int32_t gy = px[stride] - px[-stride];
  return {gx * gx, gx * gy, gy * gy};
}

// Whether twice the smaller eigenvalue, trace - root, exceeds limit. root^2 = (xx - yy)^2 + 4 xy^2 is exact in int64_t,
// so that no root is taken.
inline bool twice_smaller_exceeds(const StructureTensor& sum, int32_t limit) {
  const int32_t excess = sum.xx + sum.yy - limit;
  if (excess <= 0) return false;
  const int32_t difference = sum.xx - sum.yy, twice_xy = 2 * sum.xy;
  return int64_t{excess} * excess > int64_t{difference} * difference + int64_t{twice_xy} * twice_xy;
}
// Twice the smaller eigenvalue, rounded. The root is at most 6.4e6 and rounded to 0.5: after scaling by
// tensor_scale(kRadiusL0) the error is 0.0013. An eigenvalue of zero may therefore come out slightly negative.
[[gnu::always_inline]] inline float twice_smaller_eigenvalue(const StructureTensor& sum) {
  const auto difference = static_cast<float>(sum.xx - sum.yy);
  const auto twice_xy = static_cast<float>(2 * sum.xy);
  const float root = std::sqrt(difference * difference + twice_xy * twice_xy);
  return static_cast<float>(sum.xx + sum.yy) - root;
}

// Sums of row y's gradient products over 3 columns, for columns first..last.
void sum_row(const GreyView& image, int y, int first, int last, StructureTensor* out) {
  const int stride = image.stride;
  const uint8_t* row = image.row(y);
  StructureTensor left = gradient_products(row + first - 1, stride);
  StructureTensor middle = gradient_products(row + first, stride);
  for (int x = first; x <= last; ++x) {
    const StructureTensor right = gradient_products(row + x + 1, stride);
    out[x] = left + middle + right;
    left = middle;
    middle = right;
  }
}

// Whether a score is greater than its neighbours before it in row-major order and not less than those after it: of
// equal neighbours only the first is taken.
bool is_maximum(const float* above, const float* score, const float* below) {
  const float s = *score;
  return s > score[-1] && s > above[-1] && s > above[0] && s > above[1] &&  //
         s >= score[1] && s >= below[-1] && s >= below[0] && s >= below[1];
}

// Moves (x, y), pixels of the image, to the best of its 3x3 neighbourhood until it is a maximum (the centre wins ties)
// or max_steps are made. Returns the score there, grey^2/px^2.
template <int kRadius>
float ascend(const GreyView& image, int max_steps, int* x, int* y, int* steps) {
  constexpr int kCentre = 4;  // index in the 3x3 neighbourhood
  float twice = 0;            // of the centre: twice the smaller eigenvalue
  for (int step = 0; step < max_steps; ++step) {
    StructureTensor sums[9];
    kernel::window_sums<kRadius>(image.row(*y) + *x, image.stride, sums);
    ++*steps;
    if (step == 0) twice = twice_smaller_eigenvalue(sums[kCentre]);
    int best = kCentre;
    for (int i = 0; i < 9; ++i) {
      if (i == kCentre || !twice_smaller_exceeds(sums[i], static_cast<int32_t>(twice))) continue;
      const float other = twice_smaller_eigenvalue(sums[i]);
      if (other <= twice) continue;
      twice = other;
      best = i;
    }
    if (best == kCentre) break;
    *x += best % 3 - 1;
    *y += best / 3 - 1;
  }
  return 0.5f * tensor_scale(kRadius) * twice;
}

}  // namespace

float shi_tomasi_score(const GreyView& image, int x, int y) {
  constexpr int kInside = kRadiusL0 + 1;
  PPTAM_ASSERT(x >= kInside && y >= kInside && x < image.width - kInside && y < image.height - kInside);
  StructureTensor sum = {0, 0, 0};
  for (int dy = -kRadiusL0; dy <= kRadiusL0; ++dy)
    for (int dx = -kRadiusL0; dx <= kRadiusL0; ++dx) sum += gradient_products(image.row(y + dy) + x + dx, image.stride);
  return std::max(0.0f, 0.5f * tensor_scale(kRadiusL0) * twice_smaller_eigenvalue(sum));
}

CornerDetector::CornerDetector(Arena& arena, int width_l0, int height_l0, int search_level)
    : finest_scored_(std::min(search_level, 1)),
      score_(arena, std::max((width_l0 >> coarsest_scored()) * (height_l0 >> coarsest_scored()),
                             3 * (width_l0 >> finest_scored_))),
      rows_(arena, 3 * (width_l0 >> finest_scored_)),
      // Maxima are never adjacent: there is at most one in each 2x2 block.
      maxima_(arena, ((width_l0 >> coarsest_scored()) + 1) * ((height_l0 >> coarsest_scored()) + 1)),
      taken_(arena, ((width_l0 >> coarsest_scored()) + 1) * ((height_l0 >> coarsest_scored()) + 1)) {}

void CornerDetector::start(const Pyramid& pyramid, const CornerParams& params) {
  PPTAM_ASSERT(params.max_ascent_steps >= 1 && params.max_ascent_steps <= kMaxAscentSteps);
  PPTAM_ASSERT(params.cells_x >= 1 && params.cells_y >= 1 && params.cells_x * params.cells_y <= kMaxCells);
  pyramid_ = pyramid;
  params_ = params;
  taken_.clear();
  scored_pixels_ = 0;
  ascent_steps_ = 0;
  start_level(coarsest_scored());
}

void CornerDetector::start_level(int level) {
  level_ = level;
  maxima_.clear();
  round_.clear();
  next_ = 0;
  const GreyView& image = pyramid_.level[level];
  border_ = std::max(params_.border << (coarsest_scored() - level), kMinBorder);
  score_.resize(level == coarsest_scored() ? image.width * image.height : 3 * image.width);
  rows_.resize(3 * image.width);
  row_ = std::min(image.width, image.height) > 2 * border_ ? border_ - 1 : image.height;
}

// Scores every pixel of row row_ that is at least border_ - 1 inside; the score is zero below min_score. Window sums
// are made along rows, kept for three rows, then down the columns. Then finds the maxima of the row before.
void CornerDetector::score_row() {
  static_assert(kScoreRadius == 1);
  const GreyView& image = pyramid_.level[level_];
  const int y = row_++;
  const int first_x = border_ - 1, last_x = image.width - border_;
  const float scale = 0.5f * tensor_scale(kScoreRadius);
  const auto min_twice = static_cast<int32_t>(std::clamp(params_.min_score / scale, 0.0f, 2 * kMaxThreshold));
  const int32_t min_diagonal = min_twice / 2;  // the smaller eigenvalue is at most min(xx, yy): rejects most pixels
  scored_pixels_ += image.width;

  const auto sums_of = [&](int row) { return rows_.data() + row % 3 * image.width; };
  if (y == border_ - 1) {
    sum_row(image, y - 1, first_x, last_x, sums_of(y - 1));
    sum_row(image, y, first_x, last_x, sums_of(y));
  }
  sum_row(image, y + 1, first_x, last_x, sums_of(y + 1));
  const StructureTensor* const above = sums_of(y - 1);
  const StructureTensor* const middle = sums_of(y);
  const StructureTensor* const below = sums_of(y + 1);
  float* const scores = scores_of(y);
  for (int x = first_x; x <= last_x; ++x) {
    scores[x] = 0;
    const int32_t xx = above[x].xx + middle[x].xx + below[x].xx;
    if (xx < min_diagonal) continue;
    const int32_t yy = above[x].yy + middle[x].yy + below[x].yy;
    if (yy < min_diagonal) continue;
    const StructureTensor sum = {xx, above[x].xy + middle[x].xy + below[x].xy, yy};
    if (twice_smaller_exceeds(sum, min_twice)) scores[x] = scale * twice_smaller_eigenvalue(sum);
  }

  if (y <= border_) return;
  const float* const before = scores_of(y - 1);
  const float* const before_that = scores_of(y - 2);
  const int cell_row = (y - 1) * params_.cells_y / image.height * params_.cells_x;
  for (int x = border_; x < image.width - border_; ++x) {
    if (before[x] == 0 || !is_maximum(before_that + x, before + x, scores + x)) continue;
    Maximum maximum;
    maximum.score = before[x];
    maximum.x = static_cast<int16_t>(x);
    maximum.y = static_cast<int16_t>(y - 1);
    maximum.cell = static_cast<int16_t>(cell_row + x * params_.cells_x / image.width);
    maxima_.push_back(maximum);
  }
}

// Fills round_ with the best maximum left in each bucket, best first.
void CornerDetector::order_round() {
  int16_t best[kMaxCells];
  std::fill_n(best, kMaxCells, int16_t{-1});
  for (int i = 0; i < maxima_.size(); ++i) {
    const Maximum& maximum = maxima_[i];
    if (maximum.cell < 0) continue;
    int16_t& leader = best[maximum.cell];
    if (leader < 0 || better(maximum, maxima_[leader])) leader = static_cast<int16_t>(i);
  }
  round_.clear();
  next_ = 0;
  for (const int16_t i : best) {
    if (i < 0) continue;
    maxima_[i].cell = -1;
    round_.push_back(i);
  }
  sort_list(round_, [&](int16_t a, int16_t b) { return better(maxima_[a], maxima_[b]); });
}

bool CornerDetector::apart(int x, int y) const {
  const int distance = kMinDistance << finest_scored_;
  return std::none_of(taken_.begin(), taken_.end(), [&](const Position& other) {
    const int dy = other.y - y;
    if (dy >= distance || dy <= -distance) return false;
    const int dx = other.x - x;
    return dx * dx + dy * dy < distance * distance;
  });
}

// Follows a maximum down to L0. False when it is below min_score there, or nearer than kMinDistance to a corner
// already found.
bool CornerDetector::follow(const Maximum& maximum, Corner* corner) {
  int x = maximum.x, y = maximum.y;
  if (level_ == coarsest_scored()) {
    // The centre of its pixel lies at 2 x + 0.5 in the finer level, between two pixels: the one on the side of the
    // greater score is the start.
    const int width = pyramid_.level[level_].width;
    const float* score = score_.data() + y * width + x;
    x = 2 * x + (score[1] > score[-1] ? 1 : 0);
    y = 2 * y + (score[width] > score[-width] ? 1 : 0);
  } else if (!apart(x << finest_scored_, y << finest_scored_)) {
    return false;
  }
  float score = ascend<kScoredRadius>(pyramid_.level[finest_scored_], params_.max_ascent_steps, &x, &y, &ascent_steps_);
  if (score < params_.min_score) return false;
  if (finest_scored_ > 0) {
    x *= 2;  // rounded down: the first 3x3 neighbourhood holds all four pixels round the centre of the L1 pixel
    y *= 2;
    score = std::min(score, ascend<kRadiusL0>(pyramid_.level[0], params_.max_ascent_steps, &x, &y, &ascent_steps_));
  }
  if (score < params_.min_score || !apart(x, y)) return false;
  *corner = {static_cast<int16_t>(x), static_cast<int16_t>(y), std::min(maximum.score, score)};
  taken_.push_back({corner->x, corner->y});
  return true;
}

CornerProgress CornerDetector::advance(Corner* corner) {
  if (row_ <= pyramid_.level[level_].height - border_) {
    score_row();
    return CornerProgress::kWorking;
  }
  if (next_ == round_.size()) {
    order_round();
    if (round_.size() > 0) return CornerProgress::kWorking;
    if (level_ == finest_scored_) return CornerProgress::kEnd;
    start_level(level_ - 1);
    return CornerProgress::kWeaker;
  }
  return follow(maxima_[round_[next_++]], corner) ? CornerProgress::kFound : CornerProgress::kWorking;
}

int CornerDetector::detect(const Pyramid& pyramid, const CornerParams& params, std::span<Corner> out, int enough) {
  start(pyramid, params);
  int count = 0;
  while (count < static_cast<int>(out.size())) {
    const CornerProgress progress = advance(&out[static_cast<size_t>(count)]);
    if (progress == CornerProgress::kEnd || (progress == CornerProgress::kWeaker && count >= enough)) break;
    count += progress == CornerProgress::kFound;
  }
  return count;
}

ShiTomasiCorners::ShiTomasiCorners(Arena& arena, const Config& config, WorkMeter& meter)
    : meter_(meter), detector_(arena, config.camera.model.width, config.camera.model.height, config.search_level) {}

void ShiTomasiCorners::start(const Pyramid& pyramid) {
  detector_.start(pyramid, CornerParams());
}

CornerProgress ShiTomasiCorners::advance(Corner* corner) {
  const int pixels = detector_.scored_pixels(), steps = detector_.ascent_steps();
  const CornerProgress progress = detector_.advance(corner);
  meter_.charge(Work::kCornerPixel, detector_.scored_pixels() - pixels);
  meter_.charge(Work::kCornerAscent, detector_.ascent_steps() - steps);
  return progress;
}

CornerSource* create_shi_tomasi_corners(Arena& arena, const Config& config, WorkMeter& meter) {
  return arena.create<ShiTomasiCorners>(config, meter);
}

}  // namespace pptam
