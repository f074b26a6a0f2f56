#!/usr/bin/env bash
# Puts the program that has been built for a board into a folder with every library that it needs, the C library too:
# for systems that have other ones, or none of that kind.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

if [[ "${1:-}" == -h || "${1:-}" == --help ]]; then
  cat <<'HELP'
Usage: toolchains/make_board_folder.sh arm64|armhf|armel [--drivers mesa] [--build DIR] [--folder DIR]
Makes DIR [build/boards/ARCHITECTURE] of the program in --build DIR [build/board-ARCHITECTURE] and the libraries of
its sysroot. Copy the folder to the board and run DIR/pocket-ptam there: it asks for nothing but a Linux kernel of that
processor, whichever C library the system has. Videos and plots need the board's own ffmpeg and gnuplot.
--drivers mesa: with displays, overlays and Mesa's drivers for them, for graphics processors and in software: 200 MB
more. Drivers are one file by many names, hard links: copy by rsync -aH or tar, which keep them. Not for armel.
An earlier folder is replaced, unless other files were put into it.
Exit code: 0 when the folder is whole, 1 when it could not be made, 2 when asked for something unknown.
HELP
  exit 0
fi

source toolchains/boards.sh
build="" folder="" drivers=""
read_board_options "build folder drivers" "$@"
if [[ -n "$drivers" && ("$drivers" != mesa || "$architecture" == armel) ]]; then
  echo "error: --drivers knows only mesa, for arm64 and armhf; see --help" >&2
  exit 2
fi
build=${build:-build/board-$architecture}
folder=$(realpath -m "${folder:-build/boards/$architecture}")
if [[ ! -x "$build/pocket-ptam" ]]; then
  echo "error: no program in $build. Presets: cmake --preset board-$architecture, cmake --build likewise" >&2
  exit 1
fi
marker=.pocket-ptam-board  # in the folder: the list of what is in it
if [[ -e "$folder" && -n "$(ls -A "$folder")" ]]; then
  if [[ ! -f "$folder/$marker" ]]; then
    echo "error: $folder was not made by this script: move it away, or name another --folder" >&2
    exit 2
  fi
  foreign=$(cd "$folder" && find . -mindepth 1 | LC_ALL=C sort | LC_ALL=C comm -13 "$marker" - | head -n 1)
  if [[ -n "$foreign" ]]; then
    echo "error: $folder/${foreign#./} is not of the board's folder: move it away, or name another --folder" >&2
    exit 2
  fi
fi
sysroot=$(sed -n 's/^PPTAM_SYSROOT:.*=//p' "$build/CMakeCache.txt")
libraries=$sysroot/usr/lib/$triplet
if [[ ! -d "$libraries" ]]; then
  echo "error: $build was not built for $architecture: its sysroot is ${sysroot:-not told}" >&2
  exit 1
fi

# Filled under another name, so that a folder is whole or not there.
mkdir -p "$(dirname "$folder")"
part=$(mktemp -d "$folder.XXXXXX")
trap 'rm -rf "$part"' EXIT
chmod 755 "$part"
mkdir "$part/bin" "$part/lib"
cp "$build/pocket-ptam" "$part/bin"
# Modules, if there are any; those of displays are of no use without drivers that fit the folder's C library.
without=()
[[ -z "$drivers" ]] && without=(! -name 'pocket-ptam-display.so' ! -name 'pocket-ptam-window.so')
find "$build" -maxdepth 1 -name 'pocket-ptam-*.so' "${without[@]}" -exec cp -t "$part/lib" {} +
if [[ -n "$drivers" ]]; then
  if [[ ! -e "$part/lib/pocket-ptam-display.so" ]]; then
    echo "error: $build was built without displays: its sysroot is older, toolchains/make_sysroot.sh makes it anew" >&2
    exit 1
  fi
  cp -a "$libraries/dri" "$part/lib"
  [[ -d "$libraries/gbm" ]] && cp -a "$libraries/gbm" "$part/lib"
  cp -L "$libraries/libEGL_mesa.so.0" "$part/lib"
  cp "$sysroot/usr/share/glvnd/egl_vendor.d/50_mesa.json" "$part/lib"
fi
cp "$libraries"/gdk-pixbuf-2.0/*/loaders/*.so "$part/lib"  # decoders, found by name as the other libraries are
sed -E 's#^"/.*/([^/]*\.so)"#"\1"#' "$libraries"/gdk-pixbuf-2.0/*/loaders.cache >"$part/lib/loaders.cache"

shopt -s nullglob
needed=("$part/bin/pocket-ptam" "$part"/lib/*.so "$part"/lib/*.so.* "$part"/lib/{dri,gbm}/*.so)
while ((${#needed[@]} > 0)); do
  names=$("$triplet-objdump" -p "${needed[@]}" | sed -n 's/^  NEEDED *//p' | sort -u)
  needed=()
  for name in $names; do
    [[ -e "$part/lib/$name" ]] && continue
    for place in "$libraries" "$libraries/pulseaudio" "$sysroot/lib"; do
      if [[ -e "$place/$name" ]]; then
        cp -L "$place/$name" "$part/lib"
        needed+=("$part/lib/$name")
        continue 2
      fi
    done
    echo "error: $name, which the program or a library needs, is not in $sysroot" >&2
    exit 1
  done
done

# What the program itself names, by the packages that have it.
packages=$("$triplet-objdump" -p "$part/bin/pocket-ptam" | sed -n 's/^  NEEDED *//p' |
  while read -r name; do sed -n "s/^$name //p" "$sysroot/.libraries"; done | sort -u | tr '\n' ' ')
read -r suite _ <"$sysroot/.made_of"

with_drivers=""
[[ -n "$drivers" ]] && with_drivers='export __EGL_VENDOR_LIBRARY_FILENAMES="$here/lib/50_mesa.json"
export LIBGL_DRIVERS_PATH="$here/lib/dri" GBM_BACKENDS_PATH="$here/lib/gbm"'
cat >"$part/pocket-ptam" <<RUN
#!/bin/sh
# Runs bin/pocket-ptam with the libraries beside it, not those of the system; on another processor by PPTAM_EMULATOR.
here=\$(dirname "\$(readlink -f "\$0")")
export GDK_PIXBUF_MODULE_FILE="\$here/lib/loaders.cache"
$with_drivers
exec \$PPTAM_EMULATOR "\$here/lib/$loader" --library-path "\$here/lib" "\$here/bin/pocket-ptam" "\$@"
RUN
chmod 755 "$part/pocket-ptam"
touch "$part/$marker"
(cd "$part" && find . -mindepth 1 | LC_ALL=C sort >"$marker")
rm -rf "$folder"
mv "$part" "$folder"
echo "$folder: $(du -sm "$folder" | cut -f 1) MB"
echo "bin/pocket-ptam alone, on $suite, needs: $packages"
