#!/usr/bin/env bash
# Our cameras on drivers of a real kernel, in an emulated computer. --help says how to run it.
set -euo pipefail

usage() {
  cat <<'HELP'
Usage: tests/platform/drivers.sh vivid|usb|libcamera|pi|pi-replay BUILD
       tests/platform/drivers.sh --fetch vivid|usb|libcamera|pi|pi-replay
Boots Debian's kernel in an emulated computer with the programs in the folder BUILD, such as build/test:
  vivid      our V4L2 camera on the driver vivid: formats, sizes, times, and every fault that vivid can inject
  usb        a USB camera by uvcvideo: all its formats; then pocket-ptam live, to which it shows the emulated phone's
             desk at 320x240, 15 Hz, while it is pulled out and plugged in again: pixels, accuracy, ages, recording
  libcamera  pocket-ptam live by libcamera of Debian 12 and 13, on their kernels: the USB camera; and pictures of the
             desk that 13's pipeline "virtual" shows
  pi         as usb on an emulated Raspberry Pi Zero, with the program in build/board-armel; BUILD is this computer's
  pi-replay  20 s of the emulated phone's desk, as images, on the same: replayed at their own rate by that kernel's
             clock, no frame may be dropped; twice, and the logs must be the same but for times
--fetch: fetches Debian's kernel, and libcamera, for one of these.
The exit code is 0 when all holds, 77 when a package or program could not be had; what the guest wrote stays in
BUILD/drivers-NAME.
HELP
}

here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
source "$here/guest_kernel.sh"
if [[ "${1:-}" == -h || "${1:-}" == --help ]]; then
  usage
  exit 0
fi
if (($# != 2)); then
  usage >&2
  exit 2
fi
# Programs of a newer system do not run on Debian 12's C library.
libcamera_suites() {
  [[ "$(. /etc/os-release && echo "${VERSION_ID:-}")" != 12 ]] || echo bookworm
  echo trixie
}

if [[ "$1" == --fetch ]]; then
  case "$2" in
    libcamera)
      for suite in $(libcamera_suites); do
        "$here/boot.sh" --suite "$suite" --fetch
        guest_libcamera "$suite" "" >/dev/null
      done
      ;;
    pi | pi-replay) "$here/boot.sh" --machine raspi0 --fetch ;;
    vivid | usb) "$here/boot.sh" --fetch ;;
    *)
      echo "error: $2 is neither vivid, usb, libcamera, pi nor pi-replay; see --help" >&2
      exit 2
      ;;
  esac
  exit
fi
name=$1 build=$(realpath "$2")
programs=$build/tests/platform
out=$build/drivers-$name
rm -rf "$out"
mkdir -p "$out"

wrong=0
fail() {
  echo "FAILED: $*"
  wrong=1
}

test_vivid() {
  echo 'vivid_tests --gtest_color=no' >"$out/guest.sh"
  "$here/boot.sh" --offline --module "vivid n_devs=1 node_types=0x1 num_inputs=1 input_types=0" \
    --program "$programs/vivid_tests" --script "$out/guest.sh" --out "$out"
}

frames=180 pulled_after=110

# render SIM_OPTION...: the clip.
render() {
  "$build/pocket-ptam" sim "$@" --dump "$out/clip" >"$out/clip.txt" 2>&1 || { cat "$out/clip.txt"; exit 1; }
}

# What the camera shows: the clip lies on its side there, as on the phone's sensor, and live turns it upright.
make_clip() {
  render --duration $((frames / 15))
  "$programs/grey_frames" 270 "$out/clip" "$out/sent.grey"
  "$programs/grey_frames" 0 "$out/clip" "$out/upright.grey"
}

# plug LOG OPTION...: all frames are sent in order; those that come while the program is busy are dropped.
plug='plug() {
  log=$1
  shift
  usb_camera "$@" sent.grey >$log 2>&1 &
  camera=$!
  for i in $(seq 100); do
    [ -e /dev/video0 ] && return
    usleep 100000
  done
}'

