// The program as its users meet it: started as a child, judged by exit code, output and files.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "tests/support/scratch_folder.h"

namespace {

namespace fs = std::filesystem;

std::string read_all(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

struct Answer {
  int code = -1;
  std::string out, err;
};

class Program : public ::testing::Test {
 protected:
  // arguments are words for the shell.
  Answer run(const std::string& arguments, const std::string& environment = "") const {
    const fs::path out = folder_ / "stdout.txt";
    const fs::path err = folder_ / "stderr.txt";
    const std::string command = "cd '" + folder_.string() + "' && " + environment + " '" PPTAM_PROGRAM "' " +
                                arguments + " >'" + out.string() + "' 2>'" + err.string() + "'";
    const int status = std::system(command.c_str());
    return {WIFEXITED(status) ? WEXITSTATUS(status) : 128, read_all(out), read_all(err)};
  }

  void write(const std::string& name, const std::string& content) const {
    std::ofstream(folder_ / name, std::ios::binary) << content;
  }

  const pptam::test::ScratchFolder scratch_;
  const fs::path& folder_ = scratch_.path();
};

// One pose every 0.1 s on a curve; positions times scale.
std::string tum_file(int poses, double scale) {
  std::ostringstream text;
  text << "# timestamp tx ty tz qx qy qz qw\n";
  for (int i = 0; i < poses; ++i) {
    const double t = 0.1 * i;
    text << t << ' ' << scale * std::sin(t) << ' ' << scale * std::cos(0.7 * t) << ' ' << scale * 0.1 * std::sin(2 * t)
         << " 0 0 0 1\n";
  }
  return text.str();
}

TEST_F(Program, HelpShowsEveryCommandWithExamples) {
  const Answer help = run("--help");
  EXPECT_EQ(help.code, 0);
  for (const char* part : {"sim", "budget", "replay", "live", "cameras", "readout", "calibrate", "eval", "map", "model",
                           "Examples:", "Exit codes"})
    EXPECT_TRUE(contains(help.out, part));
  for (const char* command : {"sim", "budget", "replay", "live", "cameras", "readout", "calibrate", "eval", "map",
                              "map info", "map export", "model"}) {
    const Answer answer = run(std::string(command) + " --help");
    EXPECT_EQ(answer.code, 0) << command;
    EXPECT_TRUE(contains(answer.out, "Example")) << command;
    EXPECT_TRUE(answer.err.empty()) << answer.err;
  }
  EXPECT_TRUE(contains(run("sim --help").out, "rotation_start")) << "the stories";
  const Answer version = run("--version");
  EXPECT_EQ(version.code, 0);
  EXPECT_TRUE(contains(version.out, "pocket-ptam ")) << version.out;
}

TEST_F(Program, BadInputIsOneLineThatNamesItAndLeavesNothingBehind) {
  write("garbage.txt", "this is no trajectory\n");
  write("good.txt", tum_file(50, 1));
  write("empty.txt", "");
  write("late.txt", "1000 0 0 0 0 0 0 1\n1001 1 0 0 0 0 0 1\n1002 1 1 0 0 0 0 1\n");
  write("no_video.mp4", "this is no video");
  fs::create_directory(folder_ / "no_images");
  const struct {
    const char* arguments;
    const char* named;  // what the message must name
  } kCases[] = {
      {"", "--help"},
      {"fly", "fly"},
      {"sim --wings", "--wings"},
      {"sim --scene moon --out o", "moon"},
      {"sim --motion swim --out o", "swim"},
      {"sim --duration -1 --out o", "duration"},
      {"sim --duration abc --out o", "duration"},
      {"sim --readout sideways --out o", "columns:-:0.060"},
      {"sim --readout rows:+:abc --out o", "columns:-:0.060"},
      {"sim --readout rows:+:-1 --out o", "columns:-:0.060"},
      {"sim --clock sun --out o", "work, steady or throttled"},
      {"sim --slowdown 0 --out o", "slowdown"},
      {"sim --seeds 3 --out o", "--suite"},
      {"sim --suite --jobs 0 --out o", "jobs"},
      {"sim --suite --scene moon --out o", "moon"},
      {"sim --story flood --out o", "flood"},
      {"sim --suite --story flood --out o", "flood"},
      {"sim --harsh fog --out o", "fog"},
      {"sim --harsh dim:2 --out o", "dim:2"},
      {"sim --story orbit --story zoom --out o", "--suite"},
      {"sim --story orbit --motion calm --out o", "--story"},
      {"sim --shard 1/2 --out o", "--suite"},
      {"sim --compare --out o", "--suite"},
      {"sim --suite --shard 3/2 --out o", "3/2"},
      {"sim --suite --shard 0/4 --out o", "0/4"},
      {"sim --suite --shard 1 --out o", "1/4"},
      {"sim --suite --shard 1/2x --out o", "1/2x"},
      {"sim --study life --out o", "life"},
      {"sim --study init --kind sphere --out o", "sphere"},
      {"sim --study init --suite --out o", "--suite"},
      {"sim --kind planar --out o", "--study"},
      {"sim --plane-distance 0 --out o", "plane-distance"},
      {"sim --ground 12 --out o", "--ground 12: write X,Y"},
      {"sim --ground -3,5 --out o", "--ground"},
      {"sim --ground 3,5x --out o", "--ground 3,5x"},
      {"sim --duration 1 --out good.txt", "good.txt"},
      {"replay", "source"},
      {"replay nowhere --out o", "nowhere"},
      {"replay no_images --fov 50 --out o", "no_images"},
      {"replay no_video.mp4 --fov 50 --out o", "no_video.mp4"},
      {"replay no_images --calibration missing.yaml --out o", ""},
      {"replay no_images --fov 50 --resize big --out o", "320x240"},
      {"sim --load-map missing.map --out o", "missing.map"},
      {"sim --load-map garbage.txt --out o", "garbage.txt: this is not a map"},
      {"sim --load-map garbage.txt --tap 1 --out o", "--tap"},
      {"sim --save-map nowhere/desk.map --out o", "nowhere"},
      {"sim --save-map no_images --out o", "no_images"},
      {"sim --suite --save-map desk.map --out o", "single run"},
      {"sim --dump d --lock-map", "single run"},
      {"map", "map --help"},
      {"map fly", "map --help"},
      {"map info", "map info --help"},
      {"map info missing.map", "missing.map"},
      {"map info no_images", "no_images"},
      {"map info garbage.txt", "garbage.txt: this is not a map"},
      {"map info empty.txt", "empty.txt: this is not a map"},
      {"map export good.txt", "--ply or --colmap"},
      {"map export good.txt --ply o", "good.txt: this is not a map"},
      {"map export good.txt --colmap o", "good.txt: this is not a map"},
      {"eval missing.txt good.txt", "missing.txt"},
      {"eval good.txt missing.txt", "missing.txt"},
      {"eval garbage.txt good.txt", "garbage.txt"},
      {"eval empty.txt good.txt", "empty.txt"},
      {"eval late.txt good.txt", "late.txt"},
  };
  for (const auto& bad : kCases) {
    const Answer answer = run(bad.arguments);
    EXPECT_EQ(answer.code, 2) << bad.arguments;
    EXPECT_EQ(std::count(answer.err.begin(), answer.err.end(), '\n'), 1) << bad.arguments << "\n" << answer.err;
    EXPECT_EQ(answer.err.rfind("pocket-ptam: error: ", 0), 0u) << bad.arguments << "\n" << answer.err;
    EXPECT_TRUE(contains(answer.err, bad.named)) << bad.arguments << "\n" << answer.err;
    EXPECT_TRUE(answer.out.empty()) << bad.arguments << "\n" << answer.out;
    EXPECT_FALSE(fs::exists(folder_ / "o")) << bad.arguments;
    EXPECT_FALSE(fs::exists(folder_ / "out")) << bad.arguments;
  }
}

TEST_F(Program, AStudyNamesHowToRepeatEachTrial) {
  const Answer study = run("sim --study init --kind planar --seeds 1 --out o");
  EXPECT_EQ(study.code, 0) << study.err;
  EXPECT_TRUE(contains(study.out, "planar")) << study.out;
  EXPECT_TRUE(fs::exists(folder_ / "o/study.html"));
  std::istringstream csv(read_all(folder_ / "o/study.csv"));
  std::string heads, row;
  std::getline(csv, heads);
  std::getline(csv, row);
  EXPECT_EQ(std::count(heads.begin(), heads.end(), ','), std::count(row.begin(), row.end(), ',')) << row;
  const size_t from = row.find("--scene");
  ASSERT_NE(from, std::string::npos) << row;
  const Answer trial =
      run("sim --duration 1 --no-overlay --no-report --out t " + row.substr(from, row.find(',', from) - from));
  EXPECT_EQ(trial.code, 0) << trial.err;
  EXPECT_TRUE(contains(trial.out, "plane, start, seed 1")) << trial.out;
}

std::vector<std::string> lines_of(const std::string& text) {
  std::istringstream stream(text);
  std::vector<std::string> lines;
  for (std::string line; std::getline(stream, line);) lines.push_back(line);
  return lines;
}

TEST_F(Program, ASuitesShardsAreItsRuns) {
  // One story and one scene of two seeds, too short for a map: what matters is which runs there are.
  const std::string suite = "sim --suite --story sparse --scene checkerboard --seeds 2 --duration 0.5 --jobs 2 ";
  const Answer whole = run(suite + "--out whole");
  ASSERT_EQ(whole.code, 0) << whole.err;
  for (const char* part : {"sparse median", "checkerboard median", "worst", "goal", "runs that initialised", "0 of 4",
                           "pocket-ptam sim --story sparse --seed 2 --duration 0.5: no map"}) {
    EXPECT_TRUE(contains(whole.out, part)) << part << "\n" << whole.out;
  }
  ASSERT_EQ(run(suite + "--shard 1/3 --out first").code, 0);
  ASSERT_EQ(run(suite + "--shard 2/3 --out second").code, 0);
  ASSERT_EQ(run(suite + "--shard 3/3 --out third").code, 0);
  std::vector<std::string> all = lines_of(read_all(folder_ / "whole/suite.csv"));
  ASSERT_EQ(all.size(), 5u) << "a head and four runs";
  std::vector<std::string> parts = {all.front()};
  for (const char* name : {"first", "second", "third"}) {
    const std::vector<std::string> lines = lines_of(read_all(folder_ / name / "suite.csv"));
    ASSERT_GE(lines.size(), 2u) << name;
    EXPECT_EQ(lines.front(), all.front());
    parts.insert(parts.end(), lines.begin() + 1, lines.end());
  }
  std::sort(all.begin(), all.end());
  std::sort(parts.begin(), parts.end());
  EXPECT_EQ(all, parts);
  for (const std::string& line : all) {
    EXPECT_EQ(std::count(line.begin(), line.end(), ','), std::count(all.front().begin(), all.front().end(), ','))
        << line;
  }
  const std::string page = read_all(folder_ / "whole/suite.html");
  EXPECT_TRUE(contains(page, "</html>") && contains(page, "a plain table")) << "the stories' lines";
}

TEST_F(Program, ASuiteComparesShutters) {
  const Answer answer = run("sim --suite --story desk_calm --seeds 1 --duration 6 --compare --out o");
  ASSERT_EQ(answer.code, 0) << answer.err;
  EXPECT_TRUE(contains(answer.out, "times that with a global shutter")) << answer.out;
  const std::vector<std::string> lines = lines_of(read_all(folder_ / "o/suite.csv"));
  ASSERT_EQ(lines.size(), 2u);
  std::vector<std::string> heads, cells;
  for (const auto& [line, into] : {std::pair(lines[0], &heads), std::pair(lines[1], &cells)}) {
    std::istringstream stream(line);
    for (std::string cell; std::getline(stream, cell, ',');) into->push_back(cell);
  }
  const auto value = [&](const std::string& name) {
    const auto at = std::find(heads.begin(), heads.end(), name);
    if (at == heads.end()) ADD_FAILURE() << name << " is no column";
    return at == heads.end() ? 0 : std::atof(cells[static_cast<size_t>(at - heads.begin())].c_str());
  };
  for (const char* name : {"initialised_s", "tracked_percent", "ate_percent", "frame_minstructions_median",
                           "frame_minstructions_p99", "global_ate_percent", "unmodelled_ate_percent"}) {
    EXPECT_GT(value(name), 0) << name;
  }
  for (const char* name : {"seed", "wrong_percent", "wrong_good_percent", "false_relocalisations", "recovered_percent",
                           "recovery_s", "jitter_mm", "jitter_mm_ratio", "jitter_deg", "jitter_deg_ratio", "lag_frames",
                           "plane_deg", "frames_expected", "frames_tracked", "losses", "recovered", "repeat"}) {
    EXPECT_NE(std::find(heads.begin(), heads.end(), name), heads.end()) << name;
  }
  EXPECT_NEAR(value("ate_to_global"), value("ate_percent") / value("global_ate_percent"), 1e-3);
  // Three different runs.
  EXPECT_NE(value("ate_percent"), value("unmodelled_ate_percent"));
  EXPECT_NE(value("ate_percent"), value("global_ate_percent"));
}

// A CSV without the columns whose name ends in _us: those hold times.
std::string without_times(const std::string& csv) {
  std::istringstream lines(csv);
  std::vector<bool> keep;
  std::string result;
  for (std::string line; std::getline(lines, line);) {
    std::istringstream cells(line);
    size_t column = 0;
    for (std::string cell; std::getline(cells, cell, ','); ++column) {
      if (result.empty() || column >= keep.size())
        keep.push_back(cell.size() < 3 || cell.substr(cell.size() - 3) != "_us");
      if (keep[column]) result += cell + ",";
    }
    result += '\n';
  }
  return result;
}

TEST(FramesCsv, CuttingTimeColumnsGoesByName) {
  EXPECT_EQ(without_times("frame,pose_us,found\n1,20,3\n"), "frame,found,\n1,3,\n");
}

TEST_F(Program, EmulatedRunsRepeatByteForByte) {
  const std::string options = "sim --scene desk --duration 4 --no-overlay --no-report ";
  ASSERT_EQ(run(options + "--seed 1 --out a").code, 0);
  ASSERT_EQ(run(options + "--seed 1 --out b").code, 0);
  ASSERT_EQ(run(options + "--seed 2 --out c").code, 0);
  for (const char* name : {"trajectory.txt", "keyframes.txt", "map.ply", "frames.csv"}) {
    ASSERT_TRUE(fs::exists(folder_ / "a" / name)) << name;
    const auto content = [&](const char* run_name) {
      const std::string text = read_all(folder_ / run_name / name);
      return std::string(name) == "frames.csv" ? without_times(text) : text;
    };
    EXPECT_TRUE(content("a") == content("b")) << name;
  }
  // Another seed is another run: the comparison above can fail.
  EXPECT_TRUE(without_times(read_all(folder_ / "a/frames.csv")) != without_times(read_all(folder_ / "c/frames.csv")));
  const std::string csv = read_all(folder_ / "a/frames.csv");
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 4 * 15 + 1) << "a header and 15 frames a second";
}

TEST_F(Program, SlowPhoneDropsFramesUnlessTold) {
  const std::string options = "sim --duration 2 --no-overlay --no-report --clock throttled --slowdown 10000 ";
  const auto rows = [&](const char* name) {
    const std::string csv = read_all(folder_ / name / "frames.csv");
    return std::count(csv.begin(), csv.end(), '\n') - 1;
  };
  ASSERT_EQ(run(options + "--out dropping").code, 0);
  ASSERT_EQ(run(options + "--no-drop --out patient").code, 0);
  EXPECT_LT(rows("dropping"), 30);
  EXPECT_EQ(rows("patient"), 30);
}

TEST_F(Program, ReportAndOverlayAreWritten) {
  const Answer answer = run("sim --duration 3 --out o");
  ASSERT_EQ(answer.code, 0) << answer.err;
  const std::string page = read_all(folder_ / "o/report.html");
  EXPECT_TRUE(contains(page, "pocket-ptam sim --duration 3 --out o")) << "how to repeat";
  EXPECT_TRUE(contains(page, "</html>"));
  EXPECT_FALSE(contains(page, "http://")) << "self-contained";
  EXPECT_TRUE(fs::exists(folder_ / "o/overlay.mp4") || contains(answer.err, "ffmpeg")) << answer.err;
  EXPECT_TRUE(contains(answer.out, "written to o:")) << answer.out;
}

TEST_F(Program, MissingHelpersCostOnlyTheirOutputs) {
  const Answer answer = run("sim --duration 2 --out o", "PATH=/nonexistent");
  EXPECT_EQ(answer.code, 0) << answer.err;
  EXPECT_TRUE(contains(answer.err, "warning:") && contains(answer.err, "ffmpeg")) << answer.err;
  EXPECT_TRUE(contains(answer.err, "gnuplot")) << answer.err;
  for (const char* name : {"trajectory.txt", "frames.csv", "report.html"})
    EXPECT_TRUE(fs::exists(folder_ / "o" / name));
  EXPECT_FALSE(fs::exists(folder_ / "o/overlay.mp4"));
}

TEST_F(Program, EvalComparesFiles) {
  write("truth.txt", tum_file(100, 1));
  write("half.txt", tum_file(100, 0.5));
  const Answer same = run("eval half.txt truth.txt");
  EXPECT_EQ(same.code, 0) << same.err;
  EXPECT_TRUE(contains(same.out, "100 of 100")) << same.out;
  EXPECT_TRUE(contains(same.out, "scale             2\n")) << same.out;
  EXPECT_TRUE(contains(same.out, "0 of 100 (0.0 %)")) << same.out;

  std::string spoiled = tum_file(99, 0.5) + "9.9 50 50 50 0 0 0 1\n";
  write("spoiled.txt", spoiled);
  EXPECT_TRUE(contains(run("eval spoiled.txt truth.txt").out, "1 of 100 (1.0 %)"));
}

TEST_F(Program, NoColourWhenNobodyWatches) {
  write("truth.txt", tum_file(100, 1));
  EXPECT_FALSE(contains(run("eval truth.txt truth.txt").out, "\033"));
  EXPECT_FALSE(contains(run("eval missing.txt truth.txt").err, "\033"));
}

// A phone whose shutter nobody told of, and whose field of view was guessed: the command finds both.
TEST_F(Program, FindsTheReadoutAndTheFieldOfView) {
  ASSERT_EQ(run("sim --seed 3 --duration 10 --dump d").code, 0);
  fs::remove(folder_ / "d/calibration.yaml");
  const Answer answer = run("readout d --fov 45 --estimate fov,readout --out found");
  EXPECT_EQ(answer.code, 0) << answer.err;
  const auto number_after = [&](const std::string& text) {
    const size_t at = answer.out.find(text);
    return at == std::string::npos ? -1 : std::stod(answer.out.substr(at + text.size()));
  };
  EXPECT_NEAR(number_after("best: --readout columns:-:"), 0.060, 0.003) << answer.out;
  EXPECT_NEAR(number_after("best: --fov "), 37, 0.03 * 37) << answer.out;
  EXPECT_TRUE(contains(read_all(folder_ / "found/report.html"), "svg+xml"));
  // And so does a run that is told the wrong one: it says so. Of the right one it says nothing.
  EXPECT_TRUE(contains(run("replay d --fov 45 --no-overlay --out wrong").out, "the points fit a focal length of"));
  const Answer right = run("replay d --fov 37 --readout columns:-:0.060 --no-overlay --out right");
  EXPECT_FALSE(contains(right.out, "the points fit")) << right.out;
  EXPECT_EQ(run("readout nothing.mp4 --fov 50").code, 2);
  // A recording that breaks off is told, whatever was found until then.
  std::string list = read_all(folder_ / "d/rgb.txt");
  list.resize(list.find('\n', list.size() * 3 / 4) + 1);
  write("d/rgb.txt", list + "99 rgb/missing.png\n");
  const Answer broken = run("readout d --fov 37 --axis columns");
  EXPECT_EQ(broken.code, 1) << broken.out;
  EXPECT_TRUE(contains(broken.err, "missing.png")) << broken.err;
  EXPECT_EQ(run("readout d --fov 37 --axis diagonal").code, 2);
}

// COLMAP's text model, read as its documentation says: the median distance between the measurements and the points
// projected by the pinhole camera, in pixels; negative when the model does not hang together.
double colmap_error(const fs::path& folder, int* images, int* points) {
  std::istringstream cameras(read_all(folder / "cameras.txt"));
  std::string line, model;
  std::getline(cameras, line);
  int camera_id = 0, width = 0, height = 0;
  double fx = 0, fy = 0, cx = 0, cy = 0;
  cameras >> camera_id >> model >> width >> height >> fx >> fy >> cx >> cy;
  if (camera_id != 1 || model != "PINHOLE" || width != 240 || height != 320) return -1;

  std::map<int, std::vector<double>> position;  // of each point
  std::map<std::pair<int, int>, int> track;     // image and index: point
  std::istringstream points_file(read_all(folder / "points3D.txt"));
  while (std::getline(points_file, line)) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream words(line);
    int id = 0, image = 0, index = 0;
    double x = 0, y = 0, z = 0, red = 0, green = 0, blue = 0, error = 0;
    words >> id >> x >> y >> z >> red >> green >> blue >> error;
    position[id] = {x, y, z};
    while (words >> image >> index) track[{image, index}] = id;
  }
  std::vector<double> errors;
  std::istringstream images_file(read_all(folder / "images.txt"));
  *images = 0;
  while (std::getline(images_file, line)) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream words(line);
    int id = 0, camera = 0;
    double w = 0, a = 0, b = 0, c = 0, tx = 0, ty = 0, tz = 0;
    std::string name;
    words >> id >> w >> a >> b >> c >> tx >> ty >> tz >> camera >> name;
    if (camera != 1 || !fs::exists(folder / "images" / name)) return -2;
    ++*images;
    std::getline(images_file, line);
    std::istringstream observations(line);
    double u = 0, v = 0;
    for (int index = 0, point = 0; observations >> u >> v >> point; ++index) {
      if (track.count({id, index}) == 0 || track[{id, index}] != point) return -3;
      const double x = position[point][0], y = position[point][1], z = position[point][2];
      // The quaternion's rotation, written out.
      const double X = (1 - 2 * (b * b + c * c)) * x + 2 * (a * b - w * c) * y + 2 * (a * c + w * b) * z + tx;
      const double Y = 2 * (a * b + w * c) * x + (1 - 2 * (a * a + c * c)) * y + 2 * (b * c - w * a) * z + ty;
      const double Z = 2 * (a * c - w * b) * x + 2 * (b * c + w * a) * y + (1 - 2 * (a * a + b * b)) * z + tz;
      errors.push_back(std::hypot(fx * X / Z + cx - u, fy * Y / Z + cy - v));
    }
  }
  *points = static_cast<int>(position.size());
  if (errors.size() != track.size() || errors.empty()) return -4;
  std::nth_element(errors.begin(), errors.begin() + static_cast<ptrdiff_t>(errors.size() / 2), errors.end());
  return errors[errors.size() / 2];
}

