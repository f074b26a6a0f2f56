#include "platform/display/renderer.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <utility>

#include "platform/display/shaders.h"
#include "platform/input_error.h"

namespace pptam::platform {
namespace {

// Of each kind of vertex, in the order in which they lie in a buffer.
using Attributes = std::vector<VertexAttribute>;
const Attributes kTriangleVertex = {{"p_w", 3}, {"colour", 4}};
const Attributes kPointVertex = {{"p_w", 3}, {"colour", 4}, {"size", 1}};
const Attributes kLineVertex = {{"p_w", 3}, {"other_w", 3}, {"colour", 4}, {"offset", 2}};
const Attributes kCornerVertex = {{"corner", 2}};
const Attributes kShapeVertex = {{"position", 2}, {"local", 2}, {"form", 4}, {"colour", 4}};
const Attributes kGlyphVertex = {{"position", 2}, {"place", 2}, {"colour", 4}};

// A line on a wall is before the wall by this much of the depth's range of 2: 16 bits tell 3e-5 apart.
constexpr float kEdgeCloser = 5e-5f;

size_t floats_of(const Attributes& attributes) {
  size_t floats = 0;
  for (const VertexAttribute& attribute : attributes) floats += static_cast<size_t>(attribute.floats);
  return floats;
}

GLuint compiled(GLenum kind, const std::string& source) {
  const GLuint shader = glCreateShader(kind);
  const char* text = source.c_str();
  glShaderSource(shader, 1, &text, nullptr);
  glCompileShader(shader);
  GLint good = 0;
  glGetShaderiv(shader, GL_COMPILE_STATUS, &good);
  if (good != 0) return shader;
  char why[512] = "";
  glGetShaderInfoLog(shader, sizeof why, nullptr, why);
  throw InputError("the display's driver, " + Renderer::driver() + ", does not take a shader: " + why + kOrSoftware);
}

GLuint linked(const std::string& vertex, const std::string& fragment, const Attributes& attributes) {
  const GLuint program = glCreateProgram();
  for (const auto& [kind, source] :
       {std::pair(GLenum{GL_VERTEX_SHADER}, &vertex), std::pair(GLenum{GL_FRAGMENT_SHADER}, &fragment)}) {
    const GLuint shader = compiled(kind, *source);
    glAttachShader(program, shader);
    glDeleteShader(shader);  // once the program is
  }
  for (size_t i = 0; i < attributes.size(); ++i)
    glBindAttribLocation(program, static_cast<GLuint>(i), attributes[i].name);
  glLinkProgram(program);
  GLint good = 0;
  glGetProgramiv(program, GL_LINK_STATUS, &good);
  if (good != 0) return program;
  char why[512] = "";
  glGetProgramInfoLog(program, sizeof why, nullptr, why);
  throw InputError("the display's driver, " + Renderer::driver() + ", does not link a shader: " + why + kOrSoftware);
}

void bind(GLuint buffer, const Attributes& attributes) {
  glBindBuffer(GL_ARRAY_BUFFER, buffer);
  const auto stride = static_cast<GLsizei>(floats_of(attributes) * sizeof(float));
  size_t offset = 0;
  for (size_t i = 0; i < attributes.size(); ++i) {
    const auto index = static_cast<GLuint>(i);
    glEnableVertexAttribArray(index);
    glVertexAttribPointer(index, attributes[i].floats, GL_FLOAT, GL_FALSE, stride, std::bit_cast<const void*>(offset));
    offset += static_cast<size_t>(attributes[i].floats) * sizeof(float);
  }
}

void unbind(const Attributes& attributes) {
  for (size_t i = 0; i < attributes.size(); ++i) glDisableVertexAttribArray(static_cast<GLuint>(i));
}

void add(std::vector<float>* floats, const Vector3f& p) {
  floats->insert(floats->end(), {p.x(), p.y(), p.z()});
}
void add(std::vector<float>* floats, const Vector2f& p) {
  floats->insert(floats->end(), {p.x(), p.y()});
}
void add(std::vector<float>* floats, const Rgba& colour) {
  constexpr float kFull = 255;
  for (const uint8_t part : {colour.r, colour.g, colour.b, colour.a})
    floats->push_back(static_cast<float>(part) / kFull);
}

void set(GLint at, const Eigen::Matrix3f& matrix) {
  glUniformMatrix3fv(at, 1, GL_FALSE, matrix.data());  // columns, as Eigen stores them
}

// Canvas to target, y down, the canvas turned clockwise.
Eigen::Matrix3f turned(const Scene& scene) {
  const auto width = static_cast<float>(scene.width);
  const auto height = static_cast<float>(scene.height);
  Eigen::Matrix3f turn;
  switch (scene.turn_degrees) {
    case 90:
      turn << 0, -1, height, 1, 0, 0, 0, 0, 1;
      break;
    case 180:
      turn << -1, 0, width, 0, -1, height, 0, 0, 1;
      break;
    case 270:
      turn << 0, 1, 0, -1, 0, width, 0, 0, 1;
      break;
    default:
      turn.setIdentity();
  }
  return turn;
}

// Homogeneous pixels of an image that fills an area of the canvas.
Eigen::Matrix3f image_to_canvas(const Area& view, int width, int height) {
  const float x = view.width / static_cast<float>(width);
  const float y = view.height / static_cast<float>(height);
  Eigen::Matrix3f matrix;
  matrix << x, 0, view.x + 0.5f * x, 0, y, view.y + 0.5f * y, 0, 0, 1;
  return matrix;
}

// Of a part of an image that is shown, perhaps turned: corners of what is seen to places in the image, all from 0 to 1.
Eigen::Matrix3f corners_to_image(const Picture& picture) {
  const bool all = picture.width == 0;
  const auto width = static_cast<float>(picture.frame.width);
  const auto height = static_cast<float>(picture.frame.height);
  Eigen::Matrix3f part, turn;
  part << (all ? 1 : static_cast<float>(picture.width) / width), 0, static_cast<float>(picture.x) / width, 0,
      (all ? 1 : static_cast<float>(picture.height) / height), static_cast<float>(picture.y) / height, 0, 0, 1;
  switch (picture.turn_degrees) {
    case 90:
      turn << 0, 1, 0, -1, 0, 1, 0, 0, 1;
      break;
    case 180:
      turn << -1, 0, 1, 0, -1, 1, 0, 0, 1;
      break;
    case 270:
      turn << 0, -1, 1, 1, 0, 0, 0, 0, 1;
      break;
    default:
      turn.setIdentity();
  }
  return part * turn;
}

}  // namespace

GLint Renderer::Program::at(const std::string& uniform) {
  const auto found = uniforms.find(uniform);
  if (found != uniforms.end()) return found->second;
  return uniforms[uniform] = glGetUniformLocation(name, uniform.c_str());
}

std::string Renderer::driver() {
  const GLubyte* name = glGetString(GL_RENDERER);
  return name == nullptr ? "without a name" : reinterpret_cast<const char*>(name);
}

void Renderer::check() {
  const GLenum error = glGetError();
  if (error == GL_NO_ERROR) return;
  throw InputError(error == GL_OUT_OF_MEMORY
                       ? "drawing: " + driver() + " has no memory for it: try smaller images or a smaller window"
                       : "drawing: " + driver() + " failed, error " + std::to_string(error) + kOrSoftware);
}

Renderer::Renderer() {
  using namespace shaders;
  shapes_.name = linked(kShapeVert, kShapeFrag, kShapeVertex);
  glyphs_.name = linked(kGlyphVert, kGlyphFrag, kGlyphVertex);
  glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
  glPixelStorei(GL_PACK_ALIGNMENT, 1);
  glGenTextures(static_cast<GLsizei>(planes_.size()), planes_.data());
  glGenTextures(1, &letters_);
  for (const GLuint texture : {planes_[0], planes_[1], planes_[2], letters_}) {
    glBindTexture(GL_TEXTURE_2D, texture);
    for (const GLenum filter : {GL_TEXTURE_MIN_FILTER, GL_TEXTURE_MAG_FILTER})
      glTexParameteri(GL_TEXTURE_2D, filter, GL_LINEAR);
    for (const GLenum wrap : {GL_TEXTURE_WRAP_S, GL_TEXTURE_WRAP_T})  // other sizes than powers of two ask for it
      glTexParameteri(GL_TEXTURE_2D, wrap, GL_CLAMP_TO_EDGE);
  }
  floats_ = {0, 0, 1, 0, 0, 1, 1, 1};
  upload(&corners_, floats_of(kCornerVertex), GL_STATIC_DRAW);
}

Renderer::~Renderer() {
  for (const Program& picture : pictures_) glDeleteProgram(picture.name);
  for (const auto& [lens, of] : worlds_) {
    for (const Program* program : {&of.triangles, &of.points, &of.lines}) glDeleteProgram(program->name);
  }
  for (const Program* program : {&shapes_, &glyphs_}) glDeleteProgram(program->name);
  glDeleteTextures(static_cast<GLsizei>(planes_.size()), planes_.data());
  glDeleteTextures(1, &letters_);
  std::vector<const Batch*> batches = {&corners_, &flat_};
  for (const auto& [model, of] : models_)
    batches.insert(batches.end(), {&of.ground, &of.shadow, &of.faces, &of.edges, &of.wires, &of.points});
  for (const Batch* batch : batches) {
    glDeleteBuffers(1, &batch->vertices);
    glDeleteBuffers(1, &batch->indices);
  }
}

void Renderer::draw(const Scene& scene, bool upside_down) {
  const bool lying = scene.turn_degrees == 90 || scene.turn_degrees == 270;
  target_width_ = lying ? scene.height : scene.width;
  target_height_ = lying ? scene.width : scene.height;
  const auto width = static_cast<float>(target_width_);
  const auto height = static_cast<float>(target_height_);
  half_target_ = 0.5f * Vector2f(width, height);
  Eigen::Matrix3f rows, to_clip;
  if (upside_down) {
    rows.setIdentity();
  } else {
    rows << 1, 0, 0, 0, -1, height, 0, 0, 1;
  }
  to_clip << 2 / width, 0, -1, 0, 2 / height, -1, 0, 0, 1;
  canvas_to_target_ = rows * turned(scene);
  canvas_to_clip_ = to_clip * canvas_to_target_;
  glFrontFace(upside_down ? GL_CW : GL_CCW);

  glViewport(0, 0, target_width_, target_height_);
  glDisable(GL_SCISSOR_TEST);
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_CULL_FACE);
  glDepthMask(GL_TRUE);
  constexpr float kFull = 255;
  glClearColor(static_cast<float>(scene.background.r) / kFull, static_cast<float>(scene.background.g) / kFull,
               static_cast<float>(scene.background.b) / kFull, 1);
  glClear(GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT);
  glDisable(GL_BLEND);
  clip_to(scene.view);
  if (scene.picture) draw_picture(*scene.picture, scene.view);
  glEnable(GL_BLEND);
  glBlendFuncSeparate(GL_SRC_ALPHA, GL_ONE_MINUS_SRC_ALPHA, GL_ZERO, GL_ONE);
  if (scene.eye) {
    const CameraModel& model = scene.eye->camera.model;
    image_to_clip_ = canvas_to_clip_ * image_to_canvas(scene.view, model.width, model.height);
    see(*scene.eye);
    for (const WorldModel* model_drawn : scene.models) draw_ground(*model_drawn, *scene.eye);
  }
  draw_shapes(scene.marks);
  if (scene.eye) {
    for (const WorldModel* model_drawn : scene.models) draw_standing(*model_drawn, *scene.eye);
  }
  glDisable(GL_SCISSOR_TEST);
  draw_shapes(scene.shapes);
  if (scene.letters != nullptr) draw_glyphs(scene.glyphs, *scene.letters);
}

