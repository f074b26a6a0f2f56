// Sites of a pose sought in one pyramid level, and the pose that fits what was found: the step that everything else
// repeats, from other poses and in other levels.
//
//   ModelView::make_sites ─▶ search each ─▶ weigh by contrast and neighbours ─▶ Servoing
//
// What the sites have shown is remembered here, for each level and place along a contour. A frame is begun with
// begin(); once its pose is certain, report() says what each site found and learn() remembers it.
#pragma once

#include <pocket_ptam/model_tracker.h>
#include "base/containers.h"
#include "edges/edge_search.h"
#include "edges/model_view.h"
#include "edges/object_search.h"
#include "edges/servoing.h"
#include "image/pyramid.h"

namespace pptam {

constexpr int kModelLevels = 3;  // pyramid levels searched, at most: 0 to 2

// A pose and how well the picture agrees with it.
struct Hypothesis {
  SE3 T_co;
  float quality = 0;   // 0 to 1: of the contours that should be visible, how much looks as it did
  ServoingResult fit;  // in the finest level
};

// What is expected of the pose: 1-sigma of a turn about the object's middle, radians, and of a shift of the middle, in
// its distances, about T_co.
struct PosePrior {
  static constexpr float kFree = 0.5f;  // as good as none
  SE3 T_co;
  float turn = kFree, shift = kFree;
};

class EdgeMatching {
 public:
  // config must outlive this; its camera is prepared.
  EdgeMatching(Arena& arena, const ModelTrackerConfig& config);

  const ModelParts& parts() const { return parts_; }
  int coarsest() const { return coarsest_; }
  // The finest level worth searching: 0, and coarser where the image is blurred.
  int finest() const { return finest_; }
  void set_finest(int level) { finest_ = level; }

  void forget();  // all that the sites have shown
  // A new frame. velocity: of T_co, for the rolling shutter (units/s, radians/s). The pyramid must stay alive.
  void begin(const Pyramid& pyramid, const Vector6f& velocity);
  void set_velocity(const Vector6f& velocity) { velocity_ = velocity; }
  void set_prior(const PosePrior& prior) { prior_ = prior; }

  // One search along the normals, `range` pixels of the level to either side, and servoing.
  ServoingResult fit(const SE3& T_co, int level, int range);
  // From level `from` to the finest one; `range` is that of the first.
  Hypothesis refine(const SE3& T_co, int from, int range);
  // In the finest level once more: sites and measurements become those of this hypothesis.
  void refit(Hypothesis* hypothesis);
  // How well the picture agrees with a pose as it is, without a search beyond a pixel of the level: 0 to 1.
  float evidence(const SE3& T_co, int level);

  // Poses that may be the object's, when nothing is known of it.
  std::span<const SE3> propose(ObjectSearch& search) { return search.run(pyramid_, view_, &sites_); }

  // After refine() or refit() of this hypothesis.
  void report(const Hypothesis& found, ModelResult* result);
  // After report(): remembers what supported sites show. certain: of the whole pose; else only those are learnt that
  // surely look as they did. Sees how sharp the image is.
  void learn(const SE3& T_co, bool certain);

 private:
  SiteMemory& memory(const ContourSite& site, int level) {
    return memory_[(level * parts_.contours() + site.contour) * kSiteBuckets + site.bucket];
  }
  uint8_t& supported(const ContourSite& site) { return supported_[site.contour * kSiteBuckets + site.bucket]; }
  Vector2f in_level(const ContourSite& site, int level) const {
    return {from_level0(site.px.x(), level), from_level0(site.px.y(), level)};
  }
  float spacing(int level) const;
  float support_px() const;
  float shown_length() const;
  float quality() const;
  void search(int site, int level, int range);
  void weigh_by_contrast();
  void weigh_by_neighbours();
  ModelSite judged(const ContourSite& site, const EdgeMeasurement* measurement, const SE3& since_search) const;
  uint8_t support_of(const ModelSite& judged, const EdgeMeasurement* measurement) const;

  const ModelTrackerConfig& config_;
  ModelParts parts_;
  ModelView view_;
  Servoing servoing_;
  int coarsest_ = 0, finest_ = 0;

  // By contour and bucket, the first also by level.
  FixedVector<SiteMemory> memory_;
  FixedVector<uint8_t> supported_;  // in the last report
  float usual_length_ = 0;          // shown_length() of frames with a pose: nearly the most

  // The frame.
  Pyramid pyramid_;
  Vector6f velocity_ = Vector6f::Zero();
  PosePrior prior_;
  int frames_ = 0;  // modulo kOtherLevels

  // The last search.
  FixedVector<ContourSite> sites_;
  float spacing_px_ = 0;  // of them, level 0
  FixedVector<EdgeMeasurement> measurements_;
  FixedVector<int16_t> profiles_;  // kMaxProfile for each site
  FixedVector<float> values_;      // working storage, by site
  FixedVector<ModelSite> reported_;
};

}  // namespace pptam
