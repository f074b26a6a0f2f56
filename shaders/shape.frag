// The distance from a box with round corners covers a pixel smoothly.
#ifdef GL_FRAGMENT_PRECISION_HIGH
precision highp float;
#else
precision mediump float;
#endif
varying vec2 from_centre;
varying vec4 shape;
varying vec4 shade;

void main() {
  vec2 beyond = abs(from_centre) - shape.xy;
  float distance = length(max(beyond, 0.0)) + min(max(beyond.x, beyond.y), 0.0) - shape.z;
  if (shape.w > 0.0) distance = abs(distance) - 0.5 * shape.w;
  gl_FragColor = vec4(shade.rgb, shade.a * clamp(0.5 - distance, 0.0, 1.0));
}
