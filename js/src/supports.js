// Where values live, as the GPU looks it up: bricks of voxels in a hash table, with all coarser levels.
//
// A level's values are the plain means of the values of the level where a plane begins, as render/levels.py has them, rounded.

/** @typedef {{bricks: Uint32Array, words: Uint32Array}} Bricks Ascending Morton codes of bricks, and 16 words a brick: which voxels are there. */
/** @typedef {Bricks & {ranks: Uint32Array, base: number, count: number}} Level */
/** @typedef {{first: number, levels: Level[], parents: Uint32Array[]}} Tree */

const WORDS = 16;
const HASH_FACTOR = 2654435769;
const LINEAR = Float64Array.from({ length: 256 }, (_, code) => (code <= 10 ? code / 3294.6 : ((code / 255 + 0.055) / 1.055) ** 2.4)); // of sRGB

/** Ascending Morton keys as bricks of 8 x 8 x 8: key >> 9 of each, and 512 bits of which of its voxels are there.
 * @param {BigUint64Array} keys @returns {Bricks} */
export function bricksOf(keys) {
  const halves = new Uint32Array(keys.buffer, keys.byteOffset, 2 * keys.length), bricks = new Uint32Array(keys.length);
  let count = 0;
  for (let i = 0; i < halves.length; i += 2) {
    const brick = ((halves[i + 1] << 23) | (halves[i] >>> 9)) >>> 0;
    if (count === 0 || bricks[count - 1] !== brick) bricks[count++] = brick;
  }
  const words = new Uint32Array(WORDS * count);
  for (let i = 0, b = -1, last = -1; i < halves.length; i += 2) {
    const brick = ((halves[i + 1] << 23) | (halves[i] >>> 9)) >>> 0, inside = halves[i] & 511;
    if (brick !== last) [b, last] = [b + 1, brick];
    words[WORDS * b + (inside >> 5)] |= 1 << (inside & 31);
  }
  return { bricks: bricks.slice(0, count), words };
}

/** Voxels of one level in Morton order: bricks Uint32Array [B], words Uint32Array [B * 16], base: how many come before.
 * @param {Uint32Array} bricks @param {Uint32Array} words @param {number} base @returns {Level} */
export function levelOf(bricks, words, base) {
  const ranks = new Uint32Array(words.length);
  let rank = base;
  for (let i = 0; i < words.length; i++) {
    ranks[i] = rank;
    rank += bitCount(words[i]);
  }
  return { bricks, words, ranks, base, count: rank - base };
}

/** @param {number} x */
export function bitCount(x) {
  x -= (x >>> 1) & 0x55555555;
  x = (x & 0x33333333) + ((x >>> 2) & 0x33333333);
  return Math.imul((x + (x >>> 4)) & 0x0f0f0f0f, 0x01010101) >>> 24;
}

/**
 * The level above, whose voxels are twice as wide, and the number in it of every voxel of this one's. Eight places that share a
 * parent are a byte of a word; a brick's parents are an eighth of the brick above.
 * @param {Level} level
 */
function coarser({ bricks, words, base, count }) {
  const keys = new Uint32Array(bricks.length), above = new Uint32Array(words.length), parents = new Uint32Array(count);
  let many = 0, row = -1, n = 0;
  for (let b = 0; b < bricks.length; b++) {
    const key = bricks[b] >>> 3, eighth = (bricks[b] & 7) << 6;
    if (many === 0 || keys[many - 1] !== key) keys[many++] = key;
    for (let i = 0; i < 4 * WORDS; i++) {
      const eight = (words[b * WORDS + (i >> 2)] >>> (8 * (i & 3))) & 255, inside = eighth | i;
      if (eight === 0) continue;
      above[(many - 1) * WORDS + (inside >> 5)] |= 1 << (inside & 31);
      row++;
      for (let left = bitCount(eight); left > 0; left--) parents[n++] = row;
    }
  }
  return { level: levelOf(keys.slice(0, many), above.slice(0, many * WORDS), base + count), parents };
}