# On standard input: what comes first.
write_guest_script() {
  cat >"$out/guest.sh" <<GUEST
$plug
$(cat)
plug /out/camera.txt --count $pulled_after
pocket-ptam cameras 2>&1
timeout -s INT 60 pocket-ptam live --mode YUYV:320x240 --calibration sent.grey.yaml --rotate 90 --exposure 0.03 \\
  --record /out/recording >/out/poses.txt 2>/out/live.txt &
live=\$!
wait \$camera || exit 1
sleep 1
plug /out/camera_again.txt --first $pulled_after --broken-every 30
wait \$camera || exit 1
sleep 1
kill -INT \$live
wait \$live
GUEST
}

# Which frame of the clip each recorded one is: "TIME NUMBER DIFFERENCE NEXT", see frame_numbers. The control: another
# frame differs.
number_frames() {
  local most=$1  # difference, grey levels
  "$programs/frame_numbers" "$out/upright.grey" "$out/recording" >"$out/numbers.txt"
  awk -v most="$most" '$3 > most {wrong = 1} END {exit wrong}' "$out/numbers.txt" || fail "frames with other pixels"
  awk -v most="$most" '$4 <= most {wrong = 1} END {exit wrong}' "$out/numbers.txt" ||
    fail "frames that cannot be told from the next one"
}

# What the clip's frames that were tracked live give when mapping has all the time that it wants.
track_at_leisure() {
  cp -r "$out/clip" "$out/leisure"
  awk 'FILENAME ~ /numbers.txt$/ {tracked[$2] = 1; next} /^#/ || ++number in tracked' \
    "$out/numbers.txt" "$out/clip/rgb.txt" >"$out/leisure/rgb.txt"
  "$build/pocket-ptam" replay "$out/leisure" --calibration "$out/clip/calibration.yaml" --auto-start --no-overlay \
    --no-report --out "$out/reference" >"$out/reference.txt" 2>&1 ||
    { cat "$out/reference.txt"; fail "the same frames cannot be replayed"; }
}

# count_lines GREP_OPTION...: 0, too, is no failure, nor is a file that is missing because something before has failed.
count_lines() {
  grep -c "$@" || true
}

