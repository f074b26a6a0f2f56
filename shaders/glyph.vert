// Letters: rectangles of the canvas with a part of the letters' image each.
attribute vec2 position;  // canvas, pixels
attribute vec2 place;     // in the letters' image, 0 to 1
attribute vec4 colour;
uniform mat3 canvas;  // homogeneous canvas pixels to clip coordinates
varying vec2 at;
varying vec4 shade;

void main() {
  at = place;
  shade = colour;
  gl_Position = vec4((canvas * vec3(position, 1.0)).xy, 0.0, 1.0);
}
