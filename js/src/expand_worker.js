/** The thread of createDecoder() of gltf_transform.js: expands a GLB while the thread that sent it waits. */

import {workerData} from 'node:worker_threads';

import {TexfError} from './engine.js';
import {expand} from './expand.js';
import {inThread} from './in_thread.js';

const {module, flag, port} = workerData, decoder = inThread(module);

port.on('message', async (/** @type {{file: ArrayBuffer, limits: import('./index.js').Limits}} */ {file, limits}) => {
  try {
    const result = await expand(file, {decoder, limits});
    port.postMessage({result}, [result]);
  } catch (error) {
    const {code, message, details} = error instanceof TexfError ? error : new TexfError('internal', String(error));
    port.postMessage({error: {code, message, details}});
  }
  Atomics.store(flag, 0, 1);
  Atomics.notify(flag, 0);
});
port.postMessage({});
