/**
 * An atlas of the faces of a stream over voxels: triangles that share their longest edge lie together in a cell of a square image, unfolded
 * about that edge without distortion. A texel is the answer of the field (clause 8.2.1) at its place on the plane of its face.
 *
 * A face is half a cell. Arrays have a row for each face, of all units in turn; a cell has the number of its first face.
 */

import {TexfError} from './engine.js';
import {componentsOf, hasAlpha, withZ} from './pictures.js';
import {Voxels} from './voxels.js';

/** @typedef {import('./engine.js').Asset} Asset */
/** @typedef {ArrayLike<number>} Vector */
/** @typedef {import('./pictures.js').Picture} Picture */
/** @typedef {{values: Uint8Array, step: number, at: number, width: number, data: Uint8Array, k: number}} Output values: step components a voxel, of which `width`
 *   from `at` on become components of the pixels from k on; of a normal three become two */
/** @typedef {{voxels: Voxels, size: number, plain: Output[], normals: Output[]}} Layer planes of a field with the same voxels, `size` voxels of the field wide */

const GUTTER = 2, DENSITY = 1.25, MOST = 4096, LEAST = 64; // texels about a cell; texels a voxel, unless MOST, a side, forbids
const REACH = 1.5; // texels about a face in which the field answers as on it
const FLAT = 127.5; // what stands for 0 in normals
const FRAME = 12, LENGTH = 9, APEX = 10; // a row of `frames`: origin, x axis, along the longest edge, and y axis, in voxels; length of that edge; x, y of the third corner

/** @param {Vector} a @param {number} i @param {Vector} b @param {number} j */
const dot = (a, i, b, j) => a[i] * b[j] + a[i + 1] * b[j + 1] + a[i + 2] * b[j + 2];

/** Makes three numbers of length 1, or 0. @param {Float64Array} a @param {number} i */
function normalise(a, i) {
  const size = Math.sqrt(dot(a, i, a, i)) || 1;
  for (let k = i; k < i + 3; k++) a[k] /= size;
}

/** Writes the place in a triangle (0, 0), (length, 0), (ax, ay) that is nearest to (x, y). @param {Float64Array} near @param {number} length @param {number} ax
 * @param {number} ay @param {number} x @param {number} y @returns {number} the square of its distance */
function nearest(near, length, ax, ay, x, y) {
  let best = y >= 0 && ax * y <= ay * x && (length - ax) * y <= ay * (length - x) ? 0 : Infinity;
  near[0] = x;
  near[1] = y;
  for (let n = 0; n < 3 && best > 0; n++) {
    const from = n === 2 ? length : 0, u = (n === 0 ? length : ax) - from, v = n === 0 ? 0 : ay, t = Math.min(1, Math.max(0, ((x - from) * u + y * v) / (u * u + v * v || 1)));
    const square = (from + t * u - x) ** 2 + (t * v - y) ** 2;
    if (square >= best) continue;
    best = square;
    near[0] = from + t * u;
    near[1] = t * v;
  }
  return best;
}

/** Places of faces in a square image, whose pictures are made as they are needed. */
export class Atlas {
  /** @param {Asset} asset @param {number[]} numbers of units over voxels */
  constructor(asset, numbers) {
    const count = numbers.reduce((sum, number) => sum + asset.units[number].indices.length / 3, 0);
    this.asset = asset;
    this.units = new Uint32Array(count); // of each face
    this.faces = new Uint32Array(count); // number in its unit
    this.turns = new Uint8Array(count); // the corner at which its longest edge begins
    this.others = new Int32Array(count).fill(-1); // the face that shares its cell
    this.isBelow = new Uint8Array(count); // whether it is the second one there
    this.frames = new Float64Array(FRAME * count);
    numbers.reduce((first, number) => this.measure(number, first), 0);
    this.heights = Float64Array.from(this.others, (other, face) => this.frames[FRAME * face + APEX + 1] + (other < 0 ? 0 : this.frames[FRAME * other + APEX + 1]));
    this.cells = Array.from(this.units.keys()).filter((face) => !this.isBelow[face]).sort((a, b) => this.heights[b] - this.heights[a]);
    this.boxes = new Int32Array(4 * this.cells.length); // x, y, width and height of the cells
    /** @type {Map<string, Voxels>} */
    this.voxels = new Map();
    /** Those that finish() fills. @type {{channels: (string|null)[], picture: Picture}[]} */
    this.pictures = [];
    this.side = LEAST;
    this.density = this.packedBest();
    /** UVs and tangents of the corners of each unit. @type {{uvs: Float32Array, tangents: Float32Array}[]} */
    this.corners = [];
    for (const number of numbers) this.corners[number] = {uvs: new Float32Array(2 * asset.units[number].indices.length), tangents: new Float32Array(4 * asset.units[number].indices.length)};
    this.near = new Float64Array(2);
    this.basis = new Float64Array(12); // normal, tangent, bitangent and the normal of the field
    this.cells.forEach((face, n) => {
      this.place(n, face);
      if (this.others[face] >= 0) this.place(n, this.others[face]);
    });
  }

