/**
 * An atlas of the faces of a stream over voxels: triangles that share their longest edge lie together in a cell of a square image, unfolded
 * about that edge without distortion. A texel is the answer of the field (clause 8.2.1) at its place on the plane of its face.
 */

import {TexfError} from './engine.js';
import {componentsOf, withZ} from './pictures.js';
import {Voxels} from './voxels.js';

/** @typedef {import('./engine.js').Asset} Asset */
/** @typedef {number[]} Vector */
/** @typedef {{unit: number, face: number, turn: number, side: number, apex: Vector, frame: Vector[]}} Half a triangle of a cell. turn: its corner at which its
 *   longest edge begins; side: 1 above that edge, -1 below; apex: its third corner from there, in voxels; frame: origin, x axis and y axis in the field */
/** @typedef {{halves: Half[], length: number, height: number, top: number, at: Vector, size: Vector}} Cell length of the edge along x, height and height above
 *   the edge in voxels; at, size: the rectangle in texels that it fills */

const GUTTER = 2, DENSITY = 1.25, MOST = 4096, LEAST = 64; // texels about a cell; texels a voxel, unless MOST, a side, forbids
const FLAT = 127.5; // what stands for 0 in normals
const dot = (/** @type {Vector} */ a, /** @type {Vector} */ b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const along = (/** @type {Vector} */ a, /** @type {number} */ t, /** @type {Vector} */ b) => a.map((value, k) => value + t * b[k]);
/** @param {Vector} a @returns {Vector} of length 1, or 0 */
const unit = (a) => a.map((value) => value / (Math.sqrt(dot(a, a)) || 1));

/** Cells of the faces of a unit: two faces with one longest edge share a cell. @param {Asset} asset @param {number} number @returns {Cell[]} */
function cellsOf(asset, number) {
  const {indices, lattice, field} = asset.units[number], {resolution, levelsLeftOut} = asset.fields[field], scale = resolution / 2 ** (asset.positionBits + levelsLeftOut);
  const cells = /** @type {Cell[]} */ ([]), open = /** @type {Map<string, Cell>} */ (new Map());
  for (let f = 0; f < indices.length; f += 3) {
    const at = [0, 1, 2].map((k) => indices[f + k]), corners = at.map((v) => [0, 1, 2].map((k) => lattice[3 * v + k] * scale));
    const edges = corners.map((corner, k) => along(corners[(k + 1) % 3], -1, corner)), squares = edges.map((edge) => dot(edge, edge));
    const turn = squares.indexOf(Math.max(...squares)), length = Math.sqrt(squares[turn]), origin = corners[turn], across = unit(edges[turn]);
    const third = along(corners[(turn + 2) % 3], -1, origin), x = dot(third, across), up = along(third, -x, across), y = Math.sqrt(dot(up, up));
    const half = {unit: number, face: f / 3, turn, side: 1, apex: [x, y], frame: [origin, across, unit(up)]}, [p, q] = [at[turn], at[(turn + 1) % 3]];
    const other = open.get(`${q} ${p}`);
    if (other) {
      other.halves.push({...half, side: -1});
      other.height += y;
      open.delete(`${q} ${p}`);
    } else {
      cells.push({halves: [half], length, height: y, top: y, at: [0, 0], size: [0, 0]});
      open.set(`${p} ${q}`, cells[cells.length - 1]);
    }
  }
  return cells;
}

/** The place in a triangle (0, 0), (length, 0), apex that is nearest to (x, y). @param {number} length @param {Vector} apex @param {number} x @param {number} y */
function inside(length, [ax, ay], x, y) {
  if (y >= 0 && ax * y <= ay * x && (length - ax) * y <= ay * (length - x)) return [x, y];
  const ends = [[0, 0, length, 0], [0, 0, ax, ay], [length, 0, ax, ay]].map(([px, py, qx, qy]) => {
    const [u, v] = [qx - px, qy - py], t = Math.min(1, Math.max(0, ((x - px) * u + (y - py) * v) / (u * u + v * v || 1)));
    return [px + t * u, py + t * v];
  });
  return ends.reduce((a, b) => (Math.hypot(b[0] - x, b[1] - y) < Math.hypot(a[0] - x, a[1] - y) ? b : a));
}

/** Places of faces in a square image, whose pictures are made as they are needed. */
export class Atlas {
  /** @param {Asset} asset @param {number[]} numbers of units over voxels */
  constructor(asset, numbers) {
    this.asset = asset;
    this.cells = numbers.flatMap((number) => cellsOf(asset, number)).sort((a, b) => b.height - a.height);
    /** @type {Map<string, Voxels>} */
    this.voxels = new Map();
    this.side = LEAST;
    while (!this.packed(DENSITY) && this.side < MOST) this.side *= 2;
    let [low, high] = this.packed(DENSITY) ? [DENSITY, 4 * DENSITY] : [0.01, DENSITY];
    for (let step = 0; step < 8; step++) [low, high] = this.packed((low + high) / 2) ? [(low + high) / 2, high] : [low, (low + high) / 2];
    if (!this.packed(low)) throw new TexfError('limit', `the faces over voxels need an atlas of more than ${MOST} texels a side`);
    this.density = low;
    /** UVs and tangents of the corners of each unit. @type {{uvs: Float32Array, tangents: Float32Array}[]} */
    this.corners = [];
    for (const number of numbers) this.corners[number] = {uvs: new Float32Array(2 * asset.units[number].indices.length), tangents: new Float32Array(4 * asset.units[number].indices.length)};
    for (const cell of this.cells) for (const half of cell.halves) this.place(cell, half);
  }

  /** Places the cells, in rows. @param {number} density @returns {boolean} whether they fit */
  packed(density) {
    let x = 0, y = 0, row = 0, first = 0;
    const end = (/** @type {number} */ n, /** @type {number} */ tall) => { // the cells of a row fill it
      if (n > first) this.cells[n - 1].size[0] += this.side - x;
      for (; first < n; first++) this.cells[first].size[1] = tall;
    };
    for (const [n, cell] of this.cells.entries()) {
      const [wide, tall] = [cell.length, cell.height].map((size) => Math.ceil(size * density) + 2 * GUTTER);
      if (x + wide > this.side) {
        end(n, row);
        [x, y, row] = [0, y + row, 0];
      }
      row = Math.max(row, tall);
      if (wide > this.side || y + row > this.side) return false;
      [cell.at, cell.size] = [[x, y], [wide, tall]];
      x += wide;
    }
    end(this.cells.length, this.side - y);
    return true;
  }

  /** Writes UVs and tangents of a triangle. @param {Cell} cell @param {Half} half */
  place({length, top, at}, {unit: number, face, turn, side, apex, frame}) {
    const {uvs, tangents} = this.corners[number], {normals} = this.asset.units[number];
    [[0, 0], [length, 0], apex].forEach(([x, y], n) => {
      const corner = 3 * face + (turn + n) % 3, normal = [...normals.subarray(3 * corner, 3 * corner + 3)], flat = along(frame[1], -dot(frame[1], normal), normal);
      const other = Math.abs(normal[0]) < 0.7 ? [1, 0, 0] : [0, 1, 0], tangent = dot(flat, flat) > 1e-12 ? flat.map((value) => side * value) : along(other, -dot(other, normal), normal);
      uvs[2 * corner] = (at[0] + GUTTER + (side > 0 ? x : length - x) * this.density) / this.side;
      uvs[2 * corner + 1] = (at[1] + GUTTER + (top - side * y) * this.density) / this.side;
      tangents.set([...unit(tangent), 1], 4 * corner);
    });
  }

  /** A picture of channels, as pictureOf() of a field over texels. @param {(string|null)[]} channels @returns {import('./pictures.js').Picture} */
  picture(channels) {
    const {side} = this, data = new Uint8Array(4 * side * side).fill(255), from = componentsOf(channels), names = [...new Set(channels)].filter((name) => name !== null);
    for (const cell of this.cells) {
      for (let j = cell.at[1]; j < cell.at[1] + cell.size[1]; j++) {
        for (let i = cell.at[0]; i < cell.at[0] + cell.size[0]; i++) {
          const x = (i + 0.5 - cell.at[0] - GUTTER) / this.density, y = cell.top - (j + 0.5 - cell.at[1] - GUTTER) / this.density;
          const half = cell.halves[cell.halves.length > 1 && y < 0 ? 1 : 0];
          for (const name of names) {
            const values = this.answer(half, cell.length, half.side > 0 ? x : cell.length - x, half.side * y, name);
            channels.forEach((channel, k) => {
              if (channel === name && values) data[4 * (j * side + i) + k] = Math.round(values[Math.min(from[k], values.length - 1)]);
            });
          }
        }
      }
    }
    if (names.some((name) => name.endsWith('normal'))) withZ(data);
    return {width: side, height: side, data, hasAlpha: data.some((value, i) => i % 4 === 3 && value < 255)};
  }

  /** Values of a channel on a triangle, 0 to 255; null if its field lacks it. @param {Half} half @param {number} length @param {number} x @param {number} y @param {string} name */
  answer({unit: number, face, turn, apex, frame}, length, x, y, name) {
    const {field, normals} = this.asset.units[number], isNormal = name.endsWith('normal'), plane = this.asset.fields[field].planes[isNormal ? `${name}_object` : name];
    if (!plane) return null;
    const coarser = Math.max(0, plane.levelShift - this.asset.fields[field].levelsLeftOut), key = `${field} ${coarser}`;
    const voxels = this.voxels.get(key) ?? new Voxels(this.asset.fields[field].keys, coarser), near = inside(length, apex, x, y);
    this.voxels.set(key, voxels);
    const at = (/** @type {Vector} */ [u, v]) => along(along(frame[0], u, frame[1]), v, frame[2]).map((value) => value / 2 ** coarser);
    if (Math.hypot(x - near[0], y - near[1]) * this.density > 1.5 || !voxels.ask(at([x, y]), false)) voxels.ask(at(near), true);
    const {values, components, offset} = plane, sums = Array.from({length: isNormal ? 3 : components - offset}, (_, c) => voxels.rows.reduce((sum, row, n) => sum + voxels.shares[n] * values[components * row + offset + c], 0));
    if (!isNormal) return sums;
    const third = near[1] / (apex[1] || 1), second = (near[0] - third * apex[0]) / (length || 1), weights = [1 - second - third, second, third];
    const mean = (/** @type {Float32Array} */ of, /** @type {number} */ width) => unit([0, 1, 2].map((k) => weights.reduce((sum, weight, n) => sum + weight * of[width * (3 * face + (turn + n) % 3) + k], 0)));
    const normal = mean(normals, 3), tangent = mean(this.corners[number].tangents, 4), bent = unit(normal.map((value, k) => value + sums[k] / FLAT - 1));
    const across = [0, 1, 2].map((k) => normal[(k + 1) % 3] * tangent[(k + 2) % 3] - normal[(k + 2) % 3] * tangent[(k + 1) % 3]);
    return [FLAT * (dot(bent, tangent) + 1), FLAT * (dot(bent, across) + 1)];
  }
}
