// Flat shapes on the canvas, each a rectangle that holds a box with round corners: discs, rings, bars, strokes.
attribute vec2 position;  // canvas, pixels: corners at integers
attribute vec2 local;     // from the shape's centre, along its own axes, pixels
attribute vec4 form;      // half width and half height without the round corners, their radius, stroke (0: filled)
attribute vec4 colour;
uniform mat3 canvas;  // homogeneous canvas pixels to clip coordinates
varying vec2 from_centre;
varying vec4 shape;
varying vec4 shade;

void main() {
  from_centre = local;
  shape = form;
  shade = colour;
  gl_Position = vec4((canvas * vec3(position, 1.0)).xy, 0.0, 1.0);
}
