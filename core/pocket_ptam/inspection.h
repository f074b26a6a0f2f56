// For laboratories and tests: what judges a map, slowly.
#pragma once

#include <cstdint>

#include <pocket_ptam/pocket_ptam.h>

namespace pptam {

// How well the map explains what its keyframes measured: the bundle's objective at one fixed scale, so that maps of the
// same recording made under different assumptions can be compared.
struct MapFit {
  int measurements = 0;
  // Mean Tukey cost of a measurement at a scale of a quarter of its sigma (half a pixel), and the share of the
  // keyframes' velocities, whose prior is the camera's motion. Squared sigmas.
  float cost = 0;
};
MapFit map_fit(const System& system);

// Into how many parts the map falls where live keyframes hold together by at least so many common points: 1 for a
// sound map, 0 without one.
int map_parts(const System& system, int common_points);

// Of poses, points and measurements: equal maps on every target have equal hashes.
uint64_t map_hash(const System& system);

}  // namespace pptam
