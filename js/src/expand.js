/** expand(): a GLB with coded primitives -> an ordinary GLB, for hosts that have no plug-in. */

import {Added, entryOf, inflated, invalid, isIndex, MESHOPT, NAME, placeOf, wellFormed, within, without} from './accessors.js';
import {Atlas} from './atlas.js';
import {isContainer, unfold} from './container.js';
import {decode, TexfError} from './index.js';
import {addImages} from './png.js';
import {checkTree, hasUnknown, references} from './references.js';

const MAGIC = 0x46546C67, JSON_CHUNK = 0x4E4F534A, BINARY_CHUNK = 0x004E4942, ALIGNMENT = 8;

/**
 * An ordinary GLB of one whose primitives are coded by TEXF_stream: accessors, PNG images, and all else as it was.
 *
 * @param {ArrayBuffer} file stays as it is
 * @param {{decoder?: {decode: typeof decode}|null, limits?: import('./index.js').Limits, signal?: AbortSignal}} [options]
 * @returns {Promise<ArrayBuffer>} the file itself if it has no coded primitives; rejected with a TexfError
 */
export function expand(file, {decoder = null, limits = {}, signal} = {}) {
  return wellFormed(() => expanded(file, (stream) => (decoder ?? {decode}).decode(stream, {limits, signal})));
}

/** @param {ArrayBuffer} file @param {(stream: Uint8Array) => Promise<import('./index.js').Asset>} decoded */
async function expanded(file, decoded) {
  const {root, binary} = readGlb(file);
  if (!isContainer(root)) return file;
  checkTree(root);
  const source = new Source(root, binary), before = held(references(root)), keepsAll = hasUnknown(root);
  const {views, pictures} = await unfold(root, (number) => source.view(number), decoded, {Atlas});
  const added = new Added(root);
  await addImages(root, added, pictures);
  const bytes = await Promise.all(root.bufferViews.map(async (/** @type {any} */ view, /** @type {number} */ n) => views.get(n) ?? added.views.get(n) ?? source.known.get(n) ?? source.stored(n)));
  leaveOut(root);
  return writeGlb(root, keepsAll ? bytes : withoutUnused(root, bytes, before));
}

/** The tree and the binary chunk of a GLB. @param {ArrayBuffer} file */
export function readGlb(file) {
  const view = new DataView(file), wrong = () => invalid('the file is not a whole GLB', 'TXF-I07'), end = file.byteLength < 20 ? 0 : view.getUint32(8, true);
  if (end < 20 || end > file.byteLength || view.getUint32(0, true) !== MAGIC) throw wrong();
  if (view.getUint32(4, true) !== 2) throw new TexfError('unsupported', 'only glTF 2 is supported', {finding: 'TXF-I33'});
  const length = view.getUint32(12, true), next = 20 + length + 8;
  if (view.getUint32(16, true) !== JSON_CHUNK || 20 + length > end) throw wrong();
  const root = jsonOf(new Uint8Array(file, 20, length)), size = next <= end ? view.getUint32(next - 8, true) : 0;
  if (next + size > end && size > 0) throw wrong();
  return {root, binary: size > 0 && view.getUint32(next - 4, true) === BINARY_CHUNK ? new Uint8Array(file, next, size) : new Uint8Array(0)};
}

/** The tree of a JSON text. @param {Uint8Array} text @returns {any} */
function jsonOf(text) {
  let root;
  try {
    root = JSON.parse(new TextDecoder('utf-8', {fatal: true}).decode(text));
  } catch {
    throw invalid('the glTF text is not JSON', 'TXF-I08');
  }
  if (!root || typeof root !== 'object' || Array.isArray(root)) throw invalid('the top level of the glTF is not an object');
  return root;
}

/** Bytes of a file's bufferViews. */
class Source {
  /** @param {any} root @param {Uint8Array} binary */
  constructor(root, binary) {
    this.root = root;
    this.binary = binary;
    /** @type {Map<number, Promise<Uint8Array>>} */
    this.known = new Map();
  }

  /** @param {number} number @returns {Promise<Uint8Array>} */
  view(number) {
    const view = entryOf(this.root, 'bufferViews', number);
    if (MESHOPT.some((name) => view.extensions?.[name])) throw new TexfError('unsupported', `bufferView ${number} is compressed by another extension`);
    if (!this.known.has(number)) this.known.set(number, this.stored(number));
    return /** @type {Promise<Uint8Array>} */ (this.known.get(number));
  }

  /** As view(), but what another extension has compressed stays so. @param {number} number @returns {Promise<Uint8Array>} */
  async stored(number) {
    const view = this.root.bufferViews[number], place = placeOf(view), bytes = within(await this.buffer(place.buffer), place, number);
    return place === view.extensions?.[NAME] ? inflated(bytes, view, number) : bytes;
  }

