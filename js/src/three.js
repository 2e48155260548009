/**
 * TEXFLoader: .texf streams for three.js.
 *
 *     import {TEXFLoader} from 'texf/three';
 *     scene.add(await new TEXFLoader().loadAsync('scan.texf'));
 *
 * Fields over texels become textures with mipmaps, whose colours are filtered in linear light, as those of a GLB are. Fields over
 * voxels become bricks in textures, which the fragment shader asks; a 3DNTC stream is evaluated there.
 */

import {
  BufferAttribute, BufferGeometry, ClampToEdgeWrapping, Color, CompressedTexture, DataTexture, DoubleSide, FileLoader, FrontSide, Group,
  LinearFilter, LinearMipmapLinearFilter, LinearSRGBColorSpace, Loader, Matrix3, Matrix4, Mesh, MeshBasicMaterial, MeshPhysicalMaterial,
  MeshStandardMaterial, MirroredRepeatWrapping, NearestFilter, NoColorSpace, RepeatWrapping, RGBA_ASTC_4x4_Format, RGBA_BPTC_Format, RGBAFormat, RGIntegerFormat,
  ShaderChunk, SRGBColorSpace, UnsignedByteType,
} from 'three';

import {BITS_GLSL, LEVELS_GLSL, lookUpGlsl} from './glsl_voxels.js';
import {Decoder, TexfError} from './index.js';
import {componentsOf, interleaved, pictureOf} from './pictures.js';
import {bricksOf, levelsOf, lookUpOf, pyramidOf} from './supports.js';
import {inverseTranspose} from './surface.js';
import {networkOf} from './three_neural.js';
import {PLACE_GLSL, tableTexture} from './three_tables.js';

/** @typedef {import('./index.js').Asset} Asset */
/** @typedef {import('./engine.js').Field} Field */
/** @typedef {import('./engine.js').Material} Material */
/** @typedef {import('./engine.js').Plane} Plane */
/** @typedef {import('./pictures.js').Picture} Picture */
/** @typedef {import('./blocks.js').Blocks} Blocks */
/** @typedef {import('./blocks.js').BlockFormat} BlockFormat */

const WRAPS = {repeat: RepeatWrapping, clamp: ClampToEdgeWrapping, mirror: MirroredRepeatWrapping};

export class TEXFLoader extends Loader {
  /** @param {import('three').LoadingManager} [manager] */
  constructor(manager) {
    super(manager);
    this.decoder = new Decoder();
    this.level = 0;
    /** @type {import('./index.js').Limits} */
    this.limits = {};
    /** @type {((group: Group, level: number) => void)|null} */
    this.onLevel = null;
    this.control = new AbortController();
    /** @type {BlockFormat|null} */
    this.blockFormat = null;
  }

  /**
   * From now on textures of texels are kept compressed where the renderer's card can: as BC7, else as ASTC, a quarter of their bytes.
   * @param {import('three').WebGLRenderer} renderer
   */
  detectSupport(renderer) {
    this.blockFormat = blockFormatOf(renderer);
    return this;
  }

  /** @param {import('./index.js').ModulePlace} wasm where blocks.wasm is, in place of beside the module */
  setBlocksPath(wasm) {
    this.decoder.blocksWasm = wasm;
    this.decoder.blocksModule = null;
    return this;
  }

  /** @param {string|URL|ArrayBuffer|Uint8Array} wasm where texf.wasm is, in place of beside the module */
  setDecoderPath(wasm) {
    this.decoder.wasm = wasm;
    this.decoder.module = null;
    return this;
  }

  /** @param {string|URL} worker where the worker's script is, as one classic script, where a page has bundled it */
  setWorkerPath(worker) {
    this.decoder.worker = worker;
    return this;
  }

  /** @param {number} limit */
  setWorkerLimit(limit) {
    this.decoder.setWorkerLimit(limit);
    return this;
  }

  /** @param {import('./index.js').Limits} limits what a stream may ask for */
  setLimits(limits) {
    this.limits = limits;
    return this;
  }

  /** @param {number} level levels of detail that are left out */
  setLevel(level) {
    this.level = level;
    return this;
  }

  /** @param {(group: Group, level: number) => void} onLevel gets a coarse group before the whole one; who takes it disposes of it */
  setOnLevel(onLevel) {
    this.onLevel = onLevel;
    return this;
  }

  preload() {
    this.decoder.preload().catch(() => {}); // the load that needs it says what is wrong
    return this;
  }

