// Pocket PTAM: camera tracking and mapping for one small core. The whole interface, with config.h and track_result.h;
// inspection.h is for laboratories.
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
// arbitrary (monocular): the sideways start, from the first view to the farthest of it, is Config::initial_baseline
// long, unless the user knows a distance: Config::initial_plane_distance, System::set_length. The world's z = 0 is the
// dominant plane of the first view, z up towards the camera. Poses are T_cw (world to camera), camera x right, y down,
// z forward, at the frame's timestamp (mid-exposure of the image centre).
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include <pocket_ptam/clock.h>
#include <pocket_ptam/config.h>
#include <pocket_ptam/image.h>
#include <pocket_ptam/map_info.h>
#include <pocket_ptam/track_result.h>

namespace pptam {

struct MapFit;  // inspection.h

class System {
 public:
  System(const System&) = delete;  // it lives in the caller's memory
  System& operator=(const System&) = delete;

  // Bytes of memory that create() needs for this configuration.
  static size_t required_bytes(const Config& config);
  // Builds the system inside memory (aligned as by malloc, at least required_bytes), which must outlive it. *system is
  // set only on success; there is nothing to destroy.
  static Status create(const Config& config, std::span<std::byte> memory, System** system);

  // For stage times and for the slices' length; may be null. The clock must outlive the system or be replaced.
  void set_clock(const Clock* clock);

  // Tracks one frame to completion. Refuses (result.status) incomplete frames, another size than the camera's, and
  // timestamps that do not increase.
  TrackResult track(const Frame& frame);

  bool has_work() const;  // is there anything for idle time?
  void work_slice();      // one slice of mapping, at most about 0.25 million ARMv6 instructions

  // Starts initialisation with the next frame. With a map, or initialising already: forgets it and starts again.
  void tap();
  void reset();  // forgets everything, waits for a tap or for Config::auto_start

  // Scales the world so that two map points (ids as in map_points() or TrackResult::points) are `length` world units
  // apart; poses follow from the next frame on. Refused when there is no finished map, a point does not exist, the
  // length is not within a millionth to a million times what it was, or the map would reach over 1e8 units or under
  // 1e-8; nothing changes then.
  Status set_length(uint32_t point_a, uint32_t point_b, float length);

  // A finished map as bytes, between two slices: a versioned, checksummed format, the same on every target
  // (map/map_file.h describes it). With everything needed to find the pose again and go on; keyframes still in the
  // queue are not in it. All at once: 20 to 30 million ARMv6 instructions for a full map of the phone's.
  size_t map_bytes() const;  // exactly what save_map() writes now; 0: there is no finished map
  // Refused when there is no finished map or out is smaller than map_bytes(); *bytes is set on success.
  Status save_map(std::span<std::byte> out, size_t* bytes) const;
  // Header and checksum of a saved map, for making a Config that can load it. *info is set on success.
  static Status map_info(std::span<const std::byte> file, MapInfo* info);
  // Replaces the map, or whatever was being done, by a saved one. The state is kLost then: the relocaliser finds the
  // pose in the next frames that show a known view. Refused, with nothing changed, unless the whole file is good, was
  // made with this camera and shutter, and fits Config's capacities.
  Status load_map(std::span<const std::byte> file);

  // A locked map is tracked only: no new keyframes or points, no mapping work, until it is unlocked. Without a finished
  // map it waits for one. Stays as set through tap(), reset() and load_map().
  void set_locked(bool locked);
  bool locked() const;

  // Copies up to out.size() entries in the order of their ids (keyframes: live ones); returns how many there are in
  // all.
  int keyframes(std::span<KeyframeInfo> out) const;
  int map_points(std::span<MapPointInfo> out) const;
  int measurements(std::span<MeasurementInfo> out) const;  // by point, as map_points()
  // Level 0 of a live or erased keyframe, valid until the next call that is not const; empty: no such id.
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
