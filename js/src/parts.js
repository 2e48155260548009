/** Decoding a stream in parts side by side: no attribute unit needs another, each part finds the surface by itself. */

import {ALL} from './engine.js';

/** @typedef {import('./engine.js').Asset} Asset */

const HEADER = 8, FIELD = 2, ATTRIBUTE = 4, CRC = 4, LAST = 31; // clause 5: unit_type; the bit of all units from there on
const CELLS = 6; // texels or voxels of a field that take about as long as a byte of its payload

/** A number of 7 bits a byte, and where it ends.
 * @param {Uint8Array} bytes @param {number} at @returns {[number, number]} */
function varint(bytes, at) {
  let value = 0;
  for (let scale = 1, more = true; more && at < bytes.length; scale *= 128) {
    value += (bytes[at] & 127) * scale;
    more = bytes[at++] > 127;
  }
  return [value, at];
}

/** What decoding the attribute units of each bit costs, in bytes of payload; what is no stream has none, and the decoder says so.
 * @param {Uint8Array} bytes */
function attributeCosts(bytes) {
  const /** @type {number[]} */ costs = [], /** @type {number[]} */ cells = [];
  let units = 0;
  const add = (/** @type {number} */ cost) => {
    const bit = Math.min(units++, LAST);
    costs[bit] = (costs[bit] ?? 0) + cost;
  };
  for (let at = HEADER; at < bytes.length;) {
    const type = bytes[at], [length, begin] = varint(bytes, at + 1), [field, next] = varint(bytes, begin);
    if (type === FIELD) [cells[field]] = varint(bytes, next + (bytes[next] === 1 ? 8 : 5)); // num_keys, after support and its costs
    if (type === ATTRIBUTE) add(length + (cells[field] ?? 0) / 4 ** bytes[next + 2] / CELLS); // level_shift
    at = begin + length + CRC;
  }
  return costs;
}

/**
 * Which attribute units every part decodes, one bit each: the dearest first, each to the part that has least. One part where there is
 * nothing to gain: the surface is found again by every part.
 *
 * @param {Uint8Array} bytes
 * @param {number} most parts
 * @param {number} least bytes of attributes that are worth a second worker, or what takes as long
 * @returns {number[]} the first part has the first unit
 */
export function partsOf(bytes, most, least) {
  const costs = attributeCosts(bytes), sum = costs.reduce((a, b) => a + b, 0);
  if (most < 2 || costs.length < 2 || sum < least || Math.max(...costs) > 0.8 * sum) return [ALL];
  const count = Math.min(most, costs.length, Math.ceil(sum / Math.max(...costs)));
  const parts = Array.from({length: count}, () => ({cost: 0, chosen: 0}));
  for (const i of costs.map((_, n) => n).sort((a, b) => costs[b] - costs[a])) {
    const part = parts.reduce((a, b) => (b.cost < a.cost ? b : a));
    part.cost += costs[i];
    part.chosen |= 1 << i;
  }
  return parts.map(({chosen}) => chosen).sort((a, b) => (b & 1) - (a & 1));
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
