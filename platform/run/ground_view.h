// Which planes of the map could be its ground: the first image with a pose, with each plane's points in a colour and
// the pixel to give to --ground.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "platform/run/run_log.h"

namespace pptam::platform {

class GroundView {
 public:
  // Of each tracked frame: keeps the first image of each map.
  void add(const Frame& frame, const TrackResult& result);

  // One of RunLog::planes as it is seen in that image.
  struct Choice {
    size_t plane = 0;
    Vector2f px = Vector2f::Zero();  // for --ground
    bool is_ground = false;          // it is now
  };
  // Those of log.main_map() that are seen in it, the largest first.
  std::vector<Choice> choices(const RunLog& log) const;

  // PNG; empty without choices.
  std::string picture(const RunLog& log) const;
  // What is to be said beside it.
  std::string note(const RunLog& log) const;

 private:
  struct View {
    int64_t timestamp_ns = 0;
    int width = 0, height = 0;
    std::vector<uint8_t> grey;
  };
  struct Seen {
    Vector2f px;
    int plane;  // -1: on none
  };
  const View* view_of(const RunLog& log) const;
  static std::vector<Seen> seen_points(const RunLog& log, const View& view);

  std::map<int, View> views_;  // by TrackResult::map
};

}  // namespace pptam::platform