// What reaches out of the area is not drawn.
void Renderer::clip_to(const Area& area) const {
  const Vector3f a = canvas_to_target_ * Vector3f(area.x, area.y, 1);
  const Vector3f b = canvas_to_target_ * Vector3f(area.x + area.width, area.y + area.height, 1);
  const auto low = [](float one, float other) { return static_cast<GLint>(std::lround(std::min(one, other))); };
  const auto size = [](float one, float other) { return static_cast<GLsizei>(std::lround(std::abs(one - other))); };
  glEnable(GL_SCISSOR_TEST);
  glScissor(low(a.x(), b.x()), low(a.y(), b.y()), size(a.x(), b.x()), size(a.y(), b.y()));
}

void Renderer::draw_picture(const Picture& picture, const Area& view) {
  const Frame& frame = picture.frame;
  const bool again = frame.data == nullptr;
  if (again && (plane_sizes_[0][0] != frame.width || plane_sizes_[0][1] != frame.height)) return;  // none was drawn
  const int half_width = (frame.width + 1) / 2;
  const int half_height = (frame.height + 1) / 2;
  const auto plane = [&](int unit, GLenum format, int width, int bytes) {
    set_plane(unit, format, width, frame.height, bytes, frame.data, frame.stride_bytes);
  };
  const auto chroma = [&](int unit, GLenum format, int bytes) {
    const uint8_t* data = again ? nullptr : picture.chroma[unit - 1];
    set_plane(unit, format, half_width, half_height, bytes, data, picture.chroma_stride_bytes);
  };
  size_t kind = 0;
  switch (frame.format) {
    case PixelFormat::kGrey:
      plane(0, GL_LUMINANCE, frame.width, 1);
      break;
    case PixelFormat::kRgb24:
      plane(0, GL_RGB, frame.width, 3);
      break;
    case PixelFormat::kBgra:
      plane(0, GL_RGBA, frame.width, 4);
      kind = 1;
      break;
    case PixelFormat::kYuyv:
      plane(0, GL_LUMINANCE_ALPHA, frame.width, 2);
      plane(1, GL_RGBA, frame.width / 2, 4);
      kind = 2;
      break;
    case PixelFormat::kNv12:
    case PixelFormat::kNv21:
    case PixelFormat::kI420:
      plane(0, GL_LUMINANCE, frame.width, 1);
      if (picture.chroma[0] == nullptr) break;
      if (frame.format == PixelFormat::kI420) {
        chroma(1, GL_LUMINANCE, 1);
        chroma(2, GL_LUMINANCE, 1);
        kind = 5;
      } else {
        chroma(1, GL_LUMINANCE_ALPHA, 2);
        kind = frame.format == PixelFormat::kNv12 ? 3 : 4;
      }
      break;
  }
  Program& program = pictures_[kind];
  if (program.name == 0)
    program.name = linked(shaders::kPictureVert, "#define KIND " + std::to_string(kind) + "\n" + shaders::kPictureFrag,
                          kCornerVertex);
  glUseProgram(program.name);
  Eigen::Matrix3f corners_to_canvas;
  corners_to_canvas << view.width, 0, view.x, 0, view.height, view.y, 0, 0, 1;
  set(program.at("canvas"), canvas_to_clip_ * corners_to_canvas);
  set(program.at("shown"), corners_to_image(picture));
  for (const auto& [name, unit] : {std::pair("plane_0", 0), std::pair("plane_1", 1), std::pair("plane_2", 2)})
    glUniform1i(program.at(name), unit);
  bind(corners_.vertices, kCornerVertex);
  glDrawArrays(GL_TRIANGLE_STRIP, 0, corners_.count);
  unbind(kCornerVertex);
}

