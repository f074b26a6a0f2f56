// Draws a frame, what was found in it and the house with WebGL, by the shaders of the native display (shaders/): each
// vertex goes through the camera's lens at the time at which its line of the image was exposed.
import {houseCorners, placeHouse, siteModel, toWorld} from './house.js';
import {shaders} from './shaders.js';

/** @typedef {import('./pocket_ptam.js').Camera} Camera */
/** @typedef {import('./pocket_ptam.js').TrackResult} TrackResult */
/**
 * @typedef {{centre: number[], half?: number[], direction?: number[], radius: number, stroke?: number, colour:
 * number[]}} Shape
 */
/** @typedef {{vertices: WebGLBuffer, indices: WebGLBuffer|null, count: number}} Batch */

// Of each kind of vertex: attributes and their floats, as they lie in a buffer.
const kTriangle = [['p_w', 3], ['colour', 4]];
const kLine = [['p_w', 3], ['other_w', 3], ['colour', 4], ['offset', 2]];
const kShape = [['position', 2], ['local', 2], ['form', 4], ['colour', 4]];
const kCorner = [['corner', 2]];
const kBaseline = 0.1;     // world units: Config.initial_baseline as configPhone() has it
const kEdgeCloser = 5e-5;  // of the depth's range of 2: 16 bits tell 3e-5 apart

const kGreen = [51, 217, 102, 255], kDarkGreen = [5, 64, 26, 230], kRed = [242, 64, 64, 255];
const kYellow = [255, 209, 51, 255], kBlue = [77, 166, 255, 230], kGrey = [184, 184, 184, 178];

