// Pocket PTAM for JavaScript, in browsers, workers and Node.js: pocket_ptam_c.h by its WebAssembly library,
// pocket_ptam.wasm or, for engines with vectors, pocket_ptam_simd.wasm (same bits).
//
//   const library = await PocketPtam.load(wasmBytes);
//   const system = await library.createSystem(library.configPhone(camera));
//   system.tap();                                        // start at the next frame, or config.auto_start
//   for (each frame) {
//     const result = system.track(frame);
//     while (thereIsTimeBeforeTheNextFrame() && system.hasWork()) system.workSlice();
//   }
//
// Structures are plain objects whose fields have the names of the C interface, where each is explained. Numbers of 64
// bits are BigInt, arrays of numbers are typed arrays, hints and states are numbers of PocketPtam.constants. Functions
// are called as in C, without pptam_ and with capital letters for underscores. What C answers with a status is thrown
// here, as a PtamError; nothing has changed then. Each system and each tracker has a memory of its own: there is
// nothing to free. Everything that is returned is a copy.
//
// How structures lie in memory is told by the library itself (layout.cmake): there is no offset in this file.

/**
 * Lens and rolling shutter; what is left out is 0.
 * @typedef {object} Camera
 * @property {number} width pixels
 * @property {number} height pixels
 * @property {number} fx pixels
 * @property {number} fy pixels
 * @property {number} cx pixels; pixel centres are at integers
 * @property {number} cy pixels
 * @property {number} [distortion] PPTAM_DISTORTION_...
 * @property {ArrayLike<number>} [coeffs] up to five
 * @property {number} [shutter_axis] PPTAM_SHUTTER_...
 * @property {number} [line_time_s] signed seconds from one line to the next; 0: global shutter
 */

/**
 * A rigid motion: R p + t. R by rows.
 * @typedef {object} Pose
 * @property {Float32Array} R nine
 * @property {Float32Array} t three
 */

/**
 * All settings: begin with configPhone().
 * @typedef {object} Config
 * @property {Camera} camera
 * @property {number} exposure_s of a line; 0: unknown
 * @property {number} max_keyframes
 * @property {number} max_erased_keyframes
 * @property {number} max_maps
 * @property {number} max_map_points
 * @property {number} max_measurements
 * @property {number} max_measurements_per_point
 * @property {number} max_partial_points
 * @property {number} max_measured_points
 * @property {number} max_partial_searches
 * @property {number} max_new_partial_points
 * @property {number} max_initial_points
 * @property {number} cells_x
 * @property {number} cells_y
 * @property {number} search_level
 * @property {number} coarse_search_level
 * @property {number} initial_baseline world units
 * @property {number} initial_plane_distance world units
 * @property {boolean} auto_start without a tap, when the camera is held still
 * @property {number} min_keyframe_interval_s
 * @property {boolean} steady_damping
 * @property {PhoneProfile} profile
 */

/**
 * Turns work into the modelled time of a device.
 * @typedef {object} PhoneProfile
 * @property {number} clock_mhz
 * @property {number} cycles_per_instruction
 * @property {Float32Array} instructions for a unit of each PPTAM_WORK_...
 */

/**
 * An image to be tracked, of the camera's size.
 * @typedef {object} Frame
 * @property {Uint8Array} data the first plane
 * @property {bigint} timestamp_ns mid-exposure of the image's centre, from any origin
 * @property {number} [stride_bytes] from row to row; left out: rows without gaps
 * @property {number} [format] PPTAM_PIXEL_...; left out: grey
 * @property {number} [width] left out: the camera's
 * @property {number} [height] likewise
 */

