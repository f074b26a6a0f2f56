// Lines with smooth edges.
precision mediump float;
varying vec4 shade;
varying vec2 across;

void main() {
  float cover = clamp(across.y + 0.5 - abs(across.x), 0.0, 1.0);
  gl_FragColor = vec4(shade.rgb, shade.a * cover);
}