export class Renderer {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.lost = false;
    /** @type {Map<number, import('./house.js').Site>} by TrackResult.map */
    this.sites = new Map();
    this.worldChanges = 0;
    canvas.addEventListener('webglcontextlost', (event) => {
      event.preventDefault();  // else it is not restored
      this.lost = true;
    });
    canvas.addEventListener('webglcontextrestored', () => this.begin());
    this.begin();
  }

  begin() {
    const gl = this.canvas.getContext('webgl', {alpha: false, antialias: false, depth: true});
    if (!gl) throw new Error('This browser draws no WebGL here');
    this.gl = gl;
    this.lost = gl.isContextLost();
    if (this.lost) return;
    this.programs = new Map();  // by their sources' names
    this.model = null;          // batches of the house
    this.modelSite = null;      // whose
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
      gl.texParameteri(gl.TEXTURE_2D, filter, gl.LINEAR);
    for (const wrap of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, wrap, gl.CLAMP_TO_EDGE);
    this.corners = this.uploaded([0, 0, 1, 0, 0, 1, 1, 1], [], 2);
    this.shapes = {vertices: gl.createBuffer(), indices: null, count: 0};
  }

  /** @param {string} key @param {string} vertex @param {string} fragment @param {any[][]} attributes */
  program(key, vertex, fragment, attributes) {
    let program = this.programs.get(key);
    if (program) return program;
    const {gl} = this;
    program = {name: gl.createProgram(), places: new Map()};
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost())
        throw new Error(`this browser's WebGL does not take a shader: ${gl.getShaderInfoLog(shader)}`);
      gl.attachShader(program.name, shader);
    }
    attributes.forEach(([name], i) => gl.bindAttribLocation(program.name, i, name));
    gl.linkProgram(program.name);
    this.programs.set(key, program);
    return program;
  }

  /**
   * @param {any} program @param {string} name @param {number|ArrayLike<number>} value nine numbers: a matrix by
   *     columns
   */
  set(program, name, value) {
    const {gl} = this;
    if (!program.places.has(name)) program.places.set(name, gl.getUniformLocation(program.name, name));
    const place = program.places.get(name);
    if (typeof value === 'number') return gl.uniform1f(place, value);
    if (value.length === 9) return gl.uniformMatrix3fv(place, false, value);
    gl[`uniform${value.length}fv`](place, value);
  }

  /** @param {number[]} floats @param {number[]} indices @param {number} each floats of a vertex @returns {Batch} */
  uploaded(floats, indices, each) {
    const {gl} = this;
    const fill = (/** @type {number} */ target, /** @type {ArrayBufferView} */ data) => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(target, buffer);
      gl.bufferData(target, data, gl.STATIC_DRAW);
      return buffer;
    };
    return {
      vertices: fill(gl.ARRAY_BUFFER, new Float32Array(floats)),
      indices: indices.length ? fill(gl.ELEMENT_ARRAY_BUFFER, new Uint16Array(indices)) : null,
      count: indices.length || floats.length / each,
    };
  }

  /** @param {import('./house.js').Mesh} mesh */
  uploadedMesh(mesh) {
    const floats = mesh.vertices.flatMap(({at, colour}) => [...at, ...colour.map((part) => part / 255)]);
    return this.uploaded(floats, mesh.triangles, 7);
  }

  /**
   * Two vertices for each point of a line, left and right of it. Of the last one the other end is the one before.
   * @param {import('./house.js').Line[]} lines
   */
  uploadedLines(lines) {
    const floats = [], indices = [];
    for (const {points, width} of lines) {
      const reach = 0.5 * width + 0.5;
      const first = floats.length / 12;
      if (points.length < 2) continue;
      points.forEach(({at, colour}, i) => {
        const last = i + 1 === points.length;
        for (const side of [-1, 1])
          floats.push(
              ...at, ...points[last ? i - 1 : i + 1].at, ...colour.map((part) => part / 255), side * reach,
              last ? -1 : 1);
        if (!last) indices.push(...[0, 1, 2, 2, 1, 3].map((corner) => first + 2 * i + corner));
      });
    }
    return this.uploaded(floats, indices, 12);
  }

  /** @param {Batch} batch @param {any[][]} attributes @param {number} mode */
  drawBatch(batch, attributes, mode) {
    const {gl} = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, batch.vertices);
    const stride = 4 * attributes.reduce((sum, [, floats]) => sum + floats, 0);
    let offset = 0;
    attributes.forEach(([, floats], i) => {
      gl.enableVertexAttribArray(i);
      gl.vertexAttribPointer(i, floats, gl.FLOAT, false, stride, offset);
      offset += 4 * floats;
    });
    if (batch.indices) {
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, batch.indices);
      gl.drawElements(mode, batch.count, gl.UNSIGNED_SHORT, 0);
    } else {
      gl.drawArrays(mode, 0, batch.count);
    }
    attributes.forEach((_, i) => gl.disableVertexAttribArray(i));
  }

  /**
   * Where the house stands in the result's map; null: nowhere yet. @param {TrackResult} result
   * @param {Camera} camera
   */
  siteOf(result, camera) {
    if (result.maps === 0 || result.world_changes !== this.worldChanges) this.sites.clear();
    this.worldChanges = result.world_changes;
    if (result.map === 0) return null;
    if (!this.sites.has(result.map) && result.pose_valid) {
      const site = placeHouse(result.T_cw, kBaseline);
      // A ground that was chosen has its origin where the house is wanted.
      const [x, y, z] = result.T_cw.t;
      const [u, v] = [camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy];
      if (result.world_changes > 0 && z > 0 && u >= 0 && v >= 0 && u < camera.width && v < camera.height)
        site.anchor = [0, 0, 0];
      this.sites.set(result.map, site);
    }
    return this.sites.get(result.map) || null;
  }

  /**
   * @param {TexImageSource|VideoFrame} picture @param {Camera} camera a pinhole @param {TrackResult} result
   * @param {Float32Array} points px, predicted px, kind, level of each @param {Object<string, number>} constants
   *     PPTAM_...
   * @returns {boolean} false: WebGL is gone for now
   */
  draw(picture, camera, result, points, constants) {
    const {gl, canvas} = this;
    if (this.lost || gl.isContextLost()) return false;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.CULL_FACE);
    gl.depthMask(true);
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.disable(gl.BLEND);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, /** @type {any} */ (picture));
    const image = this.program('picture', shaders.picture_vert, '#define KIND 0\n' + shaders.picture_frag, kCorner);
    gl.useProgram(image.name);
    this.set(image, 'canvas', [2, 0, 0, 0, -2, 0, -1, 1, 1]);
    this.set(image, 'shown', [1, 0, 0, 0, 1, 0, 0, 0, 1]);
    this.drawBatch(this.corners, kCorner, gl.TRIANGLE_STRIP);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ZERO, gl.ONE);
    const site = this.siteOf(result, camera);
    const world = result.pose_valid && site ? this.see(camera, result, site, constants) : null;
    if (world) this.drawLines(world, this.model.ground, world.near, 0);
    this.drawShapes(pointShapes(points, canvas.width / camera.width, constants));
    if (world) this.drawHouse(world);
    return true;
  }

  /**
   * Programs for the camera's view, and the house's batches. @param {Camera} camera @param {TrackResult} result
   * @param {import('./house.js').Site} site @param {Object<string, number>} constants
   */
  see(camera, result, site, constants) {
    if (this.modelSite !== site) {
      const model = siteModel(site);
      this.modelSite = site;
      this.model = {
        ground: this.uploadedLines(model.ground),
        shadow: this.uploadedMesh(model.shadow),
        faces: this.uploadedMesh(model.faces),
        edges: this.uploadedLines(model.edges)
      };
    }
    const {gl, canvas} = this;
    const rolling = camera.line_time_s !== 0;
    const lens = `#define DISTORTION 0\n#define ROLLING ${Number(rolling)}\n${shaders.lens_glsl}`;
    const triangles = this.program('triangles' + rolling, lens + shaders.world_vert, shaders.plain_frag, kTriangle);
    const lines = this.program('lines' + rolling, lens + shaders.line_vert, shaders.line_frag, kLine);
    const {R, t} = result.T_cw;
    const [sx, sy] = [2 / camera.width, 2 / camera.height];
    const columns = camera.shutter_axis === constants.PPTAM_SHUTTER_COLUMNS;
    for (const program of [triangles, lines]) {
      gl.useProgram(program.name);
      this.set(program, 'R_cw', [R[0], R[3], R[6], R[1], R[4], R[7], R[2], R[5], R[8]]);
      this.set(program, 't_cw', t);
      this.set(program, 'linear_velocity', result.velocity.slice(0, 3));
      this.set(program, 'angular_velocity', result.velocity.slice(3));
      this.set(program, 'focal_centre', [camera.fx, camera.fy, camera.cx, camera.cy]);
      this.set(program, 'line_time', columns ? [camera.line_time_s, 0] : [0, camera.line_time_s]);
      this.set(program, 'middle', [0.5 * (camera.width - 1), 0.5 * (camera.height - 1)]);
      this.set(program, 'half_readout', 0.5 * Math.abs(camera.line_time_s) * (columns ? camera.width : camera.height));
      this.set(program, 'canvas_px', [sx, 0, 0, 0, -sy, 0, 0.5 * sx - 1, 1 - 0.5 * sy, 1]);
    }
    gl.useProgram(lines.name);
    this.set(lines, 'half_canvas', [0.5 * canvas.width, 0.5 * canvas.height]);
    const near = 0.05 * site.size;
    const depths = houseCorners().map((p) => {
      const [x, y, z] = toWorld(site, p);
      return R[6] * x + R[7] * y + R[8] * z + t[2];
    });
    return {triangles, lines, near, nearFaces: Math.max(near, 0.5 * Math.min(...depths))};
  }

  /** @param {any} world @param {Batch} batch @param {number} near @param {number} closer */
  drawLines(world, batch, near, closer) {
    this.gl.useProgram(world.lines.name);
    this.set(world.lines, 'near_z', near);
    this.set(world.lines, 'closer', closer);
    this.drawBatch(batch, kLine, this.gl.TRIANGLES);
  }

  /** @param {any} world @param {Batch} batch @param {number} near */
  drawTriangles(world, batch, near) {
    this.gl.useProgram(world.triangles.name);
    this.set(world.triangles, 'near_z', near);
    this.drawBatch(batch, kTriangle, this.gl.TRIANGLES);
  }

  /** @param {any} world */
  drawHouse(world) {
    const {gl, model} = this;
    this.drawTriangles(world, model.shadow, world.near);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.enable(gl.CULL_FACE);
    gl.disable(gl.BLEND);
    this.drawTriangles(world, model.faces, world.nearFaces);
    gl.enable(gl.BLEND);
    gl.disable(gl.CULL_FACE);
    gl.depthMask(false);
    this.drawLines(world, model.edges, world.nearFaces, kEdgeCloser);
    gl.depthMask(true);
    gl.disable(gl.DEPTH_TEST);
  }

  /** @param {Shape[]} shapes */
  drawShapes(shapes) {
    if (shapes.length === 0) return;
    const {gl, canvas} = this;
    const floats = [];
    for (const {centre, half = [0, 0], direction = [1, 0], radius, stroke = 0, colour} of shapes) {
      const beyond = radius + 0.5 * stroke + 1;  // and a pixel for the smooth edge
      const reach = [half[0] + beyond, half[1] + beyond];
      for (const [x, y] of [[-1, -1], [1, -1], [-1, 1], [-1, 1], [1, -1], [1, 1]]) {
        const local = [x * reach[0], y * reach[1]];
        floats.push(
            centre[0] + local[0] * direction[0] - local[1] * direction[1],
            centre[1] + local[0] * direction[1] + local[1] * direction[0], ...local, ...half, radius, stroke,
            ...colour.map((part) => part / 255));
      }
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, this.shapes.vertices);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(floats), gl.STREAM_DRAW);
    this.shapes.count = floats.length / 12;
    const program = this.program('shapes', shaders.shape_vert, shaders.shape_frag, kShape);
    gl.useProgram(program.name);
    this.set(program, 'canvas', [2 / canvas.width, 0, 0, 0, -2 / canvas.height, 0, -1, 1, 1]);
    this.drawBatch(this.shapes, kShape, gl.TRIANGLES);
  }
}

