/** The JSON tree of a glTF file: references, accessors, and bufferViews that are stored deflated (docs/guide/TEXF_stream.md). */

import {TexfError} from './engine.js';

/** @typedef {(number: number) => Promise<Uint8Array>} ViewOf bytes of a bufferView, decompressed */
/** @typedef {Int8Array|Uint8Array|Int16Array|Uint16Array|Uint32Array|Float32Array} Values */

export const NAME = 'TEXF_stream', MESHOPT = ['EXT_meshopt_compression', 'KHR_meshopt_compression'], ARRAY = 34962, INDICES = 34963; // targets of bufferViews
/** @type {Map<any, any>} */
const KINDS = new Map(/** @type {[number, any][]} */ ([[5120, Int8Array], [5121, Uint8Array], [5122, Int16Array], [5123, Uint16Array], [5125, Uint32Array], [5126, Float32Array]]));
/** @type {Map<any, number>} */
const WIDTHS = new Map([['SCALAR', 1], ['VEC2', 2], ['VEC3', 3], ['VEC4', 4]]);
const ROWS = [5121, 5123, 5125]; // componentTypes of sparse indices
const MOST_BYTES = 2 ** 30, MOST_IMPLICIT = 2 ** 24, MOST_RATIO = 1032; // bytes of all deflated views, elements of an accessor without a view, bytes of one in zlib data

/** @param {string} message @param {string} finding */
export const invalid = (message, finding = 'TXF-I09') => new TexfError('invalid', message, {finding});

/** @param {any} value @returns {value is number} */
export const isIndex = (value) => Number.isSafeInteger(value) && value >= 0;

