#include "mapping/measurement_culling.h"

namespace pptam {

namespace {

// Lower triangle of a symmetric 3x3 matrix.
struct Symmetric3 {
  float xx = 0, yx = 0, yy = 0, zx = 0, zy = 0, zz = 0;
  float determinant() const { return xx * (yy * zz - zy * zy) - yx * (yx * zz - zx * zy) + zx * (yx * zy - zx * yy); }
};

}  // namespace

void measure_usefulness(const Map& map, const Camera& camera, const MapPoint& point, float* m) {
  const int count = point.measurements.size();
  if (count == 0) return;
  // Lengths are divided by a typical depth: V_j is of order 1 / sigma^2 then, and |V| stays within float32's range.
  const float depth = map.keyframes()[map.measurements(point)[0].keyframe].mean_depth;
  const float aspect = camera.model.fy / camera.model.fx;
  Symmetric3 V_j[kMaxMeasurementsPerPoint + 1], V;
  int next = 0;
  for (const Measurement& measurement : map.measurements(point)) {
    Symmetric3& A = V_j[next++];
    const SE3& T_kw = map.keyframes()[measurement.keyframe].T_kw;
    const Vector3f p_k = T_kw * point.p_w;
    if (!(p_k.z() > 0)) continue;
    const float inverse_z = 1.0f / p_k.z();
    const float u = p_k.x() * inverse_z, v = p_k.y() * inverse_z;
    const float scale = depth * inverse_z / measurement.at.sigma();
    const float s = measurement.weight * scale * scale;
    float a[3], b[3];  // rows of B_j, whose common factor is in s
    for (int i = 0; i < 3; ++i) {
      a[i] = T_kw.R(0, i) - u * T_kw.R(2, i);
      b[i] = aspect * (T_kw.R(1, i) - v * T_kw.R(2, i));
    }
    A.xx = s * (a[0] * a[0] + b[0] * b[0]);
    A.yx = s * (a[1] * a[0] + b[1] * b[0]);
    A.yy = s * (a[1] * a[1] + b[1] * b[1]);
    A.zx = s * (a[2] * a[0] + b[2] * b[0]);
    A.zy = s * (a[2] * a[1] + b[2] * b[1]);
    A.zz = s * (a[2] * a[2] + b[2] * b[2]);
    V.xx += A.xx, V.yx += A.yx, V.yy += A.yy, V.zx += A.zx, V.zy += A.zy, V.zz += A.zz;
  }
  const float all = V.determinant();
  for (int j = 0; j < count; ++j) {
    const Symmetric3& A = V_j[j];
    m[j] = all - Symmetric3{V.xx - A.xx, V.yx - A.yx, V.yy - A.yy, V.zx - A.zx, V.zy - A.zy, V.zz - A.zz}.determinant();
  }
}

void cull_measurements(Map& map, int index, const Camera& camera, WorkMeter& meter) {
  const MapPoint& point = map.points()[index];
  while (point.measurements.size() > map.max_measurements_per_point()) {
    float m[kMaxMeasurementsPerPoint + 1];
    measure_usefulness(map, camera, point, m);
    meter.charge(Work::kOther, kUsefulnessInstructions * point.measurements.size());
    int worst = -1, j = 0;
    for (const Measurement& measurement : map.measurements(point)) {
      if (measurement.keyframe != point.source.keyframe && (worst < 0 || m[j] < m[worst])) worst = j;
      ++j;
    }
    map.remove_measurement(index, worst);
  }
}

}  // namespace pptam
