/**
 * The part-level form of TEXF_stream (docs/guide/TEXF_stream.md): coded primitives of a glTF file become plain ones. No host is named
 * here: gltf.js hands what is added to GLTFLoader, expand.js writes it into a file.
 */

import {Added, ARRAY, checkViews, entryOf, INDICES, invalid, isIndex, NAME, readAccessor, without} from './accessors.js';
import {pictureOf} from './pictures.js';
import {checkTree} from './references.js';
import {inverseTranspose, Surface} from './surface.js';

/** @typedef {import('./engine.js').Asset} Asset */
/** @typedef {import('./pictures.js').Picture} Picture */
/** @typedef {import('./accessors.js').ViewOf} ViewOf */
/** @typedef {import('./accessors.js').Values} Values */
/** @typedef {{primitive: any, stream: number, units: number[], matrix: number[], texCoord: number, splits: Values|null}} Coded */
/** @typedef {{number?: number, isMapped: boolean, hasNormals: boolean, isVoxels: boolean}} Look a material of the file on a field; number: in the file */
/**
 * @typedef {object} VoxelLook a material that shows a field over voxels
 * @property {Asset} asset
 * @property {number} field
 * @property {import('./engine.js').Material} material of the stream
 * @property {string[]} channels those of the field that slots of the file's material show
 * @property {number[]} matrix from the stream's space to the mesh's, column-major
 */
/**
 * @typedef {object} Unfolded
 * @property {Map<number, Uint8Array>} views bytes of bufferViews that were added
 * @property {Map<number, Picture & {isColour: boolean}>} pictures of textures that were added
 * @property {Map<number, VoxelLook>} voxels by number of the material
 */

export const PLACE = '_TEXF_PLACE'; // attribute: places in the stream's space, for fields over voxels
const UNSIGNED = [5121, 5123, 5125], LABELS = ['name', 'extras', 'extensions']; // componentTypes; properties of stored accessors that are kept
const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
const REPEAT = {repeat: 10497, clamp: 33071, mirror: 33648}, LINEAR = [9729, 9987], NEAREST = [9728, 9728];
const PBR = 'pbrMetallicRoughness', COLOURS = ['base_colour', 'alpha'];
const three = (/** @type {string} */ name) => [name, name, name];
const SURFACE = ['occlusion', 'roughness', 'metallic'], COAT = ['clearcoat', 'clearcoat_roughness'], SHEEN = [...three('sheen_colour'), 'sheen_roughness'];
const SPECULAR = [...three('specular_colour'), 'specular'], VOLUME = ['transmission', 'thickness'], FILM = ['iridescence', 'iridescence_thickness'];
const DIFFUSE = [...three('diffuse_transmission_colour'), 'diffuse_transmission'];

/** Texture slots of glTF: the object in a material that has it ("" for itself), its name, which channels it shows, and what its picture holds.
 * @type {[string, string, string[], string[]][]} */
const SLOTS = [
  [PBR, 'baseColorTexture', COLOURS, [...three('base_colour'), 'alpha']],
  [PBR, 'metallicRoughnessTexture', ['roughness', 'metallic'], SURFACE],
  ['', 'occlusionTexture', ['occlusion'], SURFACE],
  ['', 'normalTexture', ['normal'], ['normal', 'normal']],
  ['', 'emissiveTexture', ['emissive'], three('emissive')],
  ['KHR_materials_clearcoat', 'clearcoatTexture', ['clearcoat'], COAT],
  ['KHR_materials_clearcoat', 'clearcoatRoughnessTexture', ['clearcoat_roughness'], COAT],
  ['KHR_materials_clearcoat', 'clearcoatNormalTexture', ['clearcoat_normal'], ['clearcoat_normal', 'clearcoat_normal']],
  ['KHR_materials_sheen', 'sheenColorTexture', ['sheen_colour'], SHEEN],
  ['KHR_materials_sheen', 'sheenRoughnessTexture', ['sheen_roughness'], SHEEN],
  ['KHR_materials_specular', 'specularTexture', ['specular'], SPECULAR],
  ['KHR_materials_specular', 'specularColorTexture', ['specular_colour'], SPECULAR],
  ['KHR_materials_transmission', 'transmissionTexture', ['transmission'], VOLUME],
  ['KHR_materials_volume', 'thicknessTexture', ['thickness'], VOLUME],
  ['KHR_materials_iridescence', 'iridescenceTexture', ['iridescence'], FILM],
  ['KHR_materials_iridescence', 'iridescenceThicknessTexture', ['iridescence_thickness'], FILM],
  ['KHR_materials_anisotropy', 'anisotropyTexture', ['anisotropy'], three('anisotropy')],
  ['KHR_materials_diffuse_transmission', 'diffuseTransmissionTexture', ['diffuse_transmission'], DIFFUSE],
  ['KHR_materials_diffuse_transmission', 'diffuseTransmissionColorTexture', ['diffuse_transmission_colour'], DIFFUSE],
];

