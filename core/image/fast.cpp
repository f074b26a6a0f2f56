#include "image/fast.h"

#include <algorithm>

#include <pocket_ptam/config.h>
#include "base/sort.h"
#include "image/corners.h"
#include "image/kernels.h"

namespace pptam {

namespace {

constexpr int kOrder[FastCorners::kLevels] = {1, 0, 2, 3};
// Pixels of an image for each local maximum that is kept at most; further ones, in the lower rows, are left out. Not
// swept.
constexpr int kPixelsPerMaximum = 16;
// ARMv6 instructions, estimates: of a pixel tested, and of a corner scored.
constexpr int64_t kTestInstructions = 40, kScoreInstructions = 900;

}  // namespace

FastCorners::FastCorners(Arena& arena, int width_l0, int height_l0, WorkMeter& meter)
    : meter_(meter),
      scores_(arena, 3 * width_l0),
      columns_(arena, width_l0),
      before_(arena, width_l0),
      maxima_(arena, width_l0 * height_l0 / kPixelsPerMaximum) {
  scores_.resize(scores_.capacity());
}

int FastCorners::level() const {
  return kOrder[order_];
}

void FastCorners::start(const Pyramid& pyramid) {
  pyramid_ = pyramid;
  order_ = 0;
  start_level();
}

void FastCorners::start_level() {
  maxima_.clear();
  round_.clear();
  next_ = 0;
  before_.clear();
  columns_.clear();
  std::fill(scores_.begin(), scores_.end(), 0.0f);
  const GreyView& image = pyramid_.level[level()];
  row_ = std::min(image.width, image.height) > 2 * kBorder ? kBorder : image.height;
}

// Scores the corners of row row_, then finds the maxima of the row before.
void FastCorners::score_row() {
  const GreyView& image = pyramid_.level[level()];
  const int y = row_++;
  float* const scores = scores_.data() + y % 3 * image.width;
  std::fill_n(scores, image.width, 0.0f);
  std::swap(columns_, before_);
  columns_.clear();
  if (y < image.height - kBorder) {
    columns_.resize(columns_.capacity());
    columns_.resize(
        kernel::fast_row(image.row(y), image.stride, kBorder, image.width - kBorder - 1, kThreshold, columns_.data()));
    for (const int16_t x : columns_) {
      const float score = shi_tomasi_score(image, x, y);
      scores[x] = score >= kMinScore ? score : 0.0f;
    }
  }
  meter_.charge(Work::kOther, kTestInstructions * image.width + kScoreInstructions * columns_.size());
  suppress_row(y - 1);
}

// Keeps the corners of row y, the row before the last scored one, whose score no neighbour exceeds. Of equal ones the
// first in row-major order stays.
void FastCorners::suppress_row(int y) {
  const GreyView& image = pyramid_.level[level()];
  const auto row = [&](int of) { return scores_.data() + (of + 3) % 3 * image.width; };
  const float *above = row(y - 1), *here = row(y), *below = row(y + 1);
  const int cell_row = y * kCellsY / image.height * kCellsX;
  for (const int16_t x : before_) {
    const float score = here[x];
    if (score == 0 || here[x - 1] >= score || here[x + 1] > score) continue;
    const float upper = std::max({above[x - 1], above[x], above[x + 1]});
    const float lower = std::max({below[x - 1], below[x], below[x + 1]});
    if (upper >= score || lower > score) continue;
    Maximum maximum;
    maximum.score = score;
    maximum.x = x;
    maximum.y = static_cast<int16_t>(y);
    maximum.cell = static_cast<int16_t>(cell_row + x * kCellsX / image.width);
    maxima_.push_back(maximum);
  }
}

// Fills round_ with the best maximum left in each cell, best first.
void FastCorners::order_round() {
  int best[kCellsX * kCellsY];
  std::fill_n(best, kCellsX * kCellsY, -1);
  for (int i = 0; i < maxima_.size(); ++i) {
    const Maximum& maximum = maxima_[i];
    if (maximum.cell < 0) continue;
    int& leader = best[maximum.cell];
    if (leader < 0 || better(maximum, maxima_[leader])) leader = i;
  }
  round_.clear();
  next_ = 0;
  for (const int i : best) {
    if (i < 0) continue;
    maxima_[i].cell = -1;
    round_.push_back(i);
  }
  sort_list(round_, [&](int32_t a, int32_t b) { return better(maxima_[a], maxima_[b]); });
}

CornerProgress FastCorners::advance(Corner* corner) {
  const GreyView& image = pyramid_.level[level()];
  if (row_ <= image.height - kBorder) {
    score_row();
    return CornerProgress::kWorking;
  }
  if (next_ == round_.size()) {
    order_round();
    if (round_.size() > 0) return CornerProgress::kWorking;
    if (order_ == kLevels - 1) return CornerProgress::kEnd;
    ++order_;
    start_level();
    return CornerProgress::kWeaker;
  }
  const Maximum& maximum = maxima_[round_[next_++]];
  *corner = {maximum.x, maximum.y, maximum.score, static_cast<uint8_t>(level())};
  return CornerProgress::kFound;
}

CornerSource* create_fast_corners(Arena& arena, const Config& config, WorkMeter& meter) {
  return arena.create<FastCorners>(config.camera.model.width, config.camera.model.height, meter);
}

}  // namespace pptam
