#!/usr/bin/env bash
# firefox.sh WEB PROGRAM CAMERA WORK: as chromium.sh, the page in headless Firefox (firefox.mjs).
set -euo pipefail

web=$1 program=$2 camera=$3 work=$4
here=$(dirname "${BASH_SOURCE[0]}")
skip() {
  echo "skipped: $*"
  exit 77
}
[[ -n "${PPTAM_ALL:-}" ]] || skip "a browser is tried with --all: tests/run.sh --all --preset wasm -R Firefox"
firefox=$(command -v firefox-esr || command -v firefox) || skip "firefox is not here (Debian: firefox-esr)"
[[ -x "$program" ]] || skip "no $program: first cmake --preset test and build pocket-ptam"
command -v ffmpeg >/dev/null || skip "ffmpeg is not here"
"$here/fake_camera.sh" "$program" "$camera"
exec node "$here/firefox.mjs" "$web" "$program" "$camera/desk.y4m" "$work" "$firefox"
