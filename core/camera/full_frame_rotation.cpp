#include "camera/full_frame_rotation.h"

#include <algorithm>
#include <cmath>

#include "base/assert.h"

namespace pptam {

namespace {

// Small images of more pixels are halved until they have no more: twice the phone's. A phone of 480x640 pixels that
// pans at 45 to 75 degrees/s is tracked throughout with 15x20 pixels as with 30x40. Not swept.
constexpr int kMaxPixels = 600;
constexpr int kMaxIterations = 8;  // not swept
// Step at which the iteration ends. The next step would be at most a tenth of it, while the estimate's noise is twice
// it. Five times less costs one more iteration and gains nothing (0.101 degrees rms both, at up to 60 degrees/s).
constexpr float kConverged_rad = 1e-3f;
// Largest last step of a good estimate that used all iterations: 0.1 px of level 4 on the phone. Not swept.
constexpr float kMaxLastStep_rad = 4e-3f;
// Huber threshold, grey levels: above the noise of 1-2, below the residuals of moving objects and borders. Not swept.
constexpr float kHuber_grey = 8.0f;
constexpr float kBandHuber_grey = 64.0f;  // grey levels, in the first iteration under lamp bands; not swept
// Largest rms residual (grey levels) and smallest gain (ratio; largest 1 / kMinGain) at which the two images are
// believed to show the same scene. Not swept.
constexpr float kMaxResidual_grey = 25.0f;
constexpr float kMinGain = 0.4f;
constexpr int kOverlapShare = 3;  // at least 1 / kOverlapShare of the interior pixels must overlap; not swept

// Information of the prior on the gain parameters, grey^2: a weak pull to an even gain of 1, which separates gain and
// offset in images of little contrast. Not swept.
constexpr float kGainPull = 10.0f;
// Share of a line's information that goes to its gain, a ratio: the rest keeps the equations regular. Not swept.
constexpr float kLineShare = 0.97f;
// Mean of RotationEstimate::line_share, a ratio, at which bands are seen, and down to which they stay. Between the
// shares of steady and of flickering light. The mean is over about five frames. Not swept.
constexpr float kMinShare = 0.35f, kMinShareToStay = 0.25f;
constexpr float kShareBlend = 0.2f;
constexpr float kMinCost = 0.5f;  // grey^2 a pixel under which residuals are rounding, which has no lines; not swept
constexpr float kMinVariance_grey2 = 1.0f;  // grey^2, floor of the covariance's noise; not swept
constexpr float kMaxStep_rad = 0.5f;        // longer steps come from images that do not match; not swept
constexpr float kMinRotationPivot = 1e-5f;  // ratio (NormalEquations), a hundred times float32's rounding; not swept
constexpr float kMinInformation = 1e-3f;    // on a rotation, grey^2/rad^2: there is no texture at all. Not swept

constexpr int16_t kOutside = INT16_MIN;  // in warped_: the pixel falls outside the current image
constexpr int kUnit = 16;                // warped_ is in units of 1/kUnit grey level

int aligned_level(const CameraModel& camera) {
  int level = small_image_level(camera.width, camera.height);
  while ((camera.width >> level) * (camera.height >> level) > kMaxPixels) ++level;
  return level;
}

}  // namespace

void LampBands::note(float line_share) {
  mean_share_ += kShareBlend * (line_share - mean_share_);
  seen_ = mean_share_ > (seen_ ? kMinShareToStay : kMinShare);
}

FullFrameRotation::FullFrameRotation(Arena& arena, const Camera& camera)
    : camera_(camera.model),
      shutter_lines_(camera.shutter.line_time_s == 0                      ? LampLines::kNone
                     : camera.shutter.axis == RollingShutter::Axis::kRows ? LampLines::kRows
                                                                          : LampLines::kColumns),
      small_level_(small_image_level(camera.model.width, camera.model.height)),
      level_(aligned_level(camera.model)),
      width_(camera.model.width >> level_),
      height_(camera.model.height >> level_),
      previous_levels_(arena, level_ - small_level_),
      current_levels_(arena, level_ - small_level_),
      pixels_(arena, width_ * height_),
      lines_(arena, shutter_lines_ == LampLines::kNone ? 0 : std::max(width_, height_)),
      warped_(arena, width_ * height_) {
  for (FixedVector<GreyImage>* levels : {&previous_levels_, &current_levels_}) {
    for (int l = small_level_ + 1; l <= level_; ++l) {
      const int width = camera_.width >> l, height = camera_.height >> l;
      levels->push_back({arena.allocate_array<uint8_t>(static_cast<size_t>(width) * height), width, height, width});
    }
  }
  if (arena.measuring()) return;
  pixels_.resize(pixels_.capacity());
  warped_.resize(warped_.capacity());
  lines_.resize(lines_.capacity());
  for (int i = 0; i < pixels_.size(); ++i) {
    Pixel& pixel = pixels_[i];
    const int x = i % width_, y = i / width_;
    pixel.ray = camera_.unproject({to_level0(static_cast<float>(x), level_), to_level0(static_cast<float>(y), level_)});
    const Vector3f p = pixel.ray.homogeneous();
    Vector2f px;
    Matrix23f J_px_p;
    pixel.J_px_w.setZero();
    if (camera_.project(p, &px, &J_px_p)) pixel.J_px_w = J_px_p * -hat(p) / static_cast<float>(1 << level_);
  }
}

GreyView FullFrameRotation::reduced(const GreyView& small, std::span<const GreyImage> levels) {
  GreyView image = small;
  for (const GreyImage& level : levels) {
    half_sample(image, level);
    image = level;
  }
  return image;
}

// Fills warped_ with the current image as the previous camera would see it: bilinear, at multiples of 1/256 px, rounded
// to 1/16 grey level.
void FullFrameRotation::warp(const GreyView& current, const Matrix3f& R_cp, const Vector3f& t_over_depth) {
  constexpr float kRounding = 0.5f / 256;  // pixels
  const float max_x = static_cast<float>(width_ - 1) - kRounding, max_y = static_cast<float>(height_ - 1) - kRounding;
  // Local copies, so that the compiler keeps them in registers.
  const Matrix3f R = R_cp;  // NOLINT(performance-unnecessary-copy-initialization)
  const Vector3f shift = R.col(2) + t_over_depth;
  const uint8_t* const data = current.data;
  const int stride = current.stride;
  int16_t* out = warped_.data();
  for (const Pixel& pixel : pixels_) {
    int16_t& warped = *out++;
    warped = kOutside;
    const float x = pixel.ray.x(), y = pixel.ray.y();
    const Vector3f p(R(0, 0) * x + R(0, 1) * y + shift.x(), R(1, 0) * x + R(1, 1) * y + shift.y(),
                     R(2, 0) * x + R(2, 1) * y + shift.z());
    Vector2f px;
    if (!camera_.project(p, &px)) continue;
    const float xc = from_level0(px.x(), level_), yc = from_level0(px.y(), level_);
    if (!(xc >= 0 && yc >= 0 && xc < max_x && yc < max_y)) continue;
    const auto column = static_cast<int32_t>(xc * 256.0f + 0.5f), row = static_cast<int32_t>(yc * 256.0f + 0.5f);
    const int32_t x_weight = column & 255, y_weight = row & 255;
    const uint8_t* upper_px = data + (row >> 8) * stride + (column >> 8);
    const uint8_t* lower_px = upper_px + stride;
    const int32_t upper = (upper_px[0] << 8) + (upper_px[1] - upper_px[0]) * x_weight;  // at most 255 x 2^8
    const int32_t lower = (lower_px[0] << 8) + (lower_px[1] - lower_px[0]) * x_weight;
    warped = static_cast<int16_t>(((upper << 8) + (lower - upper) * y_weight + (1 << 11)) >> 12);
  }
}

RotationEstimate FullFrameRotation::estimate(const GreyView& previous, const GreyView& current, const Matrix3f& R_start,
                                             const Vector3f& t_over_depth, bool lamp_bands) {
  for (const GreyView* small : {&previous, &current})
    PPTAM_ASSERT(small->width == camera_.width >> small_level_ && small->height == camera_.height >> small_level_);
  previous_ = reduced(previous, previous_levels_);
  current_ = reduced(current, current_levels_);
  t_over_depth_ = t_over_depth;
  lamp_bands_ = lamp_bands && shutter_lines_ != LampLines::kNone;
  gain_ = Gain();
  for (Line& line : lines_) line = Line();
  result_ = RotationEstimate();
  result_.R_cp = R_start;
  RobustFit<FullFrameRotation> fit;
  fit.run(*this, height_);
  result_.iterations = fit.iterations();
  return result_;
}

bool FullFrameRotation::errors(int iteration) {
  // Bands look like outliers until their lines' gains are known.
  huber_ = lamp_bands_ && iteration == 0 ? kBandHuber_grey : kHuber_grey;
  warp(current_, result_.R_cp, t_over_depth_);
  return true;
}

void FullFrameRotation::scale() {
  equations_.clear();
  for (Line& line : lines_) line.clear_sums();
  cost_ = 0;
  count_ = 0;
}

void FullFrameRotation::sum(int from, int to) {
  for (int y = std::max(from, 1); y < std::min(to, height_ - 1); ++y) sum_row(y);
}

// Adds one image row to the normal equations: w u u^T and w u e with u = (J, -I, -1, -I x, -I y). The sums are single
// variables, so that the compiler keeps them in registers.
void FullFrameRotation::sum_row(int y) {
  const uint8_t* I_p = previous_.row(y);
  const int stride = previous_.stride;
  const float x_middle = 0.5f * static_cast<float>(width_ - 1), y_middle = 0.5f * static_cast<float>(height_ - 1);
  const float unit = 2.0f / static_cast<float>(width_ + height_);  // scales coordinates to order 1
  const float ys = unit * (static_cast<float>(y) - y_middle);
  const float row_gain = gain_.gain + gain_.y * ys + (shutter_lines_ == LampLines::kRows ? lines_[y].gain : 0),
              gain_x = gain_.x, offset = gain_.offset;
  float J0_J0 = 0, J1_J0 = 0, J1_J1 = 0, J2_J0 = 0, J2_J1 = 0, J2_J2 = 0;
  float J0_I = 0, J1_I = 0, J2_I = 0, J0_1 = 0, J1_1 = 0, J2_1 = 0, J0_X = 0, J1_X = 0, J2_X = 0;
  float I_I = 0, I_1 = 0, I_X = 0, w_1 = 0, X_1 = 0, X_X = 0;
  float J0_e = 0, J1_e = 0, J2_e = 0, I_e = 0, e_1 = 0, X_e = 0;
  float cost = 0;
  for (int x = 1; x + 1 < width_; ++x) {
    const int i = y * width_ + x;
    const int16_t* I_w = warped_.data() + i;
    const int16_t left = I_w[-1], right = I_w[1], above = I_w[-width_], below = I_w[width_];
    if (I_w[0] == kOutside || left == kOutside || right == kOutside || above == kOutside || below == kOutside) continue;
    const float xs = unit * (static_cast<float>(x) - x_middle);
    const float pixel_gain = row_gain + gain_x * xs + (shutter_lines_ == LampLines::kColumns ? lines_[x].gain : 0);
    // J = (grad I_p + grad I_warped) / 2 * d(pixel)/d(omega) [phone 4]. Both gradients are in the previous camera's
    // pixels. A factor 1/2 comes from the central differences, another from the mean of the two images.
    constexpr float kWarped = 0.25f / kUnit;
    const float dx =
        kWarped * static_cast<float>(right - left) + 0.25f * pixel_gain * static_cast<float>(I_p[x + 1] - I_p[x - 1]);
    const float dy = kWarped * static_cast<float>(below - above) +
                     0.25f * pixel_gain * static_cast<float>(I_p[x + stride] - I_p[x - stride]);
    const Matrix23f& J_px_w = pixels_[i].J_px_w;
    const float J0 = dx * J_px_w(0, 0) + dy * J_px_w(1, 0);
    const float J1 = dx * J_px_w(0, 1) + dy * J_px_w(1, 1);
    const float J2 = dx * J_px_w(0, 2) + dy * J_px_w(1, 2);
    const auto I = static_cast<float>(I_p[x]);
    const float e = static_cast<float>(I_w[0]) * (1.0f / kUnit) - (pixel_gain * I + offset);
    const float abs_e = std::abs(e);
    const float w = abs_e <= huber_ ? 1.0f : huber_ / abs_e;
    const float X = I * xs;
    const float wJ0 = w * J0, wJ1 = w * J1, wJ2 = w * J2, wI = w * I, wX = w * X, we = w * e;
    J0_J0 += wJ0 * J0, J1_J0 += wJ1 * J0, J1_J1 += wJ1 * J1;
    J2_J0 += wJ2 * J0, J2_J1 += wJ2 * J1, J2_J2 += wJ2 * J2;
    J0_I += wJ0 * I, J1_I += wJ1 * I, J2_I += wJ2 * I;
    J0_1 += wJ0, J1_1 += wJ1, J2_1 += wJ2;
    J0_X += wJ0 * X, J1_X += wJ1 * X, J2_X += wJ2 * X;
    I_I += wI * I, I_1 += wI, I_X += wI * X, w_1 += w, X_1 += wX, X_X += wX * X;
    J0_e += wJ0 * e, J1_e += wJ1 * e, J2_e += wJ2 * e, I_e += wI * e, e_1 += we, X_e += wX * e;
    cost += we * e;
    ++count_;
    if (shutter_lines_ != LampLines::kColumns) continue;
    Line& line = lines_[x];
    line.I_I += wI * I;
    line.I_e += wI * e;
    if (lamp_bands_) line.add({wJ0 * I, wJ1 * I, wJ2 * I, -wI * I, -wI, -wX * I, -wI * I * ys});
  }
  cost_ += cost;
  if (shutter_lines_ == LampLines::kRows) {
    Line& line = lines_[y];
    line.I_I = I_I;
    line.I_e = I_e;
    if (lamp_bands_) line.add({J0_I, J1_I, J2_I, -I_I, -I_1, -I_X, -I_I * ys});
  }
  // u of the last parameter is -I y, where y is constant along the row: its sums are multiples of the others.
  const float row[kUnknowns][kUnknowns] = {
      {J0_J0},
      {J1_J0, J1_J1},
      {J2_J0, J2_J1, J2_J2},
      {-J0_I, -J1_I, -J2_I, I_I},
      {-J0_1, -J1_1, -J2_1, I_1, w_1},
      {-J0_X, -J1_X, -J2_X, I_X, X_1, X_X},
      {-J0_I * ys, -J1_I * ys, -J2_I * ys, I_I * ys, I_1 * ys, I_X * ys, I_I * ys * ys}};
  const float row_e[kUnknowns] = {-J0_e, -J1_e, -J2_e, I_e, e_1, X_e, I_e * ys};
#pragma GCC unroll 7
  for (int j = 0; j < kUnknowns; ++j) {
#pragma GCC unroll 7
    for (int k = 0; k <= j; ++k) equations_.A(j, k) += row[j][k];
    equations_.b(j) += row_e[j];
  }
}

void FullFrameRotation::Line::add(const float (&sums)[kUnknowns]) {
  for (int i = 0; i < kUnknowns; ++i) u_I[i] += sums[i];
}

float FullFrameRotation::line_share() const {
  float explained = 0, all = cost_;
  for (const Line& line : lines_) {
    if (line.I_I == 0) continue;
    // What the gain found so far has explained, and what its next step would.
    const float found = line.gain * line.gain * line.I_I;
    explained += found + line.I_e * line.I_e / line.I_I;
    all += found;
  }
  return all > kMinCost * static_cast<float>(count_) ? explained / all : 0;
}

// Schur complement of the lines' gains.
void FullFrameRotation::eliminate_lines() {
  for (const Line& line : lines_) {
    if (line.I_I == 0) continue;
    const float scale = kLineShare / line.I_I;
    for (int j = 0; j < kUnknowns; ++j) {
      for (int k = 0; k <= j; ++k) equations_.A(j, k) -= scale * line.u_I[j] * line.u_I[k];
      equations_.b(j) += scale * line.u_I[j] * line.I_e;
    }
  }
}

FitStep FullFrameRotation::step(int iteration) {
  if (count_ < (width_ - 2) * (height_ - 2) / kOverlapShare) return FitStep::kFailed;
  if (lamp_bands_) eliminate_lines();
  result_.residual = std::sqrt(cost_ / static_cast<float>(count_));
  // The prior kGainPull on parameters 3, 5 and 6 (gain, gain_x, gain_y).
  const float from_even[kUnknowns] = {0, 0, 0, 1.0f - gain_.gain, 0, -gain_.x, -gain_.y};
  for (const int j : {3, 5, 6}) {
    equations_.A(j, j) += kGainPull;
    equations_.b(j) += kGainPull * from_even[j];
  }
  float x[kUnknowns];
  if (!equations_.solve(kMinRotationPivot, x)) return FitStep::kFailed;
  for (int i = 0; i < 3; ++i)
    if (!(equations_.information(i) > kMinInformation)) return FitStep::kFailed;
  const Vector3f turn(x[0], x[1], x[2]);
  const float size = turn.norm();
  if (size > kMaxStep_rad) return FitStep::kFailed;
  result_.R_cp = result_.R_cp * so3_exp(turn);
  gain_.gain += x[3];
  gain_.offset += x[4];
  gain_.x += x[5];
  gain_.y += x[6];
  if (lamp_bands_) {
    for (Line& line : lines_) {
      if (line.I_I == 0) continue;
      float step = line.I_e;
      for (int i = 0; i < kUnknowns; ++i) step += line.u_I[i] * x[i];
      line.gain += kLineShare * step / line.I_I;
    }
  }
  if (!(size < kConverged_rad) && iteration + 1 < kMaxIterations) return FitStep::kAgain;

  const float variance = std::max(result_.residual * result_.residual, kMinVariance_grey2);
  for (int i = 0; i < 3; ++i) {
    float column[kUnknowns];
    equations_.covariance_column(i, 0, column);
    for (int j = 0; j < 3; ++j) result_.covariance(j, i) = column[j] * variance;
  }
  result_.R_cp = orthonormalised(result_.R_cp);
  result_.line_share = line_share();
  result_.near = result_.residual < kMaxResidual_grey && gain_.gain > kMinGain && gain_.gain < 1 / kMinGain;
  result_.ok = result_.near && size < kMaxLastStep_rad;
  return FitStep::kConverged;
}

}  // namespace pptam
