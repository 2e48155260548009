// What the page draws of a decoded stream (engine.js): buffers as a GPU takes them, under the names of viewer/pack.py's header.

import { CHANNELS } from './engine.js';
import { ALL_TERMS, lookOfMaterial } from './materials.js';
import { bricksOf, coarserValues } from './supports.js';
import { cornerTangents, distinctRows } from './tangents.js';

const SHORT = 32767;
const EXACT = 1 << 15; // texels up to which binary32 has 8 fractional bits
const FEW = 8, NEAR = 4, MOST_OTHERS = 0.02, POINTS = 4096; // as render/backdrop.py
const WRAPS = ['repeat', 'clamp', 'mirror'];
const WANTED_MAPS = ['normal', 'clearcoat_normal'];

/** asset: of decodeWith(); name: what the page calls it; bytes: of its file. */
export function headerOfStream(asset, name, bytes) {
  const materials = asset.materials.map(lookOfMaterial), [centre, radius] = sphereOf(asset);
  const isLit = materials.some((material) => material.effects.includes('lit'));
  const fields = asset.fields.map((field, number) => (field.planar ? texelField(field) : voxelField(asset, field, number)));
  const header = {
    kind: 'stream', name, bytes, faces: asset.units.reduce((sum, unit) => sum + unit.indices.length / 3, 0), centre,
    radius: radius || 1, plain: isPlain(asset), warnings: [], materials,
    mesh: meshOf(asset, materials, isLit, centre, radius || 1),
    channels: CHANNELS.filter((channel) => asset.fields.some((field) => channel in field.planes)), fields, payload: payloadOf(asset),
  };
  return { ...header, resident: bytesOf(header) };
}

/** What both kinds of headers get of the page itself. light: of viewer/light.py. */
export function withLight(header, light) {
  const effects = [...new Set(header.materials.flatMap((material) => material.effects))].sort();
  return { ...header, effects, defaults: ALL_TERMS, light: effects.includes('lit') ? light : null };
}

/** Centre and radius of the sphere round the box of all vertices. */
function sphereOf({ units, origin, side, positionBits }) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity], scale = side / (2 ** positionBits - 1);
  for (const { lattice } of units) {
    for (let i = 0; i < lattice.length; i += 3) {
      for (let axis = 0; axis < 3; axis++) {
        low[axis] = Math.min(low[axis], lattice[i + axis]);
        high[axis] = Math.max(high[axis], lattice[i + axis]);
      }
    }
  }
  if (low[0] === Infinity) return [[0, 0, 0], 0];
  const [a, b] = [low, high].map((ends) => ends.map((p, axis) => origin[axis] + p * scale));
  return [a.map((v, axis) => v / 2 + b[axis] / 2), Math.hypot(...b.map((v, axis) => v / 2 - a[axis] / 2))];
}

/** Whether base colour has few colours, so that a picture without light shows an outline: of cells that lie evenly. */
function isPlain({ fields }) {
  const colours = [];
  const total = fields.reduce((sum, field) => sum + field.keys.length, 0), step = Math.max(1, Math.floor(total / POINTS));
  for (const { planes } of fields) {
    const plane = planes.base_colour, size = plane?.components ?? 1, count = plane ? plane.values.length / size : 0;
    for (let cell = 0; cell < count; cell += step) {
      colours.push([0, 1, 2].map((c) => plane.values[cell * size + Math.min(plane.offset + c, size - 1)]));
    }
  }
  const most = MOST_OTHERS * colours.length;
  let left = colours;
  for (let n = 0; n < FEW && left.length > most; n++) {
    const counts = new Map();
    for (const colour of left) counts.set(String(colour), (counts.get(String(colour)) ?? 0) + 1);
    const found = [...counts].reduce((a, b) => (b[1] > a[1] ? b : a))[0].split(',').map(Number);
    left = left.filter((colour) => colour.some((value, c) => Math.abs(value - found[c]) > NEAR));
  }
  return total > 0 && left.length <= most;
}

// Corners

/**
 * Vertices and triangles: a vertex stands there once for every normal, tangent and UV that its corners have. The last faces come
 * first, for where two are equally near the page shows the one that it draws last, and texf-render the first.
 */
