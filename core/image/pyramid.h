// The five-level image pyramid, 240x320 down to 15x20 [phone 3.1].
#pragma once

#include <pocket_ptam/image.h>
#include "base/containers.h"

namespace pptam {

constexpr int kPyramidLevels = 5;  // levels 0 to 4 [phone 3.1]

// Lines of a rolling shutter along which lamps that flicker draw bands; kNone where the light is steady.
enum class LampLines : uint8_t { kNone, kRows, kColumns };

// Level 0 may point into the camera's buffer; levels 1 to 4 point into a PyramidStorage.
struct Pyramid {
  GreyView level[kPyramidLevels];
  LampLines lamp_lines = LampLines::kNone;
};

// Storage for levels first_level..4 of a width x height image, tightly packed, in one allocation.
struct PyramidStorage {
  GreyImage level[kPyramidLevels];
  PyramidStorage() = default;
  PyramidStorage(Arena& arena, int width, int height, int first_level);
};

// dst(x, y) = (a + b + c + d + 2) >> 2 over the 2x2 block at (2x, 2y); rounding half up. dst is floor(w/2) x
// floor(h/2): an odd last row or column of src is ignored.
void half_sample(const GreyView& src, const GreyImage& dst);

// Fills storage levels 1..4 from level0 and returns views of all five. Level 0 is not copied.
Pyramid build_pyramid(const GreyView& level0, const PyramidStorage& storage);

// Copies a whole pyramid (level 0 included) into storage made with first_level = 0.
Pyramid copy_pyramid(const Pyramid& source, const PyramidStorage& storage);

// Level of the small images of a width x height camera: 4, 15x20 pixels on the phone. 3 where that has fewer than 150
// pixels, half the phone's: in 10x7 of 160x120, of which 8x5 are interior, hardly a turn can be seen.
constexpr int small_image_level(int width, int height) {
  constexpr int kCoarsest = kPyramidLevels - 1, kMinPixels = 150;
  return (width >> kCoarsest) * (height >> kCoarsest) < kMinPixels ? kCoarsest - 1 : kCoarsest;
}
// An image of that level for each camera.
GreyImage small_image_storage(Arena& arena, int width, int height);

// Writes the pyramid's small_image_level(), blurred by the 3x3 binomial kernel (1 2 1), into `small`, which has its
// size. At the border the edge pixels are repeated.
void make_small_image(const Pyramid& pyramid, const GreyImage& small);

}  // namespace pptam
