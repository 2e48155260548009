/** Pictures of fields over texels, four channels in each. */

/** @typedef {import('./engine.js').Plane} Plane */
/** @typedef {import('./engine.js').Field} Field */
/** @typedef {{width: number, height: number, data: Uint8Array, hasAlpha: boolean}} Picture data: RGBA; what no channel gives is 255 */

const WHITE = Uint8Array.of(255);

/**
 * The planes of up to four components as RGBA; what no plane gives is 255.
 * @param {(Plane|undefined)[]} planes @param {number[]} from component of each, as the channel counts them
 * @param {(plane: Plane) => Uint8Array} data @param {number} count cells
 */
export function interleaved(planes, from, data, count) {
  const all = [0, 1, 2, 3].map((k) => {
    const plane = planes[k], step = plane?.components ?? 0;
    return {values: plane ? data(plane) : WHITE, step, at: plane ? plane.offset + Math.min(from[k], step - 1 - plane.offset) : 0}; // grey: one for all
  });
  const [{values: r, step: r1}, {values: g, step: g1}, {values: b, step: b1}, {values: a, step: a1}] = all;
  let [ri, gi, bi, ai] = all.map(({at}) => at);
  const out = new Uint32Array(count);
  for (let i = 0; i < count; i++, ri += r1, gi += g1, bi += b1, ai += a1) out[i] = r[ri] | g[gi] << 8 | b[bi] << 16 | a[ai] << 24;
  return new Uint8Array(out.buffer);
}

/** Which component of its channel each of four is, counted among those that name the channel.
 * @param {(string|null)[]} channels */
export const componentsOf = (channels) => channels.map((name, k) => channels.slice(0, k).filter((before) => before === name).length);

/** A picture of channels of a field, as large as the largest of their planes.
 * @param {Field} field @param {(string|null)[]} channels at most four; those that the field lacks are 255 @returns {Picture|null} null if it lacks all */
export function pictureOf(field, channels) {
  const planes = channels.map((name) => (name ? field.planes[name] : undefined)), images = planes.flatMap((plane) => plane?.image ?? []);
  if (images.length === 0) return null;
  const {width, height} = images.reduce((a, b) => (b.width * b.height > a.width * a.height ? b : a));
  const data = interleaved(planes, componentsOf(channels), (plane) => resized(plane, width, height), width * height);
  if (channels.some((name) => name?.endsWith('normal'))) withZ(data);
  return {width, height, data, hasAlpha: Boolean(planes[3]) && hasAlpha(data)};
}

/** Whether any pixel is not opaque. @param {Uint8Array} pixels */
export function hasAlpha(pixels) {
  for (let i = 3; i < pixels.length; i += 4) if (pixels[i] < 255) return true;
  return false;
}

/** Texels of a plane, linearly between those of a smaller image. @param {Plane} plane @param {number} width @param {number} height */
function resized({image, components}, width, height) {
  const from = /** @type {NonNullable<Plane['image']>} */ (image);
  if (from.width === width && from.height === height) return from.data;
  const out = new Uint8Array(width * height * components);
  const along = (/** @type {number} */ i, /** @type {number} */ size, /** @type {number} */ coarse) => {
    const at = Math.max(0, (i + 0.5) * coarse / size - 0.5), low = Math.min(Math.floor(at), coarse - 1);
    return [low, Math.min(low + 1, coarse - 1), at - low];
  };
  for (let y = 0; y < height; y++) {
    const [top, bottom, v] = along(y, height, from.height);
    for (let x = 0; x < width; x++) {
      const [left, right, u] = along(x, width, from.width);
      const value = (/** @type {number} */ row, /** @type {number} */ column, /** @type {number} */ c) => from.data[(row * from.width + column) * components + c];
      for (let c = 0; c < components; c++) {
        const upper = value(top, left, c) * (1 - u) + value(top, right, c) * u, lower = value(bottom, left, c) * (1 - u) + value(bottom, right, c) * u;
        out[(y * width + x) * components + c] = Math.round(upper * (1 - v) + lower * v);
      }
    }
  }
  return out;
}

/** The third component of tangent space normals, from the first two.
 * @param {Uint8Array} pixels */
export function withZ(pixels) {
  const known = new Uint8Array(65536); // of x and y; 128 is the least
  for (let i = 0; i < pixels.length; i += 4) {
    const at = pixels[i] << 8 | pixels[i + 1];
    if (known[at] === 0) {
      const x = pixels[i] / 127.5 - 1, y = pixels[i + 1] / 127.5 - 1;
      known[at] = Math.round(127.5 * (Math.sqrt(Math.max(0, 1 - x * x - y * y)) + 1));
    }
    pixels[i + 2] = known[at];
  }
}
