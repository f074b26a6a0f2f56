#include "sim_phone/sensor.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <utility>

#include "sim_phone/compression.h"
#include "sim_phone/random.h"

namespace pptam::sim {
namespace {

using Eigen::Isometry3d;
using Eigen::Matrix3d;
using Eigen::Quaterniond;

constexpr int kPoses = 129;      // over one frame: under 1 ms apart, interpolation errors far below 1e-3 px
constexpr int kMinSamples = 8;   // per pixel, a power of two
constexpr int kMaxSamples = 32;  // in fast motion: about one a pixel of blur
constexpr double kNear_m = 0.02;

// With the nominal gain, full scale is kElectrons: 2.1 grey levels rms at mid grey (0.22 of full scale, where gamma
// makes 265 grey levels of one unit), of them 1.7 shot noise and 1.1 read noise; 3.8 in the shadows (0.03 of full
// scale).
constexpr double kElectrons = 5200;
constexpr double kReadNoise = 0.0042;  // of full scale
constexpr double kGamma = 2.2;

constexpr double kTargetMean = 0.27;  // auto-exposure: mean of the linear image
constexpr double kExposureLag_s = 0.5;
constexpr double kNominalGain = 0.7;  // at which the noise is as stated
constexpr double kDarkest = 0.01;     // mean of the linear image under which the lens is covered: the exposure is held

// log2 by the exponent and a linear mantissa: continuous, at most 0.09 wrong.
float rough_log2(float x) {
  return static_cast<float>(std::bit_cast<int32_t>(x)) * 0x1.0p-23f - 127.0f;
}

// Normal distribution from the sum of four 16-bit uniforms, rms 1, at most 3.46.
float rough_gaussian(uint64_t bits) {
  const int sum = static_cast<int>(bits & 0xffff) + static_cast<int>((bits >> 16) & 0xffff) +
                  static_cast<int>((bits >> 32) & 0xffff) + static_cast<int>(bits >> 48);
  return (static_cast<float>(sum) - 131070.0f) * (1.7320508f / 65536.0f);
}

// Where in the pixel, in the exposure and between mip levels a sample lies. Units: pixels, exposures, levels.
struct SamplePoint {
  double x, y, time;
  float level;
};

// count = 2^bits points, centred on zero. Each coordinate alone takes count evenly spaced values, so that an upright or
// level edge and a moving one are integrated exactly to 1/count; together they are spread as by Hammersley.
std::array<SamplePoint, kMaxSamples> sample_points(int count) {
  const auto reversed = [count](int i) {
    int r = 0;
    for (int bit = 1; bit < count; bit *= 2) r = 2 * r + ((i & bit) != 0 ? 1 : 0);
    return r;
  };
  std::array<SamplePoint, kMaxSamples> points{};
  for (int i = 0; i < count; ++i) {
    const auto centred = [count](int k) { return (k % count + 0.5) / count - 0.5; };
    const double level = (reversed((i * 5 + 3) % count) + 0.5) / count;
    points[static_cast<size_t>(i)] = {centred(3 * i), centred(reversed(i)), centred(i), static_cast<float>(level)};
  }
  return points;
}

// T_wc at at_s, had the camera kept the speed that it has at t_s.
Isometry3d evenly_moved(const MotionCurve& motion, double t_s, double at_s) {
  constexpr double kStep_s = 1e-3;  // of the central difference: 0.1 % of a 10 Hz tremor's speed is lost
  const Isometry3d before = motion(t_s - kStep_s), after = motion(t_s + kStep_s);
  Isometry3d T = motion(t_s);
  const Eigen::AngleAxisd turn(Eigen::Matrix3d(before.linear().transpose() * after.linear()));
  const double share = (at_s - t_s) / (2 * kStep_s);
  T.linear() = T.linear() * Eigen::AngleAxisd(share * turn.angle(), turn.axis()).toRotationMatrix();
  T.translation() += share * (after.translation() - before.translation());
  return T;
}

}  // namespace

// A surface as one line sees it. At place s along the line, sample k sees texel (u, v) / w with inverse depth w, each
// linear in s.
struct Sensor::Candidate {
  const Surface* surface = nullptr;
  bool held = false;             // of the occluder: in the camera's frame
  const Mover* mover = nullptr;  // in its frame; null: in the world's
  int first = 0;                 // part of the line that it can cover
  int last = 0;
  float width = 0;  // texels
  float height = 0;
  struct Linear {
    float u0, u1, v0, v1, w0, w1;
    float log2_area;  // of a pixel in texels at w = 1
  };
  std::array<Linear, kMaxSamples> samples;
};

// One line of the image during its exposure.
struct Sensor::Line {
  int index = 0;
  double t_s = 0;                  // mid-exposure
  Isometry3d early, middle, late;  // T_cw at the exposure's begin, middle and end
  Matrix3d K_inv;                  // pixel to ray of depth 1
  size_t candidates = 0;           // the first so many of candidates_
  double blur_px = 0;              // the largest on the line
  int samples = 0;                 // of a pixel
  double spread_px = 1;            // of the samples: a pixel, and the blur of the focus
  std::array<SamplePoint, kMaxSamples> points;
  struct Ray {
    Eigen::Vector3f start, step;  // world: at place s of the line, start + s * step
  };
  std::array<Ray, kMaxSamples> rays;  // of each sample; with gloss alone
};

Sensor::Sensor(const Scene& scene, MotionCurve motion, const SensorOptions& options)
    : scene_(scene), motion_(std::move(motion)), options_(options) {
  const CameraModel& m = options_.model;
  columns_ = options_.shutter.axis == RollingShutter::Axis::kColumns;
  lines_ = columns_ ? m.width : m.height;
  line_length_ = columns_ ? m.height : m.width;
  table_rotation_.resize(kPoses);
  table_position_.resize(kPoses);
  const size_t pixels = static_cast<size_t>(m.width) * static_cast<size_t>(m.height);
  linear_.resize(pixels);
  vignetting_.resize(pixels);
  size_t surfaces = scene_.surfaces.size() + (options_.occluder ? options_.occluder->surfaces.size() : 0);
  for (const auto& mover : options_.movers) surfaces += mover->surfaces.size();
  candidates_.resize(surfaces);
  focus_ = focus_curve(options_.harsh.breathing, options_.seed);
  if (options_.harsh.gloss > 0) gloss_ = std::make_unique<Gloss>(options_.harsh.gloss, options_.seed);
  for (int y = 0; y < m.height; ++y) {
    for (int x = 0; x < m.width; ++x) {
      const float a = (static_cast<float>(x) - m.cx) / m.fx;
      const float b = (static_cast<float>(y) - m.cy) / m.fy;
      const float cos_sq = 1 / (1 + a * a + b * b);  // natural vignetting falls with cos^4
      vignetting_[static_cast<size_t>(y) * static_cast<size_t>(m.width) + static_cast<size_t>(x)] = cos_sq * cos_sq;
    }
  }
}

Sensor::~Sensor() = default;

void Sensor::expose(double t_s, uint64_t frame_index, uint8_t* out) {
  integrate(t_s);
  if (options_.noise) {
    develop(t_s, frame_index, out);
  } else {
    for (size_t i = 0; i < linear_.size(); ++i) {
      out[i] = static_cast<uint8_t>(std::clamp(255.0f * linear_[i] + 0.5f, 0.0f, 255.0f));
    }
  }
  if (options_.harsh.compression > 0)
    compress(out, options_.model.width, options_.model.height, options_.harsh.compression);
}

Isometry3d Sensor::pose(double t_s) const {
  const double place = std::clamp((t_s - table_start_s_) / table_step_s_, 0.0, kPoses - 1.001);
  const size_t i = static_cast<size_t>(place);
  const double f = place - static_cast<double>(i);
  Isometry3d T = Isometry3d::Identity();
  const Eigen::Vector4d q = (1 - f) * table_rotation_[i].coeffs() + f * table_rotation_[i + 1].coeffs();
  T.linear() = Quaterniond(q).normalized().toRotationMatrix();
  T.translation() = (1 - f) * table_position_[i] + f * table_position_[i + 1];
  return T;
}

void Sensor::integrate(double t_s) {
  const double readout_s = std::abs(static_cast<double>(options_.shutter.line_time_s)) * lines_;
  const double span_s = std::max(readout_s + options_.exposure_s, 1e-6);
  table_start_s_ = t_s - 0.5 * span_s;
  table_step_s_ = span_s / (kPoses - 1);
  for (size_t i = 0; i < kPoses; ++i) {
    const double at_s = table_start_s_ + static_cast<double>(i) * table_step_s_;
    const Isometry3d T = options_.even_readout ? evenly_moved(motion_, t_s, at_s) : motion_(at_s);
    Quaterniond q(T.linear());
    if (i > 0 && q.dot(table_rotation_[i - 1]) < 0) q.coeffs() = -q.coeffs();
    table_rotation_[i] = q;
    table_position_[i] = T.translation();
  }
  for (int line = 0; line < lines_; ++line) render_line(line, t_s);
}

void Sensor::render_line(int index, double t_s) {
  Line line = line_at(index, t_s);
  find_surfaces(&line);
  if (options_.occluder) find_held(&line);
  find_moving(&line);
  choose_samples(&line);
  aim(&line);
  trace(line, mean_light(line));
}

Sensor::Line Sensor::line_at(int index, double t_s) {
  const CameraModel& m = options_.model;
  Line line;
  line.index = index;
  line.t_s = t_s + (index - 0.5 * (lines_ - 1)) * static_cast<double>(options_.shutter.line_time_s);
  line.early = pose(line.t_s - 0.5 * options_.exposure_s).inverse();
  line.middle = pose(line.t_s).inverse();
  line.late = pose(line.t_s + 0.5 * options_.exposure_s).inverse();
  line.K_inv << 1.0 / m.fx, 0, -m.cx / m.fx, 0, 1.0 / m.fy, -m.cy / m.fy, 0, 0, 1;
  if (focus_) {
    const Focus focus = focus_(line.t_s);
    constexpr double kUsualWidth = 240;  // of Focus::blur_px
    image_scale_ = focus.scale;
    line.K_inv.topRows<2>() /= image_scale_;
    line.spread_px = 1 + 2 * focus.blur_px * m.width / kUsualWidth;
  }
  return line;
}

Vector2d Sensor::projected(const Vector3d& p_c) const {
  const CameraModel& m = options_.model;
  return Vector2d(image_scale_ * m.fx * p_c.x() / p_c.z() + m.cx, image_scale_ * m.fy * p_c.y() / p_c.z() + m.cy);
}

// Which surfaces can be seen, and in which part of the line.
void Sensor::find_surfaces(Line* line) {
  const Vector3d camera = pose(line->t_s).translation();
  for (const Surface& s : scene_.surfaces) {
    const Vector3d normal = s.v_axis.cross(s.u_axis);
    if (normal.dot(camera - s.origin) <= 0) continue;
    Vector2d low(1e9, 1e9), high(-1e9, -1e9);
    bool whole = false;
    for (int corner = 0; corner < 4; ++corner) {
      const Vector3d p =
          s.origin + (corner & 1 ? s.width_m : 0.0) * s.u_axis + (corner & 2 ? s.height_m : 0.0) * s.v_axis;
      for (const Isometry3d* T : {&line->early, &line->middle, &line->late}) {
        const Vector3d p_c = *T * p;
        if (p_c.z() < kNear_m) {
          whole = true;
        } else {
          const Vector2d px = projected(p_c);
          low = low.cwiseMin(px);
          high = high.cwiseMax(px);
        }
      }
    }
    if (whole) {
      low.setConstant(-1e9);
      high.setConstant(1e9);
    }
    add_candidate(s, low, high, line);
  }
}

// Held things move on their own: all that may come into the line during its exposure.
void Sensor::find_held(Line* line) {
  for (const Surface& s : options_.occluder->surfaces) {
    Vector2d low(1e9, 1e9), high(-1e9, -1e9);
    bool near = false;
    Vector2d corner_px[2];  // at the exposure's ends
    for (const double time : {-0.5, 0.0, 0.5}) {
      const Vector3d at = options_.occluder->position(line->t_s + time * options_.exposure_s);
      for (int corner = 0; corner < 4; ++corner) {
        const Vector3d p =
            at + s.origin + (corner & 1 ? s.width_m : 0.0) * s.u_axis + (corner & 2 ? s.height_m : 0.0) * s.v_axis;
        near = near || p.z() < kNear_m;
        const Vector2d px = projected(p);
        low = low.cwiseMin(px);
        high = high.cwiseMax(px);
        if (corner == 0 && time != 0) corner_px[time > 0 ? 1 : 0] = px;
      }
    }
    if (near) continue;
    Candidate* const candidate = add_candidate(s, low, high, line);
    if (candidate == nullptr) continue;
    candidate->held = true;
    line->blur_px = std::max(line->blur_px, (corner_px[0] - corner_px[1]).norm());
  }
}

// Likewise what moves in the scene.
void Sensor::find_moving(Line* line) {
  const double half_s = 0.5 * options_.exposure_s;
  const double times[] = {line->t_s - half_s, line->t_s, line->t_s + half_s};
  const Isometry3d* const cameras[] = {&line->early, &line->middle, &line->late};
  for (const auto& mover : options_.movers) {
    Isometry3d T_cm[3];
    for (int i = 0; i < 3; ++i) T_cm[i] = *cameras[i] * mover->T_wm(times[i]);
    const Vector3d camera_m = T_cm[1].inverse().translation();
    for (const Surface& s : mover->surfaces) {
      if (s.v_axis.cross(s.u_axis).dot(camera_m - s.origin) <= 0) continue;
      Vector2d low(1e9, 1e9), high(-1e9, -1e9);
      bool near = false;
      Vector2d corner_px[3];
      for (int corner = 0; corner < 4; ++corner) {
        const Vector3d p =
            s.origin + (corner & 1 ? s.width_m : 0.0) * s.u_axis + (corner & 2 ? s.height_m : 0.0) * s.v_axis;
        for (int i = 0; i < 3; ++i) {
          const Vector3d p_c = T_cm[i] * p;
          if (p_c.z() < kNear_m) {
            near = true;
            continue;
          }
          const Vector2d px = projected(p_c);
          low = low.cwiseMin(px);
          high = high.cwiseMax(px);
          if (corner == 0) corner_px[i] = px;
        }
      }
      if (near) {
        low.setConstant(-1e9);
        high.setConstant(1e9);
      }
      Candidate* const candidate = add_candidate(s, low, high, line);
      if (candidate == nullptr) continue;
      candidate->mover = mover.get();
      if (!near) line->blur_px = std::max(line->blur_px, (corner_px[0] - corner_px[2]).norm());
    }
  }
}

Sensor::Candidate* Sensor::add_candidate(const Surface& surface, const Vector2d& low, const Vector2d& high,
                                         Line* line) {
  constexpr double kMargin = 2;  // half a pixel, and what the motion's curvature may add
  const int across = columns_ ? 0 : 1;
  const int along = 1 - across;
  if (line->index < low[across] - kMargin || line->index > high[across] + kMargin) return nullptr;
  Candidate& c = candidates_[line->candidates];
  c.first = static_cast<int>(std::max(0.0, low[along] - kMargin));
  c.last = static_cast<int>(std::min(line_length_ - 1.0, high[along] + kMargin));
  if (c.first > c.last) return nullptr;
  c.surface = &surface;
  c.held = false;
  c.mover = nullptr;
  c.width = static_cast<float>(surface.width_m / surface.texel_m);
  c.height = static_cast<float>(surface.height_m / surface.texel_m);
  ++line->candidates;
  return &c;
}

double Sensor::mean_light(const Line& line) const {
  if (!options_.light) return 1;
  constexpr int kLightSamples = 16;  // over the exposure: 2 to 4 ms apart
  double light = 0;
  for (int i = 0; i < kLightSamples; ++i) {
    light += options_.light(line.t_s + ((i + 0.5) / kLightSamples - 0.5) * options_.exposure_s) / kLightSamples;
  }
  return light;
}

// As many as the blur asks for: of what is held, and near the line's ends, for things at a short arm's length.
void Sensor::choose_samples(Line* line) const {
  constexpr double kSamplesOfSpread = 4;  // for a pixel of blur in either direction
  for (const double along : {0.1, 0.9}) {
    const double s = along * (line_length_ - 1);
    const Vector3d ray = line->K_inv * (columns_ ? Vector3d(line->index, s, 1) : Vector3d(s, line->index, 1));
    const Vector3d p = line->middle.inverse() * (0.4 * ray);
    const Vector3d a = line->early * p;
    const Vector3d b = line->late * p;
    if (a.z() > kNear_m && b.z() > kNear_m)
      line->blur_px = std::max(line->blur_px, (projected(a) - projected(b)).norm());
  }
  if (line->spread_px > 1) line->blur_px = std::max(line->blur_px, kSamplesOfSpread * line->spread_px);
  line->samples = kMinSamples;
  while (line->samples < line->blur_px && line->samples < kMaxSamples) line->samples *= 2;
  line->points = sample_points(line->samples);
}

// Each candidate's texels along the line, for each sample.
void Sensor::aim(Line* line) {
  for (int k = 0; k < line->samples; ++k) {
    const SamplePoint& point = line->points[static_cast<size_t>(k)];
    const double t_s = line->t_s + point.time * options_.exposure_s;
    const Isometry3d T_wc = pose(t_s);
    const Matrix3d world_rays = T_wc.linear() * line->K_inv;  // pixel to direction in the world, of depth 1
    const double aside_x = point.x * line->spread_px, aside_y = point.y * line->spread_px;
    const double x = columns_ ? line->index + aside_x : aside_x;
    const double y = columns_ ? aside_y : line->index + aside_y;
    if (gloss_) {
      line->rays[static_cast<size_t>(k)] = {(world_rays * Vector3d(x, y, 1)).cast<float>(),
                                            world_rays.col(columns_ ? 1 : 0).cast<float>()};
    }
    const Vector3d held_o = options_.occluder ? Vector3d(-options_.occluder->position(t_s)) : Vector3d(0, 0, 0);
    for (size_t i = 0; i < line->candidates; ++i) {
      Candidate& c = candidates_[i];
      const Surface& s = *c.surface;
      Matrix3d rays = c.held ? line->K_inv : world_rays;
      Vector3d o = c.held ? held_o : T_wc.translation();
      if (c.mover != nullptr) {
        const Isometry3d T_mw = c.mover->T_wm(t_s).inverse();
        rays = T_mw.linear() * rays;
        o = T_mw * o;
      }
      // The ray o + d / w meets the plane where w = n.d / n.(origin - o); there u w = U.(o - origin) w + U.d.
      const Vector3d normal = s.v_axis.cross(s.u_axis);
      const Vector3d from_origin = o - s.origin;
      Matrix3d H;
      H.row(2) = (rays.transpose() * normal).transpose() / -normal.dot(from_origin);
      H.row(0) = (from_origin.dot(s.u_axis) * H.row(2) + s.u_axis.transpose() * rays) / s.texel_m;
      H.row(1) = (from_origin.dot(s.v_axis) * H.row(2) + s.v_axis.transpose() * rays) / s.texel_m;
      const Vector3d start = H * Vector3d(x, y, 1);
      const Vector3d step = H.col(columns_ ? 1 : 0);
      // The map from pixels to texels stretches areas by det H / w^3.
      const float log2_area = static_cast<float>(std::log2(std::abs(H.determinant()) + 1e-12));
      c.samples[static_cast<size_t>(k)] = {static_cast<float>(start[0]),
                                           static_cast<float>(step[0]),
                                           static_cast<float>(start[1]),
                                           static_cast<float>(step[1]),
                                           static_cast<float>(start[2]),
                                           static_cast<float>(step[2]),
                                           log2_area};
    }
  }
}

// (u, v): texels.
float Sensor::varnished(const Line& line, int sample, float place, const Candidate& c, float u, float v,
                        float diffuse) {
  const Line::Ray& ray = line.rays[static_cast<size_t>(sample)];
  const float texel_m = static_cast<float>(c.surface->texel_m);
  return gloss_->seen(*c.surface, u * texel_m, v * texel_m, ray.start + place * ray.step, diffuse);
}

// The nearest candidate at each place, for each sample; their mean goes into linear_.
void Sensor::trace(const Line& line, double light) {
  // Samples lie closer than pixels do: filter to half a pixel, the rest is their mean's work.
  constexpr float kSharper = -1.0f;
  constexpr float kSeam_texels = 0.02f;  // neighbouring surfaces overlap by this, so that rounding leaves no cracks
  const int width = options_.model.width;
  float* const out = linear_.data() + (columns_ ? line.index : line.index * width);
  const int out_step = columns_ ? width : 1;
  const float mean = static_cast<float>(light) / static_cast<float>(line.samples);
  for (int place = 0; place < line_length_; ++place) {
    const float s = static_cast<float>(place);
    float sum = 0;
    for (int k = 0; k < line.samples; ++k) {
      const Candidate* nearest = nullptr;
      float nearest_w = 0, nearest_u = 0, nearest_v = 0;
      for (size_t i = 0; i < line.candidates; ++i) {
        const Candidate& c = candidates_[i];
        if (place < c.first || place > c.last) continue;
        const Candidate::Linear& l = c.samples[static_cast<size_t>(k)];
        const float w = l.w0 + l.w1 * s;
        if (w <= nearest_w) continue;
        const float u = l.u0 + l.u1 * s;
        const float v = l.v0 + l.v1 * s;
        const float seam = kSeam_texels * w;
        if (u < -seam || v < -seam || u > c.width * w + seam || v > c.height * w + seam) continue;
        nearest = &c;
        nearest_w = w;
        nearest_u = u;
        nearest_v = v;
      }
      if (nearest == nullptr) {
        sum += scene_.background;
        continue;
      }
      const float log2_area = nearest->samples[static_cast<size_t>(k)].log2_area - 3 * rough_log2(nearest_w);
      // Levels are chosen at random in proportion to their distance, which over the samples is trilinear filtering.
      const float level = 0.5f * log2_area + kSharper + line.points[static_cast<size_t>(k)].level;
      const Texture& texture = nearest->surface->texture;
      const int top = static_cast<int>(texture.levels.size()) - 1;
      const int chosen = level <= 0 ? 0 : std::min(static_cast<int>(level), top);
      const float scale = 1 / nearest_w;
      const float diffuse =
          texture.sample(nearest_u * scale, nearest_v * scale, chosen) * nearest->surface->light * (1.0f / 65535.0f);
      const bool fixed = !nearest->held && nearest->mover == nullptr;
      sum += gloss_ && fixed ? varnished(line, k, s, *nearest, nearest_u * scale, nearest_v * scale, diffuse) : diffuse;
    }
    out[place * out_step] = sum * mean;
  }
}

void Sensor::develop(double t_s, uint64_t frame_index, uint8_t* out) {
  double total = 0;
  for (size_t i = 0; i < linear_.size(); ++i) {
    linear_[i] *= vignetting_[i];
    total += static_cast<double>(linear_[i]);
  }
  const double brightness = total / static_cast<double>(linear_.size());
  const double metered = brightness < kDarkest && gain_ != 0 ? gain_ : kTargetMean / std::max(brightness, 1e-3);
  if (gain_ == 0) {
    gain_ = metered;  // the camera has been running before its first image
    last_t_s_ = t_s;
  }
  const float gain = static_cast<float>(gain_);
  const float relative = static_cast<float>(gain_ / kNominalGain);
  const float shot = relative / static_cast<float>(kElectrons);
  const float read = relative * relative * static_cast<float>(kReadNoise * kReadNoise);
  const uint64_t stream = mixed(mixed(options_.seed) ^ (frame_index + 0x5e5));
  for (size_t i = 0; i < linear_.size(); ++i) {
    const float light = gain * linear_[i];
    const float noisy = light + std::sqrt(light * shot + read) * rough_gaussian(mixed(stream + i));
    const float grey = 255.0f * std::pow(std::clamp(noisy, 0.0f, 1.0f), static_cast<float>(1 / kGamma));
    out[i] = static_cast<uint8_t>(grey + 0.5f);
  }
  // The gain for the next image moves towards what this one asks for.
  const double share = 1 - std::exp(-(t_s - last_t_s_) / kExposureLag_s);
  gain_ *= std::pow(metered / gain_, std::max(share, 0.05));
  last_t_s_ = t_s;
}

}  // namespace pptam::sim
