// What the tracker did, in the order in which it did it, as `pocket-ptam live --record` keeps it
// (platform/run/live_recording.h): a folder, in a tar file, that `pocket-ptam replay` repeats with the same bits.

const kMostBytes = 256 << 20;  // of images, which are kept in memory: then the recording ends

/** A number as C reads it again with the same bits. @param {number} value */
function number(value) { return Number(Math.fround(value).toPrecision(9)).toString(); }

/** FNV-1a over bytes as they lie in memory. */
class Fnv {
  low = 0x84222325;
  high = 0xcbf29ce4;
  /** @param {ArrayBufferView} data */
  add(data) {
    for (const byte of new Uint8Array(data.buffer, data.byteOffset, data.byteLength)) {
      // Times 0x100000001b3, in halves of 32 bits.
      const low = (this.low ^ byte) >>> 0;
      const carry = Math.floor(low * 0x1b3 / 0x100000000);
      this.high = (Math.imul(this.high, 0x1b3) + carry + (low << 8)) >>> 0;
      this.low = Math.imul(low, 0x1b3) >>> 0;
    }
  }
  /** @returns {string} */
  text() { return this.high.toString(16).padStart(8, '0') + this.low.toString(16).padStart(8, '0'); }
}

/** result_hash() of platform/run/live_recording.cpp. @param {import('./pocket_ptam.js').TrackResult} r */
export function resultHash(r) {
  const hash = new Fnv();
  hash.add(BigInt64Array.of(r.timestamp_ns));
  hash.add(Int32Array.of(
      0, r.state, r.quality, r.hint, Number(r.pose_valid), r.points_attempted, r.points_found, r.points_inliers,
      r.partial_found, r.keyframes, r.map_points));
  const byColumns = (/** @type {Float32Array} */ m, /** @type {number} */ n) =>
      m.map((_, i) => m[n * (i % n) + Math.floor(i / n)]);
  hash.add(byColumns(r.T_cw.R, 3));
  hash.add(r.T_cw.t);
  hash.add(byColumns(r.covariance, 6));  // its bits are not quite symmetric
  return hash.text();
}

/** A file's head in a tar archive. @param {string} name @param {number} bytes */
function tarHead(name, bytes) {
  const head = new Uint8Array(512);
  const put = (/** @type {number} */ at, /** @type {string} */ text) => head.set(new TextEncoder().encode(text), at);
  put(0, name);
  put(100,
      '0000644\0' +
          '0000000\0' +
          '0000000\0' + bytes.toString(8).padStart(11, '0') + '\0' +
          '00000000000\0');
  put(148, '        0');  // the sum's place, blank, and the kind of file
  put(257,
      'ustar\0' +
          '00');
  put(148, head.reduce((sum, byte) => sum + byte, 0).toString(8).padStart(6, '0') + '\0 ');
  return head;
}

export class Recording {
  /** @param {string} name @param {import('./pocket_ptam.js').Config} config */
  constructor(name, config) {
    const c = config.camera;
    const kinds = ['none', 'fov', 'radtan', 'equidistant'];
    const coeffs = Array.from({length: 5}, (_, i) => number((c.coeffs || [])[i] || 0));
    const readout_s = (c.line_time_s || 0) * (c.shutter_axis ? c.width : c.height);
    this.folder = 'pocket-ptam-recording/';
    this.list = '# timestamp filename\n';
    this.text = 'pocket-ptam live recording 1\n' +
        `name ${name.replace(/[\x00-\x1f]/g, ' ')}\n` +
        `camera ${c.width} ${c.height} ${[c.fx, c.fy, c.cx, c.cy].map(number).join(' ')} ` +
        `${kinds[c.distortion || 0]} ${coeffs.join(' ')} ${c.shutter_axis ? 'columns' : 'rows'} ` +
        `${number(c.line_time_s || 0)} ${number(config.exposure_s)} 0\n` +
        `settings ${Number(config.auto_start)} ${number(config.initial_plane_distance)} ` +
        `${Number(config.steady_damping)} -1 -1\n`;
    this.calibration = `cam0:\n  camera_model: pinhole\n  distortion_model: ${kinds[c.distortion || 0]}\n` +
        `  distortion_coeffs: [${c.distortion ? coeffs.join(', ') : ''}]\n` +
        `  intrinsics: [${[c.fx, c.fy, c.cx, c.cy].map(number).join(', ')}]\n  resolution: [${c.width}, ${
                           c.height}]\n` +
        `  readout_s: ${number(Math.abs(readout_s))}\n  readout_axis: ${c.shutter_axis ? 'columns' : 'rows'}\n` +
        `  readout_direction: ${readout_s < 0 ? -1 : 1}\n`;
    /** @type {(Uint8Array|string)[]} */
    this.parts = [];
    this.frames = 0;
    this.maps = 0;
    this.slices = 0;
    this.bytes = 0;
    this.full = false;
  }

  /** @param {string} name @param {...(Uint8Array|string)} content */
  file(name, ...content) {
    const whole = content.map((part) => typeof part === 'string' ? new TextEncoder().encode(part) : part);
    const bytes = whole.reduce((sum, part) => sum + part.length, 0);
    this.parts.push(tarHead(this.folder + name, bytes), ...whole, new Uint8Array((512 - bytes % 512) % 512));
    this.bytes += bytes;
  }

  noteSlice() { ++this.slices; }
  /** @param {string} call */
  note(call) {
    if (this.full) return;
    if (this.slices > 0) this.text += `slices ${this.slices}\n`;
    this.slices = 0;
    this.text += call + '\n';
  }
  /** @param {Uint8Array} map */
  noteLoad(map) {
    const name = `map-${this.maps++}.map`;
    this.file(name, map.slice());
    this.note('load ' + name);
  }
  /**
   * @param {Uint8Array} data @param {number} width @param {number} height
   * @param {import('./pocket_ptam.js').TrackResult} result
   */
  noteFrame(data, width, height, result) {
    if (this.bytes + data.length > kMostBytes) this.full = true;
    if (this.full) return;
    const ns = result.timestamp_ns;
    const stamp = `${ns / 1000000000n}.${(ns % 1000000000n).toString().padStart(9, '0')}`;
    const name = `rgb/${stamp}.pgm`;
    this.file(name, `P5\n${width} ${height}\n255\n`, data);
    this.list += `${stamp} ${name}\n`;
    this.note(`frame ${ns} ${name} ${resultHash(result)}`);
    ++this.frames;
  }

  /** @param {bigint} mapHash @returns {Blob} a tar archive */
  finish(mapHash) {
    if (!this.full) this.note(`end ${mapHash.toString(16).padStart(16, '0')}`);
    this.file('events.txt', this.text);
    this.file('rgb.txt', this.list);
    this.file('calibration.yaml', this.calibration);
    return new Blob([...this.parts, new Uint8Array(1024)], {type: 'application/x-tar'});
  }
}
