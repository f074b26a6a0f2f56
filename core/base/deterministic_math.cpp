#include "base/deterministic_math.h"

#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>

namespace pptam {
namespace {

constexpr float kPi = 3.14159265f;
constexpr float kHalfPi = 1.57079633f;
constexpr float kPiExcess = 8.74227766e-8f;  // kPi - pi; half of it is kHalfPi - pi/2
constexpr float kQuarterPi = 0.785398163f;
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

// pi/2 in three parts. The first two have so few bits (8 and 11) that k times either is exact for |k| < 2^13.
constexpr float kHalfPi1 = 0x1.92p+0f;
constexpr float kHalfPi2 = 0x1.fb4p-12f;
constexpr float kHalfPi3 = 0x1.4442dp-24f;
constexpr float kTrigDomain = 1000.0f;  // radians; k stays below 640, far inside 2^13. Not swept

// ln 2 in two parts. The first has 12 bits, so that k times it is exact for |k| < 2^12; k stays within 116.
constexpr float kLn2Part1 = 0x1.62ep-1f;
constexpr float kLn2Part2 = 0x1.0bfbe8p-15f;
constexpr float kExpDomain = 80.0f;  // exp(+-80) is a normal float32, exp(-88) is not
constexpr float kLog2E = 1.44269504f;
constexpr int kExponentBias = 127, kMantissaBits = 23;  // of float32

// Two thirds of the exponent bias (0x2a555555), less a correction for the mantissa: det_cbrt starts within 6 %.
constexpr uint32_t kCbrtStartBits = 0x2a514067u;

// The polynomials interpolate at the Chebyshev nodes of the reduced interval. Each states its interval and error.

float sin_polynomial(float r) {  // |r| <= pi/4: 1e-8
  const float z = r * r;
  return r + r * z * (-0.1666666466f + z * (0.008332748271f + z * -0.0001958789088f));
}

float cos_polynomial(float r) {  // |r| <= pi/4: 8e-10
  const float z = r * r;
  return 1.0f - 0.5f * z + z * z * (0.04166666466f + z * (-0.001388830304f + z * 2.454794209e-5f));
}

float atan_polynomial(float r) {  // |r| <= tan(pi/8): 3e-8
  const float z = r * r;
  return r + r * z * (-0.3333328656f + z * (0.1999123774f + z * (-0.1402414284f + z * 0.08520492036f)));
}

// sin(x + quarter_turns * pi/2).
float sin_shifted(float x, int quarter_turns) {
  if (!(std::fabs(x) <= kTrigDomain)) return kNan;
  const float scaled = x * (2.0f / kPi);
  const int k = static_cast<int>(scaled + (scaled >= 0.0f ? 0.5f : -0.5f));
  const float kf = static_cast<float>(k);
  const float r = ((x - kf * kHalfPi1) - kf * kHalfPi2) - kf * kHalfPi3;
  switch ((k + quarter_turns) & 3) {
    case 0:
      return sin_polynomial(r);
    case 1:
      return cos_polynomial(r);
    case 2:
      return -sin_polynomial(r);
    default:
      return -cos_polynomial(r);
  }
}

// atan(x) for 0 <= x <= 1.
float atan_octant(float x) {
  constexpr float kTanEighthPi = 0.414213562f;
  return x <= kTanEighthPi ? atan_polynomial(x) : kQuarterPi + atan_polynomial((x - 1.0f) / (x + 1.0f));
}

}  // namespace

float det_sin(float x) {
  return sin_shifted(x, 0);
}

float det_cos(float x) {
  return sin_shifted(x, 1);
}

float det_atan(float x) {
  if (!(x == x)) return kNan;
  const float a = std::fabs(x);
  const float angle = a <= 1.0f ? atan_octant(a) : kHalfPi - (atan_octant(1.0f / a) + 0.5f * kPiExcess);
  return x < 0.0f ? -angle : angle;
}

float det_atan2(float y, float x) {
  if (!(x == x) || !(y == y)) return kNan;
  const float ax = std::fabs(x);
  const float ay = std::fabs(y);
  if (ax == 0.0f && ay == 0.0f) return 0.0f;
  float angle = ay <= ax ? atan_octant(ay / ax) : kHalfPi - (atan_octant(ax / ay) + 0.5f * kPiExcess);
  if (x < 0.0f) angle = kPi - (angle + kPiExcess);
  return y < 0.0f ? -angle : angle;
}

float det_exp(float x) {
  if (!(x == x)) return kNan;
  if (x > kExpDomain) x = kExpDomain;
  if (x < -kExpDomain) x = -kExpDomain;
  const float scaled = x * kLog2E;
  const int k = static_cast<int>(scaled + (scaled >= 0.0f ? 0.5f : -0.5f));
  const float kf = static_cast<float>(k);
  const float r = (x - kf * kLn2Part1) - kf * kLn2Part2;
  // Polynomial of exp(r) for |r| <= ln(2)/2: error 8e-9.
  const float tail = 0.5f + r * (0.1666657703f + r * (0.04166655466f + r * (0.008363173075f + r * 0.001392617612f)));
  const float mantissa = 1.0f + (r + r * r * tail);
  return mantissa * std::bit_cast<float>(static_cast<uint32_t>(k + kExponentBias) << kMantissaBits);
}

float det_cbrt(float x) {
  if (!(std::fabs(x) <= std::numeric_limits<float>::max())) return kNan;
  const float a = std::fabs(x);
  if (a == 0.0f) return 0.0f;
  // The bits of a float, read as an integer, are nearly its logarithm: a third of them starts within 6 %. Each Newton
  // step turns a relative error e into e^2, so that three reach 4e-3, 1e-5 and less than rounding.
  constexpr int kNewtonSteps = 3;
  float y = std::bit_cast<float>(std::bit_cast<uint32_t>(a) / 3u + kCbrtStartBits);
  for (int i = 0; i < kNewtonSteps; ++i) y = y - (y - a / (y * y)) * (1.0f / 3.0f);
  return x < 0.0f ? -y : y;
}

}  // namespace pptam
