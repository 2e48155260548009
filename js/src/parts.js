/** Decoding a stream in parts side by side: no attribute unit needs another, each part finds the surface by itself. */

import {ALL} from './engine.js';

/** @typedef {import('./engine.js').Asset} Asset */

const HEADER = 8, ATTRIBUTE = 4, CRC = 4, BITS = 31; // clause 5: unit_type of attribute units; bits that stand for one unit each

/** Bytes of the attribute units of a stream, in its order; what is no stream has none, and the decoder says so.
 * @param {Uint8Array} bytes */
function attributeBytes(bytes) {
  const lengths = [];
  for (let at = HEADER; at < bytes.length;) {
    const type = bytes[at++];
    let length = 0;
    for (let scale = 1, more = true; more && at < bytes.length; scale *= 128) {
      length += (bytes[at] & 127) * scale;
      more = bytes[at++] > 127;
    }
    if (type === ATTRIBUTE) lengths.push(length);
    at += length + CRC;
  }
  return lengths;
}

/**
 * Which attribute units every part decodes, one bit each: the largest first, each to the part that has least. One part where there is
 * nothing to gain: the surface is found again by every part.
 *
 * @param {Uint8Array} bytes
 * @param {number} most parts
 * @param {number} least bytes of attributes that are worth a second worker
 * @returns {number[]} the first part has the first unit
 */
export function partsOf(bytes, most, least) {
  const sizes = attributeBytes(bytes), sum = sizes.reduce((a, b) => a + b, 0);
  if (most < 2 || sizes.length < 2 || sizes.length > BITS || sum < least || Math.max(...sizes) > 0.8 * sum) return [ALL];
  const count = Math.min(most, sizes.length, Math.ceil(sum / Math.max(...sizes)));
  const parts = Array.from({length: count}, () => ({bytes: 0, chosen: 0}));
  for (const i of sizes.map((_, n) => n).sort((a, b) => sizes[b] - sizes[a])) {
    const part = parts.reduce((a, b) => (b.bytes < a.bytes ? b : a));
    part.bytes += sizes[i];
    part.chosen |= 1 << i;
  }
  return parts.map(({chosen}) => chosen).sort((a, b) => b % 2 - a % 2);
}

/** The asset of all parts, from those of each.
 * @param {Asset[]} parts @returns {Asset} */
export function merged([first, ...others]) {
  const fields = first.fields.map((field, i) => {
    const all = [field, ...others.map((asset) => asset.fields[i])];
    return {...field, keys: all.reduce((a, b) => (b.keys.length > a.keys.length ? b : a)).keys,
      planes: Object.assign({}, ...all.map(({planes}) => planes))};
  });
  return {...first, fields};
}
