// The pose by robust virtual visual servoing [vvs 2]: the camera that makes the model's contours pass through the edges
// that were found.
//
//   T_co <- exp(T_c)^-1 T_co,  T_c = -(D L)^+ D d   [vvs eq. 7]
//
// d: distances of the found points from their contours, L their interaction matrices, both of this iteration; D = diag
// (Tukey's weight times the site's likelihood, eq. 24), on both sides, so that weights count squared. Tukey's scale is
// 1.48 times the median magnitude in each iteration: the MAD about zero, since distances that are all off to one side
// are what the step shall mend, not their centre. Of several edges that a site has found, each iteration takes the one
// that is likely and near.
#pragma once

#include <array>

#include <pocket_ptam/camera.h>
#include "base/containers.h"
#include "edges/edge_search.h"
#include "edges/model_view.h"
#include "geometry/normal_equations.h"

namespace pptam {

// A site whose search has found something.
struct EdgeMeasurement {
  uint16_t contour = 0;
  uint16_t site = 0;       // index of its site
  uint16_t placed = 0;     // of its contour among those placed
  uint8_t candidates = 0;  // at least 1
  uint8_t chosen = 0;      // of these, in the last iteration
  std::array<Vector2f, kMaxCandidates>
      ray;  // normalised coordinates of the edges, as a camera at the frame's timestamp sees them
  std::array<EdgeCandidate, kMaxCandidates> edge;
  float coherence = 1;    // mean likeness of the best edges of this site and its neighbours along the contour
  float distance_px = 0;  // result: from the contour, level-0 pixels
  float weight = 0;       // result: Tukey's, 0 for outliers
};

struct ServoingOptions {
  int iterations = 0;
  float range_px = 0;        // of the search, level-0 pixels
  float sigma_floor_px = 0;  // least scale of the robust weights, level-0 pixels
  // A prior that holds what edges do not tell: 1-sigma of a turn about the object's middle, radians, and of a shift of
  // the middle, in its distances, about T_prior.
  SE3 T_prior;
  float prior_turn = 0, prior_shift = 0;
};

struct ServoingResult {
  bool ok = false;  // enough edges
  SE3 T_co;
  float sigma_px = 0;  // robust scale of the distances, level-0 pixels
  int inliers = 0;
  Matrix6f covariance = Matrix6f::Zero();  // of mu in T_co <- exp(mu) T_co
};

class Servoing {
 public:
  Servoing(Arena& arena, const ModelView& view, const ModelParts& parts, const ModelTrackerConfig& config);

  // From T_start.
  ServoingResult run(const SE3& T_start, const ServoingOptions& options, FixedVector<EdgeMeasurement>* measurements);

 private:
  friend class RobustFit<Servoing>;
  struct Placed {
    bool ok = false, straight = true;
    LineContour line;
    EllipseContour ellipse;
  };

  // Interface for RobustFit.
  bool errors(int iteration);
  void scale();
  int residuals() const { return measurements_->size(); }
  void sum(int from, int to);
  FitStep step(int iteration);

  void place(int contour);
  void interaction(int measurement, float (&L)[6]);
  bool solve(Vector6f* x);
  void to_noise();
  void finish(const Matrix6f& to_mu);

  const ModelView& view_;
  const ModelParts& parts_;
  const ModelMethod method_;
  float focal_;                 // level-0 pixels, mean
  FixedVector<Placed> placed_;  // contours at the present pose, in the order in which the measurements name them
  FixedVector<float> squared_;
  FixedVector<std::array<float, 6>> first_rows_;  // of a constant Jacobian: the first iteration's, by measurement
  NormalEquations<6> equations_;  // of the shift of the object's middle, in its distances, and the turn about it

  // State of the run.
  RobustFit<Servoing> fit_;
  ServoingOptions options_;
  FixedVector<EdgeMeasurement>* measurements_ = nullptr;
  ServoingResult result_;
  SE3 T_;
  int iteration_ = 0;
  bool last_ = false;                   // this iteration only weights
  int seen_ = 0;                        // measurements that have a distance
  float sigma_px_ = 0;                  // robust scale without its floor
  Vector3f middle_ = Vector3f::Zero();  // the object's, camera frame
  float depth_ = 1;                     // its distance
  float weights_ = 0;                   // sum
};

}  // namespace pptam
