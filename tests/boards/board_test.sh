#!/usr/bin/env bash
# The program for a board, run by an emulator of its processor, beside this computer's: the same commands and options,
# and from the same images the same results. --help says how to run it; the exit code is 0 when all is alike.
set -euo pipefail

if [[ "${1:-}" == -h || "${1:-}" == --help || $# -lt 2 ]]; then
  cat <<'HELP'
Usage: tests/boards/board_test.sh [--overlay] PROGRAM COMMAND...
Renders 4 s of the emulated phone's desk with PROGRAM, this computer's pocket-ptam, stores the images in five formats,
and runs replay with PROGRAM and with COMMAND, the board's and its emulator; likewise what was recorded live:
  tests/boards/board_test.sh build/release/pocket-ptam \
    qemu-aarch64 -L build/sysroots/arm64 build/board-arm64/pocket-ptam
--overlay: COMMAND has drivers of displays, and is to draw the same overlay, but for what two renderers round otherwise.
Without it there is to be none, and that is to be said.
HELP
  (($# >= 2)) || exit 2
  exit 0
fi

overlay=""
if [[ "$1" == --overlay ]]; then
  overlay=1
  shift
fi
host=$1
shift
board=("$@")
if [[ ! -x "$host" ]]; then
  echo "error: $host is not there: cmake --preset release && cmake --build --preset release --target pocket-ptam" >&2
  exit 1
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
fail() {
  echo "FAILED: $1" >&2
  exit 1
}

commands=$("$host" --help | sed -n '/^Subcommands:/,/^$/ s/^  \([a-z]\+\) .*/\1/p')
[[ " ${commands//$'\n'/ } " == *" replay "* ]] || fail "no commands in: $host --help"
offers() { sed -nE 's/^  ((-.,)?--[a-z-]+|[a-z]+  ).*/\1/p' "$1"; }  # how it is laid out depends on CLI11's version
for command in "" $commands; do
  "$host" $command --help >"$work/host_help"
  "${board[@]}" $command --help >"$work/board_help" || fail "$command --help ends with $?"
  [[ -n "$(offers "$work/host_help")" ]] || fail "no options in: $host $command --help"
  diff <(offers "$work/host_help") <(offers "$work/board_help") || fail "$command --help offers other options"
done

# A decoder of gdk-pixbuf for each format: two are in the library, three are plugins that it must find on the board.
"$host" sim --scene desk --seed 3 --duration 4 --dump "$work/desk" >"$work/log" 2>&1 || fail "$(tail -1 "$work/log")"
formats=(png jpg pgm bmp tiff)
for format in "${formats[@]:1}"; do
  ffmpeg -nostdin -v error -pattern_type glob -i "$work/desk/rgb/*.png" -q:v 2 -f image2 "$work/desk/rgb/%d.$format"
done
index=0
while read -r time png; do
  format=${formats[index++ % 5]}
  [[ "$format" == png ]] && echo "$time $png" || echo "$time rgb/$index.$format"
done < <(grep -v '^#' "$work/desk/rgb.txt") >"$work/desk/mixed.txt"
mv "$work/desk/mixed.txt" "$work/desk/rgb.txt"

replay() {  # out, program...
  local out=$1
  shift
  "$@" replay "$work/desk" --calibration "$work/desk/calibration.yaml" --out "$out" --save-map "$out.map" \
    >"$out.log" 2>&1 || fail "replay ends with $?: $(tail -1 "$out.log")"
}
same_results() {  # out, out: all numbers; pictures are drawn by libraries that do not promise the same bits
  local file
  for file in trajectory.txt keyframes.txt map.ply frames.csv; do cmp -s "$1/$file" "$2/$file" || return 1; done
  cmp -s "$1.map" "$2.map" && [[ "$(grep '^map hash' "$1.log")" == "$(grep '^map hash' "$2.log")" ]]
}
replay "$work/host" "$host"
(($(grep -vc '^#' "$work/host/trajectory.txt") > 10)) || fail "there must be a map, or nothing is compared"
started=$SECONDS
replay "$work/board" "${board[@]}"
emulated_s=$((SECONDS - started))
same_results "$work/host" "$work/board" || fail "other results:
$(diff "$work/host.log" "$work/board.log" || true)"
[[ -s "$work/board/report.html" ]] || fail "the board wrote no report.html"
if [[ -n "$overlay" ]]; then  # 45 dB: a grey level or two; the next still is another view
  likeness() {
    ffmpeg -nostdin -v info -i "$1" -i "$2" -lavfi psnr -f null - 2>&1 | sed -nE 's/.*average:([0-9]+|inf).*/\1/p' |
      sed 's/inf/99/'
  }
  grep 'there is no overlay' "$work/board.log" && fail "the board draws no overlay"
  (($(likeness "$work/host/overlay.png" "$work/board/overlay.png") >= 45)) || fail "the board draws another overlay"
  (($(likeness "$work/host/start.png" "$work/board/overlay.png") < 30)) || fail "control: another view is the same"
else
  grep -q 'there is no overlay: drawing: built without it' "$work/board.log" ||
    fail "the folder has no drivers of displays, and does not say so"
fi

# What was done live, in real time, is repeated: the recording knows its own bits, and replay compares.
"$host" live --camera sim:desk --seed 3 --duration 8 --poses none --record "$work/live" >"$work/log" 2>&1 ||
  fail "live ends with $?: $(tail -1 "$work/log")"
(($(grep -c '^slices' "$work/live/events.txt") > 2)) || fail "there must be mapping, or nothing is compared"
"${board[@]}" replay "$work/live" --out "$work/board_live" --no-overlay >"$work/log" 2>&1 ||
  fail "the replay of a live recording ends with $?: $(tail -1 "$work/log")"
sed -i '0,/^slices /s/^slices [0-9]*$/slices 0/' "$work/live/events.txt"  # control
! "${board[@]}" replay "$work/live" --out "$work/control_live" --no-overlay >"$work/log" 2>&1 ||
  fail "control: other slices give the same bits"

# Control: one early frame is shown in the next one's place.
png=$(sed -n '11 s/.* //p' "$work/desk/rgb.txt")
cp "$work/desk/$png" "$work/control.png"
cp "$work/desk/$(sed -n '16 s/.* //p' "$work/desk/rgb.txt")" "$work/desk/$png"
replay "$work/control" "$host"
! same_results "$work/control" "$work/board" || fail "control: other images give the same results"
echo "same options and results, live ones too; $(grep '^map hash' "$work/board.log"); replayed in $emulated_s s"