/**
 * What became of a frame.
 * @typedef {object} TrackResult
 * @property {bigint} timestamp_ns
 * @property {number} state PPTAM_TRACKING_...
 * @property {number} quality PPTAM_QUALITY_...
 * @property {number} hint PPTAM_HINT_...; words: PocketPtam.hintText()
 * @property {number} progress of initialisation, 0 to 1
 * @property {number} limits_hit bits, PPTAM_LIMIT_...
 * @property {boolean} pose_valid whether T_cw, velocity and covariance are valid
 * @property {boolean} blurred
 * @property {boolean} misfit the points agree far worse than usual: a zoom, a stabiliser's jump
 * @property {boolean} keyframe_added
 * @property {boolean} repeated the last picture again
 * @property {Pose} T_cw world to camera
 * @property {Float32Array} velocity of the camera in its own frame: translation, units/s, rotation, rad/s
 * @property {Float32Array} covariance 6x6 of mu in T_cw <- exp(mu) T_cw, translation before rotation
 * @property {number} points_attempted
 * @property {number} points_found
 * @property {number} points_inliers
 * @property {number} reprojection_px rms error of an inlier's coordinate
 * @property {number} partial_attempted
 * @property {number} partial_found
 * @property {number} map of the pose: 1, 2, ...; 0: none is finished
 * @property {number} world_changes by setLength() and setGround(): place anew what was placed
 * @property {number} maps kept, that in use included
 * @property {number} keyframes
 * @property {number} erased_keyframes
 * @property {number} map_points
 * @property {number} observed_points
 * @property {BigInt64Array} stage_ns by PPTAM_STAGE_...; zero without a clock
 */

/**
 * @typedef {object} ObservedPoint
 * @property {Float32Array} px
 * @property {Float32Array} predicted_px
 * @property {number} point_id
 * @property {number} kind PPTAM_OBSERVED_...
 * @property {number} level pyramid level searched
 */

/**
 * @typedef {object} Keyframe
 * @property {number} id
 * @property {bigint} timestamp_ns
 * @property {Pose} T_cw
 */

/**
 * @typedef {object} MapPoint
 * @property {number} id
 * @property {Float32Array} p_w
 * @property {Float32Array} normal_w
 * @property {number} measurements
 * @property {number} grey
 */

/**
 * A map point measured in a keyframe.
 * @typedef {object} Measurement
 * @property {number} point_id
 * @property {number} keyframe_id
 * @property {Float32Array} px
 * @property {Float32Array} global_px corrected to a global shutter
 * @property {number} sigma pixels
 */

/**
 * A plane of the map.
 * @typedef {object} Plane
 * @property {Float32Array} normal_w
 * @property {Float32Array} middle_w
 * @property {number} threshold world units
 * @property {number} points
 */

/**
 * Header of a saved map.
 * @typedef {object} MapInfo
 * @property {number} version
 * @property {Camera} camera
 * @property {number} maps
 * @property {number} keyframes
 * @property {number} erased_keyframes
 * @property {number} map_points
 * @property {number} partial_points
 * @property {number} min_keyframes
 * @property {number} min_erased_keyframes
 * @property {number} min_map_points
 * @property {number} min_partial_points
 * @property {number} min_measurements
 * @property {number} min_measurements_per_point
 */

/**
 * A known object: see pptam_object_arrays. What is left out is empty.
 * @typedef {object} ObjectModel
 * @property {ArrayLike<number>} [points] x, y, z of each
 * @property {ArrayLike<number>} [corners]
 * @property {{a: number, b: number, min_length_px: number}[]} [lines]
 * @property {{first: number, count: number, open: boolean, min_area_px2: number, min_length_px: number}[]} [faces]
 * @property {{a: number, b: number, radius: number, min_length_px: number}[]} [cylinders]
 * @property {{centre: ArrayLike<number>, normal: ArrayLike<number>, radius: number, both_sides: boolean,
 *   min_area_px2: number}[]} [circles]
 * @property {{centre: ArrayLike<number>, radius: number, min_area_px2: number}[]} [spheres]
 * @property {boolean} [outlines_of_smooth]
 */

/**
 * What became of a frame, of a known object.
 * @typedef {object} ModelResult
 * @property {bigint} timestamp_ns
 * @property {number} state PPTAM_MODEL_WAITING, ..._TRACKING, ..._LOST
 * @property {boolean} pose_valid
 * @property {boolean} restarted
 * @property {Pose} T_co object to camera
 * @property {Float32Array} covariance
 * @property {number} quality 0 to 1
 * @property {number} error_px
 * @property {Float32Array} feature_error_px
 * @property {Int32Array} feature_inliers
 * @property {number} sites_visible
 * @property {number} sites_inliers
 * @property {number} sites
 */

