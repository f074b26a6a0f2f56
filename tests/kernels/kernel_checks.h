// Runs every kernel's plain version and the target's on one input made of arbitrary bytes, and compares all bits.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

#include "image/kernels.h"

namespace pptam::test {

constexpr const char* kKernelNames[] = {"bgra_row",  "half_row",          "window_sums<2>", "window_sums<3>", "warp",
                                        "zmssd_x64", "zmssd_x64_of_four", "refine_sums",    "fast_row"};
constexpr int kCheckBytes = 700;  // fewer are filled up with zeros

inline const char* variant_name() {
#if defined(PPTAM_WORDS)
  return "words";
#elif defined(__ARM_FEATURE_SIMD32) && defined(__ARM_NEON)
  return "armv6, neon and plain";
#elif defined(__ARM_FEATURE_SIMD32)
  return "armv6";
#elif defined(__ARM_NEON)
  return "neon and plain";
#elif defined(__SSE2__)
  return "sse2";
#else
  return "plain";
#endif
}

// The name of the first kernel whose outputs differ, or null. break_one: the kernel whose output is falsified by one
// bit, to see that the comparison works.
inline const char* first_different_kernel(std::span<const uint8_t> input, const char* break_one = "") {
  std::vector<uint8_t> bytes(kCheckBytes, 0);
  std::copy_n(input.begin(), std::min(input.size(), bytes.size()), bytes.begin());
  size_t next = 0;
  const auto number = [&](int low, int high) { return low + bytes[next++] % (high - low + 1); };
  // Every piece gets memory of its own, exactly as long as the kernel may read, so that a sanitizer sees a byte too
  // many.
  const auto pixels = [&](int count) {
    std::vector<uint8_t> copy(static_cast<size_t>(count));
    for (size_t i = 0; i < copy.size(); ++i) copy[i] = bytes[(next + i) % bytes.size()];
    return copy;
  };
  const auto differ = [&](const char* name, const void* plain, void* variant, size_t size) {
    if (std::strcmp(name, break_one) == 0) *static_cast<uint8_t*>(variant) ^= 1;
    return std::memcmp(plain, variant, size) != 0;
  };

  {
    const int count = number(0, 67), offset = number(0, 3);
    const std::vector<uint8_t> source = pixels(4 * count + offset);
    std::vector<uint8_t> plain(static_cast<size_t>(count) + 4), variant = plain;
    plain::bgra_row(source.data() + offset, plain.data(), count);
    kernel::bgra_row(source.data() + offset, variant.data(), count);
    if (differ("bgra_row", plain.data(), variant.data(), plain.size())) return "bgra_row";
  }
  {
    const int count = number(0, 67), offset = number(0, 3);
    const std::vector<uint8_t> upper = pixels(2 * count + offset), lower = pixels(2 * count + 1);
    std::vector<uint8_t> plain(static_cast<size_t>(count) + 4), variant = plain;
    plain::half_row(upper.data() + offset, lower.data() + 1, plain.data(), count);
    kernel::half_row(upper.data() + offset, lower.data() + 1, variant.data(), count);
    if (differ("half_row", plain.data(), variant.data(), plain.size())) return "half_row";
  }
  {
    constexpr int kReach = 3 + 2;
    const int stride = number(2 * kReach + 2, 2 * kReach + 9);
    const std::vector<uint8_t> image = pixels(2 * kReach * stride + 2 * kReach + 2);
    const uint8_t* centre = image.data() + kReach * stride + kReach;
    StructureTensor plain[9], variant[9];
    plain::window_sums<2>(centre, stride, plain);
    kernel::window_sums<2>(centre, stride, variant);
    if (differ("window_sums<2>", plain, variant, sizeof plain)) return "window_sums<2>";
    plain::window_sums<3>(centre, stride, plain);
    kernel::window_sums<3>(centre, stride, variant);
    if (differ("window_sums<3>", plain, variant, sizeof plain)) return "window_sums<3>";
  }
  {
    // Steps of up to 1.5 px along both axes; the first sample where all fit, in every eighth case at the last pixels.
    constexpr int kLast = kPatchFramed - 1, kLongest = 1 + 2 * kLast * 3 / 2;  // px
    WarpGrid grid = {};
    const int width = kLongest + number(1, 9), height = kLongest + number(1, 9);
    grid.stride = width + number(0, 3);
    grid.x_last = width - 1, grid.y_last = height - 1;
    const auto fraction = [&] { return number(0, 255) * 256 + number(0, 255); };  // 2^-16 px
    const auto step = [&] { return fraction() + number(0, 1) * 32768 - 65536; };
    grid.dx_di = step(), grid.dx_dj = step(), grid.dy_di = step(), grid.dy_dj = step();
    const bool at_end = number(0, 7) == 0;
    const auto first = [&](int32_t di, int32_t dj, int last) {
      const int32_t low = -kLast * (std::min(di, 0) + std::min(dj, 0));
      const int32_t high = last * 65536 - kLast * (std::max(di, 0) + std::max(dj, 0));
      return 128 + (at_end ? high : std::min(high, low + number(0, 8) * 65536 + fraction()));
    };
    grid.x = first(grid.dx_di, grid.dx_dj, grid.x_last);
    grid.y = first(grid.dy_di, grid.dy_dj, grid.y_last);
    const std::vector<uint8_t> image = pixels((height - 1) * grid.stride + width);
    grid.image = image.data();
    std::vector<uint8_t> plain(kPatchFramed * kPatchFramed + sizeof(WarpBlur)), variant = plain;
    const auto keep = [](const WarpBlur& blur, std::vector<uint8_t>* out) {
      std::memcpy(out->data() + kPatchFramed * kPatchFramed, &blur, sizeof blur);
    };
    keep(plain::warp(grid, plain.data()), &plain);
    keep(kernel::warp(grid, variant.data()), &variant);
    if (differ("warp", plain.data(), variant.data(), plain.size())) return "warp";
  }
  const std::vector<uint8_t> framed = pixels(kPatchFramed * kPatchFramed);
  {
    const int stride = number(kPatchSize, kPatchSize + 9);
    const int32_t limit = number(0, 255) * number(0, 255) * 4096;
    const std::vector<uint8_t> image = pixels((kPatchSize - 1) * stride + kPatchSize);
    PackedTemplate plain_template, variant_template;
    plain::pack_template(framed.data(), &plain_template);
    kernel::pack_template(framed.data(), &variant_template);
    // Beyond the limit any number will do.
    const int32_t plain = std::min(limit, plain::zmssd_x64(image.data(), stride, plain_template, limit));
    int32_t variant = std::min(limit, kernel::zmssd_x64(image.data(), stride, variant_template, limit));
    if (differ("zmssd_x64", &plain, &variant, sizeof plain)) return "zmssd_x64";
  }
  {
    const int stride = number(kPatchSize + 3, kPatchSize + 12);
    const int32_t limit = number(0, 255) * number(0, 255) * 4096 >> number(0, 12);
    const std::vector<uint8_t> image = pixels((kPatchSize - 1) * stride + kPatchSize + 3);
    PackedTemplate packed;
    kernel::pack_template(framed.data(), &packed);
    PackedTemplate plain_template;
    plain::pack_template(framed.data(), &plain_template);
    int32_t plain[4], variant[4] = {limit, limit, limit, limit};
    for (int i = 0; i < 4; ++i)
      plain[i] = std::min(limit, plain::zmssd_x64(image.data() + i, stride, plain_template, limit));
    // Where it is not used there is none but the plain one.
    kernel::zmssd_x64_of_four(image.data(), stride, kernel::kFourAtOnce ? packed : plain_template, limit, variant);
    for (int32_t& zmssd : variant) zmssd = std::min(limit, zmssd);
    if (differ("zmssd_x64_of_four", plain, variant, sizeof plain)) return "zmssd_x64_of_four";
  }
  {
    RefineSample sample;
    sample.stride = number(kPatchFramed + 1, kPatchFramed + 9);
    sample.x_weight = number(0, kSubpixels);
    sample.y_weight = number(0, kSubpixels);
    sample.x_blur = number(0, 16384 / 64) * 64 - number(0, 32768 / 128) * 128;
    sample.y_blur = number(0, 16384 / 64) * 64 - number(0, 32768 / 128) * 128;
    const std::vector<uint8_t> image = pixels(kPatchFramed * sample.stride + kPatchFramed + 1);
    sample.image = image.data();
    RefineTemplate plain_template = {}, variant_template = {};
    plain::prepare_refinement(framed.data(), &plain_template);
    kernel::prepare_refinement(framed.data(), &variant_template);
    const RefineSums plain = plain::refine_sums(sample, plain_template);
    RefineSums variant = kernel::refine_sums(sample, variant_template);
    if (differ("refine_sums", &plain, &variant, sizeof plain)) return "refine_sums";
  }
  {
    const int count = number(0, 67), threshold = number(0, 254), stride = count + 2 * kFastRadius + number(0, 3);
    const std::vector<uint8_t> image = pixels(2 * kFastRadius * stride + count + 2 * kFastRadius);
    const uint8_t* row = image.data() + kFastRadius * stride;
    const int first = kFastRadius, last = kFastRadius + count - 1;
    std::vector<int16_t> plain(static_cast<size_t>(count) + 1), variant = plain;  // the last one: their number
    plain.back() = static_cast<int16_t>(plain::fast_row(row, stride, first, last, threshold, plain.data()));
    variant.back() = static_cast<int16_t>(kernel::fast_row(row, stride, first, last, threshold, variant.data()));
    if (differ("fast_row", plain.data(), variant.data(), plain.size() * sizeof(int16_t))) return "fast_row";
  }
  return nullptr;
}

}  // namespace pptam::test
