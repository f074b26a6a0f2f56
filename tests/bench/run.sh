#!/usr/bin/env bash
# Installs what the benchmarks need, builds them and runs them. The last lines printed say which targets are met.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

if [[ "${1:-}" == -h || "${1:-}" == --help ]]; then
  cat <<'HELP'
Usage: tests/bench/run.sh [--check] [GOOGLE BENCHMARK OPTIONS]
Builds the preset "bench" into build/bench, times each image kernel beside OpenCV's nearest function (one thread, the
same images, the same run) and prints the ratios. On Debian it first installs the packages that are missing (as root or
by sudo).
  --check                         exit code 1 if a target is not met; without it the exit code is 0 either way
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
cmake --build --preset bench --parallel "$(nproc)" --target kernels_bench
echo "== timing"
exec build/bench/tests/bench/kernels_bench "$@"
