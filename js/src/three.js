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
  BufferAttribute, BufferGeometry, ClampToEdgeWrapping, Color, DataTexture, DoubleSide, FileLoader, FrontSide, Group,
  LinearFilter, LinearMipmapLinearFilter, LinearSRGBColorSpace, Loader, Mesh, MeshBasicMaterial, MeshPhysicalMaterial,
  MeshStandardMaterial, MirroredRepeatWrapping, NoColorSpace, RepeatWrapping, RGBAFormat, RGIntegerFormat,
  SRGBColorSpace, UnsignedByteType, Vector2,
} from 'three';

import {BITS_GLSL, LEVELS_GLSL, lookUpGlsl} from './glsl_voxels.js';
import {Decoder, TexfError} from './index.js';
import {bricksOf, levelsOf, lookUpOf, pyramidOf} from './supports.js';
import {networkOf} from './three_neural.js';
import {PLACE_GLSL, tableTexture} from './three_tables.js';

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
  to.map = texture('base', [planes.base_colour, planes.base_colour, planes.base_colour, planes.alpha], [0, 1, 2, 0], true);
  if (material.unlit) return;
  if (has('normal')) {
    const scale = material.parameters.normal_scale?.[0] ?? 1;
    to.normalMap = texture('normal', [planes.normal, planes.normal], [0, 1]);
    to.normalScale = new Vector2(scale, -scale); // as GLTFLoader does where there are no tangents
  }
  if (has('occlusion')) to.aoMap = texture('occlusion', [planes.occlusion], [0]);
  if (has('roughness')) to.roughnessMap = texture('roughness', [undefined, planes.roughness], [0, 0]);
  if (has('metallic')) to.metalnessMap = texture('metallic', [undefined, undefined, planes.metallic], [0, 0, 0]);
  if (has('emissive')) to.emissiveMap = colour('emissive');
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

/** The third component of tangent space normals, from the first two.
 * @param {Uint8Array} pixels */
function withZ(pixels) {
  for (let i = 0; i < pixels.length; i += 4) {
    const x = pixels[i] / 127.5 - 1, y = pixels[i + 1] / 127.5 - 1;
    pixels[i + 2] = Math.round(127.5 * (Math.sqrt(Math.max(0, 1 - x * x - y * y)) + 1));
  }
}

// ---- Voxels

const LINEAR = 'vec3 texfLinear(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c)); }';
const GLSL = `
varying vec3 vTexfPlace;
varying vec3 vTexfNormal;
varying vec3 vTexfWide;
uniform sampler2D texfBase, texfSurface, texfEmissive, texfDeviation;
${LINEAR}
${PLACE_GLSL}${BITS_GLSL}${lookUpGlsl('voxels')}${LEVELS_GLSL}
vec4 texfBaseValue, texfSurfaceValue, texfEmissiveValue, texfDeviationValue;
TEXF_NETWORK
void texfAdd(int row, float weight) {
  ivec2 at = place(row);
  texfBaseValue += weight * texelFetch(texfBase, at, 0);
  if ((TEXF_MAPS & 4) != 0) texfSurfaceValue += weight * texelFetch(texfSurface, at, 0);
  if ((TEXF_MAPS & 1) != 0) texfEmissiveValue += weight * texelFetch(texfEmissive, at, 0);
  if ((TEXF_MAPS & 2) != 0) texfDeviationValue += weight * texelFetch(texfDeviation, at, 0);
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
    texfAdd(max(substitute(level, grid), 0), share);
    return;
  }
  for (int n = 0; n < 8; n++) {
    vec3 w = mix(1.0 - part, part, vec3(n & 1, n >> 1 & 1, n >> 2));
    if (rows[n] >= 0) texfAdd(rows[n], share * w.x * w.y * w.z / total);
  }
}
void texfAsk() { // a pixel that is wider than a cell asks the two levels nearest to its width
  texfBaseValue = texfSurfaceValue = texfEmissiveValue = texfDeviationValue = vec4(0.0);
  float wide = abs(dFdy(vTexfWide.x / vTexfWide.y)) * vTexfWide.z, level = clamp(log2(max(wide, 1.0)), 0.0, float(u_last));
  if (int(level) == 0) TEXF_FINEST(vTexfPlace, 1.0 - fract(level));
  else texfAskLevel(int(level), vTexfPlace, 1.0 - fract(level));
  if (fract(level) > 0.0) texfAskLevel(int(level) + 1, vTexfPlace, fract(level));
}
`;