function meshOf(asset, materials, isLit, centre, radius) {
  const { units, fields, origin, side, positionBits } = asset, wide = positionBits > 16;
  const corners = cornersOf(units), planar = fields.some((field) => field.planar), columns = {};
  if (isLit && corners.count) {
    columns.normal = [octOf(corners.normals, 3, corners.count), 2];
    const asks = materials.some(({ maps, effects }) => WANTED_MAPS.some((map) => maps.includes(map)) || effects.includes('anisotropy'));
    if (asks && planar) columns.tangent = [tangentsOf(corners), 4];
  }
  if (planar) columns.uv0 = [nearUvs(corners, fields), 2];
  const parts = partsOf(corners.parts);
  const rowWidth = 1 + Object.values(columns).reduce((sum, [array, size]) => sum + (size * array.BYTES_PER_ELEMENT) / 4, 0);
  const rows = new Uint32Array(rowWidth * corners.count);
  let column = 0;
  const put = (words, width) => {
    for (let row = 0; row < corners.count; row++) {
      for (let k = 0; k < width; k++) rows[row * rowWidth + column + k] = words[row * width + k];
    }
    column += width;
  };
  put(corners.vertex, 1);
  for (const [array] of Object.values(columns)) put(new Uint32Array(array.buffer), array.byteLength / 4 / Math.max(1, corners.count));
  const { of, first } = distinctRows(rows, rowWidth);
  const positions = new (wide ? Uint32Array : Uint16Array)(3 * first.length);
  first.forEach((corner, i) => {
    for (let axis = 0; axis < 3; axis++) positions[3 * i + axis] = corners.lattice[3 * corner + axis];
  });
  const attributes = Object.fromEntries(Object.entries(columns).map(([name, [array, size]]) => {
    const out = new array.constructor(size * first.length);
    first.forEach((corner, i) => out.set(array.subarray(size * corner, size * corner + size), size * i));
    return [name, out];
  }));
  const scale = side / (2 ** positionBits - 1) / radius;
  return { positions, faces: of, scale, offset: origin.map((o, axis) => (o - centre[axis]) / radius), parts, attributes };
}

/** All corners in the order in which they are drawn; parts: [face, field, material] of each run of faces of one unit. */
function cornersOf(units) {
  const count = units.reduce((sum, unit) => sum + unit.indices.length, 0);
  const out = {
    count, vertex: new Uint32Array(count), lattice: new Uint32Array(3 * count), normals: new Float32Array(3 * count),
    texels: new Int32Array(2 * count), field: new Uint32Array(count), planar: new Uint8Array(count), parts: [],
  };
  let at = 0, base = units.reduce((sum, unit) => sum + unit.lattice.length / 3, 0);
  for (const { indices, lattice, normals, texelSteps, field, material } of [...units].reverse()) {
    base -= lattice.length / 3;
    if (indices.length) out.parts.push([at / 3, indices.length / 3, field, material]);
    for (let face = indices.length / 3 - 1; face >= 0; face--) {
      for (let k = 3 * face; k < 3 * face + 3; k++, at++) {
        const v = indices[k];
        out.vertex[at] = base + v;
        out.field[at] = field;
        for (let axis = 0; axis < 3; axis++) {
          out.lattice[3 * at + axis] = lattice[3 * v + axis];
          out.normals[3 * at + axis] = normals[3 * k + axis];
        }
        if (!texelSteps) continue;
        out.planar[at] = 1;
        out.texels[2 * at] = texelSteps[2 * v];
        out.texels[2 * at + 1] = texelSteps[2 * v + 1];
      }
    }
  }
  return out;
}

/** [first face, faces, field, material] of what is drawn at once. */
function partsOf(runs) {
  const parts = [];
  for (const [first, count, field, material] of runs) {
    const last = parts.at(-1);
    if (last && last[2] === field && last[3] === material) last[1] += count;
    else parts.push([first, count, field, material]);
  }
  return parts;
}

