// What the renderer draws, by Mesa's software renderer off-screen: images in all formats as they are, pictures that are
// kept, what a picture costs.
#include "platform/run/picture.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <random>
#include <string>
#include <vector>

#include "platform/camera/image_files.h"
#include "platform/run/composer.h"
#include "tests/display/software.h"
#include "tests/support/phone_camera.h"
#include "tests/support/scratch_folder.h"

namespace pptam {
namespace {

using platform::Canvas;
using platform::Scene;

struct Rgb {
  int r, g, b;
};

Rgb at(const std::vector<uint8_t>& rgba, int width, int x, int y) {
  const size_t i = 4 * (static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x));
  return {rgba[i], rgba[i + 1], rgba[i + 2]};
}

int difference(const Rgb& a, const Rgb& b) {
  return std::max({std::abs(a.r - b.r), std::abs(a.g - b.g), std::abs(a.b - b.b)});
}

Scene plain_scene(const Frame& frame, int turn_degrees) {
  Scene scene;
  scene.width = frame.width;
  scene.height = frame.height;
  scene.turn_degrees = turn_degrees;
  scene.view = {0, 0, static_cast<float>(frame.width), static_cast<float>(frame.height)};
  scene.picture.emplace();
  scene.picture->frame = frame;
  return scene;
}

std::vector<uint8_t> noise(size_t bytes, uint64_t seed) {
  std::mt19937_64 random(seed);
  std::vector<uint8_t> values(bytes);
  for (uint8_t& value : values) value = static_cast<uint8_t>(random() >> 56);
  return values;
}

// An image as large as its view is shown with its own values, turned or not, also where its rows have gaps.
TEST(Picture, OfAnImageIsTheImageTurnedEitherWay) {
  constexpr int kWidth = 50, kHeight = 37, kStride = 61;
  const std::vector<uint8_t> pixels = noise(kStride * kHeight, 1);
  const Frame frame = {pixels.data(), kWidth, kHeight, kStride, PixelFormat::kGrey, 0};
  for (const int turn : {0, 90, 180, 270}) {
    const bool lying = turn % 180 != 0;
    const int width = lying ? kHeight : kWidth;
    const int height = lying ? kWidth : kHeight;
    PPTAM_SOFTWARE_DISPLAY(display, width, height);
    std::vector<uint8_t> rgba;
    display->draw(plain_scene(frame, turn), &rgba);
    int worst = 0;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const int u = turn == 0 ? x : turn == 90 ? kHeight - 1 - y : turn == 180 ? kWidth - 1 - x : y;
        const int v = turn == 0 ? y : turn == 90 ? x : turn == 180 ? kHeight - 1 - y : kWidth - 1 - x;
        const int grey = pixels[static_cast<size_t>(y * kStride + x)];
        worst = std::max(worst, difference(at(rgba, width, u, v), {grey, grey, grey}));
      }
    }
    EXPECT_EQ(worst, 0) << turn;
  }
}

// A part of it, turned: what a camera delivers of which the middle is tracked.
TEST(Picture, OfAPartIsThatPartTurned) {
  constexpr int kWidth = 64, kHeight = 48, kX = 10, kY = 4, kPartWidth = 40, kPartHeight = 30;
  const std::vector<uint8_t> pixels = noise(kWidth * kHeight, 4);
  for (const int turn : {0, 90, 180, 270}) {
    const bool lying = turn % 180 != 0;
    const int width = lying ? kPartHeight : kPartWidth;
    const int height = lying ? kPartWidth : kPartHeight;
    PPTAM_SOFTWARE_DISPLAY(display, width, height);
    Scene scene = plain_scene({pixels.data(), width, height, width, PixelFormat::kGrey, 0}, 0);
    scene.picture->frame = {pixels.data(), kWidth, kHeight, kWidth, PixelFormat::kGrey, 0};
    scene.picture->x = kX;
    scene.picture->y = kY;
    scene.picture->width = kPartWidth;
    scene.picture->height = kPartHeight;
    scene.picture->turn_degrees = turn;
    std::vector<uint8_t> rgba, again;
    display->draw(scene, &rgba);
    int worst = 0;
    for (int y = 0; y < kPartHeight; ++y) {
      for (int x = 0; x < kPartWidth; ++x) {
        const int u = turn == 0 ? x : turn == 90 ? kPartHeight - 1 - y : turn == 180 ? kPartWidth - 1 - x : y;
        const int v = turn == 0 ? y : turn == 90 ? x : turn == 180 ? kPartHeight - 1 - y : kPartWidth - 1 - x;
        const int grey = pixels[static_cast<size_t>((kY + y) * kWidth + kX + x)];
        worst = std::max(worst, difference(at(rgba, width, u, v), {grey, grey, grey}));
      }
    }
    EXPECT_LE(worst, 1) << turn;          // places are fractions in float32, and the filter's weights may be 8 bits
    scene.picture->frame.data = nullptr;  // the same once more
    display->draw(scene, &again);
    EXPECT_EQ(rgba, again);
  }
}

