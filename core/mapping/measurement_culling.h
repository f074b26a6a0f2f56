// Measurement culling: removes measurements of a point beyond the most useful ones [phone 3.2].
//
// Usefulness is the information that would be lost. V = sum_j V_j is the information about a point's position, and
// V_j = w_j B_j^T Sigma_j^-1 B_j is keyframe j's part of it (B_j the projection's Jacobian, w_j the M-estimator's
// weight). m_j = |V| - |V - V_j| is the usefulness of keyframe j for the point.
//
// Called by the mapper.
#pragma once

#include "map/map.h"

namespace pptam {

// ARMv6 instructions of measure_usefulness() for one measurement, as counted for the ARM1176 (tests/budget).
constexpr int64_t kUsefulnessInstructions = 210;

// m[j]: usefulness m_j of each of the point's measurements, up to a common factor. Lens distortion is left out: it
// changes all by nearly the same factor.
void measure_usefulness(const Map& map, const Camera& camera, const MapPoint& point, float* m);

// Removes the point's least useful measurements until Map::max_measurements_per_point() are left. The measurement in
// the patch's source keyframe always stays.
void cull_measurements(Map& map, int point, const Camera& camera, WorkMeter& meter);

}  // namespace pptam