/**
 * A place on a visible contour.
 * @typedef {object} ModelSite
 * @property {Float32Array} px
 * @property {Float32Array} model_px
 * @property {number} contour
 * @property {number} kind PPTAM_SITE_...
 */

/** What was refused: code is a PPTAM_... status, message says what to do. */
export class PtamError extends Error {
  /** @param {number} code @param {string} message */
  constructor(code, message) {
    super(message);
    this.name = 'PtamError';
    this.code = code;
  }
}

const kPage = 65536;  // bytes, of WebAssembly's memory
const kScalars = {
  int32_t: {bytes: 4, get: 'getInt32', array: Int32Array},
  uint32_t: {bytes: 4, get: 'getUint32', array: Uint32Array},
  size_t: {bytes: 4, get: 'getUint32', array: Uint32Array},
  pointer: {bytes: 4, get: 'getUint32', array: Uint32Array},
  float: {bytes: 4, get: 'getFloat32', array: Float32Array},
  int64_t: {bytes: 8, get: 'getBigInt64', array: BigInt64Array},
  bool: {bytes: 1, get: 'getUint8', array: Uint8Array},
};

/** An instance of the library with its memory: blocks that are never freed, and room for a call's arguments. */
class Instance {
  /** @param {WebAssembly.Instance} instance @param {Layout|null} layout */
  constructor(instance, layout) {
    this.functions = /** @type {any} */ (instance.exports);
    this.top = this.functions.__heap_base.value;
    this.layout = layout || readLayout(this);
    this.status = this.allocate(this.layout.structures.pptam_status.bytes);
  }

  // Views are made anew: a memory that grows leaves older ones empty.
  view() { return new DataView(this.functions.memory.buffer); }
  /** @param {number} at @param {number} length */
  bytes(at, length) { return new Uint8Array(this.functions.memory.buffer, at, length); }

  /** @param {number} bytes @returns {number} aligned as by malloc */
  allocate(bytes) {
    const at = (this.top + 15) & ~15;
    const memory = this.functions.memory;
    const missing = at + bytes - memory.buffer.byteLength;
    if (missing > 0) {
      try {
        memory.grow(Math.ceil(missing / kPage));
      } catch (error) {
        throw new PtamError(2, `there is no memory for ${bytes} bytes: close other pages, or lower the capacities`);
      }
    }
    this.top = at + bytes;
    return at;
  }

  /** Runs it, then frees what it has allocated. @template T @param {() => T} work @returns {T} */
  briefly(work) {
    const top = this.top;
    try {
      return work();
    } finally {
      this.top = top;
    }
  }

  /** @param {number} at */
  text(at) {
    const all = new Uint8Array(this.functions.memory.buffer);
    return new TextDecoder().decode(all.slice(at, all.indexOf(0, at)));
  }

  /** Calls a function that returns a status. @param {string} name @param {...(number|bigint|boolean)} rest */
  call(name, ...rest) {
    this.functions['pptam_' + name](this.status, ...rest);
    const {code, message} = this.read('pptam_status', this.status);
    if (code !== 0) throw new PtamError(code, this.text(message));
  }

  /** @param {string} structure @param {number} at @returns {any} */
  read(structure, at) {
    const view = this.view();
    const one = (/** @type {string} */ type, /** @type {number} */ place) => {
      if (!(type in kScalars)) return this.read(type, place);
      const value = view[kScalars[type].get](place, true);
      return type === 'bool' ? value !== 0 : value;
    };
    const result = {};
    for (const {type, name, offset, count} of this.layout.structures[structure].fields) {
      if (count === 1) {
        result[name] = one(type, at + offset);
      } else {
        const {array, bytes} = kScalars[type];
        result[name] = new array(this.functions.memory.buffer.slice(at + offset, at + offset + count * bytes));
      }
    }
    return result;
  }

