#!/usr/bin/env bash
# Boots one of Debian's kernels in an emulated computer with a small initramfs of our programs, runs a script there and
# brings back its exit code and its files: how drivers are tested that the computer at hand may not have.
# --help says how to run it.
set -euo pipefail
shopt -s inherit_errexit

usage() {
  cat <<'HELP'
Usage: tests/platform/boot.sh [OPTIONS] --script FILE
       tests/platform/boot.sh [--machine NAME] [--suite NAME] --fetch
Boots Debian's kernel in qemu, loads modules, runs FILE by busybox's sh as root and prints what the serial console says.
Time in there is that of the instructions executed: nothing is late because this computer is slow or busy. The exit code
is the script's.
  --machine NAME       pc (x86-64, default) or raspi0 (Raspberry Pi Zero, ARM1176)
  --shift N            an instruction takes 2^N ns; 2 when not given, of raspi0 3
  --suite NAME         Debian's suite of the kernel: bookworm (default), trixie
  --module "NAME [PARAMETER=VALUE...]"   a kernel module to load at the start, with those it needs
  --carry NAME         a module that is there for the script's `modprobe NAME`
  --program FILE       goes to /bin, with the shared libraries that it needs
  --file FILE[:PATH]   a file or folder goes to PATH, or by its own name into the script's folder /work;
                       programs and modules with the shared libraries that they need
  --sysroot FOLDER     where shared libraries are taken from; this computer's when not given
  --root FOLDER        a whole user land, laid over everything else
  --out DIR            what the script writes to /out is found there afterwards, and dmesg.txt
  --memory MB          512 when not given, and always of raspi0
  --timeout SECONDS    90 when not given
  --qemu "OPTION..."   further options of qemu's, such as another device
  --fetch              only fetches the kernel
  --offline            never fetches it: without it, skips
The kernel is fetched once from Debian into build/drivers (100 MB to fetch, 0.5 GB on disk), by apt-get and without
being root.
Exit codes: 77 skipped, because a package or program could not be had; 124 time is over; 125 the computer ended without
the script's exit code; 2 wrong options; else the script's own.
Examples:
  tests/platform/boot.sh --module "vivid n_devs=1" --program build/release/pocket-ptam --script guest.sh --out out/guest
  echo 'ls /dev/video*' >guest.sh; tests/platform/boot.sh --module vivid --script guest.sh
HELP
}

machine=pc ns_shift="" suite=bookworm memory=512 seconds=90 script="" out="" root="" sysroot="" fetch="" offline=""
modules=() carried=() files=() more_computer=()
while (($# > 0)); do
  case "$1" in
    -h | --help) usage; exit 0 ;;
    --fetch) fetch=1 ;;
    --offline) offline=1 ;;
    --machine | --shift | --suite | --module | --carry | --program | --file | --sysroot | --root | --out | --memory | \
      --timeout | --qemu | --script)
      if (($# < 2)); then
        echo "error: $1 needs a value; see --help" >&2
        exit 2
      fi
      case "$1" in
        --machine) machine=$2 ;;
        --shift) ns_shift=$2 ;;
        --suite) suite=$2 ;;
        --module) modules+=("$2") ;;
        --carry) carried+=("$2") ;;
        --program) files+=("$2:/bin/${2##*/}") ;;
        --file) files+=("$2") ;;
        --sysroot) sysroot=${2%/} ;;
        --root) root=$2 ;;
        --out) out=$2 ;;
        --memory) memory=$2 ;;
        --timeout) seconds=$2 ;;
        --qemu) read -ra words <<<"$2"; more_computer+=("${words[@]}") ;;
        --script) script=$2 ;;
      esac
      shift
      ;;
    *)
      echo "error: unknown option $1; see --help" >&2
      exit 2
      ;;
  esac
  shift
done
if [[ -z "$fetch" && ! -f "$script" ]]; then
  echo "error: --script ${script:-is missing: it} must name a file that runs in the guest; see --help" >&2
  exit 2
fi
for entry in "${files[@]}"; do
  if [[ ! -e "${entry%%:*}" ]]; then
    echo "error: there is no ${entry%%:*}" >&2
    exit 2
  fi
done

here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
source "$here/guest_kernel.sh"
need_commands modprobe:kmod cpio:cpio readelf:binutils xz:xz-utils zstd:zstd
case "$machine" in
  pc)
    need_commands qemu-system-x86_64:qemu-system-x86
    kernel=$(guest_kernel "$suite" amd64 linux-image-amd64 "$offline")
    disk=vda base_modules=(virtio_pci virtio_blk)
    ;;
  raspi0)
    need_commands qemu-system-arm:qemu-system-arm
    kernel=$(guest_kernel "$suite" armel linux-image-rpi "$offline")
    disk=mmcblk0 base_modules=()
    ;;
  *)
    echo "error: --machine $machine is neither pc nor raspi0" >&2
    exit 2
    ;;