/** Whether a file has coded primitives. @param {any} root */
export const isContainer = (root) => root.extensions?.[NAME]?.streams !== undefined;

/** Whether a stream gives the image of a texture, whose own is at most a fallback: slots with it show the stream. @param {any} root @param {number} number */
export function isEmpty(root, number) {
  const texture = entryOf(root, 'textures', number);
  return NAME in (texture.extensions ?? {}) || [texture, ...Object.values(texture.extensions ?? {})].every((place) => place?.source === undefined);
}

/**
 * Decodes the streams of a file and changes its tree: coded primitives get accessors, their materials textures. A primitive whose units
 * lie in several fields becomes one for each, but one for all fields of an atlas.
 *
 * @param {any} root @param {ViewOf} viewOf @param {(stream: Uint8Array) => Promise<Asset>} decode
 * @param {{onRefused?: (error: unknown) => void, Atlas?: typeof import('./atlas.js').Atlas|null}} [options] onRefused: called for a stream that is
 *   refused and whose primitives all have a fallback, which they then become; without it the promise is rejected. Atlas: makes fields over
 *   voxels pictures; without it they are in `voxels`
 * @returns {Promise<Unfolded>} rejected with a TexfError
 */
export async function unfold(root, viewOf, decode, {onRefused, Atlas = null} = {}) {
  const {streams} = /** @type {{streams: number[]}} */ (root.extensions[NAME]);
  checkTree(root);
  checkViews(root, streams);
  const coded = /** @type {any[]} */ (root.meshes ?? []).flatMap(({primitives}) => primitives ?? []).flatMap(({extensions}) => extensions?.[NAME] ?? []);
  const assets = await Promise.all(streams.map(async (number, n) => decode(await viewOf(number)).catch((error) => {
    if (!onRefused || coded.some(({stream, fallback}) => stream === n && fallback !== true)) throw error;
    onRefused(error);
    return null;
  })));
  const unfolding = new Unfolding(root, assets, viewOf, Atlas);
  for (const mesh of root.meshes ?? []) {
    const plain = [];
    for (const primitive of mesh.primitives ?? []) plain.push(...(primitive.extensions?.[NAME] ? await unfolding.primitive(primitive) : [primitive]));
    mesh.primitives = plain;
  }
  unfolding.surfaces.forEach((surface) => surface?.atlas?.finish());
  return {views: unfolding.added.views, pictures: unfolding.pictures, voxels: unfolding.voxels};
}

class Unfolding {
  /** @param {any} root @param {(Asset|null)[]} assets null for streams that were refused @param {ViewOf} viewOf @param {typeof import('./atlas.js').Atlas|null} Atlas */
  constructor(root, assets, viewOf, Atlas) {
    this.root = root;
    this.assets = assets;
    this.viewOf = viewOf;
    this.added = new Added(root);
    this.materials = structuredClone(root.materials ?? []);
    this.surfaces = assets.map((asset) => /** @type {Surface} */ (asset && new Surface(asset)));
    this.Atlas = Atlas;
    /** @type {Unfolded['pictures']} */
    this.pictures = new Map();
    /** @type {Map<number, VoxelLook>} */
    this.voxels = new Map();
    /** @type {Map<string, Look>} */
    this.looks = new Map();
    /** @type {Map<string, number|null>} */
    this.textures = new Map();
    /** @type {Set<string>} */
    this.taken = new Set();
  }

