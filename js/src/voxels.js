/** Queries of fields over voxels (clause 8.2.1), where no shader makes them. */

import {bitCount, bricksOf, compact, levelOf} from './supports.js';

/** @typedef {number[]} Vector */

const RINGS = 3, LARGEST = 8191; // voxels in which the nearest is looked for; coordinate of a voxel

/** Voxels of a field or of its planes that are `coarser` by some levels. */
export class Voxels {
  /** @param {BigUint64Array} keys @param {number} coarser */
  constructor(keys, coarser) {
    const shift = BigInt(3 * coarser), own = coarser ? keys.map((key) => key >> shift).filter((key, i, all) => i === 0 || key !== all[i - 1]) : keys;
    const {bricks, words} = bricksOf(own), level = levelOf(bricks, words, 0), code = (/** @type {number} */ key) => compact(key) | compact(key >>> 1) << 10 | compact(key >>> 2) << 20;
    this.level = level;
    this.brick = new Map(Array.from(level.bricks, (key, b) => [code(key), b]));
    this.last = [-1, -1]; // code and number of a brick
    this.rows = [0];
    this.shares = [1];
  }

  /** The row of a voxel, -1 where none is. @param {number} x @param {number} y @param {number} z */
  row(x, y, z) {
    const code = x >> 3 | y >> 3 << 10 | z >> 3 << 20, spread = (/** @type {number} */ v) => v & 1 | (v & 2) << 2 | (v & 4) << 4;
    if (x < 0 || y < 0 || z < 0 || x > LARGEST || y > LARGEST || z > LARGEST) return -1;
    if (code !== this.last[0]) this.last = [code, this.brick.get(code) ?? -1];
    const inside = spread(x) | spread(y) << 1 | spread(z) << 2, at = 16 * this.last[1] + (inside >> 5), bit = 1 << (inside & 31);
    return at >= 0 && this.level.words[at] & bit ? this.level.ranks[at] + bitCount(this.level.words[at] & bit - 1) : -1;
  }

  /** Makes `rows` and `shares` those of a point. @param {Vector} point @param {boolean} isSure whether the nearest voxel answers where no corner does
   * @returns {boolean} whether any voxel answers */
  ask(point, isSure) {
    const [x, y, z] = point.map((v) => Math.floor(v - 0.5)), [u, v, w] = [point[0] - 0.5 - x, point[1] - 0.5 - y, point[2] - 0.5 - z];
    let total = 0, count = 0;
    for (let n = 0; n < 8; n++) {
      const share = (n & 1 ? u : 1 - u) * (n & 2 ? v : 1 - v) * (n & 4 ? w : 1 - w), row = share > 0 ? this.row(x + (n & 1), y + (n >> 1 & 1), z + (n >> 2)) : -1;
      if (row < 0) continue;
      [this.rows[count], this.shares[count++]] = [row, share];
      total += share;
    }
    if (count === 0 && isSure) [this.rows[count], this.shares[count++], total] = [this.nearest(point), 1, 1];
    this.rows.length = this.shares.length = count;
    for (let n = 0; n < count; n++) this.shares[n] /= total;
    return count > 0;
  }

  /** The row of the voxel whose centre is nearest to a point; beyond RINGS one of the nearest brick. @param {Vector} point */
  nearest(point) {
    const [x, y, z] = point.map(Math.floor);
    let best = (RINGS + 0.5) ** 2, nearest = -1;
    for (let i = x - RINGS; i <= x + RINGS; i++) for (let j = y - RINGS; j <= y + RINGS; j++) for (let k = z - RINGS; k <= z + RINGS; k++) {
      const square = (i + 0.5 - point[0]) ** 2 + (j + 0.5 - point[1]) ** 2 + (k + 0.5 - point[2]) ** 2, row = square < best ? this.row(i, j, k) : -1;
      if (row >= 0) [best, nearest] = [square, row];
    }
    if (nearest >= 0) return nearest;
    best = Infinity;
    this.level.bricks.forEach((key, b) => {
      const square = [0, 1, 2].reduce((sum, k) => sum + (8 * compact(key >>> k) + 4 - point[k]) ** 2, 0);
      if (square < best) [best, nearest] = [square, this.level.ranks[16 * b]];
    });
    return nearest;
  }
}