// One of two that goes leaves the other as it was.
TEST(Displays, DoNotTakeEachOthersPictures) {
  constexpr int kSide = 32;
  const std::vector<uint8_t> pixels = noise(kSide * kSide, 5);
  const Scene scene = plain_scene({pixels.data(), kSide, kSide, kSide, PixelFormat::kGrey, 0}, 0);
  PPTAM_SOFTWARE_DISPLAY(stays, kSide, kSide);
  std::vector<uint8_t> before, after;
  stays->draw(scene, &before);
  {
    PPTAM_SOFTWARE_DISPLAY(goes, kSide, kSide);
    goes->draw(scene, nullptr);
    stays->draw(scene, nullptr);  // its context is current when the other one goes
  }
  stays->draw(scene, &after);
  EXPECT_EQ(before, after);
  EXPECT_EQ(at(after, kSide, 3, 2).r, pixels[2 * kSide + 3]);
}

Rgb bt601(int y, int u, int v) {
  const double luma = 255.0 / 219 * (y - 16);
  const auto byte = [](double value) { return static_cast<int>(std::lround(std::clamp(value, 0.0, 255.0))); };
  return {byte(luma + 1.596 * (v - 128)), byte(luma - 0.392 * (u - 128) - 0.813 * (v - 128)),
          byte(luma + 2.017 * (u - 128))};
}

