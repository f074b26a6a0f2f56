// Saved maps: what comes back is what was saved, bit by bit; a file that is not whole or not ours is refused, says why,
// and changes nothing.
#include "map/map_file.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include <pocket_ptam/inspection.h>
#include "tests/support/random.h"
#include "tests/support/small_map.h"

namespace pptam {
namespace {

using test::repair_checksum;
using test::small_map_config;
using test::SmallMap;
using Bytes = std::vector<std::byte>;

// Offsets as the header of map_file.h has them, of one map; images are 97x81.
constexpr size_t kHeader = 132, kImage = 97 * 81, kKeyframe = 120 + kImage;
constexpr size_t kErased = kHeader + 3 * kKeyframe, kAnchor = 52;
constexpr size_t kFirstPoint = kErased + kKeyframe + kAnchor;

// A System with its memory.
class Phone {
 public:
  explicit Phone(const Config& config)
      : memory_(new std::max_align_t[System::required_bytes(config) / sizeof(std::max_align_t) + 1]) {
    const Status status =
        System::create(config, {reinterpret_cast<std::byte*>(memory_.get()), System::required_bytes(config)}, &system_);
    if (!status.ok()) ADD_FAILURE() << status.message();
  }
  System* operator->() { return system_; }
  System& operator*() { return *system_; }
  Bytes saved() {
    Bytes bytes(system_->map_bytes());
    size_t used = 0;
    const Status status = system_->save_map(bytes, &used);
    EXPECT_TRUE(status.ok()) << status.message();
    EXPECT_EQ(used, bytes.size());
    return bytes;
  }

