// Points of the world: discs.
precision mediump float;
varying vec4 shade;

void main() {
  vec2 from_centre = 2.0 * gl_PointCoord - 1.0;
  if (dot(from_centre, from_centre) > 1.0) discard;
  gl_FragColor = shade;
}
