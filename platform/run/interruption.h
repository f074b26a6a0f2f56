// SIGINT, SIGTERM and SIGHUP: the first ends a run like a source that breaks, the second ends the process at once.
#pragma once

#include <string>

namespace pptam::platform {

// For the whole program, once. Until stop_on_signals() a signal ends the process at once; drafts of files are removed.
// A hang-up that is ignored (nohup) stays so; SIGPIPE is ignored: writing to a reader that has gone fails.
void handle_signals();

// From now on the first signal is only remembered: who runs for long asks interrupted().
void stop_on_signals();

bool interrupted();
std::string interruption();  // "stopped by SIGINT"; empty: none came

}  // namespace pptam::platform
