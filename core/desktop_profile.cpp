// The profile of the 2007 desktop system: the parts and capacities that its Config names.
#include <pocket_ptam/config.h>

namespace pptam {

namespace {

// The homography's start searches in L1 alone. The phone's corners are found there, in L2 and in L0; FAST's in one
// level.
Initialiser* create_start(Arena& arena, const Config& config, WorkMeter& meter, CornerSource*) {
  return create_homography_initialiser(arena, config, meter, create_shi_tomasi_corners(arena, config, meter));
}

}  // namespace

Config Config::desktop(const CameraModel& model) {
  Config config;
  config.corner_source = create_fast_corners;
  config.initialiser = create_start;
  config.point_source = create_epipolar_points;
  config.culling = create_keyframe_votes;
  config.camera.model = model;
  config.max_keyframes = 100;  // 40 to 120 in [ptam 4]
  config.max_erased_keyframes = 4;
  config.max_maps = 1;
  config.max_map_points = 5000;            // 2000 to 6000 in [ptam 4]
  config.max_measurements = 40000;         // ten of each point
  config.max_measurements_per_point = 20;  // not swept
  config.max_partial_points = 0;
  config.max_partial_searches = 0;
  config.max_new_partial_points = 0;
  config.max_measured_points = 1000;  // [ptam 5.5]
  config.max_coarse_points = 50;      // [ptam 5.5]
  config.own_levels = true;
  config.cells_x = 16;
  config.cells_y = 12;
  config.min_keyframe_interval_s = 0.67f;  // twenty frames [ptam 6.2]
  // Not the 2007 computer but a desktop of today, as sim_phone/profiles/desktop.yaml: assumed, not measured.
  config.profile.clock_mhz = 3000;
  config.profile.cycles_per_instruction = 0.4f;
  return config;
}

}  // namespace pptam