  /** Writes the rows of a unit's faces: two with one longest edge share a cell. @param {number} number @param {number} first @returns {number} where the next unit begins */
  measure(number, first) {
    const {indices, lattice, field} = this.asset.units[number], {resolution, levelsLeftOut} = this.asset.fields[field], scale = resolution / 2 ** (this.asset.positionBits + levelsLeftOut);
    const {frames} = this, open = /** @type {Map<number, number>} */ (new Map()), vertices = lattice.length / 3, edges = new Float64Array(9), squares = [0, 0, 0];
    const at = (/** @type {number} */ v, /** @type {number} */ k) => lattice[3 * v + k] * scale;
    for (let f = 0, face = first, row = FRAME * first; f < indices.length; f += 3, face++, row += FRAME) {
      for (let i = 0; i < 9; i++) edges[i] = at(indices[f + (i + 3) % 9 / 3 | 0], i % 3) - at(indices[f + i / 3 | 0], i % 3);
      for (let n = 0; n < 3; n++) squares[n] = dot(edges, 3 * n, edges, 3 * n);
      const turn = squares.indexOf(Math.max(squares[0], squares[1], squares[2])), p = indices[f + turn], q = indices[f + (turn + 1) % 3], apex = indices[f + (turn + 2) % 3];
      for (let k = 0; k < 3; k++) {
        frames[row + k] = at(p, k);
        frames[row + 3 + k] = edges[3 * turn + k];
        frames[row + 6 + k] = at(apex, k) - at(p, k);
      }
      normalise(frames, row + 3);
      const x = dot(frames, row + 6, frames, row + 3);
      for (let k = 6; k < 9; k++) frames[row + k] -= x * frames[row + k - 3];
      [frames[row + LENGTH], frames[row + APEX], frames[row + APEX + 1]] = [Math.sqrt(squares[turn]), x, Math.sqrt(dot(frames, row + 6, frames, row + 6))];
      normalise(frames, row + 6);
      [this.units[face], this.faces[face], this.turns[face]] = [number, f / 3, turn];
      const other = open.get(q * vertices + p);
      if (other === undefined) open.set(p * vertices + q, face);
      else [this.others[other], this.isBelow[face]] = [face, open.delete(q * vertices + p) ? 1 : 0];
    }
    return first + indices.length / 3;
  }

  /** Finds the side, and places the cells as dense as they fit. @returns {number} texels a voxel */
  packedBest() {
    while (!this.packed(DENSITY) && this.side < MOST) this.side *= 2;
    let [low, high] = this.packed(DENSITY) ? [DENSITY, 4 * DENSITY] : [0.01, DENSITY];
    for (let step = 0; step < 8; step++) [low, high] = this.packed((low + high) / 2) ? [(low + high) / 2, high] : [low, (low + high) / 2];
    if (!this.packed(low)) throw new TexfError('limit', `the faces over voxels need an atlas of more than ${MOST} texels a side`);
    return low;
  }

