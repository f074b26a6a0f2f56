// The work meter: each stage charges its work, and a phone profile turns the charges into time.
//
// A stage charges the number of units it did (pixels converted, candidates compared, ...). The profile states how many
// executed ARMv6 instructions one unit costs; time is instructions x cycles per instruction / clock rate. With the work
// clock a whole run is therefore a pure function of its input.
#pragma once

#include <array>
#include <cstdint>

namespace pptam {

enum class Work : uint8_t {
  kGreyPixel,         // one pixel converted to grey
  kPyramidPixel,      // one output pixel of a pyramid level
  kCornerPixel,       // one pixel scored and non-maximum suppressed in L2
  kCornerAscent,      // one 3x3 step of the ascent in L1 or L0
  kRotationPixel,     // one pixel in one iteration of full-frame rotation
  kPointProjected,    // one map point projected and tested for visibility
  kPatchWarp,         // one 8x8 template warped
  kPatchCandidate,    // one candidate position compared by zero-mean SSD
  kPatchRefineStep,   // one iteration of sub-pixel refinement
  kPosePoint,         // one point in one iteration of the pose update
  kPoseProjection,    // one point projected and differentiated, in a relinearising iteration of the pose update
  kHomographyPoint,   // one point in one iteration of the homography update
  kKeyframePixel,     // two pixels copied into a keyframe
  kBundleError,       // one measurement projected, for its error
  kBundleProjection,  // one measurement projected and differentiated, its share of the normal equations
  kBundleMotion,      // one measurement's further share when its keyframe's velocity is an unknown
  kBundleBlock,       // one 6x6 product of two cameras' couplings to a point
  kBundleSolve,       // one 6x6 product of the reduced camera system's factorisation
  kBundleStep,        // one measurement's share of a point's step
  kOther,             // one instruction
  kCount
};
constexpr int kWorkKinds = static_cast<int>(Work::kCount);

struct PhoneProfile {
  float clock_mhz = 412.0f;             // MHz, the ARM1176 of the 2009 phone [phone 3]
  float cycles_per_instruction = 1.5f;  // ratio, assumed, not measured; every modelled time is proportional to it
  // ARMv6 instructions per unit of each Work, as counted in emulation (tests/budget). kKeyframePixel is an estimate.
  std::array<float, kWorkKinds> instructions = {
      9.0f,  // kGreyPixel, of BGRA; YUYV takes 5, RGB 14
      7.0f,  // kPyramidPixel
      85,    // kCornerPixel
      1450,  // kCornerAscent: includes ordering the corners
      250,   // kRotationPixel
      430,   // kPointProjected: includes choosing the points to search
      4100,  // kPatchWarp
      110,   // kPatchCandidate: most are rejected after two rows of eight pixels
      2800,  // kPatchRefineStep: with its share of the preparation
      750,   // kPosePoint: for 50 to 100 points
      265,   // kPoseProjection
      1000,  // kHomographyPoint
      1,     // kKeyframePixel
      150,   // kBundleError
      565,   // kBundleProjection
      425,   // kBundleMotion
      295,   // kBundleBlock
      370,   // kBundleSolve
      91,    // kBundleStep
      1,     // kOther
  };
};

class WorkMeter {
 public:
  explicit WorkMeter(const PhoneProfile& profile = {}) { set_profile(profile); }
  void charge(Work kind, int64_t units) {
    const int i = static_cast<int>(kind);
    units_[i] += units;
    spent_ += units * price_[i];
  }
  // ARMv6 instructions charged so far, by the profile's prices.
  int64_t instructions() const { return spent_ >> kFraction; }
  // Work that would take longer than int64_t holds stays at its last instant.
  int64_t modelled_ns() const {
    const double ns = static_cast<double>(instructions()) * profile_.cycles_per_instruction * 1e3 / profile_.clock_mhz;
    return ns < 0x1p63 ? static_cast<int64_t>(ns) : INT64_MAX;
  }
  int64_t units(Work kind) const { return units_[static_cast<int>(kind)]; }
  const PhoneProfile& profile() const { return profile_; }
  // Also prices again what has been charged already.
  void set_profile(const PhoneProfile& profile) {
    profile_ = profile;
    spent_ = 0;
    for (int i = 0; i < kWorkKinds; ++i) {
      price_[i] = static_cast<int64_t>(profile.instructions[i] * (1 << kFraction));
      spent_ += units_[i] * price_[i];
    }
  }

 private:
  // Fixed point, because background jobs read the sum every few thousand instructions: converting all charges from
  // float each time would cost as many instructions again.
  static constexpr int kFraction = 8;  // bits after the point: prices are multiples of 1/256 instruction. Not swept
  PhoneProfile profile_;
  std::array<int64_t, kWorkKinds> units_ = {};
  std::array<int64_t, kWorkKinds> price_ = {};  // per unit, instructions * 2^kFraction
  int64_t spent_ = 0;                           // sum of units_ * price_, instructions * 2^kFraction
};

}  // namespace pptam
