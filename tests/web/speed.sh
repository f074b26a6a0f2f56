#!/usr/bin/env bash
# speed.sh [TIMES]: how much longer tracking takes in Node.js than on this computer's processor, as ratios of runs that
# follow each other. Builds the library for this computer as it is released (build/speed), and takes that for browsers
# from preset "wasm" and the recording that tests/run.sh -R bare_metal makes.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

times=${1:-7} recording=build/recordings/board/desk.frames native=build/speed
cmake -S . -B "$native" -G Ninja -D CMAKE_BUILD_TYPE=Release -D PPTAM_UNITY=ON -D PPTAM_BUILD_PROGRAM=OFF >/dev/null
cmake --build "$native" --target pptam_core >/dev/null
cc -O2 tests/web/time_tracking.c -Icore "$native/core/libpocket-ptam.a" -lm -o "$native/time_tracking"
echo "of native's time: tracking, mapping; microseconds a tracked frame: native, WebAssembly, pocket_ptam.js besides"
for vectors in "" _simd; do
  echo "pocket_ptam$vectors.wasm"
  for ((i = 0; i < times; ++i)); do
    # Compiled in full at once, as engines do by themselves after some frames.
    read -r track map _ hash _ <<<"$("$native/time_tracking" "$recording")"
    read -r web_track web_map _ web_hash around <<<"$(node --no-liftoff tests/web/track_time.mjs \
      "build/wasm/web/pocket_ptam$vectors.wasm" "$recording")"
    [[ "$hash" == "$web_hash" ]] || { echo "FAILED: another map" && exit 1; }
    awk -v a="$track" -v b="$web_track" -v c="$map" -v d="$web_map" -v e="$around" \
      'BEGIN { printf "%.2f %.2f  %.0f %.0f %.0f\n", b / a, d / c, a, b, e }'
  done | sort -n | awk '{ lines[NR] = $0 } END {
    print "  least   " lines[1]; print "  median  " lines[int((NR + 1) / 2)]; print "  most    " lines[NR] }'
done
