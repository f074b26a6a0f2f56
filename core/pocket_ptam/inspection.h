// Functions that judge a whole map, for tests and studies. They are slow.
#pragma once

#include <cstdint>

#include <pocket_ptam/pocket_ptam.h>

namespace pptam {

// How well the map explains its keyframes' measurements: the objective of bundle adjustment at one fixed scale, so that
// maps of the same recording made under different assumptions can be compared.
struct MapFit {
  int measurements = 0;  // count
  // Sum of the Tukey costs of all measurements, and of the costs of the keyframes' velocities against their priors,
  // divided by `measurements`. Unit: squared sigma of a measurement. The scale is 1/4 sigma (half a pixel at level 1).
  float cost = 0;
};
// All zero without measurements.
MapFit map_fit(const System& system);

// Number of connected parts of the map. Two live keyframes are connected when they measure at least common_points
// common map points. 1 for a sound map, 0 without a map.
int map_parts(const System& system, int common_points);

// Hash of poses, points and measurements. Equal maps have equal hashes on every target.
uint64_t map_hash(const System& system);

}  // namespace pptam
