// The tracker in a thread of its own: frames come, results go; between two frames mapping gets the time. One frame is
// under way at a time, the page drops what comes meanwhile. Every message has a kind:
//
//   to the worker                                  from it
//   library  simd?, wasm? (bytes; else fetched)     ready    version, simd, constants
//   setup    name, fov_rad, readout_s, axis, sign   camera   camera, bytes: a system has been built
//   frame    frame, time_ns                         result   result, points, hint, ms, frame (given back)
//   tap, reset, lock, unlock                        refused  why
//   save                                            map      file
//   load     file                                   said     text
//   record                                          recording  blob, frames
//   finish                                          failed   text: nothing goes on
import {GreyImages} from './grey.js';
import {PocketPtam} from './pocket_ptam.js';
import {Recording} from './recording.js';

/** @type {PocketPtam} */
let library;
/** @type {import('./pocket_ptam.js').System|null} */
let system = null;
/** @type {import('./pocket_ptam.js').Config} */
let config;
/** @type {any} */
let setup = null;
/** @type {Recording|null} */
let recording = null;
let recordNext = false;  // from the next system on: a recording begins with everything forgotten
let idleRun = 0;
const images = new GreyImages();

/** @param {object} message @param {Transferable[]} [transferred] */
const post = (message, transferred = []) => /** @type {any} */ (self).postMessage(message, transferred);
/** @param {string} text */
const say = (text) => post({kind: 'said', text});

/** @param {{wasm?: ArrayBuffer, simd?: boolean}} message */
async function loadLibrary({wasm, simd = PocketPtam.simd()}) {
  const name = simd ? 'pocket_ptam_simd.wasm' : 'pocket_ptam.wasm';
  if (!wasm) {
    const response = await fetch(new URL(name, import.meta.url));
    if (!response.ok) throw new Error(`${name}: the server answers ${response.status}; is it beside the page?`);
    wasm = await response.arrayBuffer();
  }
  try {
    library = await PocketPtam.load(wasm);
  } catch (error) {
    if (error instanceof WebAssembly.CompileError && /Content Security Policy|unsafe-eval/.test(error.message))
      throw new Error(
          'the server\'s Content-Security-Policy forbids WebAssembly to this worker: add ' +
          'script-src \'self\' \'wasm-unsafe-eval\'');
    throw error;
  }
  post({kind: 'ready', version: library.version, simd, constants: library.constants});
}

/** A pinhole camera of square pixels. @param {number} width @param {number} height */
function cameraOf(width, height) {
  const f = 0.5 * Math.max(width, height) / Math.tan(0.5 * setup.fov_rad);
  const columns = setup.axis === 'columns';
  return {
    width,
    height,
    fx: f,
    fy: f,
    cx: 0.5 * (width - 1),
    cy: 0.5 * (height - 1),
    shutter_axis: columns ? library.constants.PPTAM_SHUTTER_COLUMNS : library.constants.PPTAM_SHUTTER_ROWS,
    line_time_s: setup.sign * setup.readout_s / (columns ? width : height),
  };
}

/** @param {number} width @param {number} height */
async function build(width, height) {
  config = library.configPhone(cameraOf(width, height));
  config.auto_start = setup.auto_start;
  if (recording) finishRecording();
  system = await library.createSystem(config);
  if (recordNext) recording = new Recording(setup.name, config);
  recordNext = false;
  post({kind: 'camera', camera: config.camera, bytes: system.bytes});
}

function finishRecording() {
  if (!recording || !system) return;
  const blob = recording.finish(system.mapHash());
  if (recording.frames > 0) post({kind: 'recording', blob, frames: recording.frames, full: recording.full});
  recording = null;
}

/** @param {{frame: VideoFrame|ImageBitmap, time_ns: bigint}} message */
async function track({frame, time_ns}) {
  ++idleRun;
  const {data, width, height} = await images.of(frame);
  if (!system || config.camera.width !== width || config.camera.height !== height) await build(width, height);
  const s = /** @type {import('./pocket_ptam.js').System} */ (system);
  const begun = performance.now();
  const result = s.track({data, timestamp_ns: time_ns});
  const ms = performance.now() - begun;
  if (recording) recording.noteFrame(data, width, height, result);
  const points = new Float32Array(6 * result.observed_points);
  s.observedPoints().forEach(
      (point, i) => points.set([...point.px, ...point.predicted_px, point.kind, point.level], 6 * i));
  post(
      {kind: 'result', result, points, hint: library.hintText(result.hint), ms, frame, locked: s.locked()},
      [points.buffer, /** @type {any} */ (frame)]);
  idle();
}

const channel = new MessageChannel();
/** @type {() => void} */
let resume = () => {};
channel.port1.onmessage = () => resume();
/** Lets messages in that wait. */
const otherMessages = () => new Promise((resolve) => {
  resume = () => resolve(undefined);
  channel.port2.postMessage(0);
});

async function idle() {
  const mine = ++idleRun;
  const one = () => {
    system.workSlice();
    if (recording) recording.noteSlice();
  };
  while (mine === idleRun && system && system.hasWork()) {
    const until = performance.now() + 2;  // milliseconds: what a frame may have to wait
    do one();
    while (performance.now() < until && system.hasWork());
    await otherMessages();
  }
}

const calls = {
  library: loadLibrary,
  setup(/** @type {any} */ message) {
    if (setup && ['fov_rad', 'readout_s', 'axis', 'sign', 'auto_start'].every((key) => setup[key] === message[key]))
      return;
    if (system) say('another camera: the map is forgotten');
    setup = message;
    finishRecording();
    system = null;
  },
  frame: track,
  tap() {
    if (system) system.tap(), recording?.note('tap');
  },
  reset() {
    if (system) system.reset(), recording?.note('reset'), say('everything is forgotten');
  },
  lock() {
    if (system) system.setLocked(true), recording?.note('lock'), say('the map is locked');
  },
  unlock() {
    if (system) system.setLocked(false), recording?.note('unlock'), say('the map is unlocked');
  },
  save() {
    if (!system || system.mapBytes() === 0) return say('nothing is saved: there is no map yet');
    post({kind: 'map', file: system.saveMap()});
  },
  load(/** @type {any} */ {file}) {
    if (!system) return;
    system.loadMap(file);
    recording?.noteLoad(file);
    say('the map is loaded: return to a view that it knows');
  },
  record() {  // from the first frame of a new system
    recordNext = true;
    system = null;
  },
  finish() { finishRecording(); },
};

// One at a time: a frame is waited for before what came after it is looked at.
let before = Promise.resolve();
self.onmessage = ({data}) => {
  before = before.then(() => calls[data.kind](data)).catch((error) => {
    if (data.kind === 'frame') {
      data.frame.close();  // nothing happens to one that was given back
      return post({kind: 'refused', why: error.message});
    }
    post({kind: data.kind === 'library' ? 'failed' : 'said', text: error.message});
  });
};
