// Letters: the image holds how much of each pixel is covered.
precision mediump float;
varying vec2 at;
varying vec4 shade;
uniform sampler2D letters;

void main() { gl_FragColor = vec4(shade.rgb, shade.a * texture2D(letters, at).a); }
