#include "sim_phone/compression.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>

namespace pptam::sim {
namespace {

constexpr int kBlock = 8;
using Block = std::array<float, static_cast<size_t>(kBlock) * kBlock>;

// [ITU-T T.81, table K.1], grey levels times 8, as the transform below is orthonormal: steps in grey levels of a
// coefficient.
constexpr Block kSteps = {16, 11, 10, 16, 24,  40,  51,  61,  12, 12, 14, 19, 26,  58,  60,  55,
                          14, 13, 16, 24, 40,  57,  69,  56,  14, 17, 22, 29, 51,  87,  80,  62,
                          18, 22, 37, 56, 68,  109, 103, 77,  24, 35, 55, 64, 81,  104, 113, 92,
                          49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99};

// Row k: the k-th cosine of the orthonormal transform.
Block cosines() {
  Block c{};
  for (int k = 0; k < kBlock; ++k) {
    for (int i = 0; i < kBlock; ++i) {
      const double scale = std::sqrt((k == 0 ? 1.0 : 2.0) / kBlock);
      c[static_cast<size_t>(k * kBlock + i)] =
          static_cast<float>(scale * std::cos((i + 0.5) * k * std::numbers::pi / kBlock));
    }
  }
  return c;
}

// left * in * right', where a flag transposes the cosines: forward C in C', back C' in C.
Block transformed(const Block& in, const Block& c, bool back) {
  const auto at = [&](int row, int column) {
    return back ? c[static_cast<size_t>(column * kBlock + row)] : c[static_cast<size_t>(row * kBlock + column)];
  };
  Block half{}, out{};
  for (int i = 0; i < kBlock; ++i) {
    for (int j = 0; j < kBlock; ++j) {
      float sum = 0;
      for (int k = 0; k < kBlock; ++k) sum += at(i, k) * in[static_cast<size_t>(k * kBlock + j)];
      half[static_cast<size_t>(i * kBlock + j)] = sum;
    }
  }
  for (int i = 0; i < kBlock; ++i) {
    for (int j = 0; j < kBlock; ++j) {
      float sum = 0;
      for (int k = 0; k < kBlock; ++k) sum += half[static_cast<size_t>(i * kBlock + k)] * at(j, k);
      out[static_cast<size_t>(i * kBlock + j)] = sum;
    }
  }
  return out;
}

}  // namespace

void compress(uint8_t* pixels, int width, int height, double coarseness) {
  static const Block kCosines = cosines();
  for (int top = 0; top + kBlock <= height; top += kBlock) {
    for (int left = 0; left + kBlock <= width; left += kBlock) {
      uint8_t* const corner = pixels + static_cast<std::ptrdiff_t>(top) * width + left;
      Block block{};
      for (int i = 0; i < kBlock * kBlock; ++i)
        block[static_cast<size_t>(i)] = static_cast<float>(corner[(i / kBlock) * width + i % kBlock]) - 128;
      Block spectrum = transformed(block, kCosines, false);
      for (size_t i = 0; i < spectrum.size(); ++i) {
        const float step = std::max(1.0f, static_cast<float>(coarseness) * kSteps[i]);
        spectrum[i] = step * std::round(spectrum[i] / step);
      }
      block = transformed(spectrum, kCosines, true);
      for (int i = 0; i < kBlock * kBlock; ++i) {
        corner[(i / kBlock) * width + i % kBlock] =
            static_cast<uint8_t>(std::clamp(block[static_cast<size_t>(i)] + 128.5f, 0.0f, 255.0f));
      }
    }
  }
}

}  // namespace pptam::sim
