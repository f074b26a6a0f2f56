// The mapper: the background job that makes and maintains the map in idle time [ptam 6, phone 3, 5.2].
//
// - A map that an initialiser has made is finished (InitialMap).
// - A new keyframe is inserted: the tracker's measurements are taken over, the remaining visible points are searched,
//   and the point source makes new points. Then follow bundle adjustment, local and full, and Hygiene.
// - When there are too many keyframes the least useful one is erased. If none can be, the new one is discarded.
#pragma once

#include <pocket_ptam/tracer.h>
#include "map/map.h"
#include "map/patch_search.h"
#include "mapping/bundle_adjustment.h"
#include "mapping/ground.h"
#include "mapping/hygiene.h"
#include "mapping/initial_map.h"
#include "mapping/keyframe_culling.h"
#include "mapping/keyframe_pose.h"
#include "mapping/point_source.h"
#include "scheduler/task.h"

namespace pptam {

class Mapper : public Background {
 public:
  // Builds point source and keyframe culling by Config's functions.
  Mapper(Arena& arena, const Config& config, Map& map, WorkMeter& meter, CornerSource* corner_source);

  bool has_work() const;
  void work_slice(Tracer* tracer = nullptr);
  Ground& ground() { return ground_; }

 private:
  void begin_or_go_on();
  void turn_to(Span job);
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
  Ground ground_;
  InitialMap initial_map_;
  KeyframeCulling* culling_;
  KeyframeEraser eraser_;
  PointSource* point_source_;
  Hygiene hygiene_;
  PatchFinder finder_;
  Task<> task_;
  Tracer* tracer_ = nullptr;  // of the present slice
  Span job_ = Span::kTidy;    // what is being done, for the tracer
  bool resting_ = true;       // the job has nothing left to do
  bool local_pending_ = false, full_pending_ = false;
  int newest_ = -1;              // keyframe to adjust locally; -1: none
  int velocity_rounds_ = 0;      // since the last new keyframe
  uint32_t epoch_ = UINT32_MAX;  // Map::epoch() that the job works on; at first none
};

}  // namespace pptam
