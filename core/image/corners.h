// Multi-scale Shi-Tomasi corners [phone 3.1]: exhaustive only in L2, then iterative ascent down to L1 and L0. Where
// these are not enough, corners follow that are seen in L1 and L0 only: all of L1 is scored then. Of cameras that are
// searched in L0 (Config::tiny) all is a level finer: L1 is scored and followed down to L0, and then all of L0.
//
// Used once per keyframe and at the start of initialisation, never per tracked frame. Scores come from the integer
// structure tensor of central differences; its minimum eigenvalue is the score. Windows are 7x7 in L0, 5x5 in L1 and
// 3x3 in L2. Wider windows in the coarse levels merge neighbouring corners and move the maximum away from where the
// ascent in the finer level looks: halved frames of a desk and of a phone's video gave 68 to 110 corners with these
// windows, 34 to 69 with 7x7 in all levels.
#pragma once

#include <cstdint>
#include <span>

#include <pocket_ptam/work_meter.h>
#include "image/corner_source.h"
#include "image/kernels.h"
#include "image/pyramid.h"

namespace pptam {

struct Config;

struct CornerParams {
  // Smallest minimum eigenvalue of the structure tensor (mean over the window of products of central differences,
  // grey^2/px^2) at which a pixel counts as a corner, in every level. Lower values admit sensor noise, higher ones
  // leave dim scenes without corners. With noise of 2 grey levels a flat area gives no corner above 1.0. A long
  // straight edge, along which a point cannot be located, gives 3.3 corners a frame at 4.0 and 0.05 at 6.0. A desk
  // dimmed to 30 % still gives 68 to 82 corners at 6.0.
  float min_score = 6.0f;
  // Smallest distance of a corner from the edge of the coarsest level scored, its pixels; at least 5, which the windows
  // of the ascent need. A patch (4 px in the level searched) and the search circle (4 px there) need 4.
  int border = 5;
  int max_ascent_steps = 3;  // in each finer level [phone 3.1: three]; 1 to 5
  // The image is divided into cells_x by cells_y buckets. Each round takes the best corner left in every bucket, so
  // that one textured area does not take all corners. cells_x * cells_y is at most 64. 40 px squares of the phone's
  // image; not swept.
  int cells_x = 6;
  int cells_y = 8;
};

// Minimum eigenvalue of the structure tensor of the 7x7 window centred on (x, y), divided by the 49 pixels; the centre
// must be at least 4 pixels inside. Central differences (I(x+1) - I(x-1)) / 2.
float shi_tomasi_score(const GreyView& image, int x, int y);

// Finds corners one at a time, as CornerSource does. A piece of work is to score one row, to order one round of
// the buckets, or to follow one maximum down to L0. Within a round the strongest comes first. Corner::score is the
// smallest of the minimum eigenvalues in the levels that it was followed through, grey^2/px^2. Two corners are never
// closer than 3 pixels of the finest level scored. No allocation after construction; memory is about 6 bytes for each
// pixel of that level.
class CornerDetector {
 public:
  CornerDetector() = default;
  // search_level: that of the patches to be made of the corners. 0: L1 and L0 are scored; else L2 and L1.
  CornerDetector(Arena& arena, int width_l0, int height_l0, int search_level = 1);

  void start(const Pyramid& pyramid, const CornerParams& params);
  CornerProgress advance(Corner* corner);
  // Runs start() and advance() until out is full, no corner is left, or only weaker ones are and there are `enough`;
  // returns the number of corners.
  int detect(const Pyramid& pyramid, const CornerParams& params, std::span<Corner> out, int enough = 0);

  // Since start(): pixels of the rows scored in both levels, and 3x3 steps made in these and L0. The work meter charges
  // these.
  int scored_pixels() const { return scored_pixels_; }
  int ascent_steps() const { return ascent_steps_; }

 private:
  struct Maximum {  // a local maximum of the score
    float score = 0;
    int16_t x = 0, y = 0;  // pixels of level_
    int16_t cell = 0;      // bucket, row-major; -1: used in an earlier round
  };
  static constexpr int kMaxCells = 64;  // buckets; bounds round_. Not swept
  // Strictly before in the order of a round. The order is total, so that every sort routine gives the same result.
  static bool better(const Maximum& a, const Maximum& b) {
    if (a.score != b.score) return a.score > b.score;
    return a.y != b.y ? a.y < b.y : a.x < b.x;
  }
  struct Position {  // level-0 pixels
    int16_t x = 0, y = 0;
  };
  void start_level(int level);
  void score_row();
  void order_round();
  bool apart(int x, int y) const;  // from all corners found, level-0 pixels
  bool follow(const Maximum& maximum, Corner* corner);

  // The levels in which all pixels are scored.
  int finest_scored_ = 1;
  int coarsest_scored() const { return finest_scored_ + 1; }

  // Scores of a row of level_. Those of the finest level are kept for three rows only.
  float* scores_of(int y) {
    return score_.data() + (level_ == coarsest_scored() ? y : y % 3) * pyramid_.level[level_].width;
  }

  FixedVector<float> score_;           // of each pixel, grey^2/px^2
  FixedVector<StructureTensor> rows_;  // sums over 3 columns, of the last three rows
  FixedVector<Maximum> maxima_;
  FixedVector<Position> taken_;  // of the corners found since start()
  Pyramid pyramid_;
  CornerParams params_;
  int level_ = 0;                           // being scored
  int border_ = 0;                          // pixels of level_
  int row_ = 0;                             // next row to be scored
  InlineVector<int16_t, kMaxCells> round_;  // indices in maxima_: the best left in each bucket, best first
  int next_ = 0;                            // next entry of round_ to be followed
  int scored_pixels_ = 0;
  int ascent_steps_ = 0;
};

// CornerDetector as the corner source that Config names, with CornerParams' defaults.
class ShiTomasiCorners final : public CornerSource {
 public:
  ShiTomasiCorners(Arena& arena, const Config& config, WorkMeter& meter);

  void start(const Pyramid& pyramid) override;
  CornerProgress advance(Corner* corner) override;

 private:
  WorkMeter& meter_;
  CornerDetector detector_;
};

}  // namespace pptam
