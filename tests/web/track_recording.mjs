// The run of tests/bits/run.cpp once more, by the library for browsers and its JavaScript interface: the recording is
// tracked, mapping for a while after each frame, and two lines are said of it, the second one with the hash of the map,
// in which all poses have a part.
//
//   node track_recording.mjs LIBRARY.wasm RECORDING [CHANGED_FRAME]
import {readFileSync} from 'node:fs';
import process from 'node:process';

import {PocketPtam} from '../../platform/web/pocket_ptam.js';

const kSlicesAFrame = 40;  // as there, and the configuration too

const hex = (/** @type {bigint} */ number) => number.toString(16).padStart(16, '0');

/**
 * @param {string} library @param {string} file @param {number} changedFrame in which one pixel is inverted; -1: none
 */
async function trackRecording(library, file, changedFrame) {
  const recording = readFileSync(file);
  const ptam = await PocketPtam.load(readFileSync(library));
  const {pptam_camera: layout, pptam_pose} = ptam.instance.layout.structures;
  // The head is a pptam_camera as it lies in memory, the exposure, three numbers, the first that of frames, and a pose.
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
  const pixels = camera.width * camera.height;
  let offset = layout.bytes + 16 + pptam_pose.bytes;
  let poses = 0;
  let r;
  for (let i = 0; i < frames; ++i) {
    const timestamp_ns = recording.readBigInt64LE(offset);
    const data = new Uint8Array(recording.subarray(offset + 8, offset + 8 + pixels));
    offset += 8 + pixels;
    if (i === changedFrame) data[Math.floor(pixels / 2)] ^= 0xff;
    r = system.track({data, timestamp_ns});
    poses += Number(r.pose_valid);
    for (let slice = 0; slice < kSlicesAFrame && system.hasWork(); ++slice) system.workSlice();
  }
  said.push(`${poses} poses, ${r.keyframes} keyframes, map ${hex(system.mapHash())}`);
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