/** What a function gives; an error that no check has foreseen is a TexfError too. @template T @param {() => Promise<T>} work @returns {Promise<T>} */
export async function wellFormed(work) {
  try {
    return await work();
  } catch (error) {
    if (error instanceof TypeError) throw new TexfError('internal', `an unexpected error: ${error.message}`);
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
  const {count, type, componentType, sparse, ...place} = entryOf(root, 'accessors', number), Kind = KINDS.get(componentType), width = WIDTHS.get(type);
  if (!Kind || !width || !isIndex(count) || count < 1) throw invalid(`accessor ${number} has an unexpected type or count`);
  if (!('bufferView' in place) && count > MOST_IMPLICIT) throw new TexfError('limit', `accessor ${number} has too many elements`, {finding: 'TXF-I41', value: count, allowed: MOST_IMPLICIT});
  const rows = async (/** @type {any} */ from, /** @type {any} */ Type, /** @type {number} */ size, /** @type {number} */ many) => {
    const {byteStride: stride = size} = entryOf(root, 'bufferViews', from.bufferView), {byteOffset: offset = 0} = from;
    const bytes = await viewOf(from.bufferView);
    if (!isIndex(offset) || !isIndex(stride) || stride < size || offset + stride * (many - 1) + size > bytes.length) throw invalid(`accessor ${number} exceeds its bufferView`, 'TXF-I11');
    const out = new Uint8Array(many * size);
    for (let i = 0; i < many; i++) out.set(bytes.subarray(offset + i * stride, offset + i * stride + size), i * size);
    return new Type(out.buffer);
  };
  const values = 'bufferView' in place ? await rows(place, Kind, width * Kind.BYTES_PER_ELEMENT, count) : new Kind(count * width);
  if (sparse) {
    const Type = ROWS.includes(sparse.indices?.componentType) ? KINDS.get(sparse.indices.componentType) : null;
    if (!Type || !isIndex(sparse.count) || sparse.count < 1 || sparse.count > count) throw invalid(`accessor ${number} has sparse values of an unexpected type or count`);
    const places = await rows(sparse.indices, Type, Type.BYTES_PER_ELEMENT, sparse.count);
    const taken = await rows(sparse.values ?? {}, Kind, width * Kind.BYTES_PER_ELEMENT, sparse.count);
    places.forEach((/** @type {number} */ row, /** @type {number} */ i) => {
      if (row >= count) throw invalid(`accessor ${number} has a sparse index beyond its end`, 'TXF-I11');
      values.set(taken.subarray(i * width, (i + 1) * width), row * width);
    });
  }
  return values;
}

/** Where a file has the bytes of a bufferView, compressed or not: an object with buffer, byteOffset and byteLength. @param {any} view @returns {any} */
export const placeOf = (view) => [NAME, ...MESHOPT].map((name) => view.extensions?.[name]).find(Boolean) ?? view;

/** Throws a TexfError where a small file asks for any amount of work: where streams overlap, or deflated views have too many bytes.
 * @param {any} root @param {number[]} streams bufferViews */
export function checkViews(root, streams) {
  const deflated = (root.bufferViews ?? []).reduce((/** @type {number} */ sum, /** @type {any} */ view) => sum + (view.extensions?.[NAME] ? view.byteLength : 0), 0);
  if (deflated > MOST_BYTES) throw new TexfError('limit', 'the deflated bufferViews are too large', {finding: 'TXF-I41', value: deflated, allowed: MOST_BYTES});
  const places = streams.map((number) => {
    const {buffer, byteOffset = 0, byteLength} = placeOf(entryOf(root, 'bufferViews', number));
    if (![buffer, byteOffset, byteLength].every(isIndex)) throw invalid(`bufferView ${number} has no whole numbers`);
    return {buffer, begin: byteOffset, end: byteOffset + byteLength};
  }).sort((a, b) => a.buffer - b.buffer || a.begin - b.begin || a.end - b.end);
  if (places.some(({buffer, begin}, i) => i > 0 && buffer === places[i - 1].buffer && begin < places[i - 1].end)) throw invalid('streams overlap');
}

/** A bufferView that is stored deflated: planes of bytes, each the difference to the row before.
 * @param {Uint8Array} packed @param {any} view the bufferView @param {number} number of it @returns {Promise<Uint8Array>} */
export async function inflated(packed, view, number) {
  const {byteLength} = view, {row} = view.extensions[NAME];
  if (!isIndex(byteLength) || !isIndex(row) || byteLength < 1 || row < 1) throw invalid(`bufferView ${number} has no rows`);
  if (byteLength % row || byteLength > MOST_RATIO * packed.length) throw invalid(`bufferView ${number} inflates to another length`, 'TXF-I11');
  const out = new Uint8Array(byteLength), planes = new Uint8Array(byteLength), count = byteLength / row;
  const length = await unzip(packed, byteLength, (bytes, at) => planes.set(bytes.subarray(0, byteLength - at), at));
  if (length !== byteLength) throw invalid(`bufferView ${number} inflates to another length`, 'TXF-I11');
  if (await unzip(packed.subarray(0, -1), byteLength) !== null) throw invalid(`bufferView ${number} has bytes behind its zlib data`, 'TXF-I11'); // some hosts ignore them
  for (let b = 0; b < row; b++) {
    for (let n = 0, value = 0; n < count; n++) out[n * row + b] = value = (value + planes[b * count + n]) & 255;
  }
  return out;
}

/** What a transform makes of bytes; faults are those of the reader. @param {Uint8Array} bytes @param {{readable: ReadableStream, writable: WritableStream}} transform */
export function through(bytes, {readable, writable}) {
  const writer = writable.getWriter();
  Promise.all([writer.write(bytes), writer.close()]).catch(() => {});
  return readable;
}

/** Inflates zlib data, piece by piece: the number of bytes, more than `most` if they are more, null if the data are cut off or broken.
 * @param {Uint8Array} packed @param {number} most @param {(bytes: Uint8Array, at: number) => void} [take] */
async function unzip(packed, most, take = () => {}) {
  const reader = through(packed, new DecompressionStream('deflate')).getReader();
  let at = 0;
  for (;;) {
    const piece = await reader.read().catch(() => null);
    if (!piece || piece.done) return piece && at;
    take(piece.value, at);
    at += piece.value.length;
    if (at > most) return reader.cancel().then(() => at, () => at);
  }
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
    const width = /** @type {number} */ (WIDTHS.get(type)), size = width * values.BYTES_PER_ELEMENT, count = values.length / width, {constructor: kind} = values;
    const componentType = [...KINDS.keys()].find((key) => KINDS.get(key) === kind);
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
