#!/usr/bin/env bash
# speed.sh [TIMES]: how much longer tracking takes in Node.js than on this computer's processor, as ratios of runs that
# follow each other. Builds the library for this computer as it is released (build/speed) and without vectors
# (build/speed-plain), and takes that for browsers from preset "wasm" and the recording that tests/run.sh -R bare_metal
# makes.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

times=${1:-7} recording=build/recordings/board/desk.frames
build_native() {  # FOLDER FLAGS
  cmake -S . -B "$1" -G Ninja -D CMAKE_BUILD_TYPE=Release -D PPTAM_UNITY=ON -D PPTAM_BUILD_PROGRAM=OFF \
    -D CMAKE_CXX_FLAGS="$2" >/dev/null
  cmake --build "$1" --target pptam_core >/dev/null
  cc -O2 tests/web/time_tracking.c -Icore "$1/core/libpocket-ptam.a" -lm -o "$1/time_tracking"
}
build_native build/speed ""
build_native build/speed-plain "-DPPTAM_PLAIN -fno-tree-vectorize"
echo "of native's time: tracking, mapping; of native's without vectors: tracking, mapping;"
echo "microseconds a tracked frame: native, native without vectors, WebAssembly, pocket_ptam.js besides"
for vectors in "" _simd; do
  echo "pocket_ptam$vectors.wasm"
  for ((i = 0; i < times; ++i)); do
    read -r track map _ hash _ <<<"$(build/speed/time_tracking "$recording")"
    read -r plain_track plain_map _ plain_hash _ <<<"$(build/speed-plain/time_tracking "$recording")"
    # Compiled in full at once, as engines do by themselves after some frames.
    read -r web_track web_map _ web_hash around <<<"$(node --no-liftoff tests/web/track_time.mjs \
      "build/wasm/web/pocket_ptam$vectors.wasm" "$recording")"
    [[ "$hash" == "$web_hash" && "$hash" == "$plain_hash" ]] || { echo "FAILED: another map" && exit 1; }
    awk -v a="$track" -v b="$map" -v c="$plain_track" -v d="$plain_map" -v w="$web_track" -v m="$web_map" \
      -v e="$around" 'BEGIN { printf "%.2f %.2f  %.2f %.2f  %.0f %.0f %.0f %.0f\n", w / a, m / b, w / c, m / d, a, c, w, e }'
  done | sort -n | awk '{ lines[NR] = $0 } END {
    print "  least   " lines[1]; print "  median  " lines[int((NR + 1) / 2)]; print "  most    " lines[NR] }'
done