void Renderer::set_plane(int unit, GLenum format, int width, int height, int bytes_per_pixel, const uint8_t* data,
                         int stride_bytes) {
  GLint largest = 0;
  glGetIntegerv(GL_MAX_TEXTURE_SIZE, &largest);
  if (std::max(width, height) > largest)
    throw InputError("the display draws images of up to " + std::to_string(largest) +
                     " pixels a side only: make them smaller");
  const auto row = static_cast<size_t>(width) * static_cast<size_t>(bytes_per_pixel);
  if (data != nullptr && static_cast<size_t>(stride_bytes) != row) {  // OpenGL ES 2.0 knows no gaps between rows
    packed_.resize(row * static_cast<size_t>(height));
    for (int y = 0; y < height; ++y)
      std::memcpy(packed_.data() + static_cast<size_t>(y) * row, data + static_cast<ptrdiff_t>(y) * stride_bytes, row);
    data = packed_.data();
  }
  const auto index = static_cast<size_t>(unit);
  glActiveTexture(GL_TEXTURE0 + static_cast<GLenum>(unit));
  glBindTexture(GL_TEXTURE_2D, planes_[index]);
  const std::array<int, 3> size = {width, height, static_cast<int>(format)};
  if (data == nullptr) {  // it holds the picture drawn last
  } else if (plane_sizes_[index] == size) {
    glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, width, height, format, GL_UNSIGNED_BYTE, data);
  } else {
    glTexImage2D(GL_TEXTURE_2D, 0, static_cast<GLint>(format), width, height, 0, format, GL_UNSIGNED_BYTE, data);
    plane_sizes_[index] = size;
  }
  glActiveTexture(GL_TEXTURE0);
}