  /** Fields that the value lacks are 0. @param {string} structure @param {number} at @param {any} value */
  write(structure, at, value) {
    const {bytes, fields} = this.layout.structures[structure];
    this.bytes(at, bytes).fill(0);
    const view = this.view();
    const known = new Set(fields.map((field) => field.name));
    for (const name of Object.keys(value))
      if (!known.has(name)) throw new TypeError(`${structure} has no field ${name}`);
    for (const {type, name, offset, count} of fields) {
      const given = value[name];
      if (given === undefined) continue;
      if (!(type in kScalars)) {
        this.write(type, at + offset, given);
        continue;
      }
      const list = count === 1 ? [given] : given;
      if (list.length > count) throw new TypeError(`${structure}.${name} has ${count} elements at most`);
      const put = kScalars[type].get.replace('get', 'set');
      for (let i = 0; i < list.length; ++i) {
        const element = type === 'bool' ? Number(Boolean(list[i])) : list[i];
        view[put](at + offset + i * kScalars[type].bytes, element, true);
      }
    }
    return at;
  }

  /** @param {string} structure @param {any} value @returns {number} where it lies */
  put(structure, value) { return this.write(structure, this.allocate(this.layout.structures[structure].bytes), value); }
  /** @param {string} type @param {ArrayLike<number>} values */
  putArray(type, values) {
    const at = this.allocate(4 * values.length);
    new kScalars[type].array(this.functions.memory.buffer, at, values.length).set(values);
    return at;
  }
  /** @param {string} type @param {number} at @param {number} count */
  array(type, at, count) {
    const {array, bytes} = kScalars[type];
    return new array(this.functions.memory.buffer.slice(at, at + count * bytes));
  }

  /**
   * A list that C copies into the caller's array. @param {string} name @param {string} structure @param {number[]}
   * rest
   */
  list(name, structure, ...rest) {
    return this.briefly(() => {
      const count = this.allocate(4);
      this.call(name, ...rest, 0, 0, count);
      const length = this.view().getInt32(count, true);
      const {bytes} = this.layout.structures[structure];
      const out = this.allocate(length * bytes);
      this.call(name, ...rest, out, length, count);
      return Array.from({length}, (_, i) => this.read(structure, out + i * bytes));
    });
  }

  /** What a handle was written to by a call. @param {string} name @param {number[]} rest */
  handle(name, ...rest) {
    const out = this.allocate(4);
    this.call(name, ...rest, out);
    return this.view().getUint32(out, true);
  }

  /**
   * A function of JavaScript as a pointer for C. @param {string[]} parameters @param {string[]} results
   * @param {Function} callback
   */
  pointer(parameters, results, callback) {
    const kTypes = {i32: 0x7f, i64: 0x7e};
    const types = (/** @type {string[]} */ list) => [list.length, ...list.map((type) => kTypes[type])];
    const section = (/** @type {number} */ id, /** @type {number[]} */ content) => [id, content.length, ...content];
    // A module that exports what it imports.
    const bytes = [
      0, 0x61, 0x73, 0x6d, 1, 0, 0, 0, ...section(1, [1, 0x60, ...types(parameters), ...types(results)]),
      ...section(2, [1, 1, 0x65, 1, 0x66, 0, 0]), ...section(7, [1, 1, 0x66, 0, 0])
    ];
    const {f} = new WebAssembly.Instance(new WebAssembly.Module(new Uint8Array(bytes)), {e: {f: callback}}).exports;
    const table = this.functions.__indirect_function_table;
    const index = table.grow(1);
    table.set(index, f);
    return index;
  }
}

/**
 * @typedef {object} Field
 * @property {string} type
 * @property {string} name
 * @property {number} offset
 * @property {number} count
 */
/**
 * @typedef {object} Layout
 * @property {Object<string, {bytes: number, fields: Field[]}>} structures
 * @property {Object<string, number>} constants
 */

/** What the library says of itself. @param {Instance} instance @returns {Layout} */
function readLayout(instance) {
  const view = instance.view();
  let at = instance.functions.pptam_layout_numbers();
  const number = () => view.getUint16((at += 2) - 2, true);
  /** @type {Layout} */
  const layout = {structures: {}, constants: {}};
  /** @type {Field[]} */
  let fields = [];
  for (const line of instance.text(instance.functions.pptam_layout_text()).trim().split('\n')) {
    const [type, name] = line.split(' ');
    if (type === 'struct') {
      fields = [];
      layout.structures[name] = {bytes: number(), fields};
    } else if (type === 'enumerator') {
      layout.constants[name] = number();
    } else {
      fields.push({type, name, offset: number(), count: number()});
    }
  }
  return layout;
}

