/** Queries of fields over voxels (clause 8.2.1), where no shader makes them. */

import {bitCount, bricksOf, compact, levelOf} from './supports.js';

const RINGS = 3, LARGEST = 8191; // voxels in which the nearest is looked for; coordinate of a voxel
const SPREAD = Uint16Array.from({length: 8}, (_, v) => v & 1 | (v & 2) << 2 | (v & 4) << 4); // a coordinate in a brick, every third bit

/** Voxels of a field or of its planes that are `coarser` by some levels. */
export class Voxels {
  /** @param {BigUint64Array} keys @param {number} coarser */
  constructor(keys, coarser) {
    const shift = BigInt(3 * coarser), own = coarser ? keys.map((key) => key >> shift).filter((key, i, all) => i === 0 || key !== all[i - 1]) : keys;
    const {bricks, words} = bricksOf(own), level = levelOf(bricks, words, 0);
    this.level = level;
    this.places = [0, 1, 2].map((k) => Int32Array.from(bricks, (key) => compact(key >>> k))); // x, y, z of bricks
    const [x, y, z] = this.places;
    this.brick = new Map(Array.from(bricks, (_, b) => [x[b] | y[b] << 10 | z[b] << 20, b]));
    // Codes and numbers of the last bricks, in eight slots: bricks beside each other have different ones.
    this.codes = new Int32Array(8).fill(-1);
    this.numbers = new Int32Array(8);
    /** The voxels of the last point: the lowest corner of its cell, rows of all eight, and rows and shares of the `count` that answer. */
    this.corner = Int32Array.of(-2, 0, 0);
    this.around = new Int32Array(8).fill(-1);
    this.count = 0;
    this.rows = new Int32Array(8);
    this.shares = new Float64Array(8);
    this.sums = new Float64Array(3);
  }

  /** The row of a voxel, -1 where none is. @param {number} x @param {number} y @param {number} z */
  row(x, y, z) {
    if (x < 0 || y < 0 || z < 0 || x > LARGEST || y > LARGEST || z > LARGEST) return -1;
    const code = x >> 3 | y >> 3 << 10 | z >> 3 << 20, slot = x >> 3 & 1 | y >> 2 & 2 | z >> 1 & 4;
    if (code !== this.codes[slot]) {
      this.codes[slot] = code;
      this.numbers[slot] = this.brick.get(code) ?? -1;
    }
    const inside = SPREAD[x & 7] | SPREAD[y & 7] << 1 | SPREAD[z & 7] << 2, at = 16 * this.numbers[slot] + (inside >> 5), bit = 1 << (inside & 31);
    return at >= 0 && this.level.words[at] & bit ? this.level.ranks[at] + bitCount(this.level.words[at] & bit - 1) : -1;
  }

  /** Makes `rows` and `shares` those of a point. @param {number} px @param {number} py @param {number} pz
   * @param {boolean} isSure whether the nearest voxel answers where no corner does @returns {boolean} whether any voxel answers */
  ask(px, py, pz, isSure) {
    const {corner, around, rows, shares} = this, x = Math.floor(px - 0.5), y = Math.floor(py - 0.5), z = Math.floor(pz - 0.5);
    if (x !== corner[0] || y !== corner[1] || z !== corner[2]) {
      corner[0] = x;
      corner[1] = y;
      corner[2] = z;
      for (let n = 0; n < 8; n++) around[n] = this.row(x + (n & 1), y + (n >> 1 & 1), z + (n >> 2));
    }
    const u = px - 0.5 - x, v = py - 0.5 - y, w = pz - 0.5 - z;
    let total = 0, count = 0;
    for (let n = 0; n < 8; n++) {
      const share = around[n] < 0 ? 0 : (n & 1 ? u : 1 - u) * (n & 2 ? v : 1 - v) * (n & 4 ? w : 1 - w);
      if (share <= 0) continue;
      rows[count] = around[n];
      shares[count++] = share;
      total += share;
    }
    if (count === 0 && isSure) [rows[0], shares[0], total, count] = [this.nearest(px, py, pz), 1, 1, 1];
    for (let n = 0; n < count; n++) shares[n] /= total;
    this.count = count;
    return count > 0;
  }

  /** Makes `sums` the answer of up to three components of a plane with `step` a voxel, 0 to 255.
   * @param {Uint8Array} values @param {number} step @param {number} at @param {number} width */
  sum(values, step, at, width) {
    const {rows, shares, sums, count} = this;
    let x = 0, y = 0, z = 0;
    for (let n = 0; n < count; n++) {
      const from = step * rows[n] + at, share = shares[n];
      x += share * values[from];
      if (width > 1) y += share * values[from + 1];
      if (width > 2) z += share * values[from + 2];
    }
    sums[0] = x;
    sums[1] = y;
    sums[2] = z;
  }

  /** The row of the voxel whose centre is nearest to a point; beyond RINGS one of the nearest brick. @param {number} px @param {number} py @param {number} pz */
  nearest(px, py, pz) {
    const x = Math.floor(px), y = Math.floor(py), z = Math.floor(pz), {places, level} = this;
    let best = (RINGS + 0.5) ** 2, nearest = -1;
    for (let i = x - RINGS; i <= x + RINGS; i++) for (let j = y - RINGS; j <= y + RINGS; j++) for (let k = z - RINGS; k <= z + RINGS; k++) {
      const square = (i + 0.5 - px) ** 2 + (j + 0.5 - py) ** 2 + (k + 0.5 - pz) ** 2, row = square < best ? this.row(i, j, k) : -1;
      if (row >= 0) [best, nearest] = [square, row];
    }
    if (nearest >= 0) return nearest;
    best = Infinity;
    for (let b = 0; b < places[0].length; b++) {
      const square = (8 * places[0][b] + 4 - px) ** 2 + (8 * places[1][b] + 4 - py) ** 2 + (8 * places[2][b] + 4 - pz) ** 2;
      if (square < best) [best, nearest] = [square, level.ranks[16 * b]];
    }
    return nearest;
  }
}
