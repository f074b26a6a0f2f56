// FAST-10 corners of four pyramid levels [ptam 5.1, 6.2]: where ten neighbouring pixels of a circle of sixteen are all
// brighter, or all darker, than the middle. Of a cluster the pixel with the greatest Shi-Tomasi score is taken.
//
// Used once per keyframe and at the start of initialisation, never per tracked frame. The test itself is in
// image/kernels.h (fast_row).
#pragma once

#include <cstdint>

#include <pocket_ptam/work_meter.h>
#include "image/corner_source.h"
#include "image/pyramid.h"

namespace pptam {

// A corner source for four levels, in the order L1, L0, L2, L3: corners of L1 can be found in most views, and an
// initialiser that needs few corners gets these alone. kWeaker comes between two levels. A piece of work is to score
// one row, or to order one round. Within a level each round has the best corner left in every cell of the image, the
// strongest first. Corner::score is shi_tomasi_score(), at least kMinScore. Two corners of a level are never adjacent.
// No allocation after construction; memory is 0.8 bytes for each pixel of the image.
class FastCorners final : public CornerSource {
 public:
  static constexpr int kLevels = 4;
  // Grey levels. The difference of two pixels with noise of 2 grey levels exceeds it in 4 of 10000 pairs: that of ten
  // in a row and the same pixel hardly ever does. Not swept.
  static constexpr int kThreshold = 10;
  static constexpr float kMinScore = 6.0f;  // as of CornerParams: weak edges and noise are below it
  // Pixels of the level: a framed 8x8 patch stays inside, and so does the score's window.
  static constexpr int kBorder = 6;

  FastCorners(Arena& arena, int width_l0, int height_l0, WorkMeter& meter);

  void start(const Pyramid& pyramid) override;
  CornerProgress advance(Corner* corner) override;

 private:
  static constexpr int kCellsX = 8, kCellsY = 6;  // 80 px squares of 640x480; not swept
  struct Maximum {                                // a local maximum of the score
    float score = 0;
    int16_t x = 0, y = 0;
    int16_t cell = 0;  // row-major; -1: used in an earlier round
  };
  // Strictly before in the order of a round. The order is total, so that every sort routine gives the same result.
  static bool better(const Maximum& a, const Maximum& b) {
    if (a.score != b.score) return a.score > b.score;
    return a.y != b.y ? a.y < b.y : a.x < b.x;
  }
  int level() const;
  void start_level();
  void score_row();
  void suppress_row(int y);
  void order_round();

  WorkMeter& meter_;
  Pyramid pyramid_;
  FixedVector<float> scores_;                       // of the last three rows; 0: no corner
  FixedVector<int16_t> columns_;                    // of one row's corners
  FixedVector<int16_t> before_;                     // of the row before
  FixedVector<Maximum> maxima_;                     // of the level
  int order_ = 0;                                   // place of the level in the order
  int row_ = 0;                                     // next one to be scored
  InlineVector<int32_t, kCellsX * kCellsY> round_;  // indices in maxima_, best first
  int next_ = 0;                                    // next entry of round_
};

}  // namespace pptam
