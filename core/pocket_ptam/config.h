// All settings, and the exchangeable parts that a profile names.
#pragma once

#include <pocket_ptam/camera.h>
#include <pocket_ptam/work_meter.h>

namespace pptam {

class Arena;
class Background;
class CornerSource;     // image/corner_source.h
class Initialiser;      // tracking/initialiser.h
class KeyframeCulling;  // mapping/keyframe_culling.h
class Map;
class PointSource;  // mapping/point_source.h
struct Config;

// A profile names its parts by the functions that build them, so that parts which no profile names are not linked. Each
// function builds one part in the arena (Arena::create). In an arena that only measures it returns null, and the
// CornerSource argument may be null.
using CreateCornerSource = CornerSource*(Arena&, const Config&, WorkMeter&);
using CreateInitialiser = Initialiser*(Arena&, const Config&, WorkMeter&, CornerSource*);
using CreatePointSource = PointSource*(Arena&, const Config&, Map&, WorkMeter&, Background&, CornerSource*);
using CreateKeyframeCulling = KeyframeCulling*(Arena&, const Config&, Map&, WorkMeter&, Background&);

CreateCornerSource create_shi_tomasi_corners;     // multi-scale [phone 3.1]
CreateCornerSource create_fast_corners;           // FAST-10 in four levels [ptam 5.1, 6.2]
CreateInitialiser create_homography_initialiser;  // two-stage, from one tap [phone 5.1]
CreatePointSource create_partial_points;          // inverse depth, frame by frame [phone 5.2]
CreatePointSource create_epipolar_points;         // epipolar search between two keyframes [ptam 6.2]
CreateKeyframeCulling create_keyframe_votes;      // keyframes are ranked by their points' votes [phone 3.3]

// All settings, passed once to System::create. Capacities (max_...) are counts that bound memory and time. A capacity
// that was reached shows in TrackResult::limits_hit. "Not swept": no other value was measured.
struct Config {
  // Parts. The default constructor names none: begin with phone().
  CreateCornerSource* corner_source = nullptr;  // shared by initialiser and point source
  CreateInitialiser* initialiser = nullptr;
  CreatePointSource* point_source = nullptr;
  CreateKeyframeCulling* culling = nullptr;

  Camera camera;            // lens and shutter; System::create calls camera.model.prepare()
  float exposure_s = 0.0f;  // seconds, at most 1; predicts motion blur, and templates are blurred alike. 0: unknown

  // Live keyframes: those in bundle adjustment, whose measurements the map points keep. When there is one too many, the
  // least useful one is erased [phone 3.3: 35]. Bundle adjustment solves in O(max_keyframes^3). Measured: an error of
  // 0.044 % of the path with 35, 0.037 % with all 82 to 108 (tests/MEASURED.md, culling).
  int max_keyframes = 35;
  // Erased keyframes whose images are kept, for patches and relocalisation. When there is one too many, the least
  // useful one is forgotten. 4/3 bytes a pixel each. Not swept.
  int max_erased_keyframes = 35;
  // Maps that are kept: the one in use, and those in which the camera was lost before a new one began (auto_start).
  // They share the keyframes' images and max_measurements; every further one takes 0.1 MB. 1 to 8. Not swept.
  int max_maps = 3;
  int max_map_points =
      1000;  // of each map: room for 25 new points in each of 35 keyframes and 100 of the first view: 975
  // Pool that all map points share for their third and further measurements (two places belong to each point); 24 bytes
  // each. 6 more for each of 1000 points makes 8.
  int max_measurements = 6000;
  // When a point has one too many, its least useful one is dropped [phone 3.2: 8]. 2 to 32.
  int max_measurements_per_point = 8;
  int max_partial_points = 100;  // not swept
  int max_measured_points = 50;  // map points searched per frame [phone 7]
  // Partial points searched per frame [phone 7]; where fewer map points are in view than may be measured, as many more.
  int max_partial_searches = 12;
  int max_new_partial_points = 25;  // per keyframe [phone 5.2]
  int max_initial_points = 100;     // of the first view, tracked by the homography; not swept
  // The image is divided into cells_x by cells_y cells over which the measured points are spread. 1 to 16 each. 40 px
  // squares of the phone's image; not swept.
  int cells_x = 6, cells_y = 8;
  // Pyramid levels searched, 0 to 4: of a sharp frame, and of a blurred one or in a wide search [phone 4].
  int search_level = 1, coarse_search_level = 2;
  // Every map point has a level of its own, in which it is searched in place of search_level [ptam 4, 5.3].
  bool own_levels = false;
  // With own_levels: of the points searched in a frame so many, of coarse levels, are searched before the others in a
  // wider circle [ptam 5.5: 50]. 0: no such stage.
  int max_coarse_points = 0;

  float initial_baseline = 0.1f;  // length of the sideways start, world units [ptam 6.1: 10 cm]
  // Distance from the camera centre of the first view to the plane z = 0, world units, when the user knows it. Sets
  // the scale instead of initial_baseline. 0: not known.
  float initial_plane_distance = 0;
  // Starts initialisation without a tap once the camera has been held still for 0.3 s before a textured view. After a
  // failure it starts again, until there is a map. When the camera has been lost for 3 s, the map is set aside and a
  // new one begun; the old one goes on as soon as one of its views returns (max_maps, TrackResult::map).
  bool auto_start = false;
  // Seconds between keyframes (0.67 in [ptam 6.2]); half of it where the view is being replaced. Not swept.
  float min_keyframe_interval_s = 0.2f;
  // Damps the reported pose while the whole image is at rest: it follows the measured pose only as far as noise does
  // not explain the difference. False: every pose as measured.
  bool steady_damping = true;

  PhoneProfile profile;  // turns charged work into time (the work clock)

  // The 2009 phone's parts and capacities, for a camera from 64x64 pixels to 12 million (its 86 images may take 1 GB).
  // Its shutter is global until camera.shutter is set.
  static Config phone(const CameraModel& model);
  // The same parts for a small camera of a microcontroller, 192x144 down to 120x160 pixels: a block of at most 1.5 MB.
  // Patches are searched in the camera's own pixels, a level finer than the phone's, and capacities are smaller.
  static Config tiny(const CameraModel& model);
  // Lengths in the image, such as distances of corners and noise, are told for patches of level 1, the phone's
  // search_level: their factor for this one.
  float px_scale() const { return 0.5f * static_cast<float>(1 << search_level); }
  // The 2007 desktop system's: thousands of points in four levels, up to 1000 searched in a frame. Made for 640x480 at
  // 30 frames/s; a computer of 3 GHz is modelled. README.md says what of that system is missing.
  static Config desktop(const CameraModel& model);
  Status validate() const;
};

}  // namespace pptam
