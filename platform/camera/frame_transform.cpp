#include "platform/camera/frame_transform.h"

#include <algorithm>
#include <string>
#include <utility>

#include "platform/input_error.h"

namespace pptam::platform {
namespace {

GreyPixels make_image(int width, int height) {
  GreyPixels image;
  image.width = width;
  image.height = height;
  image.px.resize(static_cast<size_t>(width) * static_cast<size_t>(height));
  return image;
}

// Calls f(i, j, weight) for every old cell j that overlaps new cell i when old_size cells become new_size, in order of
// i and j. In units of 1 / new_size of an old cell, old cell j covers [j, j + 1) * new_size and new cell i covers [i, i
// + 1) * old_size, so weights are integers, and those of one new cell sum to old_size.
template <class F>
void for_each_overlap(int old_size, int new_size, F f) {
  for (int i = 0; i < new_size; ++i) {
    const int64_t begin = int64_t{i} * old_size;
    const int64_t end = begin + old_size;
    for (int64_t j = begin / new_size; j * new_size < end; ++j) {
      f(i, static_cast<int>(j),
        static_cast<uint32_t>(std::min((j + 1) * new_size, end) - std::max(j * new_size, begin)));
    }
  }
}

}  // namespace

FrameTransform::FrameTransform(int source_width, int source_height, int rotate_degrees, int resize_width,
                               int resize_height)
    : turns_(rotate_degrees / 90), rotated_width_(source_width), rotated_height_(source_height) {
  if (rotate_degrees < 0 || rotate_degrees > 270 || rotate_degrees % 90 != 0) {
    throw InputError("cannot rotate by " + std::to_string(rotate_degrees) + " degrees: give 0, 90, 180 or 270");
  }
  if (turns_ % 2 == 1) std::swap(rotated_width_, rotated_height_);
  if (resize_width < 0 || resize_height < 0 || (resize_width == 0) != (resize_height == 0)) {
    throw InputError("cannot resize to " + std::to_string(resize_width) + "x" + std::to_string(resize_height) +
                     ": give a width and a height");
  }
  width_ = resize_width == 0 ? rotated_width_ : resize_width;
  height_ = resize_height == 0 ? rotated_height_ : resize_height;
  if (width_ > rotated_width_ || height_ > rotated_height_) {
    throw InputError("cannot enlarge images of " + std::to_string(rotated_width_) + "x" +
                     std::to_string(rotated_height_) + " pixels to " + std::to_string(width_) + "x" +
                     std::to_string(height_) + ": give a smaller size");
  }
}

CameraModel FrameTransform::model(const CameraModel& source) const {
  CameraModel m = source;
  for (int turn = 0; turn < turns_; ++turn) {
    // x' = H - 1 - y, y' = x for pixels, x' = -y, y' = x for normalised coordinates. Radial terms stay. The tangential
    // ones, dx = 2 p1 x y + p2 (r^2 + 2 x^2) and dy = p1 (r^2 + 2 y^2) + 2 p2 x y, give with dx' = -dy, dy' = dx:
    // p1' = p2, p2' = -p1.
    const CameraModel before = m;
    m.width = before.height;
    m.height = before.width;
    m.fx = before.fy;
    m.fy = before.fx;
    m.cx = static_cast<float>(before.height - 1) - before.cy;
    m.cy = before.cx;
    if (m.distortion == Distortion::kRadTan) {
      m.coeffs[2] = before.coeffs[3];
      m.coeffs[3] = -before.coeffs[2];
    }
  }
  const float sx = static_cast<float>(width_) / static_cast<float>(rotated_width_);
  const float sy = static_cast<float>(height_) / static_cast<float>(rotated_height_);
  m.width = width_;
  m.height = height_;
  m.fx *= sx;
  m.fy *= sy;
  m.cx = (m.cx + 0.5f) * sx - 0.5f;
  m.cy = (m.cy + 0.5f) * sy - 0.5f;
  return m;
}

RollingShutter FrameTransform::shutter(const RollingShutter& source) const {
  RollingShutter s = source;
  for (int turn = 0; turn < turns_; ++turn) {
    if (s.axis == RollingShutter::Axis::kRows) {  // a row at y becomes a column at H - 1 - y
      s.axis = RollingShutter::Axis::kColumns;
      s.line_time_s = 0.0f - s.line_time_s;
    } else {  // a column at x becomes a row at x
      s.axis = RollingShutter::Axis::kRows;
    }
  }
  const bool rows = s.axis == RollingShutter::Axis::kRows;
  const int lines_before = rows ? rotated_height_ : rotated_width_;
  const int lines = rows ? height_ : width_;
  s.line_time_s *= static_cast<float>(lines_before) / static_cast<float>(lines);  // the whole readout stays
  return s;
}

Eigen::Vector2d FrameTransform::pixel(const Eigen::Vector2d& source_px) const {
  Eigen::Vector2d px = source_px;
  int width = turns_ % 2 == 1 ? rotated_height_ : rotated_width_;
  int height = turns_ % 2 == 1 ? rotated_width_ : rotated_height_;
  for (int turn = 0; turn < turns_; ++turn) {
    px = Eigen::Vector2d(height - 1 - px.y(), px.x());
    std::swap(width, height);
  }
  return {(px.x() + 0.5) * width_ / rotated_width_ - 0.5, (px.y() + 0.5) * height_ / rotated_height_ - 0.5};
}

Eigen::Matrix3d FrameTransform::rotation() const {
  Eigen::Matrix3d quarter;
  quarter << 0, -1, 0,  //
      1, 0, 0,          //
      0, 0, 1;
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  for (int turn = 0; turn < turns_; ++turn) R = quarter * R;
  return R;
}

GreyView FrameTransform::apply(const GreyView& image) {
  GreyView view = image;
  if (turns_ != 0) {
    if (rotated_.px.empty()) rotated_ = make_image(rotated_width_, rotated_height_);
    uint8_t* out = rotated_.px.data();
    for (int y = 0; y < rotated_height_; ++y) {
      for (int x = 0; x < rotated_width_; ++x) {
        if (turns_ == 1) *out++ = image.at(y, rotated_width_ - 1 - x);
        if (turns_ == 2) *out++ = image.at(rotated_width_ - 1 - x, rotated_height_ - 1 - y);
        if (turns_ == 3) *out++ = image.at(rotated_height_ - 1 - y, x);
      }
    }
    view = rotated_.view();
  }
  if (width_ == rotated_width_ && height_ == rotated_height_) return view;

  if (resized_.px.empty()) resized_ = make_image(width_, height_);
  row_.resize(static_cast<size_t>(width_));
  sum_.resize(static_cast<size_t>(width_));
  const uint64_t area = static_cast<uint64_t>(rotated_width_) * static_cast<uint64_t>(rotated_height_);
  int row_of = -1;  // the source row that row_ holds
  int sum_of = -1;  // the output row that sum_ gathers
  const auto finish_row = [&] {
    if (sum_of < 0) return;
    for (int x = 0; x < width_; ++x) {
      const uint64_t sum = sum_[static_cast<size_t>(x)];
      resized_.px[static_cast<size_t>(sum_of) * static_cast<size_t>(width_) + static_cast<size_t>(x)] =
          static_cast<uint8_t>((sum + area / 2) / area);
    }
  };
  for_each_overlap(rotated_height_, height_, [&](int y, int source_y, uint32_t weight_y) {
    if (sum_of != y) {
      finish_row();
      std::fill(sum_.begin(), sum_.end(), 0);
      sum_of = y;
    }
    if (row_of != source_y) {
      const uint8_t* in = view.row(source_y);
      std::fill(row_.begin(), row_.end(), 0);  // at most 255 * width: no overflow
      for_each_overlap(rotated_width_, width_, [&](int x, int source_x, uint32_t weight_x) {
        row_[static_cast<size_t>(x)] += weight_x * in[source_x];
      });
      row_of = source_y;
    }
    for (size_t x = 0; x < sum_.size(); ++x) sum_[x] += uint64_t{weight_y} * row_[x];
  });
  finish_row();
  return resized_.view();
}

}  // namespace pptam::platform
