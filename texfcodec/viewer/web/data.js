// Containers of assets (viewer/container.py): a JSON header whose references become typed arrays.

const MAGIC = 0x57565854; // "TXVW"
const ARRAYS = { u8: Uint8Array, u16: Uint16Array, u32: Uint32Array, i16: Int16Array, f16: Uint16Array, f32: Float32Array };

/** The header of a container (ArrayBuffer) with every array in its place; an array also knows its shape. */
export function unpack(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < 8 || view.getUint32(0, true) !== MAGIC) throw new Error('this is no asset of texf-view');
  const length = view.getUint32(4, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, length)));
  return withArrays(header, buffer, 8 + length);
}

function withArrays(node, buffer, start) {
  if (Array.isArray(node)) return node.map((one) => withArrays(one, buffer, start));
  if (node === null || typeof node !== 'object') return node;
  if ('at' in node && 'type' in node) return arrayOf(node, buffer, start);
  return Object.fromEntries(Object.entries(node).map(([key, one]) => [key, withArrays(one, buffer, start)]));
}

function arrayOf({ at, type, shape, differences }, buffer, start) {
  const count = shape.reduce((a, b) => a * b, 1);
  const Type = ARRAYS[type], place = start + at;
  const array = differences ? summed(buffer, place, Type, shape, count) : new Type(buffer, place, count);
  return Object.assign(type === 'f16' ? Float32Array.from(array, halfOf) : array, { shape });
}

/** The number of a pattern of binary16, a finite one. */
function halfOf(bits) {
  const exponent = (bits >> 10) & 31, fraction = bits & 1023;
  return (bits & 0x8000 ? -1 : 1) * (exponent > 0 ? fraction + 1024 : fraction) * 2 ** (Math.max(exponent, 1) - 25);
}

/** Mirror of container._differences: low bytes of all numbers first, columns one after the other, folded differences. */
function summed(buffer, at, Type, shape, count) {
  const out = new Type(count), size = Type.BYTES_PER_ELEMENT, bytes = new Uint8Array(buffer, at, count * size);
  const rows = shape[0], width = rows ? count / rows : 0;
  for (let column = 0; column < width; column++) {
    let last = 0;
    for (let row = 0; row < rows; row++) {
      const place = column * rows + row;
      let folded = 0;
      for (let b = 0; b < size; b++) folded |= bytes[b * count + place] << (8 * b);
      last += (folded >>> 1) ^ -(folded & 1);
      out[row * width + column] = last;
    }
  }
  return out;
}
