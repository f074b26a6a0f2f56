// Models of known objects from files: .cao (V1, the text format of the best-known model-based tracker) and Wavefront
// OBJ; and where such an object is: .pos, a 4x4 matrix, .init.
//
// Files are hostile: every error is an InputError with file, line and what is wrong; nothing is read beyond fixed
// numbers of files, lines and entries. Both formats are told apart by what is in them.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <pocket_ptam/model_tracker.h>

namespace pptam::platform {

// A model and its arrays.
struct ModelFile {
  std::vector<Vector3f> points;
  std::vector<int> corners;
  std::vector<ModelLine> lines;
  std::vector<ModelFace> faces;
  std::vector<ModelCylinder> cylinders;
  std::vector<ModelCircle> circles;
  std::vector<ModelSphere> spheres;
  bool outlines_of_smooth = false;
  std::vector<std::filesystem::path> files;  // read, the first one first

  ObjectModel view() const;  // valid while this is unchanged
};

// .cao: sections of points, lines, faces from lines, faces from points, cylinders, circles and, our extension, spheres
// (nSpheres, then radius pCentre); "load" lines before with t=[x; y; z], tu=[rx; ry; rz deg] and R=[9 values];
// attributes name=, useLod=, minLineLengthThreshold=, minPolygonAreaThreshold=. The faces' lines must join end to end.
// A file may load any that its reader may read, by an absolute path or through "..", as users' models do: what is no
// model is refused, and an error quotes 40 characters of it at most.
// OBJ: v, f and l; coordinates only; sides between faces that meet at less than 30 degrees count only as outlines.
ModelFile read_model(const std::filesystem::path& file);
// The same of a file's text. `file` stands for it in errors, and what it loads is sought beside it.
ModelFile model_of(const std::string& text, const std::filesystem::path& file);

// Object to camera: six numbers, translation (model units) and rotation vector (radians), as in .pos; or a 4x4 matrix,
// row by row.
SE3 read_object_pose(const std::filesystem::path& file);

// Points of the object and where they are seen: a number n >= 4, then n lines X Y Z (as in .init) followed by u v, the
// level-0 pixel, in the same line.
struct SeenPoints {
  std::vector<Vector3f> points_o;
  std::vector<Vector2f> px;
};
SeenPoints read_seen_points(const std::filesystem::path& file);

}  // namespace pptam::platform
