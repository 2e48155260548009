/**
 * TEXFLoader: .texf streams for three.js.
 *
 *     import {TEXFLoader} from 'texf/three';
 *     scene.add(await new TEXFLoader().loadAsync('scan.texf'));
 *
 * Fields over texels become textures with mipmaps. Fields over voxels become bricks in textures, which the fragment shader asks; a
 * 3DNTC stream is evaluated there.
 */

import {
  BufferAttribute, BufferGeometry, ClampToEdgeWrapping, Color, DataTexture, DoubleSide, FileLoader, FrontSide, Group,
  LinearFilter, LinearMipmapLinearFilter, LinearSRGBColorSpace, Loader, Mesh, MeshBasicMaterial, MeshPhysicalMaterial,
  MeshStandardMaterial, MirroredRepeatWrapping, NearestFilter, NoColorSpace, RepeatWrapping, RGBAFormat, RGIntegerFormat,
  SRGBColorSpace, UnsignedByteType, UnsignedIntType, Vector2,
} from 'three';

import {Decoder, TexfError} from './index.js';
import {networkOf} from './three_neural.js';

/** @typedef {import('./index.js').Asset} Asset */
/** @typedef {import('./engine.js').Field} Field */
/** @typedef {import('./engine.js').Material} Material */
/** @typedef {import('./engine.js').Plane} Plane */

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
  }

  /** @param {string|URL|ArrayBuffer|Uint8Array} wasm where texf.wasm is, in place of beside the module */
  setDecoderPath(wasm) {
    this.decoder.wasm = wasm;
    this.decoder.module = null;
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
    return groupOf(asset);
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
  const told = new TexfError('network', `${url} cannot be fetched: ${error instanceof Error ? error.message : error}`);
  told.cause = error;
  return told;
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
 * @returns {Group} with a mesh for every geometry unit; `position` is the origin of the asset
 */
export function groupOf(asset) {
  const group = new Group(), textures = new TextureCache();
  group.position.fromArray(asset.origin);
  group.userData = {metadata: asset.metadata, textures: textures.made};
  for (const unit of asset.units) {
    const material = asset.materials[unit.material], field = asset.fields[unit.field];
    const mesh = new Mesh(geometryOf(unit), material.unlit ? new MeshBasicMaterial() : standardMaterial(material));
    mesh.name = material.name;
    mesh.material.name = material.name;
    common(mesh.material, material);
    if (field.planar) texelMaps(/** @type {any} */ (mesh.material), material, field, unit.field, textures);
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
    let found = seen[v];
    const same = (/** @type {number} */ a) => normals[3 * corner[a]] === normals[3 * i] && normals[3 * corner[a] + 1] === normals[3 * i + 1]
      && normals[3 * corner[a] + 2] === normals[3 * i + 2];
    while (found >= 0 && !same(found)) found = next[found];
    if (found < 0) {
      found = vertex.length;
      next[found] = seen[v];
      seen[v] = found;
      vertex.push(v);
      corner.push(i);
    }
    index[i] = found;
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
  geometry.setIndex(new BufferAttribute(index, 1));
  return geometry;
}

// ---- Materials (8.5)

/** @param {any} to @param {Material} from */
function common(to, from) {
  to.side = from.doubleSided ? DoubleSide : FrontSide;
  to.transparent = from.alphaMode === 'BLEND';
  to.depthWrite = from.alphaMode !== 'BLEND';
  to.alphaTest = from.alphaMode === 'MASK' ? from.alphaCutoff : 0;
}

const PHYSICAL = /** @type {const} */ ({
  clearcoat: 'clearcoat', clearcoat_roughness: 'clearcoatRoughness', sheen_roughness: 'sheenRoughness', specular: 'specularIntensity',
  transmission: 'transmission', thickness: 'thickness', attenuation_distance: 'attenuationDistance', iridescence: 'iridescence',
  iridescence_ior: 'iridescenceIOR', anisotropy: 'anisotropy', anisotropy_rotation: 'anisotropyRotation', ior: 'ior', dispersion: 'dispersion',
});
const PHYSICAL_COLOURS = /** @type {const} */ ({sheen_colour: 'sheenColor', specular_colour: 'specularColor', attenuation_colour: 'attenuationColor'});

/** @param {Material} material */
function standardMaterial(material) {
  const {parameters} = material, number = (/** @type {string} */ name, /** @type {number} */ otherwise) => parameters[name]?.[0] ?? otherwise;
  const names = [...Object.keys(PHYSICAL), ...Object.keys(PHYSICAL_COLOURS)];
  const physical = names.some((name) => name in parameters || material.channels.includes(name));
  const made = physical ? new MeshPhysicalMaterial() : new MeshStandardMaterial();
  made.roughness = number('roughness', 1);
  made.metalness = number('metallic', 1);
  made.aoMapIntensity = number('occlusion_strength', 1);
  made.emissive.setRGB(.../** @type {[number, number, number]} */ (parameters.emissive ?? [0, 0, 0]), LinearSRGBColorSpace);
  made.emissiveIntensity = number('emissive_strength', 1);
  if (made instanceof MeshPhysicalMaterial) {
    for (const [name, property] of Object.entries(PHYSICAL)) if (name in parameters) /** @type {any} */ (made)[property] = parameters[name][0];
    for (const [name, property] of Object.entries(PHYSICAL_COLOURS))
      if (name in parameters) /** @type {any} */ (made)[property] = new Color().setRGB(.../** @type {[number, number, number]} */ (parameters[name]), LinearSRGBColorSpace);
    if ('sheen_colour' in parameters) made.sheen = 1;
    made.iridescenceThicknessRange = [number('iridescence_thickness_minimum', 100), number('iridescence_thickness_maximum', 400)];
  }
  return made;
}

class TextureCache {
  constructor() {
    /** @type {import('three').Texture[]} */
    this.made = [];
    /** @type {Map<string, any>} */
    this.known = new Map();
  }

  /** @template T @param {string} key @param {() => T} make @returns {T} */
  get(key, make) {
    if (!this.known.has(key)) {
      const found = /** @type {any} */ (make());
      this.known.set(key, found);
      if (found?.isTexture) this.made.push(found);
    }
    return this.known.get(key);
  }
}

/**
 * The planes of up to four components as RGBA; what no plane gives is 255.
 * @param {(Plane|undefined)[]} planes @param {number[]} from component of each, as the channel counts them
 * @param {(plane: Plane) => Uint8Array} data @param {number} count cells
 */
function interleaved(planes, from, data, count) {
  const out = new Uint8Array(4 * count).fill(255);
  planes.forEach((plane, k) => {
    if (!plane) return;
    const values = data(plane), step = plane.components, at = plane.offset + Math.min(from[k], step - 1 - plane.offset); // grey: one for all
    for (let i = 0; i < count; i++) out[4 * i + k] = values[step * i + at];
  });
  return out;
}

// ---- Texels

const LINEAR = 'vec3 texfLinear(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c)); }';

/** @param {any} to @param {Material} material @param {Field} field @param {number} number @param {TextureCache} cache */
function texelMaps(to, material, field, number, cache) {
  const planes = field.planes;
  const texture = (/** @type {string} */ key, /** @type {(Plane|undefined)[]} */ four, /** @type {number[]} */ from, srgb = false) => cache.get(`${number} ${key}`, () => {
    const size = four.find(Boolean)?.image;
    if (!size) return null;
    const fitting = four.map((plane) => plane?.image?.width === size.width && plane.image.height === size.height ? plane : undefined);
    const pixels = interleaved(fitting, from, (plane) => /** @type {any} */ (plane.image).data, size.width * size.height);
    if (key.includes('normal')) withZ(pixels);
    const made = new DataTexture(pixels, size.width, size.height, RGBAFormat, UnsignedByteType);
    [made.wrapS, made.wrapT] = field.wrap.map((wrap) => WRAPS[wrap]);
    made.colorSpace = srgb ? SRGBColorSpace : NoColorSpace;
    made.magFilter = LinearFilter;
    made.minFilter = LinearMipmapLinearFilter;
    made.generateMipmaps = true;
    made.anisotropy = 16;
    made.needsUpdate = true;
    return made;
  });
  const colour = (/** @type {string} */ name) => texture(name, [planes[name], planes[name], planes[name]], [0, 1, 2], true);
  const has = (/** @type {string} */ name) => name in planes && material.channels.includes(name);
  to.map = texture('base', [planes.base_colour, planes.base_colour, planes.base_colour, planes.alpha], [0, 1, 2, 0]);
  to.onBeforeCompile = interpolatedAsCoded;
  to.customProgramCacheKey = () => 'texf texels';
  if (material.unlit) return;
  if (has('normal')) {
    const scale = material.parameters.normal_scale?.[0] ?? 1;
    to.normalMap = texture('normal', [planes.normal, planes.normal], [0, 1]);
    to.normalScale = new Vector2(scale, -scale); // as GLTFLoader does where there are no tangents
  }
  if (has('occlusion')) to.aoMap = texture('occlusion', [planes.occlusion], [0]);
  if (has('roughness')) to.roughnessMap = texture('roughness', [undefined, planes.roughness], [0, 0]);
  if (has('metallic')) to.metalnessMap = texture('metallic', [undefined, undefined, planes.metallic], [0, 0, 0]);
  if (has('emissive')) to.emissiveMap = texture('emissive', [planes.emissive, planes.emissive, planes.emissive], [0, 1, 2]);
  if (!(to instanceof MeshPhysicalMaterial)) return;
  if (has('clearcoat')) to.clearcoatMap = texture('clearcoat', [planes.clearcoat], [0]);
  if (has('clearcoat_roughness')) to.clearcoatRoughnessMap = texture('clearcoat_roughness', [undefined, planes.clearcoat_roughness], [0, 0]);
  if (has('clearcoat_normal')) {
    const scale = material.parameters.clearcoat_normal_scale?.[0] ?? 1;
    to.clearcoatNormalMap = texture('clearcoat_normal', [planes.clearcoat_normal, planes.clearcoat_normal], [0, 1]);
    to.clearcoatNormalScale = new Vector2(scale, -scale);
  }
  if (has('sheen_colour')) to.sheenColorMap = colour('sheen_colour');
  if (has('sheen_roughness')) to.sheenRoughnessMap = texture('sheen_roughness', [undefined, undefined, undefined, planes.sheen_roughness], [0, 0, 0, 0]);
  if (has('specular')) to.specularIntensityMap = texture('specular', [undefined, undefined, undefined, planes.specular], [0, 0, 0, 0]);
  if (has('specular_colour')) to.specularColorMap = colour('specular_colour');
  if (has('transmission')) to.transmissionMap = texture('transmission', [planes.transmission], [0]);
  if (has('thickness')) to.thicknessMap = texture('thickness', [undefined, planes.thickness], [0, 0]);
  if (has('iridescence')) to.iridescenceMap = texture('iridescence', [planes.iridescence], [0]);
  if (has('iridescence_thickness')) to.iridescenceThicknessMap = texture('iridescence_thickness', [undefined, planes.iridescence_thickness], [0, 0]);
  if (has('anisotropy')) to.anisotropyMap = texture('anisotropy', [planes.anisotropy, planes.anisotropy, planes.anisotropy], [0, 1, 2]);
}

/** Base colour and emissive are filtered as they are coded and made linear then (8.2.1), so that their textures have no colour space.
 * @param {{fragmentShader: string}} shader */
function interpolatedAsCoded(shader) {
  shader.fragmentShader = shader.fragmentShader
    .replace('#include <common>', `#include <common>\n${LINEAR}`)
    .replace('#include <map_fragment>', `#ifdef USE_MAP
vec4 texfBase = texture2D(map, vMapUv);
diffuseColor *= vec4(texfLinear(texfBase.rgb), texfBase.a);
#endif`)
    .replace('#include <emissivemap_fragment>', `#ifdef USE_EMISSIVEMAP
totalEmissiveRadiance *= texfLinear(texture2D(emissiveMap, vEmissiveMapUv).rgb);
#endif`);
}

/** The third component of tangent space normals, from the first two.
 * @param {Uint8Array} pixels */
function withZ(pixels) {
  for (let i = 0; i < pixels.length; i += 4) {
    const x = pixels[i] / 127.5 - 1, y = pixels[i + 1] / 127.5 - 1;
    pixels[i + 2] = Math.round(127.5 * (Math.sqrt(Math.max(0, 1 - x * x - y * y)) + 1));
  }
}

// ---- Voxels

/**
 * All levels of a field over voxels: rows of cells from the finest level to the one of a single cell, and where they stand. A brick is
 * 8 x 8 x 8 cells of a level. `table` is a hash table of (code of the brick, its number + 1), `bits` has for every 32 cells of a brick
 * which are active and the row of the first of them.
 * @param {BigUint64Array} keys ascend @param {number} depth levels above the finest
 */
function levelsOf(keys, depth) {
  const parents = /** @type {Uint32Array[]} */ ([]), codes = /** @type {number[]} */ ([]), words = /** @type {number[]} */ ([]);
  let cells = numbersOf(keys), rows = 0;
  for (let level = 0; ; level++) {
    let last = -1;
    for (let n = 0; n < cells.length; n++) {
      const brick = Math.floor(cells[n] / 512), local = cells[n] - 512 * brick;
      if (brick !== last) {
        codes.push(codeOf(level, brick));
        for (let word = 0; word < 16; word++) words.push(0, 0);
        last = brick;
      }
      const at = words.length - 32 + 2 * (local >> 5);
      if (words[at] === 0) words[at + 1] = rows + n;
      words[at] = (words[at] | 1 << (local & 31)) >>> 0;
    }
    rows += cells.length;
    if (level === depth) return {...tableOf(codes), bits: words, rows, parents};
    const parent = new Uint32Array(cells.length), above = new Float64Array(cells.length);
    let count = 0;
    for (let n = 0; n < cells.length; n++) {
      const key = Math.floor(cells[n] / 8);
      if (count === 0 || above[count - 1] !== key) above[count++] = key;
      parent[n] = count - 1;
    }
    parents.push(parent);
    cells = above.slice(0, count);
  }
}

/** Keys as numbers: they have 39 bits at most.
 * @param {BigUint64Array} keys */
function numbersOf(keys) {
  const halves = new Uint32Array(keys.buffer, keys.byteOffset, 2 * keys.length), out = new Float64Array(keys.length);
  for (let n = 0; n < out.length; n++) out[n] = halves[2 * n] + 2 ** 32 * halves[2 * n + 1];
  return out;
}

/** @param {number} level @param {number} brick Morton number */
function codeOf(level, brick) {
  const [x, y, z] = [0, 1, 2].map((axis) => {
    let out = 0;
    for (let i = 0; i < 10; i++) out |= (brick >>> (3 * i + axis) & 1) << i;
    return out;
  });
  return (level === 0 ? x | y << 10 | z << 20 : x | y << 9 | z << 18 | level << 27 | 1 << 31) >>> 0;
}

/** @param {number[]} codes */
function tableOf(codes) {
  const log2 = Math.ceil(Math.log2(2 * codes.length + 1)), table = new Uint32Array(2 << log2);
  codes.forEach((code, number) => {
    let slot = Math.imul(code, HASH) >>> 32 - log2;
    while (table[2 * slot + 1] > 0) slot = slot + 1 & (1 << log2) - 1;
    table[2 * slot] = code;
    table[2 * slot + 1] = number + 1;
  });
  return {table, log2};
}

/** RGBA of all levels, each cell the mean of those of the finest level in it.
 * @param {Uint8Array} finest @param {ReturnType<typeof levelsOf>} levels */
function withMeans(finest, {rows, parents}) {
  const out = new Uint8Array(4 * WIDTH * Math.max(1, Math.ceil(rows / WIDTH)));
  out.set(finest);
  let sums = new Float32Array(finest), counts = new Float32Array(finest.length / 4).fill(1), at = finest.length;
  for (const parent of parents) {
    const size = parent[parent.length - 1] + 1, above = new Float32Array(4 * size), many = new Float32Array(size);
    for (let n = 0; n < parent.length; n++) {
      const to = 4 * parent[n], from = 4 * n;
      many[parent[n]] += counts[n];
      above[to] += sums[from];
      above[to + 1] += sums[from + 1];
      above[to + 2] += sums[from + 2];
      above[to + 3] += sums[from + 3];
    }
    for (let i = 0; i < above.length; i++) out[at + i] = above[i] / many[i >> 2] + 0.5;
    [sums, counts, at] = [above, many, at + above.length];
  }
  return out;
}

const WIDTH = 2048, HASH = 2654435769;
const GLSL = `
varying vec3 vTexfPlace;
varying vec3 vTexfNormal;
varying vec3 vTexfWide;
uniform highp usampler2D texfTable, texfBits;
uniform int texfSize, texfLast, texfLog2;
uniform sampler2D texfBase, texfSurface, texfEmissive, texfDeviation;
${LINEAR}
ivec2 texfAt(int i) { return ivec2(i & ${WIDTH - 1}, i >> ${Math.log2(WIDTH)}); }
int texfOnes(uint x) {
  x -= (x >> 1) & 0x55555555u;
  x = (x & 0x33333333u) + ((x >> 2) & 0x33333333u);
  return int((((x + (x >> 4)) & 0x0f0f0f0fu) * 0x01010101u) >> 24);
}
uint texfCode = 0xffffffffu;
int texfBrick = -1;
int texfFind(uint code) {
  uint slot = (code * ${HASH}u) >> (32 - texfLog2), mask = (1u << texfLog2) - 1u;
  for (uint step = 0u; step <= mask; step++) {
    uvec2 entry = texelFetch(texfTable, texfAt(int(slot)), 0).rg;
    if (entry.y == 0u) return -1;
    if (entry.x == code) return int(entry.y) - 1;
    slot = (slot + 1u) & mask;
  }
  return -1;
}
int texfRow(int level, ivec3 cell) { // -1 where the cell is not active
  if (any(lessThan(cell, ivec3(0))) || any(greaterThanEqual(cell, ivec3((texfSize + (1 << level) - 1) >> level)))) return -1;
  uvec3 brick = uvec3(cell >> 3), q = uvec3(cell & 7);
  uint code = level == 0 ? brick.x | (brick.y << 10) | (brick.z << 20) : brick.x | (brick.y << 9) | (brick.z << 18) | (uint(level) << 27) | 0x80000000u;
  if (code != texfCode) {
    texfCode = code;
    texfBrick = texfFind(code);
  }
  if (texfBrick < 0) return -1;
  q = (q & 1u) | ((q & 2u) << 2) | ((q & 4u) << 4);
  uint inside = q.x | (q.y << 1) | (q.z << 2), bit = inside & 31u;
  uvec2 word = texelFetch(texfBits, texfAt(texfBrick * 16 + int(inside >> 5)), 0).rg;
  return ((word.x >> bit) & 1u) == 0u ? -1 : int(word.y) + texfOnes(word.x & ((1u << bit) - 1u));
}
vec4 texfBaseValue, texfSurfaceValue, texfEmissiveValue, texfDeviationValue;
TEXF_ANSWERS
void texfAdd(int row, float weight) {
  ivec2 at = texfAt(row);
  texfBaseValue += weight * texelFetch(texfBase, at, 0);
  if ((TEXF_MAPS & 4) != 0) texfSurfaceValue += weight * texelFetch(texfSurface, at, 0);
  if ((TEXF_MAPS & 1) != 0) texfEmissiveValue += weight * texelFetch(texfEmissive, at, 0);
  if ((TEXF_MAPS & 2) != 0) texfDeviationValue += weight * texelFetch(texfDeviation, at, 0);
}
void texfAskLevel(int level, vec3 place, float share) { // trilinear over the active cells (8.2.1)
#ifdef TEXF_NETWORK
  if (level == 0) {
    texfAskNetwork(ivec3(clamp(place * (16777216.0 / float(texfSize)), 0.0, 16777215.0)), share);
    return;
  }
#endif
  place /= float(1 << level);
  vec3 low = floor(place - 0.5), part = place - 0.5 - low;
  int rows[8];
  float total = 0.0;
  for (int n = 0; n < 8; n++) {
    vec3 d = vec3(n & 1, n >> 1 & 1, n >> 2), w = mix(1.0 - part, part, d);
    rows[n] = texfRow(level, ivec3(low + d));
    if (rows[n] >= 0) total += w.x * w.y * w.z;
  }
  if (total > 0.0) {
    for (int n = 0; n < 8; n++) {
      vec3 w = mix(1.0 - part, part, vec3(n & 1, n >> 1 & 1, n >> 2));
      if (rows[n] >= 0) texfAdd(rows[n], share * w.x * w.y * w.z / total);
    }
    return;
  }
  int row = -1; // none of them is: the nearest of those around, on the finest level that has one
  for (; row < 0 && level <= texfLast; level++) {
    float least = 3.0;
    for (int n = 0; n < 27; n++) {
      ivec3 cell = ivec3(floor(place)) + ivec3(n % 3, n / 3 % 3, n / 9) - 1;
      vec3 away = vec3(cell) + 0.5 - place;
      float far = dot(away, away);
      int found = far < least ? texfRow(level, cell) : -1;
      if (found < 0) continue;
      least = far;
      row = found;
    }
    place *= 0.5;
  }
  texfAdd(max(row, 0), share);
}
void texfAsk() { // a pixel that is wider than a cell asks the two levels nearest to its width
  texfBaseValue = texfSurfaceValue = texfEmissiveValue = texfDeviationValue = vec4(0.0);
  float wide = abs(dFdy(vTexfWide.x / vTexfWide.y)) * vTexfWide.z, level = clamp(log2(max(wide, 1.0)), 0.0, float(texfLast));
  texfAskLevel(int(level), vTexfPlace, 1.0 - fract(level));
  if (fract(level) > 0.0) texfAskLevel(int(level) + 1, vTexfPlace, fract(level));
}
`;

/** @param {any} to @param {Material} material @param {Field} field @param {number} number @param {Asset} asset @param {TextureCache} cache */
function voxelMaps(to, material, field, number, asset, cache) {
  const size = 2 ** field.levelsLeftOut, cells = Math.ceil(field.resolution / size), last = Math.ceil(Math.log2(cells)), {planes} = field;
  const levels = cache.get(`${number} levels`, () => levelsOf(field.keys, last));
  const look = (/** @type {'table'|'bits'} */ key) => cache.get(`${number} ${key}`, () => {
    const pairs = levels[key].length / 2, height = Math.max(1, Math.ceil(pairs / WIDTH)), data = new Uint32Array(2 * WIDTH * height);
    data.set(levels[key]);
    return nearest(new DataTexture(data, WIDTH, height, RGIntegerFormat, UnsignedIntType), 'RG32UI');
  });
  const texture = (/** @type {string} */ key, /** @type {(Plane|undefined)[]} */ four, /** @type {number[]} */ from) => cache.get(`${number} ${key}`, () => {
    const pixels = withMeans(interleaved(four, from, (plane) => spreadOut(plane, field), field.keys.length), levels);
    return nearest(new DataTexture(pixels, WIDTH, pixels.length / 4 / WIDTH, RGBAFormat, UnsignedByteType));
  });
  const has = (/** @type {string} */ name, /** @type {string} */ channel) => channel in planes && material.channels.includes(name);
  const lit = !material.unlit, glows = lit && has('emissive', 'emissive'), bends = lit && has('normal', 'normal_object');
  const of = (/** @type {string} */ name) => has(name, name) ? planes[name] : undefined;
  const three = (/** @type {Plane} */ plane) => [plane, plane, plane], maps = (glows ? 1 : 0) + (bends ? 2 : 0) + (lit ? 4 : 0);
  const base = texture('base', [...three(planes.base_colour), planes.alpha], [0, 1, 2, 0]);
  const uniforms = {
    texfTable: {value: look('table')}, texfBits: {value: look('bits')}, texfLog2: {value: levels.log2}, texfSize: {value: cells}, texfLast: {value: last},
    texfBase: {value: base},
    texfSurface: {value: lit ? texture(`surface ${material.channels.join()}`, [of('occlusion'), of('roughness'), of('metallic')], [0, 0, 0]) : base},
    texfEmissive: {value: glows ? texture('emissive', three(planes.emissive), [0, 1, 2]) : base},
    texfDeviation: {value: bends ? texture('deviation', three(planes.normal_object), [0, 1, 2]) : base},
    texfScale: {value: asset.side > 0 ? (1 - 2 ** -asset.positionBits) * field.resolution / size / asset.side : 0},
  };
  const strength = (material.parameters.occlusion_strength?.[0] ?? 1).toFixed(6);
  const network = asset.neural && field.levelsLeftOut === 0 ? networkOf(asset.neural, number, (key, make) => cache.get(key, make)) : null;
  const surface = ['occlusion', 'roughness', 'metallic'].map((name) => has(name, name) ? `${name} 0` : null);
  const glsl = network ? GLSL.replace('TEXF_ANSWERS', answersGlsl(network, 'alpha' in planes ? 'alpha 0' : null, surface)) : GLSL.replace('TEXF_ANSWERS', '');
  to.onBeforeCompile = (/** @type {any} */ shader) => {
    Object.assign(shader.uniforms, uniforms, network?.uniforms);
    shader.vertexShader = shader.vertexShader
      .replace('#include <common>', '#include <common>\nvarying vec3 vTexfPlace;\nvarying vec3 vTexfNormal;\nvarying vec3 vTexfWide;\nuniform float texfScale;')
      .replace('#include <begin_vertex>', '#include <begin_vertex>\nvTexfPlace = position * texfScale;\nvTexfNormal = normal;')
      .replace('#include <project_vertex>', `#include <project_vertex>
vTexfWide = vec3(gl_Position.yw, gl_Position.w / projectionMatrix[1][1] * texfScale / length(modelViewMatrix[0].xyz));`);
    shader.fragmentShader = shader.fragmentShader
      .replace('#include <common>', `#include <common>\n${lit ? 'uniform mat3 normalMatrix;' : ''}\n#define TEXF_MAPS ${maps}${glsl}`)
      .replace('#include <map_fragment>', 'texfAsk();\ndiffuseColor *= vec4(texfLinear(texfBaseValue.rgb), texfBaseValue.a);')
      .replace('#include <roughnessmap_fragment>', '#include <roughnessmap_fragment>\nroughnessFactor *= texfSurfaceValue.g;')
      .replace('#include <metalnessmap_fragment>', '#include <metalnessmap_fragment>\nmetalnessFactor *= texfSurfaceValue.b;');
    if (lit) shader.fragmentShader = shader.fragmentShader.replace('#include <aomap_fragment>', `float texfOcclusion = 1.0 + ${strength} * (texfSurfaceValue.r - 1.0);
reflectedLight.indirectDiffuse *= texfOcclusion;\nreflectedLight.indirectSpecular *= texfOcclusion;`);
    if (glows) shader.fragmentShader = shader.fragmentShader.replace('#include <emissivemap_fragment>',
      'totalEmissiveRadiance *= texfLinear(texfEmissiveValue.rgb);');
    if (bends) shader.fragmentShader = shader.fragmentShader.replace('#include <normal_fragment_maps>',
      'normal = normalize(normalMatrix * (normalize(vTexfNormal) + texfDeviationValue.xyz * 2.0 - 1.0)) * faceDirection;');
  };
  to.customProgramCacheKey = () => `texf ${maps} ${strength} ${network ? `${surface.join()} ${glsl}` : ''}`;
}

/** Where a network answers in place of the finest cells.
 * @param {ReturnType<typeof networkOf>} network @param {string|null} alpha @param {(string|null)[]} surface */
function answersGlsl({glsl, ask, vectorOf}, alpha, surface) {
  const three = (/** @type {string} */ name) => vectorOf([`${name} 0`, `${name} 1`, `${name} 2`, null]);
  return `#define TEXF_NETWORK
#define place(i) texfAt(i)
${glsl}
void texfAskNetwork(ivec3 position, float share) {
  ${ask('position')}
  texfBaseValue += share * ${vectorOf(['base_colour 0', 'base_colour 1', 'base_colour 2', alpha])};
  if ((TEXF_MAPS & 4) != 0) texfSurfaceValue += share * ${vectorOf([...surface, null])};
  if ((TEXF_MAPS & 1) != 0) texfEmissiveValue += share * ${three('emissive')};
  if ((TEXF_MAPS & 2) != 0) texfDeviationValue += share * ${three('normal_object')};
}`;
}

/** @param {DataTexture} texture @param {import('three').PixelFormatGPU|null} internal */
function nearest(texture, internal = null) {
  texture.internalFormat = internal;
  texture.minFilter = texture.magFilter = NearestFilter;
  texture.needsUpdate = true;
  return texture;
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
