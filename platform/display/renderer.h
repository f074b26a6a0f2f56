// Draws a Scene with OpenGL ES 2.0 into whatever is bound in the current context, with the shaders of shaders/.
//
// The scene's world goes through the camera's lens and shutter on the graphics processor: each vertex is moved to the
// time at which its own line of the image was exposed. Used by every display's module; one renderer for each context.
#pragma once

#include <GLES2/gl2.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "platform/display/scene.h"

namespace pptam::platform {

// At the end of what is said of a driver that does not do it.
inline constexpr const char* kOrSoftware = ": try LIBGL_ALWAYS_SOFTWARE=1, Mesa's software renderer";

struct VertexAttribute {
  const char* name;
  GLint floats;
};

class Renderer {
 public:
  // In the current context, in which all else is to be called, and in which it is to be destroyed. Throws InputError.
  Renderer();
  ~Renderer();
  Renderer(const Renderer&) = delete;
  Renderer& operator=(const Renderer&) = delete;

  // upside_down: the target's rows begin at the top, as those of a picture that is to be read.
  void draw(const Scene& scene, bool upside_down);

  // After drawing: throws InputError if the driver has failed, such as for want of memory.
  static void check();
  // How the driver calls itself: "llvmpipe (LLVM 15.0.6, 256 bits)".
  static std::string driver();

 private:
  // What is drawn in one call: vertices of some kind in a buffer.
  struct Batch {
    GLuint vertices = 0, indices = 0;  // buffers
    GLsizei count = 0;                 // of the indices, or else of the vertices
  };
  struct ModelBatches {
    uint64_t revision = 0;
    Batch ground, shadow, faces, edges, wires, points;
  };
  struct Program {
    GLuint name = 0;
    std::map<std::string, GLint> uniforms;
    GLint at(const std::string& uniform);
  };

  struct WorldPrograms {
    Program triangles, points, lines;
  };

  void draw_picture(const Picture& picture, const Area& view);
  void draw_ground(const WorldModel& model, const Eye& eye);
  void draw_standing(const WorldModel& model, const Eye& eye);  // after draw_ground() of all
  void see(const Eye& eye);
  void set_eye(Program& program, const Eye& eye);
  void draw_triangles(const Batch& batch, float near_z);
  void draw_lines(const Batch& batch, float near_z, float closer);
  static void draw(const Batch& batch, const std::vector<VertexAttribute>& attributes, GLenum mode);
  void draw_shapes(const std::vector<Shape>& shapes);
  void draw_glyphs(const std::vector<Glyph>& glyphs, const LetterImage& letters);
  void upload(Batch* batch, size_t floats_per_vertex, GLenum use);  // floats_, and indices_ if there are any
  void upload_lines(Batch* batch, const std::vector<WorldLine>& lines);
  void upload_points(Batch* batch, const std::vector<WorldPoint>& points);
  void upload_mesh(Batch* batch, const WorldMesh& mesh);
  void set_plane(int unit, GLenum format, int width, int height, int bytes_per_pixel, const uint8_t* data,
                 int stride_bytes);
  void clip_to(const Area& area) const;

  std::array<Program, 6> pictures_;                       // by the shader's KIND, made when it is met
  std::map<std::pair<int, bool>, WorldPrograms> worlds_;  // by distortion and whether the shutter rolls, likewise
  WorldPrograms* world_ = nullptr;                        // of the scene that is being drawn
  Program shapes_, glyphs_;
  std::array<GLuint, 3> planes_ = {};
  std::array<std::array<int, 3>, 3> plane_sizes_ = {};  // width, height, format of what was allocated
  GLuint letters_ = 0;
  uint64_t letters_revision_ = 0;
  std::map<const WorldModel*, ModelBatches> models_;
  Batch corners_, flat_;           // the picture's rectangle; shapes and letters, filled anew each time
  std::vector<float> floats_;      // for filling buffers
  std::vector<uint16_t> indices_;  // likewise
  std::vector<uint8_t> packed_;    // rows of a plane without gaps

  // Of the scene that is being drawn.
  Eigen::Matrix3f canvas_to_clip_ = Eigen::Matrix3f::Identity();
  Eigen::Matrix3f image_to_clip_ = Eigen::Matrix3f::Identity();
  Vector2f half_target_ = Vector2f::Ones();  // of the target, pixels
  int target_width_ = 0, target_height_ = 0;
  Eigen::Matrix3f canvas_to_target_ = Eigen::Matrix3f::Identity();  // pixels, rows from the bottom as GL counts them
};

}  // namespace pptam::platform