check_frames() {
  local sent tracked gaps left_out poses leisure_poses
  sent=$(cat "$out/camera.txt" "$out/camera_again.txt" | count_lines '^frame .*[0-9]$')  # the others are erroneous
  tracked=$(wc -l <"$out/numbers.txt")
  gaps=$(awk -v pulled=$pulled_after 'last && (last <= pulled) == ($2 <= pulled) {sum += $2 - last - 1} {last = $2}
    END {print sum + 0}' "$out/numbers.txt")
  left_out=$(awk '$1 == "frames" && $3 == "tracked" {sum = $10 + $15 + $17} END {print sum + 0}' "$out/live.txt")
  poses=$(wc -l <"$out/poses.txt") leisure_poses=$(count_lines -v '^#' "$out/reference/trajectory.txt")
  echo "$sent frames sent, $tracked tracked, $gaps missing between them, $left_out told;" \
    "$poses poses, at leisure $leisure_poses"
  awk '$2 <= last {wrong = 1} {last = $2} END {exit wrong}' "$out/numbers.txt" || fail "frames out of order"
  awk -v pulled=$pulled_after '$2 > pulled && ($2 - pulled) % 30 == 0 {wrong = 1} END {exit wrong}' \
    "$out/numbers.txt" || fail "an erroneous frame was tracked"
  # Those before a start's first one, and in the driver's buffers when it is pulled out, are not between tracked ones.
  ((gaps <= left_out)) || fail "$gaps frames are missing between tracked ones, of which only $left_out are told"
  ((tracked >= sent * 5 / 6)) || fail "of $sent frames only $tracked were tracked"
  ((poses >= leisure_poses * 5 / 6 && poses > 0)) ||
    fail "$poses poses where the same frames at leisure give $leisure_poses"
  grep -q 'tracking at the end' "$out/live.txt" || fail "it does not track at the end"
}

check_return() {
  local plugged back
  plugged=$(sed -nE 's/^\[ *([0-9.]+)\].*Found UVC.*/\1/p' "$out/dmesg.txt" | tail -1)  # CLOCK_MONOTONIC but for ms
  back=$(awk -v after="$plugged" '$1 > after {print $1; exit}' "$out/numbers.txt")
  echo "first frame ${back:-none}, found again by the kernel at $plugged s"
  awk -v from="$plugged" -v to="${back:-1e18}" 'BEGIN {exit !(to - from < 2)}' || fail "it goes on 2 s later or more"
  grep -q 'waiting for it to come back' "$out/live.txt" || fail "it is not told that the camera was pulled out"
  grep -q 'is back' "$out/live.txt" || fail "it is not told that the camera is back"
}

check_recording() {
  "$build/pocket-ptam" replay "$out/recording" --no-overlay --no-report --out "$out/replayed" \
    >"$out/replayed.txt" 2>&1 ||
    { cat "$out/replayed.txt"; fail "the recording cannot be replayed"; return; }
  grep -q 'the same bits as in the live run' "$out/replayed.txt" || fail "the recording's replay has other bits"
  grep -v '^#' "$out/replayed/trajectory.txt" | cmp - "$out/poses.txt" || fail "the recording's replay has other poses"
}

# The truth is known at the times of the clip. What is looked for are frames with wrong times: the control is a path
# three frames late. By half a frame, a sixth of the control's error, the live path may be worse than the same frames at
# leisure.
check_path() {
  awk '!/^#/ {print $1}' "$out/clip/rgb.txt" >"$out/clip.times"
  awk 'FILENAME ~ /clip.times$/ {clip[FNR] = $1; next}
       FILENAME ~ /numbers.txt$/ {time[$1] = clip[$2]; next}
       {$1 = time[$1]; print}' "$out/clip.times" "$out/numbers.txt" "$out/poses.txt" >"$out/trajectory.txt"
  awk '{$1 = sprintf("%.9f", $1 + 0.2); print}' "$out/trajectory.txt" >"$out/late.txt"  # the control
  local error leisure late
  error=$(error_of "$out/trajectory.txt") leisure=$(error_of "$out/reference/trajectory.txt")
  late=$(error_of "$out/late.txt")
  echo "error of the path: $error %, at leisure $leisure %, three frames late $late %"
  awk -v error="$error" -v least="$leisure" -v late="$late" 'function right(e) {return e > 0 && e < least + late / 6}
    BEGIN {exit !(right(error) && !right(late))}' || fail "the path is wrong, or a late one passes for right"
}

# In % of the path; 0 when there is none.
error_of() {
  { "$build/pocket-ptam" eval "$1" "$out/clip/groundtruth.txt" || true; } |
    awk '/trajectory error/ {e = $3} END {print e + 0}'
}

check_ages() {
  local worst
  worst=$(sed -nE 's/^age of a pose .* ([0-9.]+) at worst.*/\1/p' "$out/live.txt")
  awk -v worst="${worst:-1e9}" 'BEGIN {exit !(worst <= 1000 / 15)}' || fail "a pose is older than a frame's period"
}

# live_with_usb PROGRAM CAMERA [BOOT OPTION...]: standard input as write_guest_script's.
live_with_usb() {
  local program=$1 camera=$2
  shift 2
  make_clip
  write_guest_script
  "$here/boot.sh" --offline --module vhci_hcd --module uvcvideo --program "$program" --program "$camera" \
    --file "$out/sent.grey" --file "$out/sent.grey.yaml" --script "$out/guest.sh" --out "$out" "$@"
  cat "$out/live.txt"
  number_frames 0
  track_at_leisure
  check_frames
  check_return
  check_ages
  check_recording
  check_path
}

test_usb() {
  live_with_usb "$build/pocket-ptam" "$programs/usb_camera" --program "$programs/usb_tests" <<'GUEST'
plug /out/camera_formats.txt
PPTAM_SENT=sent.grey usb_tests --gtest_color=no 2>&1 || exit 1
kill $camera
wait $camera
while [ -e /dev/video0 ]; do usleep 10000; done
GUEST
}

board=$here/../../build/board-armel

# need_built FILE...: programs, by both presets.
need_built() {
  local file
  for file in "$@"; do
    [[ -x "$file" ]] || skip "$file has not been built: tests/run.sh --preset board-armel, and tests/run.sh -L platform"
  done
}

test_pi() {
  need_built "$board/pocket-ptam" "$board/tests/boards/usb_camera" "$build/pocket-ptam" "$programs/frame_numbers"
  live_with_usb "$board/pocket-ptam" "$board/tests/boards/usb_camera" --machine raspi0 \
    --sysroot "$here/../../build/sysroots/armel" </dev/null
}

# column FILE NAME: of a frames.csv.
column() {
  awk -F, -v name="$2" 'NR == 1 {for (i = 1; i <= NF; ++i) if ($i == name) at = i; next} {print $at}' "$1"
}

# replay_on_pi RUN: one boot; what replay says and writes is in $out/RUN. The control in it are the same images at four
# times their rate.
replay_on_pi() {
  mkdir "$out/$1"
  cat >"$out/guest.sh" <<'GUEST'
echo 0 >/proc/sys/kernel/randomize_va_space  # where memory lies would decide how long it takes to copy some
replay() {
  name=$1
  shift
  folder/pocket-ptam replay "$@" --calibration clip/calibration.yaml --clock steady --no-overlay --no-report \
    --out /out/$name >/out/$name.txt 2>&1
}
replay desk clip || exit 1
mkdir fast
awk '/^#/ {print; next} {printf "%.9f ../clip/%s\n", $1 / 4, $2}' clip/rgb.txt >fast/rgb.txt
replay fast fast
GUEST
  "$here/boot.sh" --offline --machine raspi0 --timeout 300 --file "$board/folder" --file "$out/clip" \
    --script "$out/guest.sh" --out "$out/$1" || { cat "$out/$1"/*.txt; exit 1; }
}

# log_of RUN: what is the same in each boot: path, map, and all that is told of frames but times, which differ by some
# microseconds.
log_of() {
  cat "$1"/desk/{trajectory.txt,keyframes.txt,map.ply}
  awk -F, 'NR == 1 {for (i = 1; i <= NF; ++i) timed[i] = $i ~ /_us$/}
    {for (i = 1; i <= NF; ++i) if (!timed[i]) printf "%s,", $i; print ""}' "$1/desk/frames.csv"
  grep -v ' ms' "$1/desk.txt"
}

test_pi_replay() {
  [[ -n "${PPTAM_ALL:-}" ]] || skip "tests/run.sh --all runs it, or PPTAM_ALL=1 tests/platform/drivers.sh"
  need_built "$board/folder/pocket-ptam" "$build/pocket-ptam"
  render --duration 20
  # As raw pixels: to decode a PNG takes that processor longer than a frame's period.
  local time png number=0
  while read -r time png; do
    mv "$out/clip/$png" "$out/clip/rgb/$((++number)).png"
    echo "$time $number.pgm"
  done < <(grep -v '^#' "$out/clip/rgb.txt") >"$out/clip/pgm.txt"
  ffmpeg -nostdin -loglevel error -i "$out/clip/rgb/%d.png" "$out/clip/%d.pgm"
  mv "$out/clip/pgm.txt" "$out/clip/rgb.txt"
  rm -r "$out/clip/rgb"
  local run first=$out/first
  for run in first second; do replay_on_pi $run; done
  cat "$first/desk.txt"
  local images dropped control keyframes
  images=$(grep -vc '^#' "$out/clip/rgb.txt")
  dropped=$(sed -nE 's/^frames .* ([0-9]+) dropped.*/\1/p' "$first/desk.txt")
  control=$(sed -nE 's/^frames .* ([0-9]+) dropped.*/\1/p' "$first/fast.txt")
  keyframes=$(column "$first/desk/frames.csv" keyframes | tail -1)
  echo "$images images, ${dropped:-unknown} dropped; at four times the rate ${control:-unknown}"
  echo "a frame in ms: mean, 99 %, worst; mapping; idle: $(for name in track_us mapping_us idle_us; do
    column "$first/desk/frames.csv" $name | sort -n | awk '{v[NR] = $1 / 1000; sum += v[NR]}
      END {printf "%.1f, %.1f, %.1f; ", sum / NR, v[int(0.99 * NR + 0.999)], v[NR]}'
  done)"
  [[ "$dropped" == 0 ]] || fail "frames were dropped"
  ((${control:-0} > 0)) || fail "control: at four times the rate none is dropped"
  ((keyframes >= 5)) || fail "the map has ${keyframes:-no} keyframes: nothing was mapped beside"
  grep -q '^tracked since then  *100.0 %' "$first/desk.txt" || fail "frames without a pose"
  awk '/^trajectory error/ && $3 < 1 {right = 1} END {exit !right}' "$first/desk.txt" || fail "the path is wrong"
  diff <(log_of "$first") <(log_of "$out/second") || fail "the second boot gives another log"
}

# libcamera's pipeline "virtual" reads JPEGs when it starts and shows each four times, as fast as they are asked for: a
# walk to and fro, so that there is no jump at the end.
make_pictures() {
  local count=180 i
  render --fps 36 --readout rows:+:0 --exposure 0.01 --duration $((count / 36))
  mkdir "$out/clip/frames" "$out/pictures"
  ffmpeg -loglevel error -pattern_type glob -i "$out/clip/rgb/*.png" -vf format=gray,format=yuvj420p -qmin 1 -q:v 1 \
    "$out/clip/frames/%04d.jpg"
  awk '!/^#/ {printf "%s frames/%04d.jpg\n", $1, ++number}' "$out/clip/rgb.txt" >"$out/clip/jpg.txt"
  mv "$out/clip/jpg.txt" "$out/clip/rgb.txt"
  "$programs/grey_frames" 0 "$out/clip" "$out/upright.grey"
  cp "$out"/clip/frames/* "$out/pictures/"
  for ((i = 2; i < count; ++i)); do
    cp "$out/clip/frames/$(printf %04d $i).jpg" "$out/pictures/$(printf %04d $((2 * count - i))).jpg"
  done
}

# use_libcamera SUITE: our module for that libcamera, and boot.sh's options for both.
use_libcamera() {
  local libcamera module=$out/$1/pocket-ptam-libcamera.so
  mkdir -p "$out/$1"
  libcamera=$(guest_libcamera "$1" offline)
  g++ -std=c++20 -O2 -fPIC -shared -ffp-contract=off -D EIGEN_DONT_VECTORIZE -I "$here/../.." -I "$here/../../core" \
    $(pkg-config --cflags eigen3) -isystem "$libcamera/usr/include/libcamera" \
    "$here/../../platform/camera/libcamera_device.cpp" -o "$module" -L "$libcamera/usr/lib/x86_64-linux-gnu" -lcamera \
    -lcamera-base -Wl,--allow-shlib-undefined
  libcamera_options=(--suite "$1" --root "$libcamera" --program "$build/pocket-ptam"
    --file "$module:/bin/${module##*/}")
}

