// Where platform/display/house.cpp puts the house for some poses, as text that house.mjs compares with platform/web's.
#include <cstdio>
#include <random>

#include "platform/display/house.h"

namespace pptam::test {
namespace {

void print(const char* what, const Vector3f& p, const platform::Rgba& colour) {
  std::printf("%s %.9g %.9g %.9g %d %d %d %d\n", what, static_cast<double>(p.x()), static_cast<double>(p.y()),
              static_cast<double>(p.z()), colour.r, colour.g, colour.b, colour.a);
}

void print_lines(const char* what, const std::vector<platform::WorldLine>& lines) {
  for (const platform::WorldLine& line : lines) {
    std::printf("%s %zu %.9g\n", what, line.points.size(), static_cast<double>(line.width_px));
    for (const platform::WorldVertex& vertex : line.points) print(what, vertex.p_w, vertex.colour);
  }
}

void print_mesh(const char* what, const platform::WorldMesh& mesh) {
  for (const platform::WorldVertex& vertex : mesh.vertices) print(what, vertex.p_w, vertex.colour);
  std::printf("%s", what);
  for (const uint16_t index : mesh.triangles) std::printf(" %d", index);
  std::printf("\n");
}

void run() {
  std::mt19937 random(1);
  const auto number = [&](float low, float high) {
    return low + (high - low) * static_cast<float>(random() % 10007) / 10007;
  };
  for (int pose = 0; pose < 20; ++pose) {
    Vector6f turn;
    turn << 0, 0, 0, number(-1, 1), number(-1, 1), number(-3, 3);
    SE3 T_cw = SE3::exp(turn);
    T_cw.R = T_cw.R * Vector3f(1, -1, -1).asDiagonal();  // looks down, more or less
    T_cw.t = -(T_cw.R * Vector3f(number(-1, 1), number(-1, 1), number(0.2f, 3)));
    std::printf("pose");
    for (int i = 0; i < 9; ++i) std::printf(" %.9g", static_cast<double>(T_cw.R(i / 3, i % 3)));
    for (int i = 0; i < 3; ++i) std::printf(" %.9g", static_cast<double>(T_cw.t[i]));
    std::printf("\n");
    const platform::WorldModel model = platform::make_site_model(platform::place_house(T_cw, 0.1f));
    print_lines("ground", model.ground);
    print_mesh("shadow", model.shadow);
    print_mesh("faces", model.faces);
    print_lines("edges", model.edges);
  }
}

}  // namespace
}  // namespace pptam::test

int main() {
  pptam::test::run();
}
