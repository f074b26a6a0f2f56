// The page: camera, worker, picture, buttons. A camera's frames go to the worker one at a time, the newest first; what
// comes back is drawn with the frame that it belongs to.
import {kinds, shutterOf} from './cameras.js';
import {keepMap, keptMap} from './map_store.js';
import {Renderer} from './renderer.js';

const element = (/** @type {string} */ id) => /** @type {any} */ (document.getElementById(id));
const view = element('canvas');
/** Some browsers play none that is not in the page. @type {HTMLVideoElement} */
const video = element('video');

/** What goes on, for tests and the curious. */
const status = {
  state: 'no camera',
  version: '',
  simd: false,
  arrived: 0,
  tracked: 0,
  dropped: 0,
  refused: 0,
  /** Frames since the first one with a pose, and those of them with one. */
  since: 0,
  poses: 0,
  misfits: 0,
  ms: 0,
  drawn: 0,
  said: '',
  trouble: '',
  recorded: 0,
  /** @type {any} */
  result: null,
  /** @type {any} */
  camera: null,
};
/** @type {any} */ (globalThis).pocketPtam = status;

/** @type {Worker|null} */
let worker = null;
/** @type {Object<string, number>} */
let constants = {};
/** @type {Renderer|null} */
let renderer = null;
/** Without WebGL: the picture alone. @type {CanvasRenderingContext2D|null} */
let plain = null;
/** @type {MediaStreamTrack|null} */
let track = null;
let busy = false;  // the worker has a frame
/** The newest frame that has come meanwhile. @type {{frame: VideoFrame|ImageBitmap, ns: bigint}|null} */
let next = null;
let lastNs = 0n;
let recording = false;
let locked = false;
/** @type {number|undefined} */
let noticeEnds;

/** A line over the picture, for a while. @param {string} text */
function say(text) {
  status.said = text;
  element('notice').textContent = text;
  clearTimeout(noticeEnds);
  noticeEnds = setTimeout(() => {
    element('notice').textContent = '';
  }, 4000);
}

/** What has to be mended by the user. @param {string} text empty: nothing */
function trouble(text) {
  status.trouble = text;
  element('trouble').textContent = text;
  element('trouble').hidden = text === '';
}

/** @param {string} state */
function showState(state) {
  status.state = state;
  document.body.dataset.state = state;
  element('state').textContent = state;
}

/** @param {object} message @param {Transferable[]} [transferred] */
const tell = (message, transferred = []) => worker?.postMessage(message, transferred);

// ---- Camera ---------------------------------------------------------------------------------------------------------

function tellSetup() {
  const kind = kinds[element('kind').value];
  const angle = screen.orientation ? screen.orientation.angle : 0;
  const [axis, sign] = element('lines').value.split(' ');
  const shutter = axis ? {axis, sign: sign === '-' ? -1 : 1} : shutterOf(kind.handset, angle);
  const inside = (/** @type {string} */ id, /** @type {number} */ low, /** @type {number} */ high) =>
      Math.min(Math.max(Number(element(id).value) || low, low), high);
  tell({
    kind: 'setup',
    name: track ? track.label || kind.name : kind.name,
    auto_start: true,
    ...shutter,
    fov_rad: inside('fov', 10, 140) * Math.PI / 180,
    readout_s: inside('readout', 0, 200) / 1000
  });
}

const kRefused = {
  NotAllowedError:
      'The camera was refused. Allow it for this page, in the browser\'s settings beside the address, and start again.',
  NotFoundError: 'There is no camera here. Plug one in and start again.',
  NotReadableError: 'The camera cannot be read: another program may have it. Close that one and start again.',
};

async function startCamera() {
  trouble('');
  if (!navigator.mediaDevices) {
    trouble('Browsers give cameras to pages from https:// or localhost only.');
    return;
  }
  let stream;
  try {
    stream = await navigator.mediaDevices.getUserMedia({
      audio: false,
      video: {
        facingMode: 'environment',
        width: {ideal: 640},
        height: {ideal: 480},
        frameRate: {ideal: 30},
        .../** @type {any} */ ({resizeMode: {ideal: 'none'}}),  // what the browser cuts off changes the field of view
      }
    });
  } catch (error) {
    trouble(kRefused[error.name] || `The camera does not start: ${error.message}`);
    return;
  }
  track = stream.getVideoTracks()[0];
  track.addEventListener('ended', () => {
    showState('no camera');
    trouble('The camera has gone. Plug it in, or close the program that took it, and start again.');
    showButtons(false);
  });
  tellSetup();
  video.srcObject = stream;
  try {
    await video.play();
  } catch (error) {
    trouble(`The camera's picture does not play: ${error.message}`);
    return;
  }
  showButtons(true);
  navigator.wakeLock?.request('screen').catch(() => {});  // nobody touches a screen that is looked through
  nextFrame();
}

