// Projected contours and the interaction matrices of a point's distance to them [vvs 3.1].
//
// A contour is a straight segment or a circle in the camera's frame. The limbs of a cylinder are segments, the outline
// of a sphere is a circle: both move over the surface, but their distance to an image point changes as if they were
// fixed to it. Coordinates (x, y) are normalised, (X/Z, Y/Z); distances have the same unit. Interaction matrices are
// for the camera's screw (v, w), with dX/dt = -v - w x X; a pose T <- exp(mu) T is one of mu = -(v, w). All functions
// are pure.
#pragma once

#include <pocket_ptam/se3.h>

namespace pptam {

// Signed distance of an image point from a straight line, x c + y s = rho [vvs eq. 16-21].
struct LineContour {
  float c = 1, s = 0, rho = 0;  // cos theta, sin theta
  float L_theta[6] = {}, L_rho[6] = {};

  // The line through two points of the camera's frame. False when it passes by the camera's centre (end-on) or does not
  // appear in any finite part of the image.
  bool set(const Vector3f& a, const Vector3f& b);

  // d = rho - (x c + y s): of the model's line from the point [eq. 17, 18].
  float distance(float x, float y) const { return rho - (x * c + y * s); }
  // L of the distance, L_rho + alpha L_theta, alpha = x s - y c [eq. 21; its third entry has a minus].
  void interaction(float x, float y, float (&L)[6]) const;
};

// Distance of an image point from an ellipse, the image of a circle or the outline of a sphere [vvs eq. 22, 23].
struct EllipseContour {
  float xg = 0, yg = 0;                // centre
  float mu20 = 0, mu11 = 0, mu02 = 0;  // four times the normalised central moments: semi-axes squared
  float L[5][6] = {};                  // interaction matrix of xg, yg, mu20, mu11, mu02

  // The circle with this centre, unit normal n and radius in the camera's frame. False when it is seen edge-on, or is
  // not an ellipse in the image (not wholly in front of the camera).
  bool set(const Vector3f& centre, const Vector3f& n, float radius);

  // d_e of (22), of order length^4.
  float algebraic(float x, float y) const;
  // d_e divided by the length of its gradient: to first order the distance, positive outside.
  float distance(float x, float y) const;
  // L of distance(), the gradient's length held fixed.
  void interaction(float x, float y, float (&L_d)[6]) const;
};

// Limb `side` (0 or 1) of a cylinder whose axis runs from a to b, camera frame: the segment where a plane through the
// camera's centre touches it. False when the camera is inside the (infinite) cylinder.
bool cylinder_limb(const Vector3f& a, const Vector3f& b, float radius, int side, Vector3f* limb_a, Vector3f* limb_b);

// Outline of a sphere, camera frame: the circle where the rays touch it. False when the camera is inside.
bool sphere_outline(const Vector3f& centre, float radius, Vector3f* Q, Vector3f* n, float* r);

}  // namespace pptam
