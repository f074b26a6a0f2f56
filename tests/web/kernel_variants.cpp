// The kernels by hand give the bits of the plain ones in WebAssembly, too: with vectors, where base/sse2.h stands in
// for Intel's functions, and without, in words of 64 bits. On x86-64 tests/kernels does this with images of all kinds;
// here each kernel gets numbers drawn at random, extremes among them.
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "image/kernels.h"
#include "mapping/block_product.h"

namespace pptam::test {
namespace {

#if !defined(__wasm_simd128__) && !defined(PPTAM_WORDS)
#error "only the plain kernels: nothing would be compared"
#endif

uint32_t state = 1;
uint32_t random_bits() {  // xorshift
  state ^= state << 13;
  state ^= state >> 17;
  return state ^= state << 5;
}

constexpr int kStride = 64, kRows = 64;
uint8_t image[kStride * kRows];
void draw_image() {
  const uint32_t kind = random_bits() % 3;  // noise, black and white, smooth
  for (int i = 0; i < kStride * kRows; ++i) {
    const uint32_t noise = random_bits();
    image[i] = static_cast<uint8_t>(kind == 0   ? noise
                                    : kind == 1 ? (noise & 1) * 255
                                                : (i % kStride) * 3 + (noise & 3));
  }
}

bool same(const void* a, const void* b, size_t bytes) {
  return std::memcmp(a, b, bytes) == 0;
}

bool half_rows() {
  for (int count = 0; count <= 30; ++count) {
    uint8_t plain_out[32] = {}, out[32] = {};
    plain::half_row(image + count, image + kStride, plain_out, count);
    kernel::half_row(image + count, image + kStride, out, count);
    if (!same(plain_out, out, sizeof out)) return false;
  }
  return true;
}

template <int kRadius>
bool sums() {
  StructureTensor plain_sums[9], found[9];
  const uint8_t* px = image + 20 * kStride + 10 + random_bits() % 30;
  plain::window_sums<kRadius>(px, kStride, plain_sums);
  kernel::window_sums<kRadius>(px, kStride, found);
  return same(plain_sums, found, sizeof found);
}

bool patches() {
  const auto small = [](int32_t range) { return static_cast<int32_t>(random_bits() % (2 * range)) - range; };
  const WarpGrid grid = {.image = image,
                         .stride = kStride,
                         .x_last = kStride - 1,
                         .y_last = kRows - 1,
                         .x = (28 << 16) + small(65536),
                         .y = (28 << 16) + small(65536),
                         .dx_di = 65536 + small(40000),
                         .dy_di = small(40000),
                         .dx_dj = small(40000),
                         .dy_dj = 65536 + small(40000)};
  uint8_t plain_framed[kPatchFramed * kPatchFramed + 16] = {}, framed[sizeof plain_framed] = {};
  const WarpBlur plain_blur = plain::warp(grid, plain_framed), blur = kernel::warp(grid, framed);
  if (!same(&plain_blur, &blur, sizeof blur) || !same(plain_framed, framed, sizeof framed)) return false;

  PackedTemplate plain_packed, packed;
  plain::pack_template(framed, &plain_packed);
  kernel::pack_template(framed, &packed);
  const uint8_t* at = image + (10 + random_bits() % 30) * kStride + 10 + random_bits() % 30;
  if (plain::zmssd_x64(at, kStride, plain_packed, INT32_MAX) != kernel::zmssd_x64(at, kStride, packed, INT32_MAX))
    return false;

  RefineTemplate plain_refined, refined;
  plain::prepare_refinement(framed, &plain_refined);
  kernel::prepare_refinement(framed, &refined);
  RefineSample sample = {};
  sample.image = at;
  sample.stride = kStride;
  sample.x_weight = static_cast<int32_t>(random_bits() % kSubpixels);
  sample.y_weight = static_cast<int32_t>(random_bits() % kSubpixels);
  sample.x_blur = static_cast<int32_t>(random_bits() % 49152) - 32768;
  sample.y_blur = static_cast<int32_t>(random_bits() % 49152) - 32768;
  const RefineSums plain_sums = plain::refine_sums(sample, plain_refined), found = kernel::refine_sums(sample, refined);
  return same(&plain_sums, &found, sizeof found);
}

bool fast_rows() {
  const uint8_t* row = image + 20 * kStride;
  const auto threshold = static_cast<int>(random_bits() % 60);
  int16_t plain_out[kStride] = {}, out[kStride] = {};
  const int plain_count = plain::fast_row(row, kStride, kFastRadius, kStride - 1 - kFastRadius, threshold, plain_out);
  const int count = kernel::fast_row(row, kStride, kFastRadius, kStride - 1 - kFastRadius, threshold, out);
  return plain_count == count && same(plain_out, out, sizeof out);
}

bool products() {
  constexpr int kDepth = 12;
  float a[kBlock * kDepth], b[kBlock * kDepth], plain_c[kBlockNumbers], c[kBlockNumbers];
  const auto number = [] { return static_cast<float>(static_cast<int32_t>(random_bits())) * 1e-9f; };
  for (float& value : a) value = number();
  for (float& value : b) value = number();
  for (int i = 0; i < kBlockNumbers; ++i) plain_c[i] = c[i] = number();
  subtract_product_plain(plain_c, a, b, kDepth);
  subtract_product(c, a, b, kDepth);
  return same(plain_c, c, sizeof c);
}

}  // namespace
}  // namespace pptam::test

// 0, or which kernel differs.
extern "C" [[gnu::visibility("default"), gnu::used]] int kernel_variants(uint32_t seed) {
  using namespace pptam::test;
  state = seed;
  draw_image();
  if (!half_rows()) return 1;
  if (!sums<2>() || !sums<3>()) return 2;
  if (!patches()) return 3;
  if (!fast_rows()) return 4;
  return products() ? 0 : 5;
}