  /** Places the cells, in rows. @param {number} density @returns {boolean} whether they fit */
  packed(density) {
    const {boxes, cells, frames, heights, side} = this;
    let x = 0, y = 0, row = 0, first = 0;
    const end = (/** @type {number} */ n, /** @type {number} */ tall) => { // the cells of a row fill it
      if (n > first) boxes[4 * n - 2] += side - x;
      for (; first < n; first++) boxes[4 * first + 3] = tall;
    };
    for (let n = 0; n < cells.length; n++) {
      const wide = Math.ceil(frames[FRAME * cells[n] + LENGTH] * density) + 2 * GUTTER, tall = Math.ceil(heights[cells[n]] * density) + 2 * GUTTER;
      if (x + wide > side) {
        end(n, row);
        [x, y, row] = [0, y + row, 0];
      }
      row = Math.max(row, tall);
      if (wide > side || y + row > side) return false;
      boxes[4 * n] = x;
      boxes[4 * n + 1] = y;
      boxes[4 * n + 2] = wide;
      boxes[4 * n + 3] = tall;
      x += wide;
    }
    end(cells.length, side - y);
    return true;
  }

  /** Writes UVs and tangents of a face. @param {number} n of its cell @param {number} face */
  place(n, face) {
    const {frames, boxes, density, side} = this, row = FRAME * face, number = this.units[face], {uvs, tangents} = this.corners[number], {normals} = this.asset.units[number];
    const length = frames[row + LENGTH], top = frames[FRAME * this.cells[n] + APEX + 1], sign = this.isBelow[face] ? -1 : 1, tangent = this.basis;
    for (let corner = 0; corner < 3; corner++) {
      const at = 3 * this.faces[face] + (this.turns[face] + corner) % 3, x = corner === 0 ? 0 : frames[row + LENGTH + corner - 1], y = corner === 2 ? frames[row + APEX + 1] : 0;
      uvs[2 * at] = (boxes[4 * n] + GUTTER + (sign > 0 ? x : length - x) * density) / side;
      uvs[2 * at + 1] = (boxes[4 * n + 1] + GUTTER + (top - sign * y) * density) / side;
      const across = dot(frames, row + 3, normals, 3 * at), other = Math.abs(normals[3 * at]) < 0.7 ? 0 : 1; // an axis for a normal along the edge
      for (let k = 0; k < 3; k++) tangent[k] = frames[row + 3 + k] - across * normals[3 * at + k];
      const isAlong = dot(tangent, 0, tangent, 0) <= 1e-12;
      for (let k = 0; k < 3; k++) tangent[k] = isAlong ? Number(k === other) - normals[3 * at + other] * normals[3 * at + k] : sign * tangent[k];
      normalise(tangent, 0);
      for (let k = 0; k < 4; k++) tangents[4 * at + k] = k < 3 ? tangent[k] : 1;
    }
  }

  /** A picture of channels, as pictureOf() of a field over texels, which finish() fills. @param {(string|null)[]} channels @returns {Picture} */
  picture(channels) {
    const {side} = this, picture = {width: side, height: side, data: new Uint8Array(4 * side * side).fill(255), hasAlpha: false};
    this.pictures.push({channels, picture});
    return picture;
  }

  /** Fills all pictures: a texel asks the voxels once for all of them. */
  finish() {
    const layers = this.corners.map((_, number) => this.layersOf(number));
    this.cells.forEach((face, n) => layers[this.units[face]].forEach((layer) => this.paint(n, layer)));
    for (const {channels, picture} of this.pictures.splice(0)) {
      if (channels.some((name) => name?.endsWith('normal'))) withZ(picture.data);
      picture.hasAlpha = Boolean(channels[3]) && hasAlpha(picture.data);
    }
  }

  /** How the field of a unit answers for the channels of the pictures. @param {number} number @returns {Layer[]} */
  layersOf(number) {
    const {field} = this.asset.units[number], {planes, keys, levelsLeftOut} = this.asset.fields[field], layers = /** @type {Map<number, Layer>} */ (new Map());
    for (const {channels, picture: {data}} of this.pictures) for (const [k, name] of channels.entries()) {
      const isNormal = name?.endsWith('normal') ?? false, plane = planes[isNormal ? `${name}_object` : name ?? ''], from = componentsOf(channels)[k];
      if (!plane || isNormal && from > 0) continue;
      const {values, components: step, offset, levelShift} = plane, coarser = Math.max(0, levelShift - levelsLeftOut), key = `${field} ${coarser}`;
      const voxels = this.voxels.get(key) ?? new Voxels(keys, coarser), layer = layers.get(coarser) ?? {voxels, size: 2 ** coarser, plain: [], normals: []};
      this.voxels.set(key, voxels);
      layers.set(coarser, layer);
      const at = offset + Math.min(from, step - offset - 1), last = layer.plain.at(-1);
      if (isNormal) layer.normals.push({values, step, at, width: 3, data, k});
      else if (last?.data === data && last.values === values && last.at + last.width === at && last.k + last.width === k && last.width < 3) last.width++;
      else layer.plain.push({values, step, at, width: 1, data, k});
    }
    return [...layers.values()];
  }