  /** The plain primitives that a coded one becomes. @param {any} primitive @returns {Promise<any[]>} */
  async primitive(primitive) {
    if (this.assets[primitive.extensions[NAME]?.stream] === null) return [this.fallback(primitive)];
    const coded = await this.read(primitive), {units} = this.assetOf(coded), stored = await this.stored(primitive);
    const corners = this.surfaces[coded.stream].cornersOf(coded, stored.count);
    const fields = [...new Set(coded.units.map((unit) => units[unit].field))], atlas = this.atlasOf(coded.stream);
    const voxels = atlas ? fields.filter((field) => !atlas.asset.fields[field].planar) : [];
    return fields.filter((field) => !voxels.includes(field) || field === voxels[0]).map((field) => {
      const look = this.look(coded, field), plain = structuredClone(primitive);
      plain.attributes = {};
      without(plain, NAME);
      if (look.number !== undefined) plain.material = look.number;
      const needsNormals = look.hasNormals || (primitive.targets ?? []).some((/** @type {any} */ target) => 'NORMAL' in target);
      const hasTangents = look.hasNormals && !look.isVoxels && 'TANGENT' in primitive.attributes; // viewers draw a source without them
      const {values, index, vertex} = this.surfaces[coded.stream].patch(coded, voxels.includes(field) ? voxels : [field], corners, {needsNormals, hasTangents, isMapped: look.isMapped});
      if (look.isVoxels) plain.attributes[PLACE] = this.added.addAccessor(values.place, 'VEC3', {}, ARRAY);
      this.write(plain, values, look, coded.texCoord);
      for (const {owner, name, entry, array} of stored.arrays) this.repeat(owner === null ? plain.attributes : plain.targets[owner], name, entry, array, vertex, owner !== null);
      const Index = values.position.length / 3 <= 65535 ? Uint16Array : Uint32Array;
      plain.indices = this.added.addAccessor(Index.from(index), 'SCALAR', {}, INDICES);
      return plain;
    });
  }

  /** @param {{stream: number}} coded */
  assetOf({stream}) {
    return /** @type {Asset} */ (this.assets[stream]);
  }

  /** A coded primitive whose own attributes are shown, and the images of its textures. @param {any} primitive */
  fallback(primitive) {
    for (const {owner, slot} of this.slotsOf(this.root.materials?.[primitive.material] ?? {})) without(entryOf(this.root, 'textures', owner[slot].index), NAME);
    without(primitive, NAME);
    return primitive;
  }

  /** The atlas of the faces of a stream over voxels that have a texture of it, null without. @param {number} stream */
  atlasOf(stream) {
    const surface = this.surfaces[stream], {units, fields} = surface.asset;
    if (!this.Atlas || surface.atlas) return surface.atlas;
    const coded = (this.root.meshes ?? []).flatMap((/** @type {any} */ mesh) => mesh.primitives ?? []).filter((/** @type {any} */ {extensions}) => extensions?.[NAME]?.stream === stream);
    const mapped = coded.filter((/** @type {any} */ {material}) => material !== undefined && this.slotsOf(this.materials[material] ?? {}).length > 0).flatMap((/** @type {any} */ {extensions}) => extensions[NAME].units);
    const numbers = [...units.keys()].filter((unit) => !fields[units[unit].field].planar && mapped.includes(unit));
    if (numbers.length) surface.atlas = new this.Atlas(surface.asset, numbers);
    return surface.atlas;
  }

  /** What the extension says of a primitive, checked. @param {any} primitive @returns {Promise<Coded>} */
  async read(primitive) {
    const {stream, units, matrix = IDENTITY, texCoord = 0, splits, fallback = false} = primitive.extensions[NAME] ?? {}, asset = isIndex(stream) && this.assets[stream];
    if (!asset) throw invalid('a primitive names a stream that is not there');
    if (!Array.isArray(units) || !units.length || !units.every((unit) => isIndex(unit) && unit < asset.units.length)) throw invalid('a primitive names a unit that is not there');
    for (const unit of units) {
      if (this.taken.has(`${stream} ${unit}`)) throw invalid('two primitives consist of one unit of a stream');
      this.taken.add(`${stream} ${unit}`);
    }
    if (!Array.isArray(matrix) || matrix.length !== 16 || !matrix.every(Number.isFinite)) throw invalid('the matrix of a primitive does not have 16 numbers');
    if (!isIndex(texCoord)) throw invalid("'texCoord' of a primitive is not an index");
    if (typeof fallback !== 'boolean' || (fallback && (splits !== undefined || primitive.targets?.length))) throw invalid('a primitive with a fallback has splits or targets');
    const pairs = splits === undefined ? null : entryOf(this.root, 'accessors', splits);
    if (pairs && (pairs.type !== 'VEC2' || !UNSIGNED.includes(pairs.componentType))) throw invalid('splits of a primitive are not pairs of unsigned integers');
    return {primitive, stream, units, matrix, texCoord, splits: splits === undefined ? null : await readAccessor(this.root, splits, this.viewOf)};
  }