void Renderer::see(const Eye& eye) {
  const auto distortion = static_cast<int>(eye.camera.model.distortion);
  const bool rolling = eye.camera.shutter.line_time_s != 0;
  world_ = &worlds_[{distortion, rolling}];
  if (world_->triangles.name == 0) {
    using namespace shaders;
    const std::string lens =
        "#define DISTORTION " + std::to_string(distortion) + "\n#define ROLLING " + (rolling ? "1\n" : "0\n") + kLens;
    world_->triangles.name = linked(lens + kWorldVert, kPlainFrag, kPointVertex);
    world_->points.name = linked(lens + kWorldVert, kDiscFrag, kPointVertex);
    world_->lines.name = linked(lens + kLineVert, kLineFrag, kLineVertex);
  }
  for (Program* program : {&world_->triangles, &world_->points, &world_->lines}) set_eye(*program, eye);
}

void Renderer::set_eye(Program& program, const Eye& eye) {
  const CameraModel& lens = eye.camera.model;
  const RollingShutter& shutter = eye.camera.shutter;
  const bool columns = shutter.axis == RollingShutter::Axis::kColumns;
  glUseProgram(program.name);
  set(program.at("R_cw"), eye.T_cw.R);
  glUniform3f(program.at("t_cw"), eye.T_cw.t.x(), eye.T_cw.t.y(), eye.T_cw.t.z());
  const Vector6f& v = eye.velocity;
  glUniform3f(program.at("linear_velocity"), v[0], v[1], v[2]);
  glUniform3f(program.at("angular_velocity"), v[3], v[4], v[5]);
  glUniform4f(program.at("focal_centre"), lens.fx, lens.fy, lens.cx, lens.cy);
  const float* c = lens.coeffs;
  glUniform4f(program.at("coeffs"), c[0], lens.distortion == Distortion::kFov ? lens.fov_gain : c[1], c[2], c[3]);
  glUniform1f(program.at("coeff_4"), c[4]);
  glUniform1f(program.at("max_radius"), std::sqrt(lens.max_radius_sq));
  glUniform2f(program.at("line_time"), columns ? shutter.line_time_s : 0, columns ? 0 : shutter.line_time_s);
  glUniform2f(program.at("middle"), 0.5f * static_cast<float>(lens.width - 1),
              0.5f * static_cast<float>(lens.height - 1));
  const auto lines = static_cast<float>(columns ? lens.width : lens.height);
  glUniform1f(program.at("half_readout"), 0.5f * std::abs(shutter.line_time_s) * lines);
  set(program.at("canvas_px"), image_to_clip_);
}

