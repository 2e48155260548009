/** The JSON tree of a glTF file: references, accessors, and bufferViews that are stored deflated (docs/guide/TEXF_stream.md). */

import {TexfError} from './engine.js';

/** @typedef {(number: number) => Promise<Uint8Array>} ViewOf bytes of a bufferView, decompressed */
/** @typedef {Int8Array|Uint8Array|Int16Array|Uint16Array|Uint32Array|Float32Array} Values */

export const NAME = 'TEXF_stream', ARRAY = 34962, INDICES = 34963; // targets of bufferViews
/** @type {Object<number, any>} */
const KINDS = {5120: Int8Array, 5121: Uint8Array, 5122: Int16Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array};
/** @type {Object<string, number>} */
const WIDTHS = {SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4};
const MOST_BYTES = 2 ** 30, MOST_IMPLICIT = 2 ** 24; // bytes of a view, and elements of an accessor without one

/** @param {string} message @param {string} finding */
export const invalid = (message, finding = 'TXF-I09') => new TexfError('invalid', message, {finding});

/** @param {any} value @returns {value is number} */
export const isIndex = (value) => Number.isSafeInteger(value) && value >= 0;

/** What a function gives; a tree that is not as glTF has it is a TexfError. @template T @param {() => Promise<T>} work @returns {Promise<T>} */
export async function wellFormed(work) {
  try {
    return await work();
  } catch (error) {
    if (error instanceof TypeError) throw invalid(`the file is not as glTF has it: ${error.message}`);
    throw error;
  }
}

/** An entry of an array of the tree. @param {any} root @param {string} kind @param {any} number @returns {any} */
export function entryOf(root, kind, number) {
  const entry = isIndex(number) && Array.isArray(root[kind]) ? root[kind][number] : null;
  if (!entry || typeof entry !== 'object') throw invalid(`${kind} ${number} is not in the file`);
  return entry;
}

/** Values of an accessor, as they are stored, row after row. @param {any} root @param {any} number @param {ViewOf} viewOf @returns {Promise<Values>} */
export async function readAccessor(root, number, viewOf) {
  const {count, type, componentType, sparse, ...place} = entryOf(root, 'accessors', number), Kind = KINDS[componentType], width = WIDTHS[type];
  if (!Kind || !width || !isIndex(count) || count < 1) throw invalid(`accessor ${number} has an unexpected type or count`);
  if (!('bufferView' in place) && count > MOST_IMPLICIT) throw new TexfError('limit', `accessor ${number} has too many elements`, {finding: 'TXF-I41', value: count, allowed: MOST_IMPLICIT});
  const rows = async (/** @type {any} */ from, /** @type {any} */ Type, /** @type {number} */ size, /** @type {number} */ many) => {
    const {byteStride: stride = size} = entryOf(root, 'bufferViews', from.bufferView), {byteOffset: offset = 0} = from;
    const bytes = await viewOf(from.bufferView);
    if (!isIndex(offset) || !(stride >= size) || offset + stride * (many - 1) + size > bytes.length) throw invalid(`accessor ${number} exceeds its bufferView`, 'TXF-I11');
    const out = new Uint8Array(many * size);
    for (let i = 0; i < many; i++) out.set(bytes.subarray(offset + i * stride, offset + i * stride + size), i * size);
    return new Type(out.buffer);
  };
  const values = 'bufferView' in place ? await rows(place, Kind, width * Kind.BYTES_PER_ELEMENT, count) : new Kind(count * width);
  if (sparse) {
    const Type = KINDS[sparse.indices?.componentType];
    if (!Type || !isIndex(sparse.count) || sparse.count > count) throw invalid(`accessor ${number} has sparse values of an unexpected type or count`);
    const places = await rows(sparse.indices, Type, Type.BYTES_PER_ELEMENT, sparse.count);
    const taken = await rows(sparse.values ?? {}, Kind, width * Kind.BYTES_PER_ELEMENT, sparse.count);
    places.forEach((/** @type {number} */ row, /** @type {number} */ i) => {
      if (row >= count) throw invalid(`accessor ${number} has a sparse index beyond its end`, 'TXF-I11');
      values.set(taken.subarray(i * width, (i + 1) * width), row * width);
    });
  }
  return values;
}

