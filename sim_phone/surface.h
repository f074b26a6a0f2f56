// A textured rectangle: what the emulated world and the things held before the lens are made of.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace pptam::sim {

using Eigen::Vector2d;
using Eigen::Vector3d;

// Reflectance 0 to 1 as 0 to 65535, row major, each level the 2x2 box mean of the one before.
struct Texture {
  struct Level {
    int width = 0;
    int height = 0;
    std::vector<uint16_t> texels;
  };
  std::vector<Level> levels;

  // Bilinear sample of one level, 0 to 65535; (u, v) in texels of level 0, texel i covers [i, i + 1). Clamps at the
  // edge.
  float sample(float u, float v, int level) const {
    const Level& l = levels[static_cast<size_t>(level)];
    const float scale = 1.0f / static_cast<float>(1 << level);
    float x = u * scale - 0.5f;
    float y = v * scale - 0.5f;
    x = x < 0 ? 0 : x;
    y = y < 0 ? 0 : y;
    int ix = static_cast<int>(x);
    int iy = static_cast<int>(y);
    ix = ix > l.width - 2 ? l.width - 2 : ix;
    iy = iy > l.height - 2 ? l.height - 2 : iy;
    float fx = x - static_cast<float>(ix);
    float fy = y - static_cast<float>(iy);
    fx = fx > 1 ? 1 : fx;
    fy = fy > 1 ? 1 : fy;
    const uint16_t* top = l.texels.data() + static_cast<size_t>(iy) * static_cast<size_t>(l.width) + ix;
    const uint16_t* bottom = top + l.width;
    const float a = static_cast<float>(top[0]) + fx * static_cast<float>(top[1] - top[0]);
    const float b = static_cast<float>(bottom[0]) + fx * static_cast<float>(bottom[1] - bottom[0]);
    return a + fy * (b - a);
  }
};

// A rectangle, seen only from the side that v_axis x u_axis points to: rows run downwards as on a printed page.
struct Surface {
  Vector3d origin = Vector3d::Zero();   // of the texture's corner (0, 0), metres
  Vector3d u_axis = Vector3d::UnitX();  // unit vectors along texture columns and rows
  Vector3d v_axis = Vector3d::UnitY();
  double width_m = 0;
  double height_m = 0;
  double texel_m = 0;
  float light = 1;  // illumination, multiplies the reflectance
  Texture texture;
};

}  // namespace pptam::sim