TEST_F(Program, TimestampsAtTheEndsOfTimeAreTrackedInOrder) {
  std::string image = "P5 160 120 255\n";
  for (int i = 0; i < 160 * 120; ++i) image += static_cast<char>(i * 7919 % 251);
  write("frame.pgm", image);
  write("ends.txt", "-9223372036.8 frame.pgm\n0 frame.pgm\n9223372036.8 frame.pgm\n");
  const Answer answer = run("replay ends.txt --fov 50 --no-overlay --no-report --out o");
  EXPECT_EQ(answer.code, 0) << answer.err;
  EXPECT_TRUE(contains(answer.out, "3 tracked, 0 dropped")) << answer.out;
}

TEST_F(Program, SavedMapsAreLoadedShownAndExported) {
  const std::string quiet = " --no-overlay --no-report --out o";
  const Answer made = run("sim --duration 6 --save-map desk.map" + quiet);
  ASSERT_EQ(made.code, 0) << made.err;
  EXPECT_TRUE(contains(made.out, "map saved to desk.map")) << made.out;
  const std::string map = read_all(folder_ / "desk.map");
  ASSERT_GT(map.size(), 100000u);

  const Answer info = run("map info desk.map");
  EXPECT_EQ(info.code, 0) << info.err;
  for (const char* part : {"version 3", "checksum", "240x320", "columns:-:0.06", "keyframes", "points", "px, median"})
    EXPECT_TRUE(contains(info.out, part)) << part << "\n" << info.out;

  const Answer exported = run("map export desk.map --ply desk.ply --colmap colmap");
  EXPECT_EQ(exported.code, 0) << exported.err;
  EXPECT_EQ(read_all(folder_ / "desk.ply"), read_all(folder_ / "o/map.ply"));
  int images = 0, points = 0;
  // Half a pixel of sub-pixel noise, of points measured in level 1; the convention of pixel centres alone is as much,
  // in each direction: without it the median would be above this.
  const double error = colmap_error(folder_ / "colmap", &images, &points);
  EXPECT_GT(error, 0);
  EXPECT_LT(error, 0.5);
  EXPECT_TRUE(contains(info.out, std::to_string(points) + ", measured")) << points << "\n" << info.out;
  EXPECT_GE(images, 3);
  // Neither an input, be it through a link, nor what is not ours or was changed since is replaced.
  write("frame.pgm", "P5 160 120 255\n" + std::string(160 * 120, 'x'));
  write("desk_mine.ply", read_all(folder_ / "desk.ply") + "0 0 0 0 0 1 9 9 9 2\n");
  fs::copy(folder_ / "colmap", folder_ / "edited", fs::copy_options::recursive);
  write("edited/images.txt", read_all(folder_ / "edited/images.txt") + "# mine\n");
  write("damaged.map", map.substr(0, map.size() - 1));
  fs::create_hard_link(folder_ / "desk.map", folder_ / "too.map");
  fs::create_symlink("desk.map", folder_ / "link.map");
  fs::create_symlink("nowhere", folder_ / "dead.map");
  const std::string replay = "replay frame.pgm --fov 50 --out p --save-map ";
  for (const std::string& refused :
       {std::string("map export desk.map --colmap edited"), std::string("map export desk.map --ply desk_mine.ply"),
        std::string("map export desk.map --ply desk.map"), std::string("map export desk.map --ply too.map"),
        std::string("map export link.map --ply desk.map"), std::string("map export too.map --ply new --colmap new"),
        replay + "desk.map --load-map desk.map", replay + "link.map --load-map desk.map",
        replay + "desk.map --load-map too.map", replay + "dead.map", replay + "damaged.map", replay + "desk.ply",
        std::string("replay frame.pgm --fov 50 --out o --save-map o/report.html"),
        std::string("replay frame.pgm --fov 50 --out o --save-map o/.pocket-ptam")}) {
    const Answer answer = run(refused);
    EXPECT_EQ(answer.code, 2) << refused << answer.err;
    EXPECT_FALSE(fs::exists(folder_ / "p") || fs::exists(folder_ / "new")) << refused;
  }
  EXPECT_EQ(run("map export desk.map --ply desk.ply --colmap colmap").code, 0) << "ours, as it was";
  EXPECT_TRUE(read_all(folder_ / "desk.map") == map);
  EXPECT_TRUE(contains(read_all(folder_ / "edited/images.txt"), "# mine"));
  EXPECT_TRUE(contains(read_all(folder_ / "desk_mine.ply"), "9 9 9 2"));

  // Pixels from their corners, not from their centres: what the check is to find.
  std::string cameras = read_all(folder_ / "colmap/cameras.txt");
  const size_t centre = cameras.rfind(" 120 160");
  ASSERT_NE(centre, std::string::npos) << cameras;
  write("colmap/cameras.txt", cameras.replace(centre, 8, " 119.5 159.5"));
  EXPECT_GT(colmap_error(folder_ / "colmap", &images, &points), 0.5);

  // Used again; locked it stays as it is, to the byte but for what the tracker counts.
  const Answer again = run("sim --duration 3 --load-map desk.map --lock-map --save-map again.map" + quiet);
  EXPECT_EQ(again.code, 0) << again.err;
  EXPECT_EQ(read_all(folder_ / "again.map").size(), map.size());
  EXPECT_EQ(read_all(folder_ / "desk.ply"), read_all(folder_ / "o/map.ply"));

  // Not with another camera, and not damaged.
  for (const char* other : {"--readout rows:+:0.06", "--readout columns:-:0.03"}) {
    const Answer wrong = run(std::string("sim --load-map desk.map --out p ") + other);
    EXPECT_EQ(wrong.code, 2) << other;
    EXPECT_TRUE(contains(wrong.err, "desk.map: the map was made with another rolling shutter")) << wrong.err;
    EXPECT_FALSE(fs::exists(folder_ / "p"));
  }
  for (const size_t length : {size_t{0}, size_t{5}, size_t{50}, size_t{200}, map.size() / 2, map.size() - 1}) {
    write("cut.map", map.substr(0, length));
    for (const char* command : {"map info cut.map", "map export cut.map --ply p", "sim --load-map cut.map --out p"}) {
      const Answer cut = run(command);
      EXPECT_EQ(cut.code, 2) << command << length;
      EXPECT_EQ(cut.err.rfind("pocket-ptam: error: cut.map: ", 0), 0u) << cut.err;
      EXPECT_EQ(std::count(cut.err.begin(), cut.err.end(), '\n'), 1) << cut.err;
      EXPECT_TRUE(cut.out.empty()) << cut.out;
      EXPECT_FALSE(fs::exists(folder_ / "p"));
    }
  }

  // No map, nothing saved: the older file stays, and the exit code says so.
  const Answer none = run("sim --duration 1 --save-map desk.map" + quiet);
  EXPECT_EQ(none.code, 1);
  EXPECT_TRUE(contains(none.err, "nothing was saved")) << none.err;
  EXPECT_EQ(read_all(folder_ / "desk.map"), map);
}

