#!/usr/bin/env bash
# Installs what the tests need, builds them and runs them. The last lines printed are ctest's summary, its exit code
# is ours.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

if [[ "${1:-}" == -h || "${1:-}" == --help ]]; then
  cat <<'HELP'
Usage: tests/run.sh [CTEST OPTIONS]
Builds the preset "test" into build/test and runs all tests. On Debian it first installs the packages that
are missing (as root or by sudo). Options go to ctest:
  tests/run.sh -L unit            only the tests of one folder: unit, kernels, scenario, cli
  tests/run.sh -R pyramid         only tests whose name matches
  tests/run.sh --rerun-failed     only those that failed the last time
HELP
  exit 0
fi

source toolchains/debian_packages.sh
install_packages "${program_packages[@]}" "${test_packages[@]}"
echo "== building"
cmake --preset test --log-level=WARNING
cmake --build --preset test --parallel "$(nproc)"
echo "== testing"
exec ctest --preset test "$@"