 private:
  std::unique_ptr<std::max_align_t[]> memory_;
  System* system_ = nullptr;
};

void put_u32(Bytes* file, size_t at, uint32_t value) {
  for (size_t i = 0; i < 4; ++i) (*file)[at + i] = static_cast<std::byte>(value >> (8 * i));
}
void put_u16(Bytes* file, size_t at, uint16_t value) {
  for (size_t i = 0; i < 2; ++i) (*file)[at + i] = static_cast<std::byte>(value >> (8 * i));
}
void put_f32(Bytes* file, size_t at, float value) {
  put_u32(file, at, std::bit_cast<uint32_t>(value));
}
void cut(Bytes* file, size_t size) {
  if (size < file->size()) file->erase(file->begin() + static_cast<ptrdiff_t>(size), file->end());
}
uint32_t get_u32(const Bytes& file, size_t at) {
  uint32_t value = 0;
  for (size_t i = 0; i < 4; ++i) value |= static_cast<uint32_t>(file[at + i]) << (8 * i);
  return value;
}

TEST(MapFile, ChecksumIsThatOfZipAndPng) {
  const char digits[] = "123456789";
  EXPECT_EQ(crc32(std::as_bytes(std::span(digits, 9))), 0xCBF43926u);
  EXPECT_EQ(crc32({}), 0u);
  EXPECT_NE(crc32(std::as_bytes(std::span(digits, 8))), 0xCBF43926u);
}

TEST(MapFile, LoadedIsWhatWasSaved) {
  test::Random random;
  Config roomy = small_map_config();  // larger capacities than it was saved with
  roomy.max_keyframes = 9;
  roomy.max_map_points = 300;
  for (int trial = 0; trial < 20; ++trial) {
    const SmallMap original(random.seed() + static_cast<uint64_t>(trial));
    const Bytes file = original.file();
    SmallMap other(random.seed() + 1000);  // whatever was there before
    other.map.clear();
    const Status status = check_map_file(file, other.config);
    ASSERT_TRUE(status.ok()) << status.message();
    read_map_file(file, other.config, other.map);
    EXPECT_EQ(other.map.hash(), original.map.hash());
    EXPECT_EQ(other.file(), file);
    EXPECT_TRUE(other.map.ready());
    EXPECT_EQ(MapAccess::next_id(other.map), MapAccess::next_id(original.map));
    ASSERT_EQ(other.map.keyframes().size(), original.map.keyframes().size());
    for (int k = 0; k < other.map.keyframes().size(); ++k) {
      const Keyframe &a = original.map.keyframes()[k], &b = other.map.keyframes()[k];
      EXPECT_EQ(a.id, b.id);
      if (a.id == 0) continue;
      EXPECT_EQ(a.erased, b.erased);
      EXPECT_EQ(a.anchor, b.anchor);
      EXPECT_EQ(a.timestamp_ns, b.timestamp_ns);
      for (int l = 0; l < kPyramidLevels; ++l)
        for (int y = 0; y < a.pyramid.level[l].height; ++y)
          EXPECT_EQ(std::memcmp(a.pyramid.level[l].row(y), b.pyramid.level[l].row(y),
                                static_cast<size_t>(a.pyramid.level[l].width)),
                    0);
      for (int y = 0; y < a.small.height; ++y)
        EXPECT_EQ(std::memcmp(a.small.row(y), b.small.row(y), static_cast<size_t>(a.small.width)), 0);
    }
    for (int i = 0; i < original.map.points().size(); ++i)
      EXPECT_EQ(other.map.points()[i].id, original.map.points()[i].id) << "slots stay, slot " << i;
    for (int i = 0; i < original.map.partial_points().size(); ++i) {
      const PartialPoint &a = original.map.partial_points()[i], &b = other.map.partial_points()[i];
      EXPECT_EQ(b.id, a.id);
      EXPECT_TRUE(a.id == 0 || b.ray == a.ray);
    }

    for (const Config& config : {original.config, roomy}) {
      Phone phone(config);
      EXPECT_EQ(phone->map_bytes(), 0u);
      ASSERT_TRUE(phone->load_map(file).ok());
      EXPECT_EQ(map_hash(*phone), original.map.hash());
      EXPECT_EQ(phone.saved(), file);
      EXPECT_TRUE(phone->has_work()) << "a bundle adjustment";
    }
  }
}

TEST(MapFile, SeveralMapsAreWhatWasSaved) {
  SmallMap original(1);
  original.add_another(2);
  original.add_another(3);
  const Bytes file = original.file();
  MapInfo info;
  ASSERT_TRUE(read_map_info(file, &info).ok());
  EXPECT_EQ(info.maps, 3);
  EXPECT_EQ(info.keyframes, 9);
  EXPECT_EQ(info.min_keyframes, 3);
  SmallMap other(4);
  other.map.clear_all();
  const Status status = check_map_file(file, other.config);
  ASSERT_TRUE(status.ok()) << status.message();
  read_map_file(file, other.config, other.map);
  other.map.check_consistency();
  EXPECT_EQ(other.file(), file);
  EXPECT_EQ(other.map.hash(), original.map.hash());
  EXPECT_EQ(other.map.number(), 3u);
  for (int place = 0; place < 2; ++place) {
    other.map.exchange(place);
    other.map.check_consistency();
    EXPECT_EQ(other.map.hash(), SmallMap(other.map.number()).map.hash());
    other.map.exchange(place);
  }
  for (const auto& [harm, says] : std::vector<std::pair<std::function<void(Config*)>, const char*>>{
           {[](Config* c) { c->max_maps = 2; }, "max_maps"},
           {[](Config* c) { c->max_erased_keyframes = 5; }, "in all"}}) {
    Config small = original.config;
    harm(&small);
    const Status refused = check_map_file(file, small);
    EXPECT_EQ(refused.code(), StatusCode::kConfigMismatch);
    EXPECT_NE(std::string(refused.message()).find(says), std::string::npos) << refused.message();
  }
}

// One number on every target. A change of the format changes it, and needs another version.
TEST(MapFile, BytesAreTheSameOnEveryTarget) {
  const Bytes file = SmallMap(1).file();
  EXPECT_EQ(file.size(), 38204u);
  const auto checksum = [](const Bytes& bytes) { return get_u32(bytes, bytes.size() - 4); };
  EXPECT_EQ(checksum(file), 0xCCF2E65Au);
  EXPECT_NE(checksum(SmallMap(2).file()), checksum(file));
}

TEST(MapFile, LayoutIsAsWritten) {
  const SmallMap original(1);
  const Bytes file = original.file();
  EXPECT_EQ(std::memcmp(file.data(), "PPTAMMAP", 8), 0);
  EXPECT_EQ(get_u32(file, 8), 3u);
  EXPECT_EQ(get_u32(file, 16), file.size());
  EXPECT_EQ(get_u32(file, 24), 97u);
  EXPECT_EQ(get_u32(file, 28), 81u);
  EXPECT_EQ(get_u32(file, 80), MapAccess::next_id(original.map));
  EXPECT_EQ(get_u32(file, kHeader + 4), original.map.keyframes()[0].id);
  EXPECT_EQ(file[kHeader + 120 + 5], static_cast<std::byte>(original.map.keyframes()[0].pyramid.level[0].at(5, 0)));
  EXPECT_EQ(get_u32(file, kFirstPoint), 1u) << "slot 0 is empty";
  EXPECT_EQ(get_u32(file, kFirstPoint + 4), original.map.points()[1].id);
  size_t expected = kFirstPoint + 4;
  uint32_t measurements = 0, most_of_a_point = 0;
  for (const MapPoint& point : original.map.points()) {
    if (point.id == 0) continue;
    const auto count = static_cast<uint32_t>(point.measurements.size());
    expected += 52 + 20 * size_t{count};
    measurements += count;
    most_of_a_point = std::max(most_of_a_point, count);
  }
  EXPECT_EQ(get_u32(file, 124), measurements);
  EXPECT_EQ(get_u32(file, 128), most_of_a_point);
  const Measurement& first = original.map.measurements(original.map.points()[1])[0];
  EXPECT_EQ(get_u32(file, kFirstPoint + 52 + 12), uint32_t{first.at.level});
  EXPECT_NE(first.at.level, 0) << "or nothing was compared";
  for (const PartialPoint& partial : original.map.partial_points()) expected += partial.id != 0 ? 44 : 0;
  EXPECT_EQ(file.size(), expected);

  MapInfo info;
  ASSERT_TRUE(read_map_info(file, &info).ok());
  EXPECT_EQ(info.version, 3);
  EXPECT_EQ(info.maps, 1);
  EXPECT_EQ(info.keyframes, 3);
  EXPECT_EQ(info.erased_keyframes, 1);
  EXPECT_EQ(info.min_erased_keyframes, 2) << "slots 3 and 4";
  EXPECT_EQ(info.map_points, 56);
  EXPECT_EQ(info.min_map_points, 59);
  EXPECT_EQ(info.partial_points, 9);
  EXPECT_EQ(info.min_partial_points, 10);
  EXPECT_EQ(info.min_measurements, static_cast<int>(measurements) - 2 * 56) << "beyond two of each point";
  EXPECT_EQ(info.min_measurements_per_point, 3);
  EXPECT_EQ(info.camera.model.width, 97);
  EXPECT_EQ(info.camera.shutter.line_time_s, original.config.camera.shutter.line_time_s);
}

// Everything that can be wrong in a file, with what the message must say. The untouched file is accepted, so that each
// is refused for its own fault.
TEST(MapFile, EveryFaultIsNamed) {
  const SmallMap original(1);
  const Bytes good = original.file();
  const float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
  const size_t point = kFirstPoint, measurement = point + 52;
  size_t partial = good.size() - 4 - 9 * 44;
  const auto f32 = [](size_t at, float value) { return [=](Bytes* file) { put_f32(file, at, value); }; };
  const auto u32 = [](size_t at, uint32_t value) { return [=](Bytes* file) { put_u32(file, at, value); }; };
  const auto u16 = [](size_t at, uint16_t value) { return [=](Bytes* file) { put_u16(file, at, value); }; };
  const struct {
    const char* says;
    std::function<void(Bytes*)> harm;
    bool repaired = true;
    StatusCode code = StatusCode::kBadFile;
  } kFaults[] = {
      {"not a map", [](Bytes* file) { file->clear(); }, false},
      {"not a map", [](Bytes* file) { cut(file, 7); }, false},
      {"not a map", [](Bytes* file) { (*file)[3] ^= std::byte{1}; }},
      {"cut off within its header", [](Bytes* file) { cut(file, 9); }, false},
      {"cut off within its header", [](Bytes* file) { cut(file, kHeader + 3); }, false},
      {"cut off:", [](Bytes* file) { file->pop_back(); }, false},
      {"cut off:", [](Bytes* file) { cut(file, kFirstPoint); }},
      {"longer", [](Bytes* file) { file->push_back(std::byte{0}); }, false},
      {"checksum", [](Bytes* file) { (*file)[5000] ^= std::byte{4}; }, false},
      {"checksum", [](Bytes* file) { file->back() ^= std::byte{128}; }, false},
      {"version", u32(8, 1)},
      {"version", u32(8, 2)},
      {"version", u32(8, 4)},
      {"version", u32(8, 0)},
      {"flags", u32(12, 1)},
      {"holds no map", u32(88, 0)},
      {"holds no map, or more", u32(88, 9)},
      {"impossible numbers", u32(92, 0)},
      {"impossible numbers", u32(84, 0)},  // the last one
      {"impossible numbers", u32(84, 0x7fffffff)},
      {"counts", u32(100, 0)},           // keyframes
      {"counts", u32(100, 6)},           // more than slots
      {"counts", u32(120, 4)},           // all erased
      {"counts", u32(108, 0x40000000)},  // points
      {"counts", u32(104, 0xffffffff)},
      {"counts", u32(116, 11)},
      {"counts", u32(124, 0xffffffff)},  // measurements
      {"counts", u32(124, get_u32(good, 124) + 1)},
      {"counts", u32(124, get_u32(good, 124) - 1)},
      {"than any configuration allows", u32(128, 34)},  // the most of one point
      {"or more than the header says", u32(128, 2)},
      {"counts do not fit its measurements", u32(128, 4)},
      {"camera is nonsense", u32(24, 0x80000061)},
      {"camera is nonsense", u32(48, 9)},
      {"camera is nonsense", u32(72, 2)},
      {"camera is nonsense", f32(76, nan)},
      {"principal point", f32(40, -5)},
      {"focal length", f32(32, 101), true, StatusCode::kConfigMismatch},
      {"rolling shutter", f32(76, 0.0005f), true, StatusCode::kConfigMismatch},
      {"rolling shutter", u32(72, 0), true, StatusCode::kConfigMismatch},
      {"smaller images", u32(24, 96), true, StatusCode::kConfigMismatch},
      {"slots", u32(kHeader, 1)},  // order
      {"slots", u32(kHeader + kKeyframe, 0)},
      {"slots", u32(kHeader + 2 * kKeyframe, 4)},
      {"slots", u32(104, 60)},  // one more than used
      {"impossible id", u32(kHeader + 4, 0)},
      {"impossible id", u32(80, original.map.keyframes()[1].id)},  // next_id
      {"keyframe of the map has flags", u32(kHeader + 8, 2)},
      {"rotation", f32(kHeader + 20, nan)},
      {"rotation", f32(kHeader + 20, 1.01f)},
      {"rotation", f32(kHeader + 24, 1e30f)},
      {"rotation",
       [](Bytes* file) {  // mirrored
         for (size_t at = kHeader + 20; at < kHeader + 56; at += 4)
           put_f32(file, at, -std::bit_cast<float>(get_u32(*file, at)));
       }},
      {"position or velocity", f32(kHeader + 56, inf)},
      {"position or velocity", f32(kHeader + 56, 2e8f)},
      {"position or velocity", f32(kHeader + 68, nan)},
      {"position or velocity", f32(kHeader + 92, -inf)},
      {"counts do not fit its keyframes", u32(120, 0)},
      {"follows one that is not there", u32(kErased + 120, 3)},
      {"follows one that is not there", u32(kErased + 120, 4)},
      {"follows one that is not there", u32(kErased + 120, 0xffffffff)},
      {"rotation", f32(kErased + 124, nan)},
      {"position or velocity", f32(kErased + 160, inf)},
      {"mean depth", f32(kHeader + 116, 0)},
      {"mean depth", f32(kHeader + 116, nan)},
      {"mean depth", f32(kHeader + 116, -1)},
      {"position is not", f32(point + 8, nan)},
      {"position is not", f32(point + 16, 1e9f)},
      {"comes from a keyframe that is not there", u32(point + 20, 3)},
      {"comes from a keyframe that is not there", u32(point + 20, 5)},
      {"comes from a keyframe that is not there", u32(point + 20, 0xffffffff)},
      {"comes from outside", f32(point + 24, -1)},
      {"comes from outside", f32(point + 28, 81)},
      {"comes from outside", f32(point + 28, nan)},
      {"unit length", f32(point + 32, 5)},
      {"unit length", f32(point + 32, nan)},
      {"found more often", u16(point + 46, 0xffff)},
      {"less than two", u32(point + 48, 1)},
      {"or more than the header says", u32(point + 48, 4)},
      {"less than two", u32(point + 48, 0xffffffff)},
      {"measured in a keyframe that is not there", u32(measurement, 3)},
      {"measured in a keyframe that is not there", u32(measurement, 4)},  // erased
      {"weight", f32(measurement + 16, -0.1f)},
      {"weight", f32(measurement + 16, nan)},
      {"measured in a keyframe that is not there", u32(measurement, 0x10000)},
      {"measured outside", f32(measurement + 4, 97)},
      {"measured outside", f32(measurement + 8, nan)},
      {"pyramid level", u32(measurement + 12, 5)},
      {"pyramid level", u32(measurement + 12, 0x100)},
      {"pyramid level", u32(measurement + 12, 0xffffffff)},
      {"twice", [&](Bytes* file) { put_u32(file, measurement + 20, get_u32(*file, measurement)); }},
      {"comes from a keyframe that is not there", u32(partial + 8, 7)},
      {"comes from outside", f32(partial + 12, inf)},
      {"partial point's depth", f32(partial + 32, 0)},
      {"partial point's depth", f32(partial + 32, nan)},
      {"partial point's depth", f32(partial + 36, -1)},
      {"partial point's depth", f32(partial + 36, inf)},
      {"found more often", u16(partial + 42, 100)},
      {"do not fill",
       [](Bytes* file) {  // four bytes more than its entries
         file->insert(file->end() - 4, 4, std::byte{0});
         put_u32(file, 16, static_cast<uint32_t>(file->size()));
       }},
  };
  Phone phone(original.config);
  const SmallMap running(2);
  ASSERT_TRUE(phone->load_map(running.file()).ok());
  const Bytes before = phone.saved();
  for (const auto& fault : kFaults) {
    Bytes file = good;
    fault.harm(&file);
    if (fault.repaired) repair_checksum(&file);
    const Status status = phone->load_map(file);
    const auto index = &fault - kFaults;
    EXPECT_EQ(status.code(), fault.code) << index << ": " << fault.says;
    EXPECT_NE(std::string(status.message()).find(fault.says), std::string::npos)
        << index << ": " << fault.says << ", said: " << status.message();
    EXPECT_EQ(phone.saved(), before) << index << ": " << fault.says;
  }
  SmallMap without_datum(1);
  MapAccess::keyframe(without_datum.map, 0).erased = true;
  MapAccess::keyframe(without_datum.map, 0).anchor = 1;
  EXPECT_NE(std::string(phone->load_map(without_datum.file()).message()).find("datum"), std::string::npos);
  const Status status = phone->load_map(good);
  EXPECT_TRUE(status.ok()) << status.message();
  EXPECT_EQ(phone.saved(), good);
}

TEST(MapFile, AnotherConfigIsNamedFieldByField) {
  const Bytes file = SmallMap(1).file();
  const struct {
    const char* says;
    std::function<void(Config*)> change;
  } kCases[] = {
      {"smaller images than Config::camera", [](Config* c) { c->camera.model.width = 98; }},
      {"another camera", [](Config* c) { c->camera.model.width = 70; }},  // cut off, not made smaller
      {"another camera", [](Config* c) { c->camera.model.fx += 1e-4f; }},
      {"another camera", [](Config* c) { c->camera.model.cy += 1; }},
      {"another camera",
       [](Config* c) {
         c->camera.model.distortion = Distortion::kRadTan;
         c->camera.model.coeffs[0] = 0.01f;
       }},
      {"another rolling shutter than Config::camera", [](Config* c) { c->camera.shutter.line_time_s = 0; }},
      {"another rolling shutter than Config::camera",
       [](Config* c) { c->camera.shutter.axis = RollingShutter::Axis::kRows; }},
      {"Config::max_partial_points", [](Config* c) { c->max_partial_points = 9; }},
  };
  for (const auto& bad : kCases) {
    Config config = small_map_config();
    bad.change(&config);
    Phone phone(config);
    const Status status = phone->load_map(file);
    EXPECT_FALSE(status.ok()) << bad.says;
    EXPECT_NE(std::string(status.message()).find(bad.says), std::string::npos) << bad.says << ": " << status.message();
    EXPECT_EQ(phone->map_bytes(), 0u);
    EXPECT_FALSE(phone->has_work());
  }
  // The least capacities that Config allows hold this map's keyframes and points: the functions are asked themselves.
  for (const bool keyframes : {true, false}) {
    Config config = small_map_config();
    (keyframes ? config.max_keyframes : config.max_map_points) = keyframes ? 1 : 58;
    const std::string says = keyframes ? "Config::max_keyframes" : "Config::max_map_points";
    const Status status = check_map_file(file, config);
    EXPECT_NE(std::string(status.message()).find(says), std::string::npos) << status.message();
    ++(keyframes ? config.max_keyframes : config.max_map_points);
    EXPECT_TRUE(check_map_file(file, config).ok()) << says;
  }
  MapInfo info;
  ASSERT_TRUE(read_map_info(file, &info).ok());
  for (const bool all : {true, false}) {
    Config config = small_map_config();
    // One more of a point is let in, for culling to judge.
    (all ? config.max_measurements : config.max_measurements_per_point) =
        (all ? info.min_measurements : info.min_measurements_per_point - 1) - 1;
    const std::string says = all ? "Config::max_measurements:" : "Config::max_measurements_per_point:";
    const Status status = check_map_file(file, config);
    EXPECT_NE(std::string(status.message()).find(says), std::string::npos) << status.message();
    ++(all ? config.max_measurements : config.max_measurements_per_point);
    EXPECT_TRUE(check_map_file(file, config).ok()) << says;
  }
  Config few = small_map_config();
  few.max_keyframes = 3;
  few.max_erased_keyframes = 0;  // four slots and the newcomer's would do, five are used
  EXPECT_NE(std::string(check_map_file(file, few).message()).find("Config::max_erased_keyframes"), std::string::npos);
  few.max_erased_keyframes = 1;
  EXPECT_TRUE(check_map_file(file, few).ok());
  // What does not belong to the map may differ.
  Config config = small_map_config();
  config.exposure_s = 0.01f;
  config.max_measured_points = 100;
  EXPECT_TRUE(Phone(config)->load_map(file).ok());
}

// The small map's camera with images of another size.
Config with_images_of(int width, int height) {
  Config config = small_map_config();
  CameraModel& camera = config.camera.model;
  const float x = static_cast<float>(width) / static_cast<float>(camera.width);
  const float y = static_cast<float>(height) / static_cast<float>(camera.height);
  camera.fx *= x;
  camera.fy *= y;
  camera.cx = (camera.cx + 0.5f) * x - 0.5f;
  camera.cy = (camera.cy + 0.5f) * y - 0.5f;
  config.camera.shutter.line_time_s *= static_cast<float>(camera.width) / static_cast<float>(width);
  camera.width = width;
  camera.height = height;
  camera.prepare();
  return config;
}

// Points, poses and times stay; what is in pixels is that of the smaller images. The small map measures its points
// where they project, so they must be there in the smaller camera as well.
TEST(MapFile, ACameraWithSmallerImagesGetsItScaled) {
  const SmallMap original(5, with_images_of(194, 162));
  const Bytes file = original.file();
  const struct {
    int width, height, levels;
  } kSizes[] = {{194, 162, 0}, {150, 125, 0}, {130, 108, 1}, {97, 81, 1}, {80, 67, 1}};
  for (const auto& size : kSizes) {
    SCOPED_TRACE(std::to_string(size.width) + "x" + std::to_string(size.height));
    const Config config = with_images_of(size.width, size.height);
    SmallMap scaled(6, config);
    scaled.map.clear();
    const Status status = check_map_file(file, config);
    ASSERT_TRUE(status.ok()) << status.message();
    read_map_file(file, config, scaled.map);
    scaled.map.check_consistency();
    for (int k = 0; k < scaled.map.keyframes().size(); ++k) {
      const Keyframe &a = original.map.keyframes()[k], &b = scaled.map.keyframes()[k];
      if (a.id == 0) continue;
      EXPECT_EQ(std::memcmp(a.T_kw.t.data(), b.T_kw.t.data(), 3 * sizeof(float)), 0);
      double from_mean = 0;  // against the mean over each pixel's area, by adding 16 x 16 samples of it
      for (int y = 0; y < size.height; ++y) {
        for (int x = y % 5; x < size.width; x += 5) {
          double sum = 0;
          for (int i = 0; i < 256; ++i) {
            const double u = (x + (i % 16 + 0.5) / 16) * 194 / size.width,
                         v = (y + (i / 16 + 0.5) / 16) * 162 / size.height;
            sum += a.pyramid.level[0].at(static_cast<int>(u), static_cast<int>(v));
          }
          from_mean = std::max(from_mean, std::abs(sum / 256 - b.pyramid.level[0].at(x, y)));
        }
      }
      // A sample stands for 1/16 of a pixel's side: an edge between 30 and 220 may be put 1/32 wrong on both axes.
      EXPECT_LE(from_mean, 0.5 + 2 * 190.0 / 32);
    }
    int checked = 0;
    for (int i = 0; i < scaled.map.points().size(); ++i) {
      const MapPoint &before = original.map.points()[i], &point = scaled.map.points()[i];
      ASSERT_EQ(point.id, before.id);
      if (point.id == 0) continue;
      EXPECT_EQ(point.p_w, before.p_w);
      auto old_m = original.map.measurements(before).begin();
      for (const Measurement& m : scaled.map.measurements(point)) {
        Vector2f px;
        ASSERT_TRUE(config.camera.project(scaled.map.keyframes()[m.keyframe].T_kw * point.p_w, &px));
        EXPECT_LT((m.at.px - px).norm(), 1e-3f) << "float32 of pixels up to 200, a few operations";
        EXPECT_EQ(m.at.level, std::max(0, (*old_m).at.level - size.levels));
        ++old_m;
        ++checked;
      }
    }
    EXPECT_GT(checked, 100);
    Phone phone(config);
    ASSERT_TRUE(phone->load_map(file).ok());
    EXPECT_EQ(map_hash(*phone), scaled.map.hash());
    for (int i = 0; i < 50 && phone->has_work(); ++i) phone->work_slice();
    Phone again(config);
    EXPECT_TRUE(again->load_map(phone.saved()).ok()) << "saved, it is a map of the smaller images";
  }
  const auto refused = [&](const std::function<void(Config*)>& change) {
    Config config = with_images_of(97, 81);
    change(&config);
    return check_map_file(file, config).code() == StatusCode::kConfigMismatch;
  };
  EXPECT_FALSE(refused([](Config* c) { c->camera.model.cx += 0.25f; })) << "scaled as pixels' edges are";
  EXPECT_TRUE(refused([](Config* c) { c->camera.model.cx += 1; }));
  EXPECT_TRUE(refused([](Config* c) { c->camera.model.fy *= 1.001f; }));
  EXPECT_TRUE(refused([](Config* c) { c->camera.model.coeffs[0] = 0.01f; }));
  EXPECT_TRUE(refused([](Config* c) { c->camera.shutter.line_time_s *= -1; }));
  EXPECT_TRUE(refused([](Config* c) { c->camera.shutter.line_time_s *= 1.1f; }));
}

// Too few points for an adjustment: there is nothing to do then, rather than for ever the same.
TEST(MapFile, HardlyAnyPointsAreNoEndlessWork) {
  for (const int left : {0, 3}) {
    SmallMap few(5);
    int count = few.map.point_count();
    for (int i = 0; i < few.map.points().size() && count > left; ++i) {
      if (few.map.points()[i].id == 0) continue;
      few.map.remove_point(i);
      --count;
    }
    Phone phone(few.config);
    const Status status = phone->load_map(few.file());
    ASSERT_TRUE(status.ok()) << status.message();
    int slices = 0;
    while (phone->has_work() && slices < 1000) {
      phone->work_slice();
      ++slices;
    }
    EXPECT_LT(slices, 1000) << left << " points";
  }
}

TEST(MapFile, NothingIsSavedWithoutAMapOrWithoutRoom) {
  Phone phone(small_map_config());
  size_t used = 77;
  Bytes room(100000);
  EXPECT_EQ(phone->save_map(room, &used).code(), StatusCode::kNotReady);
  const Bytes file = SmallMap(3).file();
  ASSERT_TRUE(phone->load_map(file).ok());
  EXPECT_EQ(phone->save_map(std::span(room).first(file.size() - 1), &used).code(), StatusCode::kOutOfMemory);
  EXPECT_EQ(used, 77u);
  EXPECT_TRUE(phone->save_map(room, &used).ok());
  EXPECT_EQ(used, file.size());
  EXPECT_TRUE(std::equal(file.begin(), file.end(), room.begin()));
  phone->reset();
  EXPECT_EQ(phone->map_bytes(), 0u);
}

// One to three changes of every kind that files suffer.
void mutate(test::Random& random, Bytes* file) {
  const auto place = [&](size_t room) {
    // Every other one among the numbers, which are few against the pixels.
    size_t at = static_cast<size_t>(random.integer(0, static_cast<int>(file->size()) - 1));
    if (random.integer(0, 1) == 0 && file->size() > kFirstPoint) {
      const int part = random.integer(0, 3);
      if (part == 0) at = static_cast<size_t>(random.integer(0, kHeader - 1));
      if (part == 1)
        at = kHeader + static_cast<size_t>(random.integer(0, 2)) * kKeyframe +
             static_cast<size_t>(random.integer(0, 119));
      if (part >= 2) at = kFirstPoint + static_cast<size_t>(random.integer(0, 1 << 30)) % (file->size() - kFirstPoint);
    }
    return file->size() > room ? std::min(at, file->size() - room) : size_t{0};
  };
  const float floats[] = {0.0f,
                          -0.0f,
                          1.0f,
                          -1.0f,
                          1e-38f,
                          1e38f,
                          1e7f,
                          std::numeric_limits<float>::quiet_NaN(),
                          std::numeric_limits<float>::infinity()};
  for (int changes = random.integer(1, 3); changes > 0 && file->size() > 8; --changes) {
    switch (random.integer(0, 7)) {
      case 0:
        (*file)[place(1)] ^= static_cast<std::byte>(1 << random.integer(0, 7));
        break;
      case 1:
        (*file)[place(1)] = static_cast<std::byte>(random.integer(0, 255));
        break;
      case 2:
        put_f32(file, place(4) / 4 * 4, floats[random.integer(0, 8)]);
        break;
      case 3:
        put_u32(file, place(4) / 4 * 4, static_cast<uint32_t>(random.integer(-2, 70)));
        break;
      case 4: {  // a run of zeros, as after a crash
        const size_t at = place(1);
        const size_t end = std::min(file->size(), at + static_cast<size_t>(random.integer(1, 4096)));
        std::fill(file->begin() + static_cast<ptrdiff_t>(at), file->begin() + static_cast<ptrdiff_t>(end), std::byte{});
        break;
      }
      case 5: {  // a piece of it elsewhere
        const size_t length = static_cast<size_t>(random.integer(1, 600));
        const size_t from = place(length), to = place(length);
        if (file->size() > length) std::memmove(file->data() + to, file->data() + from, length);
        break;
      }
      case 6:
        cut(file, place(1));
        break;
      default:
        file->insert(file->begin() + static_cast<ptrdiff_t>(place(1)), static_cast<size_t>(random.integer(1, 64)),
                     static_cast<std::byte>(random.integer(0, 255)));
    }
  }
}

// Damage alone is always found: the checksum finds every change of up to 32 bits in a row, and lets others pass once in
// 2^32. Damage with the size and the checksum made good is a hostile file: refused, or loaded for exactly what it says;
// and the system works on, whatever that is.
TEST(MapFile, MutatedFilesAreRefusedOrLoadedForWhatTheySay) {
  test::Random random;
  const SmallMap original(random.seed());
  SmallMap several(random.seed() + 1);
  several.add_another(random.seed() + 2);
  const Bytes one = original.file(), two = several.file();
  Bytes good = one;
  Phone phone(original.config);
  ASSERT_TRUE(phone->load_map(good).ok());
  Bytes current = good;
  uint64_t hash = map_hash(*phone);
  int64_t now_ns = 0;
  int refused = 0, hostile_refused = 0, loaded = 0, unchanged = 0, tracked = 0;
  std::set<std::string> reasons;
  const int trials = test::trials(10000);
  for (int trial = 0; trial < trials; ++trial) {
    good = trial % 4 < 2 ? one : two;
    Bytes file = good;
    mutate(random, &file);
    const bool hostile = trial % 2 == 1;
    if (hostile && file.size() >= kHeader) {
      put_u32(&file, 16, static_cast<uint32_t>(file.size()));
      put_u32(&file, 20, 0);
      repair_checksum(&file);
    }
    const Status status = phone->load_map(file);
    if (file == good) {
      ++unchanged;
      EXPECT_TRUE(status.ok());
    } else if (!hostile) {
      EXPECT_FALSE(status.ok()) << trial;
    }
    if (status.ok()) {
      ++loaded;
      current = file;
      hash = map_hash(*phone);
      // Frames at the places of the keyframes and elsewhere; mapping besides.
      for (int i = 0; i < 3; ++i) {
        const GreyView image = original.map.keyframes()[(trial + i) % 3].pyramid.level[0];
        now_ns += 66666667;
        const TrackResult result =
            phone->track({image.data, image.width, image.height, image.stride, PixelFormat::kGrey, now_ns});
        EXPECT_TRUE(result.status.ok());
        tracked += result.state == TrackingState::kTracking;
        if (loaded % 10 == 0)
          for (int slice = 0; slice < 20; ++slice) phone->work_slice();
      }
      ASSERT_TRUE(phone->load_map(file).ok());
    } else {
      ++(hostile ? hostile_refused : refused);
      reasons.insert(status.message());
    }
    EXPECT_EQ(map_hash(*phone), hash) << "trial " << trial << (status.ok() ? " loaded" : " refused");
    if (status.ok() || trial % 10 == 0) {
      ASSERT_TRUE(phone.saved() == current) << "trial " << trial << (status.ok() ? " loaded" : " refused");
    }
  }
  RecordProperty("refused", refused);
  RecordProperty("hostile_refused", hostile_refused);
  RecordProperty("loaded", loaded);
  std::printf(
      "%d mutated maps: %d damaged and refused, %d hostile and refused for %zu reasons, %d loaded (%d of them "
      "unchanged); %d frames tracked\n",
      trials, refused, hostile_refused, reasons.size(), loaded, unchanged, tracked);
  EXPECT_EQ(refused + hostile_refused + loaded, trials);
  // Both happen, or nothing was tested: a mutated pixel is a good map, a mutated index is none.
  EXPECT_GT(loaded, trials / 20);
  EXPECT_GT(hostile_refused, trials / 20);
  EXPECT_GT(reasons.size(), 10u);
  EXPECT_GT(tracked, 0);
}

// Every length from nothing to all but a byte.
TEST(MapFile, EveryTruncationIsRefused) {
  const SmallMap original(5);
  const Bytes good = original.file();
  const size_t step = test::trials(10) == 10 ? 7 : 70;
  for (size_t length = 0; length < good.size(); length += length < 200 || good.size() - length < 200 ? 1 : step) {
    EXPECT_FALSE(check_map_file(std::span(good).first(length), original.config).ok()) << length;
    // The same with a size and a checksum that fit.
    Bytes file(good.begin(), good.begin() + static_cast<ptrdiff_t>(length));
    if (length < kHeader + 4) continue;
    put_u32(&file, 16, static_cast<uint32_t>(length));
    repair_checksum(&file);
    EXPECT_FALSE(check_map_file(file, original.config).ok()) << length;
  }
  EXPECT_TRUE(check_map_file(good, original.config).ok());
}

}  // namespace
}  // namespace pptam