void Renderer::draw_ground(const WorldModel& model, const Eye& eye) {
  ModelBatches& batches = models_[&model];
  if (batches.revision != model.revision) {
    batches.revision = model.revision;
    upload_lines(&batches.ground, model.ground);
    upload_mesh(&batches.shadow, model.shadow);
    upload_mesh(&batches.faces, model.faces);
    upload_lines(&batches.edges, model.edges);
    upload_lines(&batches.wires, model.wires);
    upload_points(&batches.points, model.points);
  }
  draw_lines(batches.ground, eye.near_z, 0);
}

void Renderer::draw_standing(const WorldModel& model, const Eye& eye) {
  const ModelBatches& batches = models_[&model];
  draw_triangles(batches.shadow, eye.near_z);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LEQUAL);
  glEnable(GL_CULL_FACE);
  glDisable(GL_BLEND);
  draw_triangles(batches.faces, eye.near_faces_z);
  glEnable(GL_BLEND);
  glDisable(GL_CULL_FACE);
  glDepthMask(GL_FALSE);
  draw_lines(batches.edges, eye.near_faces_z, kEdgeCloser);
  glDepthMask(GL_TRUE);
  glDisable(GL_DEPTH_TEST);
  draw_lines(batches.wires, eye.near_z, 0);
  if (batches.points.count > 0) {
    glUseProgram(world_->points.name);
    glUniform1f(world_->points.at("near_z"), eye.near_z);
    draw(batches.points, kPointVertex, GL_POINTS);
  }
}

