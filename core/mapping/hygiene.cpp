#include "mapping/hygiene.h"

#include "mapping/culling.h"
#include "mapping/neighbours.h"

namespace pptam {

namespace {

constexpr float kMinReliability = 0.3f;
constexpr int kMinAttempts = 20;
// Of a point with two measurements: nothing but searches can show that its depth is wrong.
constexpr int kMinAttemptsOfTwo = 6;

}  // namespace

Task<> Hygiene::cull_measurements() {
  for (int i = 0; i < map_.points().size(); ++i) {
    pptam::cull_measurements(map_, i, config_.camera, meter_);
    co_await background_.spend(Work::kOther, 30);
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
  co_await background_.spend(Work::kOther, 10LL * map_.points().size());
}

Task<> Hygiene::tidy() {
  for (; left_ > 0 && map_.queue().waiting() == 0; --left_) {
    const int i = next_;
    next_ = (next_ + 1) % map_.points().size();
    const MapPoint& point = map_.points()[i];
    if (point.id == 0) continue;
    const Neighbours neighbours = find_neighbours(map_, i);
    meter_.charge(Work::kOther, 12LL * map_.points().size() + 5000);
    Vector3f normal_k;
    if (fit_patch_normal(map_, neighbours, &normal_k)) map_.set_normal(i, normal_k);
    for (int n = 1; n < neighbours.size() && point.id != 0; ++n) merge_if_same(i, neighbours[n]);
    co_await background_.spend(Work::kOther, 400LL * neighbours.size());
  }
}

// If they are the same physical point the one measured more often takes over the other's measurements.
void Hygiene::merge_if_same(int a, int b) {
  const bool a_stays = map_.points()[a].measurements.size() >= map_.points()[b].measurements.size();
  const int stays = a_stays ? a : b, goes = a_stays ? b : a;
  if (!explains(map_, config_.camera, map_.points()[stays], map_.points()[goes])) return;
  // Taken out first: their places may be needed.
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