/** The library, compiled. */
export class PocketPtam {
  /** @param {WebAssembly.Module} module @param {Instance} instance */
  constructor(module, instance) {
    this.module = module;
    this.instance = instance;
    /** Enumerators of the C interface, PPTAM_... @type {Object<string, number>} */
    this.constants = instance.layout.constants;
    /** @type {string} */
    this.version = instance.text(instance.functions.pptam_version());
  }

  /** @param {BufferSource|WebAssembly.Module} wasm the bytes of the library's file @returns {Promise<PocketPtam>} */
  static async load(wasm) {
    const module = wasm instanceof WebAssembly.Module ? wasm : await WebAssembly.compile(wasm);
    return new PocketPtam(module, new Instance(await WebAssembly.instantiate(module), null));
  }

  /** Whether this engine has vectors, for pocket_ptam_simd.wasm. @returns {boolean} */
  static simd() {  // a function that returns v128.const... i8x16.splat of 0
    return WebAssembly.validate(new Uint8Array(
        [0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 8, 1, 6, 0, 65, 0, 253, 15, 11]));
  }

  /** A few words for the user. @param {number} hint PPTAM_HINT_... @returns {string} */
  hintText(hint) { return this.instance.text(this.instance.functions.pptam_hint_text(hint)); }

  /** Throws unless the calibration is possible. @param {Camera} camera */
  validateCamera(camera) {
    this.instance.briefly(() => this.instance.call('camera_validate', this.instance.put('pptam_camera', camera)));
  }

  /** The 2009 phone's settings. @param {Camera} camera @returns {Config} */
  configPhone(camera) {
    const m = this.instance;
    return m.briefly(() => {
      const config = m.put('pptam_config', {});
      m.call('config_phone', m.put('pptam_camera', camera), config);
      return m.read('pptam_config', config);
    });
  }

  /** Throws unless the configuration is possible. @param {Config} config */
  validateConfig(config) {
    this.instance.briefly(() => this.instance.call('config_validate', this.instance.put('pptam_config', config)));
  }

  /** Bytes of a system's block; 0: the configuration is refused. @param {Config} config @returns {number} */
  requiredBytes(config) {
    const m = this.instance;
    return m.briefly(() => m.functions.pptam_required_bytes(m.put('pptam_config', config)) >>> 0);
  }

  /** @param {Config} config @returns {Promise<System>} */
  async createSystem(config) { return new System(await this.another(), config); }

  /**
   * @param {Camera} camera @param {ObjectModel} model @param {object} [settings] fields of pptam_model_tracker_config
   * other than usual @returns {Promise<ModelTracker>}
   */
  async createModelTracker(camera, model, settings = {}) {
    return new ModelTracker(await this.another(), camera, model, settings);
  }

  /** The header of a saved map. @param {Uint8Array} file @returns {MapInfo} */
  readMapInfo(file) {
    const m = this.instance;
    return m.briefly(() => {
      const at = m.allocate(file.length);
      m.bytes(at, file.length).set(file);
      const info = m.put('pptam_map_info', {});
      m.call('read_map_info', at, file.length, info);
      return m.read('pptam_map_info', info);
    });
  }

  /**
   * The inverse of a pose as trajectories have it. @param {Pose} pose
   * @returns {{position: Float32Array, quaternion_xyzw: Float32Array}}
   */
  inverseAsQuaternion(pose) {
    const m = this.instance;
    return m.briefly(() => {
      const [position, quaternion] = [m.allocate(12), m.allocate(16)];
      m.call('inverse_as_quaternion', m.put('pptam_pose', pose), position, quaternion);
      return {position: m.array('float', position, 3), quaternion_xyzw: m.array('float', quaternion, 4)};
    });
  }

  /** @returns {Promise<Instance>} */
  async another() { return new Instance(await WebAssembly.instantiate(this.module), this.instance.layout); }
}

