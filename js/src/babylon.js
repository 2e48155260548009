/**
 * TEXF_stream for the glTF loader of Babylon.js: coded primitives get their arrays and textures before the loader reads anything.
 *
 *     import {registerGLTFExtension} from '@babylonjs/loaders/glTF/2.0/glTFLoaderExtensionRegistry.js';
 *     import {registerTEXF} from 'texf/babylon';
 *     registerTEXF(registerGLTFExtension); // BABYLON.GLTF2.registerGLTFExtension on a page with scripts
 *     await BABYLON.AppendSceneAsync('small.glb', scene);
 */

import {Added, inflated, NAME, wellFormed} from './accessors.js';
import {Atlas} from './atlas.js';
import {isContainer, unfold} from './container.js';
import {decode} from './index.js';
import {addImages} from './png.js';

const CHANGED = ['accessors', 'bufferViews', 'images', 'materials', 'meshes', 'samplers', 'textures']; // arrays of the tree

/**
 * Registers the extension. Where a stream is refused, fallbacks of its primitives are shown; if one has none, loading is rejected with a TexfError.
 *
 * @param {(name: string, isGLTFExtension: boolean, factory: (loader: any) => Promise<any>) => void} registerGLTFExtension that of Babylon.js
 * @param {{decoder?: {decode: typeof decode}|null, limits?: import('./index.js').Limits, signal?: AbortSignal}} [options]
 */
export function registerTEXF(registerGLTFExtension, {decoder = null, limits = {}, signal} = {}) {
  registerGLTFExtension(NAME, true, async (loader) => {
    const extension = new TEXFStream(loader, (stream) => (decoder ?? {decode}).decode(stream, {limits, signal}));
    await wellFormed(() => extension.begin());
    return extension;
  });
}

/** An extension of a loader, which awaits begin() before it reads the tree. */
class TEXFStream {
  /** @param {any} loader GLTFLoader @param {(stream: Uint8Array) => Promise<import('./index.js').Asset>} decoded */
  constructor(loader, decoded) {
    this.name = NAME;
    this.enabled = true;
    this.order = 0;
    this.loader = loader;
    this.decoded = decoded;
    /** Bytes of bufferViews that were added. @type {Map<number, Uint8Array>} */
    this.views = new Map();
  }

  async begin() {
    const {gltf} = this.loader;
    if (!isContainer(gltf)) return;
    const root = plainTree(gltf), onRefused = (/** @type {any} */ error) => console.warn(`${NAME}: ${error.code ?? 'internal'}: ${error.message}; the fallback is shown`);
    const {views, pictures} = await unfold(root, (number) => this.stored(root.bufferViews[number], number), this.decoded, {Atlas, onRefused});
    const added = new Added(root);
    await addImages(root, added, pictures);
    this.views = new Map([...views, ...added.views]);
    for (const kind of CHANGED.filter((name) => root[name])) gltf[kind] = root[kind].map((/** @type {any} */ entry, /** @type {number} */ index) => Object.assign(entry, {index}));
  }

  /** Bytes of a bufferView of the file. @param {any} view @param {number} number @returns {Promise<Uint8Array>} */
  async stored(view, number) {
    const packed = view.extensions?.[NAME], {buffer, byteOffset, byteLength} = packed ?? view;
    const bytes = await this.loader.loadBufferViewAsync(`/bufferViews/${number}`, {index: number, buffer, byteOffset, byteLength});
    const plain = new Uint8Array(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    return packed ? inflated(plain, view, number) : plain;
  }

  /** A hook of the loader. @param {string} context @param {any} view @returns {Promise<Uint8Array>|null} */
  loadBufferViewAsync(context, view) {
    const bytes = this.views.get(view.index);
    return bytes ? Promise.resolve(bytes) : view.extensions?.[NAME] ? this.stored(view, view.index) : null;
  }

  dispose() {
    this.views.clear();
  }
}

/** The tree of a file without what Babylon.js has added to the entries of its arrays. @param {any} gltf @returns {any} */
function plainTree(gltf) {
  const plain = (/** @type {any} */ entry) => Object.fromEntries(Object.entries(entry).filter(([key]) => !(key === 'index' || key === 'parent' || key.startsWith('_'))));
  return Object.fromEntries(Object.entries(gltf).map(([key, value]) => [key, Array.isArray(value) ? value.map((entry) => (entry && typeof entry === 'object' ? plain(entry) : entry)) : value]));
}
