// The camera's image: colours as they are, or luminance and chroma (BT.601, 16 to 235). Compiled for each KIND that is
// met: 0 as it is, 1 BGRA, 2 YUYV, 3 NV12, 4 NV21, 5 I420.
#ifdef GL_FRAGMENT_PRECISION_HIGH
precision highp float;
#else
precision mediump float;
#endif
varying vec2 place;
uniform sampler2D plane_0;  // grey, RGB, or luminance
uniform sampler2D plane_1;  // both chromas in luminance and alpha, or the first of them; of YUYV its pairs of pixels
uniform sampler2D plane_2;  // the second chroma

vec3 rgb_of(float y, vec2 chroma) {
  float luma = 1.164384 * (y - 0.0627451);
  vec2 uv = chroma - 0.5019608;
  return vec3(luma + 1.596027 * uv.y, luma - 0.391762 * uv.x - 0.812968 * uv.y, luma + 2.017232 * uv.x);
}

void main() {
  vec4 first = texture2D(plane_0, place);
#if KIND == 0
  gl_FragColor = first;
#elif KIND == 1
  gl_FragColor = first.bgra;
#elif KIND == 2
  gl_FragColor = vec4(rgb_of(first.r, texture2D(plane_1, place).ga), 1.0);
#elif KIND == 3
  gl_FragColor = vec4(rgb_of(first.r, texture2D(plane_1, place).ra), 1.0);
#elif KIND == 4
  gl_FragColor = vec4(rgb_of(first.r, texture2D(plane_1, place).ar), 1.0);
#else
  gl_FragColor = vec4(rgb_of(first.r, vec2(texture2D(plane_1, place).r, texture2D(plane_2, place).r)), 1.0);
#endif
}
