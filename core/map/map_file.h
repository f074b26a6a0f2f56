// A finished map as bytes, and back: what System::save_map and load_map read and write. Pure functions on the caller's
// memory; files are the platform's business.
//
// Everything is little-endian and packed; u and i are integers, f is an IEEE float, of so many bits. "Slot" is an index
// into the map's own vectors: entries keep theirs, so that a loaded map goes on bit by bit as the saved one would.
// Images are level 0 alone: the pyramid and the small image are made from it again. A partial point's ray is that of
// its source pixel. Frames as in map.h: T_kw takes world to keyframe, pixels are level 0.
//
//   header, 120 bytes   u8[8] "PPTAMMAP"  u32 version (2)  u32 flags (0)  u64 bytes of the whole file
//     camera            u32 width, height  f32 fx, fy, cx, cy  u32 distortion (as the enum)  f32[5] coefficients
//     shutter           u32 axis (0 rows, 1 columns)  f32 line_time_s
//     counts            u32 next_id, then for keyframes, map points and partial points each: u32 slots, u32 entries
//     u32 erased keyframes, measurements of all map points, the most of one map point
//   keyframes, by ascending slot, each 120 bytes and the image
//     u32 slot, id, flags (1: erased)  i64 timestamp_ns  f32[9] rotation of T_kw by rows, f32[3] its translation
//     f32[6] velocity  f32[6] velocity_prior  f32 mean_depth
//     if erased: u32 anchor's slot  f32[9] rotation of T_anchor by rows, f32[3] its translation
//     u8[width * height] image by rows
//   map points, by ascending slot, each 52 bytes and the measurements
//     u32 slot, id  f32[3] p_w  source: u32 keyframe's slot, f32[2] px, f32[3] normal  u16 attempts, found
//     u32 number of measurements, at least 2, each: u32 keyframe's slot, f32[2] px, u32 level, f32 weight
//   partial points, by ascending slot, each 44 bytes
//     u32 slot, id  source as above  f32 inverse_depth, information  u16 attempts, found
//   u32 CRC-32 (polynomial 0xEDB88320, as of zip and PNG) of all bytes before
//
// Not in a file: keyframes still in the queue, and what the mapper was doing; it starts again with a bundle adjustment.
// Cost: about 8 ARMv6 instructions a byte, and a pyramid for each keyframe when loading: 20 to 30 million for a full
// map of the phone's, in one go.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include <pocket_ptam/config.h>
#include <pocket_ptam/map_info.h>
#include "map/map.h"

namespace pptam {

// Bytes that write_map_file writes. The map is `ready`.
size_t map_file_bytes(const Map& map, const Config& config);

// The whole file into out, which is exactly that large.
void write_map_file(const Map& map, const Config& config, std::span<std::byte> out);

// Header and checksum, whatever the configuration; *info is set only if they are good.
Status read_map_info(std::span<const std::byte> file, MapInfo* info);

// Everything: header, checksum, camera, capacities, every index and number. config.camera is prepared.
Status check_map_file(std::span<const std::byte> file, const Config& config);

// A file that check_map_file found good, into a map of the same configuration that was just cleared. The map is `ready`
// then.
void read_map_file(std::span<const std::byte> file, const Config& config, Map& map);

uint32_t crc32(std::span<const std::byte> bytes);

}  // namespace pptam
