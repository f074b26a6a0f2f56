// What is put into the world: a ground grid and a small house on the map's ground, as platform/display/house.cpp has
// them. Vectors are arrays of three numbers.

/** @typedef {[number, number, number]} Vector */
/**
 * Where the house stands: on the world's z = 0.
 * @typedef {object} Site
 * @property {Vector} anchor the middle of its floor
 * @property {number} angle of the house's x axis about z, radians
 * @property {number} size length of its longer side, world units
 * @property {number} spacing of the grid, world units
 */
/** @typedef {{at: Vector, colour: number[]}} Vertex colour: red, green, blue, opacity, 0 to 255 */
/** @typedef {{points: Vertex[], width: number}} Line */
/** @typedef {{vertices: Vertex[], triangles: number[]}} Mesh */
/** @typedef {{ground: Line[], shadow: Mesh, faces: Mesh, edges: Line[]}} Model */

const kWall = [0.96, 0.88, 0.72], kRoof = [0.82, 0.29, 0.22], kDoor = [0.45, 0.27, 0.16], kWindow = [0.48, 0.70, 0.86];
const kGridColour = [115, 217, 255];

// Measures in units of the longer side, in the house's frame: x along the ridge, z up.
const kHalfLength = 0.50, kHalfWidth = 0.36, kEaves = 0.50, kRidge = 0.90;
const kRoofHalfLength = 0.57, kRoofHalfWidth = 0.44, kRoofLow = 0.43, kRoofRidge = 0.94;
const kDecal = 0.004;  // doors and windows stand off the wall, so that the depth tells them apart
const kPieces = 2;     // lens and shutter move only corners: each side is cut

const add = (/** @type {Vector} */ a, /** @type {Vector} */ b, k = 1) =>
    /** @type {Vector} */ ([a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]]);
const dot = (/** @type {ArrayLike<number>} */ a, /** @type {ArrayLike<number>} */ b) =>
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (/** @type {Vector} */ a, /** @type {Vector} */ b) =>
    /** @type {Vector} */ ([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]);
const normalised = (/** @type {Vector} */ a) => add([0, 0, 0], a, 1 / Math.hypot(...a));

const kLight = normalised([0.45, -0.35, 0.82]);  // towards it, in the house's frame

/** Corners counter-clockwise from outside; the last repeats in triangles. @returns {[Vector[], number[]][]} */
function houseFaces() {
  const a = kHalfLength, b = kHalfWidth, h = kEaves, e = kDecal;
  const c = kRoofHalfLength, d = kRoofHalfWidth, low = kRoofLow, top = kRoofRidge;
  /** @type {Vector} */ const left = [-a, 0, kRidge];
  /** @type {Vector} */ const right = [a, 0, kRidge];
  return [
    [[[-a, -b, 0], [a, -b, 0], [a, -b, h], [-a, -b, h]], kWall],
    [[[a, b, 0], [-a, b, 0], [-a, b, h], [a, b, h]], kWall],
    [[[a, -b, 0], [a, b, 0], [a, b, h], [a, -b, h]], kWall],
    [[[-a, b, 0], [-a, -b, 0], [-a, -b, h], [-a, b, h]], kWall],
    [[[a, -b, h], [a, b, h], right, right], kWall],
    [[[-a, b, h], [-a, -b, h], left, left], kWall],
    [[[-0.10, -b - e, 0], [0.10, -b - e, 0], [0.10, -b - e, 0.36], [-0.10, -b - e, 0.36]], kDoor],
    [[[-0.40, -b - e, 0.18], [-0.20, -b - e, 0.18], [-0.20, -b - e, 0.38], [-0.40, -b - e, 0.38]], kWindow],
    [[[0.20, -b - e, 0.18], [0.40, -b - e, 0.18], [0.40, -b - e, 0.38], [0.20, -b - e, 0.38]], kWindow],
    [[[a + e, -0.12, 0.18], [a + e, 0.12, 0.18], [a + e, 0.12, 0.40], [a + e, -0.12, 0.40]], kWindow],
    [[[-a - e, 0.12, 0.18], [-a - e, -0.12, 0.18], [-a - e, -0.12, 0.40], [-a - e, 0.12, 0.40]], kWindow],
    [[[0.20, b + e, 0.18], [-0.20, b + e, 0.18], [-0.20, b + e, 0.40], [0.20, b + e, 0.40]], kWindow],
    [[[-c, -d, low], [c, -d, low], [c, 0, top], [-c, 0, top]], kRoof],
    [[[c, d, low], [-c, d, low], [-c, 0, top], [c, 0, top]], kRoof],
  ];
}

