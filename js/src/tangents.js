/** Tangents of face corners for normal maps over texels, as geometry/tangents.py of the repository has them: nearly MikkTSpace. */

/** @typedef {number[]} Vector */

const SHORT = 1e-30; // what is shorter has no direction
const dot = (/** @type {Vector} */ a, /** @type {Vector} */ b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const minus = (/** @type {Vector} */ a, /** @type {Vector} */ b) => a.map((value, k) => value - b[k]);
/** The part of a vector in the plane of a normal. @param {Vector} a @param {Vector} normal */
const within = (a, normal) => minus(a, normal.map((value) => value * dot(a, normal)));

/** A vector scaled to length 1; 0 without a direction. @param {Vector} a */
function unit(a) {
  const largest = Math.max(...a.map(Math.abs)), length = largest > SHORT ? largest * Math.hypot(...a.map((value) => value / largest)) : 0;
  return length > 0 ? a.map((value) => value / length) : [0, 0, 0];
}

/** Where u grows on a face, unit or 0, and the sign of its chart. @param {Vector[]} corners @param {number[][]} uv */
function alongU([a, b, c], [s, t, r]) {
  const first = minus(b, a), second = minus(c, a), u1 = t[0] - s[0], v1 = t[1] - s[1], u2 = r[0] - s[0], v2 = r[1] - s[1];
  const sign = Math.sign(u2 * v1 - u1 * v2), along = unit(first.map((value, k) => -sign * (v2 * value - v1 * second[k])));
  return {along, sign: dot(along, along) > 0 ? sign : 0, hasArea: sign !== 0};
}

/**
 * Unit tangents of the corners of all units over texels, and the sign of the bitangent; 0 where UVs have no area.
 * @param {import('./engine.js').Asset} asset @param {number} scale of lattice steps
 * @returns {Float32Array[]} [faces, 3 corners, 4] of each unit, empty over voxels
 */
export function cornerTangents(asset, scale) {
  /** @type {Map<string, {sum: Vector, normal: Vector, sign: number, corners: [number, number][]}>} */
  const groups = new Map();
  const out = asset.units.map(({indices, lattice, normals, texelSteps, field}, n) => {
    const {width, height, fractionBits} = asset.fields[field], tangents = new Float32Array(texelSteps ? 4 * indices.length : 0);
    if (!texelSteps) return tangents;
    for (let f = 0; f < indices.length; f += 3) {
      const at = [0, 1, 2].map((k) => indices[f + k]), corners = at.map((v) => [0, 1, 2].map((j) => lattice[3 * v + j] * scale));
      const uv = at.map((v) => [texelSteps[2 * v] / (width * 2 ** fractionBits), texelSteps[2 * v + 1] / (height * 2 ** fractionBits)]);
      const {along, sign, hasArea} = alongU(corners, uv);
      for (let k = 0; k < (hasArea ? 3 : 0); k++) {
        const normal = unit([0, 1, 2].map((j) => normals[3 * (f + k) + j])), flat = unit(within(along, normal));
        const [left, right] = [1, 2].map((turn) => unit(within(minus(corners[(k + turn) % 3], corners[k]), normal)));
        const weight = Math.acos(Math.min(1, Math.max(-1, dot(left, right)))), key = `${corners[k]} ${uv[k]} ${normal} ${sign}`;
        const group = groups.get(key) ?? {sum: [0, 0, 0], normal, sign, corners: []};
        group.sum = group.sum.map((value, j) => value + weight * flat[j]);
        group.corners.push([n, f + k]);
        groups.set(key, group);
      }
    }
    return tangents;
  });
  for (const {sum, normal, sign, corners} of groups.values()) {
    const tangent = unit(within(sum, normal)), isDirection = dot(tangent, tangent) > 0, axis = Math.abs(normal[0]) < 0.7 ? [1, 0, 0] : [0, 1, 0];
    const four = [...(isDirection ? tangent : unit(within(axis, normal))), isDirection && sign < 0 ? -1 : 1];
    for (const [n, corner] of corners) out[n].set(four, 4 * corner);
  }
  return out;
}
