#include <gtest/gtest.h>

#include <climits>
#include <vector>

#include <pocket_ptam/image.h>
#include "tests/kernels/test_images.h"

namespace pptam {
namespace {

using test::OwnedImage;
using test::Random;

int bytes_of(PixelFormat format) {
  return format == PixelFormat::kBgra ? 4 : format == PixelFormat::kRgb24 ? 3 : format == PixelFormat::kYuyv ? 2 : 1;
}

// The definition, pixel by pixel, in plain arithmetic.
uint8_t reference(const Frame& frame, int x, int y) {
  const uint8_t* px = frame.data + y * frame.stride_bytes + x * bytes_of(frame.format);
  if (frame.format == PixelFormat::kBgra)
    return static_cast<uint8_t>((77 * px[2] + 150 * px[1] + 29 * px[0] + 128) / 256);
  if (frame.format == PixelFormat::kRgb24)
    return static_cast<uint8_t>((77 * px[0] + 150 * px[1] + 29 * px[2] + 128) / 256);
  return px[0];
}

TEST(Grey, EqualsTheDefinitionForEveryFormatSizeAndStride) {
  Random random;
  for (const PixelFormat format : {PixelFormat::kBgra, PixelFormat::kRgb24, PixelFormat::kYuyv}) {
    for (int width = 1; width <= 21; ++width) {
      if (format == PixelFormat::kYuyv && width % 2) continue;
      const int height = random.integer(1, 5);
      const int bytes = width * bytes_of(format);
      const OwnedImage raw = test::random_image(random, bytes, height, bytes + random.integer(0, 7));  // unaligned
      const Frame frame{raw.view().data, width, height, raw.view().stride, format, 0};
      ASSERT_TRUE(validate_frame(frame).ok());
      OwnedImage storage(width, height, width + random.integer(0, 3));
      const GreyView grey = to_grey(frame, storage.image());
      ASSERT_EQ(grey.data, storage.view().data);
      for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) ASSERT_EQ(grey.at(x, y), reference(frame, x, y)) << x << " " << y;
      ASSERT_TRUE(storage.guards_intact());
    }
  }
}

// Every corner of the colour cube, where the sums are largest, with alpha 0 and 255; and every grey keeps its value.
TEST(Grey, ExtremesDoNotOverflowAndGreysAreKept) {
  std::vector<uint8_t> bgra;
  for (int i = 0; i < 16; ++i)
    for (int c = 0; c < 4; ++c) bgra.push_back((i >> c) & 1 ? 255 : 0);
  for (int i = 0; i < 256; ++i)
    for (int c = 0; c < 4; ++c) bgra.push_back(static_cast<uint8_t>(c == 3 ? 255 - i : i));
  const Frame frame{bgra.data(), 272, 1, 4 * 272, PixelFormat::kBgra, 0};
  OwnedImage storage(272, 1);
  const GreyView grey = to_grey(frame, storage.image());
  for (int x = 0; x < 272; ++x) EXPECT_EQ(grey.at(x, 0), reference(frame, x, 0)) << x;
  for (int i = 0; i < 256; ++i) EXPECT_EQ(grey.at(16 + i, 0), i);
}

TEST(Grey, GreyAndPlanarFramesAreUsedInPlace) {
  const std::vector<uint8_t> data(64 * 64, 7);
  for (const PixelFormat format : {PixelFormat::kGrey, PixelFormat::kNv12, PixelFormat::kNv21, PixelFormat::kI420}) {
    const Frame frame{data.data(), 30, 20, 33, format, 0};
    ASSERT_TRUE(validate_frame(frame).ok());
    const GreyView grey = to_grey(frame, {});
    EXPECT_EQ(grey.data, data.data());
    EXPECT_EQ(grey.width, 30);
    EXPECT_EQ(grey.height, 20);
    EXPECT_EQ(grey.stride, 33);
  }
}

TEST(Grey, IncompleteFramesAreRefused) {
  const std::vector<uint8_t> data(4096);
  const Frame good{data.data(), 16, 8, 64, PixelFormat::kBgra, 0};
  const auto refused = [](Frame frame) { return validate_frame(frame).code() == StatusCode::kInvalidArgument; };
  EXPECT_FALSE(refused(good));
  Frame f = good;
  f.data = nullptr;
  EXPECT_TRUE(refused(f));
  for (const int bad : {0, -1, INT_MIN}) {
    f = good;
    f.width = bad;
    EXPECT_TRUE(refused(f));
    f = good;
    f.height = bad;
    EXPECT_TRUE(refused(f));
    f = good;
    f.stride_bytes = bad;
    EXPECT_TRUE(refused(f));
  }
  f = good;
  f.stride_bytes = 63;
  EXPECT_TRUE(refused(f));
  f.width = INT_MAX;  // 4 x width overflows 32 bits
  f.stride_bytes = INT_MAX;
  EXPECT_TRUE(refused(f));
  f = good;
  f.format = static_cast<PixelFormat>(200);
  EXPECT_TRUE(refused(f));
  for (const PixelFormat format : {PixelFormat::kNv12, PixelFormat::kNv21, PixelFormat::kI420, PixelFormat::kYuyv}) {
    f = good;
    f.format = format;
    EXPECT_FALSE(refused(f));
    f.width = 15;
    EXPECT_TRUE(refused(f));
    f.width = 16;
    f.height = 7;
    EXPECT_EQ(refused(f), format != PixelFormat::kYuyv);  // which shares colour between columns only
  }
}

TEST(Grey, GoldenHash) {
  const auto hash = [](const GreyView& raw) {
    test::Fnv fnv;
    for (const PixelFormat format : {PixelFormat::kBgra, PixelFormat::kRgb24, PixelFormat::kYuyv}) {
      const int width = raw.width / bytes_of(format) / 2 * 2;
      OwnedImage storage(width, raw.height);
      fnv.add_image(to_grey({raw.data, width, raw.height, raw.stride, format, 0}, storage.image()));
    }
    return fnv.value();
  };
  OwnedImage raw = test::golden_image(411, 23);
  constexpr uint64_t kExpected = 0xf61d94a75c48d51bu;
  EXPECT_EQ(hash(raw.view()), kExpected);
  raw.image().at(201, 11) ^= 64;  // control
  EXPECT_NE(hash(raw.view()), kExpected);
}

}  // namespace
}  // namespace pptam
