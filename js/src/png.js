/** PNG files of pictures, written where there may be no canvas. */

import {through} from './accessors.js';

const CRC = Uint32Array.from({length: 256}, (_, n) => {
  for (let bit = 0; bit < 8; bit++) n = n & 1 ? 0xEDB88320 ^ (n >>> 1) : n >>> 1;
  return n;
});
const SIGNATURE = [0x89, 0x50, 0x4E, 0x47, 0x0D, 0x0A, 0x1A, 0x0A], TRUE_COLOUR = 2, WITH_ALPHA = 6, PAETH = 4;

/** @param {string} type @param {Uint8Array} data */
function chunk(type, data) {
  const out = new Uint8Array(data.length + 12), view = new DataView(out.buffer);
  view.setUint32(0, data.length);
  out.set([...type].map((letter) => letter.charCodeAt(0)), 4);
  out.set(data, 8);
  let crc = ~0;
  for (const byte of out.subarray(4, -4)) crc = CRC[(crc ^ byte) & 255] ^ (crc >>> 8);
  view.setUint32(data.length + 8, ~crc);
  return out;
}

/** Rows of a picture, each less what its neighbours make likely. @param {import('./pictures.js').Picture} picture @param {number} size bytes of a pixel */
function filtered({width, height, data}, size) {
  const out = new Uint8Array(height * (1 + size * width));
  for (let y = 0, at = 0; y < height; y++) {
    out[at++] = PAETH;
    for (let x = 0; x < width; x++) {
      for (let c = 0; c < size; c++) {
        const i = 4 * (y * width + x) + c, a = x ? data[i - 4] : 0, b = y ? data[i - 4 * width] : 0, d = x && y ? data[i - 4 * width - 4] : 0;
        const left = Math.abs(b - d), up = Math.abs(a - d), corner = Math.abs(a + b - 2 * d);
        out[at++] = data[i] - (left <= up && left <= corner ? a : up <= corner ? b : d);
      }
    }
  }
  return out;
}

/** @param {import('./pictures.js').Picture} picture @returns {Promise<Uint8Array>} */
export async function pngOf(picture) {
  const {width, height, hasAlpha} = picture, header = new Uint8Array(13), view = new DataView(header.buffer);
  view.setUint32(0, width);
  view.setUint32(4, height);
  header.set([8, hasAlpha ? WITH_ALPHA : TRUE_COLOUR], 8);
  const rows = through(filtered(picture, hasAlpha ? 4 : 3), new CompressionStream('deflate'));
  const packed = new Uint8Array(await new Response(rows).arrayBuffer());
  return new Uint8Array(await new Blob([Uint8Array.from(SIGNATURE), chunk('IHDR', header), chunk('IDAT', packed), chunk('IEND', new Uint8Array(0))]).arrayBuffer());
}
