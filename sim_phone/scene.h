// The world before the emulated phone: textured rectangles in metres, z up, a table top (or the floor) at z = 0.
//
// Everything is painted once, when the scene is made, into mip-mapped reflectances in linear light. What lies flat on a
// surface (pages, pens, posters) is part of that surface's texture; boxes are rectangles of their own.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
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

// What a hand needs to know of the scene to move sensibly in it.
struct Stage {
  enum class Kind { kTable, kCorner } kind = Kind::kTable;
  double azimuth_rad = 0;      // kTable: direction from the scene's middle towards the person
  double min_height_m = 0.27;  // kTable: of the camera
  bool mirrored = false;       // kCorner: starts at the wall x = 0 instead of the wall y = 0
  bool cluttered = false;      // there are views in which no plane dominates
};

struct Scene {
  std::vector<Surface> surfaces;
  float background = 0.15f;  // where no surface is hit
  Stage stage;
};

// The checkerboard scene: corner (i, j), 0 <= i <= kCheckerColumns, 0 <= j <= kCheckerRows, lies at
// ((i - kCheckerColumns / 2) * kCheckerSquare_m, (j - kCheckerRows / 2) * kCheckerSquare_m, 0).
constexpr int kCheckerColumns = 20;
constexpr int kCheckerRows = 20;
constexpr double kCheckerSquare_m = 0.03;

// Depth at which the ray origin + depth * direction first meets a surface from its visible side; infinity: nowhere.
double first_hit(const Scene& scene, const Vector3d& origin, const Vector3d& direction);

// name is one of scene_names(). Different seeds give other objects in other places under other light.
Scene make_scene(const std::string& name, uint64_t seed);

}  // namespace pptam::sim
