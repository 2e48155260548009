// GLSL: 3DNTC by random access (spec clause 11): latents and network as they stand in the stream.
//
// Places, phases, cells and look-ups are integers, exact in 32 bits. Sums of latents and of the network are binary32: products of
// 28 and 24 bits do not fit; clause 9 allows 0.5 of 255 for it.

import { lookUpGlsl } from './glsl_voxels.js';

/** @typedef {{features: number, octaves: number, first_wave: number, widths: number[], levels: {resolution: number, log2: number}[]}} Payload */

/** `void network(ivec3 position, out vec4 v0, ...)` at a place of 2**24 a side.
 * @param {Payload} payload @param {boolean[]} kept whether a level has a look-up, else its rows are hashed
 * @param {(count: [number, number]) => string} [store] GLSL that gives u_matrix[i] and u_bias[i]: a uniform block, where nothing is said */
export function networkGlsl(payload, kept, store = blockGlsl) {
  const { features, octaves, widths } = payload;
  const padded = widths.map((w) => Math.ceil(w / 4)), outputs = padded[padded.length - 1];
  const words = Math.ceil(features / 8), most = Math.max(...padded) + 2 * words + 2;
  const outs = [...Array(outputs).keys()].map((t) => `out vec4 v${t}`).join(', '), last = padded.length % 2 ? 'a' : 'b';
  const reads = payload.levels.map((level, n) => readGlsl(n, level, words, kept[n], 4 * most));
  return `
uniform highp usampler2D u_codes;
int localOf(int p, int resolution) {
  return (p >> 12) * resolution + (((p & 4095) * resolution) >> 12) - 2048;
}
${reads.join('')}
${store(matricesOf(padded))}
void network(ivec3 position, ${outs}) {
  float inputs[${4 * most}];
  for (int i = 0; i < ${4 * most}; i++) inputs[i] = 0.0;
  ${payload.levels.map((_, n) => `latents_${n}(position, inputs, ${n * features});`).join('\n  ')}
  int at = ${payload.levels.length * features};
  for (int octave = 0; octave < ${octaves}; octave++) {
    ivec3 phase = ivec3(((uvec3(position) * (${payload.first_wave}u << octave)) >> 9) & 65535u);
    for (int axis = 0; axis < 3; axis++) {
      inputs[at++] = float(abs(phase[axis] - 32768) - 16384) / 16384.0;
      inputs[at++] = float(abs(((phase[axis] + 16384) & 65535) - 32768) - 16384) / 16384.0;
    }
  }
  vec4 a[${most}], b[${most}];
  for (int i = 0; i < ${padded[0]}; i++) a[i] = vec4(inputs[4 * i], inputs[4 * i + 1], inputs[4 * i + 2], inputs[4 * i + 3]);
${layersGlsl(padded)}
  ${[...Array(outputs).keys()].map((t) => `v${t} = clamp((${last}[${t}] + 1.0) * 0.5, 0.0, 1.0);`).join(' ')}
}
`;
}

const HASHED = `
uniform highp uint u_salt;
uint hashed(uvec3 v) { return v.x ^ (v.y * 2654435761u) ^ (v.z * 805459861u) ^ u_salt; }`;

/** Latents of one level around a point, weighted by where it stands in their cell, into inputs[at..].
 * @param {number} n @param {{resolution: number, log2: number}} level @param {number} words @param {boolean} isKept @param {number} size */
function readGlsl(n, { resolution, log2 }, words, isKept, size) {
  const row = log2 > 0
    ? `int(hashed(uvec3(voxel + 1)) & ${2 ** log2 - 1}u)`
    : `row_latents${n}(0, voxel, ${resolution})`;
  return `${isKept ? lookUpGlsl(`latents${n}`) : ''}
uniform int u_first_${n};
${n === 0 ? HASHED : ''}
void latents_${n}(ivec3 position, inout float inputs[${size}], int at) {
  ivec3 local = ivec3(localOf(position.x, ${resolution}), localOf(position.y, ${resolution}), localOf(position.z, ${resolution}));
  ivec3 cell = local >> 12;
  vec3 part = vec3(local & 4095) / 4096.0;
  float total = 0.0, sums[${8 * words}];
  for (int c = 0; c < ${8 * words}; c++) sums[c] = 0.0;
  for (int q = 0; q < 8; q++) {
    ivec3 corner = ivec3(q & 1, (q >> 1) & 1, q >> 2), voxel = cell + corner;
    vec3 share = mix(1.0 - part, part, vec3(corner));
    float weight = share.x * share.y * share.z;
    if (weight < 1.0 / 16777216.0) continue;
    int row = ${row};
    if (row < 0) continue;
    total += weight;
    for (int w = 0; w < ${words}; w++) {
      uint word = texelFetch(u_codes, place((row + u_first_${n}) * ${words} + w), 0).r;
      for (int k = 0; k < 8; k++) {
        int code = int((word >> (4 * k)) & 15u);
        sums[8 * w + k] += weight * float(2 * (code > 7 ? code - 16 : code) + 1);
      }
    }
  }
  float scale = total > 0.0 ? 1.0 / (16.0 * total) : 0.0;
  for (int c = 0; c < ${8 * words}; c++) inputs[at + c] = sums[c] * scale;
}
`;
}

