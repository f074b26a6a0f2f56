// Reading models and poses: the whole of .cao V1, OBJ, .pos, matrices, points; and files that are none.
#include "platform/model/model_file.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>

#include "platform/input_error.h"
#include "tests/support/random.h"
#include "tests/support/scratch_folder.h"

namespace pptam::platform {
namespace {

namespace fs = std::filesystem;

constexpr const char* kWhole =
    "# a comment before\r\n"
    "V1\r\n"
    "6 # points\r\n"
    "0 0 0\r\n"
    "1 0 0   # X Y Z\r\n"
    "1 1 0\r\n"
    "0 1 0\r\n"
    "0.5 0.5 1\r\n"
    "+5e-1 .5 -1\r\n"
    "# 3D lines\r\n"
    "5\r\n"
    "0 1\r\n"
    "2 1\r\n"
    "2 3\r\n"
    "3 0\r\n"
    "0 4 name=mast useLod=true minLineLengthThreshold=20\r\n"
    "2\r\n"
    "4 0 1 2 3 name=ground useLod=true\r\n"
    "2 1 2\r\n"
    "1\r\n"
    "3 0 1 4\r\n"
    "1\r\n"
    "4 5 0.25 name=pole\r\n"
    "1\r\n"
    "0.5 4 0 1 useLod=true\r\n"
    "1\r\n"
    "0.125 5 useLod=true minPolygonAreaThreshold=7";

class ModelFiles : public ::testing::Test {
 protected:
  fs::path write(const std::string& name, const std::string& text) {
    std::ofstream(folder_.path() / name, std::ios::binary) << text;
    return folder_.path() / name;
  }
  std::string error_of(const std::string& text, const std::string& name = "bad.cao") {
    try {
      read_model(write(name, text));
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  }
  // That the file is refused where it says so.
  void expect_refused(const std::string& text, int line, const std::string& what) {
    const std::string error = error_of(text);
    EXPECT_NE(error.find("bad.cao:" + std::to_string(line) + ": "), std::string::npos) << error << "\n" << text;
    EXPECT_NE(error.find(what), std::string::npos) << error;
  }
  test::ScratchFolder folder_;
};

TEST_F(ModelFiles, TheWholeFormat) {
  const ModelFile model = read_model(write("whole.cao", kWhole));
  EXPECT_EQ(model.points.size(), 6u);
  EXPECT_EQ(model.points[5], Vector3f(0.5f, 0.5f, -1));
  ASSERT_EQ(model.lines.size(), 1u) << "those in faces belong to the faces";
  EXPECT_EQ(model.lines[0].b, 4);
  EXPECT_EQ(model.lines[0].min_length_px, 20);
  ASSERT_EQ(model.faces.size(), 3u);
  EXPECT_FALSE(model.faces[0].open);
  EXPECT_EQ(model.faces[0].count, 4);
  EXPECT_EQ(model.faces[0].min_area_px2, 2500);
  EXPECT_EQ(model.faces[0].min_length_px, 50);
  const int square[] = {0, 1, 2, 3};
  for (int i = 0; i < 4; ++i)
    EXPECT_EQ(model.corners[static_cast<size_t>(i)], square[i]) << "the second line runs back";
  EXPECT_TRUE(model.faces[1].open);
  EXPECT_EQ(model.faces[1].count, 3);
  EXPECT_EQ(model.faces[1].min_area_px2, 0);
  EXPECT_FALSE(model.faces[2].open);
  ASSERT_EQ(model.cylinders.size(), 1u);
  EXPECT_EQ(model.cylinders[0].radius, 0.25f);
  ASSERT_EQ(model.circles.size(), 1u);
  EXPECT_EQ(model.circles[0].centre, Vector3f(0.5f, 0.5f, 1));
  EXPECT_GT(model.circles[0].normal.dot(Vector3f(0, -1, 0.5f)), 1.1f)
      << "its points run counter-clockwise, seen from there";
  ASSERT_EQ(model.spheres.size(), 1u);
  EXPECT_EQ(model.spheres[0].radius, 0.125f);
  EXPECT_EQ(model.circles[0].min_area_px2, 2500);
  EXPECT_EQ(model.spheres[0].min_area_px2, 7);
  EXPECT_TRUE(model.view().validate().ok());
}

TEST_F(ModelFiles, LoadedFilesAreMoved) {
  write("part.cao", "V1\n2\n1 0 0\n0 0 2\n1\n0 1\n0\n0\n0");
  const ModelFile model =
      read_model(write("all.cao",
                       "V1\nload(\"part.cao\")\nload(\"part.cao\", t=[0; 0; 5], tu=[0; 0; 90 deg])\n"
                       "load( \"part.cao\" , R=[0 -1 0; 1 0 0; 0 0 1])\n"));
  ASSERT_EQ(model.points.size(), 6u);
  EXPECT_LT((model.points[2] - Vector3f(0, 1, 5)).norm(), 1e-6f);
  EXPECT_LT((model.points[4] - Vector3f(0, 1, 0)).norm(), 1e-6f);
  ASSERT_EQ(model.lines.size(), 3u);
  EXPECT_EQ(model.lines[2].b, 5);
  EXPECT_EQ(model.files.size(), 4u);
  // By absolute paths and from above, as users' models do.
  fs::create_directory(folder_.path() / "below");
  const std::string absolute = (folder_.path() / "part.cao").string();
  EXPECT_EQ(
      read_model(write("below/other.cao", "V1\nload(\"../part.cao\")\nload(\"" + absolute + "\")\n")).lines.size(), 2u);
}

// Lines that hold nothing cost no memory, and files that load each other end.
TEST_F(ModelFiles, LargeFilesAreRefused) {
  const std::string blank(size_t{5} << 20, '\n');
  write("a.cao", "V1\nload(\"b.cao\")\n" + blank);
  write("b.cao", "V1\nload(\"c.cao\")\n" + blank);
  write("c.cao", "V1\nload(\"a.cao\")\n");
  EXPECT_NE(error_of("V1\nload(\"c.cao\")\n").find("a.cao:2: the files that are loaded have more than 8 MB"),
            std::string::npos);
  write("b.cao", "V1\nload(\"c.cao\")\n");
  EXPECT_NE(error_of("V1\nload(\"c.cao\")\n").find("b.cao:2: it is being read already"), std::string::npos);
}

TEST_F(ModelFiles, WrongFilesAreRefusedByLine) {
  expect_refused("V2\n", 1, "V1");
  expect_refused("V1\n2\n0 0 0\n0 0\n", 4, "needs 3 numbers");
  expect_refused("V1\n2\n0 0 0\n0 0 x\n", 4, "'x'");
  expect_refused("V1\n2\n0 0 0\n0 0 nan\n", 4, "'nan'");
  expect_refused("V1\n2\n0 0 0\n0 0 1e9\n", 4, "1e6");
  expect_refused("V1\n2\n0 0 0\n", 3, "the file ends where there should be a point");
  expect_refused("V1\n-1\n", 2, "0 to 4096");
  expect_refused("V1\n99999999999999999999\n", 2, "not a whole number");
  expect_refused("V1\n2\n0 0 0\n0 0 1\n1\n0 2\n", 6, "point 2 does not exist");
  expect_refused("V1\n2\n0 0 0\n0 0 0\n1\n0 1\n", 6, "not at the same place");
  expect_refused("V1\n3\n0 0 0\n0 0 1\n0 1 0\n2\n0 1\n2 0\n1\n2 0 0\n0\n0\n", 10, "not at the same place");
  expect_refused("V1\n3\n0 0 0\n0 0 1\n0 1 0\n0\n0\n1\n4 0 1 2\n", 9, "not the 4 it says");
  expect_refused("V1\n3\n0 0 0\n0 0 1\n0 1 0\n0\n0\n1\n3 0 1 2 colour=red\n", 9, "no such attribute");
  expect_refused("V1\n3\n0 0 0\n0 0 1\n0 1 0\n0\n0\n1\n3 0 1 2 useLod=maybe\n", 9, "neither true nor false");
  expect_refused("V1\n2\n0 0 0\n0 0 1\n0\n0\n0\n1\n0 1 -3\n", 9, "radius");
  expect_refused("V1\n3\n0 0 0\n0 0 1\n0 0 2\n0\n0\n0\n0\n1\n1 0 1 2\n", 11, "in a line");
  expect_refused("V1\n2\n0 0 0\n0 0 1\n1\n0 1\n0\n0\n0\n0\n0\nmore\n", 12, "more after the last section");
  expect_refused("V1\nload(part.cao)\n", 2, "load(");
  expect_refused("V1\nload(\"missing.cao\")\n", 2, "there is no file");
  expect_refused("V1\nload(\"bad.cao\")\n", 2, "load themselves");
  write("part.cao", "V1\n2\n1 0 0\n0 0 2\n1\n0 1\n0\n0\n0");
  expect_refused("V1\nload(\"part.cao\", t=[1; 2])\n", 2, "needs 3 numbers");
  expect_refused("V1\nload(\"part.cao\", R=[1 0 0 0 1 0 0 0 2])\n", 2, "not a rotation");
  expect_refused("V1\nload(\"./bad.cao\")\n", 2, "load themselves");
  EXPECT_NE(error_of("V1\nload(\"part.cao\", t=[1000000; 0; 0])\n").find("part.cao:3: the point is not within 1e6"),
            std::string::npos);
  // Of all files together, at the line that goes too far.
  std::string lines = "V1\n2\n1 0 0\n0 0 2\n3000\n", loads = "V1\nload(\"many.cao\")\nload(\"many.cao\")\n";
  for (int i = 0; i < 3000; ++i) lines += "0 1\n";
  write("many.cao", lines + "0\n0\n0\n");
  EXPECT_NE(error_of(loads).find("many.cao:3006: more than 4096 lines"), std::string::npos) << error_of(loads);
  EXPECT_NE(error_of("V1\n0\n0\n0\n0\n0\n").find("nothing to track"), std::string::npos);
  EXPECT_NE(error_of("").find("is empty"), std::string::npos);
}

TEST_F(ModelFiles, WavefrontObj) {
  const ModelFile model =
      read_model(write("cube.obj",
                       "# a cube\nmtllib x.mtl\no cube\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1 1.0\n"
                       "v 1 0 1\nv 1 1 1\nv 0 1 1\nv 0 0 0\nvn 0 0 1\nvt 0 0\ns off\n"
                       "f 1/1/1 4/1/1 3/1/1 2/1/1\nf 5//1 6//1 7//1\nf -5 7 8\nf 9 2 6 5\nl 1 7\n"));
  EXPECT_EQ(model.points.size(), 8u) << "vertices at the same place are one";
  EXPECT_EQ(model.faces.size(), 4u);
  EXPECT_EQ(model.lines.size(), 1u);
  EXPECT_TRUE(model.outlines_of_smooth);
  EXPECT_TRUE(model.view().validate().ok());
  // Corners in a line and pieces of no width have no area; corners at nearly the same place are one.
  const ModelFile thin = read_model(write("thin.obj",
                                          "v 0 0 0\nv 1 0 0\nv 2 0 0\nv 1 1e-7 0\nv 1 1 0\nv 0 0 1e-6\n"
                                          "f 1 2 3\nf 1 3 4\nf 1 3 5 6\nf 1 2 1\n"));
  ASSERT_EQ(thin.faces.size(), 1u);
  EXPECT_EQ(thin.faces[0].count, 3);
  EXPECT_NE(error_of("v 0 0 0\nv 0 0 1\nv 0 1 0\nf 1 2 4\n", "bad.obj").find("bad.obj:4: vertex '4' does not exist"),
            std::string::npos);
  EXPECT_NE(error_of("v 0 0\n", "bad.obj").find("bad.obj:1: "), std::string::npos);
}

TEST_F(ModelFiles, PosesAndPoints) {
  const SE3 pos = read_object_pose(write("a.pos", "0.1\n0.2 \n 0.5\n0\n0\n1.5707963\n"));
  EXPECT_LT((pos * Vector3f(1, 0, 0) - Vector3f(0.1f, 1.2f, 0.5f)).norm(), 1e-6f);
  const SE3 matrix = read_object_pose(write("a.txt", "0 -1 0 0.1\n1 0 0 0.2\n0 0 1 0.5\n0 0 0 1\n"));
  EXPECT_LT((matrix.R - pos.R).norm(), 1e-6f);
  EXPECT_THROW(read_object_pose(write("b.txt", "1 2 3\n")), InputError);
  EXPECT_THROW(read_object_pose(write("b.txt", "2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1\n")), InputError);
  const SeenPoints seen =
      read_seen_points(write("a.points", "4\n0 0 0 1 2\n1 0 0 3 4\n1 1 0 5 6 # last\n0 1 0 7 8.5\n"));
  ASSERT_EQ(seen.px.size(), 4u);
  EXPECT_EQ(seen.px[3], Vector2f(7, 8.5f));
  EXPECT_THROW(read_seen_points(write("b.points", "3\n0 0 0 1 2\n1 0 0 3 4\n1 1 0 5 6\n")), InputError);
  EXPECT_THROW(read_seen_points(write("b.points", "4\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n")), InputError);
}

// Bytes changed, lines doubled, dropped and cut off: refused with a line, or loaded and good for a tracker.
TEST_F(ModelFiles, MutatedFilesAreRefusedOrLoaded) {
  test::Random random;
  const std::string obj = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0.5\nf 1 2 3\nf 1 3 4\nl 2 4\n";
  int refused = 0, loaded = 0;
  write("part.cao", "V1\n2\n1 0 0\n0 0 2\n1\n0 1\n0\n0\n0");
  const std::string with_load = std::string("V1\nload(\"part.cao\", t=[0; 1; 0], tu=[1; 2; 3 deg])\n") + (kWhole + 24);
  for (int trial = 0; trial < 10000; ++trial) {
    std::string text = trial % 3 == 0 ? obj : trial % 3 == 1 ? std::string(kWhole) : with_load;
    for (int k = random.integer(1, 4); k > 0 && !text.empty(); --k) {
      const size_t at = static_cast<size_t>(random.integer(0, static_cast<int>(text.size()) - 1));
      switch (random.integer(0, 4)) {
        case 0:
          text[at] = static_cast<char>(random.integer(1, 255));
          break;
        case 1:
          text[at] = "0123456789-.#\n \t\";=[]"[random.integer(0, 20)];
          break;
        case 2:
          text.erase(at, static_cast<size_t>(random.integer(1, 8)));
          break;
        case 3:
          text.insert(at, text.substr(static_cast<size_t>(random.integer(0, static_cast<int>(at))), 6));
          break;
        default:
          if (random.integer(0, 9) == 0) text.resize(at);
      }
    }
    try {
      const ModelFile model = model_of(text, folder_.path() / "mutant");
      ASSERT_TRUE(model.view().validate().ok()) << text;
      ++loaded;
    } catch (const InputError& error) {
      const std::string what = error.what();
      ASSERT_TRUE(what.find("mutant:") != std::string::npos || what.find("part.cao:") != std::string::npos) << what;
      ++refused;
    }
  }
  EXPECT_GT(refused, 3000);
  EXPECT_GT(loaded, 1000);
}

}  // namespace
}  // namespace pptam::platform
