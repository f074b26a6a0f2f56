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
#include "sim_phone/gloss.h"
#include "sim_phone/harshness.h"
#include "sim_phone/lamp_and_focus.h"
#include "sim_phone/motion.h"
#include "sim_phone/scene.h"

namespace pptam::sim {

// Something held before the lens. Its surfaces lie in a frame that keeps the camera's axes (x right, y down, z forward)
// and whose origin is at position(t_s) in the camera.
struct Occluder {
  std::vector<Surface> surfaces;
  std::function<Vector3d(double t_s)> position;
};

// Something that moves in the scene. Its surfaces lie in a frame of its own.
struct Mover {
  std::vector<Surface> surfaces;
  std::function<Eigen::Isometry3d(double t_s)> T_wm;  // that frame to the world
};

struct SensorOptions {
  CameraModel model;  // without distortion
  RollingShutter shutter;
  double exposure_s = 0;
  bool noise = true;  // false: no noise, vignetting, gamma or auto-exposure; grey = 255 * light * reflectance
  // The camera moves evenly during each image, as at its middle: what its change of speed within one costs.
  bool even_readout = false;
  uint64_t seed = 1;
  // Factor on all light at a time: lamps, and what covers the lens. Null: 1. Averaged over each line's exposure.
  std::function<double(double t_s)> light = nullptr;
  std::shared_ptr<const Occluder> occluder = nullptr;  // may be null
  std::vector<std::shared_ptr<const Mover>> movers;
  Harshness harsh;  // what the sensor has to do with: gloss, breathing, compression
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
  Line line_at(int index, double t_s);
  void find_surfaces(Line* line);
  void find_held(Line* line);
  void find_moving(Line* line);
  // low and high: the box in the image that the surface stays in. Null when the line does not meet it.
  Candidate* add_candidate(const Surface& surface, const Vector2d& low, const Vector2d& high, Line* line);
  void choose_samples(Line* line) const;
  void aim(Line* line);
  double mean_light(const Line& line) const;
  void trace(const Line& line, double light);
  float varnished(const Line& line, int sample, float place, const Candidate& c, float u, float v, float diffuse);

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
  std::function<Focus(double t_s)> focus_;  // null: fixed
  double image_scale_ = 1;                  // of the line at hand, by its focus
  std::unique_ptr<Gloss> gloss_;            // null: nothing is glossy
  double gain_ = 0;                         // 0: nothing metered yet
  double last_t_s_ = 0;
};

}  // namespace pptam::sim
