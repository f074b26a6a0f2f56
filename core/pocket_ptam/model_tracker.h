// Tracks a known object by its edges [vvs]: lines, circles, cylinders and spheres. Independent of System.
//
//   pptam::ModelTrackerConfig config{.camera = camera, .model = model};
//   std::vector<std::byte> memory(pptam::ModelTracker::required_bytes(config));
//   pptam::ModelTracker* tracker = nullptr;
//   pptam::Status status = pptam::ModelTracker::create(config, memory, &tracker);   // check it
//   tracker->start(T_co);                                                           // roughly where the object is
//   for (every frame) pptam::ModelResult r = tracker->track(frame);
//
// One thread. No heap, no exceptions, no operating system: everything lives in the caller's block, but for the model,
// whose arrays are the caller's too and must outlive the tracker. Frames: T_co takes the object's frame to the camera's
// (x right, y down, z forward) at the frame's timestamp. The unit of length is the model's.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include <pocket_ptam/camera.h>
#include <pocket_ptam/image.h>
#include <pocket_ptam/status.h>

namespace pptam {

// A segment between two points. One that is no side of a face is always visible.
struct ModelLine {
  int a = 0, b = 0;         // indices of points
  float min_length_px = 0;  // left out where it is shorter in the image
};

// A plane polygon, which hides what is behind it. Its sides are tracked while it faces the camera: seen from outside
// its corners run counter-clockwise. An open one has no side between its last corner and its first. One of two corners
// is a line.
struct ModelFace {
  int first = 0, count = 0;  // its corners: ObjectModel::corners[first] to [first + count - 1], indices of points
  bool open = false;
  float min_area_px2 = 0;   // left out where it is smaller in the image
  float min_length_px = 0;  // of its sides
};

// Both limbs between two points of the axis. Hides what is behind it.
struct ModelCylinder {
  int a = 0, b = 0;  // indices of points
  float radius = 0;
  float min_length_px = 0;
};

// Visible from the side to which the normal points.
struct ModelCircle {
  Vector3f centre = Vector3f::Zero();
  Vector3f normal = Vector3f::UnitZ();  // of any length
  float radius = 0;
  bool both_sides = false;
  float min_area_px2 = 0;  // left out where it is smaller in the image
};

// Hides what is behind it.
struct ModelSphere {
  Vector3f centre = Vector3f::Zero();
  float radius = 0;
  float min_area_px2 = 0;  // left out where it is smaller in the image
};

// A view of arrays that the caller owns.
struct ObjectModel {
  std::span<const Vector3f> points;
  std::span<const int> corners;
  std::span<const ModelLine> lines;
  std::span<const ModelFace> faces;
  std::span<const ModelCylinder> cylinders;
  std::span<const ModelCircle> circles;
  std::span<const ModelSphere> spheres;
  // Sides in which two faces meet at less than 30 degrees are tracked only where they are the outline: of surfaces made
  // of many flat pieces. Otherwise every side is an edge.
  bool outlines_of_smooth = false;

  // Corner i of a face, counted round and round: an index of points.
  int corner(const ModelFace& face, int i) const { return corners.data()[face.first + i % face.count]; }

