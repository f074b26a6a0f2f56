// Mesa's software renderer off-screen, whatever this computer has: the same pictures everywhere.
#pragma once

#include <gtest/gtest.h>

#include <cstdlib>
#include <memory>

#include "platform/display/display.h"
#include "platform/input_error.h"

namespace pptam::test {

// Null, with the test skipped, where there is no driver.
inline std::unique_ptr<platform::Display> software_display(int width, int height) {
  ::setenv("LIBGL_ALWAYS_SOFTWARE", "1", 1);
  try {
    return platform::open_offscreen(width, height);
  } catch (const platform::InputError& error) {
    std::printf("  skipped: %s\n", error.what());
    return nullptr;
  }
}

}  // namespace pptam::test

#define PPTAM_SOFTWARE_DISPLAY(display, width, height)                                      \
  const std::unique_ptr<platform::Display> display = test::software_display(width, height); \
  if (display == nullptr) GTEST_SKIP() << "nothing can be drawn here"
