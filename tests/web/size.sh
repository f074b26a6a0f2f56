#!/usr/bin/env bash
# size.sh WEB: what a browser loads of the page, each file compressed by gzip as servers do, is at most 150 kB. The page
# loads one of the two libraries.
set -euo pipefail

cd "$1"
total=0
for file in index.html style.css *.js "$(ls -S pocket_ptam.wasm pocket_ptam_simd.wasm | head -n 1)"; do
  [[ "$file" == example.js ]] && continue
  bytes=$(gzip -9 -c "$file" | wc -c)
  echo "$bytes $file"
  total=$((total + bytes))
done
echo "$total in all"
if ((total > 150000)); then
  echo "FAILED: at most 150000 are allowed"
  exit 1
fi
