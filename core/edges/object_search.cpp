#include "edges/object_search.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "base/deterministic_math.h"

namespace pptam {

namespace {

// None of these was swept.
constexpr int kSmallest_px = 60;     // of the level's shorter side, at least
constexpr float kSteepest = 0.12f;   // share of the pixels that are edges
constexpr int kLeastSteepness = 24;  // of Sobel's mask: 6 grey values from pixel to pixel
constexpr uint8_t kFar = 18;         // thirds of a pixel: farther edges count as if they were there
constexpr int kStep_px = 2;          // between places, level pixels
constexpr int kSidesSeen = 48, kRolls = 12;
// Half of the object's extent, shares of the image's shorter side.
constexpr float kSizes[] = {0.17f, 0.24f, 0.34f, 0.46f};
constexpr float kSpacing_px = 2.5f;  // of sites, level pixels
constexpr int kFewestMarks = 12;
// Cosines and sines of the directions, middles of 30 degrees each.
constexpr float kCosine[] = {1, 0.8660254f, 0.5f, 0, -0.5f, -0.8660254f};
constexpr float kSine[] = {0, 0.5f, 0.8660254f, 1, 0.8660254f, 0.5f};

int direction_of(float x, float y) {
  int best = 0;
  float most = -1;
  for (int i = 0; i < 6; ++i) {
    const float along = std::abs(x * kCosine[i] + y * kSine[i]);
    if (along <= most) continue;
    most = along;
    best = i;
  }
  return best;
}

// The object seen from side i of kSidesSeen, spread evenly over the sphere, and rolled; its middle on the optical axis.
Matrix3f view_from(int i, int roll) {
  constexpr float kGolden = 2.3999632f, kTurn = 6.2831853f;
  const float z = 1 - (2 * static_cast<float>(i) + 1) / kSidesSeen, r = std::sqrt(1 - z * z);
  const float around = kGolden * static_cast<float>(i) - kTurn * std::floor(kGolden * static_cast<float>(i) / kTurn);
  const Vector3f forward(-r * det_cos(around), -r * det_sin(around), -z);
  const Vector3f other = std::abs(forward.z()) < 0.8f ? Vector3f(0, 0, 1) : Vector3f(1, 0, 0);
  const Vector3f across = forward.cross(other).normalized(), down = forward.cross(across);
  const float angle = kTurn * static_cast<float>(roll) / kRolls;
  const float c = det_cos(angle), s = det_sin(angle);
  Matrix3f R;
  R.row(0) = (c * across + s * down).transpose();
  R.row(1) = (c * down - s * across).transpose();
  R.row(2) = forward.transpose();
  return R;
}

}  // namespace

ObjectSearch::ObjectSearch(Arena& arena, const Camera& camera, const ModelParts& parts)
    : camera_(camera), parts_(parts) {
  const int shorter = std::min(camera.model.width, camera.model.height);
  while (level_ + 1 < kPyramidLevels && shorter >> (level_ + 1) >= kSmallest_px) ++level_;
  width_ = camera.model.width >> level_;
  height_ = camera.model.height >> level_;
  maps_ = FixedVector<uint8_t>(arena, kDirections * width_ * height_);
  steepness_ = FixedVector<int16_t>(arena, width_ * height_);
  constexpr int kMostMarks = 400;
  marks_ = FixedVector<Mark>(arena, kMostMarks);
}

// The steepest pixels, in the maps of their direction and of both beside it: 0; all others kFar. Sobel's masks give at
// most 1020 in x and y each.
void ObjectSearch::find_edges(const GreyView& image) {
  maps_.resize(maps_.capacity());
  steepness_.resize(steepness_.capacity());
  std::fill(maps_.begin(), maps_.end(), kFar);
  std::fill(steepness_.begin(), steepness_.end(), int16_t{0});
  constexpr int kBins = 256, kPerBin = 8;  // 2040 is the largest sum
  int histogram[kBins] = {};
  const auto slope = [&](int x, int y, int* gx, int* gy) {
    const uint8_t *a = image.row(y - 1) + x, *b = image.row(y) + x, *c = image.row(y + 1) + x;
    *gx = a[1] + 2 * b[1] + c[1] - a[-1] - 2 * b[-1] - c[-1];
    *gy = c[-1] + 2 * c[0] + c[1] - a[-1] - 2 * a[0] - a[1];
  };
  for (int y = 1; y + 1 < height_; ++y) {
    for (int x = 1; x + 1 < width_; ++x) {
      int gx, gy;
      slope(x, y, &gx, &gy);
      const int steep = std::abs(gx) + std::abs(gy);
      steepness_[y * width_ + x] = static_cast<int16_t>(steep);
      ++histogram[std::min(steep / kPerBin, kBins - 1)];
    }
  }
  int bin = kBins - 1, wanted = static_cast<int>(kSteepest * static_cast<float>(width_ * height_));
  while (bin > 0 && (wanted -= histogram[bin]) > 0) --bin;
  const int least = std::max(kLeastSteepness, bin * kPerBin);
  for (int y = 1; y + 1 < height_; ++y) {
    for (int x = 1; x + 1 < width_; ++x) {
      if (steepness_[y * width_ + x] < least) continue;
      int gx, gy;
      slope(x, y, &gx, &gy);
      const int direction = direction_of(static_cast<float>(gx), static_cast<float>(gy));
      for (const int near : {direction, (direction + 1) % kDirections, (direction + kDirections - 1) % kDirections})
        maps_[near * width_ * height_ + y * width_ + x] = 0;
    }
  }
}

// By two passes with steps of 3 and 4 thirds of a pixel.
void ObjectSearch::measure_distances() {
  int64_t sum = 0, squares = 0;
  for (int d = 0; d < kDirections; ++d) {
    uint8_t* map = maps_.data() + d * width_ * height_;
    const auto nearer = [&](int at, int from, int step) {
      map[at] = static_cast<uint8_t>(std::min<int>(map[at], map[from] + step));
    };
    for (int y = 1; y < height_; ++y) {
      for (int x = 1; x + 1 < width_; ++x) {
        const int at = y * width_ + x;
        nearer(at, at - 1, 3);
        nearer(at, at - width_, 3);
        nearer(at, at - width_ - 1, 4);
        nearer(at, at - width_ + 1, 4);
      }
    }
    for (int y = height_ - 2; y >= 0; --y) {
      for (int x = width_ - 2; x > 0; --x) {
        const int at = y * width_ + x;
        nearer(at, at + 1, 3);
        nearer(at, at + width_, 3);
        nearer(at, at + width_ + 1, 4);
        nearer(at, at + width_ - 1, 4);
      }
    }
    for (int i = 0; i < width_ * height_; ++i) {
      sum += map[i];
      squares += map[i] * map[i];
    }
  }
  const float count = static_cast<float>(kDirections * width_ * height_);
  mean_ = static_cast<float>(sum) / count;
  deviation_ = std::sqrt(std::max(static_cast<float>(squares) / count - mean_ * mean_, 0.01f));
}

// T: the object's middle on the optical axis.
bool ObjectSearch::make_marks(const SE3& T, ModelView& view, FixedVector<ContourSite>* sites) {
  view.set_pose(T);
  view.make_sites(level_, kSpacing_px, Vector6f::Zero(), sites);
  marks_.clear();
  Vector2f middle;
  if (!camera_.project(T * parts_.middle(), &middle)) return false;
  const float unit = 1 / static_cast<float>(1 << level_);
  for (const ContourSite& site : *sites) {
    const Vector2f d = (site.px - middle) * unit;
    if (!marks_.push_back({static_cast<int16_t>(std::lrint(d.x())), static_cast<int16_t>(std::lrint(d.y())),
                           static_cast<uint8_t>(direction_of(site.normal.x(), site.normal.y()))}))
      break;
  }
  return marks_.size() >= kFewestMarks;
}

// Over all places at which they lie within the image; proposes the best one. The deviation of a mean of n is that of
// one by the root of n, if they knew nothing of each other.
void ObjectSearch::shift_marks(const SE3& T) {
  int left = 0, right = 0, up = 0, down = 0;
  for (const Mark& mark : marks_) {
    left = std::max<int>(left, -mark.dx);
    right = std::max<int>(right, mark.dx);
    up = std::max<int>(up, -mark.dy);
    down = std::max<int>(down, mark.dy);
  }
  const float n = static_cast<float>(marks_.size());
  const float least = count_ < kProposals ? 0 : kept_[kProposals - 1].unlikelihood;
  const float limit = n * (mean_ - least * deviation_ / std::sqrt(n));
  if (!(limit > 0)) return;
  int best = static_cast<int>(limit), best_x = -1, best_y = -1;
  for (int y = up; y + down < height_; y += kStep_px) {
    for (int x = left; x + right < width_; x += kStep_px) {
      int sum = 0;
      for (const Mark& mark : marks_) {
        sum += distances(mark.direction)[(y + mark.dy) * width_ + x + mark.dx];
        if (sum >= best) break;
      }
      if (sum >= best) continue;
      best = sum;
      best_x = x;
      best_y = y;
    }
  }
  if (best_x < 0) return;
  // There the object is seen along another ray, turned as that is.
  const Vector2f ray =
      camera_.unproject({to_level0(static_cast<float>(best_x), level_), to_level0(static_cast<float>(best_y), level_)});
  const Vector3f d = Vector3f(ray.x(), ray.y(), 1).normalized();
  const Matrix3f K = hat(Vector3f(-d.y(), d.x(), 0));  // z x d
  const Matrix3f R = (Matrix3f::Identity() + K + K * K / (1 + d.z())) * T.R;
  const float distance = (T * parts_.middle()).z();
  const SE3 there(orthonormalised(R), d * distance - R * parts_.middle());
  propose(there, (mean_ - static_cast<float>(best) / n) * std::sqrt(n) / deviation_);
}

void ObjectSearch::propose(const SE3& T, float unlikelihood) {
  int place = count_;
  while (place > 0 && kept_[place - 1].unlikelihood < unlikelihood) --place;
  if (place >= kProposals) return;
  count_ = std::min(count_ + 1, kProposals);
  for (int k = count_ - 1; k > place; --k) kept_[k] = kept_[k - 1];
  kept_[place] = {T, unlikelihood};
}

std::span<const SE3> ObjectSearch::run(const Pyramid& pyramid, ModelView& view, FixedVector<ContourSite>* sites) {
  count_ = 0;
  find_edges(pyramid.level[level_]);
  measure_distances();
  const float focal = 0.5f * (camera_.model.fx + camera_.model.fy);
  const float shorter = static_cast<float>(std::min(camera_.model.width, camera_.model.height));
  for (int side = 0; side < kSidesSeen; ++side) {
    for (int roll = 0; roll < kRolls; ++roll) {
      SE3 T;
      T.R = view_from(side, roll);
      for (const float size : kSizes) {
        T.t = Vector3f(0, 0, focal * parts_.extent() / (size * shorter)) - T.R * parts_.middle();
        if (make_marks(T, view, sites)) shift_marks(T);
      }
    }
  }
  for (int i = 0; i < count_; ++i) poses_[i] = kept_[i].T;
  return {poses_, static_cast<size_t>(count_)};
}

}  // namespace pptam