  /** Stored attributes and targets of a primitive, and the number of their values, null without any. @param {any} primitive */
  async stored(primitive) {
    if (primitive.extensions[NAME].fallback) return {arrays: [], count: null};
    const arrays = [];
    for (const [owner, names] of [[null, primitive.attributes ?? {}], ...(primitive.targets ?? []).entries()]) {
      for (const [name, number] of Object.entries(names)) {
        const entry = entryOf(this.root, 'accessors', number);
        if (owner !== null || 'bufferView' in entry || 'sparse' in entry) arrays.push({owner, name, entry, array: await readAccessor(this.root, number, this.viewOf)});
      }
    }
    const [first] = arrays;
    if (arrays.some(({entry}) => entry.count !== first.entry.count)) throw invalid('the stored attributes of a primitive differ in count');
    return {arrays, count: first ? /** @type {number} */ (first.entry.count) : null};
  }

  /** @param {any} plain @param {import('./surface.js').Columns} values @param {Look} look @param {number} texCoord */
  write(plain, {position, normal, tangent, uv}, look, texCoord) {
    const low = [Infinity, Infinity, Infinity], high = low.map((v) => -v);
    position.forEach((value, i) => {
      low[i % 3] = Math.min(low[i % 3], value);
      high[i % 3] = Math.max(high[i % 3], value);
    });
    if (![...low, ...high].every(Number.isFinite)) throw invalid('the matrix of a primitive takes positions beyond binary32');
    plain.attributes.POSITION = this.added.addAccessor(position, 'VEC3', {min: low, max: high}, ARRAY);
    if (normal) plain.attributes.NORMAL = this.added.addAccessor(normal, 'VEC3', {}, ARRAY);
    if (tangent) plain.attributes.TANGENT = this.added.addAccessor(tangent, 'VEC4', {}, ARRAY);
    if (uv && look.isMapped) plain.attributes[`TEXCOORD_${texCoord}`] = this.added.addAccessor(uv, 'VEC2', {}, ARRAY);
  }

  /** Adds an attribute with the values of stored vertices. @param {any} attributes @param {string} name @param {any} entry @param {Values} array
   * @param {Uint32Array} vertex stored vertex of each vertex @param {boolean} isTarget */
  repeat(attributes, name, entry, array, vertex, isTarget) {
    if (Object.hasOwn(attributes, name) && !isTarget) return;
    const {type, min, sparse, bufferView} = entry, width = {SCALAR: 1, VEC2: 2, VEC3: 3}[/** @type {string} */ (type)] ?? 4, values = new /** @type {any} */ (array.constructor)(vertex.length * width);
    vertex.forEach((from, i) => values.set(array.subarray(from * width, (from + 1) * width), i * width));
    const properties = Object.fromEntries(LABELS.filter((key) => key in entry).map((key) => [key, entry[key]]));
    if (entry.normalized) properties.normalized = true;
    if (isTarget && min) {
      const columns = Array.from({length: width}, (_, c) => values.filter((/** @type {number} */ _v, /** @type {number} */ i) => i % width === c));
      const extreme = (/** @type {(a: number, b: number) => number} */ pick) => columns.map((column) => column.reduce(pick));
      Object.assign(properties, {min: extreme((a, b) => Math.min(a, b)), max: extreme((a, b) => Math.max(a, b))});
    }
    const isSparse = isTarget && (sparse || bufferView === undefined);
    attributes[name] = isSparse ? this.addSparse(values, type, width, properties) : this.added.addAccessor(values, type, properties, ARRAY);
  }

  /** Adds an accessor without the rows that are 0, if those are the most. @param {any} values @param {string} type @param {number} width @param {any} properties */
  addSparse(values, type, width, properties) {
    const count = values.length / width, rows = [];
    for (let i = 0; i < count; i++) if (values.subarray(i * width, (i + 1) * width).some((/** @type {number} */ v) => v !== 0)) rows.push(i);
    const number = this.added.addAccessor(values, type, properties, ARRAY);
    if (2 * rows.length >= count) return number;
    const {bufferView, ...entry} = this.root.accessors[number], kept = new values.constructor(rows.length * width);
    this.root.bufferViews.length = bufferView; // the last that was added
    this.added.views.delete(bufferView);
    rows.forEach((row, i) => kept.set(values.subarray(row * width, (row + 1) * width), i * width));
    const sparse = rows.length ? {sparse: {count: rows.length, indices: {bufferView: this.added.addView(Uint32Array.from(rows)), componentType: 5125},
      values: {bufferView: this.added.addView(kept)}}} : {};
    this.root.accessors[number] = {...entry, ...sparse};
    return number;
  }

