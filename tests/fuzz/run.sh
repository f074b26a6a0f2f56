#!/usr/bin/env bash
# Installs what the fuzz targets need, builds them with sanitizers and runs each for a while.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

if [[ "${1:-}" == -h || "${1:-}" == --help ]]; then
  cat <<'HELP'
Usage: tests/fuzz/run.sh [SECONDS] [NAME...]
Builds the preset "fuzz" (clang's libFuzzer, address and undefined-behaviour sanitizers) into build/fuzz and runs every
fuzz target, or those named (kernels, map_file, c_api, c_model, calibration, list, image, camera_image, model,
object_pose), for SECONDS (60), one after the other. They begin with what tests/fuzz/corpus holds and with what earlier
runs have found in build/fuzz/corpus. Exit code 0: nothing was found; otherwise the input that fails is named and kept. On
Debian it first installs the packages that are missing (as root or by sudo).
HELP
  exit 0
fi
seconds="${1:-60}" only=("${@:2}")
if [[ ! "$seconds" =~ ^[0-9]+$ ]]; then
  echo "error: '$seconds' is not a number of seconds; see --help" >&2
  exit 2
fi

source toolchains/debian_packages.sh
install_packages "${program_packages[@]}" "${fuzz_packages[@]}"
echo "== building"
cmake --preset fuzz --log-level=WARNING
targets=(kernels_fuzz map_file_fuzz c_api_fuzz c_model_fuzz calibration_fuzz list_fuzz image_fuzz camera_image_fuzz
  model_fuzz object_pose_fuzz)
if ((${#only[@]} > 0)); then targets=("${only[@]/%/_fuzz}"); fi
cmake --build --preset fuzz --parallel "$(nproc)" --target "${targets[@]}"
mkdir -p build/fuzz/corpus/image_fuzz build/fuzz/corpus/camera_image_fuzz
for name in a.png a.jpg a.bmp a.tif a.ppm; do
  ffmpeg -nostdin -v error -f lavfi -i testsrc=size=18x12 -frames:v 1 -y "build/fuzz/corpus/image_fuzz/$name"
done
{ printf '\002\010\005\000'; cat build/fuzz/corpus/image_fuzz/a.jpg; } >build/fuzz/corpus/camera_image_fuzz/jpeg
failed=0
for target in "${targets[@]}"; do
  echo "== $target, $seconds s"
  mkdir -p "build/fuzz/corpus/$target"
  seeds=tests/fuzz/corpus/${target%_fuzz} most=1024
  [[ "$target" != *image_fuzz ]] || most=4096
  build/fuzz/tests/fuzz/"$target" -max_total_time="$seconds" -max_len=$most -len_control=0 -print_final_stats=1 \
    -rss_limit_mb=2048 -timeout=20 -artifact_prefix="build/fuzz/$target-" "build/fuzz/corpus/$target" \
    $([[ ! -d "$seeds" ]] || echo "$seeds") &>"build/fuzz/$target.log" || failed=1
  grep -E 'ERROR|SUMMARY|Test unit|number_of_executed|new_units|peak_rss|^artifact' "build/fuzz/$target.log" || true
done
exit "$failed"
