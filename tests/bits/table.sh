#!/usr/bin/env bash
# The same recordings on every processor and by every compiler: a table of hashes, which must all be equal. Where one
# differs, the first frame and stage that do are named.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

if [[ "${1:-}" == -h || "${1:-}" == --help ]]; then
  cat <<'HELP'
Usage: tests/bits/table.sh [--quick] [--rows REGEX] [--folder DIR]
Renders five stories of 20 s of the emulated phone, one for the desktop profile, one seen by a tiny camera, and a known
object; builds the library for each row of the table and tracks them with it. Exit code 0: all hashes are equal, and
the two controls, in which one rounding is broken on one target, were noticed. Takes some 20 minutes on two cores. On
Debian it first installs the packages that are missing (as root or by sudo).
  --quick        only what the tiny camera sees, and the known object
  --rows REGEX   only the rows whose name matches; the first row is always there, the controls only if they match
  --folder DIR   where tests/fresh_systems.sh has Debian 13, or is to make it, as root [build/fresh_systems]
What a run said is in build/bits/NAME-RECORDING.txt, a line for each frame (tests/bits/run.h). A row is a command that
builds and one that runs: see "The rows" in this script.
HELP
  exit 0
fi
wanted="" quick="" systems=$PWD/build/fresh_systems
while (($# > 0)); do
  case "$1" in
    --quick) quick=yes ;;
    --rows) wanted=${2:?--rows needs a regular expression}; shift ;;
    --folder) systems=$(realpath -m "${2:?--folder needs a folder}"); shift ;;
    *)
      echo "error: $1 is not an option; see --help" >&2
      exit 2
      ;;
  esac
  shift
done

source toolchains/debian_packages.sh
install_packages "${program_packages[@]}" "${target_packages[@]}" "${microcontroller_packages[@]}" "${web_packages[@]}" \
  clang libgtest-dev
bits=$PWD/build/bits recordings=$PWD/build/bits/recordings
mkdir -p "$recordings"

# ---- Ways to build and to run ----------------------------------------------------------------------------------------

configure() {  # SOURCE NAME CMAKE_ARGS...
  cmake -S "$1" -B "$bits/$2" -G Ninja --log-level=WARNING -D CMAKE_BUILD_TYPE=Release -D PPTAM_BUILD_PROGRAM=OFF \
    -D PPTAM_BUILD_BITS=ON -D PPTAM_INSTALL=OFF -D PPTAM_UNITY=ON "${@:3}"
}
build() {  # NAME CMAKE_ARGS...: track_recording
  configure . "$@" && cmake --build "$bits/$1" --target track_recording
}
build_preset() {  # NAME PRESET TARGET: where tests/run.sh builds it, too
  cmake --preset "$2" --log-level=WARNING && cmake --build --preset "$2" --target "$3"
}
build_trixie() {  # NAME: inside of Debian 13
  local root=$systems/trixie
  tests/fresh_systems.sh --folder "$systems" --make-only trixie
  if ! chroot "$root" sh -c 'command -v g++ cmake ninja && test -d /usr/include/eigen3' >/dev/null; then
    cp /etc/resolv.conf "$root/etc/resolv.conf"
    chroot "$root" sh -c 'apt-get -qq update; DEBIAN_FRONTEND=noninteractive apt-get -qq install -y \
      --no-install-recommends g++ cmake ninja-build libeigen3-dev >/dev/null'
  fi
  rm -rf "$root/bits"
  mkdir "$root/bits"
  tar -c --exclude=./build --exclude=./.git . | tar -x -C "$root/bits"
  chroot "$root" sh -c 'cd /bits && cmake -S . -B build -G Ninja -D CMAKE_BUILD_TYPE=Release -D PPTAM_BUILD_PROGRAM=OFF \
    -D PPTAM_BUILD_BITS=ON -D PPTAM_INSTALL=OFF -D PPTAM_UNITY=ON -D CMAKE_EXE_LINKER_FLAGS=-static &&
    cmake --build build --target track_recording'
  mkdir -p "$bits/$1/tests/bits"
  cp "$root/bits/build/tests/bits/track_recording" "$bits/$1/tests/bits/"
}
# NAME FILE FROM TO CMAKE_ARGS...: a copy of the sources in which FILE has a rounding of its own.
build_broken() {
  local source=$bits/$1-source
  rm -rf "$source"
  mkdir -p "$source"
  tar -c --exclude=./build --exclude=./.git . | tar -x -C "$source"
  sed -i "s/$3/$4/" "$source/$2"
  if cmp -s "$2" "$source/$2"; then
    echo "error: $2 has no '$3' any more: mend this control" >&2
    return 1
  fi
  configure "$source" "$1" "${@:5}" && cmake --build "$bits/$1" --target track_recording
}

