// The map maker: what happens in idle time [ptam 6, phone 3, 5.2].
//
//   a new map is bundle adjusted and laid on its dominant plane;
//   a new keyframe is inserted: measurements taken over, remaining visible points searched, partial points promoted,
//   new corners become partial points; then bundle adjustment, local and full; then bad points go;
//   when nothing else is to do, the points that are one become one, and patches turn as they lie;
//   where there are too many keyframes one goes, or the newcomer if none can.
#pragma once

#include "camera/pose_update.h"
#include "image/corners.h"
#include "map/map.h"
#include "map/patch_search.h"
#include "mapping/bundle_adjustment.h"
#include "mapping/culling.h"
#include "scheduler/task.h"

namespace pptam {

class Mapper : public Background {
 public:
  Mapper(Arena& arena, const Config& config, Map& map, WorkMeter& meter);

  bool has_work() const;
  void work_slice();

 private:
  Task<> run();
  Task<> finish_initial_map();
  Task<bool> locate_initial_views();
  Task<> measure_initial_velocities();
  Task<> insert_keyframe();
  Task<> make_room();
  Task<> cull_surplus_measurements();
  Task<> measure_remaining_points(int keyframe);
  Task<> promote_partial_points(int keyframe);
  Task<> add_partial_points(int keyframe);
  Task<> update_velocities();
  Task<> discard_unreliable_points();
  Task<> tidy_points();
  void merge_if_same(int a, int b);
  Task<> gather_pose_points(int keyframe, int most);
  Task<bool> align_to_dominant_plane();
  // Where the point appears in the keyframe, rolling shutter included.
  bool predict_in_keyframe(int keyframe, const Vector3f& p_w, PredictedPoint* predicted) const;

  const Config& config_;
  Map& map_;
  BundleAdjuster bundle_;
  KeyframeCuller culler_;
  CornerDetector corner_detector_;
  PatchFinder finder_;
  FixedVector<PosePoint> pose_points_;
  PoseUpdater pose_;
  FixedVector<Vector2f> occupied_;  // level-0 pixels of a keyframe that already have a point
  Task<> task_;
  bool resting_ = true;  // the job has nothing left to do
  bool local_pending_ = false, full_pending_ = false;
  int newest_ = -1;
  int velocity_rounds_ = 0;
  int tidy_next_ = 0, tidy_left_ = 0;  // tidy_points(): slot of Map::points, and how many more
  uint32_t epoch_ = UINT32_MAX;        // of the map that the job works on; none yet
};

}  // namespace pptam
