// The whole screen without a window system: GBM's buffers, shown by the kernel (KMS).
#pragma once

#include <memory>

#include "platform/display/display.h"

namespace pptam::platform {

// On the first graphics device with a connected screen, at the screen's preferred mode. Throws InputError: no such
// screen, no permission, or another program has it.
std::unique_ptr<Display> make_kms_display();

}  // namespace pptam::platform
