#include "sim_phone/lamp_and_focus.h"

#include <cmath>
#include <numbers>

#include "sim_phone/hand.h"
#include "sim_phone/random.h"

namespace pptam::sim {

std::function<double(double)> lamp_light(const Harshness& harshness, uint64_t seed) {
  constexpr double kMainsTolerance = 0.001;
  if (harshness.flicker == 0 && harshness.dimness == 0) return nullptr;
  Random random(seed, 50);
  const double omega =
      2 * std::numbers::pi * harshness.mains_hz * (1 + random.uniform(-kMainsTolerance, kMainsTolerance));
  const double phase = random.uniform(0, 2 * std::numbers::pi);
  return [=, depth = harshness.flicker, share = 1 - harshness.dimness](double t_s) {
    return share * (1 + depth * std::sin(omega * t_s + phase));
  };
}

std::function<Focus(double)> focus_curve(double breathing, uint64_t seed) {
  if (breathing == 0) return nullptr;
  constexpr double kDrift = 0.35;   // share of the change that is slow
  constexpr double kHunt_s = 0.7;   // there and back
  constexpr double kBlur_px = 1.5;  // at the far end of a hunt
  Random random(seed, 51);
  const double drift_s = random.uniform(5, 9);
  const double phase = random.uniform(0, 2 * std::numbers::pi);
  const double period_s = random.uniform(4, 6);  // of the hunts, whose time in it varies
  const uint64_t times = random.bits();
  return [=](double t_s) {
    const double index = std::floor(t_s / period_s);
    Random hunt(times, static_cast<uint64_t>(static_cast<int64_t>(index)));
    const double start_s = index * period_s + hunt.uniform(0, period_s - kHunt_s);
    const double way = hunt.sign();
    const double half = 0.5 * kHunt_s;
    const double away = blend((t_s - start_s) / half) - blend((t_s - start_s - half) / half);
    Focus focus;
    focus.scale =
        1 + breathing * (kDrift * std::sin(2 * std::numbers::pi * t_s / drift_s + phase) + (1 - kDrift) * way * away);
    focus.blur_px = kBlur_px * away;
    return focus;
  };
}

}  // namespace pptam::sim
