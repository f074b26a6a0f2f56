// Images of objects made of faces, cylinders, circles and spheres, by casting rays: what the model-based tracker's
// tests track, with exact poses. As in a camera each pixel is the mean light of 2x2 rays, encoded by a gamma of 2; a
// rolling shutter has a pose for each line.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include <pocket_ptam/model_tracker.h>

namespace pptam::test {

struct RenderedObject {
  std::vector<Vector3f> points;
  std::vector<int> corners;
  std::vector<ModelFace> faces;
  std::vector<ModelCylinder> cylinders;
  std::vector<ModelCircle> circles;
  std::vector<ModelSphere> spheres;
  float background = 60;  // grey at the image's left; it brightens by 30 to the right

  ObjectModel model() const {
    ObjectModel view;
    view.points = points;
    view.corners = corners;
    view.faces = faces;
    view.cylinders = cylinders;
    view.circles = circles;
    view.spheres = spheres;
    return view;
  }

  // A box from its middle, with the given sides; its faces have greys of their own.
  void add_box(const Vector3f& middle, const Vector3f& sides) {
    const int first = static_cast<int>(points.size());
    for (int i = 0; i < 8; ++i)
      points.push_back(middle + 0.5f * Vector3f(i & 1 ? sides.x() : -sides.x(), i & 2 ? sides.y() : -sides.y(),
                                                i & 4 ? sides.z() : -sides.z()));
    constexpr int kFaces[6][4] = {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};
    for (const auto& face : kFaces) {
      ModelFace added;
      added.first = static_cast<int>(corners.size());
      added.count = 4;
      for (const int corner : face) corners.push_back(first + corner);
      faces.push_back(added);
    }
  }

  // Z of what the ray (x, y, 1) of the camera's frame meets first; 1e9: nothing. T_oc: camera to object.
  float depth(const Vector3f& ray_c, const SE3& T_oc) const {
    float nearest;
    cast(ray_c, T_oc, 0, &nearest);
    return nearest;
  }
  // Grey of that; across: 0 to 1, of the background.
  float grey(const Vector3f& ray_c, const SE3& T_oc, float across) const {
    float unused;
    return cast(ray_c, T_oc, across, &unused);
  }
  float cast(const Vector3f& ray_c, const SE3& T_oc, float across, float* depth) const {
    const Vector3f o = T_oc.t, d = T_oc.R * ray_c;
    float nearest = 1e9f, found = background + 30 * across;
    const auto hit = [&](float t, float value) {
      if (t > 1e-4f && t < nearest) {
        nearest = t;
        found = value;
      }
    };
    for (size_t f = 0; f < faces.size(); ++f) {
      const auto corner = [&](int i) {
        return points[static_cast<size_t>(corners[static_cast<size_t>(faces[f].first + i % faces[f].count)])];
      };
      const Vector3f n = (corner(1) - corner(0)).cross(corner(2) - corner(0));
      const float t = n.dot(corner(0) - o) / n.dot(d);
      const Vector3f p = o + t * d;
      bool inside = true;
      for (int i = 0; i < faces[f].count; ++i)
        inside = inside && n.dot((corner(i + 1) - corner(i)).cross(p - corner(i))) >= 0;
      if (inside) hit(t, 100 + 25 * static_cast<float>(f % 6));
    }
    for (const ModelSphere& sphere : spheres) {
      const Vector3f m = o - sphere.centre;
      const float b = m.dot(d), a = d.squaredNorm(),
                  rest = b * b - a * (m.squaredNorm() - sphere.radius * sphere.radius);
      if (rest >= 0) hit((-b - std::sqrt(rest)) / a, 220);
    }
    for (const ModelCircle& circle : circles) {
      const float t = circle.normal.dot(circle.centre - o) / circle.normal.dot(d);
      if ((o + t * d - circle.centre).norm() < circle.radius) hit(t - 1e-3f, 240);
    }
    for (const ModelCylinder& cylinder : cylinders) {
      const Vector3f from = points[static_cast<size_t>(cylinder.a)], to = points[static_cast<size_t>(cylinder.b)];
      const Vector3f u = (to - from).normalized();
      const Vector3f m = (o - from) - u * u.dot(o - from), e = d - u * u.dot(d);
      const float a = e.squaredNorm(), b = m.dot(e),
                  rest = b * b - a * (m.squaredNorm() - cylinder.radius * cylinder.radius);
      if (rest < 0) continue;
      const float t = (-b - std::sqrt(rest)) / a;
      const float along = u.dot(o + t * d - from);
      if (along > 0 && along < (to - from).norm()) hit(t, 190);
    }
    *depth = nearest;
    return found;
  }

  // T_co: the pose at a time relative to the frame's, seconds.
  std::vector<uint8_t> render(const Camera& camera, const std::function<SE3(float)>& T_co) const {
    const int w = camera.model.width, h = camera.model.height;
    std::vector<uint8_t> image(static_cast<size_t>(w) * static_cast<size_t>(h));
    for (int y = 0; y < h; ++y) {
      for (int x = 0; x < w; ++x) {
        const Vector2f px(static_cast<float>(x), static_cast<float>(y));
        const SE3 T_oc = T_co(camera.dt_s(px)).inverse();
        float sum = 0;
        for (int k = 0; k < 4; ++k) {
          const Vector2f at = px + Vector2f(k % 2 == 0 ? -0.25f : 0.25f, k < 2 ? -0.25f : 0.25f);
          const Vector2f ray = camera.unproject(at);
          const float g = grey(Vector3f(ray.x(), ray.y(), 1), T_oc, static_cast<float>(x) / static_cast<float>(w));
          sum += g * g;
        }
        image[static_cast<size_t>(y) * static_cast<size_t>(w) + static_cast<size_t>(x)] =
            static_cast<uint8_t>(std::min(std::sqrt(sum / 4) + 0.5f, 255.0f));
      }
    }
    return image;
  }
  std::vector<uint8_t> render(const Camera& camera, const SE3& T_co) const {
    return render(camera, [&](float) { return T_co; });
  }
};

// A camera of 320x240 pixels, and a box of 0.2 x 0.15 x 0.1 about the origin.
inline Camera small_camera() {
  Camera camera;
  camera.model.width = 320;
  camera.model.height = 240;
  camera.model.fx = camera.model.fy = 320;
  camera.model.cx = 159.5f;
  camera.model.cy = 119.5f;
  camera.model.prepare();
  return camera;
}

inline RenderedObject box() {
  RenderedObject object;
  object.add_box(Vector3f::Zero(), Vector3f(0.2f, 0.15f, 0.1f));
  return object;
}

inline ModelTrackerConfig config_of(const RenderedObject& object, const Camera& camera) {
  ModelTrackerConfig config;
  config.camera = camera;
  config.model = object.model();
  config.max_sites = 400;
  return config;
}

// In front of the camera, turning and swaying; t in frames.
inline SE3 swaying(float t) {
  Vector6f mu;
  mu << 0, 0, 0, 0.5f + 0.012f * t, 0.5f - 0.01f * t, 0.004f * t;
  SE3 T = SE3::exp(mu);
  T.t = Vector3f(0.002f * t - 0.02f, 0.0015f * t - 0.02f, 0.55f - 0.002f * t);
  return T;
}

}  // namespace pptam::test
