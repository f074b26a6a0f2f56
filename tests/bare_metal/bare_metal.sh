#!/usr/bin/env bash
# bare_metal.sh PROGRAM.elf RECORDING EMULATOR...: runs the microcontroller's program on a recording that the test
# bare_metal.recording of preset "test" has made, and compares what both say of it. Exit code 77: there is none.
set -euo pipefail

program=$1 recording=$2 expected=${2%.frames}.result
shift 2
skip() {
  echo "skipped: $*"
  exit 77
}
fail() {
  echo "FAILED: $*"
  exit 1
}
command -v "$1" >/dev/null || skip "$1 is not here"
[[ -f "$expected" ]] || skip "no $expected: first tests/run.sh -R bare_metal"

options=("${@:1:$#-1}")  # without the last, -kernel
for i in "${!options[@]}"; do
  [[ "${options[$i]}" == enable=on,* ]] && options[$i]+=",arg=bare_metal,arg=${recording//,/,,}"
done
result=$("${options[@]}" -kernel "$program" 2>&1) || fail "$result"
echo "here:        $(cat "$expected")"
echo "mps2-an500:  ${result//$'\n'/; }"
[[ "$(tail -n 1 <<<"$result")" == "$(cat "$expected")" ]] || fail "another result than here"