  /** Texture slots of a material that show a stream. @param {any} entry */
  slotsOf(entry) {
    return SLOTS.map(([place, slot, channels, picture]) => ({owner: place === '' ? entry : place === PBR ? entry[place] : entry.extensions?.[place], slot, channels, picture}))
      .filter(({owner, slot}) => owner?.[slot] && isEmpty(this.root, owner[slot].index));
  }

  /** The material of a coded primitive on a field: that of the file, or a copy if another field has changed it. @param {Coded} coded @param {number} field @returns {Look} */
  look({primitive, stream, units, matrix}, field) {
    const asset = this.assetOf({stream}), {planar, planes} = asset.fields[field], isVoxels = !planar && !this.Atlas, {material: number} = primitive;
    if (number === undefined) return {isMapped: false, hasNormals: false, isVoxels: false};
    const entry = structuredClone(this.materials[number] ?? entryOf(this.root, 'materials', number));
    const material = asset.materials[asset.units[/** @type {number} */ (units.find((unit) => asset.units[unit].field === field))].material];
    const has = (/** @type {string} */ name) => COLOURS.includes(name) || material.channels.some((channel) => channel.replace('_object', '') === name);
    const slots = this.slotsOf(entry);
    const shown = slots.map((slot) => ({...slot, names: slot.channels.filter(has).map((name) => (!planar && name.endsWith('normal') ? `${name}_object` : name)).filter((name) => name in planes)}));
    const names = shown.flatMap((slot) => slot.names), hasNormals = names.some((name) => name.includes('normal'));
    const key = slots.length ? `${number} ${stream} ${planar || isVoxels ? field : 'atlas'} ${!isVoxels ? '' : hasNormals ? matrix : inverseTranspose(matrix).determinant}` : `${number}`;
    const known = this.looks.get(key);
    if (known) return known;
    const isFirst = ![...this.looks.values()].some((look) => look.number === number);
    const look = {number: isFirst ? number : this.added.add('materials', entry), isMapped: names.length > 0, hasNormals, isVoxels: names.length > 0 && isVoxels};
    if (isFirst) this.root.materials[number] = entry;
    if (look.isVoxels) this.voxels.set(look.number, {asset, field, material, channels: names, matrix});
    else for (const {owner, slot, picture, names: held} of shown) this.refer(owner, slot, held.length ? this.texture(stream, field, picture) : null, primitive.extensions[NAME].texCoord);
    this.looks.set(key, look);
    return look;
  }

  /** Makes a texture slot show a texture of the stream. @param {any} owner @param {string} slot @param {number|null} texture @param {number} texCoord */
  refer(owner, slot, texture, texCoord) {
    if (texture === null) {
      delete owner[slot];
      return;
    }
    owner[slot].index = texture;
    delete owner[slot].texCoord;
    if (texCoord) owner[slot].texCoord = texCoord;
    without(owner[slot], 'KHR_texture_transform');
  }

  /** The texture of a picture of a field over texels. @param {number} stream @param {number} field @param {string[]} channels */
  texture(stream, field, channels) {
    const asset = this.assetOf({stream}), atlas = asset.fields[field].planar ? null : this.atlasOf(stream), key = `${stream} ${atlas ? 'atlas' : field} ${channels}`;
    const before = this.textures.get(key);
    if (before !== undefined) return before;
    const picture = atlas ? atlas.picture(channels) : pictureOf(asset.fields[field], channels), squares = /** @type {any} */ (asset.metadata)?.nearest_fields;
    const [magFilter, minFilter] = Array.isArray(squares) && squares.includes(field) ? NEAREST : LINEAR, [wrapS, wrapT] = asset.fields[field].wrap.map((wrap) => REPEAT[atlas ? 'clamp' : wrap]);
    const sampler = {magFilter, minFilter, wrapS, wrapT}, text = JSON.stringify(sampler);
    const same = (this.root.samplers ?? []).findIndex((/** @type {any} */ known) => JSON.stringify(known) === text);
    const number = picture && this.added.add('textures', {sampler: same < 0 ? this.added.add('samplers', sampler) : same});
    if (picture && number !== null) this.pictures.set(number, Object.assign(picture, {isColour: channels.some((name) => /colour|emissive/.test(name ?? ''))}));
    this.textures.set(key, number);
    return number;
  }
}
