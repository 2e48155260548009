// Streams are decoded in the page, by a worker that runs the page's own script; it ends with its one stream.

import { decodeWith, TexfError } from './engine.js';
import { headerOfStream } from './stream_header.js';

const SIGNATURE = [0x89, 0x54, 0x58, 0x46, 0x0d, 0x0a, 0x1a, 0x0a];
const STAYS_OUT = 'The decoder does not start: this browser allows the page no worker or no WebAssembly.';

/** Whether this script runs in a worker, which draws nothing. */
export const IS_WORKER = typeof document === 'undefined';

/** Whether bytes (Uint8Array) begin as a stream does. */
export function isStream(bytes) {
  return SIGNATURE.every((byte, i) => bytes[i] === byte);
}

export class StreamDecoder {
  /** script: { place, type }, where the page's script is and of which type a worker takes it; wasm: function that promises an ArrayBuffer of texf.wasm; limits: of engine.js. */
  constructor(script, wasm, limits) {
    Object.assign(this, { script, wasm, limits, module: null });
  }

  /** The header (stream_header.js) of a stream's bytes (ArrayBuffer). Throws a TexfError, or what kept the worker from it. */
  async headerOf(bytes, name) {
    this.module ??= this.wasm().then((wasm) => WebAssembly.compile(wasm));
    const module = await this.module.catch((error) => {
      this.module = null;
      throw error;
    });
    const worker = new Worker(this.script.place, { type: this.script.type });
    try {
      const { header, error } = await new Promise((resolve, reject) => {
        worker.onmessage = ({ data }) => resolve(data);
        worker.onerror = ({ message }) => reject(new Error(message || STAYS_OUT));
        worker.postMessage({ module, bytes, name, limits: this.limits });
      });
      if (error) throw new TexfError(error.code, error.message);
      return header;
    } finally {
      worker.terminate();
    }
  }
}

/** The worker's side: answers a message with a header, or with what is wrong with its stream. */
export function decodeForThePage() {
  self.onmessage = ({ data: { module, bytes, name, limits } }) => {
    try {
      const asset = decodeWith(module, new Uint8Array(bytes), 0, limits), header = headerOfStream(asset, name, bytes.byteLength);
      self.postMessage({ header }, { transfer: [...buffersOf(header)] });
    } catch (error) {
      self.postMessage({ error: { code: error.code ?? 'internal', message: error.message } });
    }
  };
}

function buffersOf(node, found = new Set()) {
  if (ArrayBuffer.isView(node)) found.add(node.buffer);
  else if (node && typeof node === 'object') Object.values(node).forEach((one) => buffersOf(one, found));
  return found;
}
