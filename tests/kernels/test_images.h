// Images for the kernel tests: owned pixels with any stride, noise, analytic textures, and the hash of the golden
// tests.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include <pocket_ptam/image.h>
#include "tests/support/random.h"

namespace pptam::test {

// Pixels with padding: guard bytes before the first row and after every row, so that a kernel which writes outside its
// image is seen.
class OwnedImage {
 public:
  static constexpr uint8_t kGuard = 0xa5;
  OwnedImage(int width, int height, int stride = 0)
      : width_(width),
        height_(height),
        stride_(stride > 0 ? stride : width),
        pixels_(static_cast<size_t>(kLead + stride_ * height_ + kLead), kGuard) {}
  GreyImage image() { return {pixels_.data() + kLead, width_, height_, stride_}; }
  GreyView view() const { return {pixels_.data() + kLead, width_, height_, stride_}; }
  bool guards_intact() const {
    for (size_t i = 0; i < pixels_.size(); ++i) {
      const int64_t at = static_cast<int64_t>(i) - kLead;
      const bool pixel = at >= 0 && at < int64_t{stride_} * height_ && at % stride_ < width_;
      if (!pixel && pixels_[i] != kGuard) return false;
    }
    return true;
  }
  template <class F>
  OwnedImage& fill(F value) {  // value(x, y), rounded and clamped
    for (int y = 0; y < height_; ++y)
      for (int x = 0; x < width_; ++x)
        image().at(x, y) =
            static_cast<uint8_t>(std::clamp(std::floor(static_cast<double>(value(x, y)) + 0.5), 0.0, 255.0));
    return *this;
  }

 private:
  static constexpr int kLead = 5;  // odd: rows are unaligned
  int width_, height_, stride_;
  std::vector<uint8_t> pixels_;
};

inline OwnedImage random_image(Random& random, int width, int height, int stride = 0) {
  return OwnedImage(width, height, stride).fill([&](int, int) { return random.integer(0, 255); });
}

// Smooth random texture: a sum of sinusoids of random direction and phase, with known gradient. Zero mean, standard
// deviation about contrast.
class Texture {
 public:
  // Frequencies in radians per pixel.
  Texture(Random& random, double contrast, double min_frequency, double max_frequency) {
    for (Wave& wave : waves_) {
      const double frequency = random.uniform(min_frequency, max_frequency);
      const double direction = random.uniform(0, 6.283185307179586);
      wave = {frequency * std::cos(direction), frequency * std::sin(direction), random.uniform(0, 6.283185307179586)};
    }
    amplitude_ = contrast * std::sqrt(2.0 / kWaves);
  }
  double value(double x, double y) const {
    double sum = 0;
    for (const Wave& wave : waves_) sum += std::cos(wave.x * x + wave.y * y + wave.phase);
    return amplitude_ * sum;
  }
  void gradient(double x, double y, double* dx, double* dy) const {
    *dx = *dy = 0;
    for (const Wave& wave : waves_) {
      const double slope = -amplitude_ * std::sin(wave.x * x + wave.y * y + wave.phase);
      *dx += slope * wave.x;
      *dy += slope * wave.y;
    }
  }

 private:
  struct Wave {
    double x = 0, y = 0, phase = 0;
  };
  static constexpr int kWaves = 16;
  Wave waves_[kWaves];
  double amplitude_ = 0;
};

// A picture made of integers only, the same on every target: blocks, ramps and a little noise.
inline OwnedImage golden_image(int width, int height) {
  uint32_t state = 12345;
  return OwnedImage(width, height, width + 3).fill([&](int x, int y) {
    state = state * 1664525u + 1013904223u;
    const uint32_t cell = (static_cast<uint32_t>(x / 11) * 73856093u) ^ (static_cast<uint32_t>(y / 9) * 19349663u);
    const int block = static_cast<int>((cell * 2654435761u) >> 25);  // 0..127
    return 40 + block + (x * 3 + y * 5) % 37 + static_cast<int>(state >> 29);
  });
}

class Fnv {
 public:
  void add(const void* data, size_t bytes) {
    for (size_t i = 0; i < bytes; ++i) hash_ = (hash_ ^ static_cast<const uint8_t*>(data)[i]) * 1099511628211ull;
  }
  template <class T>
  void add_value(const T& value) {
    add(&value, sizeof(value));
  }
  void add_image(const GreyView& image) {
    for (int y = 0; y < image.height; ++y) add(image.row(y), static_cast<size_t>(image.width));
  }
  uint64_t value() const { return hash_; }

 private:
  uint64_t hash_ = 14695981039346656037ull;
};

}  // namespace pptam::test
