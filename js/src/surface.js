/** Geometry of a decoded stream in the spaces of the meshes that its units belong to. */

import {invalid} from './accessors.js';
import {cornerTangents} from './tangents.js';

/** @typedef {import('./engine.js').Asset} Asset */
/** @typedef {{units: number[], matrix: number[], splits: ArrayLike<number>|null}} Placed what a primitive says of its units */
/** @typedef {{position: Float32Array, place: Float32Array, normal: Float32Array|null, tangent: Float32Array|null, uv: Float32Array|null}} Columns */

const LEVEL = 1 - 1e-5; // cosine from which two normals are one

/** Columns of the inverse transpose of a 3 x 3 in columns, and the determinant. @param {number[]} matrix 4 x 4, column-major */
export function inverseTranspose(matrix) {
  const [a, b, c, , d, e, f, , g, h, i] = matrix, determinant = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g);
  const cofactors = [e * i - f * h, f * g - d * i, d * h - e * g, h * c - i * b, i * a - g * c, g * b - h * a, b * f - c * e, c * d - a * f, a * e - b * d];
  return {determinant, columns: cofactors.map((value) => value / determinant)};
}

/** A vector by three columns. @param {number[]} m @param {number} x @param {number} y @param {number} z */
const times = (m, x, y, z) => [m[0] * x + m[3] * y + m[6] * z, m[1] * x + m[4] * y + m[7] * z, m[2] * x + m[5] * y + m[8] * z];

/** @param {number[]} vector */
function unit(vector) {
  const length = Math.hypot(...vector);
  return length > 0 ? vector.map((value) => value / length) : vector;
}

export class Surface {
  /** @param {Asset} asset */
  constructor(asset) {
    this.asset = asset;
    this.scale = asset.side / (2 ** asset.positionBits - 1);
    /** @type {Map<number, boolean>} */
    this.flat = new Map();
    /** @type {Float32Array[]|null} */
    this.tangents = null;
    /** Of faces over voxels. @type {import('./atlas.js').Atlas|null} */
    this.atlas = null;
  }

  /** Stored vertex of each corner of a primitive: that which its face names, or another by a split.
   * @param {Placed} placed @param {number|null} count of stored values @returns {Uint32Array} */
  cornersOf({units, splits}, count) {
    const all = units.map((number) => this.asset.units[number]), corners = new Uint32Array(all.reduce((sum, {indices}) => sum + indices.length, 0));
    let base = 0, at = 0;
    for (const {indices, positions} of all) {
      for (const vertex of indices) corners[at++] = base + vertex;
      base += positions.length / 3;
    }
    let most = base;
    const pairs = splits ?? [];
    for (let i = 0; i < pairs.length; i += 2) {
      if (pairs[i] >= corners.length || pairs[i + 1] >= base + pairs.length / 2) throw invalid('a split of a primitive refers to a corner or vertex that is not there', 'TXF-I11');
      corners[pairs[i]] = pairs[i + 1];
      most = Math.max(most, pairs[i + 1] + 1);
    }
    if (count !== null && count !== most) throw invalid('a stored attribute has other values than the units have vertices');
    return corners;
  }

  /**
   * The faces of a primitive in some fields, in the mesh's space.
   * @param {Placed} placed @param {number[]} fields over texels or over voxels @param {Uint32Array} corners of cornersOf()
   * @param {{needsNormals: boolean, hasTangents: boolean, isMapped: boolean}} wanted needsNormals: also where faces are flat
   * @returns {{values: Columns, index: Uint32Array, vertex: Uint32Array}} vertex: stored vertex of each vertex
   */
  patch({units, matrix}, fields, corners, {needsNormals, hasTangents, isMapped}) {
    const {columns: turned, determinant} = inverseTranspose(matrix), linear = [0, 1, 2, 4, 5, 6, 8, 9, 10].map((i) => matrix[i]);
    if (!(Math.abs(determinant) > 0) || !turned.every(Number.isFinite)) throw invalid('the matrix of a primitive has no inverse');
    const vertices = new Vertices(this, {matrix, linear, turned, mirrored: determinant < 0}), index = /** @type {number[]} */ ([]);
    const shaded = needsNormals || units.some((number) => fields.includes(this.asset.units[number].field) && !this.isFlat(this.asset.units[number].material));
    let base = 0, at = 0;
    for (const number of units) {
      const {indices, positions, field: own, material} = this.asset.units[number];
      const normal = shaded && (needsNormals || !this.isFlat(material)), tangent = hasTangents ? this.tangentsOf(number) : null;
      const count = fields.includes(own) ? indices.length : 0, uvs = isMapped ? this.atlas?.corners[number]?.uvs ?? null : null;
      const has = {normals: normal ? this.asset.units[number].normals : null, tangents: tangent, uvs};
      for (let i = 0; i < count; i++) {
        const corner = determinant < 0 ? i - i % 3 + (3 - i % 3) % 3 : i;
        index.push(vertices.of(number, base, corner, corners[at + corner], has));
      }
      base += positions.length / 3;
      at += indices.length;
    }
    return {values: vertices.columns(shaded, hasTangents, this.asset.fields[fields[0]].planar || this.atlas !== null), index: Uint32Array.from(index), vertex: Uint32Array.from(vertices.stored)};
  }

  /** Tangents of a unit's corners. @param {number} number */
  tangentsOf(number) {
    this.tangents ??= cornerTangents(this.asset, this.scale);
    return this.atlas?.corners[number]?.tangents ?? this.tangents[number];
  }

