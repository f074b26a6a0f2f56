#include "image/pyramid.h"

#include <bit>
#include <cstring>

namespace pptam {
namespace {

static_assert(std::endian::native == std::endian::little, "half_sample packs little-endian words");

constexpr uint32_t kEvenBytes = 0x00ff00ffu;

// Two means from two words of four pixels, one above the other: in bits 0-7 and 16-23. A 16-bit lane holds at most
// 4 x 255 + 2 = 1022, so the lanes do not touch.
inline uint32_t two_means(const uint8_t* upper, const uint8_t* lower) {
  uint32_t a, b;
  std::memcpy(&a, upper, sizeof(a));
  std::memcpy(&b, lower, sizeof(b));
  const uint32_t sums =
      (a & kEvenBytes) + ((a >> 8) & kEvenBytes) + (b & kEvenBytes) + ((b >> 8) & kEvenBytes) + 0x00020002u;
  return (sums >> 2) & kEvenBytes;
}

}  // namespace

void half_sample(const GreyView& src, const GreyImage& dst) {
  PPTAM_ASSERT(dst.width == src.width / 2 && dst.height == src.height / 2);
  for (int y = 0; y < dst.height; ++y) {
    const uint8_t* upper = src.row(2 * y);
    const uint8_t* lower = src.row(2 * y + 1);
    uint8_t* out = dst.row(y);
    int x = 0;
    for (; x + 4 <= dst.width; x += 4) {
      const uint32_t left = two_means(upper + 2 * x, lower + 2 * x);
      const uint32_t right = two_means(upper + 2 * x + 4, lower + 2 * x + 4);
      const uint32_t word = ((left | (left >> 8)) & 0xffffu) | ((right | (right >> 8)) << 16);
      std::memcpy(out + x, &word, sizeof(word));
    }
    for (; x < dst.width; ++x)
      out[x] = static_cast<uint8_t>((upper[2 * x] + upper[2 * x + 1] + lower[2 * x] + lower[2 * x + 1] + 2) >> 2);
  }
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
  return copy;
}

}  // namespace pptam
