// The run of time_tracking.c by the library for browsers: node track_time.mjs LIBRARY.wasm RECORDING. The library's
// time alone is told in the same places; last what pocket_ptam.js adds to a frame.
import {readFileSync} from 'node:fs';
import process from 'node:process';

import {PocketPtam} from '../../platform/web/pocket_ptam.js';

const kRuns = 15;
const now_us = () => Number(process.hrtime.bigint()) / 1000;

const recording = readFileSync(process.argv[3]);
const ptam = await PocketPtam.load(readFileSync(process.argv[2]));
const {pptam_camera, pptam_pose} = ptam.instance.layout.structures;
const {bytes} = pptam_camera;
const headBytes = bytes + 16 + pptam_pose.bytes;
const at = ptam.instance.allocate(bytes);
ptam.instance.bytes(at, bytes).set(recording.subarray(0, bytes));
const camera = ptam.instance.read('pptam_camera', at);
const config = ptam.configPhone(camera);
config.exposure_s = recording.readFloatLE(bytes);
const pixels = camera.width * camera.height;

/** @type {{track: number, map: number, around: number}[]} the shortest times of each tracked frame */
const best = [];
let hash = 0n;
for (let run = 0; run < kRuns; ++run) {
  const system = await ptam.createSystem(config);
  system.tap();
  const {pptam_track} = system.instance.functions;
  let tracked = 0;
  for (let offset = headBytes; offset + 8 + pixels <= recording.length; offset += 8 + pixels) {
    const data = recording.subarray(offset + 8, offset + 8 + pixels);
    const times = [now_us()];
    const place = system.room.put({data, timestamp_ns: recording.readBigInt64LE(offset)});
    times.push(now_us());
    pptam_track(system.instance.status, system.system, place, system.result);
    times.push(now_us());
    const result = system.instance.read('pptam_track_result', system.result);
    times.push(now_us());
    for (let slice = 0; slice < 40 && system.hasWork(); ++slice) system.workSlice();
    times.push(now_us());
    if (result.state !== ptam.constants.PPTAM_TRACKING_TRACKING) continue;
    const [put, track, read, map] = times.slice(1).map((time, i) => time - times[i]);
    best[tracked] ??= {track, map, around: put + read};
    const least = best[tracked++];
    least.track = Math.min(least.track, track);
    least.map = Math.min(least.map, map);
    least.around = Math.min(least.around, put + read);
  }
  hash = system.mapHash();
}
const mean = (/** @type {'track'|'map'|'around'} */ what) =>
    (best.reduce((sum, times) => sum + times[what], 0) / best.length).toFixed(2);
console.log(`${mean('track')} ${mean('map')} ${best.length} ${hash.toString(16).padStart(16, '0')} ${mean('around')}`);
