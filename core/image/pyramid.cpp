#include "image/pyramid.h"

#include <cstring>

#include "base/assert.h"
#include "image/kernels.h"

namespace pptam {
void half_sample(const GreyView& src, const GreyImage& dst) {
  PPTAM_ASSERT(dst.width == src.width / 2 && dst.height == src.height / 2);
  for (int y = 0; y < dst.height; ++y) kernel::half_row(src.row(2 * y), src.row(2 * y + 1), dst.row(y), dst.width);
}

PyramidStorage::PyramidStorage(Arena& arena, int width, int height, int first_level) {
  PPTAM_ASSERT(width >= 0 && height >= 0 && first_level >= 0);
  size_t bytes = 0;
  for (int l = first_level; l < kPyramidLevels; ++l)
    bytes += static_cast<size_t>(width >> l) * static_cast<size_t>(height >> l);
  uint8_t* data = arena.allocate_array<uint8_t>(bytes);
  for (int l = first_level; l < kPyramidLevels; ++l) {
    level[l] = {data, width >> l, height >> l, width >> l};
    if (data) data += static_cast<size_t>(width >> l) * static_cast<size_t>(height >> l);
  }
}

Pyramid build_pyramid(const GreyView& level0, const PyramidStorage& storage) {
  Pyramid pyramid;
  pyramid.level[0] = level0;
  for (int l = 1; l < kPyramidLevels; ++l) {
    half_sample(pyramid.level[l - 1], storage.level[l]);
    pyramid.level[l] = storage.level[l];
  }
  return pyramid;
}

Pyramid copy_pyramid(const Pyramid& source, const PyramidStorage& storage) {
  Pyramid copy;
  for (int l = 0; l < kPyramidLevels; ++l) {
    const GreyView& from = source.level[l];
    const GreyImage& to = storage.level[l];
    PPTAM_ASSERT(to.width == from.width && to.height == from.height);
    for (int y = 0; y < from.height; ++y) std::memcpy(to.row(y), from.row(y), static_cast<size_t>(from.width));
    copy.level[l] = to;
  }
  copy.lamp_lines = source.lamp_lines;
  return copy;
}

GreyImage small_image_storage(Arena& arena, int width, int height) {
  const int level = small_image_level(width, height);
  width >>= level, height >>= level;
  return {arena.allocate_array<uint8_t>(static_cast<size_t>(width) * static_cast<size_t>(height)), width, height,
          width};
}

void make_small_image(const Pyramid& pyramid, const GreyImage& small) {
  const GreyView& source = pyramid.level[small_image_level(pyramid.level[0].width, pyramid.level[0].height)];
  PPTAM_ASSERT(small.width == source.width && small.height == source.height);
  for (int y = 0; y < source.height; ++y) {
    const uint8_t* up = source.row(y > 0 ? y - 1 : 0);
    const uint8_t* mid = source.row(y);
    const uint8_t* down = source.row(y + 1 < source.height ? y + 1 : y);
    for (int x = 0; x < source.width; ++x) {
      const int l = x > 0 ? x - 1 : 0;
      const int r = x + 1 < source.width ? x + 1 : x;
      const int sum = up[l] + 2 * up[x] + up[r] + 2 * (mid[l] + 2 * mid[x] + mid[r]) + down[l] + 2 * down[x] + down[r];
      small.at(x, y) = static_cast<uint8_t>((sum + 8) >> 4);
    }
  }
}

}  // namespace pptam
