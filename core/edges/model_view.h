// The object as a camera sees it: its visible contours, and sites along them.
//
//   ModelParts   what does not change: sides of faces told apart, joined where two faces share them
//   ModelView    at one pose: which faces are turned to the camera, the contours in the camera's frame, what hides what
//
// A contour has a fixed index: sides and lines first, then two limbs for each cylinder, circles, spheres. Whether a
// site is hidden is computed for its ray and each occluder's plane; nothing is drawn. Cost: sites times occluders whose
// bounding box in the image holds the site.
#pragma once

#include <algorithm>
#include <array>

#include <pocket_ptam/camera.h>
#include <pocket_ptam/model_tracker.h>
#include "base/containers.h"
#include "edges/contour.h"

namespace pptam {

constexpr int kMaxPoints = 4096, kMaxSides = 4096, kMaxFaces = 2048, kMaxCurved = 1024;

// A side of faces, or a line of its own.
struct ModelSide {
  int a = 0, b = 0;        // points
  int face[2] = {-1, -1};  // the first two that have it; -1: none
  int faces = 0;           // how many have it
  // Two faces meet in it at a small angle: only seen as an outline. Or a face has it twice, as a bridge to a hole.
  bool smooth = false;
  float min_length_px = 0;
};

class ModelParts {
 public:
  // The model must be valid and outlive this.
  ModelParts(Arena& arena, const ObjectModel& model);

  const ObjectModel& model() const { return model_; }
  std::span<const ModelSide> sides() const { return sides_; }
  std::span<const Vector3f> normals() const { return normals_; }  // of faces, outwards, unit; zero: none
  int contours() const;          // sides that faces share count once; known once it is built
  int contours_at_most() const;  // known before
  int occluders() const;         // at most: faces, cylinders, spheres
  ModelFeature feature(int contour) const;
  Vector3f middle() const { return middle_; }  // of the bounding box, object frame
  float extent() const { return extent_; }     // half the bounding box' diagonal

 private:
  void add_side(int a, int b, int face, float min_length_px);

  ObjectModel model_;
  FixedVector<ModelSide> sides_;
  FixedVector<Vector3f> normals_;
  FixedVector<int> same_point_;  // the first point at the same place
  Vector3f middle_ = Vector3f::Zero();
  float extent_ = 1;
};

// A contour in the camera's frame.
struct PlacedContour {
  bool straight = true;
  Vector3f a = Vector3f::Zero(), b = Vector3f::Zero();  // ends of a segment; of a circle centre and unit normal
  // Of a circle: unit vectors that span its plane; sites begin at u and turn to v.
  Vector3f u = Vector3f::Zero(), v = Vector3f::Zero();
  float radius = 0;
};

// A place on a contour where the edge is sought.
struct ContourSite {
  uint16_t contour = 0;
  uint8_t bucket = 0;  // place along the contour, in parts of kSiteBuckets
  Vector2f px;         // level 0, where the moving camera sees it
  Vector2f normal;     // unit, in the image
  Vector3f p_c;        // camera frame, at the frame's timestamp
};
constexpr int kSiteBuckets = 64;

class ModelView {
 public:
  ModelView(Arena& arena, const ModelParts& parts, const Camera& camera);

  // Finds the visible contours at T_co.
  void set_pose(const SE3& T_co);
  const SE3& T_co() const { return T_co_; }
  // Of the contours that face the camera, how much of their length lies within the image: 0 to 1.
  float share_in_image() const { return facing_px_ > 0 ? std::min(inside_px_ / facing_px_, 1.0f) : 0; }
  // Fills sites of `level` along the visible contours, about spacing level pixels apart, farther where else there would
  // be more than sites->capacity() of them; those of a contour one after the other. Left out: what is hidden, outside
  // the image, and at coarse levels contours too small to be seen there. velocity: of T_co, for the rolling shutter.
  // Returns their spacing, level pixels.
  float make_sites(int level, float spacing, const Vector6f& velocity, FixedVector<ContourSite>* sites) const;

  // The contour at a pose, whether visible or not. False: it cannot be seen there (inside a cylinder, ...).
  bool place(int contour, const SE3& T_co, PlacedContour* placed) const;

 private:
  struct Visible {
    int contour = -1;
    PlacedContour placed;
    float from = 0, to = 1;  // part of a segment within the image, in normalised image coordinates along it, 0 to 1
    uint64_t buckets = 0;    // of a closed contour: bit i, whether part i of kSiteBuckets reaches into the image
    float length_px = 0;     // of what is within the image, level 0
    float width_px = 0;      // smallest extent of a closed contour, level 0
  };
  struct Occluder {
    int face = -1;  // or a quadrangle or a disc of its own
    bool disc = false;
    std::array<Vector2f, 4> corner = {Vector2f::Zero(), Vector2f::Zero(), Vector2f::Zero(),
                                      Vector2f::Zero()};  // of a quadrangle
    EllipseContour ellipse;                               // of a disc
    Vector3f inverse_depth = Vector3f::Zero();            // 1/Z = this . (x, y, 1)
    float x0 = 0, y0 = 0, x1 = 0, y1 = 0;                 // bounding box, normalised
  };

  void place_faces();
  void add_face_occluder(int face);
  void add_solid_occluders();
  void add_visible(int contour, float least);
  void add_closed(Visible* visible, float min_area_px2);
  bool clip(const Vector2f& p, const Vector2f& q, float* from, float* to) const;
  void add_straight_sites(const Visible& visible, int count, const Vector6f& velocity, int level,
                          FixedVector<ContourSite>* sites) const;
  void add_arc_sites(const Visible& visible, int first, int end, int count, const Vector6f& velocity, int level,
                     FixedVector<ContourSite>* sites) const;
  bool hidden(float x, float y, float inverse_depth) const;
  bool inside(const Occluder& occluder, float x, float y) const;
  void add_site(const Visible& visible, const Vector3f& p_c, const Vector3f& tangent, float along,
                const Vector6f& velocity, int level, FixedVector<ContourSite>* sites) const;

  const ModelParts& parts_;
  const Camera& camera_;
  float focal_;              // level-0 pixels, mean
  float x0_, y0_, x1_, y1_;  // the image in normalised coordinates, with a small margin
  SE3 T_co_;
  FixedVector<Vector3f> points_;  // camera frame
  FixedVector<Vector2f> image_;   // normalised; of points before the camera
  FixedVector<uint8_t> facing_;   // faces turned to the camera
  FixedVector<Visible> visible_;
  float facing_px_ = 0, inside_px_ = 0;  // length of contours that face the camera, and of it within the image
  float most_px_ = 0;                    // of the former, a side's per model unit
  FixedVector<Occluder> occluders_;
};

}  // namespace pptam
