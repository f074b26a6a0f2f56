#!/usr/bin/env bash
# The whole screen without a window system, in an emulated computer. --help says how to run it.
set -euo pipefail

usage() {
  cat <<'HELP'
Usage: tests/platform/screen.sh BUILD [--heavy]
Boots Debian's kernel, fetched before by tests/platform/boot.sh --fetch, on an emulated computer with a graphics card
(virtio-gpu) and a screen of 480x640, and shows there, drawn by Mesa's software renderer, with the programs in the
folder BUILD:
  replay of a clip that stands still before a map that knows its view: what the screen shows, as qemu has it, is what
    was drawn, also after another console had the screen and after the screen was unplugged; keys
  live   with the kernel's camera driver vivid, in colour, and a tap of the mouse
--heavy: only where PPTAM_ALL is set, as by tests/run.sh --all.
The exit code is 0 when all holds, 77 when a package or program could not be had, or it is left out; what the guest
wrote and the screen showed stays in BUILD/screen-test.
HELP
}

case "${1:-}" in
  -h | --help) usage; exit 0 ;;
  "") usage >&2; exit 2 ;;
esac
if [[ -n "${2:-}" && -z "${PPTAM_ALL:-}" ]]; then
  echo "skipped: tests/run.sh --all runs it"
  exit 77
fi
build=$(realpath "$1")
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
source "$here/../display/still_clip.sh"
libraries=/usr/lib/x86_64-linux-gnu
files=()
for needed in "$build/pocket-ptam-display.so:/bin/pocket-ptam-display.so" "$libraries/libEGL_mesa.so.0" \
  "$libraries/dri/kms_swrast_dri.so" "$libraries/dri/swrast_dri.so" "$libraries/dri/virtio_gpu_dri.so" \
  "$libraries/gbm/dri_gbm.so" /usr/share/glvnd/egl_vendor.d /etc/fonts /usr/share/fontconfig \
  /usr/share/fonts/truetype/dejavu; do
  from=${needed%%:*} to=${needed#*:}
  if [[ -e "$from" ]]; then
    files+=(--file "$from:$to")
  elif [[ "$from" != *dri_gbm.so ]]; then  # newer versions of Mesa have it
    echo "skipped: there is no $from (Debian: libegl-mesa0 libgl1-mesa-dri libgbm-dev libdrm-dev fonts-dejavu-core)"
    exit 77
  fi
done
out=$build/screen-test
rm -rf "$out"
mkdir -p "$out"

wrong=0
fail() {
  echo "FAILED: $*"
  wrong=1
}

# SCREEN NAME: what the screen shows becomes NAME.ppm. CLICK: the left button of the mouse.
cat >"$out/guest.sh" <<GUEST
until_so() {  # SECONDS COMMAND...
  tries=\$((\$1 * 5))
  shift
  while [ \$tries -gt 0 ]; do
    "\$@" >/dev/null 2>&1 && return
    usleep 200000
    tries=\$((tries - 1))
  done
  echo "in vain: \$*"
}
screen() {
  sleep 1
  echo "SCREEN \$1"
  sleep 2
}
clean() {  # any key takes a notice away
  printf v >&3
  sleep 2
  printf v >&3
}
mkfifo /work/keys
exec 3<>/work/keys
openvt -c 1 -s -- sh -c 'cd /work
  pocket-ptam replay still --show=screen --no-overlay $still_clip_options </work/keys >/out/replay.out 2>/out/replay.txt
  echo \$? >/out/replay.code'
until_so 120 grep -q 'shown on' /out/replay.txt
sleep 10
clean
screen before
printf p >&3
until_so 20 ls pocket-ptam-0001.png
cp pocket-ptam-0001.png /out
clean
screen still
chvt 2
until_so 20 grep -q 'given to another console' /out/replay.txt
screen away
chvt 1
until_so 20 grep -q 'is back' /out/replay.txt
clean
screen back
connector=\$(echo /sys/class/drm/card0-*/status)
echo off >\$connector
until_so 20 grep -q 'was unplugged' /out/replay.txt
echo on >\$connector
until_so 20 grep -q 'is plugged in' /out/replay.txt
clean
screen again
printf q >&3
until_so 30 ls /out/replay.code
screen end
openvt -c 1 -s -- sh -c 'pocket-ptam live --camera /dev/video0 --mode YUYV:640x360 --fov 60 --no-auto-start \\
  --poses none --duration 20 --show=screen </dev/null 2>/out/live.txt; echo \$? >/out/live.code'
until_so 60 grep -q 's: waiting' /out/live.txt
sleep 4
screen camera

echo CLICK
until_so 20 grep -q 'tap: the next frame' /out/live.txt
until_so 60 ls /out/live.code
GUEST

make_still_clip "$build" "$out" 600
mkfifo "$out/monitor.in" "$out/monitor.out"
cat "$out/monitor.out" >"$out/monitor.txt" &
reader=$!
trap 'kill "$reader" 2>/dev/null || true' EXIT  # it waits for ever where no emulator has begun to write
exec 9<>"$out/monitor.in"
status=0
"$here/boot.sh" --offline --memory 1500 --timeout 400 --module virtio_gpu --module evdev --module virtio_input \
  --module "vivid n_devs=1 node_types=0x1 num_inputs=1 input_types=0" --program "$build/pocket-ptam" "${files[@]}" \
  --file "$out/still" --file "$out/desk.map" --script "$out/guest.sh" --out "$out" \
  --qemu "-device virtio-gpu-pci,xres=480,yres=640 -device virtio-mouse-pci" \
  --qemu "-chardev pipe,id=monitor,path=$out/monitor -mon chardev=monitor,mode=readline" |
  while read -r line; do
    echo "$line"
    case "$line" in
      "SCREEN "*) echo "screendump $out/${line#SCREEN }.ppm" >&9 ;;
      CLICK) printf 'mouse_button 1\nmouse_button 0\n' >&9 ;;
    esac
  done || status=$?
exec 9>&-
if ((status != 0)); then
  exit "$status"
fi
cat "$out/replay.txt" "$out/live.txt"

same() {
  "$build/tests/display/same_pictures" "$@"
}
same "$out/pocket-ptam-0001.png" "$out/still.ppm" --colour 200 70 50 500 ||
  fail "the screen does not show what was drawn"
same "$out/still.ppm" "$out/away.ppm" && fail "control: another console shows the same"
same "$out/still.ppm" "$out/back.ppm" || fail "after another console had it, the screen shows something else"
same "$out/still.ppm" "$out/again.ppm" || fail "after it was unplugged, the screen shows something else"
same "$out/still.ppm" "$out/end.ppm" && fail "control: at the end the console has not got its screen back"
# The driver's test picture, bars of eight colours: of three of them, which nothing else has.
same "$out/camera.ppm" "$out/camera.ppm" --colour 190 190 10 3000 --colour 10 190 190 3000 --colour 190 10 190 3000 ||
  fail "the camera's colours are not on the screen"
[[ "$(<"$out/replay.code")" == 0 && "$(<"$out/live.code")" == 0 ]] || fail "an exit code is not 0"
grep -q 'tap: the next frame' "$out/live.txt" || fail "no tap by the mouse"
exit $wrong
