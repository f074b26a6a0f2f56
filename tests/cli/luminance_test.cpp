// Raw images of each format: which pixels come out, and that no buffer, however short or wrong, does harm.
#include "platform/camera/luminance.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <random>
#include <vector>

#include "tests/support/jpeg.h"

namespace pptam::platform {
namespace {

using Bytes = std::vector<uint8_t>;

DeviceFrame frame_of(const Bytes& bytes, int width, int height, int stride, PixelLayout layout) {
  DeviceFrame frame;
  frame.data = bytes.data();
  frame.bytes = bytes.size();
  frame.width = width;
  frame.height = height;
  frame.stride = stride;
  frame.layout = layout;
  return frame;
}

uint8_t pattern(int x, int y) {
  return static_cast<uint8_t>(40 + 3 * x + 5 * y);
}

// A soft picture, which JPEG keeps to a few greys.
Bytes jpeg_of(int width, int height, bool progressive = false) {
  Bytes grey;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) grey.push_back(static_cast<uint8_t>(60 + x / 3 + y / 2));
  }
  return test::encode_jpeg(width, height, grey, 95, progressive);
}

TEST(Luminance, PlanesAreUsedInPlace) {
  for (const int width : {64, 65, 101}) {
    for (const int stride : {width, width + 1, width + 63}) {
      constexpr int kHeight = 67;
      Bytes bytes(static_cast<size_t>(stride * (kHeight - 1) + width), 9);
      for (int y = 0; y < kHeight; ++y) {
        for (int x = 0; x < width; ++x) bytes[static_cast<size_t>(y * stride + x)] = pattern(x, y);
      }
      Luminance luminance;
      GreyView view;
      ASSERT_TRUE(luminance.read(frame_of(bytes, width, kHeight, stride, PixelLayout::kGrey), &view));
      EXPECT_EQ(view.data, bytes.data());
      EXPECT_EQ(view.at(width - 1, kHeight - 1), pattern(width - 1, kHeight - 1));
      bytes.pop_back();
      EXPECT_FALSE(luminance.read(frame_of(bytes, width, kHeight, stride, PixelLayout::kGrey), &view));
    }
  }
}

TEST(Luminance, YuyvIsEverySecondByte) {
  for (const int width : {64, 65}) {
    const int stride = 2 * width + 6;
    constexpr int kHeight = 65;
    Bytes bytes(static_cast<size_t>(stride * kHeight), 200);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < width; ++x) bytes[static_cast<size_t>(y * stride + 2 * x)] = pattern(x, y);
    }
    Luminance luminance;
    GreyView view;
    ASSERT_TRUE(luminance.read(frame_of(bytes, width, kHeight, stride, PixelLayout::kYuyv), &view));
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < width; ++x) ASSERT_EQ(view.at(x, y), pattern(x, y)) << x << " " << y;
    }
    EXPECT_FALSE(luminance.read(frame_of(bytes, width, kHeight, width, PixelLayout::kYuyv), &view));
    bytes.resize(static_cast<size_t>(stride * (kHeight - 1) + 2 * width - 1));
    EXPECT_FALSE(luminance.read(frame_of(bytes, width, kHeight, stride, PixelLayout::kYuyv), &view));
  }
}

TEST(Luminance, JpegIsNearItsSource) {
  for (const int width : {64, 95, 320}) {
    const Bytes bytes = jpeg_of(width, 77);
    Luminance luminance;
    GreyView view;
    ASSERT_TRUE(luminance.read(frame_of(bytes, width, 77, 0, PixelLayout::kMjpeg), &view)) << luminance.trouble();
    int worst = 0;
    for (int y = 0; y < 77; ++y) {
      for (int x = 0; x < width; ++x) worst = std::max(worst, std::abs(view.at(x, y) - (60 + x / 3 + y / 2)));
    }
    EXPECT_LE(worst, 4);  // the coarsest step of quality 95's table is 12: half of it, spread over a block
  }
}

