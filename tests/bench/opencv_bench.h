// OpenCV's side of the benchmarks; only there when OpenCV is.
#pragma once

#include "tests/bench/bench_scene.h"

namespace pptam::bench {

// Registers all of it. Throws std::runtime_error when it does not do the same work as our kernels.
void register_opencv(const BenchScene& scene);

}  // namespace pptam::bench
