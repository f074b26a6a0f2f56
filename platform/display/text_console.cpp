#include "platform/display/text_console.h"

#include <fcntl.h>
#include <sys/ioctl.h>
#include <unistd.h>

namespace pptam::platform {
namespace {

constexpr int kAskedSignal = SIGUSR1, kBackSignal = SIGUSR2;
volatile std::sig_atomic_t screen_asked = 0, screen_back = 0;

}  // namespace

TextConsole::TextConsole() {
  fd_ = ::open("/dev/tty", O_RDWR | O_NOCTTY | O_CLOEXEC);
  if (fd_ < 0) return;
  vt_mode mode = {};
  if (::ioctl(fd_, VT_GETMODE, &mode_before_) == 0) {
    struct sigaction action = {};
    action.sa_handler = [](int signal) { (signal == kAskedSignal ? screen_asked : screen_back) = 1; };
    action.sa_flags = SA_RESTART;
    ::sigaction(kAskedSignal, &action, &asked_before_);
    ::sigaction(kBackSignal, &action, &back_before_);
    mode.mode = VT_PROCESS;
    mode.relsig = kAskedSignal;
    mode.acqsig = kBackSignal;
    if (::ioctl(fd_, VT_SETMODE, &mode) == 0) return;
    ::sigaction(kAskedSignal, &asked_before_, nullptr);
    ::sigaction(kBackSignal, &back_before_, nullptr);
  }
  ::close(fd_);  // a terminal of another kind, such as ssh's
  fd_ = -1;
}

TextConsole::~TextConsole() {
  if (fd_ < 0) return;
  ::ioctl(fd_, VT_SETMODE, &mode_before_);
  ::sigaction(kAskedSignal, &asked_before_, nullptr);
  ::sigaction(kBackSignal, &back_before_, nullptr);
  ::close(fd_);
}

TextConsole::Change TextConsole::change() {
  if (screen_asked != 0) {
    screen_asked = 0;
    return Change::kAsked;
  }
  if (screen_back != 0) {
    screen_back = 0;
    ::ioctl(fd_, VT_RELDISP, VT_ACKACQ);
    return Change::kBack;
  }
  return Change::kNone;
}

void TextConsole::give() const {
  ::ioctl(fd_, VT_RELDISP, 1);
}

}  // namespace pptam::platform
