#!/usr/bin/env bash
# The library in the hands of others: examples.sh STEP BUILD FOLDER. The steps install what BUILD has made into
# FOLDER/usr, and build and run the examples against that copy alone. They must give the poses and the map of the
# program, from a sequence that it has dumped. Exit code 77: what the step needs is not here.
set -euo pipefail

step=$1 build=$(realpath "$2") folder=$3
here=$(realpath "$(dirname "${BASH_SOURCE[0]}")")
mkdir -p "$folder"
folder=$(realpath "$folder")
usr=$folder/usr
library=$(find "$usr" -name 'libpocket-ptam.a' -printf '%h' 2>/dev/null || true)  # its folder
export PKG_CONFIG_PATH=$library/pkgconfig LD_LIBRARY_PATH=$library

fail() {
  echo "FAILED: $*" >&2
  exit 1
}

# track COMMAND...: an example on the sequence, its poses in $folder/NAME.txt, the map's hash in $folder/NAME.hash
track() {
  local name=$1
  shift
  "$@" "$folder/camera.txt" "$folder/times.txt" <"$folder/frames.grey" >"$folder/$name.txt" 2>"$folder/$name.hash" ||
    fail "$(cat "$folder/$name.hash")"
}

# The program writes the inverse of a float pose with the rounding of doubles: an example's is a few roundings of 6e-8
# away. The map's hash is of every bit.
same_as_program() {
  paste -d ' ' <(grep -v '^#' "$folder/out/trajectory.txt") "$folder/$1.txt" | awk '
    NF != 16 || ($1 - $9) ^ 2 > 1e-8 ^ 2 { print "line " NR ": " $0; bad = 1; exit }
    { for (i = 2; i <= 8; ++i) if (($i - $(i + 8)) ^ 2 > 2e-6 ^ 2) { print "line " NR ": " $0; bad = 1; exit } }
    END { exit bad || NR < 20 }' || return 1
  [[ "$(cat "$folder/$1.hash")" == "map hash $(cat "$folder/program.hash")" ]]
}