void Renderer::draw_triangles(const Batch& batch, float near_z) {
  if (batch.count == 0) return;
  glUseProgram(world_->triangles.name);
  glUniform1f(world_->triangles.at("near_z"), near_z);
  draw(batch, kTriangleVertex, GL_TRIANGLES);
}

void Renderer::draw_lines(const Batch& batch, float near_z, float closer) {
  if (batch.count == 0) return;
  glUseProgram(world_->lines.name);
  glUniform2f(world_->lines.at("half_canvas"), half_target_.x(), half_target_.y());
  glUniform1f(world_->lines.at("near_z"), near_z);
  glUniform1f(world_->lines.at("closer"), closer);
  draw(batch, kLineVertex, GL_TRIANGLES);
}

void Renderer::draw_shapes(const std::vector<Shape>& shapes) {
  if (shapes.empty()) return;
  floats_.clear();
  for (const Shape& shape : shapes) {
    const float beyond = shape.radius + 0.5f * shape.stroke + 1;  // and a pixel for the smooth edge
    const Vector2f reach = shape.half + Vector2f(beyond, beyond);
    const Vector2f across(-shape.direction.y(), shape.direction.x());
    for (const auto& [x, y] : {std::pair(-1, -1), {1, -1}, {-1, 1}, {-1, 1}, {1, -1}, {1, 1}}) {
      const Vector2f local(static_cast<float>(x) * reach.x(), static_cast<float>(y) * reach.y());
      add(&floats_, Vector2f(shape.centre + local.x() * shape.direction + local.y() * across));
      add(&floats_, local);
      add(&floats_, shape.half);
      floats_.insert(floats_.end(), {shape.radius, shape.stroke});
      add(&floats_, shape.colour);
    }
  }
  upload(&flat_, floats_of(kShapeVertex), GL_STREAM_DRAW);
  glUseProgram(shapes_.name);
  set(shapes_.at("canvas"), canvas_to_clip_);
  draw(flat_, kShapeVertex, GL_TRIANGLES);
}