/** @param {boolean} running */
function showButtons(running) {
  element('start').hidden = running;
  for (const id of ['tap', 'reset', 'lock', 'save', 'load', 'record']) element(id).hidden = !running;
}

/** When the frame that is shown was captured, milliseconds. @param {number} now @param {any} about */
function timeOf(now, about) {
  if (about.captureTime !== undefined) return about.captureTime;
  return about.mediaTime !== undefined && about.mediaTime > 0 ? 1000 * about.mediaTime : now;
}

function nextFrame() {
  if ('requestVideoFrameCallback' in video) {
    video.requestVideoFrameCallback((now, about) => takeFrame(timeOf(now, about)));
  } else {
    requestAnimationFrame((now) => takeFrame(now));
  }
}

/** @param {number} ms */
async function takeFrame(ms) {
  if (!track || track.readyState !== 'live') return;
  nextFrame();
  const ns = BigInt(Math.round(1e6 * ms));
  if (ns <= lastNs || !worker || !status.version) return;
  lastNs = ns;
  let frame;
  try {
    frame = 'VideoFrame' in globalThis ? new VideoFrame(video, {timestamp: Number(ns / 1000n)}) :
                                         await createImageBitmap(video);
  } catch (error) {
    return;  // nothing is shown yet
  }
  ++status.arrived;
  if (next) {
    next.frame.close();
    ++status.dropped;
  }
  next = {frame, ns};
  if (!busy) sendNext();
}

function sendNext() {
  busy = next !== null;
  if (!next) return;
  const {frame, ns} = next;
  next = null;
  tell({kind: 'frame', frame, time_ns: ns}, [/** @type {any} */ (frame)]);
}

// ---- Worker ---------------------------------------------------------------------------------------------------------

function startWorker() {
  // In the one-file page worker and library are in the page itself.
  const {workerUrl, wasm} = /** @type {any} */ (globalThis).pocketPtamFiles || {};
  worker =
      workerUrl ? new Worker(workerUrl) : new Worker(new URL('./tracker_worker.js', import.meta.url), {type: 'module'});
  worker.onmessage = ({data}) => answers[data.kind](data);
  worker.onerror = (event) =>
      trouble(`The tracker does not start: ${event.message || 'its file is not beside the page'}`);
  tell({kind: 'library', ...(wasm || {})});
}

/** @param {any} data */
function showResult({result, hint, ms}) {
  const names = (/** @type {string} */ start) =>
      Object.fromEntries(Object.entries(constants)
                             .filter(([name]) => name.startsWith(start))
                             .map(([name, value]) => [value, name.slice(start.length).toLowerCase()]));
  const quality = names('PPTAM_QUALITY_')[result.quality];
  showState(names('PPTAM_TRACKING_')[result.state]);
  document.body.dataset.quality = quality;
  const words = [];
  if (status.state === 'tracking') words.push(`quality ${quality}`);
  if (hint) words.push(hint);
  if (result.blurred) words.push('blurred');
  if (result.misfit) words.push('does not fit the map: was the camera zoomed or stabilised?');
  element('words').textContent = words.join(', ');
  element('progress').style.width = `${status.state === 'initialising' ? 100 * result.progress : 100}%`;
  element('figures').textContent = status.state === 'initialising' ?
      `${Math.round(100 * result.progress)} % ready` :
      `found ${result.points_found} of ${result.points_attempted}, residual ${result.reprojection_px.toFixed(2)} px, ` +
          `keyframes ${result.keyframes}, points ${result.map_points}, ${ms.toFixed(1)} ms`;
}