/**
 * What was searched in a frame, as platform/run/composer.cpp draws it. @param {Float32Array} points
 * @param {number} scale pixels of the canvas for one of the image @param {Object<string, number>} constants
 * @returns {Shape[]}
 */
function pointShapes(points, scale, constants) {
  /** @type {Shape[]} */
  const shapes = [];
  const u = 0.5 * scale;  // sizes are those of an image shown twice as large
  for (let i = 0; i < points.length; i += 6) {
    const at = [scale * (points[i] + 0.5), scale * (points[i + 1] + 0.5)];
    const radius = u * (points[i + 5] >= 2 ? 4.5 : 3);
    switch (points[i + 4]) {
      case constants.PPTAM_OBSERVED_MISSED:
      case constants.PPTAM_OBSERVED_HIDDEN:
        shapes.push({centre: at, radius: 1.8 * u, colour: kGrey});
        break;
      case constants.PPTAM_OBSERVED_INITIAL: {
        const from = [scale * (points[i + 2] + 0.5), scale * (points[i + 3] + 0.5)];
        const [dx, dy] = [at[0] - from[0], at[1] - from[1]];
        const length = Math.hypot(dx, dy);
        shapes.push({
          centre: [0.5 * (at[0] + from[0]), 0.5 * (at[1] + from[1])],
          half: [0.5 * length, 0],
          radius: 0.8 * u,
          direction: length > 0 ? [dx / length, dy / length] : [1, 0],
          colour: kBlue
        });
        shapes.push({centre: at, radius: 2.4 * u, colour: kBlue});
        break;
      }
      case constants.PPTAM_OBSERVED_OUTLIER:
        for (const way of [-1, 1])
          shapes.push({
            centre: at,
            half: [3.5 * Math.SQRT2 * u, 0],
            direction: [Math.SQRT1_2, way * Math.SQRT1_2],
            radius: u,
            colour: kRed
          });
        break;
      case constants.PPTAM_OBSERVED_PARTIAL:
        shapes.push({centre: at, radius: radius + u, stroke: 1.8 * u, colour: kYellow});
        break;
      default:
        shapes.push({centre: at, radius, colour: kGreen});
        shapes.push({centre: at, radius, stroke: u, colour: kDarkGreen});
    }
  }
  return shapes;
}