  /** Whether all faces of a material of the stream are shaded flat, so that normals say nothing. @param {number} material */
  isFlat(material) {
    const units = this.asset.units.filter((part) => part.material === material);
    if (!this.flat.has(material)) this.flat.set(material, this.asset.materials[material].flat || units.every(({indices, lattice, normals}) => {
      for (let f = 0; f < indices.length; f += 3) {
        const [a, b, c] = [0, 1, 2].map((k) => [0, 1, 2].map((j) => normals[3 * (f + k) + j])), dot = (/** @type {number[]} */ u, /** @type {number[]} */ v) => u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
        if (Math.min(dot(a, b), dot(b, c), dot(c, a)) <= LEVEL) return false;
        const [p, q, r] = [0, 1, 2].map((k) => [0, 1, 2].map((j) => lattice[3 * indices[f + k] + j]));
        const u = q.map((v, j) => v - p[j]), w = r.map((v, j) => v - p[j]), across = [u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]];
        if (dot(across, a) < LEVEL * Math.hypot(...across)) return false;
      }
      return true;
    }));
    return /** @type {boolean} */ (this.flat.get(material));
  }
}

/** @typedef {{normals: Float32Array|null, tangents: Float32Array|null, uvs: Float32Array|null}} Corners what a unit's corners have; uvs: of an atlas */

/** Vertices of a primitive: corners that agree in all are one. */
class Vertices {
  /** @param {Surface} surface @param {{matrix: number[], linear: number[], turned: number[], mirrored: boolean}} transform */
  constructor(surface, transform) {
    this.surface = surface;
    this.transform = transform;
    /** @type {Map<number, number[]>} */
    this.known = new Map();
    this.stored = /** @type {number[]} */ ([]);
    this.decoded = /** @type {[number, number][]} */ ([]); // unit and vertex in it
    this.normals = /** @type {number[]} */ ([]);
    this.tangents = /** @type {number[]} */ ([]);
    this.uvs = /** @type {number[]} */ ([]); // of an atlas
  }

  /** @param {number} number of the unit @param {number} base of its vertices @param {number} corner @param {number} stored
   * @param {Corners} has @returns {number} the vertex of a corner */
  of(number, base, corner, stored, has) {
    const vertex = this.surface.asset.units[number].indices[corner], others = this.known.get(base + vertex), {normals, tangents, uvs} = has;
    const same = others?.find((n) => this.stored[n] === stored && this.agree(n, corner, has));
    if (same !== undefined) return same;
    if (others) others.push(this.stored.length);
    else this.known.set(base + vertex, [this.stored.length]);
    this.decoded.push([number, vertex]);
    for (let k = 0; k < 3; k++) this.normals.push(normals ? normals[3 * corner + k] : 0);
    for (let k = 0; k < 4; k++) this.tangents.push(tangents ? tangents[4 * corner + k] : 0);
    for (let k = 0; k < 2; k++) this.uvs.push(uvs ? uvs[2 * corner + k] : 0);
    return this.stored.push(stored) - 1;
  }

  /** Whether a vertex has the values of a corner. @param {number} n @param {number} corner @param {Corners} has */
  agree(n, corner, {normals, tangents, uvs}) {
    const same = (/** @type {ArrayLike<number>} */ own, /** @type {Float32Array|null} */ of, /** @type {number} */ width) => {
      if (!of) return true;
      for (let k = 0; k < width; k++) if (own[width * n + k] !== of[width * corner + k]) return false;
      return true;
    };
    return same(this.normals, normals, 3) && same(this.tangents, tangents, 4) && same(this.uvs, uvs, 2);
  }

  /** @param {boolean} hasNormals @param {boolean} hasTangents @param {boolean} hasUvs @returns {Columns} */
  columns(hasNormals, hasTangents, hasUvs) {
    const {asset: {units, origin}, scale} = this.surface, {matrix, linear, turned, mirrored} = this.transform, count = this.stored.length;
    const position = new Float32Array(3 * count), place = new Float32Array(3 * count), normal = new Float32Array(3 * count);
    const tangent = new Float32Array(4 * count), uv = new Float32Array(2 * count);
    this.decoded.forEach(([number, vertex], n) => {
      const {lattice, positions, uvs} = units[number], at = [0, 1, 2].map((k) => origin[k] + lattice[3 * vertex + k] * scale);
      position.set(times(linear, at[0], at[1], at[2]).map((value, k) => value + matrix[12 + k]), 3 * n);
      place.set(positions.subarray(3 * vertex, 3 * vertex + 3), 3 * n);
      normal.set(unit(times(turned, this.normals[3 * n], this.normals[3 * n + 1], this.normals[3 * n + 2])), 3 * n);
      tangent.set(unit(times(linear, this.tangents[4 * n], this.tangents[4 * n + 1], this.tangents[4 * n + 2])), 4 * n);
      tangent[4 * n + 3] = this.tangents[4 * n + 3] * (mirrored ? -1 : 1);
      uv.set(uvs ? uvs.subarray(2 * vertex, 2 * vertex + 2) : [this.uvs[2 * n], this.uvs[2 * n + 1]], 2 * n);
    });
    return {position, place, normal: hasNormals ? normal : null, tangent: hasNormals && hasTangents ? tangent : null, uv: hasUvs ? uv : null};
  }
}