  // Something to track; finite numbers up to 1e6, indices that exist, no segment, axis, normal or radius without length
  // (an extent of at least 1e-6); at most 4096 points, 4096 lines and sides, 2048 faces, 1024 of each other kind.
  Status validate() const;
};

// What of [vvs] can be done otherwise, to be compared (pocket-ptam sim --study model). As it stands no story fails;
// single ones are better otherwise (tests/MEASURED.md).
struct ModelMethod {
  bool no_weights = false;         // D = I in eq. 7: the strongest edges, whatever a site has shown, count all alike
  float likelihood_threshold = 0;  // over 0: edges that are at least so likely count alike, instead of by eq. 24
  bool scale_once = false;         // the robust scale is that of the first iteration, instead of each one's
  bool constant_jacobian = false;  // eq. 10 and 11: that of the first iteration without weights
};

// Where between two pixels an edge lies is found in squared grey values, as those of a camera are: light by a gamma of
// about 2. In images whose grey is the light itself edges lie a tenth of a pixel or two towards their bright side.
struct ModelTrackerConfig {
  Camera camera;  // required_bytes() and create() call prepare() on copies of camera.model
  ObjectModel model;
  // Sites along the contours, in each pyramid level: their distance, pixels of the level, at least 1; where more than
  // max_sites (50 to 5000) are visible the distance is as much larger.
  float site_spacing_px = 4;
  int max_sites = 800;
  ModelMethod method;
  Status validate() const;
};

enum class ModelState : uint8_t {
  kWaiting,   // for start()
  kTracking,  // whether this frame has a pose is ModelResult::pose_valid
  kLost       // the pose is unknown; it is sought in every frame, near the last pose and where views are like this one
};

enum class SiteKind : uint8_t {
  kInlier,
  kRejectedLocally,  // nothing along the normal is like what this site has shown before
  kRejectedRobustly  // an edge was found, but the pose does not agree with it
};

// A place on a visible contour.
struct ModelSite {
  Vector2f px = Vector2f::Zero();        // the edge found, level-0 pixels of the frame; kRejectedLocally: model_px
  Vector2f model_px = Vector2f::Zero();  // on the model's contour at T_co, where the frame has it (rolling shutter)
  uint16_t contour = 0;                  // sites of the same contour follow each other along it
  SiteKind kind = SiteKind::kRejectedLocally;
};

enum class ModelFeature : uint8_t { kLine, kCylinder, kCircle, kSphere };
constexpr int kModelFeatures = 4;

struct ModelResult {
  Status status;             // not ok: the frame was refused, nothing changed, all else but the timestamp is default
  int64_t timestamp_ns = 0;  // the frame's
  ModelState state = ModelState::kWaiting;
  bool pose_valid = false;  // true only in state kTracking
  bool restarted = false;   // the pose was found anew in this frame
  SE3 T_co;
  // Of mu in T_co <- exp(mu) T_co, model units and radians, by this frame's edges alone. What they do not tell has a
  // sigma of half a radian, or half the distance, or as much as float32 resolves beside the rest.
  Matrix6f covariance = Matrix6f::Zero();
  float quality = 0;                            // share of the visible contours that look as they should, 0 to 1
  float error_px = 0;                           // rms distance of inliers from their contours, level-0 pixels
  float feature_error_px[kModelFeatures] = {};  // the same by ModelFeature
  int feature_inliers[kModelFeatures] = {};
  int sites_visible = 0;
  int sites_inliers = 0;
  std::span<const ModelSite> sites;  // valid until the next call of track()
};

class ModelTracker {
 public:
  ModelTracker(const ModelTracker&) = delete;  // it lives in the caller's memory
  ModelTracker& operator=(const ModelTracker&) = delete;

  // Bytes of memory that create() needs for this configuration; 0 when config.validate() is not ok.
  static size_t required_bytes(const ModelTrackerConfig& config);
  // Builds the tracker inside memory (aligned as by malloc, at least required_bytes), which must outlive it. *tracker
  // is set only on success; there is nothing to destroy.
  static Status create(const ModelTrackerConfig& config, std::span<std::byte> memory, ModelTracker** tracker);

  // The object is near T_co in the next frame: about 15 degrees and a tenth of its distance. All that was learnt of its
  // looks is forgotten. Refused, with nothing changed, when the pose is not finite, not a rotation, or the object's
  // middle is not in front of the camera.
  Status start(const SE3& T_co);
  // The same from four or more points of the object (model units) and where they are seen (level-0 pixels): no three of
  // them in a line. Refused when no pose shows them there within 20 px each.
  Status start(std::span<const Vector3f> points_o, std::span<const Vector2f> px);
  // The object is wholly in view in one of the next frames, larger than a quarter of the image's shorter side; nothing
  // else is known of it. Each frame is searched until one shows it, as states kLost, at a cost of hundreds of millions
  // of instructions. What is behind it must be plain: before clutter it is often found wrongly or not at all. Of views
  // that are alike any may be taken.
  void start_anywhere();
  void reset();  // waits for start()

  // Tracks one frame to completion. Refuses (result.status) incomplete frames, another size than the camera's, and
  // timestamps that do not increase.
  ModelResult track(const Frame& frame);

  const ModelTrackerConfig& config() const;

 private:
  struct Impl;
  explicit ModelTracker(Impl* impl) : impl_(impl) {}
  Impl* impl_;
};

}  // namespace pptam
