#!/usr/bin/env bash
# Tries the README's two commands on systems on which nothing is installed: Debian 12, Debian 13, Ubuntu 24.04. Each is
# made anew in a folder by debootstrap; the commands run inside of it, on a clone of this repository's last commit.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

if [[ "${1:-}" == -h || "${1:-}" == --help ]]; then
  cat <<'HELP'
Usage: tests/fresh_systems.sh [--folder DIR] [--demo-only | --make-only] [bookworm | trixie | noble]...
Makes each system (all three if none is named) in DIR/NAME [build/fresh_systems], installs nothing in it but what a
fresh one has, and runs there ./sim_phone/demo.sh and ./tests/run.sh. Needs root, a network, a few GB for each system, and hours for all.
A folder that is there already is used again; remove it to begin anew.
  --demo-only   not the tests
  --make-only   only the folders, for tests/bits/table.sh
Exit code: 0 when everything passed, 1 otherwise.
HELP
  exit 0
fi

folder=$PWD/build/fresh_systems systems=() demo_only="" make_only=""
while (($# > 0)); do
  case "$1" in
    --folder) folder=$(realpath -m "${2:?--folder needs a folder}"); shift ;;
    --demo-only) demo_only=yes ;;
    --make-only) make_only=yes ;;
    bookworm | trixie | noble) systems+=("$1") ;;
    *)
      echo "error: $1 is neither bookworm, trixie nor noble; see --help" >&2
      exit 2
      ;;
  esac
  shift
done
((${#systems[@]} > 0)) || systems=(bookworm trixie noble)
if ((EUID != 0)); then
  echo "error: making a system in a folder needs root" >&2
  exit 2
fi
source toolchains/debian_packages.sh
install_packages debootstrap git

mounted=()
unmount_all() {
  local place
  for place in "${mounted[@]}"; do umount "$place" || true; done
  mounted=()
}
trap unmount_all EXIT

make_system() {  # name, root
  local name=$1 root=$2 mirror=http://deb.debian.org/debian script=() options=()
  if [[ "$name" == noble ]]; then
    mirror=http://archive.ubuntu.com/ubuntu
    options=(--components=main,universe --no-check-gpg)  # Debian has no keys of Ubuntu's: nothing of it is kept or shipped
    script=(/usr/share/debootstrap/scripts/gutsy)        # the one script of all Ubuntus
  fi
  debootstrap --variant=minbase --include=ca-certificates "${options[@]}" "$name" "$root.part" "$mirror" "${script[@]}" \
    >"$root.log" 2>&1 || {
    tail -3 "$root.log" >&2
    return 1
  }
  mv "$root.part" "$root"
}

failed=0
mkdir -p "$folder"
for name in "${systems[@]}"; do
  root=$folder/$name
  if [[ ! -d "$root" ]]; then
    echo "== $name: making the system"
    rm -rf "$root.part"
    make_system "$name" "$root" || {
      echo "FAILED: $name was not made"
      failed=1
      continue
    }
  fi
  [[ -z "$make_only" ]] || continue
  rm -rf "$root/src"
  git clone --quiet . "$root/src"
  for place in proc dev; do
    mount --bind "/$place" "$root/$place"
    mounted+=("$root/$place")
  done
  cp /etc/resolv.conf "$root/etc/resolv.conf"
  commands=("./sim_phone/demo.sh")
  [[ -n "$demo_only" ]] || commands+=("./tests/run.sh")
  for command in "${commands[@]}"; do
    echo "== $name: $command"
    started=$SECONDS
    if chroot "$root" /usr/bin/env -i HOME=/root PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin \
      LANG=C.UTF-8 bash -c "cd /src && $command" >"$root.log" 2>&1; then
      echo "== $name: $command passed in $((SECONDS - started)) s: $(tail -1 "$root.log")"
    else
      tail -30 "$root.log"
      echo "FAILED: $name: $command; all that it said is in $root.log"
      failed=1
    fi
  done
  unmount_all
done
exit "$failed"
