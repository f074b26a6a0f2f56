# Sourced by the scripts beside it: Debian's kernels and libcamera, fetched once into build/drivers and unpacked there.

drivers_dir=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)/build/drivers

skip() {
  echo "skipped: $*" >&2
  exit 77
}

# need_commands COMMAND:PACKAGE...
need_commands() {
  local entry
  for entry in "$@"; do
    PATH=$PATH:/usr/sbin:/sbin command -v "${entry%%:*}" >/dev/null ||
      skip "${entry%%:*} is missing; apt-get install ${entry#*:}"
  done
  PATH=$PATH:/usr/sbin:/sbin
}

# private_apt SUITE ARCHITECTURE COMMAND...: apt with lists of its own, so that another suite or architecture than this
# computer's, and a user who is not root, change nothing here.
private_apt() {
  local suite=$1 architecture=$2 dir=$drivers_dir/apt-$1-$2
  shift 2
  mkdir -p "$dir"/{lists/partial,cache/archives/partial}
  local signed='[signed-by=/usr/share/keyrings/debian-archive-keyring.gpg]'
  echo "deb $signed http://deb.debian.org/debian $suite main
deb $signed http://deb.debian.org/debian-security $suite-security main" >"$dir/sources.list"
  touch "$dir/status"
  local command=$1
  shift
  "$command" -qq -o APT::Architecture="$architecture" -o APT::Architectures="$architecture" -o APT::Sandbox::User= \
    -o Dir::Etc::sourcelist="$dir/sources.list" -o Dir::Etc::sourceparts=/dev/null -o Dir::State="$dir" \
    -o Dir::State::lists="$dir/lists" -o Dir::State::status="$dir/status" -o Dir::Cache="$dir/cache" "$@"
}

# fetch_packages SUITE ARCHITECTURE FOLDER NAME...: unpacks packages into the folder, without what they depend on.
fetch_packages() {
  local suite=$1 architecture=$2 folder=$3 debs=$3.debs
  shift 3
  rm -rf "$debs"
  mkdir -p "$debs"
  echo "boot.sh: fetching Debian $suite's $*" >&2
  if ! (cd "$debs" && private_apt "$suite" "$architecture" apt-get download "$@") >&2; then
    rm -rf "$debs"
    return 1
  fi
  local deb
  for deb in "$debs"/*.deb; do
    dpkg-deb -x "$deb" "$folder"
  done
  rm -rf "$debs"
}

# unpack_kernel FROM TO: without its compression, which would take an emulated processor five seconds.
unpack_kernel() {
  local magic at
  for magic in '\xFD7zXZ\x00/xz -dc --single-stream' '\x28\xB5\x2F\xFD/zstd -dcq'; do
    for at in $(LC_ALL=C grep -aobP "${magic%%/*}" "$1" | cut -d: -f1); do
      tail -c "+$((at + 1))" "$1" | ${magic#*/} >"$2" 2>/dev/null || true  # what follows it is no part of it
      if head -c 4 "$2" | grep -q ELF; then
        return
      fi
    done
  done
  echo "error: $1 is compressed in an unknown way" >&2
  return 1
}