  /**
   * @param {string} url
   * @param {(group: Group) => void} onLoad
   * @param {(event: ProgressEvent) => void} [onProgress]
   * @param {(error: unknown) => void} [onError]
   */
  load(url, onLoad, onProgress, onError) {
    const loader = new FileLoader(this.manager);
    loader.setPath(this.path);
    loader.setResponseType('arraybuffer');
    loader.setRequestHeader(this.requestHeader);
    loader.setWithCredentials(this.withCredentials);
    const failed = onError ?? ((/** @type {unknown} */ error) => console.error(error)), {signal} = this.control;
    const stop = () => /** @type {any} */ (loader).abort?.(); // three.js r179 or later
    signal.addEventListener('abort', stop, {once: true});
    loader.load(url, (data) => {
      signal.removeEventListener('abort', stop);
      this.manager.itemStart(url);
      this.decoded(/** @type {ArrayBuffer} */ (data), signal).then(onLoad).catch((error) => {
        failed(error);
        this.manager.itemError(url);
      }).finally(() => this.manager.itemEnd(url));
    }, onProgress, (error) => {
      signal.removeEventListener('abort', stop);
      failed(notFetched(url, error, signal));
    });
  }

  /**
   * @param {ArrayBuffer|Uint8Array} data
   * @param {(group: Group) => void} onLoad
   * @param {(error: unknown) => void} [onError]
   */
  parse(data, onLoad, onError = (error) => console.error(error)) {
    this.parseAsync(data).then(onLoad, onError);
  }

  /** @param {ArrayBuffer|Uint8Array} data @returns {Promise<Group>} */
  parseAsync(data) {
    return this.decoded(data, this.control.signal);
  }

  /** @param {ArrayBuffer|Uint8Array} data @param {AbortSignal} signal @returns {Promise<Group>} */
  async decoded(data, signal) {
    const onLevel = this.onLevel;
    const asset = await this.decoder.decode(data, {level: this.level, limits: this.limits, signal,
      onLevel: onLevel ? (coarse, level) => onLevel(groupOf(coarse), level) : undefined});
    return groupOf(asset, this.blockFormat ? await compressed(asset, this.decoder, this.blockFormat, signal) : undefined);
  }

  /** Rejects what is being fetched or decoded. */
  abort() {
    this.control.abort();
    this.control = new AbortController();
    return this;
  }

  /** Rejects what is not finished and ends all workers. */
  dispose() {
    this.abort();
    this.decoder.dispose();
    return this;
  }
}

/** @param {string} url @param {unknown} error @param {AbortSignal} signal */
function notFetched(url, error, signal) {
  if (signal.aborted || (/** @type {any} */ (error))?.name === 'AbortError') return new TexfError('aborted', 'loading was aborted');
  const failure = new TexfError('network', `${url} cannot be fetched: ${error instanceof Error ? error.message : error}`);
  failure.cause = error;
  return failure;
}

export {TexfError};

/** Frees the geometries, textures and materials of a group.
 * @param {Group} group */
export function disposeGroup(group) {
  group.traverse((object) => {
    const mesh = /** @type {any} */ (object);
    mesh.geometry?.dispose();
    mesh.material?.dispose();
  });
  for (const texture of group.userData.textures ?? []) texture.dispose();
  group.userData.textures = [];
}

/**
 * What three.js shows of a decoded asset.
 *
 * @param {Asset} asset
 * @param {Map<string, Blocks>} [blocks] of textures of texels, by compressed(); the others are RGBA
 * @returns {Group} with a mesh for every geometry unit; `position` is the origin of the asset
 */
export function groupOf(asset, blocks = new Map()) {
  const group = new Group(), textures = new TextureCache();
  group.position.fromArray(asset.origin);
  group.userData = {metadata: asset.metadata, textures: textures.created, isNeural: asset.neural !== null,
    fields: asset.fields.map(({planar, resolution, width, height, keys}) => ({planar, size: planar ? [width, height] : [resolution], cells: keys.length}))};
  for (const unit of asset.units) {
    const material = asset.materials[unit.material], field = asset.fields[unit.field];
    const mesh = new Mesh(geometryOf(unit), materialOf(material));
    mesh.name = material.name;
    mesh.userData.field = unit.field;
    mesh.material.userData.channels = mapsOf(mesh.material, material, field).flatMap(([, channels]) => channels.filter((name, k) => name && channels.indexOf(name) === k));
    common(mesh.material, material);
    if (field.planar) texelMaps(/** @type {any} */ (mesh.material), material, field, unit.field, textures, blocks);
    else voxelMaps(/** @type {any} */ (mesh.material), material, field, unit.field, asset, textures);
    group.add(mesh);
  }
  return group;
}

/** A vertex stands there once for every normal that its corners have.
 * @param {import('./engine.js').Unit} unit */
