// Everything that can be set, and the parts that a profile is made of.
#pragma once

#include <pocket_ptam/camera.h>
#include <pocket_ptam/work_meter.h>

namespace pptam {

class Arena;
class Background;
class CornerSource;     // image/corner_source.h
class Initialiser;      // tracking/initialiser.h
class KeyframeCulling;  // mapping/culling.h
class Map;
class PointSource;  // mapping/point_source.h
struct Config;

// A profile names its parts by the functions that build them, so that what no profile names is not linked. Each builds
// one part in the arena (Arena::create), which measures first: the part is null then, and what it would have been given
// may be.
using CreateCornerSource = CornerSource*(Arena&, const Config&, WorkMeter&);
using CreateInitialiser = Initialiser*(Arena&, const Config&, WorkMeter&, CornerSource*);
using CreatePointSource = PointSource*(Arena&, const Config&, Map&, WorkMeter&, Background&, CornerSource*);
using CreateKeyframeCulling = KeyframeCulling*(Arena&, const Config&, Map&, WorkMeter&, Background&);

CreateCornerSource create_shi_tomasi_corners;     // multi-scale [phone 3.1]
CreateInitialiser create_homography_initialiser;  // two-stage, from one tap [phone 5.1]
CreatePointSource create_partial_points;          // inverse depth, frame by frame [phone 5.2]
CreateKeyframeCulling create_usefulness_culling;  // by votes [phone 3.3]

// Everything that can be set, passed once. Capacities bound memory and time; a full one shows in
// TrackResult::limits_hit.
struct Config {
  // Parts. A Config of the default constructor has none: begin with phone().
  CreateCornerSource* corner_source = nullptr;  // one, for initialiser and point source
  CreateInitialiser* initialiser = nullptr;
  CreatePointSource* point_source = nullptr;
  CreateKeyframeCulling* culling = nullptr;

  Camera camera;            // lens and shutter; camera.model.prepare() is called by System::create
  float exposure_s = 0.0f;  // 0: unknown; used to predict motion blur

  // Live keyframes: bundle adjusted, measured by the map's points. Beyond, the least useful one is erased for each new
  // one [phone 3.3].
  int max_keyframes = 35;
  // Erased keyframes that keep their images, for patches and to find the way back; the least useful is forgotten then.
  // Each takes 4/3 bytes a pixel.
  int max_erased_keyframes = 35;
  int max_map_points = 1000;  // 35 keyframes with 25 new points each, and the first view's
  // Of all map points together, beyond the two that each point needs and has a place for; 24 bytes each.
  int max_measurements = 6000;
  // Beyond, the least useful one of a point goes [phone 3.2]. 2 to 32.
  int max_measurements_per_point = 8;
  int max_partial_points = 100;
  int max_measured_points = 50;     // per frame [phone 4]
  int max_partial_searches = 12;    // per frame [phone 7]
  int max_new_partial_points = 25;  // per keyframe [phone 5.2]
  int max_initial_points = 100;     // tracked by the homography
  // Measured points are spread over so many cells of the image, across and down. 1 to 16 each.
  int cells_x = 6, cells_y = 8;
  // Pyramid levels searched: of a sharp frame [phone 4], and of a blurred one or in a wide search. 0 to 4.
  int search_level = 1, coarse_search_level = 2;

  float initial_baseline = 0.1f;  // length of the sideways start in world units [ptam 6.1]
  // Distance of the first view's camera centre from the dominant plane, world units, when the user knows it: sets the
  // scale in place of initial_baseline. 0: not known.
  float initial_plane_distance = 0;
  // Initialisation begins by itself, without a tap, when the camera has been held still for 0.3 s before a textured
  // view; again whenever it has failed, until there is a map.
  bool auto_start = false;
  float min_keyframe_interval_s = 0.2f;
  // A camera that stands still is shown still: while the whole image is at rest the pose shown follows the measured one
  // only as far as noise does not explain the difference. Off: every pose as measured.
  bool steady_damping = true;

  PhoneProfile profile;  // turns charged work into time (the work clock)

  // The 2009 phone's parts and capacities, for a camera of any size from 64x64 to 4096x4096. Its shutter is global
  // until camera.shutter is set.
  static Config phone(const CameraModel& model);
  Status validate() const;
};

}  // namespace pptam
