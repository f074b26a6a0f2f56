#!/usr/bin/env bash
# Installs what the tests need, builds them and runs them: the sources' style, everything on this computer, then the core
# by another compiler with sanitizers, and on emulated ARM processors, where its instructions are counted. The last line
# is the number of tests passed, failed and skipped; the exit code is 0 when none failed.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

if [[ "${1:-}" == -h || "${1:-}" == --help ]]; then
  cat <<'HELP'
Usage: tests/run.sh [--all] [--preset NAME] [CTEST OPTIONS]
Builds the tests and runs them. On Debian it first installs the packages that are missing (as root or by sudo).
Without options the presets below, one after the other:
  style     formatting, clang-tidy, API documents   armv6     kernels, map files and budget on an emulated ARM1176
  test      everything, by gcc                      armv7     kernels, map files and bits on a Cortex-A7 with NEON
  sanitize  unit, kernel, map file, bits and API    aarch64   the same on a 64-bit Cortex-A53
            tests by clang with sanitizers          wasm      the library for browsers, by Node.js
--all: besides, the tests of sanitize by clang without them, the unit tests on every processor, the studies whole that
are otherwise sampled, in an emulated PC cameras with sanitizers, libcamera and a screen, the library as part of another
project, the web page in browsers, the core without an operating system on an emulated microcontroller (cortex-m7), and
the whole program for boards with Debian, emulated: board-arm64, board-armhf, board-armel.
With other options one preset, test if none is named; those that are not known here go to ctest:
  tests/run.sh -L unit                   only the tests of one folder: unit, kernels, map_file, budget, scenario,
                                         calibrate, cli, display, platform, examples, web
  tests/run.sh -R Pyramid                only tests whose name matches
  tests/run.sh --rerun-failed            only those that failed the last time
  tests/run.sh --preset armv6 -R OfAFrame --verbose      the table of instructions a frame
HELP
  exit 0
fi

presets=(style test sanitize armv6 armv7 aarch64 wasm) one_preset="" options=()
while (($# > 0)); do
  case "$1" in
    --all)
      export PPTAM_ALL=1
      presets=(style test clang sanitize armv6 armv7 aarch64 wasm cortex-m7 board-arm64 board-armhf board-armel)
      ;;
    --preset)
      known=" style test debug clang sanitize armv6 armv7 aarch64 wasm cortex-m7 board-arm64 board-armhf board-armel "
      if [[ "$known" != *" ${2:-none} "* ]]; then
        echo "error: --preset needs one of$known; see --help" >&2
        exit 2
      fi
      one_preset=$2
      shift
      ;;
    *) options+=("$1") ;;
  esac
  shift
done
if [[ -n "$one_preset" ]]; then
  presets=("$one_preset")
