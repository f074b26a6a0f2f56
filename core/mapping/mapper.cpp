#include "mapping/mapper.h"

namespace pptam {

namespace {

constexpr size_t kFrameBytes = 24 * 1024;  // nested jobs' frames: run > insert_keyframe > ..., run > bundle > ...
constexpr int kBundleIterations = 12;
constexpr int kFullFromKeyframes = 8;  // below, local and full adjustment are nearly the same problem
constexpr int kVelocityRounds = 3;     // bundle adjustments with re-estimated velocities after each keyframe

}  // namespace

Mapper::Mapper(Arena& arena, const Config& config, Map& map, WorkMeter& meter, CornerSource* corner_source)
    : Background(arena, kFrameBytes, meter),
      config_(config),
      map_(map),
      bundle_(arena, config, map, meter, *this),
      pose_(arena, config, map, meter, *this),
      initial_map_(arena, config, map, meter, *this, bundle_, pose_),
      culling_(config.culling(arena, config, map, meter, *this)),
      eraser_(arena, config, map, *this),
      point_source_(config.point_source(arena, config, map, meter, *this, corner_source)),
      hygiene_(config, map, meter, *this),
      finder_(map, config.camera, meter) {}

bool Mapper::has_work() const {
  if (!map_.exists() || (map_.locked() && map_.ready())) return false;
  return epoch_ != map_.epoch() || !resting_ || map_.queue().waiting() > 0 || !map_.ready();
}

void Mapper::work_slice() {
  if (!has_work()) return;
  if (epoch_ != map_.epoch()) {
    // The map that the paused job worked on is gone, or has another scale.
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
    map_.check_consistency();
    return;
  }
  resting_ = false;
  resume();
  map_.check_consistency();
}

Task<> Mapper::run() {
  co_await hygiene_.cull_measurements();  // an insertion may have been given up half-way
  for (;;) {
    if (map_.exists() && !map_.ready()) {
      co_await finish_initial_map();
    } else if (map_.live_count() > config_.max_keyframes) {  // an insertion was given up half-way
      co_await make_room();
    } else if (map_.erased_count() > config_.max_erased_keyframes) {  // likewise
      co_await eraser_.forget_surplus();
    } else if (map_.queue().waiting() > 0) {
      co_await insert_keyframe();
    } else if (local_pending_) {
      local_pending_ = false;
      co_await bundle_.run(newest_, true, kBundleIterations);
    } else if (full_pending_) {
      co_await adjust_all();
    } else if (hygiene_.untidy()) {
      co_await hygiene_.tidy();
    } else {
      resting_ = true;
      co_await rest();
    }
  }
}

Task<> Mapper::finish_initial_map() {
  const bool good = co_await initial_map_.finish();
  if (!good) {
    map_.clear();
    meter_.charge(Work::kOther, 100LL * map_.points().size());
    resting_ = true;
    co_await rest();  // the next slice starts afresh: the epoch has changed
    co_return;
  }
  map_.finish();
  newest_ = map_.keyframes().size() - 1;
  co_await point_source_->grow(newest_);
}

// Again and again until it has converged, also with velocities that are estimated anew in between.
Task<> Mapper::adjust_all() {
  full_pending_ = false;
  co_await bundle_.run(-1, true, kBundleIterations);
  if (!bundle_.result().converged) {
    full_pending_ = true;
    co_return;
  }
  co_await hygiene_.discard_unreliable_points();
  hygiene_.begin_round();
  if (map_.live_count() > kMaxVelocityCameras && velocity_rounds_ < kVelocityRounds) {
    ++velocity_rounds_;
    co_await pose_.update_velocities();
    full_pending_ = true;
  }
}

Task<> Mapper::insert_keyframe() {
  KeyframeCandidate& candidate = map_.queue().front();
  const int keyframe = map_.add_keyframe(candidate.frame);
  if (keyframe < 0) {
    map_.queue().pop();
    co_return;
  }
  for (const KeyframeMeasurement& m : candidate.measurements)
    if (map_.points()[m.point].id == m.point_id) map_.add_measurement(m.point, {m.at, static_cast<int16_t>(keyframe)});
  meter_.charge(Work::kOther, 60LL * candidate.measurements.size());
  map_.queue().pop();
  if (map_.live_count() > config_.max_keyframes) co_await make_room();
  if (!map_.keyframes()[keyframe].live()) co_return;
  co_await hygiene_.cull_measurements();  // now that it is known that the keyframe stays
  newest_ = keyframe;
  co_await measure_remaining_points(keyframe);
  co_await point_source_->grow(keyframe);
  local_pending_ = map_.live_count() >= kFullFromKeyframes;
  full_pending_ = true;
  velocity_rounds_ = 0;
}

// One keyframe too many: the least useful one goes [phone 3.3]. If none can, the newest one does, and the map is full.
Task<> Mapper::make_room() {
  int gone = co_await culling_->choose();
  if (gone >= 0) {
    map_.set_full(false);
    co_await eraser_.erase(gone);
    co_await eraser_.forget_surplus();
    co_return;
  }
  map_.set_full(true);
  for (int k = 0; k < map_.keyframes().size(); ++k)
    if (map_.keyframes()[k].live() && (gone < 0 || map_.keyframes()[k].id > map_.keyframes()[gone].id)) gone = k;
  map_.erase_keyframe(gone);
  map_.forget_keyframe(gone);
  meter_.charge(Work::kOther, 50LL * map_.points().size());
}

// The tracker measures the most useful points of a frame only; the others that should be visible are searched now.
Task<> Mapper::measure_remaining_points(int keyframe) {
  SearchOptions options;
  options.level = config_.search_level;
  options.radius_px = 3;
  options.max_relative_zmssd = 0.3f;
  for (int i = 0; i < map_.points().size(); ++i) {
    const MapPoint& point = map_.points()[i];
    if (point.id == 0) continue;
    co_await slice();
    const bool measured = map_.measured_in(point, keyframe);
    meter_.charge(Work::kOther, 100);
    if (measured) continue;
    PredictedPoint predicted;
    meter_.charge(Work::kOther, kPredictionInstructions);
    if (!predict_in_keyframe(map_, config_.camera, keyframe, point.p_w, &predicted)) continue;
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