check_libcamera_run() {
  local kinds poses
  cat "$out/live.txt"
  kinds=$(cut -d ' ' -f 2 "$out/numbers.txt" | sort -u | wc -l)
  poses=$(wc -l <"$out/poses.txt")
  echo "$(wc -l <"$out/numbers.txt") frames tracked, $kinds different pictures; $poses poses"
  ((kinds >= 50)) || fail "only $kinds of the pictures were seen"
  ((poses >= 20)) || fail "only $poses poses"
  grep -q "libcamera's SensorTimestamp" "$out/live.txt" || fail "the times are not SensorTimestamp"
  check_recording
}

test_libcamera_usb() {
  use_libcamera "$1"
  cat >"$out/guest.sh" <<GUEST
$plug
export LIBCAMERA_LOG_LEVELS=*:ERROR
plug /out/camera.txt
# libcamera names a camera by the firmware's name of its host controller, which this one has not.
controller=/sys/devices/platform/vhci_hcd.0
mkdir -p /tmp/named/firmware_node /tmp/work /tmp/usb1
echo emulated >/tmp/named/firmware_node/path
mount --bind \$controller/usb1 /tmp/usb1
mount -t overlay -o lowerdir=\$controller,upperdir=/tmp/named,workdir=/tmp/work overlay \$controller
mount --bind /tmp/usb1 \$controller/usb1
mkdir -p /run/udev/data  # libcamera passes over what udevd has not seen
for device in /sys/bus/media/devices/*/dev /sys/class/video4linux/*/dev; do
  echo I:1 >/run/udev/data/c\$(cat \$device)
done
pocket-ptam cameras
pocket-ptam live --camera libcamera:0 --mode YUYV:320x240 --calibration sent.grey.yaml --rotate 90 --exposure 0.03 \\
  --duration 8 --record /out/recording >/out/poses.txt 2>/out/live.txt
GUEST
  "$here/boot.sh" --offline "${libcamera_options[@]}" --module vhci_hcd --module uvcvideo --module overlay \
    --program "$programs/usb_camera" --file "$out/sent.grey" --file "$out/sent.grey.yaml" --script "$out/guest.sh" \
    --out "$out"
  number_frames 0
  check_libcamera_run
  rm -r "$out/recording" "$out/replayed"
}