// Colours of every format: blocks of 4x4 pixels have one colour each, judged in their middle, where no neighbour's
// chroma is mixed in.
TEST(Picture, OfColoursIsThatOfTheFormat) {
  constexpr int kWidth = 32, kHeight = 24;
  const std::vector<uint8_t> random = noise(3 * 48, 2);
  const auto block = [&](int x, int y) { return &random[static_cast<size_t>(3 * (y / 4 * (kWidth / 4) + x / 4))]; };
  std::vector<uint8_t> rgb, bgra, luma, yuyv, nv12, nv21, u_plane, v_plane;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const uint8_t* c = block(x, y);
      rgb.insert(rgb.end(), {c[0], c[1], c[2]});
      bgra.insert(bgra.end(), {c[2], c[1], c[0], 0});
      luma.push_back(c[0]);
      yuyv.insert(yuyv.end(), {c[0], x % 2 == 0 ? c[1] : c[2]});
      if (x % 2 != 0 || y % 2 != 0) continue;
      nv12.insert(nv12.end(), {c[1], c[2]});
      nv21.insert(nv21.end(), {c[2], c[1]});
      u_plane.push_back(c[1]);
      v_plane.push_back(c[2]);
    }
  }
  const struct {
    PixelFormat format;
    const std::vector<uint8_t>*pixels, *chroma, *second;
    int bytes_per_pixel;
  } kCases[] = {{PixelFormat::kRgb24, &rgb, nullptr, nullptr, 3}, {PixelFormat::kBgra, &bgra, nullptr, nullptr, 4},
                {PixelFormat::kYuyv, &yuyv, nullptr, nullptr, 2}, {PixelFormat::kNv12, &luma, &nv12, nullptr, 1},
                {PixelFormat::kNv21, &luma, &nv21, nullptr, 1},   {PixelFormat::kI420, &luma, &u_plane, &v_plane, 1},
                {PixelFormat::kNv12, &luma, nullptr, nullptr, 1}};
  PPTAM_SOFTWARE_DISPLAY(display, kWidth, kHeight);
  for (const auto& of : kCases) {
    const int stride = kWidth * of.bytes_per_pixel;
    Scene scene = plain_scene({of.pixels->data(), kWidth, kHeight, stride, of.format, 0}, 0);
    if (of.chroma != nullptr) scene.picture->chroma[0] = of.chroma->data();
    if (of.second != nullptr) scene.picture->chroma[1] = of.second->data();
    scene.picture->chroma_stride_bytes = of.second != nullptr ? kWidth / 2 : kWidth;
    std::vector<uint8_t> rgba;
    display->draw(scene, &rgba);
    const bool coloured = of.format == PixelFormat::kYuyv || of.chroma != nullptr;
    int worst = 0;
    for (int y = 1; y < kHeight; y += 4) {
      for (int x = 1; x < kWidth; x += 4) {
        const uint8_t* c = block(x, y);
        const Rgb expected = coloured                 ? bt601(c[0], c[1], c[2])
                             : of.bytes_per_pixel > 1 ? Rgb{c[0], c[1], c[2]}
                                                      : Rgb{c[0], c[0], c[0]};
        worst = std::max(worst, difference(at(rgba, kWidth, x, y), expected));
      }
    }
    // Chroma a quarter of a sample from its centre takes up to a quarter of nothing else: the block's own. Rounding of
    // the coefficients to three digits and of the result: 0.0005 * 128 * 2 + 0.5, and the renderer's own 0.5.
    EXPECT_LE(worst, 2) << "format " << static_cast<int>(of.format) << (coloured ? "" : " without chroma");
  }
}

// Letters are cairo's own, put where it would put them: beside a text that it writes itself, whichever font there is.
TEST(Picture, OfATextIsThatOfCairo) {
  constexpr int kWidth = 400, kHeight = 40;
  PPTAM_SOFTWARE_DISPLAY(display, kWidth, kHeight);
  const std::string text = "Tracking: quality good, 48 of 50 (0.13 px)";
  for (const float unit : {1.0f, 1.4f}) {
    const platform::Lettering lettering(unit);
    Scene scene;
    scene.width = kWidth;
    scene.height = kHeight;
    scene.letters = &lettering.image();
    lettering.add(platform::TextStyle::kSmall, 5, 30, text, {255, 255, 255, 255}, &scene.glyphs);
    std::vector<uint8_t> rgba;
    display->draw(scene, &rgba);

    const platform::Surface surface = platform::make_surface(kWidth, kHeight);
    const platform::Context context(cairo_create(surface.get()));
    cairo_font_options_t* options = cairo_font_options_create();
    cairo_font_options_set_antialias(options, CAIRO_ANTIALIAS_GRAY);
    cairo_set_font_options(context.get(), options);
    cairo_font_options_destroy(options);
    cairo_select_font_face(context.get(), "sans", CAIRO_FONT_SLANT_NORMAL, CAIRO_FONT_WEIGHT_NORMAL);
    cairo_set_font_size(context.get(), 13 * static_cast<double>(unit));
    cairo_set_source_rgb(context.get(), 1, 1, 1);
    cairo_move_to(context.get(), 5, 30);
    cairo_show_text(context.get(), text.c_str());
    cairo_surface_flush(surface.get());
    const unsigned char* pixels = cairo_image_surface_get_data(surface.get());
    int worst = 0;
    int lit = 0;
    for (int y = 0; y < kHeight; ++y) {
      const unsigned char* row = pixels + y * cairo_image_surface_get_stride(surface.get());
      for (int x = 0; x < kWidth; ++x) {
        worst = std::max(worst, std::abs(at(rgba, kWidth, x, y).g - row[4 * x + 1]));
        lit += row[4 * x + 1] > 128;
      }
    }
    if (lit == 0) GTEST_SKIP() << "there is no font here";
    EXPECT_LE(worst, 1) << unit;
  }
}

