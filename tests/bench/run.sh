#!/usr/bin/env bash
# Installs what the benchmarks need, builds them and runs them. The last lines printed say which targets are met.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

if [[ "${1:-}" == -h || "${1:-}" == --help ]]; then
  cat <<'HELP'
Usage: tests/bench/run.sh [--check] [GOOGLE BENCHMARK OPTIONS]
       tests/bench/run.sh --bal FILE
Builds the preset "bench" into build/bench, times each image kernel beside OpenCV's nearest function and bundle
adjustment beside Ceres (one thread, the same input, the same run) and prints the ratios. On Debian it first installs
the packages that are missing (as root or by sudo).
  --check                         exit code 1 if a target is not met; without it the exit code is 0 either way
  --bal FILE                      only the bundle: a problem of the collection "Bundle Adjustment in the Large",
                                  unpacked, in double on both sides
  --benchmark_filter=pyramid      only some of the benchmarks
  --benchmark_repetitions=31      more than the 15 short repetitions whose medians are compared
  --benchmark_out=FILE.json       all repetitions, for other programs
HELP
  exit 0
fi

source toolchains/debian_packages.sh
install_packages "${program_packages[@]}" "${bench_packages[@]}"
echo "== building"
cmake --preset bench --log-level=WARNING
cmake --build --preset bench --parallel "$(nproc)"
bundle_bench=build/bench/tests/bench/bundle_bench
if [[ ! -x "$bundle_bench" ]]; then
  echo "built without Ceres (Debian: libceres-dev): bundle adjustment is not timed" >&2
  bundle_bench=false
fi
if [[ "${1:-}" == --bal ]]; then
  exec "$bundle_bench" "$@"
fi
check=()
if [[ " $* " == *" --check "* ]]; then check=(--check); fi
result=0
echo "== timing bundle adjustment"
"$bundle_bench" "${check[@]}" || result=$?
echo "== timing image kernels"
build/bench/tests/bench/kernels_bench "$@" || result=$?
exit "$result"