/** Unit directions, `size` numbers a row, as Int16Array [rows, 2] on an octahedron; both the least where there is none. */
function octOf(directions, size, rows) {
  const out = new Int16Array(2 * rows);
  for (let row = 0; row < rows; row++) {
    const [x, y, z] = directions.subarray(size * row, size * row + 3), sum = Math.abs(x) + Math.abs(y) + Math.abs(z);
    if (!(sum >= 1e-12)) {
      out[2 * row] = out[2 * row + 1] = -SHORT;
      continue;
    }
    let [a, b] = [x / sum, y / sum];
    if (z < 0) [a, b] = [(1 - Math.abs(b)) * (a < 0 ? -1 : 1), (1 - Math.abs(a)) * (b < 0 ? -1 : 1)];
    [a, b] = [a, b].map((v) => Math.round(v * SHORT));
    if (a <= -SHORT && b <= -SHORT) [a, b] = [SHORT, SHORT]; // the same direction: both the least say that there is none
    out[2 * row] = a;
    out[2 * row + 1] = b;
  }
  return out;
}

/** Int16Array [corners, 4]: tangents on an octahedron, the bitangent's sign, and nothing. */
function tangentsOf({ count, planar, lattice, texels, normals }) {
  const chosen = [];
  for (let corner = 0; corner < count; corner++) if (planar[corner]) chosen.push(corner);
  const gathered = (from, size, Type) => {
    const to = new Type(size * chosen.length);
    chosen.forEach((corner, i) => { for (let k = 0; k < size; k++) to[size * i + k] = from[size * corner + k]; });
    return to;
  };
  const found = cornerTangents(gathered(lattice, 3, Float64Array), gathered(texels, 2, Float64Array), gathered(normals, 3, Float32Array));
  const tangents = new Float32Array(4 * count), out = new Int16Array(4 * count);
  chosen.forEach((corner, i) => tangents.set(found.subarray(4 * i, 4 * i + 4), 4 * corner));
  const directions = octOf(tangents, 4, count);
  for (let corner = 0; corner < count; corner++) {
    out[4 * corner] = directions[2 * corner];
    out[4 * corner + 1] = directions[2 * corner + 1];
    out[4 * corner + 2] = tangents[4 * corner + 3] < 0 ? -SHORT : SHORT;
  }
  return out;
}

/** UVs of corners in texels, Float32Array [corners, 2]; of faces so far off that binary32 would not do, those of the same texels
 * near the origin. */
function nearUvs({ count, field: which, planar, texels }, fields) {
  const out = new Float32Array(2 * count), three = [0, 0, 0];
  for (let corner = 0; corner < count; corner += 3) {
    if (!planar[corner]) continue;
    const field = fields[which[corner]], step = 2 ** -field.fractionBits;
    [field.width, field.height].forEach((size, axis) => {
      for (let k = 0; k < 3; k++) three[k] = texels[2 * (corner + k) + axis] * step;
      const least = Math.min(...three), wrap = field.wrap[axis], period = size * (wrap === 'mirror' ? 2 : 1);
      const far = wrap !== 'clamp' && Math.max(...three.map(Math.abs)) > EXACT;
      for (let k = 0; k < 3; k++) out[2 * (corner + k) + axis] = three[k] - (far ? Math.floor(least / period) * period : 0);
    });
  }
  return out;
}

// Fields

/** Planes of a field, with their channels: [[level shift, [[channel, plane]]]], the finest first. */
function byShift({ planes }) {
  const shifts = [...new Set(Object.values(planes).map((plane) => plane.levelShift))].sort((a, b) => a - b);
  return shifts.map((shift) => [shift, Object.entries(planes).filter(([, plane]) => plane.levelShift === shift)]);
}

/** Components of channels side by side: Uint8Array [cells, all of them]. valuesOf: of a plane, all of its group's components. */
function sideBySide(named, cells, valuesOf) {
  const channels = named.map(([name]) => [name, componentsOf(name)]), width = channels.reduce((sum, [, count]) => sum + count, 0);
  const out = new Uint8Array(cells * width);
  let column = 0;
  named.forEach(([, plane], n) => {
    const from = valuesOf(plane), { components, offset } = plane;
    for (let c = 0; c < channels[n][1]; c++, column++) {
      const at = Math.min(offset + c, components - 1); // grey: one for all
      for (let cell = 0; cell < cells; cell++) out[cell * width + column] = from[cell * components + at];
    }
  });
  return [channels, out];
}

