// All finished maps as bytes, and back: what System::save_map and load_map read and write. Pure functions on the
// caller's memory; the platform reads and writes files. The format is described below.
//
// Not in a file: keyframes in the queue and the mapper's job. After loading the mapper begins with a bundle adjustment.
// Cost: about 8 ARMv6 instructions a byte, and a pyramid for each keyframe when loading. That is 20 to 30 million for a
// full map of the phone profile, without a pause.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include <pocket_ptam/config.h>
#include <pocket_ptam/map_info.h>
#include "map/map.h"

namespace pptam {

// The format, version 3.
//
// Everything is little-endian and packed. u and i are integers, f is an IEEE float; the number behind is their bits.
// "Slot" is an index into the map's own vectors. Entries keep their slots, so that a loaded map continues with the same
// bits as the saved one. Images are level 0 only: pyramid and small image are made again from it. A partial point's ray
// is made again from its source pixel. T_kw takes world to keyframe, pixels are level 0.
//
//   header, 92 bytes    u8[8] "PPTAMMAP"  u32 version (3)  u32 flags (0)  u64 bytes of the whole file
//     camera            u32 width, height  f32 fx, fy, cx, cy  u32 distortion (as the enum)  f32[5] coefficients
//     shutter           u32 axis (0 rows, 1 columns)  f32 line_time_s
//     u32 next_id, number of the last finished map, number of maps
//   then of each finished map, that in use first if it is one, the counts; then all that follows, map by map
//     counts, 40 bytes  u32 number of the map, then for keyframes, map points and partial points each: u32 slots, u32
//                       entries; u32 erased keyframes, measurements of all map points, the most of one map point
//   keyframes, by ascending slot, each 120 bytes and the image
//     u32 slot, id, flags (1: erased)  i64 timestamp_ns  f32[9] rotation of T_kw by rows, f32[3] its translation
//     f32[6] velocity  f32[6] velocity_prior  f32 mean_depth
//     if erased: u32 anchor's slot  f32[9] rotation of T_anchor by rows, f32[3] its translation
//     u8[width * height] image by rows
//   map points, by ascending slot, each 52 bytes and the measurements
//     u32 slot, id  f32[3] p_w  source: u16 keyframe's slot, u16 patch's level (L1 is 0, L0 is 1, L2 is 3,
//                       L3 is 2), f32[2] px, f32[3] normal  u16 attempts, found
//     u32 number of measurements, at least 2, each: u32 keyframe's slot, f32[2] px, u32 level, f32 weight
//   partial points, by ascending slot, each 44 bytes
//     u32 slot, id  source as of a map point  f32 inverse_depth, information  u16 attempts, found
//   u32 CRC-32 (polynomial 0xEDB88320, as of zip and PNG) of all bytes before

// Bytes that write_map_file writes. There is a finished map, in use or aside.
size_t map_file_bytes(const Map& map, const Config& config);

// Writes the whole file into out, whose size is map_file_bytes().
void write_map_file(const Map& map, const Config& config, std::span<std::byte> out);

// Checks header and checksum, for any configuration. *info is set only if both are good.
Status read_map_info(std::span<const std::byte> file, MapInfo* info);

// Checks everything: header, checksum, camera, capacities, every index and number. config.camera must be prepared. It
// is the map's camera, or the same one with smaller images: pixels, levels and images of the map are then scaled down.
Status check_map_file(std::span<const std::byte> file, const Config& config);

// Reads a file that check_map_file found good into a map of the same configuration that was just cleared. Afterwards
// the map is ready().
void read_map_file(std::span<const std::byte> file, const Config& config, Map& map);

uint32_t crc32(std::span<const std::byte> bytes);

}  // namespace pptam