function geometryOf({positions, indices, normals, uvs}) {
  const count = positions.length / 3, next = new Int32Array(indices.length + count).fill(-1), seen = new Int32Array(count).fill(-1);
  const index = new Uint32Array(indices.length), vertex = /** @type {number[]} */ ([]), corner = /** @type {number[]} */ ([]);
  for (let i = 0; i < indices.length; i++) {
    const v = indices[i];
    let twin = seen[v];
    const same = (/** @type {number} */ a) => normals[3 * corner[a]] === normals[3 * i] && normals[3 * corner[a] + 1] === normals[3 * i + 1]
      && normals[3 * corner[a] + 2] === normals[3 * i + 2];
    while (twin >= 0 && !same(twin)) twin = next[twin];
    if (twin < 0) {
      twin = vertex.length;
      next[twin] = seen[v];
      seen[v] = twin;
      vertex.push(v);
      corner.push(i);
    }
    index[i] = twin;
  }
  const gathered = (/** @type {Float32Array} */ from, /** @type {number[]} */ places, /** @type {number} */ size) => {
    const out = new Float32Array(places.length * size);
    places.forEach((place, i) => out.set(from.subarray(size * place, size * place + size), size * i));
    return new BufferAttribute(out, size);
  };
  const geometry = new BufferGeometry();
  geometry.setAttribute('position', gathered(positions, vertex, 3));
  geometry.setAttribute('normal', gathered(normals, corner, 3));
  if (uvs) geometry.setAttribute('uv', gathered(uvs, vertex, 2));
  geometry.setIndex(new BufferAttribute(vertex.length < 65535 ? Uint16Array.from(index) : index, 1)); // 65535 begins a new strip
  return geometry;
}

// ---- Materials (8.5)

/**
 * Which of our channels each map of three.js holds, in red, green, blue and alpha, and whether it is a colour.
 * @type {[string, (string|null)[], boolean?][]}
 */
export const CHANNEL_MAPS = [
  ['map', ['base_colour', 'base_colour', 'base_colour', 'alpha'], true],
  ['normalMap', ['normal', 'normal']],
  ['aoMap', ['occlusion']],
  ['roughnessMap', [null, 'roughness']],
  ['metalnessMap', [null, null, 'metallic']],
  ['emissiveMap', ['emissive', 'emissive', 'emissive'], true],
  ['clearcoatMap', ['clearcoat']],
  ['clearcoatRoughnessMap', [null, 'clearcoat_roughness']],
  ['clearcoatNormalMap', ['clearcoat_normal', 'clearcoat_normal']],
  ['sheenColorMap', ['sheen_colour', 'sheen_colour', 'sheen_colour'], true],
  ['sheenRoughnessMap', [null, null, null, 'sheen_roughness']],
  ['specularIntensityMap', [null, null, null, 'specular']],
  ['specularColorMap', ['specular_colour', 'specular_colour', 'specular_colour'], true],
  ['transmissionMap', ['transmission']],
  ['thicknessMap', [null, 'thickness']],
  ['iridescenceMap', ['iridescence']],
  ['iridescenceThicknessMap', [null, 'iridescence_thickness']],
  ['anisotropyMap', ['anisotropy', 'anisotropy', 'anisotropy']],
];
const STANDARD = ['map', 'normalMap', 'aoMap', 'roughnessMap', 'metalnessMap', 'emissiveMap']; // the others are of physical materials
const PHYSICAL = /** @type {const} */ ({
  clearcoat: 'clearcoat', clearcoat_roughness: 'clearcoatRoughness', sheen_roughness: 'sheenRoughness', specular: 'specularIntensity',
  transmission: 'transmission', thickness: 'thickness', attenuation_distance: 'attenuationDistance', iridescence: 'iridescence',
  iridescence_ior: 'iridescenceIOR', anisotropy: 'anisotropy', anisotropy_rotation: 'anisotropyRotation', ior: 'ior', dispersion: 'dispersion',
});
const PHYSICAL_COLOURS = /** @type {const} */ ({sheen_colour: 'sheenColor', specular_colour: 'specularColor', attenuation_colour: 'attenuationColor'});

/** @param {any} to @param {Material} from */
function common(to, from) {
  to.name = from.name;
  to.side = from.doubleSided ? DoubleSide : FrontSide;
  to.transparent = from.alphaMode === 'BLEND';
  to.depthWrite = from.alphaMode !== 'BLEND';
  to.alphaTest = from.alphaMode === 'MASK' ? from.alphaCutoff : 0;
}

/** @param {Material} material */
const materialOf = (material) => (material.unlit ? new MeshBasicMaterial() : standardMaterial(material));

/** @param {Material} material */
function standardMaterial(material) {
  const {parameters} = material, number = (/** @type {string} */ name, /** @type {number} */ otherwise) => parameters[name]?.[0] ?? otherwise;
  const names = [...Object.keys(PHYSICAL), ...Object.keys(PHYSICAL_COLOURS)];
  const physical = names.some((name) => name in parameters || material.channels.includes(name));
  const standard = physical ? new MeshPhysicalMaterial() : new MeshStandardMaterial();
  const colour = (/** @type {string} */ name) => new Color().setRGB(.../** @type {[number, number, number]} */ (parameters[name] ?? [0, 0, 0]), LinearSRGBColorSpace);
  standard.roughness = number('roughness', 1);
  standard.metalness = number('metallic', 1);
  standard.aoMapIntensity = number('occlusion_strength', 1);
  standard.emissive = colour('emissive');
  standard.emissiveIntensity = number('emissive_strength', 1);
  if (standard instanceof MeshPhysicalMaterial) {
    for (const [name, property] of Object.entries(PHYSICAL)) if (name in parameters) /** @type {any} */ (standard)[property] = parameters[name][0];
    for (const [name, property] of Object.entries(PHYSICAL_COLOURS)) if (name in parameters) /** @type {any} */ (standard)[property] = colour(name);
    if ('sheen_colour' in parameters) standard.sheen = 1;
    standard.iridescenceThicknessRange = [number('iridescence_thickness_minimum', 100), number('iridescence_thickness_maximum', 400)];
  }
  return standard;
}

