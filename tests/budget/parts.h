// What System is made of, so that the map and the work meter can be seen. The tap has been made.
#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include <pocket_ptam/pocket_ptam.h>
#include "mapping/mapper.h"
#include "tracking/tracker.h"

namespace pptam::test {

struct Parts {
  explicit Parts(const Config& configuration)
      : config(configuration),
        meter(config.profile),
        memory(System::required_bytes(config) / sizeof(std::max_align_t) + 1) {
    config.camera.model.prepare();
    Arena arena(std::as_writable_bytes(std::span(memory)));
    map = Map(arena, config);
    CornerSource* const corners = config.corner_source(arena, config, meter);
    tracker = std::make_unique<Tracker>(arena, config, map, meter, config.initialiser(arena, config, meter, corners));
    mapper = std::make_unique<Mapper>(arena, config, map, meter, corners);
    EXPECT_FALSE(arena.overflowed());
    tracker->tap();
  }
  // As much idle time as the phone has between two frames, in slices.
  void map_a_while() {
    constexpr int kSlices = 60;  // of 0.25 million instructions: 15 of the 18 million between frames
    for (int i = 0; i < kSlices && mapper->has_work(); ++i) mapper->work_slice();
  }
  Config config;
  WorkMeter meter;
  std::vector<std::max_align_t> memory;
  Map map;
  std::unique_ptr<Tracker> tracker;
  std::unique_ptr<Mapper> mapper;
};

}  // namespace pptam::test
