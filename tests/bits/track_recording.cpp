// track_recording FILE: says what the library gives of a recording of make_recordings. Needs nothing but the core.
#include <cstdio>

#include "tests/bits/run_here.h"

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fputs("usage: track_recording FILE\n", stderr);
    return 2;
  }
  const pptam::test::RunHere run = pptam::test::run_here(argv[1], -1);
  std::fputs(run.said.c_str(), stdout);
  return run.result.empty() ? 1 : 0;
}