/** Where a frame's pixels are put for C. */
class FrameRoom {
  /** @param {Instance} instance @param {Camera} camera */
  constructor(instance, camera) {
    this.instance = instance;
    this.camera = camera;
    this.frame = instance.put('pptam_frame', {});
    this.data = 0;
    this.capacity = 0;
  }
  /** @param {Frame} frame @returns {number} */
  put(frame) {
    const m = this.instance;
    if (frame.data.length > this.capacity) {
      this.data = m.allocate(frame.data.length);
      this.capacity = frame.data.length;
    }
    m.bytes(this.data, frame.data.length).set(frame.data);
    const {width = this.camera.width, height = this.camera.height, format = 0, timestamp_ns} = frame;
    const bytes = m.layout.constants;
    const whole = {[bytes.PPTAM_PIXEL_BGRA]: 4, [bytes.PPTAM_PIXEL_RGB24]: 3, [bytes.PPTAM_PIXEL_YUYV]: 2};
    const pixel = whole[format] || 1;
    const {stride_bytes = width* pixel} = frame;
    if (frame.data.length < stride_bytes * (height - 1) + width * pixel)
      throw new PtamError(bytes.PPTAM_INVALID_ARGUMENT, 'Frame.data is shorter than the image');
    return m.write('pptam_frame', this.frame, {data: this.data, width, height, stride_bytes, format, timestamp_ns});
  }
}

/** Tracks and maps: pptam_system. */
export class System {
  /** @param {Instance} instance @param {Config} config */
  constructor(instance, config) {
    const m = this.instance = instance;
    const at = m.put('pptam_config', config);
    m.call('config_validate', at);
    /** Bytes of the library's block. */
    this.bytes = m.functions.pptam_required_bytes(at) >>> 0;
    this.system = m.handle('create', at, m.allocate(this.bytes), this.bytes);
    this.room = new FrameRoom(m, config.camera);
    this.result = m.put('pptam_track_result', {});
  }

  /** @returns {Config} */
  getConfig() {
    const m = this.instance;
    return m.briefly(() => {
      const config = m.put('pptam_config', {});
      m.call('get_config', this.system, config);
      return m.read('pptam_config', config);
    });
  }

  /** For stage_ns. @param {(() => bigint)|null} now_ns */
  setClock(now_ns) {
    const pointer = now_ns ? this.instance.pointer(['i32'], ['i64'], () => now_ns()) : 0;
    this.instance.call('set_clock', this.system, pointer, 0);
  }

  /**
   * What the system does while it does it: PPTAM_SPAN_..., PPTAM_COUNTER_....
   * @param {{begin: (span: number) => void, end: (span: number) => void,
   *   count: (counter: number, value: bigint) => void}|null} tracer
   */
  setTracer(tracer) {
    const m = this.instance;
    if (!tracer) return m.call('set_tracer', this.system, 0);
    const one = (/** @type {(span: number) => void} */ f) => m.pointer(['i32', 'i32'], [], (_, span) => f(span));
    const functions = {
      begin: one((span) => tracer.begin(span)),
      end: one((span) => tracer.end(span)),
      count: m.pointer(['i32', 'i32', 'i64'], [], (_, counter, value) => tracer.count(counter, value)),
    };
    m.briefly(() => m.call('set_tracer', this.system, m.put('pptam_tracer', functions)));
  }

  /** @param {Frame} frame @returns {TrackResult} */
  track(frame) {
    this.instance.call('track', this.system, this.room.put(frame), this.result);
    return this.instance.read('pptam_track_result', this.result);
  }

  /** Of the last frame. @returns {ObservedPoint[]} */
  observedPoints() { return this.instance.list('observed_points', 'pptam_observed_point', this.system); }

  /** @returns {boolean} */
  hasWork() { return this.instance.functions.pptam_has_work(this.system) !== 0; }
  workSlice() { this.instance.call('work_slice', this.system); }

