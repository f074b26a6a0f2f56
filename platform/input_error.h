// What the user can put right: every reader of files and options throws it.
#pragma once

#include <stdexcept>

namespace pptam::platform {

// A mistake in what came from outside (file, calibration, option): one line that names the file or option and the
// remedy. The program prints it and exits with code 2.
struct InputError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

}  // namespace pptam::platform