// ---- Pictures that are kept --------------------------------------------------------------------------------------

struct Kept {
  std::string name;
  platform::CameraInfo camera;
  SE3 T_cw;
  Vector6f velocity = Vector6f::Zero();
  bool from_above = false;
};

std::vector<Kept> kept_pictures() {
  Kept phone;
  phone.name = "phone";
  phone.camera.model = test::phone_camera();
  phone.camera.shutter = test::phone_shutter();
  phone.camera.frames_per_s = 15;
  phone.T_cw.R << 1, 0, 0, 0, -0.8f, -0.6f, 0, 0.6f, -0.8f;
  phone.T_cw.t = Vector3f(0.05f, 0, 1);
  phone.velocity << 0.1f, 0.05f, 0, 0.1f, 0.4f, -0.3f;
  Kept wide = phone;
  wide.name = "wide";
  wide.camera.model.width = 320;
  wide.camera.model.height = 240;
  wide.camera.model.fx = wide.camera.model.fy = 160;
  wide.camera.model.cx = 159.5f;
  wide.camera.model.cy = 119.5f;
  wide.camera.model.distortion = Distortion::kFov;
  wide.camera.model.coeffs[0] = 0.9f;
  wide.camera.model.prepare();
  wide.camera.shutter = {};
  Kept above = phone;
  above.name = "above";
  above.from_above = true;
  return {phone, wide, above};
}

// Without letters: those are the system's.
std::vector<uint8_t> drawn(const Kept& kept, bool changed, int* width, int* height) {
  const CameraModel& model = kept.camera.model;
  std::vector<uint8_t> pixels;
  for (int y = 0; y < model.height; ++y) {
    for (int x = 0; x < model.width; ++x) pixels.push_back(static_cast<uint8_t>(60 + (x / 8 * 5 + y / 8 * 3) % 120));
  }
  const Frame frame = {pixels.data(), model.width, model.height, model.width, PixelFormat::kGrey, 0};
  TrackResult result;
  result.pose_valid = true;
  result.map = result.maps = 1;
  result.state = TrackingState::kTracking;
  result.T_cw = kept.T_cw;
  result.velocity = kept.velocity;
  std::vector<ObservedPoint> points;
  for (int i = 0; i < 24; ++i) {
    ObservedPoint point;
    point.px = Vector2f(static_cast<float>(10 + i * 31 % 220), static_cast<float>(10 + i * 47 % 220));
    point.predicted_px = point.px + Vector2f(4, 3);
    point.kind = static_cast<ObservedKind>(i % 6);
    points.push_back(point);
  }
  result.points = points;
  platform::FrameLog log;
  log.state = result.state;
  log.quality = TrackingQuality::kGood;
  log.pose_valid = true;
  log.track_ns = 30'000'000;
  platform::Composer composer(kept.camera);
  const Canvas canvas = {model.width, model.height + 40, 0};
  std::vector<MapPointInfo> map(40);
  for (size_t i = 0; i < map.size(); ++i)
    map[i].p_w = Vector3f(0.02f * static_cast<float>(i % 8) - 0.1f, 0.03f * static_cast<float>(i / 8), 0.01f);
  const std::vector<KeyframeInfo> keyframes = {{1, 0, kept.T_cw}};
  Scene scene = composer.camera_view({frame}, result, log, canvas);
  if (kept.from_above) scene = composer.map_view(result, log, map, keyframes, canvas);
  scene.glyphs.clear();
  if (changed) scene.eye->T_cw.t.x() += 0.01f;
  *width = canvas.width;
  *height = canvas.height;
  const std::unique_ptr<platform::Display> display = test::software_display(canvas.width, canvas.height);
  std::vector<uint8_t> rgba;
  if (display) display->draw(scene, &rgba);
  return rgba;
}