/** All levels from `first` to the last of a field over voxels, and the parents of each one's voxels.
 * @param {Bricks & {first: number, depth: number}} field @returns {Tree} */
export function levelsOf({ bricks, words, first, depth }) {
  const levels = [levelOf(bricks, words, 0)], parents = /** @type {Uint32Array[]} */ ([]);
  for (let number = first; number < depth; number++) {
    const above = coarser(levels[levels.length - 1]);
    levels.push(above.level);
    parents.push(above.parents);
  }
  return { first, levels, parents };
}

/** What a shader asks to find a voxel: an open-addressing table of (brick's code + 1, brick), and (bits, rank) of every word.
 * @param {Tree} tree */
export function lookUpOf({ first, levels }) {
  const count = levels.reduce((sum, level) => sum + level.bricks.length, 0);
  const log2 = Math.max(4, 32 - Math.clz32(2 * count)), mask = 2 ** log2 - 1;
  const table = new Uint32Array(2 * 2 ** log2), bits = new Uint32Array(2 * Math.max(1, count) * WORDS);
  let brick = 0;
  levels.forEach((level, i) => level.bricks.forEach((key, b) => {
    const code = codeOf(first + i, key);
    let slot = Math.imul(code, HASH_FACTOR) >>> (32 - log2);
    while (table[2 * slot + 1] !== 0) slot = (slot + 1) & mask;
    table[2 * slot] = code;
    table[2 * slot + 1] = brick + 1;
    for (let w = 0; w < WORDS; w++) {
      bits[2 * (brick * WORDS + w)] = level.words[b * WORDS + w];
      bits[2 * (brick * WORDS + w) + 1] = level.ranks[b * WORDS + w];
    }
    brick++;
  }));
  return { table, log2, bits };
}

/** One number for a brick of a level: coordinates of 10 bits on level 0, of 9 above it.
 * @param {number} level @param {number} key */
function codeOf(level, key) {
  const x = compact(key), y = compact(key >>> 1), z = compact(key >>> 2);
  return (level === 0 ? x | (y << 10) | (z << 20) : 0x80000000 | (level << 27) | x | (y << 9) | (z << 18)) >>> 0;
}

/** Values of a plane on its own level and all above, Uint8Array [rows * components], and the number of rows.
 * @param {Uint8Array} values @param {boolean[]} colours of each component: whether means are in linear light, as of mipmaps @param {Tree} tree */
export function pyramidOf(values, colours, { levels, parents }) {
  const components = colours.length, rows = levels.reduce((sum, level) => sum + level.count, 0), out = new Uint8Array(rows * components);
  out.set(values);
  let sums = Float64Array.from(values, (value, i) => (colours[i % components] ? LINEAR[value] : value)), weights = new Float64Array(levels[0].count).fill(1), at = values.length;
  for (let number = 0; number < parents.length; number++) {
    const { count } = levels[number + 1], above = new Float64Array(count * components), heavier = new Float64Array(count);
    parents[number].forEach((parent, row) => {
      heavier[parent] += weights[row];
      for (let c = 0; c < components; c++) above[parent * components + c] += sums[row * components + c];
    });
    [sums, weights] = [above, heavier];
    for (let row = 0; row < count; row++) {
      for (let c = 0; c < components; c++) out[at++] = Math.round(coded(sums[row * components + c] / weights[row], colours[c]));
    }
  }
  return { rows, values: out };
}

/** @param {number} mean @param {boolean} isColour whether it is linear, 0 to 1 */
const coded = (mean, isColour) => !isColour ? mean : 255 * (mean <= 0.0031308 ? 12.92 * mean : 1.055 * mean ** (1 / 2.4) - 0.055);

/** Every third bit, the lowest first.
 * @param {number} key */
export function compact(key) {
  let out = 0;
  for (let bit = 0; bit < 11; bit++) out |= ((key >>> (3 * bit)) & 1) << bit;
  return out;
}