test_libcamera() {
  [[ -n "${PPTAM_ALL:-}" ]] || skip "tests/run.sh --all runs it, or PPTAM_ALL=1 tests/platform/drivers.sh"
  make_clip
  local suite
  for suite in $(libcamera_suites); do
    echo "libcamera of Debian $suite"
    test_libcamera_usb "$suite"
  done
  rm -r "$out/clip"
  make_pictures
  cat >"$out/virtual.yaml" <<'YAML'
"Virtual":
  supported_formats:
  - width: 240
    height: 320
    frame_rates: [15, 30]
  frames: {path: "/work/pictures"}
  location: "CameraLocationBack"
  model: "Pictures"
YAML
  cat >"$out/guest.sh" <<'GUEST'
export LIBCAMERA_LOG_LEVELS=*:ERROR
pocket-ptam cameras
pocket-ptam live --camera libcamera:0 --size 240x320 --calibration calibration.yaml --duration 20 \
  --record /out/recording >/out/poses.txt 2>/out/live.txt
GUEST
  # So slow that a second shows 20 to 30 pictures.
  "$here/boot.sh" --offline "${libcamera_options[@]}" --shift 4 --file "$out/pictures" \
    --file "$out/clip/calibration.yaml" \
    --file "$out/virtual.yaml:/usr/share/libcamera/pipeline/virtual/virtual.yaml" --script "$out/guest.sh" --out "$out"
  number_frames 1  # JPEG is decoded by a quick transform there, by an exact one here
  check_libcamera_run
}

case "$name" in
  vivid) test_vivid ;;
  usb) test_usb ;;
  libcamera) test_libcamera ;;
  pi) test_pi ;;
  pi-replay) test_pi_replay ;;
  *)
    echo "error: $name is neither vivid, usb, libcamera, pi nor pi-replay; see --help" >&2
    exit 2
    ;;
esac
exit $wrong
