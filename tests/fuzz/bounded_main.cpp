// Runs a fuzz target without a fuzzer, for the tests: on each file of a corpus, and for some seconds on these with
// bytes changed at random. TARGET SECONDS [FOLDER]. What fails is kept as finding-TARGET.
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

namespace {

using Input = std::vector<uint8_t>;

std::vector<Input> corpus_in(const char* folder) {
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder))
    if (entry.is_regular_file()) files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  std::vector<Input> corpus;
  for (const std::filesystem::path& file : files) {
    std::ifstream in(file, std::ios::binary);
    corpus.emplace_back(std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>());
  }
  return corpus;
}

void change(std::mt19937& random, const Input& other, Input* input) {
  const auto below = [&](size_t most) { return random() % (most + 1); };
  const auto place = static_cast<std::ptrdiff_t>(below(input->size()));
  switch (random() % 5) {
    case 0:
      if (!input->empty()) (*input)[below(input->size() - 1)] ^= static_cast<uint8_t>(1u << random() % 8);
      break;
    case 1:
      if (!input->empty()) (*input)[below(input->size() - 1)] = static_cast<uint8_t>(random());
      break;
    case 2:
      for (size_t count = 1 + below(30); count > 0; --count)
        input->insert(input->begin() + place, static_cast<uint8_t>(random()));
      break;
    case 3:
      input->erase(
          input->begin() + place,
          input->begin() + place + static_cast<std::ptrdiff_t>(below(input->size() - static_cast<size_t>(place))));
      break;
    default:
      input->insert(input->begin() + place, other.begin(), other.end());
  }
}

void keep(const char* target, const Input& input) {
  std::ofstream("finding-" + std::filesystem::path(target).filename().string(), std::ios::binary)
      .write(reinterpret_cast<const char*>(input.data()), static_cast<std::streamsize>(input.size()));
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2 || argc > 3) return std::fprintf(stderr, "usage: %s SECONDS [FOLDER]\n", argv[0]), 2;
  const double seconds = std::atof(argv[1]);
  std::vector<Input> corpus = argc == 3 ? corpus_in(argv[2]) : std::vector<Input>();
  corpus.emplace_back();
  constexpr unsigned kSeed = 1;
  std::mt19937 random(kSeed);
  constexpr size_t kMostBytes = 4096;
  const auto start = std::chrono::steady_clock::now();
  size_t runs = 0;
  for (;; ++runs) {
    Input input = runs < corpus.size() ? corpus[runs] : corpus[random() % corpus.size()];
    if (runs >= corpus.size())
      for (auto changes = 1 + random() % 8; changes > 0; --changes)
        change(random, corpus[random() % corpus.size()], &input);
    if (runs >= corpus.size() && input.size() > kMostBytes) input.resize(kMostBytes);
    keep(argv[0], input);
    LLVMFuzzerTestOneInput(input.data(), input.size());
    if (runs >= corpus.size() &&
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count() > seconds)
      break;
  }
  std::filesystem::remove("finding-" + std::filesystem::path(argv[0]).filename().string());
  std::printf("%zu inputs, seed %u\n", runs + 1, kSeed);
  return 0;
}
