// What makes real pictures harder than an emulator's, by physical causes. Each can be switched off: a value of 0 leaves
// every pixel as it is without the cause.
//
// Who acts on what: `scene` on bare surfaces and repeated patterns, `gloss` on reflections, `bystanders` on what moves,
// `motion` on haste, `lamp_and_focus` and `compression` on what their names
// say.
#pragma once

#include <string>
#include <vector>

namespace pptam::sim {

struct Harshness {
  double bare = 0;        // share of the pages, pictures and marks that are missing; the ground below is plain paint
  double repeats = 0;     // contrast of a pattern printed on the ground below them, alike to the texel
  double gloss = 0;       // reflectance of a varnish on parts of all surfaces, looked at along the normal
  double people = 0;      // share of the time in which an arm or a person moves in the scene
  double flicker = 0;     // light of a lamp on the mains: 1 + flicker * sin(2 pi mains_hz t); shutters make bands of it
  double mains_hz = 100;  // twice the mains' frequency
  double compression = 0;  // coarseness of an 8x8 DCT quantiser: 1 is JPEG's quality 50, 2 is 25
  double breathing = 0;    // by which share the focal length changes as the focus hunts
  double dimness = 0;      // share of the light that is missing; the camera's gain makes up for it
  double haste = 0;        // while exploring the hand moves and turns 1 + haste times as fast
};

// A cause that can be named on the command line.
struct Cause {
  const char* name;
  double Harshness::*value;
  double usual;     // what is met every day
  double greatest;  // the largest value that makes sense
  const char* says;
};
const std::vector<Cause>& causes();

// texts: "NAME" or "NAME:VALUE" of causes(), "mains:HZ", or "all". Changes what they name. Throws
// platform::InputError, which says what there is.
void add_harshness(const std::vector<std::string>& texts, Harshness* harshness);
// Those of its causes that are not 0, as for add_harshness; empty: none.
std::string harshness_text(const Harshness& harshness);

}  // namespace pptam::sim
