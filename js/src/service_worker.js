/**
 * A service worker that answers a .glb with the expanded one, for hosts without a plug-in: model-viewer, CesiumJS, an old viewer.
 *
 *     await expandOnThisPage('/texf_worker.js'); // of 'texf/expand-on-this-page', before the first file is loaded
 *
 * All other requests, files that are not ours, and streams that are refused pass as they are: a host shows their fallbacks, or says what
 * it cannot read.
 */

import {expand} from './expand.js';
import {compiled, inThread} from './in_thread.js';

const worker = /** @type {ServiceWorkerGlobalScope} */ (/** @type {unknown} */ (self));
/** @type {ReturnType<typeof compiled>|null} */
let module = null;

/** @param {Response} response */
async function answered(response) {
  if (!response.ok || response.type === 'opaque') return response;
  const file = await response.clone().arrayBuffer();
  try {
    module ??= compiled();
    const plain = await expand(file, {decoder: inThread(await module)}), headers = new Headers(response.headers);
    if (plain === file) return response;
    ['content-length', 'content-encoding', 'etag'].forEach((name) => headers.delete(name));
    return new Response(plain, {headers});
  } catch (error) {
    const {code = 'internal', message} = /** @type {any} */ (error);
    console.warn(`TEXF_stream: ${new URL(response.url).pathname}: ${code}: ${message}; the file passes as it is`);
    if (code === 'internal') module = null; // the module may not have been there
    return response;
  }
}

worker.addEventListener('install', () => worker.skipWaiting());
worker.addEventListener('activate', (event) => event.waitUntil(worker.clients.claim()));
worker.addEventListener('message', () => worker.clients.claim());
worker.addEventListener('fetch', (event) => {
  const {method, headers, url} = event.request;
  if (method === 'GET' && !headers.has('range') && /\.glb$/i.test(new URL(url).pathname)) event.respondWith(fetch(event.request).then(answered));
});