/** @type {Object<string, (data: any) => void>} */
const answers = {
  ready(data) {
    status.version = data.version;
    status.simd = data.simd;
    constants = data.constants;
  },
  camera({camera}) {
    status.camera = camera;
    locked = false;
    layOut();
  },
  result(data) {
    sendNext();
    const {result, frame, points} = data;
    ++status.tracked;
    if (result.pose_valid) ++status.poses;
    if (status.poses > 0) ++status.since;
    if (result.misfit) ++status.misfits;
    Object.assign(status, {result, ms: data.ms});
    showResult(data);
    locked = data.locked;
    element('lock').setAttribute('aria-pressed', String(locked));
    draw(frame, result, points);
    frame.close();
  },
  refused({why}) {
    sendNext();
    if (++status.refused === 1) say(`a frame was refused: ${why}`);
  },
  said({text}) { say(text); },
  failed({text}) { trouble(text); },
  map({file}) {
    keepMap(cameraName(), file)
        .then(
            () => say(`the map is kept in this browser: ${Math.round(file.length / 1024)} kB`),
            (error) => say(`the map is not kept: ${error.message}`));
  },
  recording({blob, frames, full}) {
    status.recorded = frames;
    const link = document.createElement('a');
    link.href = URL.createObjectURL(blob);
    link.download = 'pocket-ptam-recording.tar';
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
    say(`${frames} frames recorded${full ? ', until the memory for it was full' : ''}`);
  },
};

/** @param {VideoFrame|ImageBitmap} frame @param {any} result @param {Float32Array} points */
function draw(frame, result, points) {
  try {
    if (!plain) renderer ??= new Renderer(view);
  } catch (error) {
    trouble(`${error.message}: there is the picture without the house.`);
    plain = view.getContext('2d');
  }
  if (plain)
    plain.drawImage(frame, 0, 0, view.width, view.height);
  else if (renderer?.draw(frame, status.camera, result, points, constants))
    ++status.drawn;
}

/** Maps belong to one camera and its settings. */
function cameraName() {
  const c = status.camera;
  return [c.width, c.height, c.fx, c.shutter_axis, c.line_time_s].join(' ');
}

// ---- Picture and buttons --------------------------------------------------------------------------------------------

/** As many pixels as the screen shows of it, within reason. */
function layOut() {
  const c = status.camera;
  if (!c) return;
  const room = Math.min(
      document.documentElement.clientWidth * devicePixelRatio / c.width,
      0.72 * innerHeight * devicePixelRatio / c.height);
  const scale = Math.max(1, Math.min(room, 4));
  view.width = Math.round(c.width * scale);
  view.height = Math.round(c.height * scale);
}

const actions = {
  tap() { tell({kind: 'tap'}), say('tap: the next frame is the first view; move sideways'); },
  reset() { tell({kind: 'reset'}); },
  lock() { tell({kind: locked ? 'unlock' : 'lock'}); },
  save() { tell({kind: 'save'}); },
  async load() {
    try {
      const file = await keptMap(cameraName());
      if (file)
        tell({kind: 'load', file});
      else
        say('no map of this camera is kept here');
    } catch (error) {
      say(`no map is loaded: ${error.message}`);
    }
  },
  record() {
    recording = !recording;
    element('record').setAttribute('aria-pressed', String(recording));
    tell({kind: recording ? 'record' : 'finish'});
    if (recording) say('recording from the beginning: hold still, then move sideways');
  },
};
for (const [id, action] of Object.entries(actions)) element(id).addEventListener('click', action);
element('start').addEventListener('click', startCamera);
view.addEventListener('click', () => {  // by touch, too
  if (status.state === 'waiting' || status.state === 'initialising') actions.tap();
});
addEventListener('keydown', (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || /** @type {any} */ (event.target).tagName === 'INPUT') return;
  const action = {t: 'tap', r: 'reset', l: 'lock', s: 'save', o: 'load'}[event.key];
  if (action && worker) actions[action]();
});
addEventListener('resize', layOut);
if (screen.orientation) screen.orientation.addEventListener('change', tellSetup);

for (const [i, {name}] of kinds.entries()) element('kind').append(new Option(name, String(i)));
function showKind() {
  const {fov, readout_ms} = kinds[element('kind').value];
  element('fov').value = fov;
  element('readout').value = readout_ms;
  element('lines').value = '';
}
element('kind').value = /Mobi|Android|iPhone|iPad/.test(navigator.userAgent) ? '0' : '4';
showKind();
element('kind').addEventListener('change', () => {
  showKind(), tellSetup();
});
for (const id of ['fov', 'readout', 'lines']) element(id).addEventListener('change', tellSetup);
startWorker();
