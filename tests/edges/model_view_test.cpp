// Which contours are seen, where their sites lie, and what hides them.
#include "edges/model_view.h"

#include <gtest/gtest.h>

#include <cmath>
#include <optional>
#include <set>
#include <vector>

#include "tests/support/map_building.h"
#include "tests/support/random.h"
#include "tests/support/rendered_object.h"

namespace pptam {
namespace {

Camera vga_camera() {
  Camera camera;
  camera.model.width = 640;
  camera.model.height = 480;
  camera.model.fx = camera.model.fy = 600;
  camera.model.cx = 319.5f;
  camera.model.cy = 239.5f;
  camera.model.prepare();
  return camera;
}

class Viewer {
 public:
  Viewer(const ObjectModel& model, const Camera& camera, int max_sites = 800)
      : camera_(camera), block_([&](Arena& arena) {
          parts_.emplace(arena, model);
          view_.emplace(arena, *parts_, camera_);
          sites_ = FixedVector<ContourSite>(arena, max_sites);
        }) {}
  const FixedVector<ContourSite>& sites(const SE3& T_co, int level = 0, float spacing = 4) {
    view_->set_pose(T_co);
    view_->make_sites(level, spacing, Vector6f::Zero(), &sites_);
    return sites_;
  }
  std::set<int> contours(const SE3& T_co) {
    std::set<int> seen;
    for (const ContourSite& site : sites(T_co)) seen.insert(site.contour);
    return seen;
  }
  const ModelParts& parts() const { return *parts_; }
  const ModelView& view() const { return *view_; }

