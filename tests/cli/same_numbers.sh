#!/usr/bin/env bash
# Whether two builds of the program tell the same of a phone, to the last digit. --help says how to run it.
set -euo pipefail

if [[ "${1:-}" == -h || "${1:-}" == --help || $# -lt 2 ]]; then
  cat <<'HELP'
Usage: tests/cli/same_numbers.sh PROGRAM COMMAND...
Runs `budget --story desk_calm` with PROGRAM, twice, and with COMMAND, another build of the program and its emulator if
it needs one, and compares what they print:
  tests/cli/same_numbers.sh build/test/pocket-ptam build/clang/pocket-ptam
The exit code is 0 when all is alike, 77 when PROGRAM has not been built. What memory takes is compared only with
PPTAM_SAME_WORD=1, between processors whose pointers are as long.
HELP
  (($# >= 2)) || exit 2
  exit 0
fi
program=$1
shift
if [[ ! -x "$program" ]]; then
  echo "skipped: $program is not there to compare with"
  exit 77
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

told() {  # phone, program...
  local phone=$1
  shift
  "$@" budget --phone "$phone" --story desk_calm || (($? == 1))
}
same() { cmp -s "$work/$1" "$work/$2"; }
told iphone3g "$program" >"$work/first"
told iphone3g "$program" >"$work/again"
told iphone3g "$@" >"$work/other"
told pi_zero "$program" >"$work/control"
fail() {
  echo "FAILED: $1"
  exit 1
}
grep -q '^verdict' "$work/first" || fail "no verdict: $(cat "$work/first")"
same first again || fail "the same program says something else the second time"
if [[ -z "${PPTAM_SAME_WORD:-}" ]]; then sed -i '/^memory/d' "$work"/{first,other}; fi
diff "$work/first" "$work/other" || fail "the other program says something else"
! same first control || fail "control: two phones say the same"
echo "$(wc -l <"$work/first") lines alike; $(grep '^verdict' "$work/first")"
