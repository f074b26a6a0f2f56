// Multi-scale Shi-Tomasi corners [phone 3.1]: exhaustive only in L2, then iterative ascent down to L1 and L0.
//
// Used once per keyframe and at the start of initialisation, never per tracked frame. Scores come from the integer
// structure tensor of central differences; the minimum eigenvalue decides. Windows are 7x7 in L0, 5x5 in L1 and 3x3 in
// L2, of nearly equal size on the image: wide ones in the coarse levels merge neighbouring corners and pull the maximum
// away from where the finer level looks (halved frames of a desk and of a phone's video gave 68 to 110 corners so, and
// 34 to 69 with 7x7 everywhere).
#pragma once

#include <cstdint>
#include <span>

#include <pocket_ptam/work_meter.h>
#include "image/corner_source.h"
#include "image/kernels.h"
#include "image/pyramid.h"

namespace pptam {

struct CornerParams {
  // Smallest minimum eigenvalue of the structure tensor (mean over the window of squared central differences,
  // grey^2/px^2) at which a pixel counts as a corner, in every level. Lower admits sensor noise, higher starves dim
  // scenes. With noise of 2 grey levels a flat area gives no corner above 1.0, and a long straight edge, along which a
  // point cannot be located, gives 3.3 a frame at 4.0 and 0.05 at 6.0. A desk dimmed to 30 % still gives 68 to 82
  // at 6.0.
  float min_score = 6.0f;
  // No corners nearer to the L2 image's edge (at least 5, for the ascent's windows): a patch and the search's circle in
  // L1 take 4.
  int border_l2 = 5;
  int max_ascent_steps = 3;  // [phone 3.1]; at most 5
  // The image is divided into cells_x x cells_y buckets; corners are taken in turns from each, best first, so that one
  // textured area does not take them all.
  int cells_x = 6;  // cells_x * cells_y at most 64
  int cells_y = 8;
};

// Minimum eigenvalue of the structure tensor of the 7x7 window centred on (x, y), divided by the 49 pixels; the centre
// must be at least 4 pixels inside. Central differences (I(x+1) - I(x-1)) / 2.
float shi_tomasi_score(const GreyView& image, int x, int y);

// Finds corners one after the other, as CornerSource says. A piece of work is a row of L2 scored, one turn through the
// buckets put into order, or one maximum of L2 followed to L0. By turns from the buckets, the strongest in L2 first.
// Corner::score is the smallest of the minimum eigenvalues in L0, L1 and L2: mean squared gradient, grey^2 / px^2. Two
// corners are never closer than 6 level-0 pixels. No allocation; memory is about 10 bytes for each L2 pixel.
class CornerDetector {
 public:
  CornerDetector() = default;
  CornerDetector(Arena& arena, int width_l0, int height_l0);

  void start(const Pyramid& pyramid, const CornerParams& params);
  CornerProgress advance(Corner* corner);
  // Both for all that fit into out; returns their number.
  int detect(const Pyramid& pyramid, const CornerParams& params, std::span<Corner> out);

  // L2 pixels of the rows scored, and 3x3 steps made in L1 and L0, since start: what the work meter charges.
  int scored_pixels() const { return scored_pixels_; }
  int ascent_steps() const { return ascent_steps_; }

 private:
  struct Maximum {  // of the L2 score
    float score = 0;
    int16_t x = 0, y = 0;  // L2 pixels
    int16_t cell = 0;      // bucket, row-major; -1: had its turn
  };
  static constexpr int kMaxCells = 64;
  // Both orders are total, so that every sort routine gives the same result.
  static bool better(const Maximum& a, const Maximum& b) {
    if (a.score != b.score) return a.score > b.score;
    return a.y != b.y ? a.y < b.y : a.x < b.x;
  }
  void score_row();
  void order_turn();
  bool follow(const Maximum& maximum, Corner* corner);

  FixedVector<float> score_;           // L2 pixels
  FixedVector<StructureTensor> rows_;  // 3 x L2 width
  FixedVector<Maximum> maxima_;
  FixedVector<Corner> taken_;
  Pyramid pyramid_;
  CornerParams params_;
  int border_ = 0;                         // L2 pixels
  int row_ = 0;                            // of L2, the next to be scored
  InlineVector<int16_t, kMaxCells> turn_;  // the best maximum left in each bucket when the turn began, best first
  int next_ = 0;                           // in turn_
  int scored_pixels_ = 0;
  int ascent_steps_ = 0;
};

// The detector as Config's corner source.
class ShiTomasiCorners final : public CornerSource {
 public:
  ShiTomasiCorners(Arena& arena, int width_l0, int height_l0, WorkMeter& meter)
      : meter_(meter), detector_(arena, width_l0, height_l0) {}

  void start(const Pyramid& pyramid) override;
  CornerProgress advance(Corner* corner) override;

 private:
  WorkMeter& meter_;
  CornerDetector detector_;
};

}  // namespace pptam
