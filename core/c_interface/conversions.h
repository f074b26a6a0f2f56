// Between the structures of pocket_ptam_c.h and those of the C++ interface. What comes from C may hold anything: no
// number is taken for an enumerator or a truth value before it has been looked at.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include <pocket_ptam/camera.h>
#include <pocket_ptam/config.h>
#include <pocket_ptam/image.h>
#include <pocket_ptam/pocket_ptam_c.h>

namespace pptam::c {

constexpr size_t kBlockAlignment = alignof(std::max_align_t);  // of what stands in the caller's block, as malloc's

// Bytes that a structure takes at the head of a block, so that what follows is aligned.
template <class T>
constexpr size_t head_bytes() {
  return (sizeof(T) + kBlockAlignment - 1) / kBlockAlignment * kBlockAlignment;
}
inline bool block_aligned(const void* memory) {
  return reinterpret_cast<uintptr_t>(memory) % kBlockAlignment == 0;
}

constexpr pptam_status kDone = {PPTAM_OK, ""};

inline pptam_status refused(const char* message) {
  return {PPTAM_INVALID_ARGUMENT, message};
}
inline pptam_status to_c(const Status& status) {
  return {static_cast<int32_t>(status.code()), status.message()};
}

// An enumerator, or, of what is none, one that no check of the C++ interface takes.
template <class Enum>
Enum enum_from(int32_t value) {
  constexpr int32_t kNoEnumerator = 255;
  return static_cast<Enum>(value >= 0 && value < kNoEnumerator ? value : kNoEnumerator);
}

// Whatever byte a caller that is not C has put there.
inline bool truth_from(const bool& value) {
  unsigned char byte = 0;
  std::memcpy(&byte, &value, 1);
  return byte != 0;
}

inline Vector2f vector2_from(const float v[2]) {
  return {v[0], v[1]};
}
inline Vector3f vector3_from(const float v[3]) {
  return {v[0], v[1], v[2]};
}
inline bool all_within(const float* numbers, int count, float most) {
  for (int i = 0; i < count; ++i)
    if (!(std::abs(numbers[i]) <= most)) return false;  // NaN, too
  return true;
}

template <class Matrix>
void numbers_to(const Matrix& matrix, float* rows) {
  for (int r = 0; r < matrix.rows(); ++r)
    for (int c = 0; c < matrix.cols(); ++c) *rows++ = matrix(r, c);
}

inline SE3 pose_from(const pptam_pose& pose) {
  SE3 T;
  for (int i = 0; i < 9; ++i) T.R(i / 3, i % 3) = pose.R[i];
  T.t = vector3_from(pose.t);
  return T;
}
inline pptam_pose to_c(const SE3& T) {
  pptam_pose pose;
  numbers_to(T.R, pose.R);
  numbers_to(T.t, pose.t);
  return pose;
}

// The shutter's axis is looked at by camera_status().
inline Camera camera_from(const pptam_camera& c) {
  Camera camera;
  camera.model.width = c.width;
  camera.model.height = c.height;
  camera.model.fx = c.fx;
  camera.model.fy = c.fy;
  camera.model.cx = c.cx;
  camera.model.cy = c.cy;
  camera.model.distortion = enum_from<Distortion>(c.distortion);
  std::copy_n(c.coeffs, 5, camera.model.coeffs);
  camera.shutter.axis = enum_from<RollingShutter::Axis>(c.shutter_axis);
  camera.shutter.line_time_s = c.line_time_s;
  return camera;
}
inline pptam_camera to_c(const Camera& camera) {
  pptam_camera c;
  c.width = camera.model.width;
  c.height = camera.model.height;
  c.fx = camera.model.fx;
  c.fy = camera.model.fy;
  c.cx = camera.model.cx;
  c.cy = camera.model.cy;
  c.distortion = static_cast<int32_t>(camera.model.distortion);
  std::copy_n(camera.model.coeffs, 5, c.coeffs);
  c.shutter_axis = static_cast<int32_t>(camera.shutter.axis);
  c.line_time_s = camera.shutter.line_time_s;
  return c;
}
// What the configurations' validate() does not look at.
inline pptam_status camera_status(const pptam_camera& c) {
  if (c.shutter_axis != PPTAM_SHUTTER_ROWS && c.shutter_axis != PPTAM_SHUTTER_COLUMNS)
    return refused("pptam_camera.shutter_axis: PPTAM_SHUTTER_ROWS or PPTAM_SHUTTER_COLUMNS is needed");
  return kDone;
}

inline Frame frame_from(const pptam_frame& c) {
  Frame frame;
  frame.data = c.data;
  frame.width = c.width;
  frame.height = c.height;
  frame.stride_bytes = c.stride_bytes;
  frame.format = enum_from<PixelFormat>(c.format);
  frame.timestamp_ns = c.timestamp_ns;
  return frame;
}

// Whether `out` with `capacity` and `count` can be written to.
template <class T>
bool is_output(const T* out, size_t capacity, const int32_t* count) {
  return count && (out || capacity == 0);
}
constexpr const char* kNoOutput = "count is null, or out is null and capacity is not 0";
constexpr const char* kNoBlock = "memory is null, or not aligned as by malloc (alignof(max_align_t))";

// The bytes and the making of a pptam_system whose Config has parts that pptam_config cannot name; the Config is valid.
size_t required_bytes(const Config& config);
pptam_status create(const Config& config, void* memory, size_t bytes, pptam_system** system);

}  // namespace pptam::c
