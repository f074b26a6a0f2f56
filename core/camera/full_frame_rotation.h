// The visual gyroscope: rotation between successive frames from the 15x20 level [phone 4], or from images about as
// small of a camera with more pixels.
//
// Direct 3-DOF efficient second-order minimisation (ESM) with gain and offset and Huber weights. It needs no map, so it
// serves every tracking state. No allocation after construction. Without a map and at a narrow field of view it
// measures *apparent* rotation: 0.1 m/s sideways at 1 m looks like 5.7 degrees/s. With a map, give the motion model's
// translation divided by the scene's depth; then only the residual rotation is estimated. Lamps that flicker draw bands
// along the lines of a rolling shutter, which move from frame to frame and look like a turn: when they are seen, each
// line has a gain of its own.
#pragma once

#include <span>

#include <pocket_ptam/camera.h>
#include "base/containers.h"
#include "geometry/normal_equations.h"
#include "image/pyramid.h"

namespace pptam {

struct RotationEstimate {
  Matrix3f R_cp = Matrix3f::Identity();        // previous camera to current camera
  Matrix3f covariance = Matrix3f::Identity();  // of omega in R_cp <- R_cp exp(omega), rad^2
  float residual = 0;                          // rms after gain and offset, grey levels
  int iterations = 0;
  bool ok = false;    // enough overlap and texture, converged
  bool near = false;  // ok, or only convergence is missing: good enough to start a wide search
  // Share of the squared residuals that a gain for each of the shutter's lines explains or would explain. 0 without a
  // rolling shutter. Small under steady light, and most of them under bands (tests/unit).
  float line_share = 0;
};

// Whether lamps draw bands along the shutter's lines, from RotationEstimate::line_share of the frames so far.
class LampBands {
 public:
  void note(float line_share);
  bool seen() const { return seen_; }

 private:
  float mean_share_ = 0;
  bool seen_ = false;
};

// ARMv6, of an iteration besides its pixels (Work::kRotationPixel): scale and solution, as counted.
constexpr int64_t kRotationStepInstructions = 5500;

class FullFrameRotation {
 public:
  FullFrameRotation(Arena& arena, const Camera& camera);  // its model is of level 0, prepared

  // Aligns `current` with `previous`, both made by make_small_image() from images of the camera's size. R_start: start
  // for R_cp. t_over_depth: translation of T_cp divided by the scene's mean depth; zero without a map. lamp_bands:
  // gives each of the shutter's lines a gain of its own; in steady light that only wastes information.
  RotationEstimate estimate(const GreyView& previous, const GreyView& current, const Matrix3f& R_start,
                            const Vector3f& t_over_depth, bool lamp_bands = false);

  // The shutter's lines; kNone of a global shutter.
  LampLines lines() const { return shutter_lines_; }
  int pixels() const { return width_ * height_; }  // of the images aligned

 private:
  friend class RobustFit<FullFrameRotation>;
  struct Pixel {       // a pixel of the small image
    Vector2f ray;      // (x/z, y/z) of its centre
    Matrix23f J_px_w;  // small-image pixels per radian of omega, for p <- exp(omega) p
  };
  // Model: I_c(project(R exp(omega) x + t/d)) = gain(x) I_p(x) + offset, over the interior pixels of the previous
  // image. gain(x) is linear in the image coordinates, because vignetting changes a point's brightness when the camera
  // turns. At up to 60 degrees/s with natural vignetting the error is 0.10 degrees rms; with one gain for all pixels,
  // 0.46.
  struct Gain {
    float gain = 1, x = 0, y = 0;  // ratio at the middle, and its change per unit of scaled coordinates (sum_row())
    float offset = 0;              // grey levels
  };
  static constexpr int kUnknowns = 7;  // omega, gain, offset, gain_x, gain_y
  // Sums of a line of the shutter, for its gain.
  struct Line {
    float u_I[kUnknowns] = {};  // sums of w u I, with lamp bands
    float I_e = 0, I_I = 0;     // sums of w I e and w I^2
    float gain = 0;             // to be added to the pixels', a ratio
    void clear_sums() { *this = {.gain = gain}; }
    void add(const float (&sums)[kUnknowns]);
  };

  // Interface for RobustFit, which sums by image rows.
  bool errors(int iteration);
  void scale();
  int residuals() const { return height_; }
  void sum(int from, int to);
  FitStep step(int iteration);

  static GreyView reduced(const GreyView& small, std::span<const GreyImage> levels);
  void warp(const GreyView& current, const Matrix3f& R_cp, const Vector3f& t_over_depth);
  void sum_row(int y);
  void eliminate_lines();
  float line_share() const;

  CameraModel camera_;
  LampLines shutter_lines_;
  int small_level_;  // of the small images
  int level_;        // of the images aligned: that, or a coarser one
  int width_, height_;
  FixedVector<GreyImage> previous_levels_, current_levels_;  // coarser than the small images
  FixedVector<Pixel> pixels_;
  FixedVector<Line> lines_;      // rows or columns of the small image; none of a global shutter
  FixedVector<int16_t> warped_;  // the current image as the previous camera would see it, 1/16 grey; kOutside elsewhere

  // State of the estimate in progress.
  bool lamp_bands_ = false;
  float huber_ = 0;  // threshold of this iteration, grey levels
  GreyView previous_, current_;
  Vector3f t_over_depth_;
  Gain gain_;
  NormalEquations<kUnknowns> equations_;
  float cost_ = 0;  // weighted sum of squared residuals, grey^2
  int count_ = 0;   // pixels used
  RotationEstimate result_;
};

}  // namespace pptam