 private:
  const Camera camera_;
  std::optional<ModelParts> parts_;
  std::optional<ModelView> view_;
  FixedVector<ContourSite> sites_;
  test::Block block_;
};

test::RenderedObject box() {
  test::RenderedObject object;
  object.add_box(Vector3f::Zero(), Vector3f(0.2f, 0.15f, 0.1f));
  return object;
}

SE3 pose(float turn_x, float turn_y, float z) {
  Vector6f mu;
  mu << 0, 0, 0, turn_x, turn_y, 0;
  SE3 T = SE3::exp(mu);
  T.t = Vector3f(0, 0, z);
  return T;
}

TEST(ModelView, FacesShareTheirSides) {
  const test::RenderedObject object = box();
  Viewer viewer(object.model(), vga_camera());
  EXPECT_EQ(viewer.parts().contours(), 12);
  for (const ModelSide& side : viewer.parts().sides()) EXPECT_EQ(side.faces, 2);
  EXPECT_NEAR(viewer.parts().extent(), 0.5f * std::sqrt(0.04f + 0.0225f + 0.01f), 1e-6f);
}

// A box that is passed closely, on the right, with sides that cross the camera's plane: without a bound their length in
// the image grows to any size, and hardly anything of the object would seem to be within it.
TEST(ModelView, WhatCrossesTheCamerasPlaneHasABoundedLength) {
  const test::RenderedObject object = box();
  const Camera camera = vga_camera();
  Viewer viewer(object.model(), camera);
  const float spacing = 4;
  int crossed = 0;
  for (const float z : {0.09f, 0.06f, 0.051f, 0.05f, 0.049f, 0.03f}) {  // of the middle; half the box is 0.05 deep
    const SE3 T_co = pose(0.1f, 0.02f, z) * SE3{Matrix3f::Identity(), Vector3f(0.125f, 0.01f, 0)};
    const float inside_px = static_cast<float>(viewer.sites(T_co, 0, spacing).size()) * spacing;
    if (!(inside_px > 100)) continue;
    ++crossed;
    const float sides = 4 * (0.2f + 0.15f + 0.1f), middle_z = (T_co * viewer.parts().middle()).z();
    const float at_most_px = 4 * camera.model.fx * sides / middle_z;
    // A site stands for its spacing or more: less where something hides the contour, so half is left for the hidden.
    EXPECT_GE(viewer.view().share_in_image(), 0.5f * inside_px / at_most_px) << z;
  }
  EXPECT_GE(crossed, 3);
}

TEST(ModelView, ABoxShowsFourSevenOrNineSides) {
  const test::RenderedObject object = box();
  Viewer viewer(object.model(), vga_camera());
  EXPECT_EQ(viewer.contours(pose(0, 0, 1)).size(), 4u);
  EXPECT_EQ(viewer.contours(pose(0, 0.5f, 1)).size(), 7u);
  EXPECT_EQ(viewer.contours(pose(0.5f, 0.5f, 1)).size(), 9u);
  EXPECT_TRUE(viewer.contours(pose(0, 0, -1)).empty()) << "behind the camera";
}

// Sites lie on their contour, inside the image, as far apart as wanted, with normals across it.
TEST(ModelView, SitesLieAlongTheContours) {
  const test::RenderedObject object = box();
  const Camera camera = vga_camera();
  Viewer viewer(object.model(), camera);
  const SE3 T = pose(0.4f, 0.6f, 0.8f);
  const FixedVector<ContourSite>& sites = viewer.sites(T);
  ASSERT_GT(sites.size(), 100);
  for (int i = 0; i < sites.size(); ++i) {
    const ContourSite& site = sites[i];
    EXPECT_TRUE(camera.in_image(site.px, 3));
    Vector2f px;
    ASSERT_TRUE(camera.project(site.p_c, &px));
    EXPECT_LT((px - site.px).norm(), 1e-3f);
    const ModelSide& side = viewer.parts().sides()[site.contour];
    const Vector3f a = T * object.points[static_cast<size_t>(side.a)],
                   b = T * object.points[static_cast<size_t>(side.b)];
    EXPECT_LT((site.p_c - a).cross(b - a).norm() / (b - a).norm(), 1e-4f) << "off its line";
    if (i == 0 || sites[i - 1].contour != site.contour) continue;
    const Vector2f step = site.px - sites[i - 1].px;
    EXPECT_NEAR(step.norm(), 4, 0.3f);
    EXPECT_LT(std::abs(step.dot(site.normal)), 1e-2f);
  }
}

TEST(ModelView, FewSitesAreSpreadOverAllContours) {
  const test::RenderedObject object = box();
  Viewer viewer(object.model(), vga_camera(), 60);
  const SE3 T = pose(0.4f, 0.6f, 0.4f);
  EXPECT_EQ(viewer.contours(T).size(), 9u);
  EXPECT_LE(viewer.sites(T).size(), 60);
  EXPECT_GT(viewer.sites(T).size(), 35);
}

// A model of more contours than sites: some of all kinds and places get one.
TEST(ModelView, FewerSitesThanContours) {
  test::RenderedObject object = box();
  std::vector<ModelLine> lines;
  for (int i = 0; i < 300; ++i) {
    const float x = 0.001f * static_cast<float>(i) - 0.15f;
    object.points.emplace_back(x, -0.1f, 0.1f);
    object.points.emplace_back(x, 0.1f, 0.1f);
    lines.push_back({8 + 2 * i, 9 + 2 * i, 0});
  }
  object.faces.clear();
  for (const float x : {-0.1f, 0.1f}) object.circles.push_back({Vector3f(x, 0, -0.1f), Vector3f(0, 0, -1), 0.1f});
  ObjectModel model = object.model();
  model.lines = lines;
  Viewer viewer(model, vga_camera(), 60);
  const std::set<int> seen = viewer.contours(pose(0, 0, 1));
  EXPECT_LE(viewer.sites(pose(0, 0, 1)).size(), 60);
  EXPECT_GT(viewer.sites(pose(0, 0, 1)).size(), 50);
  EXPECT_LT(*seen.begin(), 20);
  EXPECT_EQ(*seen.rbegin(), 301) << "the last circle";
}

// Of a circle that surrounds the image nearly, what is outside takes no sites from the others.
TEST(ModelView, ACircleOutsideTheImageTakesNoSites) {
  const SE3 T = pose(0.4f, 0.6f, 0.8f);
  test::RenderedObject object = box();
  Viewer alone(object.model(), vga_camera(), 200);
  const int box_alone = alone.sites(T).size();
  // Of a radius of 390 px; the image's corners are 400 px away.
  object.circles.push_back({Vector3f::Zero(), T.R.transpose() * Vector3f(0, 0, -1), 0.52f});
  Viewer viewer(object.model(), vga_camera(), 200);
  int on_circle = 0;
  for (const ContourSite& site : viewer.sites(T)) {
    on_circle += site.contour == 12;
    EXPECT_TRUE(vga_camera().in_image(site.px, 3));
  }
  EXPECT_GT(viewer.sites(T).size(), 140);
  EXPECT_GT(viewer.sites(T).size() - on_circle, box_alone * 2 / 3);
  object.circles[0].radius = 5;
  Viewer around(object.model(), vga_camera(), 200);
  EXPECT_EQ(around.sites(T).size(), box_alone) << "wholly outside";
}

// Every site is compared with a ray cast at it: what the ray meets first must not be nearer than the site.
TEST(ModelView, HiddenSitesAreLeftOut) {
  test::RenderedObject object = box();
  object.add_box(Vector3f(0.05f, 0.02f, -0.2f), Vector3f(0.1f, 0.1f, 0.05f));  // before the first one
  object.points.emplace_back(-0.08f, -0.2f, -0.2f);
  object.points.emplace_back(-0.08f, 0.2f, -0.2f);
  object.cylinders.push_back({16, 17, 0.03f, 0});
  object.spheres.push_back({Vector3f(0.1f, -0.08f, -0.1f), 0.04f});
  Viewer viewer(object.model(), vga_camera());
  test::Random random;
  int shown = 0, near_misses = 0;
  for (int trial = 0; trial < 40; ++trial) {
    const SE3 T =
        pose(static_cast<float>(random.uniform(-0.6, 0.6)), static_cast<float>(random.uniform(-0.6, 0.6)), 0.8f);
    const SE3 T_oc = T.inverse();
    for (const ContourSite& site : viewer.sites(T)) {
      ++shown;
      const float depth = object.depth(site.p_c / site.p_c.z(), T_oc);
      if (depth < 0.9f * site.p_c.z()) ++near_misses;
    }
  }
  EXPECT_GT(shown, 5000);
  // Sites within a pixel of an occluder's outline may be judged either way.
  EXPECT_LT(near_misses, shown / 200);
}

TEST(ModelView, AFaceHidesWhatIsBehindIt) {
  test::RenderedObject object = box();
  object.add_box(Vector3f(0, 0, -0.3f), Vector3f(0.4f, 0.4f, 0.02f));  // a board that covers the box
  Viewer viewer(object.model(), vga_camera());
  for (const int contour : viewer.contours(pose(0, 0, 1))) EXPECT_GE(contour, 12) << "a side of the covered box";
  test::RenderedObject uncovered = box();
  Viewer other(uncovered.model(), vga_camera());
  EXPECT_EQ(other.contours(pose(0, 0, 1)).size(), 4u);
}

TEST(ModelView, SmoothSidesAreSeenAsOutlinesOnly) {
  // A prism of 24 sides: seen from aside, two of its long sides are outlines.
  test::RenderedObject object;
  constexpr int kSides = 24;
  for (int i = 0; i < 2 * kSides; ++i) {
    const float angle = 6.2831853f * static_cast<float>(i / 2) / kSides;
    object.points.emplace_back(0.1f * std::cos(angle), i % 2 ? 0.15f : -0.15f, 0.1f * std::sin(angle));
  }
  for (int i = 0; i < kSides; ++i) {
    ModelFace face;
    face.first = static_cast<int>(object.corners.size());
    face.count = 4;
    const int next = (i + 1) % kSides;
    for (const int corner : {2 * i, 2 * i + 1, 2 * next + 1, 2 * next}) object.corners.push_back(corner);
    object.faces.push_back(face);
  }
  ObjectModel model = object.model();
  const auto long_sides = [&] {
    Viewer viewer(model, vga_camera());
    int count = 0;
    for (const int contour : viewer.contours(pose(0, 0.1f, 1))) {
      const ModelSide& side = viewer.parts().sides()[static_cast<size_t>(contour)];
      count += std::abs(object.points[static_cast<size_t>(side.a)].y() -
                        object.points[static_cast<size_t>(side.b)].y()) > 0.1f;
    }
    return count;
  };
  EXPECT_GT(long_sides(), 8);
  model.outlines_of_smooth = true;
  EXPECT_EQ(long_sides(), 2);
}

TEST(ModelView, ThresholdsLeaveOutWhatIsSmall) {
  test::RenderedObject object = box();
  for (ModelFace& face : object.faces) face.min_area_px2 = 2500;
  Viewer viewer(object.model(), vga_camera());
  EXPECT_EQ(viewer.contours(pose(0, 0, 1)).size(), 4u);  // 126 x 95 px
  EXPECT_TRUE(viewer.contours(pose(0, 0, 3)).empty());   // 41 x 31 px
  test::RenderedObject round;
  round.spheres.push_back({Vector3f::Zero(), 0.05f, 2500});
  round.circles.push_back({Vector3f(0.2f, 0, 0), Vector3f(0, 0, -1), 0.05f, false, 2500});
  Viewer other(round.model(), vga_camera());
  EXPECT_EQ(other.contours(pose(0, 0, 1)).size(), 2u);    // 2827 px^2
  EXPECT_TRUE(other.contours(pose(0, 0, 1.1f)).empty());  // 2340 px^2
}

}  // namespace
}  // namespace pptam