  tap() { this.instance.call('tap', this.system); }
  reset() { this.instance.call('reset', this.system); }
  /** @param {boolean} locked */
  setLocked(locked) { this.instance.call('set_locked', this.system, Number(locked)); }
  /** @returns {boolean} */
  locked() { return this.instance.functions.pptam_locked(this.system) !== 0; }
  /** @param {number} point_a @param {number} point_b @param {number} length */
  setLength(point_a, point_b, length) { this.instance.call('set_length', this.system, point_a, point_b, length); }

  /** @param {ArrayLike<number>} px @returns {Pose} takes old coordinates to new ones */
  setGround(px) {
    const m = this.instance;
    return m.briefly(() => {
      const change = m.put('pptam_pose', {});
      m.call('set_ground', this.system, m.putArray('float', px), change);
      return m.read('pptam_pose', change);
    });
  }

  /**
   * Pixel of a world point at the exposure time of its own line; null: not visible. @param {Pose} T_cw
   * @param {ArrayLike<number>} velocity @param {ArrayLike<number>} p_w @returns {Float32Array|null}
   */
  project(T_cw, velocity, p_w) {
    const m = this.instance;
    return m.briefly(() => {
      const [px, visible] = [m.allocate(8), m.allocate(1)];
      m.call(
          'project', this.system, m.put('pptam_pose', T_cw), m.putArray('float', velocity), m.putArray('float', p_w),
          px, visible);
      return m.view().getUint8(visible) ? m.array('float', px, 2) : null;
    });
  }

  /** The ray (x/z, y/z) of a pixel. @param {ArrayLike<number>} px @returns {Float32Array} */
  unproject(px) {
    const m = this.instance;
    return m.briefly(() => {
      const ray = m.allocate(8);
      m.call('unproject', this.system, m.putArray('float', px), ray);
      return m.array('float', ray, 2);
    });
  }

  // map: TrackResult.map; 0: that in use.
  /** @param {number} [map] @returns {Keyframe[]} */
  keyframes(map = 0) { return this.instance.list('keyframes', 'pptam_keyframe', this.system, map); }
  /** @param {number} [map] @returns {MapPoint[]} */
  mapPoints(map = 0) { return this.instance.list('map_points', 'pptam_map_point', this.system, map); }
  /** @param {number} [map] @returns {Measurement[]} */
  measurements(map = 0) { return this.instance.list('measurements', 'pptam_measurement', this.system, map); }
  /** @param {number} [map] @returns {Plane[]} */
  planes(map = 0) { return this.instance.list('planes', 'pptam_plane', this.system, map); }

  /** @param {number} keyframe_id @returns {{data: Uint8Array, width: number, height: number, stride_bytes: number}} */
  keyframeImage(keyframe_id) {
    const m = this.instance;
    return m.briefly(() => {
      const at = m.put('pptam_image', {});
      m.call('keyframe_image', this.system, keyframe_id, at);
      const image = m.read('pptam_image', at);
      return {...image, data: m.bytes(image.data, image.stride_bytes * (image.height - 1) + image.width).slice()};
    });
  }

  /** @returns {bigint} */
  mapHash() { return BigInt.asUintN(64, this.instance.functions.pptam_map_hash(this.system)); }
  /** @returns {{measurements: number, cost: number}} */
  mapFit() {
    const m = this.instance;
    return m.briefly(() => {
      const [measurements, cost] = [m.allocate(4), m.allocate(4)];
      m.call('map_fit', this.system, measurements, cost);
      return {measurements: m.view().getInt32(measurements, true), cost: m.view().getFloat32(cost, true)};
    });
  }
  /** @param {number} common_points @returns {number} */
  mapParts(common_points) {
    const m = this.instance;
    return m.briefly(() => {
      const parts = m.allocate(4);
      m.call('map_parts', this.system, common_points, parts);
      return m.view().getInt32(parts, true);
    });
  }