# guest_kernel SUITE ARCHITECTURE METAPACKAGE OFFLINE: prints a folder with lib/modules, bin/busybox and vmlinux, or a
# board's vmlinuz and dtb. OFFLINE, if not empty: skips when they have not been fetched.
guest_kernel() {
  local suite=$1 architecture=$2 meta=$3 offline=$4 folder package
  folder=$drivers_dir/kernel-$suite-$architecture
  if [[ ! -e "$folder/bin" ]]; then
    [[ -z "$offline" ]] || skip "Debian $suite's kernel for $architecture is not here; tests/platform/boot.sh --fetch"
    need_commands apt-get:apt dpkg-deb:dpkg
    mkdir -p "$drivers_dir"
    rm -rf "$folder.new" "$folder"
    private_apt "$suite" "$architecture" apt-get update >&2 || true  # when it could not, the next line tells
    package=$(private_apt "$suite" "$architecture" apt-cache depends "$meta" 2>/dev/null |
      sed -nE '0,/Depends:/s/.*Depends: //p') || package=""
    [[ -n "$package" ]] || skip "the list of Debian $suite's packages for $architecture cannot be had"
    fetch_packages "$suite" "$architecture" "$folder.new" "$package" busybox-static || skip "$package cannot be had"
    if [[ "$architecture" == amd64 ]]; then
      unpack_kernel "$folder.new"/boot/vmlinuz-* "$folder.new/vmlinux"
    else
      mv "$folder.new"/boot/vmlinuz-* "$folder.new/vmlinuz"
      mv "$folder.new"/usr/lib/linux-image-*/*.dtb "$folder.new"
    fi
    mkdir -p "$folder.new"/{lib,bin}
    [[ -d "$folder.new/lib/modules" ]] || mv "$folder.new/usr/lib/modules" "$folder.new/lib"
    [[ -e "$folder.new/bin/busybox" ]] || mv "$folder.new/usr/bin/busybox" "$folder.new/bin"
    depmod -b "$folder.new" "$(ls "$folder.new/lib/modules")"
    rm -rf "$folder.new"/{boot,usr}
    mv "$folder.new" "$folder"
  fi
  echo "$folder"
}

# guest_libcamera SUITE OFFLINE: prints a folder with libcamera, its headers, and all libraries that it needs, the C
# library too: a PC's user land.
guest_libcamera() {
  local suite=$1 offline=$2 folder=$drivers_dir/libcamera-$1 deb
  if [[ ! -e "$folder" ]]; then
    [[ -z "$offline" ]] || skip "Debian $suite's libcamera is not here; tests/platform/drivers.sh --fetch libcamera"
    need_commands apt-get:apt dpkg-deb:dpkg
    rm -rf "$folder.new" "$folder.debs"
    mkdir -p "$folder.new"/usr/lib{,64} "$folder.debs/partial"
    ln -s usr/lib usr/lib64 "$folder.new"  # as Debian 13's packages have it; 12's have both
    echo "boot.sh: fetching Debian $suite's libcamera" >&2
    private_apt "$suite" amd64 apt-get update >&2 || true  # when it could not, the next line tells
    private_apt "$suite" amd64 apt-get install -y --download-only --no-install-recommends \
      -o Dir::Cache::archives="$folder.debs" libcamera-dev >&2 || skip "Debian $suite's libcamera cannot be had"
    for deb in "$folder.debs"/*.deb; do
      dpkg-deb --fsys-tarfile "$deb" | tar -x -C "$folder.new" --keep-directory-symlink --exclude=./usr/share
    done
    rm -r "$folder.debs" "$folder.new"/lib{,64}
    mkdir "$folder.new/lib64"  # where programs look for their loader
    cp -L "$folder.new/usr/lib/x86_64-linux-gnu/ld-linux-x86-64.so.2" "$folder.new/lib64/"
    mv "$folder.new" "$folder"
  fi
  echo "$folder"
}

# copy_modules KERNEL RELEASE NAME ROOT: a module and those it needs, not compressed.
copy_modules() {
  local kernel=$1 release=$2 name=$3 root=$4 list path plain
  if ! list=$(modprobe -d "$kernel" -S "$release" --show-depends "$name"); then
    echo "error: kernel $release has no module $name" >&2
    exit 2
  fi
  while read -r path; do
    plain=$root/lib/modules/$release/$(basename "${path%.xz}")
    if [[ "$path" == *.xz ]]; then
      xz -dc "$path" >"$plain"
    else
      cp "$path" "$plain"
    fi
  done < <(sed -nE 's/^insmod (.*\.ko(\.xz)?).*/\1/p' <<<"$list")
}
