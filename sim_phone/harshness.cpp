#include "sim_phone/harshness.h"

#include <cstdlib>

#include "platform/input_error.h"
#include "platform/text.h"

namespace pptam::sim {
namespace {

constexpr double kMains50_hz = 100;
constexpr double kLeastMains_hz = 50, kMostMains_hz = 240;

double number_in(const std::string& text, const std::string& number, double least, double greatest) {
  char* end = nullptr;
  const double value = std::strtod(number.c_str(), &end);
  if (number.empty() || *end != '\0' || !(value >= least && value <= greatest)) {
    throw platform::InputError("--harsh " + text + ": write a number from " + platform::format("%g", least) + " to " +
                               platform::format("%g", greatest) + " behind the colon");
  }
  return value;
}

}  // namespace

const std::vector<Cause>& causes() {
  static const std::vector<Cause> all = {
      {"bare", &Harshness::bare, 0.6, 1, "bare surfaces: the share of pages and marks that is missing"},
      {"repeats", &Harshness::repeats, 0.4, 1, "a pattern printed again and again below them; its contrast"},
      {"reflections", &Harshness::gloss, 0.04, 0.5, "glossy parts mirror lamps and a window; reflectance"},
      {"people", &Harshness::people, 0.5, 1, "arms on tables, people before walls; share of the time"},
      {"flicker", &Harshness::flicker, 0.2, 0.9, "a lamp at 100 Hz (or mains:120); depth"},
      {"compression", &Harshness::compression, 2, 8, "8x8 blocks, quantised; 1 is JPEG's quality 50, 2 is 25"},
      {"breathing", &Harshness::breathing, 0.006, 0.05, "the focus hunts; change of the focal length"},
      {"dim", &Harshness::dimness, 0.75, 0.97, "a dim room, much gain; share of the light that is missing"},
      {"brisk", &Harshness::haste, 3, 6, "hasty hands; how much faster they explore"},
  };
  return all;
}

void add_harshness(const std::vector<std::string>& texts, Harshness* harshness) {
  for (const std::string& text : texts) {
    const size_t colon = text.find(':');
    const std::string name = text.substr(0, colon);
    const bool valued = colon != std::string::npos;
    if (name == "mains" && valued) {
      harshness->mains_hz = number_in(text, text.substr(colon + 1), kLeastMains_hz, kMostMains_hz);
      continue;
    }
    bool known = false;
    for (const Cause& cause : causes()) {
      if (name != cause.name && text != "all") continue;
      harshness->*cause.value = valued ? number_in(text, text.substr(colon + 1), 0, cause.greatest) : cause.usual;
      known = true;
    }
    if (!known) {
      std::vector<std::string> names;
      for (const Cause& cause : causes()) names.emplace_back(cause.name);
      throw platform::InputError("--harsh " + text + ": choose of " + platform::joined(names) +
                                 ", each with :VALUE if it shall not be the usual one, of mains:HZ and all");
    }
  }
}

std::string harshness_text(const Harshness& harshness) {
  std::string text;
  for (const Cause& cause : causes()) {
    const double value = harshness.*cause.value;
    if (value == 0) continue;
    text += (text.empty() ? "" : ",") + (cause.name + platform::format(":%g", value));
  }
  if (harshness.flicker != 0 && harshness.mains_hz != kMains50_hz)
    text += platform::format(",mains:%g", harshness.mains_hz);
  return text;
}

}  // namespace pptam::sim
