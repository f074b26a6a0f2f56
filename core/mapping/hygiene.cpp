#include "mapping/hygiene.h"

#include "mapping/measurement_culling.h"
#include "mapping/neighbours.h"

namespace pptam {

namespace {

// Share of successful searches under which a point is removed, a ratio. Not swept.
constexpr float kMinReliability = 0.3f;
constexpr int kMinAttempts = 20;  // searches before a point is judged; not swept
// Searches before a point with two measurements is judged: nothing else can show that its depth is wrong. On the
// emulated phone (seven scenes, 47 runs) 2.9 % of the points had depths wrong by more than 5 % without this rule, 1.9 %
// with 6 searches, 1.7 % with 4 at no smaller errors of position.
constexpr int kMinAttemptsOfTwo = 6;

// ARMv6 instructions, estimates. The sum over a run's mapping is within 10 % of the count (tests/budget).
constexpr int64_t kLookInstructions = 30;       // at one point, for measurements to cull
constexpr int64_t kJudgeInstructions = 10;      // of one slot of map points
constexpr int64_t kNeighbourInstructions = 12;  // of one slot of map points, in the search for neighbours
constexpr int64_t kNormalInstructions = 5000;   // of one patch's plane
constexpr int64_t kCompareInstructions = 400;   // of two neighbours

}  // namespace

Task<> Hygiene::cull_measurements() {
  for (int i = 0; i < map_.points().size(); ++i) {
    pptam::cull_measurements(map_, i, config_.camera, meter_);
    co_await background_.spend(Work::kOther, kLookInstructions);
  }
}

Task<> Hygiene::discard_unreliable_points() {
  for (int i = 0; i < map_.points().size(); ++i) {
    const MapPoint& point = map_.points()[i];
    const int enough = point.measurements.size() > 2 ? kMinAttempts : kMinAttemptsOfTwo;
    if (point.id != 0 && point.attempts >= enough &&
        static_cast<float>(point.found) < kMinReliability * static_cast<float>(point.attempts))
      map_.remove_point(i);
  }
  co_await background_.spend(Work::kOther, kJudgeInstructions * map_.points().size());
}

Task<> Hygiene::refine_points() {
  for (; left_ > 0 && map_.queue().waiting() == 0; --left_) {
    const int i = next_;
    next_ = (next_ + 1) % map_.points().size();
    const MapPoint& point = map_.points()[i];
    if (point.id == 0) continue;
    const Neighbours neighbours = find_neighbours(map_, i);
    meter_.charge(Work::kOther, kNeighbourInstructions * map_.points().size() + kNormalInstructions);
    Vector3f normal_k;
    if (fit_patch_normal(map_, neighbours, &normal_k)) map_.set_normal(i, normal_k);
    for (int n = 1; n < neighbours.size() && point.id != 0; ++n) merge_if_same(i, neighbours[n]);
    co_await background_.spend(Work::kOther, kCompareInstructions * neighbours.size());
  }
}

// Merges two points if they are the same physical point: the one with more measurements explains all of the other's. It
// takes over the other's measurements, and the other one is removed.
void Hygiene::merge_if_same(int a, int b) {
  const bool a_stays = map_.points()[a].measurements.size() >= map_.points()[b].measurements.size();
  const int stays = a_stays ? a : b, goes = a_stays ? b : a;
  if (!explains(map_, config_.camera, map_.points()[stays], map_.points()[goes])) return;
  // The other point is removed first, so that its measurements' places can be used again.
  Measurement taken[kMaxMeasurementsPerPoint + 1];
  int count = 0;
  for (const Measurement& m : map_.measurements(map_.points()[goes]))
    if (!map_.measured_in(map_.points()[stays], m.keyframe)) taken[count++] = m;
  map_.remove_point(goes);
  for (int i = 0; i < count; ++i) {
    map_.add_measurement(stays, taken[i]);
    pptam::cull_measurements(map_, stays, config_.camera, meter_);
  }
}

}  // namespace pptam