/** The maps that a material has of a field, of those that its kind of material takes; normals over voxels are deviations in object space.
 * @param {any} to @param {Material} material @param {Field} field @returns {[string, (string|null)[], boolean][]} */
function mapsOf(to, material, {planar, planes}) {
  const has = (/** @type {string} */ name) => name in planes && (name === 'base_colour' || name === 'alpha' || material.channels.includes(name.replace('_object', '')));
  const taken = to instanceof MeshPhysicalMaterial ? null : to instanceof MeshBasicMaterial ? ['map'] : STANDARD;
  return CHANNEL_MAPS.filter(([property]) => !taken || taken.includes(property)).map(([property, channels, isColour = false]) => {
    const four = !planar && property.endsWith('ormalMap') ? Array(3).fill(`${channels[0]}_object`) : channels;
    return /** @type {[string, (string|null)[], boolean]} */ ([property, four.map((name) => (name && has(name) ? name : null)), isColour]);
  }).filter(([, four]) => four.some(Boolean));
}

/** Textures of a stream, by what they show. */
export class TextureCache {
  constructor() {
    /** @type {import('three').Texture[]} */
    this.created = [];
    /** @type {Map<string, any>} */
    this.known = new Map();
  }

  /** @template T @param {string} key @param {() => T} make @returns {T} */
  get(key, make) {
    if (!this.known.has(key)) {
      const value = /** @type {any} */ (make());
      this.known.set(key, value);
      if (value?.isTexture) this.created.push(value);
    }
    return this.known.get(key);
  }
}

// ---- Texels

/** @typedef {{key: string, properties: string[], channels: (string|null)[], isColour: boolean}} TexelTexture */

/**
 * The textures of a material over texels. Maps of data of the same size share one where their components differ, as glTF's occlusion,
 * roughness and metallic do; normals do not, because their blue is computed, nor does alpha, which blocks would then code with the rest.
 * @param {any} to @param {Material} material @param {Field} field @param {number} number @returns {TexelTexture[]}
 */
function texelTextures(to, material, field, number) {
  const textures = /** @type {Omit<TexelTexture, 'key'>[]} */ ([]), all = mapsOf(to, material, field);
  const sizeOf = (/** @type {(string|null)[]} */ channels) => field.planes[channels.find(Boolean) ?? ''].image?.width;
  const isAlone = (/** @type {{channels: (string|null)[], isColour: boolean}} */ {channels, isColour}) => isColour || channels[3] || channels[0]?.endsWith('normal');
  for (const [property, channels, isColour] of all) {
    const other = isAlone({channels, isColour}) ? undefined : textures.find((texture) => !isAlone(texture)
      && sizeOf(texture.channels) === sizeOf(channels) && channels.every((name, k) => !name || !texture.channels[k]));
    if (other) [other.properties, other.channels] = [[...other.properties, property], [0, 1, 2, 3].map((k) => other.channels[k] ?? channels[k] ?? null)];
    else textures.push({properties: [property], channels, isColour});
  }
  return textures.map((texture) => ({...texture, key: `${number} ${texture.channels} ${texture.isColour}`}));
}

/** pictureOf(), and of one that is the same everywhere one texel. @param {Field} field @param {(string|null)[]} channels @returns {Picture|null} */
function smallPicture(field, channels) {
  const picture = pictureOf(field, channels), texels = picture && new Uint32Array(picture.data.buffer);
  return picture && texels?.every((texel) => texel === texels[0]) ? {...picture, width: 1, height: 1, data: picture.data.slice(0, 4)} : picture;
}

/** @param {any} to @param {Material} material @param {Field} field @param {number} number @param {TextureCache} cache @param {Map<string, Blocks>} blocks */
function texelMaps(to, material, field, number, cache, blocks) {
  for (const {key, properties, channels, isColour} of texelTextures(to, material, field, number)) {
    const image = cache.get(key, () => {
      const known = blocks.get(key), picture = known ? null : smallPicture(field, channels);
      if (known) return fieldTexture(blockTexture(known), field, isColour);
      return picture && fieldTexture(pictureTexture(picture), field, isColour);
    });
    if (image) for (const property of properties) to[property] = image;
  }
  const scale = material.parameters.normal_scale?.[0] ?? 1, coat = material.parameters.clearcoat_normal_scale?.[0] ?? 1;
  to.normalScale?.set(scale, -scale); // as GLTFLoader does where there are no tangents
  to.clearcoatNormalScale?.set(coat, -coat);
}

