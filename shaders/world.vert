// Triangles and points of the world. lens.glsl stands before it.
attribute vec3 p_w;
attribute vec4 colour;
attribute float size;  // of a point, pixels of the canvas; of a triangle unused
varying vec4 shade;

void main() {
  float dt;
  gl_Position = clip_position(seen(p_w, dt));
  gl_PointSize = size;
  shade = colour;
}
