#!/usr/bin/env bash
# A run in a window of an X server without a screen (Xvfb): what the window shows is what was drawn; keys, the mouse,
# another size, and a window that goes. Usage: tests/display/window.sh BUILD, the folder of the programs, such as
# build/test. Exit code 77: skipped, a program is missing. What it made stays in BUILD/window-test.
set -euo pipefail
build=$(realpath "$1")
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
source "$here/still_clip.sh"
for entry in Xvfb:xvfb xdotool:xdotool xwd:x11-apps; do
  if ! command -v "${entry%%:*}" >/dev/null; then
    echo "skipped: ${entry%%:*} is missing; apt-get install ${entry#*:}"
    exit 77
  fi
done
out=$build/window-test
rm -rf "$out"
mkdir -p "$out"
cd "$out"
wrong=0
fail() {
  echo "FAILED: $*"
  wrong=1
}

Xvfb -displayfd 3 -screen 0 1100x1000x24 3>number >xvfb.txt 2>&1 &
server=$!
trap 'kill $server $(jobs -p) 2>/dev/null || true' EXIT
for _ in $(seq 100); do [[ -s number ]] && break; sleep 0.1; done
[[ -s number ]] || { echo "skipped: Xvfb does not start: $(tail -1 xvfb.txt)"; exit 77; }
export DISPLAY=:$(<number) LIBGL_ALWAYS_SOFTWARE=1
unset WAYLAND_DISPLAY

# until SECONDS COMMAND...: as soon as it succeeds.
until_so() {
  local tries=$(($1 * 10))
  shift
  while ((tries-- > 0)); do
    "$@" >/dev/null 2>&1 && return
    sleep 0.1
  done
  return 1
}
start() {  # LOG ARGUMENTS...
  local log=$1
  shift
  "$build/pocket-ptam" "$@" >"$log.out" 2>"$log" </dev/null &
  run=$!
  until_so 20 grep -q 'shown on' "$log" || { cat "$log"; fail "no window"; exit 1; }
  window=$(xdotool search --name 'Pocket PTAM' | head -1)
}
picture_count() {
  find . -maxdepth 1 -name 'pocket-ptam-*.png' | wc -l
}
no_notice_any_more() {  # any key takes it away
  xdotool key --window "$window" v
  xdotool key --window "$window" v
  sleep 0.7
}
take_picture() {  # LOG: the next pocket-ptam-NNNN.png
  picture=$(printf 'pocket-ptam-%04d.png' $(($(picture_count) + 1)))
  xdotool key --window "$window" p
  until_so 10 grep -q "picture saved to $picture" "$1" || fail "no picture by key p"
}
same() {
  "$build/tests/display/same_pictures" "$@"
}

make_still_clip "$build" . 300
start still.txt replay still --show=window $still_clip_options
no_notice_any_more
take_picture still.txt
no_notice_any_more
xwd -silent -id "$window" >whole.xwd
same "$picture" whole.xwd --colour 200 70 50 500 || fail "the window does not show what was drawn"
xdotool key --window "$window" v
until_so 10 bash -c "xwd -silent -id $window >above.xwd; ! '$build/tests/display/same_pictures' '$picture' above.xwd" ||
  fail "control: the view from above is the same picture"
xdotool key --window "$window" v
xdotool windowsize --sync "$window" 700 400
no_notice_any_more
take_picture still.txt
no_notice_any_more
xwd -silent -id "$window" >wide.xwd
same "$picture" wide.xwd || fail "another size is not drawn over"
xdotool key --window "$window" Escape
wait "$run" || fail "Escape does not end the run well: exit code $?"
# The overlay was drawn off-screen, its rows the other way round: the image's filter rounds otherwise, by up to 8 levels
# where two pixels are black and white, and edges may fall on either side of a pixel's centre.
same shown/overlay.png whole.xwd --but 100 10 || fail "the window does not show what the overlay does"
same shown/overlay.png above.xwd --but 100 10 && fail "control: the view from above is the overlay's picture"

# While no frame comes, here for 4.9 s, the picture is drawn again and keys are heard.
mkdir -p gap
cp -r still/rgb still/calibration.yaml gap
sed -n '1,10p; 11s/^[^ ]*/6.7/p' still/rgb.txt >gap/rgb.txt
start gap.txt replay gap --show=window ${still_clip_options//still/gap} --no-overlay
no_notice_any_more
sleep 1.5
xdotool windowsize --sync "$window" 600 500
sleep 1
xwd -silent -id "$window" >gap.xwd
take_picture gap.txt
same "$picture" gap.xwd --colour 200 70 50 200 || fail "another size is not drawn over while no frame comes"
pressed=$(date +%s%N)
xdotool key --window "$window" q
wait "$run" || fail "q between two frames does not end the run well: exit code $?"
(($(date +%s%N) - pressed < 1800000000)) || fail "q waits for the next frame"

# A live recording that is repeated in part is not called the same bits.
"$build/pocket-ptam" live --camera sim:desk --duration 6 --poses none --record recorded >recorded.txt 2>&1
start repeated.txt replay recorded --show=window --no-overlay --no-report --out repeated
sleep 1
xdotool key --window "$window" r
until_so 5 grep -q 'only p, v and q do something here' repeated.txt || fail "key r is passed over in silence"
xdotool key --window "$window" q
wait "$run" || fail "q does not end a repetition well: exit code $?"
grep -q 'up to there' repeated.txt.out || fail "it is not told that the repetition was ended early"

# A window that is destroyed does not end a run.
start live.txt live --camera sim:desk --duration 8 --show=window --no-auto-start
xdotool mousemove --window "$window" 200 200 click 1
until_so 5 grep -q 'tap: the next frame' live.txt || fail "no tap by the mouse"
until_so 10 grep -q 's: tracking' live.txt || fail "it does not track"
xdotool mousemove --window "$window" 200 200 click 1
until_so 5 grep -q 'there is a map already' live.txt || fail "a tap by hand forgets the map"
xdotool windowclose "$window"
wait "$run" || fail "a window that goes ends the run: exit code $?"
grep -q 'the run goes on without it' live.txt || fail "it is not told that the window has gone"
poses=$(wc -l <live.txt.out)
((poses > 30)) || fail "only $poses poses"
exit $wrong