/** @param {import('three').Texture} image @param {Field} field @param {boolean} isColour */
function fieldTexture(image, field, isColour) {
  [image.wrapS, image.wrapT] = field.wrap.map((wrap) => WRAPS[wrap]);
  image.colorSpace = isColour ? SRGBColorSpace : NoColorSpace;
  image.anisotropy = 16;
  return image;
}

/** A texture with mipmaps. @param {Picture} picture */
export function pictureTexture({data, width, height}) {
  const image = new DataTexture(data, width, height, RGBAFormat, UnsignedByteType);
  image.magFilter = LinearFilter;
  image.minFilter = LinearMipmapLinearFilter;
  image.generateMipmaps = true;
  image.needsUpdate = true;
  return image;
}

const BLOCK_FORMATS = {bc7: RGBA_BPTC_Format, astc: RGBA_ASTC_4x4_Format};

/** A texture in blocks. @param {Blocks} blocks */
function blockTexture({format, levels}) {
  const image = new CompressedTexture(levels, levels[0].width, levels[0].height, BLOCK_FORMATS[format], UnsignedByteType);
  image.magFilter = LinearFilter;
  image.minFilter = LinearMipmapLinearFilter;
  image.needsUpdate = true;
  return image;
}

/** Which blocks a renderer's card takes; null for none. @param {import('three').WebGLRenderer} renderer @returns {BlockFormat|null} */
export function blockFormatOf({extensions}) {
  return extensions.has('EXT_texture_compression_bptc') ? 'bc7' : extensions.has('WEBGL_compressed_texture_astc') ? 'astc' : null;
}

/** @typedef {Pick<Decoder, 'blocks'>} BlockCoder */

/**
 * A picture's blocks; null for one whose sides are no multiples of 4, which WebGL refuses, and, with a warning, where blocks.wasm fails.
 * @param {Picture} picture whose data go to a worker @param {boolean} isColour @param {BlockCoder} coder @param {BlockFormat} format
 * @param {AbortSignal} [signal] @returns {Promise<Blocks|null>}
 */
async function blocksOrNull(picture, isColour, coder, format, signal) {
  if (picture.width % 4 || picture.height % 4) return null;
  try {
    return await coder.blocks(picture, format, isColour, signal);
  } catch (error) {
    if (/** @type {any} */ (error).code === 'aborted') throw error;
    console.warn(`TEXFLoader: a texture stays uncompressed: ${error instanceof Error ? error.message : error}`);
    return null;
  }
}

/**
 * Blocks of an asset's textures of texels, by what groupOf() keeps them under; without those that stay RGBA.
 * @param {Asset} asset @param {BlockCoder} coder @param {BlockFormat} format @param {AbortSignal} [signal] @returns {Promise<Map<string, Blocks>>}
 */
export async function compressed(asset, coder, format, signal) {
  const textures = asset.units.flatMap((unit) => {
    const field = asset.fields[unit.field], material = asset.materials[unit.material];
    return field.planar ? texelTextures(materialOf(material), material, field, unit.field).map((texture) => ({...texture, field})) : [];
  });
  const blocks = /** @type {Map<string, Blocks>} */ (new Map());
  await Promise.all([...new Map(textures.map((texture) => [texture.key, texture])).values()].map(async ({key, field, channels, isColour}) => {
    const picture = smallPicture(field, channels), coded = picture && await blocksOrNull(picture, isColour, coder, format, signal);
    if (coded) blocks.set(key, coded);
  }));
  return blocks;
}

/** The texture of a picture, which stays as it is: in blocks where it can be.
 * @param {Picture} picture @param {boolean} isColour @param {BlockCoder} coder @param {BlockFormat} format @param {AbortSignal} [signal] */
export async function compressedTexture(picture, isColour, coder, format, signal) {
  const blocks = await blocksOrNull({...picture, data: picture.data.slice()}, isColour, coder, format, signal);
  return blocks ? blockTexture(blocks) : pictureTexture(picture);
}

const GLTF_WRAPS = {10497: RepeatWrapping, 33071: ClampToEdgeWrapping, 33648: MirroredRepeatWrapping};

/** What three.js calls the properties of a sampler of glTF, filters being linear with mipmaps or nearest.
 * @param {{magFilter: number, wrapS: keyof typeof GLTF_WRAPS, wrapT: keyof typeof GLTF_WRAPS}} sampler */
export function samplerOf({magFilter, wrapS, wrapT}) {
  const filters = magFilter === 9728 ? {magFilter: NearestFilter, minFilter: NearestFilter, generateMipmaps: false} : {};
  return {wrapS: GLTF_WRAPS[wrapS], wrapT: GLTF_WRAPS[wrapT], ...filters};
}

// ---- Voxels

/** GLSL of texfAsk(), which leaves what the field answers in texfSum0, texfSum1 ..., colours in linear light; network: of texfAskNetwork(), where one
 * answers on the finest level. Colours of coarser levels are mixed in linear light, as those of mipmaps are.
 * @param {boolean[][]} colours of each texture's components @param {string|null} network */
