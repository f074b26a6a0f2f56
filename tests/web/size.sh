#!/usr/bin/env bash
# size.sh WEB: what a browser loads of the page, each file compressed as servers do, is at most 150 kB by gzip, which is
# all that some servers have, and by brotli. The page loads one of the two libraries.
set -euo pipefail

cd "$1"
command -v brotli >/dev/null || { echo "skipped: brotli is not here" && exit 77; }
by_brotli=0 by_gzip=0
echo "brotli gzip"
for file in index.html style.css *.js "$(ls -S pocket_ptam.wasm pocket_ptam_simd.wasm | head -n 1)"; do
  [[ "$file" == example.js ]] && continue
  brotli=$(brotli -9 -c "$file" | wc -c) gzip=$(gzip -9 -c "$file" | wc -c)
  echo "$brotli $gzip $file"
  by_brotli=$((by_brotli + brotli)) by_gzip=$((by_gzip + gzip))
done
echo "$by_brotli $by_gzip in all"
if ((by_brotli > 150000 || by_gzip > 150000)); then
  echo "FAILED: at most 150000 are allowed"
  exit 1
fi
