/**
 * Decoding .texf streams in a pool of workers.
 *
 *     import {decode} from 'texf';
 *     const asset = await decode(await (await fetch('scan.texf')).arrayBuffer());
 */

import {ALL, TexfError} from './engine.js';
import {merged, partsOf} from './parts.js';

export {TexfError};
/** @typedef {import('./engine.js').Asset} Asset */
/** @typedef {import('./engine.js').Limits} Limits */

/**
 * @typedef {object} DecodeOptions
 * @property {number} [level] levels of detail that are left out, 0 for none
 * @property {Limits} [limits] what a stream may ask for
 * @property {AbortSignal} [signal] rejects with code 'aborted', and ends the worker that is at it
 * @property {(asset: Asset, level: number) => void} [onLevel] called with a coarse asset as soon as there is one, before the whole
 * @property {number} [coarse] the level of that one, 3 where nothing is said
 */

/** @typedef {{bytes: Uint8Array, level: number, limits: Limits, chosen: number}} Job */
/** @typedef {{picture: import('./pictures.js').Picture, format: import('./blocks.js').BlockFormat, isColour: boolean}} BlockJob */
/** @typedef {string|URL|ArrayBuffer|Uint8Array|null} ModulePlace */

const IN_NODE = typeof process !== 'undefined' && Boolean(process.versions?.node) && typeof window === 'undefined';

/** A pool of workers; a page needs one. */
export class Decoder {
  /**
   * @param {{workers?: number, wasm?: ModulePlace, blocksWasm?: ModulePlace, worker?: string|URL|null, splitBytes?: number}} options
   *   wasm: where the module is, or its bytes; blocksWasm: where blocks.wasm is; worker: where the worker's script is, as one classic script, where a page has bundled it;
   *   splitBytes: with so many bytes of attributes in several units, or texels that take as long, a stream is decoded by all workers that are idle
   */
  constructor({workers = Math.min(4, globalThis.navigator?.hardwareConcurrency ?? 2), wasm = null, blocksWasm = null, worker = null, splitBytes = 65536} = {}) {
    this.limit = Math.max(1, workers);
    this.splitBytes = splitBytes;
    /** Jobs that are not finished, those that wait among them. */
    this.jobs = 0;
    this.wasm = wasm;
    this.blocksWasm = blocksWasm;
    this.worker = worker;
    /** @type {Promise<WebAssembly.Module>|null} */
    this.module = null;
    /** @type {Promise<WebAssembly.Module>|null} */
    this.blocksModule = null;
    /** @type {PoolWorker[]} */
    this.idle = [];
    /** @type {Set<PoolWorker>} */
    this.busy = new Set();
    /** @type {(() => void)[]} */
    this.waiting = [];
    this.life = new AbortController(); // ends with dispose()
  }

  /** Fetches and compiles the module ahead of use. */
  preload() {
    this.module ??= moduleOf('the decoder', this.wasm, moduleHere).catch((error) => {
      this.module = null; // another try may have more luck
      throw error;
    });
    return this.module;
  }

  /**
   * Codes a picture as blocks of a graphics card, with mipmaps, in a worker.
   *
   * @param {import('./pictures.js').Picture} picture whose data go to the worker
   * @param {import('./blocks.js').BlockFormat} format @param {boolean} isColour whether its RGB is sRGB @param {AbortSignal} [signal]
   * @returns {Promise<import('./blocks.js').Blocks>} rejected with a TexfError, also where the browser has no WebAssembly with SIMD
   */
  blocks(picture, format, isColour, signal) {
    this.blocksModule ??= moduleOf('blocks.wasm', this.blocksWasm, () => new URL('./blocks.wasm', import.meta.url)).catch((error) => {
      this.blocksModule = null;
      throw error;
    });
    const stops = AbortSignal.any([this.life.signal, ...(signal ? [signal] : [])]);
    return this.job({picture, format, isColour}, stops, this.blocksModule);
  }

  /** @param {number} workers at most so many from now on */
  setWorkerLimit(workers) {
    this.limit = Math.max(1, workers);
    while (this.idle.length + this.busy.size > this.limit && this.idle.length > 0) this.idle.pop()?.end();
    this.waiting.splice(0).forEach((go) => go()); // there may be room for more than one
    return this;
  }