// Many cameras leave out the tables, which are always the same.
TEST(Luminance, JpegWithoutHuffmanTables) {
  const Bytes whole = jpeg_of(128, 96);
  Bytes bare(whole.begin(), whole.begin() + 2);
  for (size_t at = 2; at + 4 < whole.size();) {
    const uint8_t marker = whole[at + 1];
    const size_t length = 2 + static_cast<size_t>(whole[at + 2]) * 256 + whole[at + 3];
    if (marker == 0xda) {
      bare.insert(bare.end(), whole.begin() + static_cast<ptrdiff_t>(at), whole.end());
      break;
    }
    if (marker != 0xc4)
      bare.insert(bare.end(), whole.begin() + static_cast<ptrdiff_t>(at),
                  whole.begin() + static_cast<ptrdiff_t>(at + length));
    at += length;
  }
  ASSERT_LT(bare.size() + 400, whole.size());
  Luminance luminance, bare_luminance;
  GreyView view, bare_view;
  ASSERT_TRUE(luminance.read(frame_of(whole, 128, 96, 0, PixelLayout::kMjpeg), &view));
  ASSERT_TRUE(bare_luminance.read(frame_of(bare, 128, 96, 0, PixelLayout::kMjpeg), &bare_view))
      << bare_luminance.trouble();
  EXPECT_TRUE(std::equal(view.data, view.data + 128 * 96, bare_view.data));
}

TEST(Luminance, DamagedJpegsAreRefused) {
  const Bytes whole = jpeg_of(320, 240);
  Luminance luminance;
  GreyView view;
  const auto reads = [&](const Bytes& bytes, int width = 320, int height = 240) {
    return luminance.read(frame_of(bytes, width, height, 0, PixelLayout::kMjpeg), &view);
  };
  ASSERT_TRUE(reads(whole));
  Bytes followed = whole;  // a buffer's rest
  followed.resize(whole.size() + 5000, 0);
  EXPECT_TRUE(reads(followed)) << luminance.trouble();
  for (size_t bytes = 1; bytes + 2 < whole.size(); bytes += 37) {
    EXPECT_FALSE(reads(Bytes(whole.begin(), whole.begin() + static_cast<ptrdiff_t>(bytes)))) << bytes;
  }
  EXPECT_FALSE(reads(whole, 640, 480));
  EXPECT_TRUE(luminance.trouble().find("size") != std::string::npos);
  EXPECT_FALSE(reads(jpeg_of(320, 240, true)));
  EXPECT_FALSE(reads({}));
  EXPECT_TRUE(reads(whole));  // nothing sticks
}

TEST(Luminance, GarbageWithoutEnd) {
  std::mt19937 random(20240711);
  Luminance luminance;
  GreyView view;
  const Bytes whole = jpeg_of(160, 120);
  for (int round = 0; round < 400; ++round) {
    Bytes bytes;
    if (round % 2 == 0) {
      bytes.resize(1 + random() % 20000);
      for (uint8_t& byte : bytes) byte = static_cast<uint8_t>(random());
      if (round % 4 == 0 && bytes.size() > 4) bytes[0] = 0xff, bytes[1] = 0xd8;
    } else {
      bytes = whole;
      for (int i = 0; i < 1 + round % 7; ++i) bytes[random() % bytes.size()] = static_cast<uint8_t>(random());
    }
    for (const PixelLayout layout : {PixelLayout::kMjpeg, PixelLayout::kYuyv, PixelLayout::kGrey}) {
      view = {};
      if (!luminance.read(frame_of(bytes, 160, 120, 160, layout), &view)) continue;
      EXPECT_EQ(view.width, 160);
      int sum = 0;
      for (int y = 0; y < 120; ++y) sum += view.at(159, y);  // all of it is there: sanitizers look
      EXPECT_GE(sum, 0);
    }
  }
}

}  // namespace
}  // namespace pptam::platform