const askGlsl = (colours, network) => {
  const count = colours.length, light = (/** @type {number} */ n) => (colours[n].some(Boolean) ? (/** @type {string} */ of) => `texfLight(${of}, bvec4(${colours[n]}))` : (/** @type {string} */ of) => of);
  const each = (/** @type {(n: number) => string} */ text) => Array.from({length: count}, (_, n) => text(n)).join('\n  ');
  return `
varying vec3 vTexfPlace;
varying vec3 vTexfNormal;
varying vec3 vTexfWide;
varying mat3 vTexfTurn;
uniform bool texfCubes;
uniform vec2 texfBends;
${each((n) => `uniform sampler2D texfTable${n};\nvec4 texfSum${n};`)}
vec4 texfLight(vec4 c, bvec4 colour) { return mix(c, mix(c / 12.92, pow((c + 0.055) / 1.055, vec4(2.4)), step(0.04045, c)), colour); }
${PLACE_GLSL}${BITS_GLSL}${lookUpGlsl('voxels')}${LEVELS_GLSL}
${network ?? ''}
void texfAdd(int level, int row, float weight) {
  ivec2 at = place(row);
  ${each((n) => `vec4 cell${n} = texelFetch(texfTable${n}, at, 0);\n  texfSum${n} += weight * (level > 0 ? ${light(n)(`cell${n}`)} : cell${n});`)}
}
void texfAskLevel(int level, vec3 grid, float share) { // trilinear over the active cells (8.2.1)
  grid /= float(1 << level);
  vec3 low = floor(grid - 0.5), part = grid - 0.5 - low;
  int rows[8];
  float total = 0.0;
  for (int n = 0; n < 8; n++) {
    vec3 d = vec3(n & 1, n >> 1 & 1, n >> 2), w = mix(1.0 - part, part, d);
    rows[n] = row_voxels(level, ivec3(low + d), sizeOf(level));
    if (rows[n] >= 0) total += w.x * w.y * w.z;
  }
  if (total <= 0.0) {
    texfAdd(level, max(substitute(level, grid), 0), share);
    return;
  }
  for (int n = 0; n < 8; n++) {
    vec3 w = mix(1.0 - part, part, vec3(n & 1, n >> 1 & 1, n >> 2));
    if (rows[n] >= 0) texfAdd(level, rows[n], share * w.x * w.y * w.z / total);
  }
}
void texfAsk() { // a pixel that is wider than a cell asks the two levels nearest to its width
  ${each((n) => `texfSum${n} = vec4(0.0);`)}
  float wide = abs(dFdy(vTexfWide.x / vTexfWide.y)) * vTexfWide.z, level = clamp(log2(max(wide, 1.0)), 0.0, float(u_last));
  vec3 grid = texfCubes ? floor(vTexfPlace) + 0.5 : vTexfPlace;
  if (int(level) == 0) {
    ${network ? 'texfAskNetwork(' : 'texfAskLevel(0, '}grid, 1.0);
    ${each((n) => `texfSum${n} = (1.0 - fract(level)) * ${light(n)(`texfSum${n}`)};`)}
  } else texfAskLevel(int(level), grid, 1.0 - fract(level));
  if (fract(level) > 0.0) texfAskLevel(int(level) + 1, grid, fract(level));
}
`;
};

/** Whether three.js has a map, in its shaders. */
const DEFINES = /** @type {Object<string, string>} */ ({
  map: 'USE_MAP', aoMap: 'USE_AOMAP', normalMap: 'USE_NORMALMAP_OBJECTSPACE', clearcoatRoughnessMap: 'USE_CLEARCOAT_ROUGHNESSMAP', sheenColorMap: 'USE_SHEEN_COLORMAP',
  sheenRoughnessMap: 'USE_SHEEN_ROUGHNESSMAP', specularIntensityMap: 'USE_SPECULAR_INTENSITYMAP', specularColorMap: 'USE_SPECULAR_COLORMAP',
  iridescenceThicknessMap: 'USE_IRIDESCENCE_THICKNESSMAP',
});

/** What stands for each map: the asked values, as the shaders of three.js would get them of a texture, colours in linear light.
 * @param {ReturnType<typeof mapsOf>} maps @param {(component: string|null) => string} valueOf */
function answersOf(maps, valueOf) {
  const answers = /** @type {Object<string, string>} */ ({});
  for (const [property, channels] of maps) {
    const from = componentsOf(channels), four = channels.map((name, k) => valueOf(name && `${name} ${from[k]}`));
    answers[property] = `vec4(${[0, 1, 2, 3].map((k) => four[k] ?? '1.0')})`;
  }
  const bent = (/** @type {string} */ name, /** @type {string} */ scale) =>
    `(vTexfTurn * (normalize(vTexfNormal) + ${scale} * (2.0 * vec3(${[0, 1, 2].map((k) => valueOf(`${name}_object ${k}`))}) - 1.0)))`;
  if ('normalMap' in answers) answers.normalMap = `vec4(0.5 * ${bent('normal', 'texfBends.x')} + 0.5, 1.0)`;
  if ('clearcoatNormalMap' in answers) answers.clearcoatNormalMap = bent('clearcoat_normal', 'texfBends.y');
  return answers;
}

