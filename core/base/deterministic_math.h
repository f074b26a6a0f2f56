// sin, cos, atan, atan2, exp and cbrt with the same bits on every target. (The C libraries' functions differ in the
// last bit.) float32 polynomials, evaluated without fused multiply-add. sqrt is exact by IEEE 754: use std::sqrt. The
// error is below 2 ulp of 1 (2.4e-7) on the stated domains, 3 ulp for atan2; it is relative for exp and cbrt. Unit
// tests compare with double precision. NaN in, NaN out.
#pragma once

namespace pptam {

// x in radians, |x| <= 1000 (reduced to [-pi/4, pi/4] in float32 with a three-part pi/2); NaN outside.
float det_sin(float x);
float det_cos(float x);

float det_atan(float x);            // result in [-pi/2, pi/2]
float det_atan2(float y, float x);  // result in [-pi, pi]; (0, 0) gives 0

float det_exp(float x);   // x clamped to [-80, 80]
float det_cbrt(float x);  // |x| in [1e-30, 1e30], or 0

}  // namespace pptam
