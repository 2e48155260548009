/** References in the JSON tree of a glTF file: where one entry names another by its number. One table has the shapes that a tree must have. */

import {invalid, isIndex, MESHOPT, NAME} from './accessors.js';

/** @typedef {{owner: any, key: string|number, kind: string}} Reference owner[key] is the number of an entry of the array `kind` */

const DRACO = 'KHR_draco_mesh_compression', INSTANCES = 'EXT_mesh_gpu_instancing', VARIANTS = 'KHR_materials_variants', MOST_LEVELS = 100;
/** Extensions whose references to accessors, bufferViews and textures are known here, or that have none. */
const KNOWN = ['KHR_materials_', 'KHR_texture_', 'EXT_texture_', 'KHR_xmp', 'KHR_lights_', 'KHR_animation_pointer', 'KHR_node_', DRACO, 'KHR_mesh_quantization',
  'MSFT_texture_dds', 'MSFT_lod', INSTANCES, NAME, ...MESHOPT];

// Shapes: an object, whose key "*" stands for all others; an array; a type; the name of an array that a number refers to.
const VIEW = {bufferView: 'bufferViews'}, ACCESSORS = {'*': 'accessors'}, TEXTURE_INFO = {index: 'textures', extensions: {KHR_texture_transform: {}}};
const MATERIAL = {}; // all that textureInfos() yields
const PRIMITIVE = {attributes: ACCESSORS, targets: [ACCESSORS], indices: 'accessors', material: 'materials',
  extensions: {[DRACO]: VIEW, [NAME]: {splits: 'accessors'}, [VARIANTS]: {mappings: [{material: 'materials'}]}}};
const ANIMATION = {samplers: [{input: 'accessors', output: 'accessors'}], channels: [{sampler: Number, target: {path: String, extensions: {KHR_animation_pointer: {}}}}]};
/** @type {Object<string, any>} */
const SHAPES = {
  accessors: [{...VIEW, type: String, componentType: Number, sparse: {indices: VIEW, values: VIEW}}],
  bufferViews: [{byteLength: Number, extensions: Object.fromEntries([NAME, ...MESHOPT].map((name) => [name, {}]))}],
  buffers: [{}],
  images: [VIEW],
  samplers: [{}],
  textures: [{sampler: 'samplers', source: 'images', extensions: {'*': {source: 'images'}}}],
  materials: [MATERIAL],
  meshes: [{primitives: [PRIMITIVE]}],
  skins: [{inverseBindMatrices: 'accessors'}],
  animations: [ANIMATION],
  scenes: [{extensions: {[NAME]: VIEW}}],
  nodes: [{extensions: {[INSTANCES]: {attributes: ACCESSORS}}}],
  extensions: {[NAME]: {streams: ['bufferViews']}},
  extensionsUsed: [String],
  extensionsRequired: [String],
};

/** @param {any} value */
const isObject = (value) => Boolean(value) && typeof value === 'object' && !Array.isArray(value);

/** All references of a tree. @param {any} root @returns {Generator<Reference>} throws a TexfError TXF-I09 where the tree has other types, or a number is of no entry */
export function* references(root) {
  for (const reference of walk({root}, 'root', SHAPES, 'root')) {
    const {owner, key, kind} = reference;
    if (!isIndex(owner[key]) || !(owner[key] < root[kind]?.length)) throw invalid(`'${key}' refers to ${kind} that are not there`);
    yield reference;
  }
}

/** @param {any} owner @param {string|number} key @param {any} shape of owner[key] @param {string|number} name of the property @returns {Generator<Reference>} */
function* walk(owner, key, shape, name) {
  const value = owner[key];
  if (typeof shape === 'string') yield {owner, key, kind: shape};
  else if (shape === Number || shape === String ? !(shape === Number ? isIndex(value) : typeof value === 'string') : Array.isArray(shape) ? !Array.isArray(value) : !isObject(value))
    throw invalid(`'${name}' has another type than glTF has there`);
  else if (Array.isArray(shape)) for (const n of value.keys()) yield* walk(value, n, shape[0], name);
  else if (shape === MATERIAL) for (const info of textureInfos(value)) yield* walk([info], 0, TEXTURE_INFO, name);
  else {
    for (const part of '*' in shape ? Object.keys(value) : Object.keys(shape).filter((known) => Object.hasOwn(value, known)))
      yield* walk(value, part, Object.hasOwn(shape, part) ? shape[part] : shape['*'], part);
  }
}

/** The textureInfo objects of a material or a part of it, also those of extensions that are not known here. @param {any} entry @returns {Generator<any>} */
function* textureInfos(entry) {
  for (const [key, value] of isObject(entry) ? Object.entries(entry) : []) {
    if (key.endsWith('Texture') && isObject(value) && 'index' in value) yield value;
    else if (key !== 'extras') yield* textureInfos(value);
  }
}

/** Throws a TexfError TXF-I09 for a tree that is too deep for functions that recurse, or that has other types than glTF has. @param {any} root */
export function checkTree(root) {
  let level = [root];
  for (let i = 0; i < MOST_LEVELS; i++) level = level.flatMap((value) => Object.values(value).filter((child) => child && typeof child === 'object'));
  if (level.length) throw invalid('objects and arrays are nested too deeply');
  Array.from(references(root));
}

/** Whether a file uses an extension whose references are not known here. @param {any} root */
export const hasUnknown = (root) => [...root.extensionsUsed ?? [], ...extensionNames(root)].some((name) => !KNOWN.some((known) => name.startsWith(known)));

/** Names of extensions in a tree, also of those that the file does not declare. @param {any} value @returns {string[]} */
function extensionNames(value) {
  const own = isObject(value) && isObject(value.extensions) ? Object.keys(value.extensions) : [];
  return [...own, ...Object.values(value).flatMap((child) => (child && typeof child === 'object' ? extensionNames(child) : []))];
}
