/**
 * Pictures as blocks of 4 x 4 texels that a graphics card keeps as they are, 16 bytes each: BC7 or ASTC, with their mipmaps
 * (native/blocks.cpp). Colours of mipmaps are means in linear light, as those of textures that WebGL makes.
 *
 * @typedef {'bc7'|'astc'} BlockFormat
 * @typedef {{format: BlockFormat, levels: {data: Uint8Array, width: number, height: number}[]}} Blocks the largest level first
 */

const PAGE = 65536;

/** Bytes of a level. @param {number} width @param {number} height */
const bytesOf = (width, height) => 16 * Math.ceil(width / 4) * Math.ceil(height / 4);

/** Width and height of all levels, the largest first. @param {number} width @param {number} height */
function levelSizes(width, height) {
  const count = 32 - Math.clz32(Math.max(width, height));
  return Array.from({length: count}, (_, n) => [Math.max(1, width >> n), Math.max(1, height >> n)]);
}

/**
 * @param {WebAssembly.Module} module blocks.wasm
 * @param {import('./pictures.js').Picture} picture
 * @param {BlockFormat} format @param {boolean} isColour whether its RGB is sRGB
 * @returns {Blocks}
 */
export function blocksOf(module, {data, width, height, hasAlpha}, format, isColour) {
  const {memory, start, encode} = /** @type {any} */ (new WebAssembly.Instance(module).exports);
  const sizes = levelSizes(width, height), total = sizes.reduce((sum, [w, h]) => sum + bytesOf(w, h), 0);
  const from = Math.ceil(start() / 16) * 16, to = from + Math.ceil(data.length / 16) * 16;
  memory.grow(Math.max(0, Math.ceil((to + total - memory.buffer.byteLength) / PAGE)));
  new Uint8Array(memory.buffer, from, data.length).set(data);
  encode(from, width, height, format === 'bc7' ? 0 : 1, isColour ? 1 : 0, hasAlpha ? 1 : 0, to);
  const blocks = new Uint8Array(memory.buffer.slice(to, to + total));
  let at = 0;
  const levels = sizes.map(([w, h]) => ({data: blocks.subarray(at, at += bytesOf(w, h)), width: w, height: h}));
  return {format, levels};
}
