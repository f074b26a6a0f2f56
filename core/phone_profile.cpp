// The profile of the 2009 phone: the parts that its Config names.
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

}  // namespace pptam