// The boxes of the emulated phone's table, tracked as a known object: the truth is that of the scene.
TEST_F(Program, ModelTracksAKnownObject) {
  ASSERT_EQ(run("sim --scene boxes --seed 5 --duration 2 --dump boxes").code, 0);
  const std::string source = "boxes/scene.cao boxes --calibration boxes/calibration.yaml --out o";
  const Answer answer = run("model " + source);
  ASSERT_EQ(answer.code, 0) << answer.err;
  EXPECT_TRUE(contains(answer.out, "edges of lines")) << answer.out;
  for (const char* name : {"trajectory.txt", "frames.csv", "report.html", "overlay.png"})
    EXPECT_TRUE(fs::exists(folder_ / "o" / name)) << name;
  const std::string csv = read_all(folder_ / "o" / "frames.csv");
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 31);
  EXPECT_TRUE(contains(csv, "timestamp,state,pose,quality,sites,inliers,error_px\n0.000000,tracking,1,"));
  EXPECT_FALSE(contains(csv, "lost"));
  // As far as the camera gets in two seconds the path is off by some per cent of itself; a pose is never wrong.
  const Answer judged = run("eval o/trajectory.txt boxes/groundtruth.txt");
  EXPECT_TRUE(contains(judged.out, "wrong poses       0 of 30")) << judged.out;

  const std::pair<const char*, const char*> wrong[] = {
      {"model boxes/scene.cao", "either a recording or --camera"},
      {"model boxes/scene.cao boxes --calibration boxes/calibration.yaml --out boxes/rgb", "images are there"},
      {"model boxes/rgb.txt boxes --calibration boxes/calibration.yaml", "boxes/rgb.txt:2: "},
      {"model nothing.cao boxes --calibration boxes/calibration.yaml", "nothing.cao"},
      {"model boxes/scene.cao boxes --calibration boxes/calibration.yaml --initial-pose boxes/rgb.txt", "rgb.txt:2"},
      {"model boxes/scene.cao boxes --calibration boxes/calibration.yaml --initial-pose boxes/scene.pos "
       "--initial-points boxes/scene.pos",
       "give one of them"}};
  for (const auto& [arguments, part] : wrong) {
    const Answer refused = run(arguments);
    EXPECT_EQ(refused.code, 2) << arguments;
    EXPECT_TRUE(contains(refused.err, part)) << arguments << "\n" << refused.err;
  }
  fs::rename(folder_ / "boxes" / "scene.pos", folder_ / "elsewhere.pos");
  EXPECT_TRUE(contains(run("model " + source + " --no-overlay").err, "was sought in the whole image"));
  EXPECT_EQ(run("model " + source + " --initial-pose elsewhere.pos --no-overlay").code, 0);
  EXPECT_FALSE(fs::exists(folder_ / "o" / "overlay.png")) << "of the run before";
}

}  // namespace
