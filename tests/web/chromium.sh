#!/usr/bin/env bash
# chromium.sh WEB PROGRAM CAMERA WORK: the page in headless Chromium (chromium.mjs), before a camera that PROGRAM, the
# one for this computer, has rendered into the folder CAMERA. It takes a minute and wants the processor: only with
# --all. Exit code 77: not now.
set -euo pipefail

web=$1 program=$2 camera=$3 work=$4
here=$(dirname "${BASH_SOURCE[0]}")
skip() {
  echo "skipped: $*"
  exit 77
}
[[ -n "${PPTAM_ALL:-}" ]] || skip "a browser is tried with --all: tests/run.sh --all --preset wasm -R Chromium"
command -v chromium >/dev/null || skip "chromium is not here (Debian: chromium)"
[[ -x "$program" ]] || skip "no $program: first cmake --preset test and build pocket-ptam"
command -v ffmpeg >/dev/null || skip "ffmpeg is not here"
"$here/fake_camera.sh" "$program" "$camera"
exec node "$here/chromium.mjs" "$web" "$program" "$camera/desk.y4m" "$work" "$(command -v chromium)"