  /**
   * @param {ArrayBuffer|ArrayBufferView} stream stays as it is
   * @param {DecodeOptions} options
   * @returns {Promise<Asset>} rejected with a TexfError; with a RangeError where an option is none
   */
  async decode(stream, {level = 0, limits = {}, signal, onLevel, coarse = 3} = {}) {
    for (const [name, number] of Object.entries({level, coarse, ...limits}))
      if (!Number.isSafeInteger(number) || number < 0) throw new RangeError(`${name} must be a whole number, 0 or greater, and is ${number}`);
    const bytes = ArrayBuffer.isView(stream) ? new Uint8Array(stream.buffer, stream.byteOffset, stream.byteLength) : new Uint8Array(stream);
    const whole = new AbortController(), stops = AbortSignal.any([this.life.signal, whole.signal, ...(signal ? [signal] : [])]);
    const parts = partsOf(bytes, this.limit - this.jobs, this.splitBytes);
    if (onLevel && coarse > level) {
      this.job({bytes, level: coarse, limits, chosen: ALL}, stops).then((asset) => {
        if (!stops.aborted) onLevel(asset, coarse);
      }, () => {}); // the whole one says what is wrong
    }
    try {
      return merged(await Promise.all(parts.map((chosen) => this.job({bytes, level, limits, chosen}, stops))));
    } finally {
      whole.abort();
    }
  }

  /** Ends all workers; what is not finished is rejected. The next decode() would start others. */
  dispose() {
    this.life.abort(new TexfError('aborted', 'the decoder was disposed of'));
    this.life = new AbortController();
    for (const worker of this.idle.splice(0)) worker.end();
    this.module = this.blocksModule = null;
  }

  /** @param {Job|BlockJob} job @param {AbortSignal} signal @param {Promise<WebAssembly.Module>} modules @returns {Promise<any>} */
  async job(job, signal, modules = this.preload()) {
    this.jobs++;
    try {
      return await this.turnOf(job, signal, modules);
    } finally {
      this.jobs--;
    }
  }

  /** @param {Job|BlockJob} job @param {AbortSignal} signal @param {Promise<WebAssembly.Module>} modules @returns {Promise<any>} */
  async turnOf(job, signal, modules) {
    const module = await unlessAborted(modules, signal);
    while (this.busy.size >= this.limit && !signal.aborted) await this.turn(signal);
    if (signal.aborted) {
      this.waiting.shift()?.(); // the turn may have been this one's
      throw abortedBy(signal);
    }
    const worker = this.idle.pop() ?? new PoolWorker(this.worker), stop = () => worker.fail(abortedBy(signal));
    this.busy.add(worker);
    signal.addEventListener('abort', stop, {once: true});
    try {
      return await worker.run({...job, module});
    } finally {
      signal.removeEventListener('abort', stop);
      this.busy.delete(worker);
      if (worker.alive && this.busy.size + this.idle.length < this.limit) this.idle.push(worker);
      else worker.end();
      this.waiting.shift()?.();
    }
  }

  /** @param {AbortSignal} signal @returns {Promise<void>} */
  turn(signal) {
    return new Promise((resolve) => {
      const go = () => {
        signal.removeEventListener('abort', leave);
        resolve();
      };
      const leave = () => {
        this.waiting = this.waiting.filter((other) => other !== go);
        resolve();
      };
      this.waiting.push(go);
      signal.addEventListener('abort', leave, {once: true});
    });
  }
}

/** @param {AbortSignal} signal */
function abortedBy(signal) {
  return signal.reason instanceof TexfError ? signal.reason : new TexfError('aborted', 'decoding was aborted');
}

/** What a promise gives, unless the signal is aborted first.
 * @template T @param {Promise<T>} promise @param {AbortSignal} signal @returns {Promise<T>} */
function unlessAborted(promise, signal) {
  return new Promise((resolve, reject) => {
    const stop = () => reject(abortedBy(signal));
    if (signal.aborted) stop();
    signal.addEventListener('abort', stop, {once: true});
    promise.then(resolve, reject).finally(() => signal.removeEventListener('abort', stop));
  });
}

/** A worker with at most one job. */
class PoolWorker {
  /** @param {string|URL|null} place of its script, null for the module */
  constructor(place) {
    this.place = place;
    this.alive = true;
    this.count = 0;
    /** @type {any} */
    this.worker = null;
    /** @type {((result: any) => void)|null} */
    this.resolve = null;
    /** @type {((error: Error) => void)|null} */
    this.reject = null;
  }

