// Letters: the image holds how much of each pixel is covered.
#ifdef GL_FRAGMENT_PRECISION_HIGH
precision highp float;  // a half has 10 bits: not enough for places in a wide image
#else
precision mediump float;
#endif
varying vec2 at;
varying vec4 shade;
uniform sampler2D letters;

void main() { gl_FragColor = vec4(shade.rgb, shade.a * texture2D(letters, at).a); }
