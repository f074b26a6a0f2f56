// The phone's image sensor: a pinhole with a rolling shutter, motion blur, vignetting, noise, gamma and auto-exposure.
//
// Each line (column or row) is exposed for exposure_s centred on its own time. A pixel is the mean of several samples,
// spread over its area and over the exposure, of the scene in linear light.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include <pocket_ptam/pocket_ptam.h>
#include "sim_phone/motion.h"
#include "sim_phone/scene.h"

namespace pptam::sim {

// Something held before the lens. Its surfaces lie in a frame that keeps the camera's axes (x right, y down, z forward)
// and whose origin is at position(t_s) in the camera.
struct Occluder {
  std::vector<Surface> surfaces;
  std::function<Vector3d(double t_s)> position;
};

struct SensorOptions {
  CameraModel model;  // without distortion
  RollingShutter shutter;
  double exposure_s = 0;
  bool noise = true;  // false: no noise, vignetting, gamma or auto-exposure; grey = 255 * light * reflectance
  uint64_t seed = 1;
  // Factor on all light at a time: lamps, and what covers the lens. Null: 1. Averaged over each line's exposure.
  std::function<double(double t_s)> light = nullptr;
  std::shared_ptr<const Occluder> occluder = nullptr;  // may be null
};

class Sensor {
 public:
  // The scene must outlive the sensor.
  Sensor(const Scene& scene, MotionCurve motion, const SensorOptions& options);
  ~Sensor();
  Sensor(const Sensor&) = delete;
  Sensor& operator=(const Sensor&) = delete;

  // Takes the image whose centre has its mid-exposure at t_s, width * height grey pixels. frame_index selects the
  // noise; auto-exposure follows the images taken so far.
  void expose(double t_s, uint64_t frame_index, uint8_t* out);

 private:
  struct Candidate;
  struct Line;
  void integrate(double t_s);                                    // fills linear_
  void develop(double t_s, uint64_t frame_index, uint8_t* out);  // linear_ to grey
  void render_line(int index, double t_s);
  // Its steps, in this order.
  Line line_at(int index, double t_s) const;
  void find_surfaces(Line* line);
  void find_held(Line* line);
  bool add_candidate(const Surface& surface, bool held, const Vector2d& low, const Vector2d& high, Line* line);
  void choose_samples(Line* line) const;
  void aim(const Line& line);
  double mean_light(const Line& line) const;
  void trace(const Line& line, double light);

  Vector2d projected(const Vector3d& p_c) const;
  Eigen::Isometry3d pose(double t_s) const;  // from the table

  const Scene& scene_;
  MotionCurve motion_;
  SensorOptions options_;
  bool columns_;  // lines are columns
  int lines_;
  int line_length_;

  // Poses over one frame's exposure, evenly spaced; interpolated linearly between.
  std::vector<Eigen::Quaterniond> table_rotation_;
  std::vector<Vector3d> table_position_;
  double table_start_s_ = 0;
  double table_step_s_ = 0;

  std::vector<float> linear_;      // light at each pixel
  std::vector<float> vignetting_;  // factor at each pixel
  std::vector<Candidate> candidates_;
  double gain_ = 0;  // 0: nothing metered yet
  double last_t_s_ = 0;
};

}  // namespace pptam::sim
