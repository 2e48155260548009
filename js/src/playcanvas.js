/**
 * TEXF_stream for PlayCanvas: assets of type "container" may be GLBs with coded primitives.
 *
 *     import {addTEXF} from 'texf/playcanvas';
 *     addTEXF(app); // once, before assets are loaded
 *     app.assets.loadFromUrl('small.glb', 'container', (error, asset) => app.root.addChild(asset.resource.instantiateRenderEntity()));
 */

import {NAME} from './accessors.js';
import {expand, readGlb} from './expand.js';

/**
 * Adds a parser of containers to an app. Where a stream is refused, the file's fallbacks are shown; if it requires the extension, the
 * asset's error is a TexfError.
 *
 * @param {any} app AppBase of PlayCanvas 2.23 or newer
 * @param {{decoder?: {decode: typeof import('./index.js').decode}|null, limits?: import('./index.js').Limits}} [options]
 */
export function addTEXF(app, options = {}) {
  const handler = app.loader.getHandler('container'), usual = handler.parsers[0];
  handler.addParser({
    canParse: (/** @type {any} */ {ext}) => ext === 'glb',
    load(/** @type {any} */ url, /** @type {(error: unknown, resource?: unknown) => void} */ callback, /** @type {any} */ asset) {
      handler.fetch(url, 'arraybuffer', async (/** @type {unknown} */ error, /** @type {ArrayBuffer} */ file) => {
        try {
          if (error) throw error;
          parse(usual, url, await expand(file, options).catch((refusal) => fallback(file, refusal)), callback, asset);
        } catch (refusal) {
          callback(refusal);
        }
      }, asset);
    },
    open: (/** @type {any[]} */ ...given) => usual.open(...given),
  });
}

/** Hands a file to the usual parser, which takes the bytes from the asset. @param {any} usual @param {any} url @param {ArrayBuffer} file
 * @param {(error: unknown, resource?: unknown) => void} callback @param {any} asset */
function parse(usual, url, file, callback, asset) {
  const {contents} = asset.file;
  asset.file.contents = file;
  usual.load(url, (/** @type {unknown} */ error, /** @type {unknown} */ resource) => {
    asset.file.contents = contents;
    callback(error, resource);
  }, asset);
}

/** The file itself if it shows something without the extension. @param {ArrayBuffer} file @param {any} refusal */
function fallback(file, refusal) {
  if (readGlb(file).root.extensionsRequired?.includes(NAME)) throw refusal;
  console.warn(`${NAME}: ${refusal.code}: ${refusal.message}; the fallback is shown`);
  return file;
}
