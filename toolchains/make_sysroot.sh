#!/usr/bin/env bash
# Makes a sysroot, the folder of a board's headers and libraries that the program is cross-built against, from Debian's
# packages. apt reads its own settings in that folder and thinks it is on the board: nothing is installed on this
# computer, and no foreign architecture is added to it.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

if [[ "${1:-}" == -h || "${1:-}" == --help ]]; then
  cat <<'HELP'
Usage: toolchains/make_sysroot.sh arm64|armhf|armel [--suite bookworm|trixie] [--folder DIR]
Fills DIR [build/sysroots/ARCHITECTURE] with the packages of Debian 12 (bookworm, unless told otherwise) or 13 (trixie)
that the program needs on such a board, fetched from deb.debian.org; their lists are program_packages,
display_packages and window_packages in toolchains/debian_packages.sh. Does nothing when that has been done; begins
anew when lists, suite or architecture have changed. Installs qemu-user and Debian's keys when they are missing (as
root or by sudo).
Then: cmake --preset board-arm64 && cmake --build --preset board-arm64
Exit code: 0 when the sysroot is whole, 1 when it could not be made, 2 when asked for something unknown.
HELP
  exit 0
fi

source toolchains/boards.sh
suite=bookworm folder=""
read_board_options "suite folder" "$@"
if [[ "$suite" != bookworm && "$suite" != trixie ]]; then
  echo "error: --suite needs one of bookworm, trixie; see --help" >&2
  exit 2
fi
sysroot=$(realpath -m "${folder:-build/sysroots/$architecture}")

source toolchains/debian_packages.sh
# Of what the program needs its libraries, with Mesa's drivers: the tools run on this computer.
packages=(libc6-dev)
for name in "${program_packages[@]}" "${display_packages[@]}" "${window_packages[@]}"; do
  [[ "$name" == lib* ]] && packages+=("$name")
done
made_of="$suite $architecture ${packages[*]}"
if [[ -e "$sysroot/.made_of" && "$(<"$sysroot/.made_of")" == "$made_of" ]]; then
  echo "sysroot $sysroot is there"
  exit 0
fi
if [[ -e "$sysroot" && ! -e "$sysroot/.made_of" && -n "$(ls -A "$sysroot")" ]]; then
  echo "error: $sysroot holds other things than a sysroot: name another --folder" >&2
  exit 2
fi
install_packages qemu-user debian-archive-keyring

# Filled under another name, so that a sysroot is whole or not there.
mkdir -p "$(dirname "$sysroot")"
part=$(mktemp -d "$sysroot.XXXXXX")
trap 'rm -rf "$part"' EXIT
chmod 755 "$part"
mkdir -p "$part"/.apt/{etc/apt/{apt.conf.d,preferences.d,sources.list.d},state/lists/partial,cache/archives/partial}
apt_root=$part/.apt
touch "$apt_root/status"
keys=/usr/share/keyrings/debian-archive-keyring.gpg
cat >"$apt_root/etc/apt/sources.list" <<SOURCES
deb [signed-by=$keys] http://deb.debian.org/debian $suite main
SOURCES
apt-config dump Acquire >"$apt_root/apt.conf"  # this computer's proxy
cat >>"$apt_root/apt.conf" <<CONF
Dir::Etc "$apt_root/etc/apt";
Dir::State "$apt_root/state";
Dir::State::status "$apt_root/status";
Dir::Cache "$apt_root/cache";
APT::Architecture "$architecture";
#clear APT::Architectures;
APT::Architectures { "$architecture"; };
APT::Sandbox::User "root";
Acquire::Languages "none";
CONF
export APT_CONFIG=$apt_root/apt.conf

fail() {
  echo "error: $1; the sysroot was not made" >&2
  tail -5 "$apt_root/log" >&2
  exit 1
}
echo "== $suite for $architecture: reading Debian's lists"
apt-get -q update -o APT::Update::Error-Mode=any >"$apt_root/log" 2>&1 ||
  fail "Debian's lists could not be read (is there a network?)"
echo "== fetching packages"
apt-get -q install -y --download-only --no-install-recommends "${packages[@]}" >"$apt_root/log" 2>&1 ||
  fail "the packages could not be fetched (is there a network?)"
archives=("$apt_root"/cache/archives/*.deb)
echo "== unpacking ${#archives[@]} packages"
for directory in bin lib sbin; do  # as on every Debian since 12; else a linker script's /lib and /usr/lib differ
  mkdir -p "$part/usr/$directory"
  ln -s "usr/$directory" "$part/$directory"
done
for archive in "${archives[@]}"; do
  package=$(dpkg-deb --field "$archive" Package)
  dpkg-deb --fsys-tarfile "$archive" | tar -xv -C "$part" --keep-directory-symlink --no-same-owner \
    --exclude='./usr/share/doc*' --exclude='./usr/share/man*' --exclude='./usr/share/locale*' |
    sed -nE "s#.*/(lib[^/]*\.so\.[^/]*)\$#\1 $package#p" >>"$part/.libraries" || fail "$archive is damaged"
done

# An absolute link would lead to this computer's file.
find "$part" -type l -lname '/*' | while read -r link; do
  ln -sfn "$(realpath -ms --relative-to="$(dirname "$link")" "$part$(readlink "$link")")" "$link"
done
# The compiler's own may be newer than the board's: see board.cmake.
ln -s libstdc++.so.6 "$part/usr/lib/$triplet/libstdc++.so"
# What the package's installation would do: images are decoded by plugins, which this file lists by their paths there.
loaders=/usr/lib/$triplet/gdk-pixbuf-2.0
"$emulator" -L "$part" "$part$loaders/gdk-pixbuf-query-loaders" "$part$loaders"/*/loaders/*.so 2>"$apt_root/log" |
  sed "s|$part||" >"$part/loaders.cache" || fail "gdk-pixbuf's list of decoders was not made"
mv "$part/loaders.cache" "$(echo "$part$loaders"/*/)"
rm -rf "$apt_root"
echo "$made_of" >"$part/.made_of"
rm -rf "$sysroot"
mv "$part" "$sysroot"
echo "sysroot $sysroot: $suite for $architecture, $(du -sm "$sysroot" | cut -f 1) MB"
