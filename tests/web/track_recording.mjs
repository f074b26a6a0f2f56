// The run of tests/bare_metal/run.cpp once more, by the library for browsers and its JavaScript interface: the
// recording is tracked, mapping for a while after each frame, and two lines are said of it, the second one with the
// hashes of all results and of the map.
//
//   node track_recording.mjs LIBRARY.wasm RECORDING [CHANGED_FRAME]
import {readFileSync} from 'node:fs';
import process from 'node:process';

import {PocketPtam} from '../../platform/web/pocket_ptam.js';

const kSlicesAFrame = 40;  // as there, and the configuration too

class Fnv {
  value = 0xcbf29ce484222325n;
  /** @param {ArrayBufferView} data */
  add(data) {
    const mask = 0xffffffffffffffffn;
    for (const byte of new Uint8Array(data.buffer, data.byteOffset, data.byteLength))
      this.value = ((this.value ^ BigInt(byte)) * 0x100000001b3n) & mask;
  }
}
const hex = (/** @type {bigint} */ number) => number.toString(16).padStart(16, '0');

/**
 * @param {string} library @param {string} file @param {number} changedFrame in which one pixel is inverted; -1: none
 */
async function trackRecording(library, file, changedFrame) {
  const recording = readFileSync(file);
  const ptam = await PocketPtam.load(readFileSync(library));
  const layout = ptam.instance.layout.structures.pptam_camera;
  // The head is a pptam_camera as it lies in memory, the exposure, the number of frames.
  const instance = ptam.instance;
  const at = instance.allocate(layout.bytes);
  instance.bytes(at, layout.bytes).set(recording.subarray(0, layout.bytes));
  const camera = instance.read('pptam_camera', at);
  const config = ptam.configPhone(camera);
  config.exposure_s = recording.readFloatLE(layout.bytes);
  const frames = recording.readInt32LE(layout.bytes + 4);
  Object.assign(config, {max_keyframes: 20, max_erased_keyframes: 5, max_maps: 1});
  const system = await ptam.createSystem(config);
  const said = [`block ${system.bytes} bytes`];
  system.tap();
  const results = new Fnv();
  const pixels = camera.width * camera.height;
  let offset = layout.bytes + 8;
  let poses = 0;
  let r;
  for (let i = 0; i < frames; ++i) {
    const timestamp_ns = recording.readBigInt64LE(offset);
    const data = new Uint8Array(recording.subarray(offset + 8, offset + 8 + pixels));
    offset += 8 + pixels;
    if (i === changedFrame) data[Math.floor(pixels / 2)] ^= 0xff;
    r = system.track({data, timestamp_ns});
    results.add(Int32Array.of(
        r.state, r.quality, r.hint, Number(r.pose_valid), r.points_found, r.points_inliers, r.partial_found, r.map,
        r.keyframes, r.map_points, r.observed_points));
    for (const part of [r.T_cw.R, r.T_cw.t, r.velocity, r.covariance]) results.add(part);
    poses += Number(r.pose_valid);
    for (let slice = 0; slice < kSlicesAFrame && system.hasWork(); ++slice) system.workSlice();
  }
  said.push(`${poses} poses, ${r.keyframes} keyframes, results ${hex(results.value)}, map ${hex(system.mapHash())}`);
  return {said, poses};
}

const [library, file, changed = '-1'] = process.argv.slice(2);
if (!file) {
  console.error('usage: track_recording.mjs LIBRARY.wasm RECORDING [CHANGED_FRAME]');
  process.exit(2);
}
const {said, poses} = await trackRecording(library, file, Number(changed));
for (const line of said) console.log(line);
if (poses <= 20) {
  console.log('FAILED: there must be a map, or nothing is compared');
  process.exit(1);
}
