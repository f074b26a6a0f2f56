// pocket-ptam-display.so: displays without a window system.
#include "platform/display/display.h"
#include "platform/display/offscreen_display.h"
#ifdef PPTAM_KMS
#include "platform/display/kms_display.h"
#endif

namespace pptam::platform {

extern "C" __attribute__((visibility("default"))) const DisplayEntry pptam_display_entry;
const DisplayEntry pptam_display_entry = {kDisplayVersion, make_offscreen_display,
#ifdef PPTAM_KMS
                                          make_kms_display,
#else
                                          nullptr,
#endif
                                          nullptr};

}  // namespace pptam::platform
