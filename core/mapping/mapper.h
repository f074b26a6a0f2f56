// The map maker: what happens in idle time [ptam 6, phone 3, 5.2].
//
//   a new map becomes one that may be shown (InitialMap);
//   a new keyframe is inserted: measurements taken over, remaining visible points searched, new points made by the
//   point source; then bundle adjustment, local and full, and hygiene;
//   where there are too many keyframes one goes, or the newcomer if none can.
#pragma once

#include "map/map.h"
#include "map/patch_search.h"
#include "mapping/bundle_adjustment.h"
#include "mapping/culling.h"
#include "mapping/hygiene.h"
#include "mapping/initial_map.h"
#include "mapping/keyframe_pose.h"
#include "mapping/point_source.h"
#include "scheduler/task.h"

namespace pptam {

class Mapper : public Background {
 public:
  // Point source and keyframe culling are Config's.
  Mapper(Arena& arena, const Config& config, Map& map, WorkMeter& meter, CornerSource* corner_source);

  bool has_work() const;
  void work_slice();

 private:
  Task<> run();
  Task<> finish_initial_map();
  Task<> insert_keyframe();
  Task<> make_room();
  Task<> measure_remaining_points(int keyframe);
  Task<> adjust_all();

  const Config& config_;
  Map& map_;
  BundleAdjuster bundle_;
  KeyframePose pose_;
  InitialMap initial_map_;
  KeyframeCulling* culling_;
  KeyframeEraser eraser_;
  PointSource* point_source_;
  Hygiene hygiene_;
  PatchFinder finder_;
  Task<> task_;
  bool resting_ = true;  // the job has nothing left to do
  bool local_pending_ = false, full_pending_ = false;
  int newest_ = -1;
  int velocity_rounds_ = 0;
  uint32_t epoch_ = UINT32_MAX;  // of the map that the job works on; none yet
};

}  // namespace pptam
