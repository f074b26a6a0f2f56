#include "sim_phone/gloss.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace pptam::sim {
namespace {

// Radiance that a texel of 1 stands for; white paper in the scene's light has 1. A lamp that lights a table seen within
// a third of a steradian sends out pi / (1/3), about 10 times as much as white paper there.
constexpr float kBrightest = 12;
constexpr double kFace_m = 2;  // of the cube, in the canvas' unit
constexpr double kFaceTexel_m = kFace_m / 128;
constexpr int kRoughness = 2;  // mip level: 32 texels for 90 degrees blur by about 3 degrees, a printed cover's gloss

constexpr float kCoatCell_m = 0.09f;    // glossy and matt parts
constexpr float kReliefCell_m = 0.04f;  // the varnish's waves
constexpr float kReliefSlope = 0.05f;   // of their sides: 3 degrees at most

Texture room_wall(bool window, Random& random) {
  Canvas canvas(kFace_m, kFace_m, kFaceTexel_m);
  const Place place(0, 0, 0);
  canvas.rectangle(place, -1, -1, 3, 3, random.uniform(0.025, 0.05));
  for (int i = 0; i < 8; ++i) {  // shelves and doors
    const double x = random.uniform(0, 1.6), y = random.uniform(0.8, 1.6), w = random.uniform(0.1, 0.5);
    canvas.rectangle(place, x, y, x + w, 2, random.uniform(0.005, 0.05));
  }
  if (window) {
    const double x = random.uniform(0.2, 0.8), w = random.uniform(0.5, 0.9);
    for (int pane = 0; pane < 2; ++pane)
      canvas.rectangle(place, x + 0.5 * w * pane, 0.35, x + 0.5 * w * pane + 0.45 * w, 1.05, random.uniform(0.5, 0.9));
  }
  return canvas.finish();
}

Texture room_ceiling(Random& random) {
  Canvas canvas(kFace_m, kFace_m, kFaceTexel_m);
  const Place place(0, 0, 0);
  canvas.rectangle(place, -1, -1, 3, 3, 0.05);
  const int lamps = random.integer(2, 4);
  for (int i = 0; i < lamps; ++i) {
    const double x = random.uniform(0.2, 1.6), y = random.uniform(0.2, 1.6);
    if (random.chance(0.5)) {
      canvas.rectangle(place, x, y, x + random.uniform(0.3, 0.6), y + 0.1, 0.9);  // a tube
    } else {
      const double radius = random.uniform(0.06, 0.14);
      canvas.ellipse(Place(x, y, 0), radius, radius, 1);
    }
  }
  return canvas.finish();
}

}  // namespace

Gloss::Gloss(double reflectance, uint64_t seed)
    : reflectance_(static_cast<float>(reflectance)),
      coats_(static_cast<uint32_t>(mixed(seed + 0x61))),
      relief_(static_cast<uint32_t>(mixed(seed + 0x62))) {
  Random random(seed, 52);
  const int window = random.integer(0, 3);
  for (int face = 0; face < 4; ++face) room_[static_cast<size_t>(face)] = room_wall(face == window, random);
  room_[4] = room_ceiling(random);
  room_[5] = room_wall(false, random);  // the floor
}

float Gloss::radiance(const Eigen::Vector3f& d) const {
  int axis = 0;
  for (int i = 1; i < 3; ++i) {
    if (std::abs(d[i]) > std::abs(d[axis])) axis = i;
  }
  // Upright faces: horizontally along the other axis, downwards from +z.
  const float scale = 1 / std::abs(d[axis]);
  const float x = axis == 0 ? d[1] : d[0];
  const float y = axis == 2 ? d[1] : -d[2];
  const float to_texels = static_cast<float>(0.5 * kFace_m / kFaceTexel_m);
  const Texture& face = room_[2 * static_cast<size_t>(axis) + (d[axis] < 0 ? 1 : 0)];
  return kBrightest / 65535 * face.sample((1 + x * scale) * to_texels, (1 + y * scale) * to_texels, kRoughness);
}

float Gloss::seen(const Surface& surface, float u_m, float v_m, const Eigen::Vector3f& direction, float diffuse) {
  // Surfaces differ by where they are.
  const float u = u_m + static_cast<float>(7 * surface.origin.x() + 3 * surface.origin.z());
  const float v = v_m + static_cast<float>(7 * surface.origin.y() + 5 * surface.origin.z());
  const float coat = std::clamp(8 * (coats_(u / kCoatCell_m, v / kCoatCell_m) - 0.45f), 0.0f, 1.0f);
  if (coat == 0) return diffuse;
  const Eigen::Vector3f u_axis = surface.u_axis.cast<float>(), v_axis = surface.v_axis.cast<float>();
  const float slope_u = kReliefSlope * (2 * relief_(u / kReliefCell_m, v / kReliefCell_m) - 1);
  const float slope_v = kReliefSlope * (2 * relief_(u / kReliefCell_m + 57.3f, v / kReliefCell_m) - 1);
  const Eigen::Vector3f normal = (v_axis.cross(u_axis) + slope_u * u_axis + slope_v * v_axis).normalized();
  const Eigen::Vector3f d = direction.normalized();
  const float cosine = std::max(0.0f, -normal.dot(d));
  const float rest = 1 - cosine;
  const float mirrored = coat * (reflectance_ + (1 - reflectance_) * rest * rest * rest * rest * rest);
  return (1 - mirrored) * diffuse + mirrored * surface.light * radiance(d + 2 * cosine * normal);
}

}  // namespace pptam::sim