run() {  # NAME RECORDING EMULATOR...
  "${@:3}" "$bits/$1/tests/bits/track_recording" "$2"
}
run_preset() {  # NAME RECORDING PRESET EMULATOR...
  "${@:4}" "build/$3/tests/bits/track_recording" "$2"
}
run_board() {  # NAME RECORDING
  qemu-system-arm -M mps2-an500 -nographic \
    -semihosting-config "enable=on,target=native,arg=bare_metal,arg=${2//,/,,}" \
    -kernel build/cortex-m7/tests/bare_metal/bare_metal.elf
}

run_web() {  # NAME RECORDING PROGRAM
  node tests/web/run_in_memory.mjs "build/wasm/tests/web/$3.wasm" "$2"
}

# ---- The rows --------------------------------------------------------------------------------------------------------

# row NAME | target | compiler | recordings | command that builds | command that prints what a recording gives
# Both commands get the row's name as their first argument, the last one the recording's file as its second.
rows=()
row() { rows+=("$1"); }
cross() { echo "-D CMAKE_TOOLCHAIN_FILE=$PWD/toolchains/$1.cmake"; }
stories="desk orbit walls shake bands"
all="$stories desktop tiny model"
set=table
if [[ -n "$quick" ]]; then all="tiny model" set=quick; fi
row "gcc|x86-64|gcc 12|$all|build|run"
row "gcc-debug|x86-64|gcc 12, Debug|$all|build -D CMAKE_BUILD_TYPE=Debug|run"
row "gcc-plain|x86-64|gcc 12, no SIMD|$all|build -D CMAKE_CXX_FLAGS='-DPPTAM_PLAIN -fno-tree-vectorize'|run"
row "gcc-O3|x86-64|gcc 12, -O3 -msse4.2|$all|build -D CMAKE_CXX_FLAGS_RELEASE='-O3 -DNDEBUG -msse4.2'|run"
row "clang|x86-64|clang 14|$all|build -D CMAKE_CXX_COMPILER=clang++-14|run"
row "clang19|x86-64|clang 19|$all|build -D CMAKE_CXX_COMPILER=clang++-19|run"
row "gcc14|x86-64|gcc 14 (Debian 13)|$all|build_trixie|run"
row "armv6|ARMv6|gcc 12|$all|build_preset armv6 track_recording|run_preset armv6 qemu-arm -cpu arm1176"
row "armv6-plain|ARMv6|gcc 12, no SIMD|desk tiny model|build $(cross armv6-linux-gnueabi) -D CMAKE_CXX_FLAGS=-DPPTAM_PLAIN|run qemu-arm -cpu arm1176"
row "armv7|ARMv7 NEON|gcc 12|$all|build_preset armv7 track_recording|run_preset armv7 qemu-arm -cpu cortex-a7"
row "aarch64|AArch64|gcc 12|$all|build_preset aarch64 track_recording|run_preset aarch64 qemu-aarch64 -cpu cortex-a53"
row "wasm|WebAssembly|clang 19|$all|build_preset wasm run_in_memory|run_web run_in_memory"
row "wasm-simd|WebAssembly|clang 19, SIMD|$all|build_preset wasm run_in_memory_simd|run_web run_in_memory_simd"
row "cortex-m7|Cortex-M7|gcc 12, bare metal|desk tiny model|build_preset cortex-m7 bare_metal|run_board"
# One rounding is another: names the stage that is expected to differ first.
row "control-pyramid|x86-64|control: pyramid|tiny|build_broken core/image/kernels_sse2.h 'two = _mm_set1_epi16(2)' 'two = _mm_set1_epi16(1)'|run"
row "control-search|AArch64|control: search|tiny|build_broken core/image/kernels_neon.h '= vrshrn_n_u32(vmlal' '= vshrn_n_u32(vmlal' $(cross aarch64-linux-gnu)|run qemu-aarch64 -cpu cortex-a53"

field() { cut -d'|' -f"$2" <<<"$1"; }
reference=$(field "${rows[0]}" 1)
chosen=()
for it in "${rows[@]}"; do
  name=$(field "$it" 1)
  [[ -n "$wanted" && "$name" != "$reference" && ! "$name" =~ $wanted ]] || chosen+=("$it")
