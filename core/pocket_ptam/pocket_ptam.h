// Pocket PTAM: camera tracking and mapping on one small core. With config.h and track_result.h this is the whole
// interface; inspection.h is for tests and studies.
//
//   pptam::Config config = pptam::Config::phone(camera_model);
//   std::vector<std::byte> memory(pptam::System::required_bytes(config));
//   pptam::System* system = nullptr;
//   pptam::Status status = pptam::System::create(config, memory, &system);   // check it
//   system->tap();                                  // start at the next frame, or set Config::auto_start before
//   for (every frame) {
//     pptam::TrackResult r = system->track(frame);                           // high priority, bounded time
//     while (there is time before the next frame && system->has_work()) system->work_slice();
//   }
//
// One thread. No heap, no exceptions, no operating system; everything lives in the caller's block. The world's unit is
// arbitrary (one camera cannot see the scale): the distance from the first view to the farthest view of the start is
// Config::initial_baseline, unless Config::initial_plane_distance or System::set_length says otherwise. The world's
// z = 0 is the dominant plane of the first view, or the ground below an upright front, or what System::set_ground says;
// z is up, towards the camera.
// Poses are T_cw (world to camera), camera x right, y down, z forward, at the frame's timestamp (mid-exposure of the
// image centre).
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include <pocket_ptam/clock.h>
#include <pocket_ptam/config.h>
#include <pocket_ptam/image.h>
#include <pocket_ptam/map_info.h>
#include <pocket_ptam/tracer.h>
#include <pocket_ptam/track_result.h>

namespace pptam {

struct MapFit;  // inspection.h

// Bytes of System::required_bytes() by what they are for.
struct MemoryParts {
  size_t map = 0;       // keyframes' images, points, measurements, partial points
  size_t tracking = 0;  // the frame's pyramid, the search, the start, corners
  size_t mapping = 0;   // bundle adjustment, paused jobs
  size_t rest = 0;      // settings and bookkeeping
};

class System {
 public:
  System(const System&) = delete;  // it lives in the caller's memory
  System& operator=(const System&) = delete;

  // Bytes of memory that create() needs for this configuration; 0 when config.validate() is not ok.
  static size_t required_bytes(const Config& config);
  static MemoryParts required_parts(const Config& config);  // their sum is required_bytes()
  // Builds the system inside memory (aligned as by malloc, at least required_bytes), which must outlive it. *system is
  // set only on success; there is nothing to destroy.
  static Status create(const Config& config, std::span<std::byte> memory, System** system);

  // Clock for TrackResult::stage_ns; null: no stage times. It must outlive the system or be replaced.
  void set_clock(const Clock* clock);
  // Who is told what track() and work_slice() are doing; null: nobody. It must outlive the system or be replaced.
  void set_tracer(Tracer* tracer);

  // Tracks one frame to completion. Refuses (result.status) incomplete frames, another size than the camera's, and
  // timestamps that do not increase.
  TrackResult track(const Frame& frame);

  bool has_work() const;  // whether there is mapping work for idle time
  void work_slice();      // one slice of mapping: with the phone's capacities at most 0.25 million ARMv6 instructions

  // Starts initialisation with the next frame. An existing map, or a start in progress, is discarded.
  void tap();    // discards other maps, too
  void reset();  // discards everything; then waits for a tap or for Config::auto_start

  // Scales the world so that two map points (ids as in map_points() or TrackResult::points) are `length` world units
  // apart. Poses follow from the next frame on. Refused, with nothing changed, when there is no finished map, a point
  // does not exist, the length is not within 1e-6 to 1e6 times the present one, or the map would leave 1e-8 to 1e8
  // units.
  Status set_length(uint32_t point_a, uint32_t point_b, float length);

  // Chooses the world's ground: the plane of the map points round what the last frame showed at px, level-0 pixels,
  // becomes z = 0, with z towards that frame's camera, x along its x, and the origin at px. The scale stays. Poses
  // follow from the next frame on; *change, if not null, takes old coordinates to new ones: p_new = *change * p_old.
  // Refused, with nothing changed, when the last frame had no pose (also while another map is looked at, until the next
  // frame), px is not within the image, fewer than half of the dozen points round it lie on one plane, or the ray meets
  // that at under 3 degrees. At once, not in slices: about 2 million ARMv6 instructions (an estimate).
  Status set_ground(const Vector2f& px, Similarity* change = nullptr);
  // The planes that hold most of a finished map's points, at least 12 and 8 % of them each, the largest first: what may
  // be the ground. Copies up to out.size() and returns how many there are, at most kMostPlanes. map: as in keyframes().
  // None while a new map is being finished. Some 30 million instructions for each in a full map of the phone (an
  // estimate).
  int planes(std::span<PlaneInfo> out, int map = 0) const;

  // Saving the finished maps, between two slices, in a versioned and checksummed format that is the same on every
  // target (map/map_file.h). The file holds all that relocalisation and further mapping need; keyframes still in the
  // queue are left out. save_map() does not pause: 20 to 30 million ARMv6 instructions for a full map of the phone.
  size_t map_bytes() const;  // exactly what save_map() writes now; 0 without a finished map
  // Refused when there is no finished map or out is smaller than map_bytes(); *bytes is set on success.
  Status save_map(std::span<std::byte> out, size_t* bytes) const;
  // Checks a saved map's header and checksum and reads what a Config that can load it needs. *info is set on success.
  static Status map_info(std::span<const std::byte> file, MapInfo* info);
  // Replaces all maps, or a start in progress, by those saved. The state is then kLost, until the relocaliser finds the
  // pose in a frame that shows a known view. Refused, with nothing changed, unless the whole file is valid, was made
  // with this camera and shutter, and fits Config's capacities. A map of the same camera with larger images is scaled
  // down to Config::camera's size; for one with smaller images, give track() images as small as the map's.
  Status load_map(std::span<const std::byte> file);

  // A locked map is only tracked: no new keyframes or points and no mapping work until it is unlocked. Without a
  // finished map the lock takes effect once there is one. tap(), reset() and load_map() do not change it.
  void set_locked(bool locked);
  bool locked() const;

  // Each copies up to out.size() entries and returns how many there are in all: live keyframes ordered by id, map
  // points in no particular order. map: which one, as in TrackResult::map; 0: that in use. None of a map that is not
  // kept.
  int keyframes(std::span<KeyframeInfo> out, int map = 0) const;
  int map_points(std::span<MapPointInfo> out, int map = 0) const;
  // Grouped by point, points in map_points()'s order.
  int measurements(std::span<MeasurementInfo> out, int map = 0) const;
  // Level-0 image of a live or erased keyframe, valid until the next non-const call; empty when no keyframe has the id.
  GreyView keyframe_image(uint32_t id) const;

  const Config& config() const;
  const WorkMeter& work_meter() const;

 private:
  friend MapFit map_fit(const System&);
  friend int map_parts(const System&, int);
  friend uint64_t map_hash(const System&);
  struct Impl;
  explicit System(Impl* impl) : impl_(impl) {}
  const Map& map() const;
  Impl* impl_;
};

}  // namespace pptam