/** @param {any} to @param {Material} material @param {Field} field @param {number} number @param {Asset} asset @param {TextureCache} cache */
function voxelMaps(to, material, field, number, asset, cache) {
  const size = 2 ** field.levelsLeftOut, cells = Math.ceil(field.resolution / size), last = Math.ceil(Math.log2(cells)), {planes} = field;
  const tree = cache.get(`${number} tree`, () => levelsOf({...bricksOf(field.keys), first: 0, depth: last}));
  const lookUp = cache.get(`${number} look-up`, () => lookUpOf(tree));
  const look = (/** @type {'table'|'bits'} */ part) => cache.get(`${number} ${part}`, () => tableTexture(lookUp[part], 2, RGIntegerFormat, 'RG32UI'));
  const texture = (/** @type {string} */ key, /** @type {(Plane|undefined)[]} */ four, /** @type {number[]} */ from) => cache.get(`${number} ${key}`, () => {
    const values = interleaved(four, from, (plane) => spreadOut(plane, field), field.keys.length);
    return tableTexture(pyramidOf({values, counts: null, level: 0}, 4, tree).values, 4, RGBAFormat, null);
  });
  const has = (/** @type {string} */ name, /** @type {string} */ channel) => channel in planes && material.channels.includes(name);
  const lit = !material.unlit, glows = lit && has('emissive', 'emissive'), bends = lit && has('normal', 'normal_object');
  const of = (/** @type {string} */ name) => has(name, name) ? planes[name] : undefined;
  const three = (/** @type {Plane} */ plane) => [plane, plane, plane], maps = (glows ? 1 : 0) + (bends ? 2 : 0) + (lit ? 4 : 0);
  const base = texture('base', [...three(planes.base_colour), planes.alpha], [0, 1, 2, 0]);
  const uniforms = {
    u_voxels_table: {value: look('table')}, u_voxels_bits: {value: look('bits')}, u_voxels_log2: {value: lookUp.log2},
    u_size: {value: cells}, u_last: {value: last},
    texfBase: {value: base},
    texfSurface: {value: lit ? texture(`surface ${material.channels.join()}`, [of('occlusion'), of('roughness'), of('metallic')], [0, 0, 0]) : base},
    texfEmissive: {value: glows ? texture('emissive', three(planes.emissive), [0, 1, 2]) : base},
    texfDeviation: {value: bends ? texture('deviation', three(planes.normal_object), [0, 1, 2]) : base},
    texfScale: {value: asset.side > 0 ? (1 - 2 ** -asset.positionBits) * field.resolution / size / asset.side : 0},
  };
  const strength = (material.parameters.occlusion_strength?.[0] ?? 1).toFixed(6);
  const network = asset.neural && field.levelsLeftOut === 0 ? networkOf(asset.neural, number, (key, make) => cache.get(key, make)) : null;
  const surface = ['occlusion', 'roughness', 'metallic'].map((name) => has(name, name) ? `${name} 0` : null);
  const glsl = GLSL.replace('TEXF_NETWORK', network ? answersGlsl(network, 'alpha' in planes ? 'alpha 0' : null, surface) : '#define TEXF_FINEST(grid, share) texfAskLevel(0, grid, share)');
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
  return `${glsl}
void texfAskNetwork(vec3 grid, float share) {
  ${ask('ivec3(clamp(grid * (16777216.0 / float(u_size)), 0.0, 16777215.0))')}
  texfBaseValue += share * ${vectorOf(['base_colour 0', 'base_colour 1', 'base_colour 2', alpha])};
  if ((TEXF_MAPS & 4) != 0) texfSurfaceValue += share * ${vectorOf([...surface, null])};
  if ((TEXF_MAPS & 1) != 0) texfEmissiveValue += share * ${three('emissive')};
  if ((TEXF_MAPS & 2) != 0) texfDeviationValue += share * ${three('normal_object')};
}
#define TEXF_FINEST(grid, share) texfAskNetwork(grid, share)`;
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
