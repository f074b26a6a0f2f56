#include "platform/run/interruption.h"

#include <csignal>

#include "platform/child_process.h"
#include "platform/files.h"
#include "platform/run/keys.h"

namespace pptam::platform {
namespace {

volatile std::sig_atomic_t remember = 0;
volatile std::sig_atomic_t came = 0;

extern "C" void on_signal(int signal) {
  if (remember != 0 && came == 0) {
    came = signal;
    return;
  }
  end_children();  // first: an encoder that has just started would make its draft again
  remove_drafts();
  restore_terminal();
  std::signal(signal, SIG_DFL);
  ::raise(signal);  // delivered when the handler returns
}

}  // namespace

void handle_signals() {
  struct sigaction action = {};
  action.sa_handler = on_signal;
  action.sa_flags = SA_RESTART;
  sigemptyset(&action.sa_mask);
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    struct sigaction before = {};
    ::sigaction(signal, nullptr, &before);
    if (signal == SIGHUP && before.sa_handler == SIG_IGN) continue;
    ::sigaction(signal, &action, nullptr);
  }
  std::signal(SIGPIPE, SIG_IGN);
  std::signal(SIGXFSZ, SIG_IGN);  // a file that may not grow is an error of writing, not the end
  std::signal(SIGCHLD, SIG_DFL);  // ignored, which may be inherited, children could not be waited for
}

void stop_on_signals() {
  remember = 1;
}

bool interrupted() {
  return came != 0;
}

std::string interruption() {
  switch (came) {
    case 0:
      return "";
    case SIGINT:
      return "stopped by SIGINT";
    case SIGHUP:
      return "stopped by SIGHUP";
    default:
      return "stopped by SIGTERM";
  }
}

}  // namespace pptam::platform
