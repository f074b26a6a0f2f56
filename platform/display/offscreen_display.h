// Pictures into memory, without any window system or screen: on a graphics processor whose device this user may open,
// else by Mesa's software renderer.
#pragma once

#include <memory>

#include "platform/display/display.h"

namespace pptam::platform {

// Throws InputError.
std::unique_ptr<Display> make_offscreen_display(int width, int height);

}  // namespace pptam::platform