  async start() {
    if (IN_NODE) {
      const {Worker: NodeWorker} = await import('node:worker_threads');
      if (!this.alive) return; // ended meanwhile
      this.worker = new NodeWorker(new URL('./worker.js', import.meta.url));
      this.worker.unref();
      this.worker.on('message', (/** @type {any} */ answer) => this.answered(answer));
      this.worker.on('error', (/** @type {Error} */ error) => this.fail(new TexfError('internal', error.message)));
    } else {
      this.worker = this.place ? new Worker(this.place) : new Worker(new URL('./worker.js', import.meta.url), {type: 'module'});
      this.worker.onmessage = (/** @type {MessageEvent} */ event) => this.answered(event.data);
      this.worker.onerror = (/** @type {ErrorEvent} */ event) => this.fail(new TexfError('internal', event.message || 'the worker does not start'));
    }
  }

  /** @param {any} job @returns {Promise<any>} */
  run(job) {
    return new Promise((resolve, reject) => {
      this.resolve = resolve;
      this.reject = reject;
      const given = job.picture ? {} : {bytes: new Uint8Array(job.bytes)}; // a copy: slice() of a Buffer is none
      const send = () => {
        if (!this.alive) return;
        if (IN_NODE) this.worker.ref();
        this.worker.postMessage({...job, ...given, id: ++this.count}, [(given.bytes ?? job.picture.data).buffer]);
      };
      if (this.worker) send();
      else this.start().then(send, (error) => this.fail(new TexfError('internal', String(error))));
    });
  }

  /** @param {{id: number, result?: any, error?: {code: any, message: string, details: any}}} answer */
  answered({id, result, error}) {
    if (id !== this.count) return;
    if (IN_NODE) this.worker.unref();
    if (error) this.reject?.(new TexfError(error.code, error.message, error.details));
    else this.resolve?.(result);
    this.resolve = this.reject = null;
  }

  /** @param {Error} error */
  fail(error) {
    this.end();
    this.reject?.(error);
    this.resolve = this.reject = null;
  }

  end() {
    this.alive = false;
    this.worker?.terminate();
  }
}

// (module (func (result v128) (i8x16.splat (i32.const 0))))
const VECTORS = Uint8Array.of(0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 8, 1, 6, 0, 65, 0, 253, 15, 11);

/** The module beside this file that this engine can run: with vectors (SIMD), which browsers have since 2023, or without.
 * Two places in full, because bundlers look for such. */
function moduleHere() {
  return WebAssembly.validate(VECTORS) ? new URL('./texf_simd.wasm', import.meta.url) : new URL('./texf.wasm', import.meta.url);
}

/** @param {string} name @param {ModulePlace} wasm @param {() => URL} usual where it is if wasm is null @returns {Promise<WebAssembly.Module>} */
async function moduleOf(name, wasm, usual) {
  try {
    const bytes = wasm instanceof ArrayBuffer || wasm instanceof Uint8Array ? wasm : await fetched(wasm ?? usual());
    return await WebAssembly.compile(/** @type {BufferSource} */ (bytes)); // whatever MIME type the server says
  } catch (error) {
    throw new TexfError('internal', `${name} cannot be used: ${error instanceof Error ? error.message : error}`);
  }
}

/** @param {string|URL} place @returns {Promise<ArrayBuffer|Uint8Array>} */
async function fetched(place) {
  const url = new URL(place, import.meta.url);
  if (IN_NODE && url.protocol === 'file:') {
    const {readFile} = await import('node:fs/promises');
    return readFile(url);
  }
  const response = await fetch(url);
  if (!response.ok) throw new Error(`the server answers ${response.status}`);
  return response.arrayBuffer();
}

/** @type {Decoder|null} */
let shared = null;

/**
 * Decodes a stream with a pool that all callers share.
 *
 * @param {ArrayBuffer|ArrayBufferView} stream
 * @param {DecodeOptions} [options]
 * @returns {Promise<Asset>}
 */
export function decode(stream, options) {
  shared ??= new Decoder();
  return shared.decode(stream, options);
}

/** Decoder.blocks() by the pool that all callers share. @type {Decoder['blocks']} */
export function blocks(...given) {
  shared ??= new Decoder();
  return shared.blocks(...given);
}

/** Ends the workers of decode(). */
export function dispose() {
  shared?.dispose();
  shared = null;
}
