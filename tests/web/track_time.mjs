// The run of time_tracking.c by the library for browsers: node track_time.mjs LIBRARY.wasm RECORDING. Its calls go past
// pocket_ptam.js, so that the library's time alone is told; what the interface adds is told as a third number.
import {readFileSync} from 'node:fs';
import process from 'node:process';

import {PocketPtam} from '../../platform/web/pocket_ptam.js';

const wall_us = () => Number(process.hrtime.bigint()) / 1000;

const recording = readFileSync(process.argv[3]);
const ptam = await PocketPtam.load(readFileSync(process.argv[2]));
const {bytes} = ptam.instance.layout.structures.pptam_camera;
const at = ptam.instance.allocate(bytes);
ptam.instance.bytes(at, bytes).set(recording.subarray(0, bytes));
const camera = ptam.instance.read('pptam_camera', at);
const config = ptam.configPhone(camera);
config.exposure_s = recording.readFloatLE(bytes);
const pixels = camera.width * camera.height;

/** One run; the first ones warm the engine up. @returns {Promise<{track: number, map: number, all: number, tracked: number,
 * hash: bigint}>} microseconds a tracked frame */
async function run() {
  const system = await ptam.createSystem(config);
  system.tap();
  const {pptam_track} = system.instance.functions;
  let track = 0, map = 0, all = 0, tracked = 0;
  for (let offset = bytes + 8; offset + 8 + pixels <= recording.length; offset += 8 + pixels) {
    const frame = {data: recording.subarray(offset + 8, offset + 8 + pixels), timestamp_ns: recording.readBigInt64LE(offset)};
    const before = wall_us();
    const place = system.room.put(frame);
    const begun = wall_us();
    pptam_track(system.instance.status, system.system, place, system.result);
    const done = wall_us();
    const result = system.instance.read('pptam_track_result', system.result);
    const read = wall_us();
    for (let slice = 0; slice < 40 && system.hasWork(); ++slice) system.workSlice();
    if (result.state !== ptam.constants.PPTAM_TRACKING_TRACKING) continue;
    ++tracked;
    track += done - begun;
    all += read - before;
    map += wall_us() - read;
  }
  return {track: track / tracked, map: map / tracked, all: all / tracked, tracked, hash: system.mapHash()};
}
const median = (/** @type {number[]} */ values) => values.sort((a, b) => a - b)[values.length >> 1];
const runs = [];
for (let i = 0; i < 25; ++i) runs.push(await run());
const late = runs.slice(10);
const [track, map, all] = ['track', 'map', 'all'].map((what) => median(late.map((r) => r[what])));
const {tracked, hash} = late[0];
console.log(`${track.toFixed(2)} ${map.toFixed(2)} ${tracked} ${hash.toString(16).padStart(16, '0')} interface ${(all - track).toFixed(2)}`);
