// A phone flying over a painted plane, drawn cheaply enough to be drawn in an emulator: rolling shutter, one sample a
// pixel, a little noise; whole runs of a hundred frames and more, in which a map starts, grows and is culled.
//
// It makes work of the usual kind and amount; accuracy is judged elsewhere (sim_phone).
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include <pocket_ptam/pocket_ptam.h>
#include "base/deterministic_math.h"

namespace pptam::test {

class PaintedRun {
 public:
  static constexpr int kWidth = 240, kHeight = 320;
  static constexpr float kFrameRate = 15;

  PaintedRun() : texture_(kTexels * kTexels, 128), image_(kWidth * kHeight) {
    camera_.width = kWidth;
    camera_.height = kHeight;
    camera_.fx = camera_.fy = 360;
    camera_.cx = 0.5f * (kWidth - 1);
    camera_.cy = 0.5f * (kHeight - 1);
    shutter_.axis = RollingShutter::Axis::kColumns;
    shutter_.line_time_s = -0.060f / kWidth;
    for (int i = 0; i < 6000; ++i) {  // bright and dark rectangles over each other
      const int x = random(kTexels), y = random(kTexels), w = 6 + random(26), h = 6 + random(26);
      const auto grey = static_cast<uint8_t>(30 + random(200));
      for (int v = y; v < y + h; ++v)
        for (int u = x; u < x + w; ++u) texture_[index(u, v)] = grey;
    }
    const std::vector<uint8_t> sharp = texture_;  // the lens
    for (int v = 0; v < kTexels; ++v) {
      for (int u = 0; u < kTexels; ++u) {
        int sum = 4;
        for (int dv = 0; dv < 3; ++dv)
          for (int du = 0; du < 3; ++du) sum += (du == 1 && dv == 1 ? 0 : 1) * sharp[index(u + du, v + dv)];
        texture_[index(u, v)] = static_cast<uint8_t>(sum / 8);
      }
    }
  }

  Config config() const {
    Config config = Config::phone(camera_);
    config.camera.shutter = shutter_;
    return config;
  }

  // Frame i; its pixels are valid until the next call.
  Frame frame(int i) {
    const float t = static_cast<float>(i) / kFrameRate;
    for (int x = 0; x < kWidth; ++x) {
      const float line_s = (static_cast<float>(x) - camera_.cx) * shutter_.line_time_s;
      const SE3 T_wc = pose(t + line_s);
      // Along the line the ray is a + y b; it meets z = 0 at c - c_z / d_z d.
      const float u = (static_cast<float>(x) - camera_.cx) / camera_.fx;
      const Vector3f a = T_wc.R * Vector3f(u, -camera_.cy / camera_.fy, 1), b = T_wc.R.col(1) / camera_.fy;
      for (int y = 0; y < kHeight; ++y) {
        const float fy = static_cast<float>(y);
        const float s = -T_wc.t.z() / (a.z() + fy * b.z());
        const float wx = T_wc.t.x() + s * (a.x() + fy * b.x()), wy = T_wc.t.y() + s * (a.y() + fy * b.y());
        image_[static_cast<size_t>(y * kWidth + x)] = sample(wx, wy);
      }
    }
    return {image_.data(), kWidth, kHeight, kWidth, PixelFormat::kGrey, static_cast<int64_t>(t * 1e9f) + 1'000'000};
  }

 private:
  static constexpr int kTexels = 1024;  // along each side; then it begins again
  static constexpr float kTexelsPerUnit = 360;

  int random(int n) {
    state_ = state_ * 1664525u + 1013904223u;
    return static_cast<int>((state_ >> 8) % static_cast<uint32_t>(n));
  }
  static size_t index(int u, int v) { return static_cast<size_t>((v & (kTexels - 1)) * kTexels + (u & (kTexels - 1))); }

  // Still for half a second, sideways for two, then round about.
  static SE3 pose(float t) {
    const float s = t < 0.5f ? 0 : t - 0.5f;
    const float eased = s < 1 ? 0.5f * s * s : s - 0.5f;
    const float wander = s < 2 ? 0 : (s - 2) * (s - 2) / (s - 1);
    const float x = 0.12f * eased + 0.25f * det_sin(0.9f * wander), y = 0.22f * wander;
    const float z = 1 + 0.15f * det_sin(0.7f * wander);
    Vector6f turn = Vector6f::Zero();
    turn[3] = 0.30f + 0.1f * det_sin(0.8f * wander);
    turn[4] = 0.1f * det_sin(1.1f * wander);
    turn[5] = 0.2f * det_sin(0.5f * wander);
    Matrix3f down;  // looks down, image upright along the world's y
    down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
    SE3 T_wc;
    T_wc.R = down * SE3::exp(turn).R;
    T_wc.t = Vector3f(x, y, z);
    return T_wc;
  }

  uint8_t sample(float x, float y) {
    // 24.8 texels; the offset keeps them positive.
    const auto u = static_cast<int32_t>((x + 64) * kTexelsPerUnit * 256),
               v = static_cast<int32_t>((y + 64) * kTexelsPerUnit * 256);
    const int fu = u & 255, fv = v & 255;
    const int u0 = u >> 8, v0 = v >> 8;
    const int upper = texture_[index(u0, v0)] * (256 - fu) + texture_[index(u0 + 1, v0)] * fu;
    const int lower = texture_[index(u0, v0 + 1)] * (256 - fu) + texture_[index(u0 + 1, v0 + 1)] * fu;
    state_ = state_ * 1664525u + 1013904223u;
    const int noise = static_cast<int>(state_ >> 30) + static_cast<int>((state_ >> 28) & 3) - 3;
    return static_cast<uint8_t>(((upper * (256 - fv) + lower * fv + 32768) >> 16) + noise);
  }

  CameraModel camera_;
  RollingShutter shutter_;
  std::vector<uint8_t> texture_, image_;
  uint32_t state_ = 1;
};

}  // namespace pptam::test
