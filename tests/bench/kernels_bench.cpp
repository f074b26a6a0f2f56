// Benchmarks of the image kernels, in one thread on the same images as OpenCV's (opencv_bench.cpp). Prints the ratios
// of the two and whether the targets are met.
#include <benchmark/benchmark.h>

#include <cstdio>
#include <cstring>
#include <exception>
#include <optional>
#include <vector>

#include <pocket_ptam/image.h>
#include "camera/full_frame_rotation.h"
#include "tests/bench/bench_scene.h"
#include "tests/bench/opencv_bench.h"
#include "tests/bench/ratio_report.h"

namespace pptam::bench {

namespace {

using benchmark::ClobberMemory;
using benchmark::DoNotOptimize;
using benchmark::State;

// Storage made by the core's own allocator: allocate(arena) runs twice, first to measure.
template <class Allocate>
std::vector<std::max_align_t> with_arena(Allocate allocate) {
  Arena measure;
  allocate(measure);
  std::vector<std::max_align_t> memory(measure.used() / sizeof(std::max_align_t) + 1);
  Arena arena(std::as_writable_bytes(std::span(memory)));
  allocate(arena);
  return memory;
}

void grey(State& state, const BenchScene& scene, PixelFormat format) {
  const Frame frame = scene.frame(format);
  std::vector<uint8_t> pixels(static_cast<size_t>(frame.width * frame.height));
  const GreyImage storage{pixels.data(), frame.width, frame.height, frame.width};
  for (auto _ : state) {
    DoNotOptimize(to_grey(frame, storage));
    ClobberMemory();
  }
}

void pyramid(State& state, const BenchScene& scene) {
  PyramidStorage storage;
  const auto memory =
      with_arena([&](Arena& arena) { storage = PyramidStorage(arena, scene.camera.width, scene.camera.height, 1); });
  for (auto _ : state) {
    DoNotOptimize(build_pyramid(scene.pyramid[1].level[0], storage));
    ClobberMemory();
  }
}

void corners(State& state, const BenchScene& scene, bool with_pyramid) {
  PyramidStorage storage;
  CornerDetector detector;
  const auto memory = with_arena([&](Arena& arena) {
    storage = PyramidStorage(arena, scene.camera.width, scene.camera.height, 1);
    detector = CornerDetector(arena, scene.camera.width, scene.camera.height);
  });
  std::vector<Corner> found(1000);
  for (auto _ : state) {
    const Pyramid built = with_pyramid ? build_pyramid(scene.pyramid[0].level[0], storage) : scene.pyramid[0];
    DoNotOptimize(detector.detect(built, CornerParams(), found));
    ClobberMemory();
  }
}

void warp(State& state, const BenchScene& scene) {
  for (auto _ : state) {
    for (const SearchedPoint& point : scene.points) {
      PatchTemplate patch;
      DoNotOptimize(warp_template(scene.pyramid[0], point.source_px, point.A_t_s, kSearchLevel, &patch));
      DoNotOptimize(patch);
    }
  }
}

void search(State& state, const BenchScene& scene) {
  for (auto _ : state) {
    for (const SearchedPoint& point : scene.points) {
      const Vector2f predicted(from_level0(point.predicted_px.x(), kSearchLevel),
                               from_level0(point.predicted_px.y(), kSearchLevel));
      PatchHit hit;
      DoNotOptimize(search_patch(scene.pyramid[1].level[kSearchLevel], point.patch, predicted, kRadius_px,
                                 point.max_zmssd, &hit));
      DoNotOptimize(hit);
    }
  }
}

void refine(State& state, const BenchScene& scene) {
  for (auto _ : state) {
    for (const SearchedPoint& point : scene.points) {
      RefinedPatch refined;
      DoNotOptimize(
          refine_patch(scene.pyramid[1].level[kSearchLevel], point.patch, point.hit_px, kRefineSteps, &refined));
      DoNotOptimize(refined);
    }
  }
}

// All of it for each point, as the tracker does.
void points(State& state, const BenchScene& scene, bool with_pyramid) {
  PyramidStorage storage;
  const auto memory =
      with_arena([&](Arena& arena) { storage = PyramidStorage(arena, scene.camera.width, scene.camera.height, 1); });
  WorkMeter meter;
  for (auto _ : state) {
    const Pyramid current = with_pyramid ? build_pyramid(scene.pyramid[1].level[0], storage) : scene.pyramid[1];
    for (const SearchedPoint& point : scene.points) {
      PatchTemplate patch;
      ImagePoint found;
      if (!warp_template(scene.pyramid[0], point.source_px, point.A_t_s, kSearchLevel, &patch)) continue;
      DoNotOptimize(find_template(current, patch, point.predicted_px, SearchOptions(), meter, &found));
      DoNotOptimize(found);
    }
  }
}

void small_image(State& state, const BenchScene& scene) {
  std::vector<uint8_t> pixels(static_cast<size_t>(scene.small[1].width * scene.small[1].height));
  const GreyImage small{pixels.data(), scene.small[1].width, scene.small[1].height, scene.small[1].width};
  for (auto _ : state) {
    make_small_image(scene.pyramid[1], small);
    ClobberMemory();
  }
}

void rotation(State& state, const BenchScene& scene) {
  std::optional<FullFrameRotation> full_frame_rotation;
  const auto memory = with_arena([&](Arena& arena) { full_frame_rotation.emplace(arena, Camera{scene.camera, {}}); });
  for (auto _ : state)
    DoNotOptimize(
        full_frame_rotation->estimate(scene.small[0], scene.small[1], Matrix3f::Identity(), Vector3f::Zero()));
}

void register_ours(const BenchScene& scene) {
  const auto add = [&](const char* name, auto function, auto... arguments) {
    benchmark::RegisterBenchmark(
        name, [&scene, function, arguments...](State& state) { function(state, scene, arguments...); });
  };
  add("ours/grey_bgra", grey, PixelFormat::kBgra);
  add("ours/grey_rgb", grey, PixelFormat::kRgb24);
  add("ours/grey_yuyv", grey, PixelFormat::kYuyv);
  add("ours/pyramid", pyramid);
  add("ours/corners", corners, false);
  add("ours/pyramid_corners", corners, true);
  add("ours/warp_50", warp);
  add("ours/search_50", search);
  add("ours/refine_50", refine);
  add("ours/points_50", points, false);
  add("ours/pyramid_points_50", points, true);
  add("ours/small_image", small_image);
  add("ours/rotation", rotation);
}

int run(int argc, char** argv) {
  bool check = false;
  // Defaults first, so that the user's options win. Short repetitions in random order: what else the machine does then
  // falls on both sides.
  char min_time[] = "--benchmark_min_time=0.02", repetitions[] = "--benchmark_repetitions=15",
       interleaved[] = "--benchmark_enable_random_interleaving=true";
  std::vector<char*> arguments{argv[0], min_time, repetitions, interleaved};
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--check") == 0) {
      check = true;
    } else {
      arguments.push_back(argv[i]);
    }
  }
  int count = static_cast<int>(arguments.size());
  arguments.push_back(nullptr);
  benchmark::Initialize(&count, arguments.data());
  if (benchmark::ReportUnrecognizedArguments(count, arguments.data())) return 2;

  const BenchScene scene;
  std::printf("emulated phone, %dx%d: %zu corners; %d of %d points found\n", scene.camera.width, scene.camera.height,
              scene.corners.size(), scene.found(), kPoints);
  register_ours(scene);
#ifdef PPTAM_BENCH_OPENCV
  register_opencv(scene);
#else
  std::puts("built without OpenCV: only our own kernels are timed, there are no ratios");
#endif
  std::fflush(stdout);
  RatioReport report;
  benchmark::RunSpecifiedBenchmarks(&report);
  benchmark::Shutdown();
  const bool met = report.print();
  return check && !met ? 1 : 0;
}

}  // namespace
}  // namespace pptam::bench

int main(int argc, char** argv) {
  try {
    return pptam::bench::run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "error: %s; nothing was timed\n", error.what());
    return 2;
  }
}
