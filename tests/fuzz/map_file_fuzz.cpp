// A good map with bytes changed here and there, cut off or lengthened, its size and checksum made good: load_map
// refuses it or loads exactly what it says, and the system works on. tests/fuzz/run.sh builds and runs it.
//
// The input is a script, so that short ones reach everything: edits of four bytes each, 24 bits of offset and the new
// byte; an offset beyond the end cuts the file at the offset less its size, or lengthens it.
#include <algorithm>
#include <cstdio>
#include <cstdlib>

#include <pocket_ptam/inspection.h>
#include "tests/support/small_map.h"

namespace {

using namespace pptam;

struct Target {
  Target() : original(1), good(original.file()) {
    memory.resize(System::required_bytes(original.config) / sizeof(std::max_align_t) + 1);
    if (!System::create(original.config, std::as_writable_bytes(std::span(memory)), &system).ok()) std::abort();
    if (!system->load_map(good).ok()) std::abort();
  }
  test::SmallMap original;
  std::vector<std::byte> good, saved;
  std::vector<std::max_align_t> memory;
  System* system = nullptr;
  int64_t now_ns = 0;
};

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "%s\n", what);
  std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static Target target;
  std::vector<std::byte> file = target.good;
  for (; size >= 4; data += 4, size -= 4) {
    const size_t offset = data[0] | size_t{data[1]} << 8 | size_t{data[2]} << 16;
    if (offset < file.size()) {
      file[offset] = static_cast<std::byte>(data[3]);
    } else {
      file.resize(std::min(offset - file.size(), 2 * target.good.size()));
    }
  }
  if (file.size() > 24)
    for (size_t i = 0; i < 8; ++i) file[16 + i] = static_cast<std::byte>(uint64_t{file.size()} >> (8 * i));
  test::repair_checksum(&file);

  System& system = *target.system;
  const uint64_t before = map_hash(system);
  if (!system.load_map(file).ok()) {
    require(map_hash(system) == before, "a refused map changed something");
    return 0;
  }
  target.saved.resize(system.map_bytes());
  size_t used = 0;
  require(system.save_map(target.saved, &used).ok() && target.saved == file, "a map was not loaded for what it says");
  for (int i = 0; i < 2; ++i) {
    const GreyView image = target.original.map.keyframes()[i].pyramid.level[0];
    target.now_ns += 66666667;
    const TrackResult result =
        system.track({image.data, image.width, image.height, image.stride, PixelFormat::kGrey, target.now_ns});
    require(result.status.ok(), "a frame was refused");
    for (int slice = 0; slice < 5; ++slice) system.work_slice();
  }
  return 0;
}
