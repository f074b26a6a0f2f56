// Grey images of what a browser's camera delivers, at the size that is tracked.

const kLongSide = 320;  // pixels, tracked: the 2009 phone's

/** The tracked size of images. @param {number} width @param {number} height as shown @returns {[number, number]} */
export function trackedSize(width, height) {
  const scale = kLongSide / Math.max(width, height);
  return scale >= 1 ? [width, height] : [Math.round(width * scale), Math.round(height * scale)];
}

/**
 * @param {Uint8Array} from first row and on @param {number} stride @param {number} n pixels of a side that make one
 * @param {number} width @param {number} height of the result @returns {Uint8Array} means of n x n pixels, rounded
 */
export function shrunk(from, stride, n, width, height) {
  const out = new Uint8Array(width * height);
  const half = n * n >> 1;
  for (let y = 0, at = 0; y < height; ++y) {
    for (let x = 0; x < width; ++x, ++at) {
      let sum = half;
      for (let j = 0; j < n; ++j) {
        const row = (y * n + j) * stride + x * n;
        for (let i = 0; i < n; ++i) sum += from[row + i];
      }
      out[at] = n === 1 ? from[y * stride + x] : Math.floor(sum / (n * n));
    }
  }
  return out;
}

const kPlanar = ['I420', 'I420A', 'I422', 'I444', 'NV12'];  // their first plane is luminance

export class GreyImages {
  buffer = new Uint8Array(0);
  /** @type {OffscreenCanvas|null} */
  canvas = null;

  /**
   * The luminance as the camera gave it where the browser hands it out and it is a whole number of times as large,
   * else what the browser's canvas makes of the picture.
   * @param {VideoFrame|ImageBitmap} frame @returns {Promise<{data: Uint8Array, width: number, height: number}>}
   */
  async of(frame) {
    if ('copyTo' in frame) {
      const [width, height] = trackedSize(frame.displayWidth, frame.displayHeight);
      const rect = frame.visibleRect;
      const turned = /** @type {any} */ (frame).rotation || /** @type {any} */ (frame).flip;
      const n = rect ? rect.width / width : 0;
      if (kPlanar.includes(frame.format || '') && !turned && Number.isInteger(n) && rect.height === n * height) {
        try {
          const bytes = frame.allocationSize();
          if (this.buffer.length < bytes) this.buffer = new Uint8Array(bytes);
          const [{offset, stride}] = await frame.copyTo(this.buffer);
          return {data: shrunk(this.buffer.subarray(offset), stride, n, width, height), width, height};
        } catch (error) {  // a picture that only the graphics processor has
        }
      }
      return {data: this.drawn(frame, width, height), width, height};
    }
    const [width, height] = trackedSize(frame.width, frame.height);
    return {data: this.drawn(frame, width, height), width, height};
  }

  /** @param {VideoFrame|ImageBitmap} frame @param {number} width @param {number} height */
  drawn(frame, width, height) {
    if (!this.canvas || this.canvas.width !== width || this.canvas.height !== height)
      this.canvas = new OffscreenCanvas(width, height);
    const context =
        /** @type {OffscreenCanvasRenderingContext2D} */ (this.canvas.getContext('2d', {willReadFrequently: true}));
    context.drawImage(frame, 0, 0, width, height);
    const rgba = context.getImageData(0, 0, width, height).data;
    const out = new Uint8Array(width * height);
    for (let i = 0, at = 0; i < out.length; ++i, at += 4)  // BT.601
      out[i] = (77 * rgba[at] + 150 * rgba[at + 1] + 29 * rgba[at + 2] + 128) >> 8;
    return out;
  }
}