case "$step" in
  install)
    rm -rf "$usr"
    cmake --install "$build" --prefix "$usr" --component library >/dev/null
    cmake --install "$build" --prefix "$usr" --component development >/dev/null
    shared=$(find "$usr" -name 'libpocket-ptam.so.*.*')
    readelf -d "$shared" | grep -q 'SONAME.*\[libpocket-ptam\.so\.[0-9]*\]' || fail "no versioned soname"
    needed=$(readelf -d "$shared" | sed -nE 's/.*NEEDED.*\[(.*)\]/\1/p' | grep -vE '^(libc|ld-linux.*)\.so' || true)
    [[ -z "$needed" ]] || fail "the shared library needs $needed"
    if nm -D --undefined-only "$shared" | grep -wE 'malloc|calloc|realloc|free|printf'; then
      fail "the library has what the core must not need"
    fi
    diff <(sed -nE 's/^PPTAM_API .*[ *](pptam_[a-z_]+)\(.*/\1/p' "$usr/include/pocket_ptam/pocket_ptam_c.h" | sort) \
      <(nm -D --defined-only "$shared" | awk '$2 == "T" { sub(/@.*/, "", $3); print $3 }' | sort) ||
      fail "the shared library does not show the functions of pocket_ptam_c.h, or others too"
    if nm -D --defined-only "$shared" | grep -v ' [TA] '; then fail "the shared library shows more than functions"; fi
    ;;
  sequence)
    rm -rf "$folder/sequence" "$folder/out"
    "$build/pocket-ptam" sim --scene boxes --seed 7 --duration 5 --dump "$folder/sequence" &>"$folder/dump.log"
    calibration=$folder/sequence/calibration.yaml
    "$build/pocket-ptam" replay "$folder/sequence" --calibration "$calibration" --out "$folder/out" --no-overlay \
      2>"$folder/replay.log" | sed -nE 's/^map hash +//p' >"$folder/program.hash"
    ffmpeg -v error -y -pattern_type glob -i "$folder/sequence/rgb/*.png" -f rawvideo -pix_fmt gray "$folder/frames.grey"
    sed -nE 's/^([0-9.]+) .*/\1/p' "$folder/sequence/rgb.txt" >"$folder/times.txt"
    # The emulated phone has no distortion, and exposes one column after the other.
    sed -nE 's/^ +(intrinsics|resolution|readout_s|readout_direction|exposure_s): *(.*)/\1 \2/p' "$calibration" |
      tr -d '[],' | awk '{ for (i = 2; i <= NF; ++i) v[$1, i] = $i }
      END { print v["resolution", 2], v["resolution", 3], v["intrinsics", 2], v["intrinsics", 3], v["intrinsics", 4],
                  v["intrinsics", 5], 1,
                  sprintf("%.17g", v["readout_direction", 2] * v["readout_s", 2] / v["resolution", 2]),
                  v["exposure_s", 2] }' >"$folder/camera.txt"
    ;;
  c)
    # As anybody would; then with all that a C compiler can find to say; then without the shared library.
    cc "$here/example.c" $(pkg-config --cflags --libs pocket-ptam) -o "$folder/example_c"
    track c "$folder/example_c"
    same_as_program c || fail "the C example has other poses or another map than the program"
    cc -std=c99 -pedantic -Wall -Wextra -Wconversion -Werror -fsyntax-only $(pkg-config --cflags pocket-ptam) \
      "$here/example.c"
    cc "$here/example.c" -I"$usr/include" "$library/libpocket-ptam.a" -lm -o "$folder/example_static"
    track static "$folder/example_static"
    same_as_program static || fail "the static library has other poses or another map than the program"
    # The one that reads a camera is compiled; run, it says that this is none.
    cc -Wall -Wextra -Werror "$here/example_v4l2.c" $(pkg-config --cflags --libs pocket-ptam) -lm \
      -o "$folder/example_v4l2"
    if "$folder/example_v4l2" /dev/null 60 2>"$folder/v4l2.txt"; then fail "/dev/null was taken for a camera"; fi
    grep -q 'no video camera' "$folder/v4l2.txt" || fail "$(cat "$folder/v4l2.txt")"
    # The comparison can fail: another focal length, 1 % longer.
    awk '{ $3 *= 1.01; $4 *= 1.01; print }' "$folder/camera.txt" >"$folder/camera_control.txt"
    "$folder/example_c" "$folder/camera_control.txt" "$folder/times.txt" <"$folder/frames.grey" \
      >"$folder/control.txt" 2>"$folder/control.hash"
    if same_as_program control >/dev/null; then fail "another camera gives the same poses: nothing is compared"; fi
    ;;
  cmake)
    for language in C CXX; do
      rm -rf "$folder/cmake_$language"
      cmake -S "$here/cmake_project" -B "$folder/cmake_$language" -D EXAMPLE_LANGUAGE=$language \
        -D CMAKE_PREFIX_PATH="$usr" -D CMAKE_BUILD_TYPE=Release --log-level=WARNING >/dev/null
      cmake --build "$folder/cmake_$language" >/dev/null
      track "cmake_$language" "$folder/cmake_$language/example"
      same_as_program "cmake_$language" || fail "the $language example has other poses or another map than the program"
    done
    ;;
  python)
    python3 -c 'import ctypes' 2>/dev/null || exit 77
    track python python3 "$here/example.py" "$(find "$usr" -name 'libpocket-ptam.so.[0-9]')"
    same_as_program python || fail "the Python example has other poses or another map than the program"
    ;;
  subproject)
    rm -rf "$folder/subproject"
    cmake -S "$here/subproject" -B "$folder/subproject" -G Ninja -D POCKET_PTAM="$here/../.." \
      -D CMAKE_BUILD_TYPE=Release -D CMAKE_EXPORT_COMPILE_COMMANDS=ON --log-level=WARNING >/dev/null
    commands=$folder/subproject/compile_commands.json
    command_of() { grep "\"command\".*/$1\"" "$commands" || fail "$1 is not compiled"; }
    if command_of example.c | grep -e EIGEN -e contract -e -std -e isystem; then
      fail "the C interface gives its users options"
    fi
    command_of example.cpp | grep -q EIGEN_DONT_VECTORIZE || fail "the C++ interface lacks an option"
    command_of system.cpp | grep -q -e EMBEDDERS_OWN_FLAG || fail "the embedder's flags do not hold in the library"
    if grep -e vect-cost-model -e Wshadow "$commands"; then fail "the library has flags of its own"; fi
    if grep '"file"' "$commands" | grep -vq '/core/\|example'; then fail "more than the library is built"; fi
    [[ -z "${PPTAM_ALL:-}" ]] && exit 0  # building the core takes minutes
    cmake --build "$folder/subproject" >/dev/null
    for language in c cpp; do
      track "subproject_$language" "$folder/subproject/example_$language"
      same_as_program "subproject_$language" || fail "the subproject's $language example has other poses or another map"
    done
    ;;
  packages)
    command -v dpkg-shlibdeps >/dev/null || exit 77
    rm -rf "$folder/packages"
    mkdir "$folder/packages"
    (cd "$folder/packages" && cpack -G DEB --config "$build/CPackConfig.cmake" &>log) ||
      fail "$(cat "$folder/packages/log")"
    for package in libpocket-ptam[0-9] libpocket-ptam-dev pocket-ptam; do
      deb=$(ls "$folder"/packages/${package}_*.deb)
      dpkg-deb --extract "$deb" "$folder/packages/root"
      echo "$(basename "$deb") depends on $(dpkg-deb --field "$deb" Depends)"
    done
    dpkg-deb --field "$folder"/packages/libpocket-ptam-dev_*.deb Depends | grep -q '^libpocket-ptam[0-9]* (= ' ||
      fail "the development package does not name its library"
    root=$folder/packages/root/usr
    export PKG_CONFIG_PATH=$(find "$root" -name pkgconfig)
    export LD_LIBRARY_PATH=$(dirname "$PKG_CONFIG_PATH")
    cc "$here/example.c" $(pkg-config --cflags --libs pocket-ptam) -o "$folder/example_packaged"
    track packaged "$folder/example_packaged"
    same_as_program packaged || fail "the packaged library has other poses or another map than the program"
    "$root/bin/pocket-ptam" --version
    ;;
  *) fail "no such step: $step" ;;
esac