void Renderer::draw_glyphs(const std::vector<Glyph>& glyphs, const LetterImage& letters) {
  if (glyphs.empty()) return;
  glBindTexture(GL_TEXTURE_2D, letters_);
  if (letters_revision_ != letters.revision) {
    letters_revision_ = letters.revision;
    glTexImage2D(GL_TEXTURE_2D, 0, GL_ALPHA, letters.width, letters.height, 0, GL_ALPHA, GL_UNSIGNED_BYTE,
                 letters.cover.data());
  }
  floats_.clear();
  for (const Glyph& glyph : glyphs) {
    for (const auto& [x, y] : {std::pair(0, 0), {1, 0}, {0, 1}, {0, 1}, {1, 0}, {1, 1}}) {
      const auto across = static_cast<float>(x);
      const auto down = static_cast<float>(y);
      add(&floats_, Vector2f(glyph.at.x + across * glyph.at.width, glyph.at.y + down * glyph.at.height));
      add(&floats_, Vector2f((glyph.from.x + across * glyph.from.width) / static_cast<float>(letters.width),
                             (glyph.from.y + down * glyph.from.height) / static_cast<float>(letters.height)));
      add(&floats_, glyph.colour);
    }
  }
  upload(&flat_, floats_of(kGlyphVertex), GL_STREAM_DRAW);
  glUseProgram(glyphs_.name);
  set(glyphs_.at("canvas"), canvas_to_clip_);
  glUniform1i(glyphs_.at("letters"), 0);
  draw(flat_, kGlyphVertex, GL_TRIANGLES);
}

void Renderer::upload(Batch* batch, size_t floats_per_vertex, GLenum use) {
  const auto fill = [use](GLenum target, GLuint* buffer, const auto& data) {
    if (*buffer == 0) glGenBuffers(1, buffer);
    glBindBuffer(target, *buffer);
    glBufferData(target, static_cast<GLsizeiptr>(data.size() * sizeof(data[0])), data.data(), use);
  };
  batch->count = static_cast<GLsizei>(indices_.empty() ? floats_.size() / floats_per_vertex : indices_.size());
  if (!floats_.empty()) fill(GL_ARRAY_BUFFER, &batch->vertices, floats_);
  if (!indices_.empty()) fill(GL_ELEMENT_ARRAY_BUFFER, &batch->indices, indices_);
  floats_.clear();
  indices_.clear();
}

// Two vertices for each point of a line, left and right of it. Of the last one the other end is the one before.
void Renderer::upload_lines(Batch* batch, const std::vector<WorldLine>& lines) {
  const size_t floats_per_vertex = floats_of(kLineVertex);
  for (const WorldLine& line : lines) {
    const float reach = 0.5f * line.width_px + 0.5f;
    const size_t first = floats_.size() / floats_per_vertex;
    if (line.points.size() < 2 || first + 2 * line.points.size() > UINT16_MAX) continue;  // more than a map ever has
    for (size_t i = 0; i < line.points.size(); ++i) {
      const bool last = i + 1 == line.points.size();
      for (const float side : {-1.0f, 1.0f}) {
        add(&floats_, line.points[i].p_w);
        add(&floats_, line.points[last ? i - 1 : i + 1].p_w);
        add(&floats_, line.points[i].colour);
        floats_.insert(floats_.end(), {side * reach, last ? -1.0f : 1.0f});
      }
      if (last) break;
      for (const int corner : {0, 1, 2, 2, 1, 3})
        indices_.push_back(static_cast<uint16_t>(first + 2 * i + static_cast<size_t>(corner)));
    }
  }
  upload(batch, floats_per_vertex, GL_STATIC_DRAW);
}

void Renderer::upload_points(Batch* batch, const std::vector<WorldPoint>& points) {
  for (const WorldPoint& point : points) {
    add(&floats_, point.p_w);
    add(&floats_, point.colour);
    floats_.push_back(point.diameter_px);
  }
  upload(batch, floats_of(kPointVertex), GL_STATIC_DRAW);
}

void Renderer::upload_mesh(Batch* batch, const WorldMesh& mesh) {
  for (const WorldVertex& vertex : mesh.vertices) {
    add(&floats_, vertex.p_w);
    add(&floats_, vertex.colour);
  }
  indices_ = mesh.triangles;
  upload(batch, floats_of(kTriangleVertex), GL_STATIC_DRAW);
}

void Renderer::draw(const Batch& batch, const Attributes& attributes, GLenum mode) {
  bind(batch.vertices, attributes);
  if (batch.indices == 0) {
    glDrawArrays(mode, 0, batch.count);
  } else {
    glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, batch.indices);
    glDrawElements(mode, batch.count, GL_UNSIGNED_SHORT, nullptr);
  }
  unbind(attributes);
}

}  // namespace pptam::platform
