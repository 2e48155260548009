/**
 * TEXF_stream for the GLTFLoader of three.js: a GLB that carries a .texf stream shows the stream, not the fallback beside it.
 *
 *     import {GLTFLoader} from 'three/addons/loaders/GLTFLoader.js';
 *     import {TEXFStreamExtension} from 'texf/gltf';
 *     const loader = new GLTFLoader().register((parser) => new TEXFStreamExtension(parser));
 *     scene.add((await loader.loadAsync('scan.glb')).scene);
 *
 * The extension is described in docs/guide/TEXF_stream.md of the repository.
 */

import {TexfError, decode} from './index.js';
import {groupOf} from './three.js';

/** @typedef {import('three/addons/loaders/GLTFLoader.js').GLTFParser} GLTFParser */
/** @typedef {import('three/addons/loaders/GLTFLoader.js').GLTFLoaderPlugin} GLTFLoaderPlugin */
/** @typedef {import('three/addons/loaders/GLTFLoader.js').GLTF} GLTF */
/** @typedef {import('three').Group} Group */

/**
 * @typedef {object} StreamOptions
 * @property {{decode: typeof decode}|null} [decoder] a Decoder; the one that all of a page share where nothing is said
 * @property {number} [level] levels of detail that are left out, 0 for none
 * @property {import('./index.js').Limits} [limits] what a stream may ask for; what asks for more is not shown, but its fallback
 * @property {AbortSignal} [signal] leaves decoding, and shows the fallback
 */

/** A plug-in of GLTFLoader. Of a scene whose stream is decoded, the nodes are never loaded; where it is refused, they are shown.
 * @implements {GLTFLoaderPlugin} */
export class TEXFStreamExtension {
  /** @param {GLTFParser} parser @param {StreamOptions} options */
  constructor(parser, {decoder = null, level = 0, limits = {}, signal} = {}) {
    this.name = 'TEXF_stream';
    this.parser = parser;
    this.decoder = decoder ?? {decode};
    this.options = {level, limits, signal};
    /** @type {Map<number, Group>} */
    this.groups = new Map();
  }

  async beforeRoot() {
    /** @type {any[]} */
    const scenes = this.parser.json.scenes ?? [];
    await Promise.all(scenes.map((scene, i) => this.name in (scene.extensions ?? {}) ? this.replace(scene, i) : undefined));
  }

  /** @param {any} scene of the file @param {number} number */
  async replace(scene, number) {
    try {
      const view = scene.extensions[this.name]?.bufferView;
      if (!this.parser.json.bufferViews?.[view]) throw new TexfError('invalid', 'the extension names no bufferView of the file');
      const stream = await this.parser.getDependency('bufferView', view);
      this.groups.set(number, groupOf(await this.decoder.decode(stream, this.options)));
      scene.nodes = [];
    } catch (error) {
      const {code, message} = error instanceof TexfError ? error : {code: 'internal', message: String(error)};
      console.warn(`${this.name}: ${code}: ${message}; the fallback is shown`);
    }
  }

  /** @param {GLTF} gltf */
  async afterRoot(gltf) {
    this.groups.forEach((group, number) => gltf.scenes[number].add(group));
  }
}