function componentsOf(name) {
  if (name === 'normal' || name === 'clearcoat_normal') return 2;
  return /colour$|^emissive$|_object$|^anisotropy$/.test(name) ? 3 : 1;
}

function depthOf(resolution) {
  return 32 - Math.clz32(resolution - 1);
}

function voxelField(asset, field, number) {
  const depth = depthOf(field.resolution), bricks = bricksOf(field.keys), isNeural = asset.neural !== null, first = isNeural && depth > 0 ? 1 : 0;
  const above = first ? coarserValues(bricks) : null;
  const planes = byShift(field).map(([shift, named]) => {
    const cells = named[0][1].values.length / named[0][1].components;
    const [channels, values] = sideBySide(named, cells, (plane) => plane.values);
    if (!first || shift > 0) return { channels, level: shift, values, counts: null };
    return { channels, level: 1, ...above.means(values) };
  });
  const told = {
    kind: 'voxels', size: field.resolution, depth, full_size: field.resolution, count: field.keys.length, first, planes,
    grid_scale: field.resolution / 2 ** asset.positionBits, ...(above?.bricks ?? bricks),
  };
  if (!isNeural) return told;
  return { ...told, kind: 'latents', latents: asset.neural.levels.map(({ log2, keys }) => (log2 > 0 ? null : bricksOf(keys[number]))) };
}

/** A field over texels: its images, and which of their texels the surface asks. */
function texelField(field) {
  const planes = byShift(field).map(([shift, named]) => {
    const { width, height } = named[0][1].image;
    const [channels, values] = sideBySide(named, width * height, (plane) => plane.image.data);
    return { channels, level: shift, size: [width, height], values, mask: maskOf(field.keys, shift, width, height) };
  });
  const size = [field.width, field.height];
  return {
    kind: 'texels', size, full_size: size, count: field.keys.length, shift: 0, planes, wrap: field.wrap.map((wrap) => WRAPS.indexOf(wrap)),
  };
}

/** Bits, row after row from the low ones on; null where every texel is asked. */
function maskOf(keys, shift, width, height) {
  const halves = new Uint32Array(keys.buffer, keys.byteOffset, 2 * keys.length), mask = new Uint8Array(Math.ceil((width * height) / 8));
  let asked = 0;
  for (let i = 0; i < halves.length; i += 2) {
    const x = thirdBits(halves[i], halves[i + 1]) >> shift, y = thirdBits(halves[i] >>> 1 | halves[i + 1] << 31, halves[i + 1] >>> 1) >> shift;
    const place = y * width + x, bit = 1 << (place & 7);
    if (mask[place >> 3] & bit) continue;
    mask[place >> 3] |= bit;
    asked++;
  }
  return asked === width * height ? null : mask;
}

/** Every third bit of a number of two words, the lowest first. */
function thirdBits(low, high) {
  const gathered = (word, from) => {
    let out = 0;
    for (let bit = from, n = 0; bit < 32; bit += 3, n++) out |= ((word >>> bit) & 1) << n;
    return out;
  };
  return gathered(low, 0) | (gathered(high, 1) << 11);
}

/** What a shader asks to answer as the network does, how it counts places, and which of its outputs belong to which channel. */
function payloadOf({ neural, fields, positionBits }) {
  if (!neural) return null;
  const bits = 24, { features, octaves, widths, codes, network, outputs } = neural;
  return {
    features, octaves, first_wave: neural.firstWave, widths, rows: (2 * codes.length) / features, position_bits: bits, codes, network,
    levels: neural.levels.map(({ resolution, log2, firstRows }) => ({ resolution, log2, first_rows: firstRows })), outputs,
    salts: fields.map((_, number) => Math.imul(number, 3674653429) >>> 0), grid_scale: 2 ** (bits - positionBits),
  };
}

/** Bytes of all arrays in a header, each counted once. */
function bytesOf(header) {
  const seen = new Set(), todo = [header];
  let sum = 0;
  while (todo.length) {
    const one = todo.pop();
    if (one === null || typeof one !== 'object' || seen.has(one)) continue;
    seen.add(one);
    if (ArrayBuffer.isView(one)) sum += one.byteLength;
    else todo.push(...Object.values(one));
  }
  return sum;
}
