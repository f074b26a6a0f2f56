// Lines of the world, as wide on the canvas everywhere: four corners for each short piece. lens.glsl stands before it.
attribute vec3 p_w;       // this end
attribute vec3 other_w;   // the other one
attribute vec4 colour;    // at this end
attribute vec2 offset;    // across, pixels of the canvas: half a width and half a pixel for its smooth edge, signed
uniform vec2 half_canvas;  // pixels
uniform float closer;      // the depth is made less by this: a line on a wall is before the wall
varying vec4 shade;
varying vec2 across;  // signed distance from the line, half the width: pixels

void main() {
  float dt;
  vec3 here = seen(p_w, dt);
  vec3 there = seen_at(other_w, dt);  // only the direction comes from it
  shade = colour;
  across = vec2(offset.x, abs(offset.x) - 0.5);
  if (here.z < near_z || there.z < near_z) {  // half before the camera: not drawn
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    return;
  }
  vec4 from = clip_position(here);
  vec4 to = clip_position(there);
  vec2 along = (to.xy / to.w - from.xy / from.w) * half_canvas;
  float length_px = length(along);
  vec2 normal = length_px > 1e-6 ? vec2(-along.y, along.x) / length_px : vec2(0.0);
  // The other end sees the line run the other way: offset.y is -1 there.
  gl_Position = from;
  gl_Position.xy += normal * (offset.x * offset.y) / half_canvas * from.w;
  gl_Position.z -= closer * from.w;
}
