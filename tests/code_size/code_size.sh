#!/usr/bin/env bash
# code_size.sh PROGRAM MOST NM: how much code and constants a program for another processor has, at most MOST times 1024
# bytes; and that nothing of a heap, of printing or of unwinding is linked.
set -euo pipefail

program=$1 most=$2 nm=$3
needless='malloc|calloc|realloc|free|_sbrk|operator (new|delete).*|printf|abort|__cxa_throw'
if "$nm" -C "$program" | grep -wE "$needless"; then
  echo "FAILED: the program has what the core must not need"
  exit 1
fi
"${nm%nm}size" "$program"
code=$("${nm%nm}size" "$program" | awk 'NR == 2 { print $1 }')
if ((code < 100 * 1024)); then
  echo "FAILED: $code bytes: the library is not in there"
  exit 1
fi
if ((code > most * 1024)); then
  echo "FAILED: $code bytes, at most $((most * 1024)) are allowed"
  exit 1
fi
echo "$code bytes of code and constants, at most $((most * 1024))"