  /** Fills a cell. @param {number} n @param {Layer} layer */
  paint(n, {voxels, size, plain, normals}) {
    const {density, side, boxes, frames} = this, [left, upper, wide, tall] = boxes.subarray(4 * n, 4 * n + 4), first = this.cells[n], second = this.others[first];
    const length = frames[FRAME * first + LENGTH], top = frames[FRAME * first + APEX + 1];
    for (let j = 0; j < tall; j++) {
      const y = top - (j + 0.5 - GUTTER) / density, isSecond = second >= 0 && y < 0, face = isSecond ? second : first;
      for (let i = 0, to = 4 * ((upper + j) * side + left); i < wide; i++, to += 4) {
        const x = (i + 0.5 - GUTTER) / density;
        this.ask(voxels, size, face, isSecond ? length - x : x, isSecond ? -y : y);
        for (let o = 0; o < plain.length; o++) {
          const {values, step, at, width, data, k} = plain[o];
          voxels.sum(values, step, at, width);
          for (let c = 0; c < width; c++) data[to + k + c] = Math.round(voxels.sums[c]);
        }
        for (let o = 0; o < normals.length; o++) this.bend(to, face, voxels, normals[o]);
      }
    }
  }

  /** Asks voxels at a place on the plane of a face or, beyond its edges, at the nearest place of it, which is `near`.
   * @param {Voxels} voxels @param {number} size @param {number} face @param {number} x @param {number} y */
  ask(voxels, size, face, x, y) {
    const {frames, near} = this, row = FRAME * face, square = nearest(near, frames[row + LENGTH], frames[row + APEX], frames[row + APEX + 1], x, y);
    const place = (/** @type {number} */ k, /** @type {number} */ u, /** @type {number} */ v) => (frames[row + k] + u * frames[row + 3 + k] + v * frames[row + 6 + k]) / size;
    const isFar = Math.sqrt(square) * this.density > REACH;
    if (isFar || !voxels.ask(place(0, x, y), place(1, x, y), place(2, x, y), false)) voxels.ask(place(0, near[0], near[1]), place(1, near[0], near[1]), place(2, near[0], near[1]), true);
  }

  /** Writes x and y of the normal at `near`, in the tangent frame that a viewer has there. @param {number} to @param {number} face
   * @param {Voxels} voxels @param {Output} output */
  bend(to, face, voxels, {values, step, at, data}) {
    const {basis, near, frames, turns, faces} = this, row = FRAME * face, {normals} = this.asset.units[this.units[face]], {tangents} = this.corners[this.units[face]];
    voxels.sum(values, step, at, 3);
    const third = near[1] / (frames[row + APEX + 1] || 1), second = (near[0] - third * frames[row + APEX]) / (frames[row + LENGTH] || 1), first = 1 - second - third;
    const a = 3 * faces[face] + turns[face], b = 3 * faces[face] + (turns[face] + 1) % 3, c = 3 * faces[face] + (turns[face] + 2) % 3;
    for (let k = 0; k < 3; k++) {
      basis[k] = first * normals[3 * a + k] + second * normals[3 * b + k] + third * normals[3 * c + k];
      basis[3 + k] = first * tangents[4 * a + k] + second * tangents[4 * b + k] + third * tangents[4 * c + k];
    }
    normalise(basis, 0);
    normalise(basis, 3);
    for (let k = 0; k < 3; k++) {
      basis[6 + k] = basis[(k + 1) % 3] * basis[3 + (k + 2) % 3] - basis[(k + 2) % 3] * basis[3 + (k + 1) % 3];
      basis[9 + k] = basis[k] + voxels.sums[k] / FLAT - 1;
    }
    normalise(basis, 9);
    data[to] = Math.round(FLAT * (dot(basis, 9, basis, 3) + 1));
    data[to + 1] = Math.round(FLAT * (dot(basis, 9, basis, 6) + 1));
  }
}
