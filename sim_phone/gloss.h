// Reflections on glossy parts of the scene: a varnish that is nowhere quite flat mirrors a room with lamps and a
// window.
//
// What is mirrored depends on the place, the normal and the direction of view: highlights wander over a surface as the
// camera moves, and hide or imitate what is painted on it.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>

#include "sim_phone/paint.h"
#include "sim_phone/surface.h"

namespace pptam::sim {

class Gloss {
 public:
  // reflectance: of the varnish, seen along the normal (Schlick's approximation elsewhere).
  Gloss(double reflectance, uint64_t seed);

  // diffuse, the light that a surface sends out at (u_m, v_m) on it, becomes what leaves it towards the camera, the
  // mirrored room included. direction: from the camera, of any length.
  float seen(const Surface& surface, float u_m, float v_m, const Eigen::Vector3f& direction, float diffuse);

 private:
  float radiance(const Eigen::Vector3f& direction) const;

  float reflectance_;
  std::array<Texture, 6> room_;  // faces of a cube: +x, -x, +y, -y, +z, -z
  ValueNoise coats_, relief_;
};

}  // namespace pptam::sim
