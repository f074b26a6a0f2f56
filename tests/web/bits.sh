#!/usr/bin/env bash
# bits.sh RECORDINGS COMMAND...: what COMMAND, one of the .mjs here with a library or program, says of the recording
# that the test bare_metal.recording of preset "test" has made, must be what was said there, but for what COMMAND does
# not tell: the hash of the stages. Exit code 77: there is none.
set -euo pipefail

recording=$1/desk.frames expected=$1/desk.result
shift
command -v "$1" >/dev/null || { echo "skipped: $1 is not here (Debian: nodejs)" && exit 77; }
[[ -f "$expected" ]] || { echo "skipped: no $expected: first tests/run.sh -R bare_metal" && exit 77; }
result=$("$@" "$recording")
wanted=$(cat "$expected")
[[ "$result" == *", results "* ]] || wanted=$(sed -E 's/, results [0-9a-f]+//' <<<"$wanted")
echo "here:         $wanted"
echo "WebAssembly:  ${result//$'\n'/; }"
if [[ "$(tail -n 1 <<<"$result")" != "$wanted" ]]; then
  echo "FAILED: another result than here"
  exit 1
fi
if [[ "$("$@" "$recording" 10 | tail -n 1)" == "$wanted" ]]; then
  echo "FAILED: one pixel of an early frame changes nothing: nothing is compared"
  exit 1
fi
