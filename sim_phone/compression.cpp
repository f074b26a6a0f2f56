#include "sim_phone/compression.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>

namespace pptam::sim {
namespace {

constexpr int kBlock = 8;
using DctBlock = std::array<float, static_cast<size_t>(kBlock) * kBlock>;

// [ITU-T T.81, table K.1], grey levels times 8, as the transform below is orthonormal: steps in grey levels of a
// coefficient.
constexpr DctBlock kLuminanceSteps = {16, 11, 10, 16, 24,  40,  51,  61,  12, 12, 14, 19, 26,  58,  60,  55,
                                      14, 13, 16, 24, 40,  57,  69,  56,  14, 17, 22, 29, 51,  87,  80,  62,
                                      18, 22, 37, 56, 68,  109, 103, 77,  24, 35, 55, 64, 81,  104, 113, 92,
                                      49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99};

size_t place_in_block(int row, int column) {
  return static_cast<size_t>(row) * kBlock + static_cast<size_t>(column);
}

// Row k: the k-th cosine of the orthonormal transform.
DctBlock cosines() {
  DctBlock c{};
  for (int k = 0; k < kBlock; ++k) {
    for (int i = 0; i < kBlock; ++i) {
      const double scale = std::sqrt((k == 0 ? 1.0 : 2.0) / kBlock);
      c[place_in_block(k, i)] = static_cast<float>(scale * std::cos((i + 0.5) * k * std::numbers::pi / kBlock));
    }
  }
  return c;
}

// left * in * right', where a flag transposes the cosines: forward C in C', back C' in C.
DctBlock transformed(const DctBlock& in, const DctBlock& c, bool back) {
  const auto at = [&](int row, int column) {
    return back ? c[place_in_block(column, row)] : c[place_in_block(row, column)];
  };
  DctBlock half{}, out{};
  for (int i = 0; i < kBlock; ++i) {
    for (int j = 0; j < kBlock; ++j) {
      float sum = 0;
      for (int k = 0; k < kBlock; ++k) sum += at(i, k) * in[place_in_block(k, j)];
      half[place_in_block(i, j)] = sum;
    }
  }
  for (int i = 0; i < kBlock; ++i) {
    for (int j = 0; j < kBlock; ++j) {
      float sum = 0;
      for (int k = 0; k < kBlock; ++k) sum += half[place_in_block(i, k)] * at(j, k);
      out[place_in_block(i, j)] = sum;
    }
  }
  return out;
}

}  // namespace

void compress(uint8_t* pixels, int width, int height, double coarseness) {
  static const DctBlock kCosines = cosines();
  for (int top = 0; top + kBlock <= height; top += kBlock) {
    for (int left = 0; left + kBlock <= width; left += kBlock) {
      uint8_t* const corner = pixels + static_cast<std::ptrdiff_t>(top) * width + left;
      const auto offset = [width](int i) { return static_cast<std::ptrdiff_t>(i / kBlock) * width + i % kBlock; };
      DctBlock block{};
      for (int i = 0; i < kBlock * kBlock; ++i)
        block[static_cast<size_t>(i)] = static_cast<float>(corner[offset(i)]) - 128;
      DctBlock spectrum = transformed(block, kCosines, false);
      for (size_t i = 0; i < spectrum.size(); ++i) {
        const float step = std::max(1.0f, static_cast<float>(coarseness) * kLuminanceSteps[i]);
        spectrum[i] = step * std::round(spectrum[i] / step);
      }
      block = transformed(spectrum, kCosines, true);
      for (int i = 0; i < kBlock * kBlock; ++i) {
        corner[offset(i)] = static_cast<uint8_t>(std::clamp(block[static_cast<size_t>(i)] + 128.5f, 0.0f, 255.0f));
      }
    }
  }
}

}  // namespace pptam::sim
