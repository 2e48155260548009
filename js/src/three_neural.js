/** 3DNTC in the fragment shader of three.js: latents and network as they stand in the stream (clause 11 of the specification). */

import {RedIntegerFormat, RGBAFormat, RGIntegerFormat} from 'three';

import {codeWords, networkBlock, networkGlsl} from './glsl_neural.js';
import {bricksOf, levelsOf, lookUpOf} from './supports.js';
import {tableTexture} from './three_tables.js';

/** @typedef {import('./engine.js').Neural} Neural */

const SALT = 3674653429;

/**
 * GLSL of `void network(ivec3 position, out vec4 n0, ...)`, which needs PLACE_GLSL and BITS_GLSL before it, its uniforms, and GLSL of
 * what it answers for channels.
 * @param {Neural} neural @param {number} number of the field
 * @param {<T>(key: string, make: () => T) => T} kept gives what was made under a key, or makes it
 */
export function networkOf(neural, number, kept) {
  const {features, octaves, widths, levels, codes} = neural, rows = 2 * codes.length / features;
  const payload = {features, octaves, first_wave: neural.firstWave, widths, levels};
  const matrices = widths.slice(1).reduce((sum, o, n) => sum + Math.ceil(o / 4) * Math.ceil(widths[n] / 4), 0);
  /** @type {Object<string, {value: any}>} */
  const uniforms = {
    u_codes: {value: kept('latents', () => tableTexture(codeWords(codes, rows, features), 1, RedIntegerFormat, 'R32UI'))},
    u_network: {value: kept('network', () => tableTexture(networkBlock(neural.network, widths), 4, RGBAFormat, 'RGBA32F'))},
    u_salt: {value: Math.imul(number, SALT) >>> 0},
  };
  levels.forEach(({log2, firstRows, keys}, n) => {
    uniforms[`u_first_${n}`] = {value: firstRows[number]};
    if (log2 > 0) return;
    const lookUp = kept(`${number} latents ${n}`, () => lookUpOf(levelsOf({...bricksOf(keys[number]), first: 0, depth: 0})));
    const texture = (/** @type {'table'|'bits'} */ part) => kept(`${number} latents ${n} ${part}`, () => tableTexture(lookUp[part], 2, RGIntegerFormat, 'RG32UI'));
    Object.assign(uniforms, {[`u_latents${n}_table`]: {value: texture('table')}, [`u_latents${n}_bits`]: {value: texture('bits')},
      [`u_latents${n}_log2`]: {value: lookUp.log2}});
  });
  const store = () => `uniform highp sampler2D u_network;
mat4 matrixAt(int i) {
  return mat4(texelFetch(u_network, place(4 * i), 0), texelFetch(u_network, place(4 * i + 1), 0), texelFetch(u_network, place(4 * i + 2), 0),
    texelFetch(u_network, place(4 * i + 3), 0));
}
vec4 biasAt(int i) { return texelFetch(u_network, place(${4 * matrices} + i), 0); }`;
  const glsl = networkGlsl(payload, levels.map(({log2}) => log2 === 0), store)
    .replace(/u_matrix\[([^\]]*)\]/g, 'matrixAt($1)').replace(/u_bias\[([^\]]*)\]/g, 'biasAt($1)');
  const answers = Array.from({length: Math.ceil(widths[widths.length - 1] / 4)}, (_, i) => `n${i}`).join(', ');
  /** @param {(string|null)[]} channels of each component, with its number among the channel's: 'roughness 0'; null is 1 */
  const vectorOf = (channels) => {
    const parts = channels.map((channel) => {
      const [name, component] = channel?.split(' ') ?? [''], output = neural.outputs[name]?.[Number(component)];
      return output === undefined ? '1.0' : `n${output >> 2}.${'xyzw'[output & 3]}`;
    });
    return `vec4(${parts.join(', ')})`;
  };
  return {glsl, uniforms, vectorOf, ask: (/** @type {string} */ position) => `vec4 ${answers}; network(${position}, ${answers});`};
}