// What is near in the camera's depth, not by its distance, is cut off: at the side of a wide view a house is nearer.
TEST(ComposedHouse, IsDrawnWholeAtTheSideOfAWideView) {
  Kept wide = kept_pictures()[1];
  wide.camera.model.distortion = Distortion::kEquidistant;
  wide.camera.model.coeffs[0] = 0;
  wide.camera.model.fx = wide.camera.model.fy = 110;  // 83 degrees to each side
  wide.camera.model.prepare();
  platform::Composer composer(wide.camera);
  TrackResult result;
  result.pose_valid = true;
  result.map = result.maps = 1;
  result.state = TrackingState::kTracking;
  result.T_cw = wide.T_cw;
  const std::vector<uint8_t> pixels(320 * 240, 90);
  const platform::Picture picture = {{pixels.data(), 320, 240, 320, PixelFormat::kGrey, 0}};
  const Canvas canvas = {320, 280, 0};
  int red[3] = {0, 0, 0};  // of the roof: ahead; aside, as composed; control: cut off at half of its distance
  for (const int which : {0, 1, 2}) {
    SE3 aside;
    const float angle = which == 0 ? 0 : 1.2f;
    aside.R << std::cos(angle), 0, std::sin(angle), 0, 1, 0, -std::sin(angle), 0, std::cos(angle);
    composer.camera_view(picture, result, {}, canvas);  // places the house
    TrackResult turned = result;
    turned.T_cw = aside * result.T_cw;
    Scene scene = composer.camera_view(picture, turned, {}, canvas);
    scene.glyphs.clear();
    if (which == 2) {
      const float distance = (composer.site()->anchor_w - turned.T_cw.centre()).norm();
      scene.eye->near_faces_z = 0.5f * (distance - composer.site()->house_size);
    }
    PPTAM_SOFTWARE_DISPLAY(display, canvas.width, canvas.height);
    std::vector<uint8_t> rgba;
    display->draw(scene, &rgba);
    for (int y = 0; y < 240; ++y) {
      for (int x = 0; x < 320; ++x) {
        const Rgb p = at(rgba, canvas.width, x, y);
        red[which] += p.r > 100 && p.r > 2 * p.g ? 1 : 0;
      }
    }
  }
  std::printf("  pixels of the roof: %d ahead, %d aside, %d by its distance\n", red[0], red[1], red[2]);
  EXPECT_GT(red[0], 100);
  EXPECT_GT(red[1], 100);
  EXPECT_LT(red[2], red[1] / 2) << "control";
}

// A house of one map does not stand in the next one, even if nothing was drawn between the two.
TEST(ComposedHouse, GoesWithItsMap) {
  platform::Composer composer(kept_pictures()[0].camera);
  TrackResult result;
  result.pose_valid = true;
  result.map = result.maps = 1;
  result.state = TrackingState::kTracking;
  result.T_cw = kept_pictures()[0].T_cw;
  composer.follow(result);
  ASSERT_TRUE(composer.site());
  const Vector3f first_w = composer.site()->anchor_w;
  result.T_cw.t.x() += 1;
  composer.follow(result);
  EXPECT_EQ(composer.site()->anchor_w, first_w) << "control: the same map";
  result.map = result.maps = 2;
  result.T_cw.t.x() += 1;
  composer.follow(result);
  EXPECT_NE(composer.site()->anchor_w, first_w);
  result.map = 1;
  composer.follow(result);
  EXPECT_EQ(composer.site()->anchor_w, first_w) << "the first map again";
  TrackResult between;  // all maps are gone
  between.state = TrackingState::kInitialising;
  composer.follow(between);
  EXPECT_FALSE(composer.site());
  result.map = 3;
  result.maps = 1;
  composer.follow(result);
  EXPECT_NE(composer.site()->anchor_w, first_w);
}

