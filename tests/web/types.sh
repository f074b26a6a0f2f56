#!/usr/bin/env bash
# types.sh WORK: the types in pocket_ptam.js' comments are right, as editors read them (TypeScript), and a caller's
# mistake is found. Exit code 77: TypeScript is not here.
set -euo pipefail

work=$1
script=$(realpath "$(dirname "${BASH_SOURCE[0]}")/../../platform/web/pocket_ptam.js")
command -v tsc >/dev/null || { echo "skipped: tsc is not here (Debian: node-typescript)" && exit 77; }
check() {
  tsc --noEmit --allowJs --checkJs --strict --noImplicitAny false --target es2022 --module esnext \
    --moduleResolution node --lib es2022,dom "$@"
}
check "$script"
mkdir -p "$work"
cat >"$work/right.ts" <<CODE
import {System, TrackResult} from '${script%.js}';
export function where(system: System, data: Uint8Array): number {
  const result: TrackResult = system.track({data, timestamp_ns: 5n});
  return result.T_cw.t[0] + system.mapPoints()[0].p_w[2];
}
CODE
check "$work/right.ts"
sed 's/timestamp_ns: 5n/timestamp_ns: 5/' "$work/right.ts" >"$work/wrong.ts"
if check "$work/wrong.ts" >/dev/null; then
  echo "FAILED: a time that is no bigint is not found"
  exit 1
fi