/** Corners of walls and roof, house's frame. @returns {Vector[]} */
export function houseCorners() {
  /** @type {Vector[]} */
  const corners = [];
  for (const x of [-1, 1]) {
    for (const y of [-1, 1]) {
      corners.push(
          [x * kHalfLength, y * kHalfWidth, 0], [x * kHalfLength, y * kHalfWidth, kEaves],
          [x * kRoofHalfLength, y * kRoofHalfWidth, kRoofLow]);
    }
    corners.push([x * kRoofHalfLength, 0, kRoofRidge]);
  }
  return corners;
}

/** From the house's frame to the world. @param {Site} site @param {ArrayLike<number>} p @returns {Vector} */
export function toWorld(site, p) {
  const c = Math.cos(site.angle), s = Math.sin(site.angle);
  return add(site.anchor, [c * p[0] - s * p[1], s * p[0] + c * p[1], p[2]], site.size);
}

/**
 * Where the view's axis meets the ground, the door towards the camera. @param {import('./pocket_ptam.js').Pose} T_cw
 * @param {number} baseline Config.initial_baseline, for the grid's size @returns {Site}
 */
export function placeHouse(T_cw, baseline) {
  const {R, t} = T_cw;
  const row = (/** @type {number} */ i) => /** @type {Vector} */ ([R[3 * i], R[3 * i + 1], R[3 * i + 2]]);
  const centre = /** @type {Vector} */ ([0, 1, 2].map((i) => -(R[i] * t[0] + R[3 + i] * t[1] + R[6 + i] * t[2])));
  const axis = row(2);
  let along = 2 * Math.max(Math.abs(centre[2]), 0.5 * baseline);  // a view along the ground never meets it, or far away
  if (axis[2] < -0.2) along = centre[2] / -axis[2];
  const anchor = add(centre, axis, along);
  anchor[2] = 0;
  const distance = Math.hypot(...add(anchor, centre, -1));
  let towards = row(1);  // image down
  if (Math.hypot(towards[0], towards[1]) < 0.1) towards = [0, -1, 0];
  let spacing = baseline;
  while (spacing > 0.2 * distance) spacing *= 0.5;
  while (spacing < 0.1 * distance) spacing *= 2;
  // Turned by 35 degrees so that two walls show.
  return {anchor, size: 0.2 * distance, spacing, angle: Math.atan2(towards[1], towards[0]) + 0.5 * Math.PI + 0.6};
}

const shaded =
    (/** @type {number[]} */ colour,
     /** @type {number} */ light) => [...colour.map((part) => Math.round(255 * Math.min(part * light, 1))), 255];

/** @param {Vector[]} c @param {number[]} colour @param {Site} site @param {Model} model */
function addFace(c, colour, site, model) {
  const normal = normalised(cross(add(c[1], c[0], -1), add(c[2], c[0], -1)));
  const light = 0.55 + 0.45 * Math.max(0, dot(normal, kLight));
  const {vertices, triangles} = model.faces;
  const row = kPieces + 1, first = vertices.length;
  for (let i = 0; i <= kPieces; ++i) {
    for (let j = 0; j <= kPieces; ++j) {
      const u = i / kPieces, v = j / kPieces;
      const low = add(add([0, 0, 0], c[0], 1 - u), c[1], u), high = add(add([0, 0, 0], c[3], 1 - u), c[2], u);
      vertices.push({at: toWorld(site, add(add([0, 0, 0], low, 1 - v), high, v)), colour: shaded(colour, light)});
      if (i === kPieces || j === kPieces) continue;
      for (const corner of [0, row, row + 1, 0, row + 1, 1]) triangles.push(first + i * row + j + corner);
    }
  }
  const dark = shaded(colour, 0.6 * light);
  c.forEach((from, side) => {
    const to = c[(side + 1) % 4];
    if (from === to) return;  // a triangle
    model.edges.push({
      width: 1.2,
      points: Array.from(
          {length: kPieces + 1},
          (_, i) => ({at: toWorld(site, add(from, add(to, from, -1), i / kPieces)), colour: dark}))
    });
  });
}

