#!/usr/bin/env bash
# Installs what the fuzz targets need, builds them with sanitizers and runs each for a while.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

if [[ "${1:-}" == -h || "${1:-}" == --help ]]; then
  cat <<'HELP'
Usage: tests/fuzz/run.sh [SECONDS]
Builds the preset "fuzz" (clang's libFuzzer, address and undefined-behaviour sanitizers) into build/fuzz and runs every
fuzz target for SECONDS (60). Exit code 0: nothing was found; otherwise the input that fails is named and kept. On
Debian it first installs the packages that are missing (as root or by sudo).
HELP
  exit 0
fi
seconds="${1:-60}"
if [[ ! "$seconds" =~ ^[0-9]+$ ]]; then
  echo "error: '$seconds' is not a number of seconds; see --help" >&2
  exit 2
fi

source toolchains/debian_packages.sh
install_packages "${program_packages[@]}" "${fuzz_packages[@]}"
echo "== building"
cmake --preset fuzz --log-level=WARNING
targets=(kernels_fuzz map_file_fuzz c_api_fuzz)
cmake --build --preset fuzz --parallel "$(nproc)" --target "${targets[@]}"
for target in "${targets[@]}"; do
  echo "== $target, $seconds s"
  mkdir -p "build/fuzz/corpus/$target"
  build/fuzz/tests/fuzz/"$target" -max_total_time="$seconds" -max_len=1024 -len_control=0 -print_final_stats=1 \
    -artifact_prefix="build/fuzz/$target-" "build/fuzz/corpus/$target" 2>&1 | tail -n 12
done
