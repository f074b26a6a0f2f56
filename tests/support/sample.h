// Studies are sampled in the daily run; tests/run.sh --all takes them whole.
#pragma once

#include <cstdlib>

namespace pptam::test {

inline bool all_asked_for() {
  return std::getenv("PPTAM_ALL") != nullptr;
}
inline int sampled(int few, int all) {
  return all_asked_for() ? all : few;
}

}  // namespace pptam::test
