// Prints, as JSON, the fragment shaders that js/src ships, as frames_egl.py draws with them, and the network as they read it:
// node frames_glsl.mjs < {"payload": {...}, "halves": [...]}
import {readFileSync} from 'node:fs';

import {networkBlock, networkGlsl} from '../../js/src/glsl_neural.js';
import {BITS_GLSL, LEVELS_GLSL, lookUpGlsl, trilinearGlsl} from '../../js/src/glsl_voxels.js';

const {payload, halves} = JSON.parse(readFileSync(0, 'utf8'));
const begin = `#version 330 core
precision highp float;
in vec3 grid;
out vec4 colour;
ivec2 place(int i) { return ivec2(i & 2047, i >> 11); }
${BITS_GLSL}`;
const voxels = `${begin}${lookUpGlsl('voxels')}${LEVELS_GLSL}${trilinearGlsl(0, 1)}
void main() { voxels_0(0, grid, colour); }
`;
const network = payload && `${begin}
uniform int u_size;
${networkGlsl(payload, payload.levels.map(({log2}) => log2 === 0))}
void main() { network(ivec3(clamp(grid * (16777216.0 / float(u_size)), 0.0, 16777215.0)), colour); }
`;
const block = payload && Buffer.from(networkBlock(Uint16Array.from(halves), payload.widths).buffer).toString('base64');
console.log(JSON.stringify({voxels, network, block}));
