/** Rows of numbers as textures that a shader reads by their number. */

import {DataTexture, FloatType, NearestFilter, UnsignedByteType, UnsignedIntType} from 'three';

const ROW_LOG2 = 11;

/** Where a row stands. */
export const PLACE_GLSL = `ivec2 place(int i) { return ivec2(i & ${2 ** ROW_LOG2 - 1}, i >> ${ROW_LOG2}); }`;

/** Rows of `size` numbers each.
 * @template {Uint8Array|Uint32Array|Float32Array} T
 * @param {T} rows @param {number} size @param {import('three').PixelFormat} format @param {import('three').PixelFormatGPU|null} internal */
export function tableTexture(rows, size, format, internal) {
  const width = 2 ** ROW_LOG2, height = Math.max(1, Math.ceil(rows.length / size / width));
  const Type = /** @type {new (length: number) => T} */ (rows.constructor), data = new Type(size * width * height);
  data.set(rows);
  const type = rows instanceof Float32Array ? FloatType : rows instanceof Uint8Array ? UnsignedByteType : UnsignedIntType;
  const table = new DataTexture(/** @type {any} */ (data), width, height, format, type);
  table.internalFormat = internal;
  table.minFilter = table.magFilter = NearestFilter;
  table.needsUpdate = true;
  return table;
}
