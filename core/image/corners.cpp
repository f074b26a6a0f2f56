#include "image/corners.h"

#include <algorithm>
#include <cmath>

namespace pptam {
namespace {

constexpr int kRadiusL2 = 1;               // windows of 3x3 in L2,
constexpr int kRadiusL1 = 2;               // 5x5 in L1
constexpr int kRadiusL0 = 3;               // and 7x7 in L0
constexpr int kMinBorder = kRadiusL0 + 2;  // the windows of a 3x3 neighbourhood and their gradients stay inside
constexpr int kMinDistance = 6;            // between corners, level-0 pixels

// Integer gradients are I(x+1) - I(x-1), twice the central difference. |gradient| <= 255, so a sum of products over 49
// pixels is at most 49 x 255^2 = 3.2e6: exact in int32_t and (below 2^24) in float, and so is the sum of two.
constexpr float tensor_scale(int radius) {
  return 1.0f / static_cast<float>(4 * (2 * radius + 1) * (2 * radius + 1));
}

inline void add_gradient(const uint8_t* px, int stride, int32_t sign, StructureTensor* sum) {
  const int32_t gx = px[1] - px[-1];
  const int32_t gy = px[stride] - px[-stride];
  sum->xx += sign * gx * gx;
  sum->xy += sign * gx * gy;
  sum->yy += sign * gy * gy;
}

// lambda_min = (xx + yy - sqrt((xx - yy)^2 + 4 xy^2)) / 2. The root is at most 6.4e6 and rounded to 0.5: after scaling
// by tensor_scale(kRadiusL0) an error of 0.0013.
float min_eigenvalue(const StructureTensor& sum, float scale) {
  const auto trace = static_cast<float>(sum.xx + sum.yy);
  const auto difference = static_cast<float>(sum.xx - sum.yy);
  const auto twice_xy = static_cast<float>(2 * sum.xy);
  const float root = std::sqrt(difference * difference + twice_xy * twice_xy);
  return std::max(0.0f, 0.5f * scale * (trace - root));
}

// Adds (sign 1) or takes away (sign -1) the gradients of row y to the sums of columns first..last.
template <int32_t sign>
void update_columns(const GreyView& image, int y, int first, int last, StructureTensor* columns) {
  const uint8_t* row = image.row(y);
  for (int x = first; x <= last; ++x) add_gradient(row + x, image.stride, sign, &columns[x]);
}

// Minimum eigenvalues for every pixel at least border - 1 inside, zero where they are below min_score. Sliding sums:
// down the columns over the window's rows, then along the row over its columns.
void score_image(const GreyView& image, float min_score, int border, CornerScratch& scratch) {
  constexpr float kScale = tensor_scale(kRadiusL2);
  const int first_x = border - 1, last_x = image.width - border;
  const int first_y = border - 1, last_y = image.height - border;
  const int first_column = first_x - kRadiusL2, last_column = last_x + kRadiusL2;
  // Neither eigenvalue exceeds xx or yy: a smaller one of those settles most pixels without a square root.
  const auto min_diagonal = static_cast<int32_t>(std::clamp(min_score / kScale, 0.0f, 4e6f));

  StructureTensor* columns = scratch.columns.data();
  std::fill(columns, columns + image.width, StructureTensor());
  for (int y = first_y - kRadiusL2; y < first_y + kRadiusL2; ++y)
    update_columns<1>(image, y, first_column, last_column, columns);
  for (int y = first_y; y <= last_y; ++y) {
    update_columns<1>(image, y + kRadiusL2, first_column, last_column, columns);
    StructureTensor sum;
    for (int x = first_column; x < first_x + kRadiusL2; ++x) sum += columns[x];
    float* scores = scratch.score.data() + y * image.width;
    for (int x = first_x; x <= last_x; ++x) {
      sum += columns[x + kRadiusL2];
      float score = 0;
      if (sum.xx >= min_diagonal && sum.yy >= min_diagonal) {
        score = min_eigenvalue(sum, kScale);
        if (score < min_score) score = 0;
      }
      scores[x] = score;
      sum -= columns[x - kRadiusL2];
    }
    update_columns<-1>(image, y - kRadiusL2, first_column, last_column, columns);
  }
}

// Greater than the neighbours before it in row-major order and not less than those after it: of a flat top exactly the
// first pixel is taken.
bool is_maximum(const float* score, int stride) {
  const float s = *score;
  const float* above = score - stride;
  const float* below = score + stride;
  return s > score[-1] && s > above[-1] && s > above[0] && s > above[1] &&  //
         s >= score[1] && s >= below[-1] && s >= below[0] && s >= below[1];
}

// Scores of the nine centres round (x, y), row-major. Every gradient is formed once: down each column for the three
// windows one row apart, then along the rows of column sums for the three windows one column apart.
template <int kRadius>
void score_neighbourhood(const GreyView& image, int x, int y, float scores[9]) {
  constexpr int kSpan = 2 * kRadius + 3;
  const int stride = image.stride;
  StructureTensor columns[3][kSpan];
  for (int i = 0; i < kSpan; ++i) {
    const uint8_t* px = image.row(y - kRadius - 1) + x - kRadius - 1 + i;
    StructureTensor first, second, last_but_one, last, middle;
    add_gradient(px, stride, 1, &first);
    add_gradient(px + stride, stride, 1, &second);
    px += 2 * stride;
    for (int j = 2; j < kSpan - 2; ++j, px += stride) add_gradient(px, stride, 1, &middle);
    add_gradient(px, stride, 1, &last_but_one);
    add_gradient(px + stride, stride, 1, &last);
    middle += second;
    columns[0][i] = middle;
    columns[0][i] += first;
    middle += last_but_one;
    columns[1][i] = middle;
    middle -= second;
    columns[2][i] = middle;
    columns[2][i] += last;
  }
  for (int r = 0; r < 3; ++r) {
    const StructureTensor* column = columns[r];
    StructureTensor sum;
    for (int i = 0; i < kSpan - 2; ++i) sum += column[i];
    scores[3 * r] = min_eigenvalue(sum, tensor_scale(kRadius));
    for (int c = 1; c < 3; ++c) {
      sum -= column[c - 1];
      sum += column[c + kSpan - 3];
      scores[3 * r + c] = min_eigenvalue(sum, tensor_scale(kRadius));
    }
  }
}

// Moves (x, y) to the best of its 3x3 neighbourhood until it is a maximum (the centre wins ties) or max_steps are made.
// Returns the score there.
template <int kRadius>
float ascend(const GreyView& image, int max_steps, int* x, int* y, int* steps) {
  float score = 0;
  for (int step = 0; step < max_steps; ++step) {
    float scores[9];
    score_neighbourhood<kRadius>(image, *x, *y, scores);
    ++*steps;
    int best = 4;
    for (int i = 0; i < 9; ++i)
      if (scores[i] > scores[best]) best = i;
    score = scores[best];
    if (best == 4) break;
    *x += best % 3 - 1;
    *y += best / 3 - 1;
  }
  return score;
}

}  // namespace

float shi_tomasi_score(const GreyView& image, int x, int y) {
  constexpr int kInside = kRadiusL0 + 1;
  PPTAM_ASSERT(x >= kInside && y >= kInside && x < image.width - kInside && y < image.height - kInside);
  StructureTensor sum;
  for (int dy = -kRadiusL0; dy <= kRadiusL0; ++dy)
    for (int dx = -kRadiusL0; dx <= kRadiusL0; ++dx) add_gradient(image.row(y + dy) + x + dx, image.stride, 1, &sum);
  return min_eigenvalue(sum, tensor_scale(kRadiusL0));
}

CornerScratch::CornerScratch(Arena& arena, int width_l0, int height_l0)
    : score(arena, (width_l0 >> 2) * (height_l0 >> 2)),
      columns(arena, width_l0 >> 2),
      candidates(arena, ((width_l0 >> 3) + 1) * ((height_l0 >> 3) + 1)) {}

int detect_corners(const Pyramid& pyramid, const CornerParams& params, CornerScratch& scratch, std::span<Corner> out,
                   CornerStats* stats) {
  // Five steps cannot leave the part of L1 and L0 where neighbourhoods can be scored: see the start of the ascent.
  PPTAM_ASSERT(params.max_ascent_steps >= 1 && params.max_ascent_steps <= 5);
  PPTAM_ASSERT(params.cells_x >= 1 && params.cells_y >= 1);
  const GreyView& l2 = pyramid.level[2];
  const int border = std::max(params.border_l2, kMinBorder);
  int steps = 0;
  scratch.candidates.clear();
  if (l2.width > 2 * border && l2.height > 2 * border) {
    scratch.score.resize(l2.width * l2.height);
    scratch.columns.resize(l2.width);
    score_image(l2, params.min_score, border, scratch);
    for (int y = border; y < l2.height - border; ++y) {
      for (int x = border; x < l2.width - border; ++x) {
        const float* score = scratch.score.data() + y * l2.width + x;
        if (*score <= 0 || !is_maximum(score, l2.width)) continue;
        // The middle of the L2 pixel is at 2 x + 0.5 in L1, as in to_level0(); rounded down, its other neighbours are
        // within the first 3x3. The same again from L1 to L0. Border: 2 x 5 - 5 steps = 5 in L1, more in L0.
        int x0 = 2 * x, y0 = 2 * y;
        const float score_l1 = ascend<kRadiusL1>(pyramid.level[1], params.max_ascent_steps, &x0, &y0, &steps);
        if (score_l1 < params.min_score) continue;
        x0 *= 2;
        y0 *= 2;
        const float score_l0 = ascend<kRadiusL0>(pyramid.level[0], params.max_ascent_steps, &x0, &y0, &steps);
        if (score_l0 < params.min_score) continue;
        CornerCandidate candidate;
        candidate.corner = {static_cast<int16_t>(x0), static_cast<int16_t>(y0), std::min({*score, score_l1, score_l0})};
        candidate.cell = y * params.cells_y / l2.height * params.cells_x + x * params.cells_x / l2.width;
        scratch.candidates.push_back(candidate);
      }
    }
  }
  if (stats) stats->ascent_steps = steps;

  // Both orders are total, so that every sort routine gives the same result.
  CornerCandidate* begin = scratch.candidates.begin();
  CornerCandidate* end = scratch.candidates.end();
  const auto better = [](const Corner& a, const Corner& b) {
    if (a.score != b.score) return a.score > b.score;
    return a.y != b.y ? a.y < b.y : a.x < b.x;
  };
  std::sort(begin, end, [&](const CornerCandidate& a, const CornerCandidate& b) {
    return a.cell != b.cell ? a.cell < b.cell : better(a.corner, b.corner);
  });
  for (CornerCandidate* c = begin; c != end; ++c) c->turn = c != begin && c[-1].cell == c->cell ? c[-1].turn + 1 : 0;
  std::sort(begin, end, [&](const CornerCandidate& a, const CornerCandidate& b) {
    return a.turn != b.turn ? a.turn < b.turn : better(a.corner, b.corner);
  });

  int count = 0;
  for (const CornerCandidate* c = begin; c != end && count < static_cast<int>(out.size()); ++c) {
    const bool apart = std::none_of(out.begin(), out.begin() + count, [&](const Corner& taken) {
      const int dx = taken.x - c->corner.x, dy = taken.y - c->corner.y;
      return dx * dx + dy * dy < kMinDistance * kMinDistance;
    });
    if (apart) out[count++] = c->corner;
  }
  return count;
}

}  // namespace pptam