/**
 * @param {any} to @param {Material} material @param {Field} field @param {number} number @param {Asset} asset @param {TextureCache} cache
 * @param {{attribute: string, matrix: number[]}|null} placed the attribute that has places in the stream's space, and the matrix from there to
 *   the mesh's space; null where they are one
 */
function voxelMaps(to, material, field, number, asset, cache, placed = null) {
  const size = 2 ** field.levelsLeftOut, cells = Math.ceil(field.resolution / size), last = Math.ceil(Math.log2(cells)), {planes} = field;
  const maps = mapsOf(to, material, field).filter(([property]) => property !== 'anisotropyMap'); // which has no frame there
  const components = maps.flatMap(([, channels]) => channels.map((name, k) => `${name} ${componentsOf(channels)[k]}`)).filter((name) => !name.startsWith('null'));
  const coloured = new Set(maps.flatMap(([, channels, isColour]) => (isColour ? channels.slice(0, 3) : []))), count = Math.ceil(components.length / 4);
  const colours = Array.from({length: count}, (_, n) => [0, 1, 2, 3].map((k) => coloured.has(components[4 * n + k]?.split(' ')[0])));
  const valueOf = (/** @type {string|null} */ component) => {
    const at = component === null ? -1 : components.indexOf(component);
    return at < 0 ? '1.0' : `texfSum${at >> 2}.${'xyzw'[at & 3]}`;
  };
  const inMesh = new Matrix4().fromArray(placed?.matrix ?? new Matrix4().elements);
  const tree = cache.get(`${number} tree`, () => levelsOf({...bricksOf(field.keys), first: 0, depth: last}));
  const lookUp = cache.get(`${number} look-up`, () => lookUpOf(tree));
  const lookUpPart = (/** @type {'table'|'bits'} */ part) => cache.get(`${number} ${part}`, () => tableTexture(lookUp[part], 2, RGIntegerFormat, 'RG32UI'));
  const uniforms = /** @type {Object<string, {value: any}>} */ ({
    u_voxels_table: {value: lookUpPart('table')}, u_voxels_bits: {value: lookUpPart('bits')}, u_voxels_log2: {value: lookUp.log2},
    u_size: {value: cells}, u_last: {value: last},
    texfScale: {value: asset.side > 0 ? (1 - 2 ** -asset.positionBits) * field.resolution / size / asset.side : 0},
    texfCubes: {get value() { return Boolean(to.userData.cubes); }},
    texfMatrix: {value: new Matrix3().setFromMatrix4(inMesh)}, texfTurn: {value: new Matrix3().fromArray(inverseTranspose(inMesh.elements).columns)},
    texfWide: {value: Math.cbrt(Math.abs(inMesh.determinant())) || 1},
    texfBends: {get value() { return [to.normalScale?.x ?? 1, to.clearcoatNormalScale?.x ?? 1]; }},
  });
  for (let n = 0; n < count; n++) {
    const four = components.slice(4 * n, 4 * n + 4), from = four.map((name) => Number(name.split(' ')[1]));
    uniforms[`texfTable${n}`] = {value: cache.get(`${number} ${four}`, () => {
      const values = interleaved(four.map((name) => planes[name.split(' ')[0]]), from, (plane) => spreadOut(plane, field), field.keys.length);
      return tableTexture(pyramidOf(values, colours[n], tree).values, 4, RGBAFormat, null);
    })};
  }
  const network = asset.neural && field.levelsLeftOut === 0 ? networkOf(asset.neural, number, (key, make) => cache.get(key, make)) : null;
  const glsl = askGlsl(colours, network && networkAskGlsl(network, components, count)), answers = answersOf(maps, valueOf);
  to.onBeforeCompile = (/** @type {any} */ shader) => {
    Object.assign(shader.uniforms, uniforms, network?.uniforms);
    shader.vertexShader = placing(shader.vertexShader, placed, 'normalMap' in answers || 'clearcoatNormalMap' in answers);
    shader.fragmentShader = withSamplers(shader.fragmentShader, glsl, answers);
  };
  to.customProgramCacheKey = () => `texf ${placed?.attribute} ${JSON.stringify(answers)} ${network ? glsl : colours}`;
}

/** A vertex shader of three.js that hands on where a vertex is in the field, before targets and skin, and how they turn its normal.
 * @param {string} shader @param {{attribute: string}|null} placed @param {boolean} bends whether normals are asked */
