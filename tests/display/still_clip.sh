# Sourced by tests of displays: a clip that stands still, before a map that knows its view, so that the house is there
# and every picture of a run is the same.

# make_still_clip BUILD FOLDER FRAMES: FOLDER/still, five frames a second, and FOLDER/desk.map.
make_still_clip() {
  local build=$1 folder=$2 frames=$3 last number
  "$build/pocket-ptam" sim --duration 6 --no-overlay --no-report --save-map "$folder/desk.map" --out "$folder/desk" \
    >"$folder/desk.txt" 2>&1
  "$build/pocket-ptam" sim --duration 6 --dump "$folder/clip" >>"$folder/desk.txt" 2>&1
  mkdir -p "$folder/still/rgb"
  cp "$folder/clip/calibration.yaml" "$folder/still"
  last=$(grep -v '^#' "$folder/clip/rgb.txt" | tail -1 | cut -d ' ' -f 2)
  cp "$folder/clip/$last" "$folder/still/rgb/view.${last##*.}"
  for number in $(seq 0 $((frames - 1))); do
    echo "$((number / 5)).$((number % 5 * 2)) rgb/view.${last##*.}"
  done >"$folder/still/rgb.txt"
}

# How the clip is shown.
still_clip_options="--calibration still/calibration.yaml --load-map desk.map --lock-map --no-report --out shown"
