// Multi-scale Shi-Tomasi corners [phone 3.1]: exhaustive only in L2, then iterative ascent down to L1 and L0.
//
// Called once per keyframe and at the start of initialisation, never per tracked frame. Scores come from the integer
// structure tensor of central differences; the minimum eigenvalue decides. Windows are 7x7 in L0, 5x5 in L1 and 3x3 in
// L2, of nearly equal size on the image: wide ones in the coarse levels merge neighbouring corners and pull the maximum
// away from where the finer level looks (halved frames of a desk and of a phone's video gave 68 to 110 corners so, and
// 34 to 69 with 7x7 everywhere).
#pragma once

#include <cstdint>
#include <span>

#include "image/pyramid.h"

namespace pptam {

struct Corner {
  int16_t x = 0;  // level-0 pixels
  int16_t y = 0;
  float score = 0;  // smallest of the minimum eigenvalues of L0, L1, L2; mean squared gradient, grey^2 / px^2
};

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
  int cells_x = 6;
  int cells_y = 8;
};

// Minimum eigenvalue of the structure tensor of the 7x7 window centred on (x, y), divided by the 49 pixels; the centre
// must be at least 4 pixels inside. Central differences (I(x+1) - I(x-1)) / 2.
float shi_tomasi_score(const GreyView& image, int x, int y);

struct StructureTensor {  // sums of products of gradients
  int32_t xx = 0;
  int32_t xy = 0;
  int32_t yy = 0;
  void operator+=(const StructureTensor& other) {
    xx += other.xx;
    xy += other.xy;
    yy += other.yy;
  }
  void operator-=(const StructureTensor& other) {
    xx -= other.xx;
    xy -= other.xy;
    yy -= other.yy;
  }
};

struct CornerCandidate {
  Corner corner;
  int32_t cell = 0;  // bucket, row-major
  int32_t turn = 0;  // rank within its bucket
};

// Scratch for detect_corners: the L2 score image, its column sums, and the maxima before bucketing.
struct CornerScratch {
  FixedVector<float> score;              // L2 pixels
  FixedVector<StructureTensor> columns;  // L2 columns
  FixedVector<CornerCandidate> candidates;
  CornerScratch() = default;
  CornerScratch(Arena& arena, int width_l0, int height_l0);
};

struct CornerStats {
  int ascent_steps = 0;  // 3x3 steps made in L1 and L0: what the work meter charges
};

// Writes up to out.size() corners, spread by buckets, in a deterministic order; returns their number. Two corners are
// never closer than 6 level-0 pixels.
int detect_corners(const Pyramid& pyramid, const CornerParams& params, CornerScratch& scratch, std::span<Corner> out,
                   CornerStats* stats);

}  // namespace pptam
