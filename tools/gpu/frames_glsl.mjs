// Prints, as JSON, fragment shaders made of what js/src ships, as frames_egl.py draws with them, and the network as they read it:
// node frames_glsl.mjs < {"payload": {...}, "halves": [...]}
import {readFileSync} from 'node:fs';

import {networkBlock, networkGlsl} from '../../js/src/glsl_neural.js';
import {BITS_GLSL, LEVELS_GLSL, lookUpGlsl} from '../../js/src/glsl_voxels.js';

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

/**
 * `void voxels_P(int level, vec3 grid, out vec4 ...)`: what planes that begin on level `plane` answer at a place of a level's
 * grid, by `textures` textures of four components each. Where no corner of the cell is active a voxel nearby answers: the nearest,
 * as in field/query.py, or one of a coarser level.
 */
function trilinearGlsl(plane, textures) {
  const numbers = [...Array(textures).keys()], outs = numbers.map((t) => `out vec4 v${t}`).join(', ');
  const fetched = (weight) => numbers.map((t) => `v${t} ${weight} texelFetch(u_values_${plane}_${t}, at, 0);`).join(' ');
  return `
${numbers.map((t) => `uniform sampler2D u_values_${plane}_${t};`).join('\n')}
uniform int u_base_${plane};
void voxels_${plane}(int level, vec3 grid, ${outs}) {
  vec3 centred = grid - 0.5, low = floor(centred), part = centred - low;
  float total = 0.0;
  ${numbers.map((t) => `v${t} = vec4(0.0);`).join(' ')}
  for (int q = 0; q < 8; q++) {
    ivec3 corner = ivec3(q & 1, (q >> 1) & 1, q >> 2);
    vec3 share = mix(1.0 - part, part, vec3(corner));
    float weight = share.x * share.y * share.z;
    int row = weight > 0.0 ? row_voxels(level, ivec3(low) + corner, sizeOf(level)) : -1;
    if (row < 0) continue;
    total += weight;
    ivec2 at = place(row - u_base_${plane});
    ${fetched('+= weight *')}
  }
  if (total > 0.0) {
    ${numbers.map((t) => `v${t} /= total;`).join(' ')}
    return;
  }
  ivec2 at = place(max(substitute(level, grid) - u_base_${plane}, 0));
  ${fetched('=')}
}
`;
}
