#!/usr/bin/env bash
# make.sh: the API's documentation into build/docs/html; every warning is an error.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
source toolchains/debian_packages.sh
install_packages doxygen
mkdir -p build/docs
doxygen core/docs/Doxyfile
echo "build/docs/html/index.html"
