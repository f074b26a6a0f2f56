# Sourced by tests/run.sh, tests/bench/run.sh, tests/fuzz/run.sh, tests/bits/table.sh, core/docs/make.sh,
# sim_phone/demo.sh and toolchains/make_sysroot.sh: the Debian packages that a build needs, and how they get installed.

program_packages=(
  g++ cmake ninja-build pkgconf
  libeigen3-dev                                         # the core
  libyaml-cpp-dev libgdk-pixbuf-2.0-dev                 # platform: calibrations, images
  libjpeg-dev                                           # platform: cameras that send MJPEG; each system's libjpeg-turbo
  libcli11-dev libcairo2-dev                            # the program: options, pictures
  ffmpeg gnuplot-nox                                    # the program runs them: videos, plots
)
display_packages=(                                      # pictures: overlays, screens; and the drivers that draw them
  libegl-dev libgles-dev libgbm-dev libdrm-dev libegl-mesa0 libgl1-mesa-dri
)
window_packages=(libsdl2-dev)                           # --show in a window
window_test_packages=(xvfb xdotool x11-apps)            # tests/display: an X server without a screen
calibrate_packages=(libopencv-calib3d-dev)              # only calibrate needs it, and it is large: not the program's
test_packages=(libgtest-dev dpkg-dev file python3 "${calibrate_packages[@]}")  # dpkg-dev, file: packages are made
target_packages=(                                       # tests/run.sh runs the core on other processors
  g++-arm-linux-gnueabi g++-arm-linux-gnueabihf g++-aarch64-linux-gnu qemu-user
)
microcontroller_packages=(                              # the core without an operating system
  gcc-arm-none-eabi libnewlib-arm-none-eabi libstdc++-arm-none-eabi-newlib qemu-system-arm
)
web_packages=(                                          # the library for browsers (toolchains/wasm32.cmake)
  clang-19 lld-19 libclang-rt-19-dev-wasm32 libc++-19-dev-wasm32 wasi-libc nodejs brotli
)
browser_packages=(chromium firefox-esr node-typescript)  # tests/web: the page in browsers, the types for editors
board_packages=(                                        # toolchains/board.cmake cross-builds the program
  g++-12-arm-linux-gnueabi g++-12-arm-linux-gnueabihf g++-12-aarch64-linux-gnu qemu-user
)
style_packages=(clang clang-format clang-tidy doxygen)
sanitize_packages=(clang libclang-rt-dev)
fuzz_packages=("${sanitize_packages[@]}")
driver_packages=(                                       # tests/platform boots Debian's kernels with our programs
  qemu-system-x86 kmod cpio binutils xz-utils zstd debian-archive-keyring
)
board_driver_packages=("${driver_packages[@]}" qemu-system-arm)
bench_packages=(libbenchmark-dev libceres-dev libopencv-video-dev)  # OpenCV's core and imgproc come with its video

# install_packages NAME...: those that are not installed yet. Calls apt only when one is missing, so that everything
# works without a network once it is there.
install_packages() {
  local name missing=() as_root=()
  for name in "$@"; do
    if [[ "$(dpkg-query --show --showformat='${db:Status-Status}' "$name" 2>/dev/null)" != installed ]]; then
      missing+=("$name")
    fi
  done
  ((${#missing[@]} == 0)) && return 0

  if ! command -v apt-get >/dev/null; then
    echo "error: there is no apt-get here to install what is missing. By their Debian names: ${missing[*]}" >&2
    echo "On another system, install the same by hand; README.md says how to build without this script." >&2
    return 1
  fi
  if ((EUID != 0)); then
    if ! command -v sudo >/dev/null; then
      echo "error: not root, and there is no sudo. Let root run: apt-get install ${missing[*]}" >&2
      return 1
    fi
    as_root=(sudo)
  fi
  echo "== installing (a minute or two): ${missing[*]}"
  as_root+=(env DEBIAN_FRONTEND=noninteractive)
  "${as_root[@]}" apt-get -qq update || true  # one broken source need not matter; the next line tells
  if ! "${as_root[@]}" apt-get -qq -o Dpkg::Use-Pty=0 install -y --no-install-recommends "${missing[@]}" >/dev/null; then
    echo "error: apt-get could not install: ${missing[*]}" >&2
    return 1
  fi
}
