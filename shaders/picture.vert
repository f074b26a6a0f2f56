// The camera's image as a rectangle of the canvas.
attribute vec2 corner;  // 0 or 1 from the left and from the top
uniform mat3 canvas;    // homogeneous corners to clip coordinates
uniform mat3 shown;     // homogeneous corners to places in the image, 0 to 1
varying vec2 place;

void main() {
  place = (shown * vec3(corner, 1.0)).xy;
  gl_Position = vec4((canvas * vec3(corner, 1.0)).xy, 0.0, 1.0);
}