esac
if [[ -n "$fetch" ]]; then
  exit 0
fi
release=$(ls "$kernel/lib/modules")

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
initramfs="$scratch/initramfs"
mkdir -p "$initramfs"/{bin,dev,etc,proc,sys,tmp,work,out,"lib/modules/$release"}

# The shared libraries of a program or module, and of these, go where its loader looks for them.
copy_libraries() {
  local name library folder
  { readelf -ld "$1" 2>/dev/null || true; } | sed -nE 's/.*(NEEDED|interpreter).*[[ ]([^][ ]+)\].*/\2/p' |
    while read -r name; do
    name=${name##*/}
    for folder in /lib64 /lib /usr/lib /usr/local/lib {/usr,}/lib/*-linux-gnu*; do
      library=$(realpath -qe "$sysroot$folder/$name") || continue
      [[ -e "$initramfs$folder/$name" ]] && break
      mkdir -p "$initramfs$folder"
      cp "$library" "$initramfs$folder/$name"
      copy_libraries "$library"
      break
    done
  done
}

for entry in "${files[@]}"; do
  from=${entry%%:*} to=/work/${from##*/}
  [[ "$entry" == *:* ]] && to=${entry#*:}
  mkdir -p "$initramfs$(dirname "$to")"
  cp -rL "$from" "$initramfs$to"
  if [[ -f "$from" ]]; then
    copy_libraries "$from"
  fi
done
for name in "${base_modules[@]}" "${modules[@]}" "${carried[@]}"; do
  copy_modules "$kernel" "$release" "${name%% *}" "$initramfs"
done
cp "$kernel/lib/modules/$release"/modules.{order,builtin,builtin.modinfo} "$initramfs/lib/modules/$release/"
depmod -b "$initramfs" "$release"

cp "$kernel/bin/busybox" "$initramfs/bin/"
cp "$script" "$initramfs/script"
{
  cat <<'INIT'
#!/bin/busybox sh
/bin/busybox --install -s /bin
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t devtmpfs devtmpfs /dev
mkdir -p /dev/shm
export PATH=/bin:/usr/bin:/sbin:/usr/sbin HOME=/work
ip link set lo up 2>/dev/null
INIT
  for name in "${base_modules[@]}" "${modules[@]}"; do
    echo "modprobe $name || echo 'boot.sh: module $name cannot be loaded'"
  done
  cat <<INIT
cd /work
sh /script
echo \$? >/exit_code
dmesg >/out/dmesg.txt
tar -c -f /dev/$disk -C / exit_code out || echo "boot.sh: /out cannot be brought back"
sync
poweroff -f
INIT
} >"$initramfs/init"
chmod +x "$initramfs/init"
[[ -n "$root" ]] && cp -a "$root/." "$initramfs/"
(cd "$initramfs" && find . | cpio --quiet -o -H newc -R 0:0) >"$scratch/initramfs.cpio"
truncate -s 1G "$scratch/disk"

arguments="quiet loglevel=4 panic=-1 no_timer_check"
computer=(-nodefaults -no-user-config -no-reboot -display none -serial stdio -initrd "$scratch/initramfs.cpio")
case "$machine" in
  pc)  # without rdrand, as boards that have just booted: nothing may wait for random numbers
    computer=(qemu-system-x86_64 "${computer[@]}" -accel tcg -icount "shift=${ns_shift:-2},sleep=off"
      -cpu qemu64 -m "$memory" -kernel "$kernel/vmlinux" -append "console=ttyS0 tsc=reliable $arguments"
      -drive "if=virtio,format=raw,file=$scratch/disk")
    ;;
  raspi0)  # the emulated board has no such power domains
    arguments="console=ttyAMA0 initcall_blacklist=bcm2835_power_driver_init $arguments"
    computer=(qemu-system-arm "${computer[@]}" -machine raspi0 -icount "shift=${ns_shift:-3},sleep=off"
      -kernel "$kernel/vmlinuz" -dtb "$kernel/bcm2835-rpi-zero.dtb" -append "$arguments"
      -drive "if=sd,format=raw,file=$scratch/disk")
    ;;
esac
status=0
timeout --foreground "$seconds" "${computer[@]}" "${more_computer[@]}" </dev/null | stdbuf -oL tr -d '\r' ||
  status=${PIPESTATUS[0]}
if ((status == 124)); then
  echo "boot.sh: not done after $seconds s" >&2
  exit 124
fi
if ! tar -x -f "$scratch/disk" -C "$scratch" 2>/dev/null || [[ ! -f "$scratch/exit_code" ]]; then
  echo "boot.sh: the guest ended without the script's exit code (qemu's: $status)" >&2
  exit 125
fi
if [[ -n "$out" ]]; then
  mkdir -p "$out"
  cp -r "$scratch/out/." "$out/"
fi
exit "$(<"$scratch/exit_code")"