/** How many matrices of 4 x 4 and biases of 4 a network has.
 * @param {number[]} padded @returns {[number, number]} */
function matricesOf(padded) {
  return [padded.slice(1).reduce((sum, o, n) => sum + o * padded[n], 0), padded.slice(1).reduce((sum, o) => sum + o, 0)];
}

/** Matrices in a uniform block: inputs by column, so that a product is four sums.
 * @param {[number, number]} count */
function blockGlsl([matrices, biases]) {
  return `layout(std140) uniform Network { mat4 u_matrix[${matrices}]; vec4 u_bias[${biases}]; };`;
}

const HARD_GELU = `vec4 bent = clamp(sum, -1.5, 1.5);
    sum = mix(bent * (bent + 1.5) / 3.0, sum, vec4(greaterThan(sum, vec4(1.5))));`;

/** @param {number[]} padded */
function layersGlsl(padded) {
  let matrix = 0, bias = 0;
  return padded.slice(1).map((outputs, n) => {
    const [from, to] = n % 2 ? ['b', 'a'] : ['a', 'b'], inputs = padded[n], last = n + 2 === padded.length;
    const text = `  for (int o = 0; o < ${outputs}; o++) {
    vec4 sum = u_bias[${bias} + o];
    for (int i = 0; i < ${inputs}; i++) sum += u_matrix[${matrix} + o * ${inputs} + i] * ${from}[i];
    sum = clamp(sum, -1024.0, 1024.0);
    ${last ? '' : HARD_GELU}
    ${to}[o] = sum;
  }`;
    matrix += outputs * inputs;
    bias += outputs;
    return text;
  }).join('\n');
}

/** The matrices and then the biases of a network as Float32Array: fixed-point parameters (11.6) as numbers.
 * @param {Uint16Array} halves @param {number[]} widths */
export function networkBlock(halves, widths) {
  const padded = widths.map((w) => Math.ceil(w / 4));
  const matrices = /** @type {number[]} */ ([]), biases = /** @type {number[]} */ ([]);
  let at = 0;
  for (let n = 0; n + 1 < widths.length; n++) {
    const [inputs, outputs] = [widths[n], widths[n + 1]], start = at;
    for (let o = 0; o < padded[n + 1]; o++) {
      for (let i = 0; i < padded[n]; i++) {
        for (let column = 0; column < 4; column++) {
          for (let row = 0; row < 4; row++) {
            const out = 4 * o + row, into = 4 * i + column;
            matrices.push(out < outputs && into < inputs ? fixedOf(halves[start + out * inputs + into]) : 0);
          }
        }
      }
    }
    at += inputs * outputs;
    for (let o = 0; o < 4 * padded[n + 1]; o++) biases.push(o < outputs ? fixedOf(halves[at + o]) : 0);
    at += outputs;
  }
  return Float32Array.from([...matrices, ...biases]);
}

/** A binary16 pattern as a number of 16 fractional bits: exact from 2**-6 on, below that rounded, halves away from zero.
 * @param {number} half */
function fixedOf(half) {
  const exponent = (half >> 10) & 31, fraction = half & 1023;
  const value = (exponent > 0 ? fraction + 1024 : fraction) * 2 ** (Math.max(exponent, 1) - 25);
  return ((half & 0x8000 ? -1 : 1) * Math.floor(value * 65536 + 0.5)) / 65536;
}

/** Latents of 4 bits as they come, repacked so that every row begins a new word of 8: Uint32Array.
 * @param {Uint8Array} codes @param {number} rows @param {number} features */
export function codeWords(codes, rows, features) {
  const words = Math.ceil(features / 8), out = new Uint32Array(rows * words), bytes = features / 2;
  for (let row = 0; row < rows; row++) {
    for (let i = 0; i < bytes; i++) out[row * words + (i >> 2)] |= codes[row * bytes + i] << (8 * (i & 3));
  }
  return out;
}
