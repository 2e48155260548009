/**
 * TEXF_stream for glTF-Transform: its scripts and commands read GLBs with coded primitives as the ordinary glTF that expand() makes.
 *
 *     import {NodeIO} from '@gltf-transform/core';
 *     import {createDecoder, TEXFStream} from 'texf/gltf-transform';
 *     const io = new NodeIO().registerExtensions([TEXFStream]).registerDependencies({'texf.decoder': await createDecoder()});
 *     const document = await io.read('small.glb');
 *
 * Extensions of glTF-Transform read without waiting, so a thread of node decodes. On a page, where none may be waited for:
 * io.readBinary(new Uint8Array(await expand(file))).
 */

import {Extension, PropertyType} from '@gltf-transform/core';

import {MESHOPT, NAME, placeOf, without} from './accessors.js';
import {isContainer} from './container.js';
import {glbOf, readGlb} from './expand.js';
import {compiled} from './in_thread.js';
import {TexfError} from './index.js';

/** @typedef {{expand: (file: ArrayBuffer) => ArrayBuffer, dispose: () => Promise<unknown>}} SyncDecoder */

const DEPENDENCY = 'texf.decoder', GLB_BUFFER = '@glb.bin', ALIGNMENT = 8; // the second as glTF-Transform names the bytes of a GLB

/**
 * The dependency 'texf.decoder': expand() in a thread of its own, for which the caller's thread waits.
 *
 * @param {{limits?: import('./index.js').Limits, seconds?: number}} [options] limits: what a stream may ask for; seconds: the longest wait for one file
 * @returns {Promise<SyncDecoder>} the thread does not keep node alive
 */
export async function createDecoder({limits = {}, seconds = 600} = {}) {
  if (typeof process === 'undefined' || !process.versions?.node) throw new TexfError('unsupported', 'only node can wait for a decoder: on a page, call expand() and then readBinary()');
  const {MessageChannel, receiveMessageOnPort, Worker} = await import('node:worker_threads'), {port1, port2} = new MessageChannel();
  const flag = new Int32Array(new SharedArrayBuffer(4));
  const worker = new Worker(new URL('./expand_worker.js', import.meta.url), {workerData: {module: await compiled(), flag, port: port2}, transferList: [port2]});
  await new Promise((resolve, reject) => {
    port1.once('message', resolve);
    worker.once('error', reject);
  });
  worker.removeAllListeners('error').on('error', () => {}).unref();
  return {
    expand(file) {
      Atomics.store(flag, 0, 0);
      port1.postMessage({file, limits});
      const state = Atomics.wait(flag, 0, 0, 1000 * seconds), {result, error} = receiveMessageOnPort(port1)?.message ?? {};
      if (result) return result;
      throw error ? new TexfError(error.code, error.message, error.details) : new TexfError('aborted', state === 'timed-out' ? `decoding took longer than ${seconds} s` : 'the decoder has ended');
    },
    dispose: () => worker.terminate(),
  };
}

/** The extension. It expands what is read, and leaves the document, which is written as an ordinary one; texf-enc codes it again. */
export class TEXFStream extends Extension {
  static EXTENSION_NAME = NAME;
  extensionName = NAME;
  prereadTypes = [PropertyType.BUFFER];
  readDependencies = [DEPENDENCY];
  /** @type {SyncDecoder|null} */
  decoder = null;

  /** @param {string} key @param {any} dependency */
  install(key, dependency) {
    if (key === DEPENDENCY) this.decoder = dependency ?? null;
    return this;
  }

  /** @param {import('@gltf-transform/core').ReaderContext} context */
  preread(context) {
    const {jsonDoc} = context, json = /** @type {any} */ (jsonDoc.json);
    if (!isContainer(json)) {
      if (json.scenes?.some((/** @type {any} */ scene) => scene.extensions?.[NAME])) this.document.getLogger().warn(`${NAME}: the stream of a scene is left out; its nodes, a coarse mesh, are read.`);
      return this;
    }
    if (!this.decoder) throw new TexfError('internal', `${NAME} needs registerDependencies({'${DEPENDENCY}': await createDecoder()})`);
    const {root, binary} = readGlb(this.decoder.expand(merged(json, jsonDoc.resources, context.bufferViews))), {buffers} = json;
    buffers.splice(0, buffers.length, ...root.buffers); // the reader holds this array and the tree
    Object.keys(json).forEach((key) => delete json[key]);
    Object.assign(json, root, {buffers});
    jsonDoc.resources[GLB_BUFFER] = new Uint8Array(binary);
    context.bufferViews.length = 0;
    return this;
  }

  read() {
    this.dispose();
    return this;
  }

  write() {
    return this;
  }
}

/**
 * A GLB of a file in parts. External images stay as they are.
 *
 * @param {any} json @param {Object<string, Uint8Array>} resources by URI @param {Uint8Array[]} decoded bytes of bufferViews that another extension has unpacked
 */
function merged(json, resources, decoded) {
  const root = structuredClone(json), pieces = /** @type {[number, Uint8Array][]} */ ([]);
  let length = 0;
  const put = (/** @type {Uint8Array|undefined} */ bytes) => {
    const at = length;
    if (bytes) pieces.push([at, bytes]);
    length += Math.ceil((bytes?.length ?? 0) / ALIGNMENT) * ALIGNMENT;
    return at;
  };
  const starts = (root.buffers ?? []).map((/** @type {any} */ {uri}, /** @type {number} */ n) => put(uri !== undefined ? resources[uri] : n === 0 ? resources[GLB_BUFFER] : undefined));
  (root.bufferViews ?? []).forEach((/** @type {any} */ view, /** @type {number} */ n) => {
    if (decoded[n]) MESHOPT.forEach((name) => without(view, name));
    const place = placeOf(view);
    place.byteOffset = decoded[n] ? put(decoded[n]) : (place.byteOffset ?? 0) + (starts[place.buffer] ?? 0);
    place.buffer = view.buffer = 0;
  });
  root.buffers = [{byteLength: length}];
  return glbOf(root, pieces, length);
}
