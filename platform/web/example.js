// Tracks the camera of a page and writes where it is: a page with <video autoplay playsinline muted></video><pre></pre>
// and <script type="module" src="example.js"></script>, this file, pocket_ptam.js and pocket_ptam_simd.wasm beside it.
import {PocketPtam} from './pocket_ptam.js';

const video = document.querySelector('video');
const text = document.querySelector('pre');
const library = await PocketPtam.load(await (await fetch('pocket_ptam_simd.wasm')).arrayBuffer());
video.srcObject = await navigator.mediaDevices.getUserMedia({video: {facingMode: 'environment'}});
await video.play();

// The tracked image is 320 pixels wide; the field of view, 60 degrees across, is a guess.
const width = 320, height = Math.round(320 * video.videoHeight / video.videoWidth);
const f = 0.5 * width / Math.tan(0.5 * 60 * Math.PI / 180);
const config = library.configPhone({width, height, fx: f, fy: f, cx: (width - 1) / 2, cy: (height - 1) / 2});
config.auto_start = true;  // hold still, then move sideways
const system = await library.createSystem(config);

const canvas = new OffscreenCanvas(width, height);
const context = canvas.getContext('2d', {willReadFrequently: true});
const data = new Uint8Array(width * height);

function frame(now, {captureTime = now}) {
  context.drawImage(video, 0, 0, width, height);
  const {data: rgba} = context.getImageData(0, 0, width, height);
  for (let i = 0; i < data.length; ++i) data[i] = rgba[4 * i + 1];  // green will do for grey
  try {
    const result = system.track({data, timestamp_ns: BigInt(Math.round(1e6 * captureTime))});
    text.textContent =
        result.pose_valid ? library.inverseAsQuaternion(result.T_cw).position.join(' ') : library.hintText(result.hint);
  } catch (error) {
    text.textContent = error.message;  // such as the same time twice
  }
  const until = performance.now() + 10;  // milliseconds, for the map
  while (performance.now() < until && system.hasWork()) system.workSlice();
  video.requestVideoFrameCallback(frame);
}
video.requestVideoFrameCallback(frame);
