/** Starts the service worker of service_worker.js for a page. */

import {TexfError} from './engine.js';

/**
 * Resolves when the service worker answers the requests of this page. Load no .glb before that.
 *
 * @param {string|URL} script a file of the site, above the pages that it serves: import './node_modules/texf/src/service_worker.js';
 * @returns {Promise<void>} rejected with a TexfError if the browser refuses it, as it does on a page without https
 */
export async function expandOnThisPage(script) {
  const place = globalThis.navigator?.serviceWorker;
  if (!place) throw new TexfError('unsupported', 'this page can have no service worker: it needs https or localhost, and a window that is not private');
  const controlled = new Promise((resolve) => {
    place.addEventListener('controllerchange', resolve, {once: true});
  });
  try {
    const {active, scope} = await place.register(script, {type: 'module'});
    if (place.controller) return;
    if (!location.href.startsWith(scope)) throw new Error(`it serves pages below ${scope}`);
    active?.postMessage('claim'); // a page that was reloaded past it
  } catch (error) {
    throw new TexfError('unsupported', `the service worker cannot be used: ${error instanceof Error ? error.message : error}`);
  }
  await controlled;
}
