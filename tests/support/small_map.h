// A small map made by hand, for tests of map files: a textured wall at depth 1, seen by a few keyframes, with map
// points and partial points, empty slots between them, and an erased keyframe that is a patch's source. Images have odd
// sizes. Everything follows from the seed.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <random>
#include <vector>

#include "map/map.h"
#include "map/map_access.h"
#include "map/map_file.h"

namespace pptam::test {

inline Config small_map_config() {
  CameraModel camera;
  camera.width = 97;
  camera.height = 81;
  camera.fx = camera.fy = 100;
  camera.cx = 48;
  camera.cy = 40;
  camera.prepare();
  Config config = Config::phone(camera);
  config.camera.shutter.axis = RollingShutter::Axis::kColumns;
  config.camera.shutter.line_time_s = -0.0005f;
  config.max_keyframes = 5;
  config.max_map_points = 120;
  config.max_partial_points = 20;
  return config;
}

// Grey of the wall at (x, y), units: cells of two sizes, the larger ones for the smallest images.
inline uint8_t small_map_wall(float x, float y) {
  const auto cell = [&](float per_unit) {
    uint32_t hash = static_cast<uint32_t>(static_cast<int>(std::floor(x * per_unit))) * 73856093u ^
                    static_cast<uint32_t>(static_cast<int>(std::floor(y * per_unit))) * 19349663u;
    hash = (hash ^ (hash >> 13)) * 0x5bd1e995u;
    return (hash ^ (hash >> 15)) & 0xff;
  };
  return static_cast<uint8_t>(30 + cell(5) / 2 + cell(25) / 4);
}

class SmallMap {
 public:
  explicit SmallMap(uint64_t seed, const Config& configuration = small_map_config()) : config(configuration) {
    Arena measure;
    const Map measured(measure, config);
    memory_ = std::make_unique<std::max_align_t[]>(measure.used() / sizeof(std::max_align_t) + 1);
    Arena arena({reinterpret_cast<std::byte*>(memory_.get()), measure.used()});
    map = Map(arena, config);
    std::mt19937_64 engine(seed);
    MapAccess::set_next_id(map, 1 + static_cast<uint32_t>(engine() % 1000));
    build(engine);
  }

  // Sets the map aside and makes another one.
  void add_another(uint64_t seed) {
    map.set_aside();
    std::mt19937_64 engine(seed);
    engine.discard(1);  // the constructor's number of the next entry: the map is that of SmallMap(seed)
    build(engine);
  }

  std::vector<std::byte> file() const {
    std::vector<std::byte> bytes(map_file_bytes(map, config));
    write_map_file(map, config, bytes);
    return bytes;
  }

  Config config;
  Map map;

 private:
  void build(std::mt19937_64& engine) {
    const auto uniform = [&engine](double low, double high) {
      return static_cast<float>(low + (high - low) * (static_cast<double>(engine() >> 11) * 0x1.0p-53));
    };
    const int keyframes = 3;  // that stay, and one to be forgotten, one erased
    for (int k = 0; k < keyframes + 2; ++k) {
      Keyframe& frame = map.queue().hold().frame;
      Vector6f mu;
      mu << uniform(-0.05, 0.05), uniform(-0.05, 0.05), uniform(-0.05, 0.05), uniform(-0.03, 0.03),
          uniform(-0.03, 0.03), uniform(-0.03, 0.03);
      frame.T_kw = SE3::exp(mu);
      frame.timestamp_ns = static_cast<int64_t>(engine() >> 2) * (k == 1 ? -1 : 1);
      for (int i = 0; i < 6; ++i) {
        frame.velocity[i] = uniform(-0.2, 0.2);
        frame.velocity_prior[i] = uniform(-0.2, 0.2);
      }
      frame.mean_depth = uniform(0.9, 1.1);
      const GreyImage& image = frame.storage.level[0];
      const SE3 T_wk = frame.T_kw.inverse();
      for (int y = 0; y < image.height; ++y) {
        for (int x = 0; x < image.width; ++x) {
          const Vector2f ray = config.camera.unproject({static_cast<float>(x), static_cast<float>(y)});
          const Vector3f direction = T_wk.R * Vector3f(ray.x(), ray.y(), 1);
          const Vector3f p_w = T_wk.t + direction * ((1 - T_wk.t.z()) / direction.z());
          image.at(x, y) = small_map_wall(p_w.x(), p_w.y());
        }
      }
      frame.pyramid = build_pyramid(image, frame.storage);
      make_small_image(frame.pyramid, frame.small);
      map.queue().release();
      map.add_keyframe(map.queue().front().frame);
      map.queue().pop();
    }
    const auto source = [&](int k, const Vector3f& p_w) {
      PatchSource s;
      s.keyframe = static_cast<int16_t>(k);
      config.camera.project(map.keyframes()[k].T_kw * p_w, &s.px);
      s.normal = -map.keyframes()[k].T_kw.R.col(2);
      return s;
    };
    for (int i = 0; i < 60; ++i) {
      const Vector3f p_w = {uniform(-0.25, 0.25), uniform(-0.2, 0.2), 1};
      const int first = static_cast<int>(engine() % keyframes);
      const int index = map.add_point(p_w, source(first, p_w));
      for (int n = 0; n < 2 + i % 2; ++n) {
        const int k = (first + n) % keyframes;
        map.add_measurement(index, {{source(k, p_w).px, static_cast<uint8_t>(i % 3)}, static_cast<int16_t>(k)});
      }
      MapPoint& point = MapAccess::point(map, index);
      point.attempts = static_cast<uint16_t>(engine() % 64);
      point.found = static_cast<uint16_t>(engine() % (point.attempts + 1u));
    }
    for (int i = 0; i < 10; ++i) {
      const PatchSource corner = source(i % keyframes, {uniform(-0.25, 0.25), uniform(-0.2, 0.2), 1});
      const Vector2f ray = config.camera.unproject(corner.px);
      PartialPoint& partial =
          MapAccess::partial_point(map, map.add_partial_point(corner, {ray.x(), ray.y(), 1}, uniform(0.5, 2)));
      partial.information = i % 4 == 0 ? 0 : uniform(0, 1e4);
      partial.attempts = static_cast<uint16_t>(i);
      partial.found = static_cast<uint16_t>(i / 2);
    }
    for (const int i : {0, 7, 8, 59}) map.remove_point(i);
    map.remove_partial_point(3);
    for (const int k : {3, 4}) map.erase_keyframe(k);
    map.forget_keyframe(3);
    MapAccess::point(map, 5).source = source(4, map.points()[5].p_w);
    map.finish();
  }

  std::unique_ptr<std::max_align_t[]> memory_;
};

// Makes the last four bytes the checksum of those before.
inline void repair_checksum(std::vector<std::byte>* file) {
  if (file->size() < 4) return;
  const uint32_t crc = crc32(std::span(*file).first(file->size() - 4));
  for (size_t i = 0; i < 4; ++i) (*file)[file->size() - 4 + i] = static_cast<std::byte>(crc >> (8 * i));
}

}  // namespace pptam::test
