#!/usr/bin/env bash
# fake_camera.sh PROGRAM FOLDER: 20 seconds of the emulated phone's desk as FOLDER/desk.y4m, which Chromium takes for its
# camera, and the camera's calibration. Made once.
set -euo pipefail

program=$1 folder=$2
[[ -f "$folder/desk.y4m" ]] && exit 0
mkdir -p "$folder"
rm -rf "$folder/desk"
"$program" sim --seed 3 --duration 21 --dump "$folder/desk" &>"$folder/dump.log"
ffmpeg -v error -y -framerate 15 -pattern_type glob -i "$folder/desk/rgb/*.png" -pix_fmt yuv420p -vf scale=in_range=full:out_range=full "$folder/draft.y4m"
cp "$folder/desk/calibration.yaml" "$folder/desk.yaml"
rm -rf "$folder/desk"
mv "$folder/draft.y4m" "$folder/desk.y4m"
