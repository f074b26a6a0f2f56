#include "sim_phone/bystanders.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim_phone/hand.h"
#include "sim_phone/paint.h"
#include "sim_phone/random.h"

namespace pptam::sim {
namespace {

using Eigen::Isometry3d;

constexpr double kFirst_s = 4;        // the first arm comes
constexpr double kFirstStep_s = 1.5;  // the first person, who takes over two seconds to come into view
constexpr double kClothTexel_m = 0.001;

// Cloth: checked, or printed all over.
void cloth(Canvas& canvas, Random& random) {
  const Place place(0, 0, 0);
  const double w = canvas.width_m(), h = canvas.height_m();
  canvas.rectangle(place, -1, -1, w + 1, h + 1, random.uniform(0.1, 0.6));
  if (random.chance(0.5)) {
    const double pitch = random.uniform(0.02, 0.04), ink = random.uniform(0.05, 0.7);
    for (double x = 0; x < w; x += pitch) canvas.rectangle(place, x, 0, x + 0.4 * pitch, h, ink, 0.5);
    for (double y = 0; y < h; y += pitch) canvas.rectangle(place, 0, y, w, y + 0.4 * pitch, ink, 0.5);
  } else {
    picture(canvas, place, w, h, random);
  }
}

// In its own frame the fingertips are at the origin, the arm leads along x, z points up.
std::shared_ptr<Mover> make_arm(Random& random) {
  constexpr double kSleeve_m = 0.6, kHand_m = 0.17;
  const Vector3d u = Vector3d::UnitX(), v = -Vector3d::UnitY();
  auto arm = std::make_shared<Mover>();
  const auto add = [&](Canvas& canvas, double from_x, double z) {
    arm->surfaces.push_back(surface_of(canvas, {from_x, 0.5 * canvas.height_m(), z}, u, v, 0.9));
  };
  Canvas sleeve(kSleeve_m, random.uniform(0.08, 0.12), kClothTexel_m),
      hand(kHand_m, random.uniform(0.07, 0.09), kClothTexel_m);
  cloth(sleeve, random);
  skin(hand, random);
  add(sleeve, kHand_m, 0.01);
  add(hand, 0, 0);
  if (random.chance(0.5)) {
    const double width = random.uniform(0.08, 0.14);
    Canvas thing(width, 1.35 * width, kClothTexel_m);
    cover(thing, Place(0.5 * width, 0.675 * width, 0), width, 1.35 * width, random);
    add(thing, -0.08, -0.01);
  }
  return arm;
}

// Every so often the arm reaches in from a side, to three places one after the other, and leaves.
std::function<Isometry3d(double)> reaching(double azimuth_rad, double stay_s, double first_s, double every_s,
                                           double height_m, uint64_t seed) {
  constexpr double kOutside_m = 0.9, kReach_m = 0.22, kEnter_s = 0.6;
  return [=](double t_s) {
    const double visit = std::max(0.0, std::floor((t_s - first_s) / every_s));
    Random random(seed, static_cast<uint64_t>(visit));
    const double side = azimuth_rad + random.uniform(-2, 2);
    const Vector3d outside = kOutside_m * Vector3d(std::cos(side), std::sin(side), 0);
    const double t = t_s - first_s - visit * every_s;
    Vector3d tip = outside;
    Vector3d last = outside;
    for (int i = 0; i < 3; ++i) {
      const double radius = kReach_m * std::sqrt(random.uniform(0, 1)), to = random.uniform(0, 2 * std::numbers::pi);
      const Vector3d next = radius * Vector3d(std::cos(to), std::sin(to), 0);
      tip += (next - last) * blend((t - i * stay_s / 3) / kEnter_s);
      last = next;
    }
    tip += (outside - last) * blend((t - stay_s + kEnter_s) / kEnter_s);
    Isometry3d T = Isometry3d::Identity();
    T.linear() = Eigen::AngleAxisd(side + 0.6 * tip.x(), Vector3d::UnitZ()).toRotationMatrix();
    T.translation() = tip + Vector3d(0, 0, height_m);
    return T;
  };
}

// Breast and head as seen from the room. In its own frame x leads to the right as seen, z up from the floor, and y to
// the viewer.
std::shared_ptr<Mover> make_person(Random& random) {
  constexpr double kNeck_m = 0.06;
  const double width = random.uniform(0.36, 0.46), shoulders = random.uniform(1.0, 1.15);
  const Vector3d u = -Vector3d::UnitX(), v = -Vector3d::UnitZ();  // v x u points along y
  auto person = std::make_shared<Mover>();
  const auto add = [&](Canvas& canvas, double top, double y) {
    person->surfaces.push_back(surface_of(canvas, {0.5 * canvas.width_m(), y, top}, u, v, 0.9));
  };
  Canvas body(width, 0.9, kClothTexel_m), head(0.17, 0.23, kClothTexel_m);
  cloth(body, random);
  skin(head, random);
  const double hair = random.uniform(0.02, 0.2);
  head.rectangle(Place(0, 0, 0), -1, -1, 1, random.uniform(0.05, 0.1), hair);
  for (const double x : {0.05, 0.12}) head.ellipse(Place(x, 0.11, 0), 0.016, 0.007, 0.05);
  head.ellipse(Place(0.085, 0.19, 0), 0.03, 0.008, 0.12);
  add(body, shoulders, 0);
  add(head, shoulders + kNeck_m + 0.17, 0.02);
  return person;
}

// Along one wall, round the corner and along the other: a place on the unfolded walls, as wall_view has it.
Isometry3d beside_walls(double place, double distance_m) {
  const double turn = blend(0.5 * (1 + place / distance_m));  // 1: before the wall y = 0, seen along -y
  Isometry3d T = Isometry3d::Identity();
  const double angle = -0.5 * std::numbers::pi * (1 - turn);  // its y axis turns from +y to +x
  T.linear() = Eigen::AngleAxisd(angle, Vector3d::UnitZ()).toRotationMatrix();
  T.translation() = Vector3d(std::max(place, distance_m), std::max(-place, distance_m), 0);
  return T;
}

}  // namespace

std::vector<std::shared_ptr<const Mover>> make_bystanders(const Stage& stage, double busy, uint64_t seed) {
  std::vector<std::shared_ptr<const Mover>> all;
  if (busy == 0) return all;
  Random random(seed, 53);
  if (stage.kind == Stage::Kind::kTable) {
    // Two arms that take turns.
    constexpr double kTurn_s = 5, kShortest_s = 1.2;  // in and out again
    for (int i = 0; i < 2; ++i) {
      const std::shared_ptr<Mover> arm = make_arm(random);
      const double height = std::min(random.uniform(0.04, 0.1), 0.5 * stage.min_height_m);
      const double stay_s = std::max(busy * kTurn_s, kShortest_s);
      arm->T_wm = reaching(stage.azimuth_rad, stay_s, kFirst_s + i * kTurn_s, 2 * kTurn_s, height, random.bits());
      all.push_back(arm);
    }
    return all;
  }
  constexpr double kHalfWay_m = 3.2;  // from the corner to where they are out of sight
  constexpr double kInSight_m = 0.6;  // of their way: where more than the tip of a shoulder is seen
  const double apart = kInSight_m / busy;
  const int people = static_cast<int>(std::ceil(2 * kHalfWay_m / apart));
  const double speed = random.uniform(0.7, 1.1), way = random.sign();
  for (int i = 0; i < people; ++i) {
    const std::shared_ptr<Mover> person = make_person(random);
    const double distance = random.uniform(0.2, 0.35);
    const double ahead = apart * (i + random.uniform(-0.2, 0.2)) + kHalfWay_m;
    const double lap = apart * people;
    person->T_wm = [=](double t_s) {
      const double gone = speed * (t_s - kFirstStep_s) - ahead + kHalfWay_m;
      const double place = gone - lap * std::floor(gone / lap) - kHalfWay_m;
      const bool present = gone > 0 && place < kHalfWay_m;
      return beside_walls(present ? way * place : 2 * kHalfWay_m, distance);
    };
    all.push_back(person);
  }
  return all;
}

std::shared_ptr<const Mover> make_carried_thing(const Isometry3d& T_wc, double depth_m, double start_s, uint64_t seed) {
  Random random(seed, 54);
  const double depth = 0.5 * depth_m;
  const double width = 0.37 * depth, height = 0.48 * depth;  // the phone sees 0.67 by 0.89 of the depth
  auto thing = std::make_shared<Mover>();
  Canvas canvas(width, height, 0.0005);
  cover(canvas, Place(0.5 * width, 0.5 * height, 0), width, height, random);
  // Seen from the camera: columns to the right, rows downwards, v x u points to the camera.
  thing->surfaces.push_back(surface_of(canvas, {-0.5 * width, -0.5 * height, 0}, Vector3d::UnitX(), Vector3d::UnitY(),
                                       random.uniform(0.8, 1)));
  const double reach_x = random.uniform(0.1, 0.14) * depth, reach_y = random.uniform(0.08, 0.18) * depth;
  const double rate_x = 2 * std::numbers::pi / random.uniform(3, 5),
               rate_y = 2 * std::numbers::pi / random.uniform(3, 7);
  const double lean = random.uniform(-0.3, 0.3);
  thing->T_wm = [=](double t_s) {
    const double t = std::max(0.0, t_s - start_s);
    const double swell = blend(t / 0.5);
    Isometry3d T = Isometry3d::Identity();
    T.translation() = Vector3d(swell * reach_x * std::sin(rate_x * t), swell * reach_y * std::sin(rate_y * t),
                               depth * (1 + 0.08 * swell * std::sin(0.7 * rate_x * t)));
    T.linear() =
        Eigen::AngleAxisd(lean + 0.1 * swell * std::sin(0.8 * rate_y * t), Vector3d::UnitZ()).toRotationMatrix();
    return T_wc * T;
  };
  return thing;
}

}  // namespace pptam::sim