function placing(shader, placed, bends) {
  const turns = `mat3 turn = texfTurn;
#ifdef USE_SKINNING
turn = mat3(skinMatrix) * turn;
#endif
#ifdef USE_INSTANCING
mat3 instance = mat3(instanceMatrix);
turn = mat3(instance[0] / dot(instance[0], instance[0]), instance[1] / dot(instance[1], instance[1]), instance[2] / dot(instance[2], instance[2])) * turn;
#endif
vTexfTurn = turn;`;
  return shader
    .replace('#include <common>', `#include <common>
varying vec3 vTexfPlace;
varying vec3 vTexfNormal;
varying vec3 vTexfWide;
varying mat3 vTexfTurn;
uniform float texfScale;
uniform float texfWide;
uniform mat3 texfMatrix;
uniform mat3 texfTurn;
${placed ? `attribute vec3 ${placed.attribute};` : ''}`)
    .replace('#include <begin_vertex>', `#include <begin_vertex>
vTexfPlace = ${placed?.attribute ?? 'position'} * texfScale;
vTexfNormal = normal * texfMatrix;
${bends ? turns : 'vTexfTurn = texfTurn;'}`)
    .replace('#include <project_vertex>', `#include <project_vertex>
vTexfWide = vec3(gl_Position.yw, gl_Position.w / projectionMatrix[1][1] * texfScale / length(modelViewMatrix[0].xyz) / texfWide);`);
}

/**
 * Makes a material show a field over voxels, and all its clones, which GLTFLoader makes for vertex colours and flat shading.
 * @template {import('three').Material} T
 * @param {T} to @param {import('./container.js').VoxelLook} look @param {string} attribute of the geometry: places in the stream's space
 * @param {TextureCache} cache of the stream @returns {T}
 */
export function overVoxels(to, look, attribute, cache) {
  const {asset, field: number, material, channels, matrix} = look, field = asset.fields[number], copy = /** @type {any} */ (to);
  const planes = Object.fromEntries(channels.map((name) => [name, field.planes[name]]));
  copy.userData.channels = channels;
  voxelMaps(copy, material, {...field, planes}, number, asset, cache, {attribute, matrix});
  copy.clone = () => overVoxels(new copy.constructor().copy(copy), look, attribute, cache);
  copy.addEventListener('dispose', () => cache.created.forEach((texture) => texture.dispose()));
  return to;
}

/** A fragment shader of three.js that gets values of texfAsk() where it would read its maps.
 * @param {string} shader @param {string} glsl @param {Object<string, string>} answers */
function withSamplers(shader, glsl, answers) {
  const defines = Object.keys(answers).filter((property) => property !== 'clearcoatNormalMap').map((property) => `#define ${DEFINES[property] ?? `USE_${property.toUpperCase()}`}`);
  let text = shader.replace('#include <map_fragment>', 'texfAsk();\n#include <map_fragment>').replace('#include <common>', `#include <common>\n${glsl}`);
  const included = /^[ \t]*#include +<([\w./]+)>/gm, chunks = /** @type {Object<string, string>} */ (ShaderChunk);
  while (text.search(included) >= 0) text = text.replace(included, (_, name) => chunks[name]);
  for (const [property, answer] of Object.entries(answers)) text = text.replaceAll(new RegExp(`texture2D\\( ${property}, \\w+ \\)`, 'g'), () => answer);
  if ('clearcoatNormalMap' in answers) text = text.replace('vec3 clearcoatNormal = nonPerturbedNormal;', () => `vec3 clearcoatNormal = normalize(normalMatrix * ${answers.clearcoatNormalMap}) * faceDirection;`);
  const turns = 'clearcoatNormalMap' in answers && !('normalMap' in answers) ? 'uniform mat3 normalMatrix;' : '';
  return `${defines.join('\n')}\n${turns}\n${text}`;
}

/** texfAskNetwork(): what a network answers in place of the finest cells.
 * @param {ReturnType<typeof networkOf>} network @param {string[]} components @param {number} count */
function networkAskGlsl({glsl, ask, vectorOf}, components, count) {
  const sums = Array.from({length: count}, (_, n) => `  texfSum${n} += share * ${vectorOf([0, 1, 2, 3].map((k) => components[4 * n + k] ?? null))};`);
  return `${glsl}
void texfAskNetwork(vec3 grid, float share) {
  ${ask('ivec3(clamp(grid * (16777216.0 / float(u_size)), 0.0, 16777215.0))')}
${sums.join('\n')}
}`;
}

/** Values of a plane that is coarser than its field, on the field's own cells.
 * @param {Plane} plane @param {Field} field */
function spreadOut(plane, field) {
  const further = BigInt(3 * Math.max(0, plane.levelShift - field.levelsLeftOut));
  if (further === 0n) return plane.values;
  const {components, values} = plane, out = new Uint8Array(field.keys.length * components);
  let cell = -1, last = -1n;
  field.keys.forEach((key, n) => {
    if (key >> further !== last) {
      cell++;
      last = key >> further;
    }
    out.set(values.subarray(cell * components, cell * components + components), n * components);
  });
  return out;
}
