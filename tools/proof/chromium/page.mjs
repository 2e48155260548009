// What runs in the page of vectors.mjs: streams through the package's workers, and how long that takes.

import { CHANNELS, Engine, TexfError } from '/cache/js/src/engine.js';
import { Decoder } from '/cache/js/src/index.js';
import { EXIT, arraysOf } from '/cache/js/test/arrays.mjs';

const decoder = new Decoder();
const fetched = async (url) => new Uint8Array(await (await fetch(url)).arrayBuffer());

// The arrays of a stream: positions, faces, keys and values are what the workers give; what an asset does not hold as integers (UVs,
// sharp edges, coded normals), and coordinates that binary32 does not, are asked of a module in the page.
async function decoded(bytes, level) {
  const asset = await decoder.decode(bytes, { level }), engine = new Engine(await decoder.preload());
  engine.decode(bytes, level);
  const said = JSON.parse(new TextDecoder().decode(engine.array('description')));
  const scale = asset.side / (2 ** asset.positionBits - 1), held = scale > 2 ** -126 && asset.side < 2 ** 127; // by binary32
  const valuesOf = (i, g) => asset.fields[i].planes[CHANNELS[said.groups[g].semantics[0]]]?.values;
  return arraysOf(said, (kind, i, g) => {
    if (kind === 'faces') return asset.units[i].indices;
    if (kind === 'positions' && held) return Uint32Array.from(asset.units[i].positions, (p) => Math.round(p / scale));
    if (kind === 'keys') return asset.fields[i].keys;
    if (kind === 'values') return valuesOf(i, g) ?? new ArrayBuffer(0);
    return engine.array(kind, i, g);
  });
}

const base64 = (bytes) => {
  let text = '';
  for (let i = 0; i < bytes.length; i += 32768) text += String.fromCharCode(...bytes.subarray(i, i + 32768));
  return btoa(text);
};

// Exit code, message and files in base64, as a decoder's command would give them.
window.answer = async (url, level) => {
  try {
    const files = await decoded(await fetched(url), level);
    return { code: 0, files: Object.fromEntries(Object.entries(files).map(([name, content]) => [name, base64(content)])) };
  } catch (error) {
    return { code: error instanceof TexfError ? EXIT[error.code] : 4, files: {}, message: error.message };
  }
};

// Milliseconds to the coarse asset and to the whole, medians; workers are up and the module is compiled.
window.timed = async (url, times) => {
  const bytes = await fetched(url), coarse = [], whole = [];
  await decoder.decode(bytes);
  for (let n = 0; n < times; n++) {
    const begin = performance.now();
    let first = null;
    await decoder.decode(bytes, { onLevel: () => { first = performance.now() - begin; } });
    whole.push(performance.now() - begin);
    coarse.push(first ?? whole.at(-1));
  }
  const median = (values) => Math.round(values.sort((a, b) => a - b)[values.length >> 1]);
  return { bytes: bytes.length, coarse: median(coarse), whole: median(whole) };
};