elif ((${#options[@]} > 0)); then
  presets=(test)
fi
if ((${#presets[@]} > 1)); then  # rendered by test, once for all processors: see tests/budget/kept_recording.h
  export PPTAM_RECORDINGS=$PWD/build/recordings
  rm -rf "$PPTAM_RECORDINGS"
fi
if [[ "$one_preset" == style ]] && ((${#options[@]} > 0)); then
  echo "error: --preset style takes no further options" >&2
  exit 2
fi

source toolchains/debian_packages.sh
packages=("${program_packages[@]}" "${display_packages[@]}" "${test_packages[@]}")
for preset in "${presets[@]}"; do
  case "$preset" in
    style) packages+=("${style_packages[@]}") ;;
    clang | sanitize) packages+=("${sanitize_packages[@]}") ;;
    arm* | aarch64) packages+=("${target_packages[@]}") ;;
    cortex-m7) packages+=("${microcontroller_packages[@]}") ;;
    board-*) packages+=("${board_packages[@]}") ;;
  esac
done
install_packages "${packages[@]}"
for preset in test board-armel; do
  [[ " ${presets[*]} " == *" $preset "* ]] || continue
  [[ "$preset" == test ]] && packages=("${driver_packages[@]}") || packages=("${board_driver_packages[@]}")
  install_packages "${packages[@]}" || echo "the tests on drivers of a real kernel will be skipped"
done
if [[ " ${presets[*]} " == *" test "* ]]; then
  install_packages "${window_packages[@]}" "${window_test_packages[@]}" || echo "the tests of a window will be skipped"
fi

if [[ " ${presets[*]} " == *" wasm "* && -n "${PPTAM_ALL:-}" ]]; then
  install_packages "${browser_packages[@]}" || echo "the page in a browser will be skipped"
fi

passed=0 failed=0 skipped=0
count() {  # passed, failed, skipped
  passed=$((passed + $1)) failed=$((failed + $2)) skipped=$((skipped + $3))
}

# Debian 12's versions decide: others format differently, and find other things.
check_style() {
  local format tidy
  format=$(clang-format --version 2>/dev/null | sed -nE 's/.*version ([0-9]+).*/\1/p' || true)
  tidy=$(clang-tidy --version 2>/dev/null | sed -nE 's/.*version ([0-9]+).*/\1/p' || true)
  if [[ "$format" != 14 || "$tidy" != 14 ]]; then
    echo "skipped: style is checked with version 14; clang-format is ${format:-missing}, clang-tidy ${tidy:-missing}"
    count 0 0 3
    return
  fi
  if core/docs/make.sh >/dev/null; then  # every warning is an error
    count 1 0 0
  else
    echo "FAILED: the API's documentation"
    count 0 1 0
  fi
  if find core platform sim_phone tests -name '*.h' -o -name '*.cpp' -o -name '*.js' -o -name '*.mjs' |
    xargs -d '\n' clang-format --dry-run -Werror; then
    count 1 0 0
  else
    echo "FAILED: the formatting; mend it with clang-format -i"
    count 0 1 0
  fi
  # The sources of a folder as one, so that Eigen is read once for each: see PPTAM_UNITY.
  if cmake --preset style --log-level=WARNING >/dev/null && sed -nE 's/^ *"file": "(.*)",?$/\1/p' build/style/compile_commands.json |
    xargs -d '\n' -P "$(nproc)" -n 1 clang-tidy -p build/style --quiet &>build/style/findings.log; then
    count 1 0 0
  else
    grep -vE '^[0-9]+ warnings? generated' build/style/findings.log || true
    echo "FAILED: clang-tidy"
    count 0 1 0
  fi
}

for preset in "${presets[@]}"; do
  started=$SECONDS
  if [[ "$preset" == style ]]; then
    echo "== style: checking"
    check_style
    echo "== style: $((SECONDS - started)) s"
    continue
  fi
  if [[ "$preset" == board-* ]]; then  # its results are compared with those of this computer's program
    echo "== $preset: its sysroot, and the program for this computer"
    if ! toolchains/make_sysroot.sh "${preset#board-}"; then
      echo "skipped: $preset, whose packages cannot be had"
      count 0 0 1
      continue
    fi
    cmake --preset release --log-level=WARNING >/dev/null &&
      cmake --build --preset release --parallel "$(nproc)" --target pocket-ptam || true  # missed, the test fails
    if [[ "$preset" == board-armel ]]; then  # the emulated Raspberry Pi's pictures and checks
      cmake --preset test --log-level=WARNING >/dev/null && cmake --build --preset test --parallel "$(nproc)" \
        --target pocket-ptam grey_frames frame_numbers || true  # missed, it is skipped
    fi
  fi
  if [[ "$preset" == wasm ]] && ! install_packages "${web_packages[@]}"; then
    echo "skipped: wasm, whose packages cannot be had"
    count 0 0 1
    continue
  fi
  targets=() labels=""
  case "$preset" in
    clang | sanitize)
      targets=(unit_tests kernels_tests word_kernels_tests map_file_tests bits_tests api_tests edges_tests
        kernels_fuzz map_file_fuzz c_api_fuzz c_model_fuzz)
      labels='^(unit|kernels|map_file|bits|api|edges|fuzz)$'
      [[ "$preset" != clang ]] || targets+=(pocket-ptam)
      ;;
    armv6)
      targets=(kernels_tests map_file_tests bits_tests budget_tests counted_run edges_tests code_size_core code_size_all)
      labels='^(kernels|map_file|bits|budget|edges|code_size)$'
      ;;
    cortex-m7) targets=(bare_metal code_size_core code_size_all) labels='^(bare_metal|code_size)$' ;;
    wasm) labels='^web$' ;;  # browsers only with --all
    armv7 | aarch64)
      targets=(kernels_tests map_file_tests bits_tests edges_tests code_size_core code_size_all)
      labels='^(kernels|map_file|bits|edges|code_size)$'
      ;;
  esac
  if [[ -n "${PPTAM_ALL:-}" && "$preset" =~ ^(arm|aarch) ]]; then
    targets+=(unit_tests) labels="${labels/(/(unit|}"
  elif [[ -n "${PPTAM_ALL:-}" && "$preset" == sanitize ]]; then
    targets+=(vivid_tests) labels="${labels/(/(vivid|}"
  elif [[ -n "${PPTAM_ALL:-}" && "$preset" == wasm ]]; then
    labels='^(web|browser)$'
  fi
  echo "== $preset: building"
  if ! cmake --preset "$preset" --log-level=WARNING >/dev/null ||
    ! cmake --build --preset "$preset" --parallel "$(nproc)" ${targets[@]:+--target "${targets[@]}"}; then
    echo "FAILED: $preset was not built"
    count 0 1 0
    continue
  fi
  echo "== $preset: testing"
  log="build/$preset/tests.log"
  # Not within a test's time.
  if [[ "$preset" == test ]] && ctest --preset test ${options[@]:+"${options[@]}"} -N | grep ': platform\.' >/dev/null; then
    for name in usb ${PPTAM_ALL:+libcamera}; do
      timeout 900 tests/platform/drivers.sh --fetch "$name" || echo "tests on drivers of a real kernel will be skipped"
    done
  elif [[ "$preset" == board-armel ]]; then
    timeout 900 tests/platform/drivers.sh --fetch pi || echo "the emulated Raspberry Pi will be skipped"
  fi
  ctest --preset "$preset" ${labels:+-L "$labels"} ${options[@]:+"${options[@]}"} 2>&1 | tee "$log" || true
  # ctest: "98% tests passed, 2 tests failed out of 100", in which skipped ones count as passed; nothing when it ran none.
  summary=$(grep -E '^[0-9]+% tests passed' "$log" || true)
  if [[ -z "$summary" ]]; then
    count 0 1 0
  else
    bad=$(sed -E 's/.*passed, ([0-9]+) tests failed.*/\1/' <<<"$summary")
    all=$(sed -E 's/.*out of ([0-9]+).*/\1/' <<<"$summary")
    skips=$(grep -cE '\*\*\*Skipped' "$log" || true)
    count $((all - bad - skips)) "$bad" "$skips"
  fi
  echo "== $preset: $((SECONDS - started)) s"
done
echo
echo "total: $passed passed, $failed failed, $skipped skipped"
((failed == 0))
