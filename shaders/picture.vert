// The camera's image as a rectangle of the canvas.
attribute vec2 corner;    // 0 or 1 from the left and from the top
uniform vec2 image_size;  // pixels
uniform mat3 canvas_px;   // homogeneous pixels of the image to clip coordinates
varying vec2 place;

void main() {
  place = corner;
  gl_Position = vec4((canvas_px * vec3(corner * image_size - 0.5, 1.0)).xy, 0.0, 1.0);
}