// Kept as PNG; compared as grey, and what is no more than one level off is the same: versions of Mesa round otherwise.
// A pixel in ten thousand may be anything, where an edge meets a pixel's centre. PPTAM_UPDATE_GOLDEN=1 writes them
// anew: look at them.
TEST(Picture, IsTheOneThatWasKept) {
  const test::ScratchFolder scratch;
  for (const Kept& kept : kept_pictures()) {
    const std::filesystem::path golden = std::filesystem::path(PPTAM_GOLDEN) / (kept.name + ".png");
    int width = 0;
    int height = 0;
    for (const bool changed : {false, true}) {
      const std::vector<uint8_t> rgba = drawn(kept, changed, &width, &height);
      if (rgba.empty()) GTEST_SKIP() << "nothing can be drawn here";
      const std::filesystem::path file =
          std::getenv("PPTAM_UPDATE_GOLDEN") != nullptr && !changed ? golden : scratch / (kept.name + ".png");
      std::ofstream(file, std::ios::binary) << platform::png_of_rgba(rgba, width, height);
      const platform::GreyPixels is = platform::read_image(file);
      const platform::GreyPixels wanted = platform::read_image(golden);
      ASSERT_EQ(is.px.size(), wanted.px.size());
      size_t off = 0;
      for (size_t i = 0; i < is.px.size(); ++i) off += std::abs(is.px[i] - wanted.px[i]) > 1;
      if (changed) {
        EXPECT_GT(off, is.px.size() / 1000) << kept.name << ": control: the world a hundredth of its distance aside";
      } else {
        EXPECT_LE(off, is.px.size() / 10000) << kept.name;
      }
    }
  }
}

// ---- Cost --------------------------------------------------------------------------------------------------------

double cpu_s() {
  timespec now = {};
  ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

// All of an overlay's picture beside its image alone over the whole canvas, turn by turn: time of all of the process'
// threads, the least of each of twenty.
TEST(Cost, OfAnOverlayIsAtMostThreeTimesThatOfItsImage) {
  platform::CameraInfo camera;
  camera.model = test::phone_camera();
  camera.shutter = test::phone_shutter();
  camera.frames_per_s = 15;
  const std::vector<uint8_t> pixels = noise(240 * 320, 3);
  const Frame frame = {pixels.data(), 240, 320, 240, PixelFormat::kGrey, 0};
  TrackResult result;
  result.pose_valid = true;
  result.map = result.maps = 1;
  result.state = TrackingState::kTracking;
  result.T_cw = kept_pictures()[0].T_cw;
  result.velocity = kept_pictures()[0].velocity;
  std::vector<ObservedPoint> points(62);
  for (size_t i = 0; i < points.size(); ++i) {
    points[i].px = Vector2f(static_cast<float>(i * 37 % 240), static_cast<float>(i * 53 % 320));
    points[i].kind = i < 50 ? ObservedKind::kInlier : ObservedKind::kPartial;
  }
  result.points = points;
  platform::FrameLog log;
  log.state = result.state;
  log.pose_valid = true;
  platform::Composer composer(camera);
  const Canvas usual = composer.usual_canvas();
  for (const Canvas& canvas : {usual, Canvas{240, 353, 0}}) {
    PPTAM_SOFTWARE_DISPLAY(display, canvas.width, canvas.height);
    Scene alone = plain_scene(frame, 0);
    alone.width = canvas.width;
    alone.height = canvas.height;
    alone.view = {0, 0, static_cast<float>(canvas.width), static_cast<float>(canvas.height)};
    const Scene& whole = composer.camera_view({frame}, result, log, canvas);
    double least[2] = {1e9, 1e9};
    std::vector<uint8_t> rgba;
    for (int turn = 0; turn < 23; ++turn) {
      for (const int which : {0, 1}) {
        const double from_s = cpu_s();
        display->draw(which == 0 ? alone : whole, &rgba);
        if (turn >= 3) least[which] = std::min(least[which], cpu_s() - from_s);  // the first ones compile
      }
    }
    std::printf("  %dx%d: overlay / image alone = %.2f\n", canvas.width, canvas.height, least[1] / least[0]);
    EXPECT_LE(least[1], 3 * least[0]) << canvas.width;
  }
}

}  // namespace
}  // namespace pptam
