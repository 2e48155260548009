/** Decoding in the thread that asks, for hosts whose threads start no workers: service workers, and threads that another one waits for. */

import {Decoder} from './index.js';
import {decodeWith} from './engine.js';

/**
 * A decoder for expand(), without a pool.
 *
 * @param {WebAssembly.Module} module what preload() of a Decoder gives
 * @returns {{decode: typeof import('./index.js').decode}}
 */
export const inThread = (module) => ({
  decode: async (stream, {limits = {}} = {}) => decodeWith(module, ArrayBuffer.isView(stream) ? new Uint8Array(stream.buffer, stream.byteOffset, stream.byteLength) : new Uint8Array(stream), 0, limits),
});

/** The compiled module. @param {import('./index.js').ModulePlace} [wasm] where it is, or its bytes; the one beside this file without */
export const compiled = (wasm = null) => new Decoder({workers: 1, wasm}).preload();
