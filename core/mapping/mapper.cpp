#include "mapping/mapper.h"

#include "base/assert.h"
#include "mapping/measurement_culling.h"

namespace pptam {

namespace {

// Bytes for the coroutine frames of nested jobs, such as run > insert_keyframe > grow > add_corners. Not swept; too few
// end in an assertion.
constexpr size_t kFrameBytes = 24 * 1024;
// Accepted steps of one adjustment at most; an unfinished full adjustment is continued. Nine of ten synthetic maps take
// at most eight (tests/unit). Not swept.
constexpr int kBundleIterations = 12;
// Live keyframes from which on a new keyframe is adjusted locally first: with fewer, local and full adjustment are
// nearly the same problem. Not swept.
constexpr int kMinKeyframesForLocal = 8;
// Full adjustments after each keyframe before which the velocities are estimated anew. Three are no better, neither on
// finished maps nor in runs (tests/MEASURED.md), and mapping takes 1.4 times the instructions.
constexpr int kVelocityRounds = 1;
// Search of known points in a new keyframe: radius in pixels of the level searched, and
// SearchOptions::max_relative_zmssd. Narrower and stricter than the tracker's 4 and 0.4, since the pose is known. Not
// swept.
constexpr float kRemainingRadius_px = 3;
constexpr float kRemainingZmssd = 0.3f;

// ARMv6 instructions, estimates. The sum over a run's mapping is within 10 % of the count (tests/budget).
constexpr int64_t kClearPointInstructions = 100;     // of one slot of map points
constexpr int64_t kAddMeasurementInstructions = 60;  // of one of the tracker's measurements
constexpr int64_t kDiscardInstructions = 50;         // of one slot of map points, when the new keyframe is discarded
constexpr int64_t kLookUpInstructions = 100;         // whether a point is measured in the new keyframe

}  // namespace

Mapper::Mapper(Arena& arena, const Config& config, Map& map, WorkMeter& meter, CornerSource* corner_source)
    : Background(arena, kFrameBytes, meter),
      config_(config),
      map_(map),
      bundle_(arena, config, map, meter, *this),
      pose_(arena, config, map, meter, *this),
      ground_(arena, config, map, meter, *this),
      initial_map_(config, map, *this, bundle_, pose_, ground_),
      culling_(config.culling(arena, config, map, meter, *this)),
      eraser_(arena, config, map, *this),
      point_source_(config.point_source(arena, config, map, meter, *this, corner_source)),
      hygiene_(config, map, meter, *this),
      finder_(map, config, meter) {}

bool Mapper::has_work() const {
  if (!map_.exists() || map_.looking() || (map_.locked() && map_.ready())) return false;
  return epoch_ != map_.epoch() || !resting_ || map_.queue().waiting() > 0 || !map_.ready();
}

void Mapper::work_slice(Tracer* tracer) {
  if (!has_work()) return;
  tracer_ = tracer;
  if (epoch_ != map_.epoch()) job_ = Span::kTidy;
  if (tracer_) {
    tracer_->begin(Span::kSlice);
    tracer_->begin(job_);
  }
  begin_or_go_on();
  map_.check_consistency();
  if (!tracer_) return;
  tracer_->end(job_);
  tracer_->end(Span::kSlice);
}

// Says what the slice works on from now on.
void Mapper::turn_to(Span job) {
  if (job == job_) return;
  if (tracer_) {
    tracer_->end(job_);
    tracer_->begin(job);
  }
  job_ = job;
}

void Mapper::begin_or_go_on() {
  if (epoch_ != map_.epoch()) {
    // The map that the paused job worked on has been cleared, or has other coordinates.
    epoch_ = map_.epoch();
    abandon();
    task_ = Task<>();
    local_pending_ = false;
    full_pending_ = map_.ready();
    newest_ = -1;
    velocity_rounds_ = 0;
    hygiene_.forget();
    task_ = run();
    resting_ = false;
    task_.start();
    return;
  }
  resting_ = false;
  resume();
}

Task<> Mapper::run() {
  co_await hygiene_.cull_measurements();  // the job before may have been dropped during an insertion
  for (;;) {
    if (map_.exists() && !map_.ready()) {
      turn_to(Span::kFinishMap);
      co_await finish_initial_map();
    } else if (map_.live_count() > map_.max_live()) {  // an insertion was dropped
      co_await make_room();
    } else if (map_.erased_count() > map_.max_erased()) {  // an erasure was dropped
      turn_to(Span::kCull);
      co_await eraser_.forget_surplus();
    } else if (map_.queue().waiting() > 0) {
      co_await insert_keyframe();
    } else if (local_pending_) {
      local_pending_ = false;
      turn_to(Span::kAdjustNew);
      co_await bundle_.run(newest_, false, kBundleIterations);
    } else if (full_pending_) {
      turn_to(Span::kAdjust);
      co_await adjust_all();
    } else if (hygiene_.refining()) {
      turn_to(Span::kTidy);
      co_await hygiene_.refine_points();
    } else {
      turn_to(Span::kTidy);
      resting_ = true;
      co_await rest();
    }
  }
}

Task<> Mapper::finish_initial_map() {
  const bool good = co_await initial_map_.finish();
  if (!good) {
    map_.clear();
    meter_.charge(Work::kOther, kClearPointInstructions * map_.points().size());
    resting_ = true;
    co_await rest();  // the epoch has changed: the next slice begins a new job
    co_return;
  }
  map_.finish();
  newest_ = map_.keyframes().size() - 1;
  co_await point_source_->grow(newest_);
}

// One full adjustment. It stays pending until it has converged, and for kVelocityRounds more, each after the velocities
// have been estimated anew.
Task<> Mapper::adjust_all() {
  full_pending_ = false;
  co_await bundle_.run(-1, false, kBundleIterations);
  if (!bundle_.result().converged) {
    full_pending_ = true;
    co_return;
  }
  co_await hygiene_.discard_unreliable_points();
  hygiene_.begin_round();
  if (velocity_rounds_ < kVelocityRounds) {
    ++velocity_rounds_;
    co_await pose_.update_velocities();
    full_pending_ = true;
  }
}

Task<> Mapper::insert_keyframe() {
  turn_to(Span::kInsert);
  KeyframeCandidate& candidate = map_.queue().front();
  const int keyframe = map_.add_keyframe(candidate.frame);
  if (keyframe < 0) {
    map_.queue().pop();
    co_return;
  }
  for (const KeyframeMeasurement& m : candidate.measurements)
    if (map_.points()[m.point].id == m.point_id) map_.add_measurement(m.point, {m.at, static_cast<int16_t>(keyframe)});
  meter_.charge(Work::kOther, kAddMeasurementInstructions * candidate.measurements.size());
  map_.queue().pop();
  if (map_.live_count() > map_.max_live()) co_await make_room();
  if (!map_.keyframes()[keyframe].live()) co_return;
  turn_to(Span::kInsert);
  co_await hygiene_.cull_measurements();  // after make_room(): a discarded keyframe costs no measurement
  newest_ = keyframe;
  co_await measure_remaining_points(keyframe);
  co_await point_source_->grow(keyframe);
  local_pending_ = map_.live_count() >= kMinKeyframesForLocal;
  full_pending_ = true;
  velocity_rounds_ = 0;
}

// Called with one keyframe too many: erases the least useful one [phone 3.3]. If none can be erased, the newest
// keyframe is discarded, and the map is full.
Task<> Mapper::make_room() {
  turn_to(Span::kCull);
  int gone = co_await culling_->choose();
  PPTAM_ASSERT(gone != 0);
  if (gone > 0) {
    map_.set_full(false);
    co_await eraser_.erase(gone);
    co_await eraser_.forget_surplus();
    co_return;
  }
  map_.set_full(true);
  gone = -1;
  for (int k = 0; k < map_.keyframes().size(); ++k)
    if (map_.keyframes()[k].live() && (gone < 0 || map_.keyframes()[k].id > map_.keyframes()[gone].id)) gone = k;
  map_.erase_keyframe(gone);
  map_.forget_keyframe(gone);
  meter_.charge(Work::kOther, kDiscardInstructions * map_.points().size());
}

// Searches the points that should be visible in a new keyframe and that the tracker has not measured in it.
Task<> Mapper::measure_remaining_points(int keyframe) {
  SearchOptions options;
  options.level = level_of_points(config_);
  options.radius_px = kRemainingRadius_px;
  options.max_relative_zmssd = kRemainingZmssd;
  for (int i = 0; i < map_.points().size(); ++i) {
    const MapPoint& point = map_.points()[i];
    if (point.id == 0) continue;
    co_await slice();
    const bool measured = map_.measured_in(point, keyframe);
    meter_.charge(Work::kOther, kLookUpInstructions);
    if (measured) continue;
    PredictedPoint predicted;
    meter_.charge(Work::kOther, kPredictionInstructions);
    if (!predict_in_keyframe(map_, config_, keyframe, point.p_w, &predicted)) continue;
    ImagePoint found;
    const SearchOutcome outcome =
        finder_.find(point.source, point.p_w, predicted, map_.keyframes()[keyframe].pyramid, options, &found);
    if (outcome != SearchOutcome::kNotVisible) map_.count_search(i, outcome == SearchOutcome::kFound);
    if (outcome == SearchOutcome::kFound) {
      map_.add_measurement(i, {found, static_cast<int16_t>(keyframe)});
      cull_measurements(map_, i, config_.camera, meter_);
    }
  }
}

}  // namespace pptam
