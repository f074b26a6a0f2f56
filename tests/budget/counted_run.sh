#!/usr/bin/env bash
# Whole runs of the emulated phone whose time is the instructions that an emulated ARM1176 executes. --help says more.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

if [[ "${1:-}" == -h || "${1:-}" == --help ]]; then
  cat <<'HELP'
Usage: tests/budget/counted_run.sh [--heavy] [--command COMMAND] [STORY...]
Runs stories of the emulated phone ("desk": six seconds as the other tests have it; that is the default) in an emulated
ARM1176 with the counting plugin. Its clock is what it has executed, at the iPhone 3G's 412 MHz and 1.5 cycles an
instruction, so that frames, mapping and idle time follow each other as there. Prints the times beside the work clock's,
which may be off by a tenth, runs all twice, and compares. First build
  cmake --preset test && cmake --build --preset test --target counted_run        # renders: seconds, not minutes
  cmake --preset armv6 && cmake --build --preset armv6 --target counted_run
The exit code is 0 when all holds, 77 when nothing counts instructions here.
--heavy: only where PPTAM_ALL is set, as by tests/run.sh --all.
--command: the emulator with its options, and the program; by default what those have built.
HELP
  exit 0
fi
if [[ "${1:-}" == --heavy ]]; then
  shift
  if [[ -z "${PPTAM_ALL:-}" ]]; then
    echo "skipped: tests/run.sh --all runs it, or PPTAM_ALL=1"
    exit 77
  fi
fi
command="qemu-arm -cpu arm1176 -plugin build/armv6/tests/budget/libcounting_plugin.so build/armv6/tests/budget/counted_run"
if [[ "${1:-}" == --command ]]; then
  command=$2
  shift 2
fi
(($# > 0)) || set -- desk
if [[ -z "${PPTAM_RECORDINGS:-}" ]]; then
  PPTAM_RECORDINGS=$(mktemp -d)
  trap 'rm -rf "$PPTAM_RECORDINGS"' EXIT
fi
export PPTAM_RECORDINGS
read -ra words <<<"$command"
if [[ ! -x "${words[-1]}" ]]; then
  echo "error: ${words[-1]} has not been built; see --help" >&2
  exit 2
fi

wrong=0
for story in "$@"; do
  echo "$story"
  renderer=build/test/tests/budget/counted_run  # without it the emulated program renders
  [[ ! -x "$renderer" ]] || "$renderer" "$story" >/dev/null || (($? == 77))
  status=0
  first=$("${words[@]}" "$story") || status=$?
  echo "$first"
  ((status != 77)) || exit 77
  ((status == 0)) || wrong=1
  second=$("${words[@]}" "$story") || true
  if [[ "$first" != "$second" ]]; then
    echo "FAILED: the second run gives other numbers"
    diff <(echo "$first") <(echo "$second") || true
    wrong=1
  fi
done
exit $wrong
