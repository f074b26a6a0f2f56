// The moving-edge search along a contour's normal [vvs 3.2], in integers.
//
//   sample_profile() ─▶ convolution() ─▶ find_edges() ─▶ candidates, with their likelihood by what the site has shown
//
// The oriented mask is 3 pixels wide along the contour and 5 long along its normal, (-1 -2 0 2 1), for every angle: the
// image is sampled bilinearly on the rotated grid, so that the convolution at all places along the normal shares the
// samples, and an edge is where it is and not at the nearest pixel.
//
// The likelihood of [vvs 3.2] compares the convolution with that of the site in the frame before. Here the memory of a
// site is more: its profile of grey values across the edge, against which candidates are correlated. Contrast polarity
// is part of that.
#pragma once

#include <cstdint>

#include <pocket_ptam/image.h>
#include <pocket_ptam/se3.h>

namespace pptam {

constexpr int kMaskHalf = 2;   // samples on either side of the mask's middle
constexpr int kMatchHalf = 5;  // of the remembered profile
constexpr int kMaxRange = 12;  // of a search, on either side
constexpr int kMaxProfile = 2 * (kMaxRange + kMatchHalf) + 1;
constexpr int kMatchSize = 2 * kMatchHalf + 1;

// A grey value has this many units in a profile: the mean of three samples of 1/16 grey, times three.
constexpr int kProfileUnits = 48;
// The convolution of a step of one grey value, at its middle.
constexpr int kStepResponse = 3 * kProfileUnits;

// 2 half + 1 samples of the image at px + k normal, k = -half to half, each the sum of three bilinear samples a pixel
// apart along the contour. px: pixels of this image, 0 <= coordinates < 32768. All samples must lie inside:
// profile_inside(). Values: 0 to 12240.
void sample_profile(const GreyView& image, const Vector2f& px, const Vector2f& normal, int half, int16_t* profile);
namespace plain {  // the specification; elsewhere a form by hand gives the same bits, where there is one that is faster
void sample_profile(const GreyView& image, const Vector2f& px, const Vector2f& normal, int half, int16_t* profile);
}
bool profile_inside(const GreyView& image, const Vector2f& px, const Vector2f& normal, int half);

// The mask's convolution at index i of a profile: |.| <= 36720.
inline int convolution(const int16_t* profile, int i) {
  return profile[i + 2] - profile[i - 2] + 2 * (profile[i + 1] - profile[i - 1]);
}

// What a site has shown: its profile about the edge.
struct SiteMemory {
  int16_t profile[kMatchSize] = {};
  uint8_t seen = 0;  // times, up to 255
};

// How like the remembered profile the part about index i is.
struct Likeness {
  // 0 to 1, linear in their zero-mean normalised correlation above what the best of a texture's edges reaches by
  // chance. Blind to brightness and contrast. 0 where either shows nothing but noise; kUnknown without a memory.
  float shape = 0;
  float contrast = 1;  // ratio of their standard deviations; 1 where shape is 0, and without a memory
};
constexpr float kUnknown = 0.5f;
Likeness likeness(const int16_t* profile, int i, const SiteMemory& memory);
// Blends the profile about index i into the memory: the newest has a quarter's weight.
void learn(const int16_t* profile, int i, SiteMemory* memory);

constexpr int kMaxCandidates = 4;
struct EdgeCandidate {
  float offset = 0;           // along the normal from the middle of the search, pixels of the image
  int index = 0;              // of the extremum in the profile
  float strength = 0;         // 0 to 1, by its contrast
  float likelihood = 0;       // zeta of [vvs eq. 24], 0 to 1: strength and what else is known
  float likeness = kUnknown;  // Likeness::shape
  float contrast = 1;         // Likeness::contrast
  bool known = false;         // whether there is a memory
};

// The most likely edges within range of a profile with half = range + kMatchHalf: extrema of the convolution, refined
// by a parabola; most likely first. Without a memory (not seen) by contrast alone. Returns how many.
int find_edges(const int16_t* profile, int range, const SiteMemory& memory, EdgeCandidate (&found)[kMaxCandidates]);

}  // namespace pptam
