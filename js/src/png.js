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
  const out = new Uint8Array(height * (1 + size * width)), pad = new Uint8Array(4), step = 4 * width;
  for (let y = 0, at = 0; y < height; y++) {
    const row = data.subarray(step * y, step * (y + 1)), above = y ? data.subarray(step * (y - 1), step * y) : new Uint8Array(step);
    out[at++] = PAETH;
    for (let i = 0; i < step; i += 4) {
      const [before, left] = i ? [row, above] : [pad, pad], from = i ? i - 4 : 0;
      for (let c = 0; c < size; c++) {
        const a = before[from + c], b = above[i + c], d = left[from + c], p = Math.abs(b - d), q = Math.abs(a - d), r = Math.abs(a + b - 2 * d);
        out[at++] = row[i + c] - (p <= q && p <= r ? a : q <= r ? b : d);
      }
    }
  }
  return out;
}

/** Adds pictures as PNG files, images of the textures that they are numbered by. @param {any} root @param {import('./accessors.js').Added} added
 * @param {Map<number, import('./pictures.js').Picture>} pictures */
export async function addImages(root, added, pictures) {
  const files = await Promise.all([...pictures.values()].map(pngOf));
  [...pictures.keys()].forEach((texture, n) => {
    root.textures[texture].source = added.add('images', {mimeType: 'image/png', bufferView: added.addView(files[n])});
  });
}

/** @param {import('./pictures.js').Picture} picture @returns {Promise<Uint8Array>} */
async function pngOf(picture) {
  const {width, height, hasAlpha} = picture, header = new Uint8Array(13), view = new DataView(header.buffer);
  view.setUint32(0, width);
  view.setUint32(4, height);
  header.set([8, hasAlpha ? WITH_ALPHA : TRUE_COLOUR], 8);
  const rows = through(filtered(picture, hasAlpha ? 4 : 3), new CompressionStream('deflate'));
  const packed = new Uint8Array(await new Response(rows).arrayBuffer());
  return new Uint8Array(await new Blob([Uint8Array.from(SIGNATURE), chunk('IHDR', header), chunk('IDAT', packed), chunk('IEND', new Uint8Array(0))]).arrayBuffer());
}
