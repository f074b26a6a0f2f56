// The profile of the 2009 phone: the parts that its Config names.
#include <utility>

#include <pocket_ptam/config.h>

namespace pptam {

// The phone's capacities are Config's default values.
Config Config::phone(const CameraModel& model) {
  Config config;
  config.corner_source = create_shi_tomasi_corners;
  config.initialiser = create_homography_initialiser;
  config.point_source = create_partial_points;
  config.culling = create_keyframe_votes;
  config.camera.model = model;
  return config;
}

Config Config::tiny(const CameraModel& model) {
  Config config = phone(model);
  config.search_level = 0;
  config.coarse_search_level = 1;
  if (model.width > model.height) std::swap(config.cells_x, config.cells_y);
  config.max_keyframes = 10;
  config.max_erased_keyframes = 2;
  config.max_maps = 1;
  config.max_map_points = 300;
  config.max_measurements = 800;
  config.max_partial_points = 50;
  config.max_initial_points = 70;
  return config;
}

}  // namespace pptam
