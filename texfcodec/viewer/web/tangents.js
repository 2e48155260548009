// Tangents of corners, as texfcodec/geometry/tangents.py makes them: what glTF asks for, up to how MikkTSpace splits groups.

const FLAT = 1e-30;

/**
 * Unit tangents Float32Array [corners, 4], orthogonal to the normals, the last of them the bitangent's sign; 0 where the UVs of
 * a face have no area. lattice: integers [corners, 3]; uv: [corners, 2] in texels; normals: [corners, 3]; three corners a face.
 */
export function cornerTangents(lattice, uv, normals) {
  const count = normals.length / 3, groups = groupsOf(lattice, uv, normals), sums = new Float64Array(3 * groups.count);
  const signs = new Int8Array(count / 3), vector = new Float64Array(3);
  for (let face = 0; face < count / 3; face++) {
    signs[face] = faceTangent(lattice, uv, 3 * face, vector);
    if (signs[face] === 0) continue;
    for (let k = 0; k < 3; k++) {
      const corner = 3 * face + k, flat = within(vector, normals, corner);
      if (!unit(flat)) continue;
      const weight = angle(lattice, normals, 3 * face, k), at = 3 * groups.of[corner];
      for (let axis = 0; axis < 3; axis++) sums[at + axis] += weight * flat[axis];
    }
  }
  const out = new Float32Array(4 * count);
  for (let corner = 0; corner < count; corner++) {
    const sign = signs[Math.floor(corner / 3)];
    if (!hasArea(uv, 3 * Math.floor(corner / 3))) continue;
    let tangent = within(sums.subarray(3 * groups.of[corner], 3 * groups.of[corner] + 3), normals, corner);
    const isDirection = unit(tangent);
    if (!isDirection) {
      tangent = within(Math.abs(normals[3 * corner]) < 0.7 ? [1, 0, 0] : [0, 1, 0], normals, corner);
      unit(tangent);
    }
    out.set(tangent, 4 * corner);
    out[4 * corner + 3] = isDirection && sign < 0 ? -1 : 1;
  }
  return out;
}

function hasArea(uv, corner) {
  const [u, v, u1, v1, u2, v2] = uv.subarray(2 * corner, 2 * corner + 6);
  return (u1 - u) * (v2 - v) - (u2 - u) * (v1 - v) !== 0;
}

/** Puts the direction along which u grows into `out`; returns the chart's sign with v upwards, 0 where there is no direction. */
function faceTangent(lattice, uv, corner, out) {
  const [u, v, ua, va, ub, vb] = uv.subarray(2 * corner, 2 * corner + 6), at = 3 * corner;
  const [u1, v1, u2, v2] = [ua - u, va - v, ub - u, vb - v], sign = Math.sign(u2 * v1 - u1 * v2);
  for (let axis = 0; axis < 3; axis++) {
    const first = lattice[at + 3 + axis] - lattice[at + axis], second = lattice[at + 6 + axis] - lattice[at + axis];
    out[axis] = -sign * (v2 * first - v1 * second);
  }
  return unit(out) ? sign : 0;
}

/** The angle at corner k of a face, between the edges laid into the plane of its normal. */
function angle(lattice, normals, first, k) {
  const edges = [1, 2].map((turn) => {
    const to = 3 * (first + ((k + turn) % 3)), from = 3 * (first + k);
    const edge = within([0, 1, 2].map((axis) => lattice[to + axis] - lattice[from + axis]), normals, first + k);
    unit(edge);
    return edge;
  });
  const cosine = edges[0][0] * edges[1][0] + edges[0][1] * edges[1][1] + edges[0][2] * edges[1][2];
  return Math.acos(Math.min(1, Math.max(-1, cosine)));
}

/** What is left of a vector in the plane of a corner's normal. */
function within(vector, normals, corner) {
  const [x, y, z] = vector, n = normals.subarray(3 * corner, 3 * corner + 3), along = x * n[0] + y * n[1] + z * n[2];
  return [x - along * n[0], y - along * n[1], z - along * n[2]];
}

/** Gives a vector length 1; whether it has a direction. */
function unit(vector) {
  const largest = Math.max(Math.abs(vector[0]), Math.abs(vector[1]), Math.abs(vector[2]));
  const length = largest > FLAT ? Math.hypot(vector[0], vector[1], vector[2]) : 0;
  for (let axis = 0; axis < 3; axis++) vector[axis] = length > 0 ? vector[axis] / length : 0;
  return length > 0;
}

/** Numbers of groups of corners that have a position, a UV, a normal and a hand in common: { of: Uint32Array, count }. */
function groupsOf(lattice, uv, normals) {
  const corners = normals.length / 3, rows = new Float64Array(9 * corners), row = new Float64Array(3);
  for (let corner = 0; corner < corners; corner++) {
    const at = 9 * corner;
    for (let k = 0; k < 3; k++) rows[at + k] = lattice[3 * corner + k];
    for (let k = 0; k < 2; k++) rows[at + 3 + k] = uv[2 * corner + k];
    for (let k = 0; k < 3; k++) rows[at + 5 + k] = normals[3 * corner + k] + 0; // no negative zeros
    rows[at + 8] = faceTangent(lattice, uv, 3 * Math.floor(corner / 3), row);
  }
  return distinctRows(rows, 9);
}

/** Equal rows of numbers: { of: Uint32Array, number of each row's kind; first: the first row of every kind; count }. */
export function distinctRows(rows, width) {
  const count = rows.length / width, log2 = Math.max(4, 33 - Math.clz32(count)), mask = 2 ** log2 - 1;
  const table = new Int32Array(2 ** log2).fill(-1), of = new Uint32Array(count), first = [];
  const words = new Uint32Array(rows.buffer, rows.byteOffset, rows.byteLength / 4), wide = width * rows.BYTES_PER_ELEMENT / 4;
  for (let row = 0; row < count; row++) {
    let hash = 0;
    for (let k = row * wide; k < row * wide + wide; k++) hash = Math.imul(hash ^ words[k], 2654435761) + (hash >>> 15);
    let slot = hash & mask;
    while (table[slot] >= 0 && !isSame(words, wide, row, first[table[slot]])) slot = (slot + 1) & mask;
    if (table[slot] < 0) {
      table[slot] = first.length;
      first.push(row);
    }
    of[row] = table[slot];
  }
  return { of, first: Uint32Array.from(first), count: first.length };
}

function isSame(words, wide, a, b) {
  for (let k = 0; k < wide; k++) if (words[a * wide + k] !== words[b * wide + k]) return false;
  return true;
}
