#!/usr/bin/env bash
# fake_camera.sh PROGRAM FOLDER: 26 seconds of the emulated phone's desk as FOLDER/desk.y4m, which Chromium takes for
# its camera. Made once.
set -euo pipefail

program=$1 folder=$2
[[ -f "$folder/desk.y4m" ]] && exit 0
mkdir -p "$folder"
rm -rf "$folder/desk"
"$program" sim --duration 26 --dump "$folder/desk" &>"$folder/dump.log"
sed -nE "s|^[0-9.]+ (.*)|file 'desk/\1'|p" "$folder/desk/rgb.txt" >"$folder/desk.list"
ffmpeg -v error -y -r 15 -f concat -i "$folder/desk.list" -vf scale=in_range=full:out_range=full -pix_fmt yuv420p \
  -r 15 "$folder/draft.y4m"
rm -rf "$folder/desk"
mv "$folder/draft.y4m" "$folder/desk.y4m"
