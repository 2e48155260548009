/**
 * TEXF_stream for the GLTFLoader of three.js: a GLB that carries a .texf stream shows the stream, not the fallback beside it, and a
 * GLB whose primitives are coded shows them with their skins, targets and animations.
 *
 *     import {GLTFLoader} from 'three/addons/loaders/GLTFLoader.js';
 *     import {TEXFStreamExtension} from 'texf/gltf';
 *     const loader = new GLTFLoader().register((parser) => new TEXFStreamExtension(parser));
 *     scene.add((await loader.loadAsync('scan.glb')).scene);
 *
 * For any other host, expand() makes an ordinary GLB of the latter, without three.js. The extension is described in
 * docs/guide/TEXF_stream.md of the repository.
 */

import {inflated, NAME, wellFormed, within} from './accessors.js';
import {isContainer, isEmpty, PLACE, unfold} from './container.js';
import {TexfError, blocks, decode} from './index.js';

export {expand} from './expand.js';
/** @typedef {import('three/addons/loaders/GLTFLoader.js').GLTFParser} GLTFParser */
/** @typedef {import('three/addons/loaders/GLTFLoader.js').GLTFLoaderPlugin} GLTFLoaderPlugin */
/** @typedef {import('three/addons/loaders/GLTFLoader.js').GLTF} GLTF */
/** @typedef {import('three').Group} Group */

/**
 * @typedef {object} StreamOptions
 * @property {{decode: typeof decode, blocks: typeof blocks}|null} [decoder] a Decoder; the one that all of a page share where nothing is said
 * @property {number} [level] levels of detail that are left out, 0 for none
 * @property {import('./index.js').Limits} [limits] what a stream may ask for; what asks for more is not shown, but its fallback
 * @property {AbortSignal} [signal] leaves decoding, and shows the fallback
 * @property {import('three').WebGLRenderer|null} [renderer] whose card keeps textures of texels compressed, as TEXFLoader.detectSupport() says
 */

/** Says that a stream is not shown. @param {unknown} error */
function refused(error) {
  const {code, message} = error instanceof TexfError ? error : {code: 'internal', message: String(error)};
  console.warn(`${NAME}: ${code}: ${message}; the fallback is shown`);
}

/**
 * A plug-in of GLTFLoader. Of a scene whose stream is decoded, the nodes are never loaded; where it is refused, they are shown. Where a
 * stream of coded primitives is refused, their fallbacks are shown; if one has none, the file is refused with a TexfError.
 * @implements {GLTFLoaderPlugin}
 */
export class TEXFStreamExtension {
  /** @param {GLTFParser} parser @param {StreamOptions} options */
  constructor(parser, {decoder = null, level = 0, limits = {}, signal, renderer = null} = {}) {
    this.name = NAME;
    this.parser = parser;
    this.decoder = decoder ?? {decode, blocks};
    this.renderer = renderer;
    /** @type {import('./blocks.js').BlockFormat|null} */
    this.blockFormat = null;
    this.options = {level, limits, signal};
    /** @type {Map<number, Group>} */
    this.groups = new Map();
    /** What coded primitives became. @type {import('./container.js').Unfolded|null} */
    this.unfolded = null;
    /** @type {Map<import('./index.js').Asset, import('./three.js').TextureCache>} */
    this.tables = new Map();
    /** @type {typeof import('./three.js')|null} */
    this.three = null;
  }

  async beforeRoot() {
    const {json} = this.parser, scenes = /** @type {any[]} */ (json.scenes ?? []);
    const carrying = scenes.flatMap((scene, i) => (this.name in (scene.extensions ?? {}) ? [i] : []));
    if (!carrying.length && !isContainer(json)) return;
    this.three = await import('./three.js'); // which expand() does without
    this.blockFormat = this.renderer && this.three.blockFormatOf(this.renderer);
    await Promise.all(carrying.map((i) => this.replace(scenes[i], i)));
    if (isContainer(json)) this.unfolded = await wellFormed(() => unfold(json, (number) => this.view(number), (stream) => this.decoder.decode(stream, this.options), {onRefused: refused}));
  }

  /** @param {any} scene of the file @param {number} number */
  async replace(scene, number) {
    try {
      const view = scene.extensions[this.name]?.bufferView;
      if (!this.parser.json.bufferViews?.[view]) throw new TexfError('invalid', 'the extension names no bufferView of the file');
      const stream = await this.parser.getDependency('bufferView', view);
      const three = /** @type {typeof import('./three.js')} */ (this.three), asset = await this.decoder.decode(stream, this.options);
      const coded = this.blockFormat ? await three.compressed(asset, this.decoder, this.blockFormat, this.options.signal) : undefined;
      this.groups.set(number, three.groupOf(asset, coded));
      scene.nodes = [];
    } catch (error) {
      refused(error);
    }
  }

  /** @param {number} number @returns {Promise<Uint8Array>} */
  async view(number) {
    return new Uint8Array(await this.parser.getDependency('bufferView', number));
  }

  /** A bufferView that is stored deflated, or that holds what was decoded; null for all others.
   * @param {number} index @returns {Promise<ArrayBuffer>|null} */
  loadBufferView(index) {
    const view = this.parser.json.bufferViews[index], added = this.unfolded?.views.get(index), packed = view.extensions?.[this.name];
    if (added) return Promise.resolve(/** @type {ArrayBuffer} */ (added.buffer));
    if (!packed) return null;
    return this.parser.getDependency('buffer', packed.buffer)
      .then(async (/** @type {ArrayBuffer} */ buffer) => /** @type {ArrayBuffer} */ ((await inflated(within(new Uint8Array(buffer), packed, index), view, index)).buffer));
  }

  /** A picture of a field over texels; no texture, but a promise, for slots that a field over voxels fills; null for all others.
   * @param {number} index @returns {Promise<import('three').Texture>|null} */
  loadTexture(index) {
    const {json} = this.parser, picture = this.unfolded?.pictures.get(index);
    if (!this.three || !this.unfolded || (!picture && !isEmpty(json, index))) return null;
    if (!picture) return Promise.resolve(/** @type {any} */ (null));
    const {three, blockFormat} = this, sampler = three.samplerOf(json.samplers[json.textures[index].sampler]);
    const texture = blockFormat && !('minFilter' in sampler) // texels that are to be seen as squares stay as they are
      ? three.compressedTexture(picture, picture.isColour, this.decoder, blockFormat, this.options.signal) : Promise.resolve(three.pictureTexture(picture));
    return texture.then((image) => {
      this.parser.associations.set(Object.assign(image, sampler), {textures: index});
      return image;
    });
  }

  /** A material that shows a field over voxels; null for all others.
   * @param {number} index @returns {Promise<import('three').Material>|null} */
  loadMaterial(index) {
    const {three} = this, look = this.unfolded?.voxels.get(index);
    if (!look || !three) return null;
    const known = this.tables.get(look.asset) ?? new three.TextureCache();
    this.tables.set(look.asset, known);
    return this.parser.loadMaterial(index).then((/** @type {import('three').Material} */ material) => three.overVoxels(material, look, PLACE.toLowerCase(), known));
  }

  /** @param {GLTF} gltf */
  async afterRoot(gltf) {
    this.groups.forEach((group, number) => gltf.scenes[number].add(group));
  }
}
