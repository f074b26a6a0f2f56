// The JavaScript interface: that the library has no imports and shows the header's functions, that what it says of its
// structures is whole and agrees with the types in pocket_ptam.js, that calls do what C's do, and that bad ones are
// refused.
//
//   node interface.mjs HEADER LIBRARY.wasm RECORDING
import assert from 'node:assert/strict';
import {existsSync, readFileSync} from 'node:fs';
import process from 'node:process';

import * as api from '../../platform/web/pocket_ptam.js';

const [headerFile, libraryFile, recordingFile] = process.argv.slice(2);
const header = readFileSync(headerFile, 'utf8');
const code = header.replace(/\/\/.*/g, '');
const wasm = readFileSync(libraryFile);
const withModels = libraryFile.includes('_all');
const library = await api.PocketPtam.load(wasm);
const {structures} = library.instance.layout;

// ---- What is linked.
assert.deepEqual(WebAssembly.Module.imports(library.module), []);
const functions = [...code.matchAll(/^PPTAM_API [^(]*?\b(pptam_\w+)\(/gm)].map((match) => match[1]);
assert.ok(functions.length > 50);
const beside = ['memory', '__indirect_function_table', '__heap_base', 'pptam_layout_text', 'pptam_layout_numbers'];
assert.deepEqual(
    WebAssembly.Module.exports(library.module).map(({name}) => name).sort(),
    [...functions.filter((name) => withModels || !name.includes('model')), ...beside].sort());

// ---- Structures: the header's, each whole, so that only what alignment asks for lies between the fields.
const kSizes = {
  int32_t: 4,
  uint32_t: 4,
  size_t: 4,
  pointer: 4,
  float: 4,
  int64_t: 8,
  bool: 1
};
const alignment = (/** @type {string} */ type) =>
    kSizes[type] || Math.max(...structures[type].fields.map((field) => alignment(field.type)));
/** @param {Object<string, {bytes: number, fields: any[]}>} layout */
function findGaps(layout) {
  const gaps = [];
  for (const [name, {bytes, fields}] of Object.entries(layout)) {
    let end = 0;
    for (const {type, name: field, offset, count} of fields) {
      const aligned = Math.ceil(end / alignment(type)) * alignment(type);
      if (offset !== aligned) gaps.push(`${name}.${field}`);
      end = offset + count * (kSizes[type] || structures[type].bytes);
    }
    if (Math.ceil(end / alignment(name)) * alignment(name) !== bytes) gaps.push(`the end of ${name}`);
  }
  return gaps;
}
assert.deepEqual(
    Object.keys(structures), [...code.matchAll(/^typedef struct (pptam_\w+) {/gm)].map((match) => match[1]));
assert.deepEqual(findGaps(structures), []);
const fewer = structuredClone(structures);
fewer.pptam_track_result.fields.splice(3, 1);
assert.deepEqual(findGaps(fewer), ['pptam_track_result.progress'], 'control: a field that is missing is found out');
const enumerators = new Set([...code.matchAll(/\bPPTAM_(?!API\b)[A-Z0-9_]+/g)].map((match) => match[0]));
assert.deepEqual(new Set(Object.keys(library.constants)), enumerators);
assert.deepEqual(
    [
      library.constants.PPTAM_OK, library.constants.PPTAM_LIMIT_MEASUREMENTS, library.constants.PPTAM_MODEL_FEATURES,
      library.constants.PPTAM_PIXEL_I420
    ],
    [0, 16, 4, 6]);

// ---- The types that are written for editors name the same fields.
const source = readFileSync(new URL('../../platform/web/pocket_ptam.js', import.meta.url), 'utf8');
const kTypes = {
  Camera: 'camera',
  Pose: 'pose',
  Config: 'config',
  PhoneProfile: 'phone_profile',
  Frame: 'frame',
  TrackResult: 'track_result',
  ObservedPoint: 'observed_point',
  Keyframe: 'keyframe',
  MapPoint: 'map_point',
  Measurement: 'measurement',
  Plane: 'plane',
  MapInfo: 'map_info',
  ModelResult: 'model_result',
  ModelSite: 'model_site'
};
for (const [type, structure] of Object.entries(kTypes)) {
  const text = source.match(new RegExp(`@typedef {object} ${type}\\n([^]*?)\\*/`))[1];
  const named = [...text.matchAll(/@property {[^}]*} \[?(\w+)\]?/g)].map((match) => match[1]);
  assert.deepEqual(named.sort(), structures['pptam_' + structure].fields.map(({name}) => name).sort(), type);
}

// ---- Bad calls are refused, and say why.
const c = library.constants;
const camera = {
  width: 240,
  height: 320,
  fx: 358.6,
  fy: 358.6,
  cx: 119.5,
  cy: 159.5,
  shutter_axis: c.PPTAM_SHUTTER_COLUMNS,
  line_time_s: -0.00025
};
const refused = (/** @type {() => any} */ call, /** @type {number} */ code, /** @type {RegExp} */ message) =>
    assert.throws(call, (/** @type {any} */ error) => error.code === code && message.test(error.message));
library.validateCamera(camera);
refused(() => library.validateCamera({...camera, fx: NaN}), c.PPTAM_INVALID_ARGUMENT, /./);
assert.throws(() => library.validateCamera(/** @type {any} */ ({...camera, focal: 3})), /has no field focal/);
const config = library.configPhone(camera);
assert.equal(config.max_keyframes, 35);
assert.equal(config.camera.line_time_s, Math.fround(-0.00025));
assert.equal(library.requiredBytes({...config, max_keyframes: -1}), 0);
await assert.rejects(library.createSystem({...config, max_keyframes: -1}), (error) => error instanceof api.PtamError);
await assert.rejects(
    library.createSystem({...config, max_map_points: 2 ** 31 - 1}), (error) => error instanceof api.PtamError);
assert.equal(library.hintText(c.PPTAM_HINT_MOVE_SIDEWAYS), 'move sideways');
const inverse =
    library.inverseAsQuaternion({R: Float32Array.of(1, 0, 0, 0, 1, 0, 0, 0, 1), t: Float32Array.of(1, 2, 3)});
assert.deepEqual([...inverse.position, ...inverse.quaternion_xyzw], [-1, -2, -3, 0, 0, 0, 1]);

const system = await library.createSystem(config);
assert.deepEqual(system.getConfig(), config);
const image = new Uint8Array(240 * 320);
assert.equal(system.track({data: image, timestamp_ns: 5n}).state, c.PPTAM_TRACKING_WAITING);
refused(() => system.track({data: image, timestamp_ns: 5n}), c.PPTAM_TIME_WENT_BACKWARDS, /./);
refused(() => system.track({data: image.subarray(1), timestamp_ns: 6n}), c.PPTAM_INVALID_ARGUMENT, /shorter/);
refused(() => system.track({data: image, width: 120, timestamp_ns: 6n}), c.PPTAM_INVALID_ARGUMENT, /./);
assert.equal(system.track({data: image, timestamp_ns: 6n}).timestamp_ns, 6n);
refused(() => system.saveMap(), c.PPTAM_NOT_READY, /./);
refused(() => system.loadMap(new Uint8Array(100)), c.PPTAM_BAD_FILE, /./);
refused(() => library.readMapInfo(new Uint8Array(3)), c.PPTAM_BAD_FILE, /./);
refused(() => system.keyframeImage(7), c.PPTAM_INVALID_ARGUMENT, /./);

// ---- A run with a map: lists, tracer, clock, saving and loading.
if (existsSync(recordingFile)) {
  const recording = readFileSync(recordingFile);
  const headBytes = structures.pptam_camera.bytes + 16 + structures.pptam_pose.bytes;
  const pixels = 240 * 320;
  const frame = (/** @type {number} */ i, shift = 0n) => {
    const at = headBytes + i * (8 + pixels);
    return {data: recording.subarray(at + 8, at + 8 + pixels), timestamp_ns: recording.readBigInt64LE(at) + shift};
  };
  const frames = Math.floor((recording.length - headBytes) / (8 + pixels));
  system.reset();
  system.tap();
  const spans = [];
  let open = 0, ticks = 0n;
  system.setTracer({
    begin: (span) => {
      spans.push(span), ++open;
    },
    end: () => {
      --open;
    },
    count: (counter, value) => assert.equal(typeof value, 'bigint', String(counter))
  });
  system.setClock(() => ++ticks);
  const later = 10n ** 12n;
  let result = system.track(frame(0, later));
  for (let i = 1; i < frames; ++i) {
    for (let slice = 0; slice < 40 && system.hasWork(); ++slice) system.workSlice();
    result = system.track(frame(i, later));
  }
  assert.equal(open, 0);
  assert.ok(spans.includes(c.PPTAM_SPAN_FRAME) && spans.includes(c.PPTAM_SPAN_ADJUST));
  assert.ok(result.stage_ns[c.PPTAM_STAGE_SEARCH] > 0n);
  system.setTracer(null);
  system.setClock(null);
  assert.equal(result.state, c.PPTAM_TRACKING_TRACKING);
  assert.equal(system.observedPoints().length, result.observed_points);
  assert.equal(system.keyframes().length, result.keyframes);
  const points = system.mapPoints();
  assert.equal(points.length, result.map_points);
  assert.ok(system.measurements().length >= 2 * points.length);
  assert.ok(system.mapFit().measurements > 100 && system.mapParts(4) === 1 && system.planes().length >= 1);
  const seen = points.map(({p_w}) => system.project(result.T_cw, result.velocity, p_w)).filter((px) => px);
  assert.ok(seen.length > 20);
  const ray = system.unproject([119.5, 159.5]);
  assert.ok(Math.abs(ray[0]) < 1e-3 && Math.abs(ray[1]) < 1e-3);
  const newest = system.keyframeImage(system.keyframes()[0].id);
  assert.equal(newest.data.length, newest.stride_bytes * 319 + 240);
  assert.ok(system.workInstructions() > 0n && system.workNs() > 0n && system.workUnits(0) >= 0n);
  system.setLocked(true);
  assert.equal(system.locked(), true);
  const file = system.saveMap();
  assert.equal(file.length, system.mapBytes());
  assert.equal(library.readMapInfo(file).keyframes, result.keyframes);
  const another = await library.createSystem(config);
  another.loadMap(file);
  assert.equal(another.mapHash(), system.mapHash());
  file[file.length >> 1] ^= 1;
  refused(() => another.loadMap(file), c.PPTAM_BAD_FILE, /./);
  assert.equal(another.mapHash(), system.mapHash());
  system.setGround([119.5, 200]);
  system.setLength(points[0].id, points[1].id, 3);
} else {
  console.log(`no ${recordingFile}: first tests/run.sh -R bare_metal; the rest is left out`);
}

// ---- A known object: a cube before the camera.
if (withModels) {
  const corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]];
  const face = (/** @type {number} */ first) => ({first, count: 4, open: false, min_area_px2: 0, min_length_px: 0});
  const cube = {
    points: corners.flat(),
    corners: [0, 3, 2, 1, 4, 5, 6, 7, 0, 1, 5, 4, 2, 3, 7, 6, 1, 2, 6, 5, 0, 4, 7, 3],
    faces: [0, 4, 8, 12, 16, 20].map(face)
  };
  const tracker = await library.createModelTracker(camera, cube);
  tracker.start({R: Float32Array.of(1, 0, 0, 0, 1, 0, 0, 0, 1), t: Float32Array.of(-0.5, -0.5, 4)});
  assert.equal(tracker.track({data: image, timestamp_ns: 1n}).pose_valid, false);
  assert.equal(tracker.sites().length >= 0, true);
  await assert.rejects(
      library.createModelTracker(camera, {points: [0, 0, 0]}), (error) => error instanceof api.PtamError);
}
console.log(`passed: ${functions.length} functions, ${Object.keys(structures).length} structures`);