done

# ---- Building, running -----------------------------------------------------------------------------------------------

# with NAME COMMAND ARGS...: the command with the name put first among its arguments.
with() { eval "$(field "$2" 1 | sed -E "s/^([a-z_]+)/\1 '$1'/")"; }

started=$SECONDS failed=0 jobs=()
for it in "${chosen[@]}"; do
  name=$(field "$it" 1)
  echo "== $name: building ($((SECONDS - started)) s)"
  if ! with "$name" "$(field "$it" 5)" >"$bits/$name.log" 2>&1; then
    tail -5 "$bits/$name.log"
    echo "FAILED: $name was not built; all that was said is in build/bits/$name.log"
    failed=1
    continue
  fi
  if [[ "$name" == "$reference" ]]; then
    cmake --build "$bits/$name" --target make_recordings >>"$bits/$name.log" 2>&1
    echo "== rendering ($((SECONDS - started)) s)"
    "$bits/$name/tests/bits/make_recordings" "$recordings" "$set"
  fi
  for recording in $(field "$it" 4); do
    [[ " $all " != *" $recording "* ]] || jobs+=("$name|$recording|$(field "$it" 6)")
  done
done

echo "== running ($((SECONDS - started)) s)"
run_job() {  # NAME|RECORDING|COMMAND
  local name recording command out
  IFS='|' read -r name recording command <<<"$1"
  out=$bits/$name-$recording.txt
  eval "$(sed -E "s#^([a-z_]+)#\1 '$name' '$recordings/$recording.frames'#" <<<"$command")" >"$out" 2>&1 ||
    echo "FAILED: exit code $?" >>"$out"
}
running=0
for job in "${jobs[@]}"; do
  ((running < $(nproc))) || { wait -n; running=$((running - 1)); }
  run_job "$job" &
  running=$((running + 1))
done
wait

# ---- Comparing -------------------------------------------------------------------------------------------------------

# The first stage of the first frame in which two runs differ. The size of the block depends on that of a pointer.
first_difference() {  # EXPECTED GOT
  awk 'FNR == NR { if (!/^block/) line[++count] = $0; next }
       /^block/ { next }
       { ++at
         if ($0 == line[at]) next
         split(line[at], a); split($0, b)
         for (i = 1; a[i] == b[i] && i < length(b);) ++i
         if (b[1] != "frame") { print "\"" $0 "\" in place of \"" line[at] "\""; exit }
         if (i > 2 && b[i - 1] in stage) { print "frame " b[2] ", stage " b[i - 1]; exit }
         print "frame " b[2] ": \"" $0 "\" in place of \"" line[at] "\""; exit }
       BEGIN { split("pyramid rotation corners predict search pose map", names); for (n in names) stage[names[n]] }' \
    "$1" "$2"
}
echo
printf '%-11s %-22s' target compiler
for recording in $all; do printf ' %-9s' "$recording"; done
printf '\n'
equal=0 differences=()
for it in "${chosen[@]}"; do
  name=$(field "$it" 1) same=yes
  printf '%-11s %-22s' "$(field "$it" 2)" "$(field "$it" 3)"
  for recording in $all; do
    cell=-
    if [[ " $(field "$it" 4) " == *" $recording "* ]]; then
      cell=$(sed -nE 's/.*results ([0-9a-f]{8})[0-9a-f]{8}, map.*/\1/p' "$bits/$name-$recording.txt" 2>/dev/null || true)
      difference=""
      if [[ -z "$cell" ]]; then
        cell=failed difference=$(tail -1 "$bits/$name-$recording.txt" 2>/dev/null || true)
        same=no
      fi
      [[ -n "$difference" ]] || difference=$(first_difference "$bits/$reference-$recording.txt" "$bits/$name-$recording.txt")
      if [[ -n "$difference" ]]; then
        same=no
        differences+=("$name: $recording: $difference")
      fi
    fi
    printf ' %-9s' "$cell"
  done
  printf '\n'
  if [[ "$name" == control-* ]]; then
    if [[ "${differences[-1]-}" != "$name: "*", stage ${name#control-}" ]]; then
      echo "FAILED: $name: the stage ${name#control-} was to be named"
      failed=1
    fi
  elif [[ "$same" == yes ]]; then
    equal=$((equal + 1))
  else
    failed=1
  fi
done
for difference in "${differences[@]}"; do echo "differs: $difference"; done
echo "$equal rows are equal; $((SECONDS - started)) s"
exit "$failed"
