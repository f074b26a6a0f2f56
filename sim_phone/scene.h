// The world before the emulated phone: textured rectangles in metres, z up, a table top (or the floor) at z = 0.
//
// Everything is painted once, when the scene is made, into mip-mapped reflectances in linear light. What lies flat on a
// surface (pages, pens, posters) is part of that surface's texture; boxes are rectangles of their own.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "sim_phone/harshness.h"
#include "sim_phone/surface.h"

namespace pptam::sim {

// What a hand needs to know of the scene to move sensibly in it.
struct Stage {
  enum class Kind { kTable, kCorner } kind = Kind::kTable;
  double azimuth_rad = 0;      // kTable: direction from the scene's middle towards the person
  double min_height_m = 0.27;  // kTable: of the camera
  bool mirrored = false;       // kCorner: starts at the wall x = 0 instead of the wall y = 0
  bool cluttered = false;      // there are views in which no plane dominates
};

struct Scene {
  std::vector<Surface> surfaces;
  float background = 0.15f;  // where no surface is hit
  Stage stage;
  std::string model;  // its known object, .cao text; empty: its things, model_text()
};

// The checkerboard scene: corner (i, j), 0 <= i <= kCheckerColumns, 0 <= j <= kCheckerRows, lies at
// ((i - kCheckerColumns / 2) * kCheckerSquare_m, (j - kCheckerRows / 2) * kCheckerSquare_m, 0).
constexpr int kCheckerColumns = 20;
constexpr int kCheckerRows = 20;
constexpr double kCheckerSquare_m = 0.03;

// Depth at which the ray origin + depth * direction first meets a surface from its visible side; infinity: nowhere.
double first_hit(const Scene& scene, const Vector3d& origin, const Vector3d& direction);

// Scene::model; or the things of the scene as a model for `pocket-ptam model`, .cao text in the scene's frame: a face
// for each surface but those longer than kLargestThing_m, the table, floor and walls. Empty: there is no such thing.
constexpr double kLargestThing_m = 1;
std::string model_text(const Scene& scene);

// "desk", "boxes", "walls", "checkerboard" (alone, all its squares alike), "plane", "clutter", "sparse", "tiles",
// "board" (a checkerboard on the desk), "postcards" (two of them on a bare table), "same_tiles" ("tiles" without
// anything that tells one from another), "front" (an upright board on the desk).
std::vector<std::string> scene_names();
// Is z = 0 a plane of this scene that a map should find?
bool ground_plane_known(const std::string& scene);

// name is one of scene_names(). Different seeds give other objects in other places under other light. Of harsh, bare
// and repeats count, in scenes with a table full of pages or with walls.
Scene make_scene(const std::string& name, uint64_t seed, const Harshness& harsh = {});

}  // namespace pptam::sim
