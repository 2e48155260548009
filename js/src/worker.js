/** A worker of the pool: gets {id, module} and what decodeWith() or blocksOf() takes, answers {id, result} or {id, error}. */

import {blocksOf} from './blocks.js';
import {TexfError, decodeWith} from './engine.js';

/** All buffers of a result, which go to the page without a copy.
 * @param {any} value @param {Set<ArrayBuffer>} buffers */
function buffersOf(value, buffers = new Set()) {
  if (ArrayBuffer.isView(value)) buffers.add(/** @type {ArrayBuffer} */ (value.buffer));
  else if (value && typeof value === 'object') Object.values(value).forEach((part) => buffersOf(part, buffers));
  return buffers;
}

/** @param {any} job @param {(answer: any, transferred: ArrayBuffer[]) => void} answer */
function work({id, module, bytes, level, limits, chosen, picture, format, isColour}, answer) {
  try {
    const result = picture ? blocksOf(module, picture, format, isColour) : decodeWith(module, bytes, level, limits, chosen);
    answer({id, result}, [...buffersOf(result)]);
  } catch (error) {
    const {code, message, details} = error instanceof TexfError ? error : new TexfError('internal', String(error));
    answer({id, error: {code, message, details}}, []);
  }
}

if (typeof self !== 'undefined' && typeof self.postMessage === 'function') {
  self.onmessage = (event) => work(event.data, (answer, transferred) => self.postMessage(answer, {transfer: transferred}));
} else {
  import('node:worker_threads').then(({parentPort}) => parentPort?.on('message', (job) => work(job, (answer, transferred) => parentPort.postMessage(answer, transferred))));
}
