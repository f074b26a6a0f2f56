#!/usr/bin/env bash
# Builds the program and runs it on the emulated phone. Ends with where the pictures are.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

if [[ "${1:-}" == -h || "${1:-}" == --help ]]; then
  cat <<'HELP'
Usage: sim_phone/demo.sh [--scene desk|boxes|walls|checkerboard] [--seed N] [OPTIONS OF "pocket-ptam sim"]
Builds the preset "release" into build/release, tracks 20 seconds of an emulated phone's camera and writes a report and
pictures to out/demo. On Debian it first installs the packages that are missing (as root or by sudo).
HELP
  exit 0
fi

source toolchains/debian_packages.sh
install_packages "${program_packages[@]}" "${display_packages[@]}"
echo "== building"
cmake --preset release --log-level=WARNING
cmake --build --preset release --parallel "$(nproc)" --target pocket-ptam
echo "== running: build/release/pocket-ptam sim --out out/demo $*"
build/release/pocket-ptam sim --out out/demo "$@"
cat <<WHERE

== done; open in a browser
report    $PWD/out/demo/report.html
video     $PWD/out/demo/overlay.mp4
picture   $PWD/out/demo/overlay.png
WHERE