  /** Bytes that saveMap() returns now; 0 without a finished map. @returns {number} */
  mapBytes() { return this.instance.functions.pptam_map_bytes(this.system) >>> 0; }
  /** All finished maps. @returns {Uint8Array} */
  saveMap() {
    const m = this.instance;
    return m.briefly(() => {
      const capacity = this.mapBytes();
      const [out, bytes] = [m.allocate(capacity), m.allocate(4)];
      m.call('save_map', this.system, out, capacity, bytes);
      return m.bytes(out, m.view().getUint32(bytes, true)).slice();
    });
  }
  /** Replaces all maps. @param {Uint8Array} file */
  loadMap(file) {
    const m = this.instance;
    m.briefly(() => {
      const at = m.allocate(file.length);
      m.bytes(at, file.length).set(file);
      m.call('load_map', this.system, at, file.length);
    });
  }

  /** @param {number} work PPTAM_WORK_... @returns {bigint} */
  workUnits(work) { return this.instance.functions.pptam_work_units(this.system, work); }
  /** @returns {bigint} */
  workInstructions() { return this.instance.functions.pptam_work_instructions(this.system); }
  /** @returns {bigint} */
  workNs() { return this.instance.functions.pptam_work_ns(this.system); }
}

/** Tracks a known object by its edges: pptam_model_tracker. */
export class ModelTracker {
  /** @param {Instance} instance @param {Camera} camera @param {ObjectModel} model @param {object} settings */
  constructor(instance, camera, model, settings) {
    const m = this.instance = instance;
    const arrays = {outlines_of_smooth: Boolean(model.outlines_of_smooth)};
    const numbers = (/** @type {string} */ name, /** @type {string} */ type, /** @type {number} */ each) => {
      const values = model[name + 's'] || [];
      arrays[name + 's'] = values.length ? m.putArray(type, values) : 0;
      arrays[name + '_count'] = values.length / each;
    };
    numbers('point', 'float', 3);
    numbers('corner', 'int32_t', 1);
    for (const kind of ['line', 'face', 'cylinder', 'circle', 'sphere']) {
      const parts = model[kind + 's'] || [];
      const {bytes} = m.layout.structures['pptam_model_' + kind];
      const at = parts.length ? m.allocate(parts.length * bytes) : 0;
      parts.forEach((part, i) => m.write('pptam_model_' + kind, at + i * bytes, part));
      arrays[kind + 's'] = at;
      arrays[kind + '_count'] = parts.length;
    }
    const given = m.put('pptam_object_arrays', arrays);
    const modelBytes = m.functions.pptam_object_model_required_bytes(given) >>> 0;
    const object = m.handle('object_model_create', given, m.allocate(modelBytes), modelBytes);
    const config = m.put('pptam_model_tracker_config', {});
    m.call('model_tracker_config_usual', m.put('pptam_camera', camera), object, config);
    m.write('pptam_model_tracker_config', config, {...m.read('pptam_model_tracker_config', config), ...settings});
    m.call('model_tracker_config_validate', config);
    this.bytes = m.functions.pptam_model_tracker_required_bytes(config) >>> 0;
    this.tracker = m.handle('model_tracker_create', config, m.allocate(this.bytes), this.bytes);
    this.room = new FrameRoom(m, camera);
    this.result = m.put('pptam_model_result', {});
  }

  /** Near a pose, object to camera. @param {Pose} T_co */
  start(T_co) {
    this.instance.briefly(() => this.instance.call('model_start', this.tracker, this.instance.put('pptam_pose', T_co)));
  }
  /** @param {ArrayLike<number>} points_o x, y, z of each @param {ArrayLike<number>} px x, y of each */
  startFromPoints(points_o, px) {
    const m = this.instance;
    if (points_o.length / 3 !== px.length / 2) throw new TypeError('a pixel is needed for each point');
    m.briefly(
        () => m.call(
            'model_start_from_points', this.tracker, m.putArray('float', points_o), m.putArray('float', px),
            px.length / 2));
  }
  startAnywhere() { this.instance.call('model_start_anywhere', this.tracker); }
  reset() { this.instance.call('model_reset', this.tracker); }

  /** @param {Frame} frame @returns {ModelResult} */
  track(frame) {
    this.instance.call('model_track', this.tracker, this.room.put(frame), this.result);
    return this.instance.read('pptam_model_result', this.result);
  }
  /** Of the last frame. @returns {ModelSite[]} */
  sites() { return this.instance.list('model_sites', 'pptam_model_site', this.tracker); }
}
