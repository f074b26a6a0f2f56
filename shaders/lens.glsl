// Where the camera sees a point of the world: the lens and the rolling shutter of core/camera, in the same equations.
// Stands before the shaders that draw the world, which are compiled for each lens that is met, as software renderers
// compute both sides of an if: DISTORTION is 0 none, 1 FOV, 2 radial-tangential, 3 equidistant; ROLLING is 1 with a
// rolling shutter, else 0.
// Camera frame: x right, y down, z forward; pixels: centres at integers.

uniform mat3 R_cw;
uniform vec3 t_cw;
uniform vec3 linear_velocity;   // of the camera: world units/s
uniform vec3 angular_velocity;  // radians/s
uniform vec4 focal_centre;      // fx, fy, cx, cy in pixels
uniform vec4 coeffs;            // FOV: w, 2 tan(w / 2); else as CameraModel::coeffs
uniform float coeff_4;          // radial-tangential: k3
uniform float max_radius;       // largest |(x/z, y/z)| that the lens shows
uniform vec2 line_time;         // seconds from a column, and from a row, to the next
uniform vec2 middle;            // of the image, pixels: its line is exposed at the timestamp
uniform float half_readout;     // seconds: all lines are exposed within so much of the timestamp
uniform mat3 canvas_px;         // homogeneous pixels of the image to clip coordinates
uniform float near_z;           // world units: what is nearer is not drawn

const float kSmallRadius = 0.01;  // below: series, as in the core

// Distorted normalised coordinates; [ptam eq. 3-5] and OpenCV's models.
vec2 through_lens(vec2 n) {
#if DISTORTION == 0
  return n;
#else
  float r_sq = dot(n, n);
  float r = sqrt(r_sq);
#if DISTORTION == 1
  float x = r * coeffs.y;
  float gain = r < kSmallRadius ? coeffs.y * (1.0 - x * x / 3.0) : atan(x) / r;
  return n * (gain / coeffs.x);
#elif DISTORTION == 2
  float radial = 1.0 + r_sq * (coeffs.x + r_sq * (coeffs.y + r_sq * coeff_4));
  vec2 p = coeffs.zw;
  float xy = n.x * n.y;
  return n * radial + vec2(2.0 * p.x * xy + p.y * (r_sq + 2.0 * n.x * n.x),
                           p.x * (r_sq + 2.0 * n.y * n.y) + 2.0 * p.y * xy);
#else
  float t = atan(r);
  float s = t * t;
  float angle = t * (1.0 + s * (coeffs.x + s * (coeffs.y + s * (coeffs.z + s * coeffs.w))));
  return n * (r < kSmallRadius ? 1.0 + r_sq * (coeffs.x - 1.0 / 3.0) : angle / r);
#endif
#endif
}

// Pixels times q.z. Beyond max_radius the lens is taken to magnify as at max_radius: what reaches there, or behind the
// camera, is then cut off along straight lines.
vec3 homogeneous_px(vec3 q) {
#if DISTORTION == 0
  vec2 n = q.xy;
#else
  float radius = max(length(q.xy), 1e-20);
  float z = max(q.z, radius / max_radius);
  vec2 n = through_lens(q.xy / z) * z;
#endif
  return vec3(n * focal_centre.xy + focal_centre.zw * q.z, q.z);
}

// exp(dt velocity) q to the third order: moved_point() of the core.
vec3 moved(vec3 q, float dt) {
  vec3 first = dt * (linear_velocity + cross(angular_velocity, q));
  vec3 second = 0.5 * dt * cross(angular_velocity, first);
  return q + first + second + (dt / 3.0) * cross(angular_velocity, second);
}

// Where a point of the world is seen, in homogeneous pixels, at the time dt (seconds after the frame's) at which its
// line of the image is exposed: Camera::project_rolling() of the core, with as many fixed-point passes.
vec3 seen(vec3 p_w, out float dt) {
  vec3 q = R_cw * p_w + t_cw;
  vec3 px = homogeneous_px(q);
  dt = 0.0;
#if ROLLING
  for (int pass = 0; pass < 2; ++pass) {
    dt = clamp(dot(px.xy / max(px.z, near_z) - middle, line_time), -1.5 * half_readout, 1.5 * half_readout);
    px = homogeneous_px(moved(q, dt));
  }
#endif
  return px;
}

// Another point at that time.
vec3 seen_at(vec3 p_w, float dt) {
  vec3 q = R_cw * p_w + t_cw;
#if ROLLING
  q = moved(q, dt);
#endif
  return homogeneous_px(q);
}

// The depth buffer holds 1 - 2 near / z: no farthest distance.
vec4 clip_position(vec3 px) {
  vec3 at = canvas_px * px;
  return vec4(at.xy, px.z - 2.0 * near_z, px.z);
}
