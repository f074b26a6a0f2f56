// pocket-ptam-display.so: displays without a window system.
#include "platform/display/display.h"
#include "platform/display/offscreen_display.h"
#ifdef PPTAM_KMS
#include "platform/display/kms_display.h"
#endif

namespace pptam::platform {

extern "C" __attribute__((visibility("default"))) const DisplayEntry PPTAM_DISPLAY_ENTRY;
const DisplayEntry PPTAM_DISPLAY_ENTRY = {make_offscreen_display,
#ifdef PPTAM_KMS
                                          make_kms_display,
#else
                                          nullptr,
#endif
                                          nullptr};

}  // namespace pptam::platform