/** A bufferView that is stored deflated: planes of bytes, each the difference to the row before.
 * @param {Uint8Array} packed @param {any} view the bufferView @param {number} number of it @returns {Promise<Uint8Array>} */
export async function inflated(packed, view, number) {
  const {byteLength} = view, {row} = view.extensions[NAME];
  if (!isIndex(byteLength) || !isIndex(row) || byteLength < 1 || row < 1 || byteLength % row) throw invalid(`bufferView ${number} has no whole rows`);
  if (byteLength > MOST_BYTES) throw new TexfError('limit', `bufferView ${number} is too large`, {finding: 'TXF-I41', value: byteLength, allowed: MOST_BYTES});
  const planes = await unzipped(packed, byteLength, number), out = new Uint8Array(byteLength), count = byteLength / row;
  for (let b = 0; b < row; b++) {
    for (let n = 0, value = 0; n < count; n++) out[n * row + b] = value = (value + planes[b * count + n]) & 255;
  }
  return out;
}

/** @param {Uint8Array} packed zlib data @param {number} length that it must have @param {number} number of the bufferView */
async function unzipped(packed, length, number) {
  const out = new Uint8Array(length), reader = new Blob([/** @type {any} */ (packed)]).stream().pipeThrough(new DecompressionStream('deflate')).getReader();
  let at = 0;
  for (;;) {
    const {done, value} = await reader.read().catch(() => {
      throw invalid(`bufferView ${number} cannot be inflated`, 'TXF-I11');
    });
    if (done) break;
    if (at + value.length > length) await reader.cancel().catch(() => {});
    if (at + value.length > length) throw invalid(`bufferView ${number} inflates to more than ${length} bytes`, 'TXF-I11');
    out.set(value, at);
    at += value.length;
  }
  if (at < length) throw invalid(`bufferView ${number} inflates to ${at} bytes, not ${length}`, 'TXF-I11');
  return out;
}

/** A part of a buffer. @param {Uint8Array} buffer @param {any} place with byteOffset and byteLength @param {number} number of the bufferView */
export function within(buffer, {byteOffset = 0, byteLength}, number) {
  if (!isIndex(byteOffset) || !isIndex(byteLength) || byteOffset + byteLength > buffer.length) throw invalid(`bufferView ${number} exceeds its buffer`, 'TXF-I11');
  return buffer.subarray(byteOffset, byteOffset + byteLength);
}

/** Takes an extension out of an object. @param {any} owner @param {string} name */
export function without(owner, name) {
  delete owner.extensions?.[name];
  if (owner.extensions && !Object.keys(owner.extensions).length) delete owner.extensions;
}

/** Adds entries to a glTF file: the tree is changed, and the bytes of added bufferViews are kept by their numbers. */
export class Added {
  /** @param {any} root */
  constructor(root) {
    this.root = root;
    /** @type {Map<number, Uint8Array>} */
    this.views = new Map();
  }

  /** @param {string} kind @param {any} entry @returns {number} its number */
  add(kind, entry) {
    return (this.root[kind] ??= []).push(entry) - 1;
  }

  /** @param {Values} values @param {any} properties */
  addView(values, properties = {}) {
    const number = this.add('bufferViews', {buffer: 0, byteLength: values.byteLength, ...properties});
    this.views.set(number, new Uint8Array(values.buffer, values.byteOffset, values.byteLength));
    return number;
  }

  /** @param {Values} values @param {string} type @param {any} properties of the accessor @param {number} [target] of its bufferView @returns {number} */
  addAccessor(values, type, properties = {}, target) {
    const width = WIDTHS[type], size = width * values.BYTES_PER_ELEMENT, count = values.length / width, {constructor: kind} = values;
    const componentType = Number(Object.keys(KINDS).find((key) => KINDS[Number(key)] === kind));
    const more = target === undefined ? {} : {target}, stride = size + (-size & 3);
    let view = values;
    if (target === ARRAY && stride !== size) {
      const padded = new Uint8Array(count * stride), bytes = new Uint8Array(values.buffer, values.byteOffset, values.byteLength);
      for (let i = 0; i < count; i++) padded.set(bytes.subarray(i * size, (i + 1) * size), i * stride);
      view = padded;
      Object.assign(more, {byteStride: stride});
    }
    return this.add('accessors', {bufferView: this.addView(view, more), componentType, count, type, ...properties});
  }
}
