// A frame and what was found in it as a Scene: the camera's image with the points that were searched, grid and house on
// the map's ground, and a panel below with state, hint, quality, residual, counts and time; or the map from above.
//
// The house goes through the camera model, distortion and shutter included, so a wrong pose shows as a house that
// slides.
#pragma once

#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "platform/camera.h"
#include "platform/display/house.h"
#include "platform/display/scene.h"
#include "platform/run/lettering.h"
#include "platform/run/run_log.h"

namespace pptam::platform {

struct Canvas {
  int width = 0, height = 0;  // pixels, as seen
  int turn_degrees = 0;       // of the screen's picture, clockwise
};

class Composer {
 public:
  explicit Composer(const CameraInfo& camera);

  // The image twice as large, or as it is where it is large already, and the panel; both sides even.
  Canvas usual_canvas() const;

  // The scenes are valid until the next call, and as long as the frame's pixels are.
  // ahead_s: how long after the frame's time the picture will be seen; the pose is predicted for then by its velocity.
  // picture: of the tracked image, or of that which it was made of.
  const Scene& camera_view(const Picture& picture, const TrackResult& result, const FrameLog& log, const Canvas& canvas,
                           double ahead_s = 0);
  const Scene& map_view(const TrackResult& result, const FrameLog& log, std::span<const MapPointInfo> points,
                        std::span<const KeyframeInfo> keyframes, const Canvas& canvas);
  // Of each frame that is not drawn: each map's world has a house of its own.
  void follow(const TrackResult& result);
  // Of the scene composed last: a line over the view.
  void add_notice(const std::string& text);

  const Site* site() const { return site_; }  // in the map of the last frame; null: none yet

 private:
  Site place_site(const TrackResult& result) const;
  void begin(const Canvas& canvas, float shape, const TrackResult& result, const FrameLog& log);
  void add_points(std::span<const ObservedPoint> points, float scale);
  void add_panel(const FrameLog& log, float top, float width);
  void add_text(TextStyle style, float x, float y, const std::string& text, const Rgba& colour);
  void add_box(std::vector<Shape>* shapes, const Area& area, float radius, const Rgba& colour) const;

  CameraInfo camera_;
  float initial_baseline_;
  float unit_ = 0;  // of the panel's sizes, pixels
  std::optional<Lettering> lettering_;
  std::map<int, Site> sites_;   // by TrackResult::map
  int world_changes_ = 0;       // TrackResult's, for which they stand
  const Site* site_ = nullptr;  // one of them
  int site_model_map_ = 0;      // whose house site_model_ is
  WorldModel site_model_, map_model_;
  Scene scene_;
};

}  // namespace pptam::platform
