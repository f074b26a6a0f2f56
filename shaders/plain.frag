// Triangles of the world: the colour is all there is.
precision mediump float;
varying vec4 shade;

void main() { gl_FragColor = shade; }
