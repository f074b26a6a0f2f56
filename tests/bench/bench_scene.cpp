#include "tests/bench/bench_scene.h"

#include <stdexcept>
#include <string>

#include "camera/full_frame_rotation.h"
#include "sim_phone/phone_camera.h"

namespace pptam::bench {
namespace {

constexpr int32_t kAnyZmssd = 64 * 255 * 255;
constexpr int kFirstFrame = 30;  // two seconds in: the phone moves sideways

}  // namespace

BenchScene::BenchScene() {
  const auto phone = sim::make_phone_camera(sim::PhoneOptions());
  camera = phone->info().model;
  camera.prepare();
  for (int i = 0; i <= kFirstFrame + 1; ++i) {
    Frame frame;
    if (!phone->read(&frame)) throw std::runtime_error("the emulated phone ended early");
    if (i >= kFirstFrame)
      pixels[i - kFirstFrame].assign(frame.data,
                                     frame.data + static_cast<ptrdiff_t>(frame.stride_bytes) * frame.height);
  }
  const int width = camera.width, height = camera.height;

  const auto allocate = [&](Arena& arena, PyramidStorage(&storage)[2], CornerDetector* detector,
                            GreyImage(&smalls)[2]) {
    for (int i = 0; i < 2; ++i) {
      storage[i] = PyramidStorage(arena, width, height, 1);
      const int w = width >> (kPyramidLevels - 1), h = height >> (kPyramidLevels - 1);
      smalls[i] = {arena.allocate_array<uint8_t>(static_cast<size_t>(w) * static_cast<size_t>(h)), w, h, w};
    }
    *detector = CornerDetector(arena, width, height);
  };
  PyramidStorage storage[2];
  CornerDetector detector;
  GreyImage smalls[2];
  Arena measure;
  allocate(measure, storage, &detector, smalls);
  memory.resize(measure.used() / sizeof(std::max_align_t) + 1);
  Arena arena(std::as_writable_bytes(std::span(memory)));
  allocate(arena, storage, &detector, smalls);

  for (int i = 0; i < 2; ++i) {
    pyramid[i] = build_pyramid({pixels[i].data(), width, height, width}, storage[i]);
    make_small_image(pyramid[i], smalls[i]);
    small[i] = smalls[i];
  }
  std::vector<std::max_align_t> rotation_memory(4096);
  Arena rotation_arena(std::as_writable_bytes(std::span(rotation_memory)));
  const RotationEstimate rotation = FullFrameRotation(rotation_arena, {camera, {}})
                                        .estimate(small[0], small[1], Matrix3f::Identity(), Vector3f::Zero());
  if (!rotation.ok) throw std::runtime_error("the full-frame rotation of the two frames failed");

  corners.resize(1000);
  corners.resize(static_cast<size_t>(detector.detect(pyramid[0], CornerParams(), corners)));

  // As for points of the map on surfaces that face the camera, seen before and after the rotation.
  const SE3 T_cp(rotation.R_cp, Vector3f::Zero());
  const Vector3f facing(0, 0, -1);
  WorkMeter meter;
  for (const Corner& corner : corners) {
    if (points.size() == kPoints) break;
    SearchedPoint point;
    point.source_px = {static_cast<float>(corner.x), static_cast<float>(corner.y)};
    const Vector2f ray = camera.unproject(point.source_px);
    const Vector3f p(ray.x(), ray.y(), 1);
    if (!camera.project(T_cp * p, &point.predicted_px) || !camera.in_image(point.predicted_px, 24)) continue;
    if (!patch_affinity({camera, {}}, p, facing, T_cp, &point.A_t_s)) continue;
    if (!warp_template(pyramid[0], point.source_px, point.A_t_s, kSearchLevel, &point.patch)) continue;
    ImagePoint found;
    point.found = find_template(pyramid[1], point.patch, point.predicted_px, SearchOptions(), meter, &found) ==
                  SearchOutcome::kFound;
    point.found_px = found.px;
    point.max_zmssd =
        static_cast<int32_t>(SearchOptions().max_relative_zmssd * static_cast<float>(point.patch.energy()));
    PatchHit hit;
    const Vector2f predicted(from_level0(point.predicted_px.x(), kSearchLevel),
                             from_level0(point.predicted_px.y(), kSearchLevel));
    search_patch(pyramid[1].level[kSearchLevel], point.patch, predicted, kRadius_px, kAnyZmssd, &hit);
    point.hit_px = {static_cast<float>(hit.x) + kPatchCentre, static_cast<float>(hit.y) + kPatchCentre};
    points.push_back(point);
  }
  if (points.size() < kPoints)
    throw std::runtime_error("the first frame has only " + std::to_string(points.size()) + " points to search");
  if (found() < kMinGood)
    throw std::runtime_error("only " + std::to_string(found()) + " of 50 points are found in the second frame");

  // Any colours will do; these keep every channel busy.
  for (size_t i = 0; i < pixels[1].size(); ++i) {
    const uint8_t v = pixels[1][i], w = pixels[0][i];
    for (const uint8_t byte : {w, v, static_cast<uint8_t>(255 - v), uint8_t{255}}) bgra.push_back(byte);
    for (const uint8_t byte : {static_cast<uint8_t>(255 - v), v, w}) rgb.push_back(byte);
    for (const uint8_t byte : {v, w}) yuyv.push_back(byte);
  }
}

Frame BenchScene::frame(PixelFormat format) const {
  const int width = camera.width, height = camera.height;
  if (format == PixelFormat::kBgra) return {bgra.data(), width, height, 4 * width, format, 0};
  if (format == PixelFormat::kRgb24) return {rgb.data(), width, height, 3 * width, format, 0};
  return {yuyv.data(), width, height, 2 * width, PixelFormat::kYuyv, 0};
}

int BenchScene::found() const {
  int count = 0;
  for (const SearchedPoint& point : points) count += point.found;
  return count;
}

}  // namespace pptam::bench
