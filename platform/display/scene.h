// What one picture shows, as plain data: the renderer draws it and knows no more.
//
// Three layers, one over the other: the camera's image, the world as a camera with lens and rolling shutter sees it,
// and flat things on the canvas (marks, bars, letters). World coordinates and poses as in pocket_ptam.h. The canvas is
// the whole picture in pixels, y down, its top-left corner at (0, 0), so that pixel centres are at halves.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <pocket_ptam/camera.h>
#include "platform/camera_picture.h"

namespace pptam::platform {

struct Rgba {
  uint8_t r = 0, g = 0, b = 0, a = 255;  // alpha is not multiplied in
};

// A rectangle of the canvas, pixels.
struct Area {
  float x = 0, y = 0, width = 0, height = 0;
};

struct WorldVertex {
  Vector3f p_w = Vector3f::Zero();
  Rgba colour;
};
// Straight between its points on the canvas, and as wide everywhere: lens and shutter bend what has many points. Where
// two pieces meet they share their ends: corners need lines of their own.
struct WorldLine {
  std::vector<WorldVertex> points;
  float width_px = 1;  // of the canvas
};
// Triangles, three indices each.
struct WorldMesh {
  std::vector<WorldVertex> vertices;
  std::vector<uint16_t> triangles;
};
struct WorldPoint {
  Vector3f p_w = Vector3f::Zero();
  Rgba colour;
  float diameter_px = 3;  // of the canvas
};

// Things that stand in the world. The renderer keeps a model until its revision changes.
struct WorldModel {
  uint64_t revision = 0;
  std::vector<WorldLine> ground;   // drawn first, without depth
  WorldMesh shadow;                // over the ground, without depth
  WorldMesh faces;                 // seen from where their corners run counter-clockwise
  std::vector<WorldLine> edges;    // on the faces
  std::vector<WorldLine> wires;    // in space, hidden by nothing
  std::vector<WorldPoint> points;  // likewise
};

// From where the world is seen, and where on the canvas.
struct Eye {
  pptam::Camera camera;  // prepared
  SE3 T_cw;
  Vector6f velocity = Vector6f::Zero();  // of the camera during the readout, as TrackResult::velocity
  float near_z = 1e-3f;                  // world units: what is nearer is not drawn
  float near_faces_z = 1e-3f;            // likewise, of faces: the larger, the better the depth tells them apart
};

// A box with round corners: also discs, rings and strokes.
struct Shape {
  Vector2f centre = Vector2f::Zero();      // canvas
  Vector2f half = Vector2f::Zero();        // of the box without its round corners, pixels
  Vector2f direction = Vector2f::UnitX();  // of the box's first axis
  float radius = 0;                        // of the corners
  float stroke = 0;                        // width of the outline; 0: filled
  Rgba colour;
};

// A rectangle of the letters' image on the canvas.
struct Glyph {
  Area at, from;  // canvas pixels; pixels of the image
  Rgba colour;
};

// How much of each pixel letters cover. Kept by the renderer until the revision changes.
struct LetterImage {
  uint64_t revision = 0;
  int width = 0, height = 0;
  std::vector<uint8_t> cover;
};

struct Scene {
  int width = 0, height = 0;  // of the canvas
  int turn_degrees = 0;       // of the canvas on the screen, clockwise: 0, 90, 180, 270
  Rgba background;
  Area view;                       // where image and world are; what reaches out of it is cut off
  std::optional<Picture> picture;  // what is shown of it fills the view
  std::vector<Shape> marks;        // over image and ground, under what stands on it; cut off with the view
  std::optional<Eye> eye;          // its camera's image fills the view
  std::vector<const WorldModel*> models;
  std::vector<Shape> shapes;  // over all
  std::vector<Glyph> glyphs;  // over these
  const LetterImage* letters = nullptr;
};

}  // namespace pptam::platform
