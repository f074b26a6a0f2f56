#include "platform/calibrate/lens_fit.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "platform/input_error.h"
#include "platform/text.h"

namespace pptam::platform {
namespace {

constexpr size_t kMinViews = 6;  // three would do for the equations; fewer than six leave mistakes unseen
constexpr size_t kWantedViews = 12;
constexpr double kMinTiltSpread = 0.1;   // of the views' tilts: without any the focal length cannot be told
constexpr double kMinFocalWidths = 0.3;  // focal length by the image's longer side: 118 degrees across
constexpr double kMaxFocalWidths = 5;    // 11 degrees
constexpr double kMaxFocalSigma = 0.01;  // of the focal length, relative: refused; a fifth of it is warned of
constexpr double kMaxAspect = 1.02;      // fx against fy, before it is told
constexpr double kGoodRms_px = 0.6;      // at the width of kUsualWidth, before it is told
constexpr double kMaxRms_px = 3;         // likewise, before it is refused
constexpr double kUsualWidth = 640;
constexpr double kOutlierRatio = 3;       // of a view's rms to the median
constexpr double kOutlierFloor_px = 0.3;  // below this a view is as good as any
constexpr double kLeastNoise_px = 0.001;  // of corners: better is made up
constexpr double kWorthATerm = 20;        // fall of -2 log likelihood, for a coefficient more or another lens
constexpr double kGoodUncertain_px = 1;   // before it is told
constexpr size_t kFolds = 5;              // of the jackknife

std::vector<std::vector<Vector2d>> corners_of(const std::vector<BoardView>& views) {
  std::vector<std::vector<Vector2d>> corners;
  corners.reserve(views.size());
  for (const BoardView& view : views) corners.push_back(view.corners);
  return corners;
}

// Rms distances of each view, and their mean over all corners.
void measure_residuals(LensFit* fit) {
  fit->view_rms_px.clear();
  double sum = 0, count = 0;
  for (size_t v = 0; v < fit->views.size(); ++v) {
    double view_sum = 0;
    const std::vector<Vector2d>& corners = fit->views[v].corners;
    for (size_t i = 0; i < corners.size(); ++i) view_sum += (corners[i] - fit->solution.predicted[v][i]).squaredNorm();
    fit->view_rms_px.push_back(std::sqrt(view_sum / static_cast<double>(corners.size())));
    sum += view_sum;
    count += static_cast<double>(corners.size());
  }
  fit->rms_px = std::sqrt(sum / count);
}

double median_rms(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

// Rms of a view beyond which it does not fit the others.
double outlier_limit(double median_px) {
  return std::max(kOutlierRatio * median_px, kOutlierFloor_px);
}

// Solves, and once more without the views that do not fit the others. False: no solution.
bool solve(const std::vector<Vector2d>& plane, const std::vector<BoardView>& views, const BoardVision& vision,
           int width, int height, LensKind kind, LensFit* fit) {
  fit->views = views;
  for (int round = 0; round < 2; ++round) {
    fit->solution = vision.solve(width, height, plane, corners_of(fit->views), kind);
    if (!fit->solution.trouble.empty()) return false;
    measure_residuals(fit);
    const double limit = outlier_limit(median_rms(fit->view_rms_px));
    if (round == 1 || *std::max_element(fit->view_rms_px.begin(), fit->view_rms_px.end()) <= limit) break;
    std::vector<BoardView> kept;
    for (size_t i = 0; i < fit->views.size(); ++i) {
      if (fit->view_rms_px[i] <= limit) {
        kept.push_back(fit->views[i]);
      } else {
        fit->left_out.push_back(fit->views[i].frame);
      }
    }
    fit->views = std::move(kept);
  }
  fit->model = model_of(fit->solution, width, height);
  if (!fit->model.validate().ok()) return false;
  fit->model.prepare();
  return true;
}

// The one that fits best, the normal lens unless another is better by more than chance.
LensFit solve_simplest(const std::vector<Vector2d>& plane, const std::vector<BoardView>& views,
                       const BoardVision& vision, int width, int height, std::optional<LensKind> kind) {
  std::vector<LensFit> fits;
  std::string trouble = "the views fit no lens";
  for (const LensKind tried : {LensKind::kNormal, LensKind::kWide, LensKind::kFisheye}) {
    if (kind && tried != *kind) continue;
    LensFit fit;
    if (solve(plane, views, vision, width, height, tried, &fit)) {
      fits.push_back(std::move(fit));
    } else if (!fit.solution.trouble.empty()) {
      trouble = "OpenCV: " + fit.solution.trouble;
    } else {
      trouble = fit.model.validate().message();
    }
  }
  if (fits.empty()) {
    throw InputError("no lens was found: " + trouble +
                     "; add views from other sides, with the board all over the image, or try another --lens");
  }
  // Where the board was not seen the lenses differ by pixels, though they hardly do where it was: even a small gain
  // that cannot be chance decides. -2 log likelihood of all views, with the noise of the kind that fits best; a view
  // that is left out costs as much as the worst that is not, whatever the kind.
  double usual_px = INFINITY;
  for (const LensFit& fit : fits) usual_px = std::min(usual_px, median_rms(fit.view_rms_px));
  usual_px = std::max(usual_px, kLeastNoise_px);
  const auto badness = [&](const LensFit& fit) {
    const double most_px = outlier_limit(usual_px);
    double sum = static_cast<double>(fit.left_out.size()) * most_px * most_px;
    for (const double rms_px : fit.view_rms_px) sum += std::pow(std::min(rms_px, most_px), 2);
    return 2 * static_cast<double>(plane.size()) * sum / (usual_px * usual_px) +
           (fit.solution.kind == LensKind::kNormal ? 0 : kWorthATerm);
  };
  return std::move(*std::min_element(fits.begin(), fits.end(),
                                     [&](const LensFit& a, const LensFit& b) { return badness(a) < badness(b); }));
}

// Before anything is solved: what makes every solution worthless.
void check_views(const std::vector<BoardView>& views, const Coverage& coverage) {
  const std::vector<std::string> missing = coverage.missing();
  const std::string advice = missing.empty() ? std::string() : "; " + missing.front();
  if (views.size() < kMinViews) {
    throw InputError(format("only %zu usable views of the board: at least %zu are needed, %zu or more are good",
                            views.size(), kMinViews, kWantedViews) +
                     advice);
  }
  double spread = 0;
  for (const BoardView& a : views) {
    for (const BoardView& b : views) spread = std::max(spread, (a.tilt - b.tilt).norm());
  }
  if (spread < kMinTiltSpread) {
    throw InputError(
        "all views show the board from the same side, which does not tell the focal length: tilt the board, or walk "
        "round it, by 20 to 40 degrees to the left, the right, up and down");
  }
}

void judge(const std::vector<BoardView>& views, LensFit* fit) {
  const CameraModel& m = fit->model;
  const LensSolution& s = fit->solution;
  const double longer = std::max(m.width, m.height);
  const double focal = s.fx / longer;
  if (focal < kMinFocalWidths || focal > kMaxFocalWidths) {
    throw InputError(
        format("the focal length came out as %.0f px, %.2f times the image's longer side, which no usual "
               "lens has: add views that are tilted clearly, and see that the board is flat",
               s.fx, focal));
  }
  const double scale = std::max(1.0, longer / kUsualWidth);
  if (fit->rms_px > kMaxRms_px * scale) {
    throw InputError(
        format("the views fit no lens: their corners lie %.1f px off in the mean. Is the board flat and "
               "--board right? Was the zoom or the focus changed, or the image stabilised?",
               fit->rms_px));
  }
  if (s.sigma_fx > kMaxFocalSigma * s.fx) {
    throw InputError(
        format("the views leave the focal length uncertain by %.1f %%: add views that are tilted by 20 to "
               "40 degrees",
               100 * s.sigma_fx / s.fx));
  }
  if (s.sigma_fx > 0.2 * kMaxFocalSigma * s.fx) {
    fit->warnings.push_back(format("the focal length is uncertain by %.2f %%: more views that are tilted would help",
                                   100 * s.sigma_fx / s.fx));
  }
  if (fit->rms_px > kGoodRms_px * scale) {
    fit->warnings.push_back(
        format("the corners lie %.2f px off in the mean, usual are 0.1 to 0.4: is the board flat, "
               "and was the camera held still? If the lens is very wide, try --lens fisheye",
               fit->rms_px));
  }
  const double aspect = std::max(s.fx / s.fy, s.fy / s.fx);
  if (aspect > kMaxAspect) {
    fit->warnings.push_back(
        format("fx and fy differ by %.1f %%: if the camera's pixels are square, then the board's "
               "squares are not; measure its sides",
               100 * (aspect - 1)));
  }
  if (views.size() < kWantedViews) {
    fit->warnings.push_back(
        format("only %zu views: %zu or more make a calibration reliable", views.size(), kWantedViews));
  }
  if (!fit->uncertain_px && fit->views.size() >= kFolds + kMinViews) {
    fit->warnings.push_back(
        "with a fifth of the views fewer no lens is found that holds to the image's corners, which are uncertain "
        "therefore: add views that have the board there");
  }
  if (fit->uncertain_px && *fit->uncertain_px > kGoodUncertain_px * scale) {
    fit->warnings.push_back(
        format("somewhere in the image the lens is uncertain by %.1f px: add views where the board "
               "was hardly seen",
               *fit->uncertain_px));
  }
}

std::optional<double> uncertainty_of(const std::vector<Vector2d>& plane, const LensFit& fit,
                                     const BoardVision& vision) {
  if (fit.views.size() < kFolds + kMinViews) return std::nullopt;
  double squares = 0;
  for (size_t fold = 0; fold < kFolds; ++fold) {
    std::vector<BoardView> views;
    for (size_t i = 0; i < fit.views.size(); ++i) {
      if (i % kFolds != fold) views.push_back(fit.views[i]);
    }
    const LensSolution solution =
        vision.solve(fit.model.width, fit.model.height, plane, corners_of(views), fit.solution.kind);
    if (!solution.trouble.empty()) return std::nullopt;
    CameraModel model = model_of(solution, fit.model.width, fit.model.height);
    if (!model.validate().ok()) return std::nullopt;
    model.prepare();
    const double difference = largest_difference_px(model, fit.model);
    squares += difference * difference;
  }
  return std::sqrt(squares * (kFolds - 1) / kFolds);
}

}  // namespace

const char* name_of(LensKind kind) {
  switch (kind) {
    case LensKind::kNormal:
      return "normal";
    case LensKind::kWide:
      return "wide";
    case LensKind::kFisheye:
      return "fisheye";
  }
  return "?";
}

CameraModel model_of(const LensSolution& solution, int width, int height) {
  CameraModel model;
  model.width = width;
  model.height = height;
  model.fx = static_cast<float>(solution.fx);
  model.fy = static_cast<float>(solution.fy);
  model.cx = static_cast<float>(solution.cx);
  model.cy = static_cast<float>(solution.cy);
  model.distortion = solution.kind == LensKind::kFisheye ? Distortion::kEquidistant : Distortion::kRadTan;
  for (size_t i = 0; i < 5; ++i) model.coeffs[i] = static_cast<float>(solution.coeffs[i]);
  return model;
}

double largest_difference_px(const CameraModel& a, const CameraModel& b) {
  constexpr int kSteps = 48;  // places along either side: what differs between them is smooth
  std::vector<Eigen::Vector3d> rays_a, rays_b;
  std::vector<Vector2f> pixels;
  for (int y = 0; y <= kSteps; ++y) {
    for (int x = 0; x <= kSteps; ++x) {
      const Vector2f px(static_cast<float>(x * (a.width - 1)) / kSteps,
                        static_cast<float>(y * (a.height - 1)) / kSteps);
      pixels.push_back(px);
      rays_a.push_back(a.unproject(px).homogeneous().cast<double>());
      rays_b.push_back(b.unproject(px).homogeneous().cast<double>());
    }
  }
  // Small turns: projected by b, ray_a must come to px. Gauss-Newton in the plane of (x/z, y/z), which b's Jacobian
  // takes to pixels.
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  double largest = 0;
  for (int step = 0; step < 6; ++step) {
    Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
    Eigen::Vector3d g = Eigen::Vector3d::Zero();
    largest = 0;
    for (size_t i = 0; i < pixels.size(); ++i) {
      const Eigen::Vector3d q = R * rays_a[i];
      Vector2f px;
      Matrix23f J_px_p;
      if (!b.project(q.cast<float>(), &px, &J_px_p)) return INFINITY;
      const Vector2d error = (pixels[i] - px).cast<double>();
      largest = std::max(largest, error.norm());
      Eigen::Matrix3d J_q;
      J_q << 0, q.z(), -q.y(), -q.z(), 0, q.x(), q.y(), -q.x(), 0;
      const Eigen::Matrix<double, 2, 3> J = J_px_p.cast<double>() * J_q;
      A += J.transpose() * J;
      g += J.transpose() * error;
    }
    const Eigen::Vector3d turn = A.ldlt().solve(g);
    if (step < 5 && turn.norm() > 0) R = Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix() * R;
  }
  return largest;
}

LensFit fit_lens(const Board& board, int width, int height, std::vector<BoardView> views, const Coverage& coverage,
                 const BoardVision& vision, std::optional<LensKind> kind) {
  check_views(views, coverage);
  const std::vector<Vector2d> plane = board.plane();
  LensFit fit = solve_simplest(plane, views, vision, width, height, kind);
  if (fit.views.size() < kMinViews) {
    throw InputError(
        format("only %zu of %zu views fit one another: is the board flat? Was the zoom or the focus "
               "changed, or the image stabilised?",
               fit.views.size(), views.size()));
  }
  fit.uncertain_px = uncertainty_of(plane, fit, vision);
  judge(fit.views, &fit);
  return fit;
}

}  // namespace pptam::platform