/**
 * Corners of the smallest convex polygon around points of the plane, counter-clockwise; Andrew's monotone chain.
 * @param {number[][]} points
 */
function convexHull(points) {
  points = [...points].sort((p, q) => p[0] - q[0] || p[1] - q[1]);
  /** @type {number[][]} */
  const hull = [];
  for (let pass = 0; pass < 2; ++pass) {
    const base = hull.length;
    for (const p of points) {
      while (hull.length >= base + 2) {
        const [o, q] = hull.slice(-2);
        if ((q[0] - o[0]) * (p[1] - q[1]) - (q[1] - o[1]) * (p[0] - q[0]) > 0) break;
        hull.pop();
      }
      hull.push(p);
    }
    hull.pop();
    points.reverse();
  }
  return hull;
}

/**
 * A polygon of the ground, house's frame, that fades out over a seam. @param {number[][]} outline
 * @param {number} seam @param {number} alpha @param {Site} site @param {Mesh} mesh
 */
function addShadow(outline, seam, alpha, site, mesh) {
  const middle = [0, 1].map((axis) => outline.reduce((sum, p) => sum + p[axis], 0) / outline.length);
  const put = (/** @type {number[]} */ p, /** @type {number} */ a) =>
      mesh.vertices.push({at: toWorld(site, [p[0], p[1], 0]), colour: [0, 0, 0, a]});
  const first = mesh.vertices.length;
  put(middle, alpha);
  const around = outline.length * kPieces;
  for (let i = 0; i < around; ++i) {
    const from = outline[Math.floor(i / kPieces)], to = outline[(Math.floor(i / kPieces) + 1) % outline.length];
    const share = i % kPieces / kPieces;
    const p = [0, 1].map((axis) => from[axis] + share * (to[axis] - from[axis]));
    const away = Math.hypot(p[0] - middle[0], p[1] - middle[1]);
    put(p, alpha);
    put(p.map((x, axis) => x + seam * (x - middle[axis]) / away), 0);
    const here = first + 1 + 2 * i, next = first + 1 + 2 * ((i + 1) % around);
    mesh.triangles.push(first, here, next, here, here + 1, next, next, here + 1, next + 1);
  }
}

/** @param {Site} site @param {Line[]} lines */
function addGrid(site, lines) {
  const kCells = 8;  // to each side
  const step = site.spacing;
  const [x0, y0] = [0, 1].map((axis) => Math.round(site.anchor[axis] / step) * step);
  for (let u = -kCells; u <= kCells; ++u) {
    for (const alongX of [false, true]) {
      /** @type {Vertex[]} */
      const points = [];
      for (let v = -kCells; v <= kCells; ++v) {
        const far = Math.hypot(u, v) / kCells;
        if (far > 1) continue;
        const [i, j] = alongX ? [v, u] : [u, v];
        points.push(
            {at: [x0 + i * step, y0 + j * step, 0], colour: [...kGridColour, Math.round(255 * 0.55 * (1 - far))]});
      }
      lines.push({points, width: 1.2});
    }
  }
}

/** Grid, the lit house, its shadow. @param {Site} site @returns {Model} */
export function siteModel(site) {
  /** @type {Model} */
  const model = {ground: [], shadow: {vertices: [], triangles: []}, faces: {vertices: [], triangles: []}, edges: []};
  addGrid(site, model.ground);
  const cast = houseCorners().map((p) => [p[0] - kLight[0] * p[2] / kLight[2], p[1] - kLight[1] * p[2] / kLight[2]]);
  addShadow(convexHull(cast), 0.04, 97, site, model.shadow);
  const a = kHalfLength, b = kHalfWidth;
  addShadow([[-a, -b], [a, -b], [a, b], [-a, b]], 0.10, 110, site, model.shadow);  // where it touches the ground
  for (const [corners, colour] of houseFaces()) addFace(corners, colour, site, model);
  return model;
}
