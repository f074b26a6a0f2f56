#!/usr/bin/env bash
# Installs what the tests need, builds them and runs them: everything on this computer, then the core with another
# compiler, with sanitizers, and on emulated ARM processors, where its instructions are counted. The last line is the
# number of tests passed and failed; the exit code is 0 when none failed.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

if [[ "${1:-}" == -h || "${1:-}" == --help ]]; then
  cat <<'HELP'
Usage: tests/run.sh [--preset NAME] [CTEST OPTIONS]
Builds the tests and runs them. On Debian it first installs the packages that are missing (as root or by sudo).
Without arguments all presets, one after the other:
  test      everything, by gcc                     armv6     unit, kernel, map file and budget tests on an emulated
                                                             ARM1176
  clang     kernel and map file tests, by clang    armv7     the same on a Cortex-A7 with NEON
  sanitize  kernel and map file tests with         aarch64   the same on a 64-bit Cortex-A53
            address and undefined-behaviour sanitizers
With arguments only one preset, test if none is named. Options go to ctest:
  tests/run.sh -L unit                   only the tests of one folder: unit, kernels, map_file, budget, scenario,
                                         cli
  tests/run.sh -R Pyramid                only tests whose name matches
  tests/run.sh --rerun-failed            only those that failed the last time
  tests/run.sh --preset armv6 -R OfAFrame --verbose      the table of instructions a frame
HELP
  exit 0
fi

presets=(test clang sanitize armv6 armv7 aarch64)
if (($# > 0)); then
  presets=(test)
  if [[ "$1" == --preset ]]; then
    if [[ ! " test debug clang sanitize armv6 armv7 aarch64 " == *" ${2:-} "* ]]; then
      echo "error: --preset needs one of test, debug, clang, sanitize, armv6, armv7, aarch64; see --help" >&2
      exit 2
    fi
    presets=("$2")
    shift 2
  fi
fi

source toolchains/debian_packages.sh
if [[ "${presets[*]}" == test || "${presets[*]}" == debug || "${presets[*]}" == sanitize ]]; then
  install_packages "${program_packages[@]}" "${test_packages[@]}"
else
  install_packages "${program_packages[@]}" "${test_packages[@]}" "${target_packages[@]}"
fi

passed=0 failed=0
for preset in "${presets[@]}"; do
  targets=() labels=()
  case "$preset" in
    clang | sanitize) targets=(--target kernels_tests map_file_tests) labels=(-L 'kernels|map_file') ;;
    arm* | aarch64) targets=(--target unit_tests kernels_tests map_file_tests budget_tests) ;;
  esac
  echo "== $preset: building"
  cmake --preset "$preset" --log-level=WARNING >/dev/null
  cmake --build --preset "$preset" --parallel "$(nproc)" "${targets[@]}"
  echo "== $preset: testing"
  log="build/$preset/tests.log"
  ctest --preset "$preset" "${labels[@]}" "$@" 2>&1 | tee "$log" || true
  # ctest: "98% tests passed, 2 tests failed out of 100"; nothing when it ran none.
  summary=$(grep -E '^[0-9]+% tests passed' "$log" || true)
  if [[ -z "$summary" ]]; then
    failed=$((failed + 1))
    continue
  fi
  bad=$(sed -E 's/.*passed, ([0-9]+) tests failed.*/\1/' <<<"$summary")
  all=$(sed -E 's/.*out of ([0-9]+).*/\1/' <<<"$summary")
  passed=$((passed + all - bad))
  failed=$((failed + bad))
done
echo
echo "total: $passed passed, $failed failed"
((failed == 0))
