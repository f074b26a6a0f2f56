// What is put into the world: a ground grid and a small house on the map's ground, placed by the first view of it, and
// the map itself, for a view from above.
#pragma once

#include <array>
#include <span>
#include <vector>

#include <pocket_ptam/camera.h>
#include <pocket_ptam/map_info.h>
#include "platform/display/scene.h"

namespace pptam::platform {

// Where the house stands: on the world's z = 0.
struct Site {
  Vector3f anchor_w = Vector3f::Zero();  // the middle of its floor
  Matrix3f R_wh = Matrix3f::Identity();  // the house's frame to the world: x along the ridge, z up
  float house_size = 1;                  // length of its longer side, world units
  float grid_spacing = 1;                // world units

  Vector3f to_world(const Vector3f& p_h) const { return anchor_w + house_size * (R_wh * p_h); }
};

// Where the view's axis meets the ground, the door towards the camera. initial_baseline: Config's, for the grid's size.
Site place_house(const SE3& T_cw, float initial_baseline);

// Corners of walls and roof, house's frame, in units of its longer side.
std::span<const Vector3f> house_corners();

// Grid, the lit house, its shadow.
WorldModel make_site_model(const Site& site);

// Map points, keyframes as small pyramids, and the present camera where pose is not null.
WorldModel make_map_model(std::span<const MapPointInfo> points, std::span<const KeyframeInfo> keyframes,
                          const pptam::Camera& camera, const SE3* T_cw);

// A camera of width x height pixels that looks at the map from above and a little aslant, turned as the first keyframe.
Eye eye_above(std::span<const MapPointInfo> points, std::span<const KeyframeInfo> keyframes, int width, int height);

}  // namespace pptam::platform
