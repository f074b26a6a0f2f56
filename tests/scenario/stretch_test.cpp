// A stretch of bad pictures: a finished map keeps its size; what does not fit it is told.

#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "sim_phone/laboratory/stretch_study.h"
#include "tests/support/sample.h"

namespace pptam {
namespace {

using laboratory::run_stretch;
using laboratory::StretchRun;

TEST(Stretch, AFinishedMapKeepsItsSize) {
  std::vector<std::pair<std::string, std::string>> cases = {{"walls", "shifted"}, {"desk", "zoomed"}};
  if (test::all_asked_for())
    cases.insert(cases.end(), {{"boxes", "zoomed"}, {"desk", "shuffled"}, {"boxes", "backwards"}});
  for (const auto& [scene, kind] : cases) {
    for (uint64_t seed = 1; seed <= 2; ++seed) {
      sim::PhoneOptions phone;
      phone.scene = scene;
      phone.seed = seed;
      phone.duration_s = 20;
      const StretchRun run = run_stretch(phone, {}, kind);
      SCOPED_TRACE(run.name);
      ASSERT_TRUE(run.begun);
      EXPECT_LT(std::abs(run.scale_percent), 1);
      if (kind == "zoomed") {  // a shift on a wall looks like a turn, and fits
        EXPECT_GT(run.judged, 0);
        EXPECT_EQ(run.wrong_good, 0);
        EXPECT_GT(run.misfits_within, 5);
      }
      EXPECT_LE(run.misfits_before, 3);  // of some 100: single quick turns
    }
  }
}

}  // namespace
}  // namespace pptam
