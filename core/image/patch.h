// One 8x8 patch: warp it from its source image, find it near a prediction, refine it below a pixel [ptam 5.3, phone 4].
//
// The patch's reference point is the middle of the 8x8 pixels, at template coordinate (3.5, 3.5). A hit at the integer
// top-left pixel (x, y) therefore puts the point at (x + 3.5, y + 3.5). A one-pixel frame round the 8x8 is kept, for
// the template's gradients at its edge.
#pragma once

#include <Eigen/Core>
#include <cstdint>

#include <pocket_ptam/image.h>
#include "image/kernels.h"
#include "image/pyramid.h"

namespace pptam {

constexpr float kPatchCentre = 3.5f;       // pixels from the centre of the 8x8's first pixel, along each axis
constexpr float kMaxSearchRadius = 32.0f;  // pixels; larger radii are reduced to it, to bound the time. Not swept

struct PatchTemplate {
  uint8_t px[kPatchFramed * kPatchFramed] = {};  // row major; the 8x8 starts at (1, 1)
  int32_t sum = 0;                               // of the 8x8 pixels
  int32_t sum_sq = 0;                            // of their squares
  // Bilinear sampling a fraction f past a pixel adds f (1 - f) / 2 times the second difference: a blur. These are the
  // means of f (1 - f) over the patch, along x and y of the template, in units of 2^-16. The refinement allows for
  // them.
  int32_t x_blur = 0;
  int32_t y_blur = 0;
  void add_up();  // sets sum and sum_sq
  // Zero-mean energy, sum_sq - sum^2 / 64, grey^2. Below about 64 x 2^2 (2 grey levels rms) only noise would be
  // matched.
  int32_t energy() const { return sum_sq - ((sum * sum) >> 6); }
};

// Samples the template from source, bilinearly in fixed point:
//   source position = centre + J_src_tpl * ((i, j) - (3.5, 3.5)),  i, j = -1..8 (column, row of the framed template)
// centre in source pixels, J_src_tpl in source pixels per template pixel. False, with out unchanged, when a sample
// falls outside the source image or an element of J_src_tpl is 64 or more. The source is at most 16384 pixels wide and
// high.
bool warp_patch(const GreyView& source, const Eigen::Vector2f& centre, const Eigen::Matrix2f& J_src_tpl,
                PatchTemplate* out);
// Likewise, but leaves out->sum and sum_sq as they are.
bool warp_pixels(const GreyView& source, const Eigen::Vector2f& centre, const Eigen::Matrix2f& J_src_tpl,
                 PatchTemplate* out);

// The mean of several templates' pixels, rounded half up, two pixels in a word at once.
class TemplateMean {
 public:
  static constexpr int kMost = 6;  // templates
  void add(const PatchTemplate& patch);
  void write(int count, PatchTemplate* patch) const;  // of so many; also its sums

 private:
  static constexpr int kWords = kPatchFramed * kPatchFramed / 4;
  uint32_t even_[kWords] = {}, odd_[kWords] = {};  // bytes 0 and 2 of each word of pixels, and 1 and 3: below 2^16 each
};

struct PatchHit {
  int x = 0;  // top-left pixel of the best 8x8
  int y = 0;
  int32_t zmssd = 0;   // zero-mean sum of squared differences over 64 pixels, grey^2
  int candidates = 0;  // positions compared; the work meter charges them
};

// Compares every integer position whose reference point lies within radius pixels of predicted (image pixels) and whose
// 8x8 lies inside the image. True if the best has zmssd <= max_zmssd; hit->candidates is set either way. Ties: the
// first in row-major order.
bool search_patch(const GreyView& image, const PatchTemplate& patch, const Eigen::Vector2f& predicted, float radius,
                  int32_t max_zmssd, PatchHit* hit);

// Compares a template at positions of the caller's choice.
class PatchComparison {
 public:
  explicit PatchComparison(const PatchTemplate& patch);
  // Zero-mean sum of squared differences of the 8x8 whose top-left pixel is (x, y), grey^2; `limit` or more where it is
  // not below `limit`, or not inside the image. limit: 0 to 64 * 255^2.
  int32_t zmssd(const GreyView& image, int x, int y, int32_t limit) const;

 private:
  PackedTemplate packed_;
};

// Under lamp bands the brightness of a patch changes across the shutter's lines. Multiplies the template by the gain,
// linear across the lines, with which the means of its lines fit those of the image's 8x8 at `at` (image pixels, inside
// the image).
void match_light(const GreyView& image, const Eigen::Vector2f& at, LampLines lines, PatchTemplate* patch);

struct RefinedPatch {
  Eigen::Vector2f position = Eigen::Vector2f::Zero();  // of the reference point, image pixels
  float residual = 0;                                  // rms difference after removing the mean, grey levels
  // Information matrix of the position for noise of 1 grey level: sum of J J^T with the mean offset eliminated,
  // grey^2/px^2.
  Eigen::Matrix2f information = Eigen::Matrix2f::Zero();
  int steps = 0;  // iterations made; the work meter charges them
};

// Sub-pixel refinement by 2-DOF ESM: translation and mean offset, J = (grad T + grad I)/2 [phone 4]. start: position of
// the reference point, image pixels. Ends after a step below 0.03 px or after max_steps, with the position reached.
// False when it moves more than 1.5 px from the start, leaves the image, or the normal equations are singular.
bool refine_patch(const GreyView& image, const PatchTemplate& patch, const Eigen::Vector2f& start, int max_steps,
                  RefinedPatch* refined);

}  // namespace pptam
