// The words for what the core and the program tell in numbers: for the terminal, the overlay, the report and the
// tables.
#pragma once

#include <string>

#include <pocket_ptam/pocket_ptam.h>
#include "platform/run/clocks.h"
#include "platform/run/trace_event.h"

namespace pptam::platform {

const char* name_of(TrackingState state);
const char* name_of(TrackingQuality quality);
const char* name_of(Hint hint);
const char* name_of(Stage stage);
const char* name_of(ClockKind clock);
const char* name_of(Span span);
const char* name_of(TraceWhat what);
const char* sentence_for(Hint hint);           // what the user should do; "" for none
const char* advice_for(Hint hint);             // after a run: what was wrong and what helps; "" for none
std::string limit_names(uint32_t limits_hit);  // Config fields joined by '|'; "" for none

const char* name_of(RollingShutter::Axis axis);  // rows or columns
// As --readout takes it, "columns:-:0.0600"; seconds is signed.
std::string readout_text(RollingShutter::Axis axis, double seconds);

}  // namespace pptam::platform