  /** @param {number} number @returns {Promise<Uint8Array>} */
  async buffer(number) {
    const {uri, byteLength} = entryOf(this.root, 'buffers', number), isHere = typeof uri === 'string' && /^data:/i.test(uri);
    if (!isHere && uri !== undefined) throw new TexfError('unsupported', `buffer ${number} is not in the file`, {finding: 'TXF-I10'});
    if (!isHere && number !== 0) throw invalid(`buffer ${number} has no data`, 'TXF-I10');
    const bytes = isHere ? await fetch(uri).then(async (answer) => new Uint8Array(await answer.arrayBuffer()), () => {
      throw invalid(`the data URI of buffer ${number} cannot be decoded`, 'TXF-I10');
    }) : this.binary;
    if (!isIndex(byteLength) || byteLength > bytes.length) throw invalid(`buffer ${number} is shorter than its byteLength`, 'TXF-I10');
    return bytes.subarray(0, byteLength);
  }
}

/** Takes the extension out of a file's tree. @param {any} root */
function leaveOut(root) {
  without(root, NAME);
  [...root.bufferViews, ...(root.textures ?? [])].forEach((owner) => without(owner, NAME));
  for (const kind of ['extensionsUsed', 'extensionsRequired']) {
    if (!Array.isArray(root[kind])) continue;
    root[kind] = root[kind].filter((/** @type {string} */ name) => name !== NAME);
    if (!root[kind].length) delete root[kind];
  }
}

/** Numbers that are referred to, by kind. @param {Iterable<import('./references.js').Reference>} all */
function held(all) {
  const numbers = /** @type {Object<string, Set<number>>} */ ({accessors: new Set(), bufferViews: new Set(), images: new Set(), textures: new Set()});
  for (const {owner, key, kind} of all) numbers[kind]?.add(owner[key]);
  return numbers;
}

/** Drops what was referred to and no longer is; returns the bytes of the bufferViews that are left.
 * @param {any} root @param {Uint8Array[]} bytes of each bufferView @param {ReturnType<typeof held>} before */
function withoutUnused(root, bytes, before) {
  for (const kinds of [['accessors', 'textures'], ['images'], ['bufferViews']]) {
    const all = [...references(root)], now = held(all), numbers = /** @type {Object<string, Map<number, number>>} */ ({});
    for (const kind of kinds) {
      const kept = (root[kind] ?? []).map((/** @type {any} */ _, /** @type {number} */ n) => n).filter((/** @type {number} */ n) => now[kind].has(n) || !before[kind].has(n));
      numbers[kind] = new Map(kept.map((/** @type {number} */ old, /** @type {number} */ n) => [old, n]));
      if (root[kind]) root[kind] = kept.map((/** @type {number} */ n) => root[kind][n]);
      if (kind === 'bufferViews') bytes = kept.map((/** @type {number} */ n) => bytes[n]);
      if (!kept.length) delete root[kind];
    }
    for (const {owner, key, kind} of all) if (kinds.includes(kind)) owner[key] = numbers[kind].get(owner[key]);
  }
  return bytes;
}

/** @param {any} root @param {Uint8Array[]} bytes of each bufferView */
function writeGlb(root, bytes) {
  let length = 0, unpacked = 0, used = '';
  const places = bytes.map((data, n) => {
    const view = root.bufferViews[n], at = length, name = MESHOPT.find((packing) => view.extensions?.[packing]);
    length += data.length + (-data.length & ALIGNMENT - 1);
    if (!name) Object.assign(view, {buffer: 0, byteOffset: at});
    else {
      Object.assign(view.extensions[name], {buffer: 0, byteOffset: at});
      Object.assign(view, {buffer: 1, byteOffset: unpacked});
      [used, unpacked] = [name, unpacked + view.byteLength + (-view.byteLength & ALIGNMENT - 1)];
    }
    return at;
  });
  root.buffers = [{byteLength: length}, ...(used ? [{byteLength: unpacked, extensions: {[used]: {fallback: true}}}] : [])];
  return glbOf(root, bytes.map((data, n) => [places[n], data]), length);
}

/** A GLB of a tree and pieces of its binary chunk. @param {any} root @param {[number, Uint8Array][]} pieces where they stand @param {number} length of the chunk */
export function glbOf(root, pieces, length) {
  const text = new TextEncoder().encode(JSON.stringify(root)), start = 20 + text.length + (-text.length & 3);
  const out = new Uint8Array(start + 8 + length), view = new DataView(out.buffer);
  out.fill(32, 20 + text.length, start);
  out.set(text, 20);
  [[0, MAGIC], [4, 2], [8, out.length], [12, start - 20], [16, JSON_CHUNK], [start, length], [start + 4, BINARY_CHUNK]].forEach(([at, value]) => view.setUint32(at, value, true));
  for (const [at, data] of pieces) out.set(data, start + 8 + at);
  return out.buffer;
}
