// Shaders of a part of an asset: what its field answers, its material's terms, and the layer that is shown, nothing else.

import { ROW_LOG2 } from './gl.js';
import { DENSITY_GLSL } from './glsl_texels.js';
import { shadingSource } from './shading.js';
import { channelsRead } from './shading_values.js';

export const VERTEX = (attributes) => `#version 300 es
precision highp float;
in vec3 a_position;
${attributes.normal ? 'in vec2 a_normal;\nout vec3 v_normal;' : ''}
${attributes.tangent ? 'in vec4 a_tangent;\nout vec4 v_tangent;' : ''}
${uvSets(attributes).map((name) => `in vec2 a_${name};\nout vec2 v_${name};`).join('\n')}
${attributes.colour ? 'in vec4 a_colour;\nout vec4 v_colour;' : ''}
uniform mat4 u_camera;
uniform vec4 u_place;
invariant gl_Position;
out vec3 v_position, v_world;
${attributes.normal || attributes.tangent ? OCTAHEDRON : ''}
void main() {
  v_position = a_position;
  v_world = a_position * u_place.w + u_place.xyz;
  ${attributes.normal ? 'v_normal = direction(a_normal);' : ''}
  ${attributes.tangent ? 'v_tangent = vec4(direction(a_tangent.xy), a_tangent.z);' : ''}
  ${uvSets(attributes).map((name) => `v_${name} = a_${name};`).join(' ')}
  ${attributes.colour ? 'v_colour = a_colour;' : ''}
  gl_Position = u_camera * vec4(v_world, 1.0);
}
`;

/** Directions on an octahedron, nothing where both coordinates are the least (surfaces._oct). */
const OCTAHEDRON = `
vec3 direction(vec2 p) {
  if (p.x <= -1.0 && p.y <= -1.0) return vec3(0.0);
  vec3 v = vec3(p, 1.0 - abs(p.x) - abs(p.y));
  if (v.z < 0.0) v.xy = (1.0 - abs(v.yx)) * vec2(v.x < 0.0 ? -1.0 : 1.0, v.y < 0.0 ? -1.0 : 1.0);
  return normalize(v);
}`;

function uvSets(attributes) {
  return Object.keys(attributes).filter((name) => name.startsWith('uv'));
}

/** What all fragments share. peels: 1 where what lies behind solid surfaces is passed over, 2 where layers before are, too. */
const HEAD = (attributes, peels) => `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
in vec3 v_position, v_world;
${attributes.normal ? 'in vec3 v_normal;' : ''}
${attributes.tangent ? 'in vec4 v_tangent;' : ''}
${uvSets(attributes).map((name) => `in vec2 v_${name};`).join('\n')}
${attributes.colour ? 'in vec4 v_colour;' : ''}
uniform vec3 u_eye, u_forward, u_flat;
uniform float u_pixel, u_cutoff, u_cells;
uniform bool u_perspective;
${peels ? 'uniform sampler2D u_solid;' : ''}
${peels > 1 ? 'uniform sampler2D u_before;' : ''}
out vec4 o_colour;
float pixelWidth() { return u_perspective ? u_pixel * dot(v_world - u_eye, u_forward) : u_pixel; }
ivec2 place(int i) { return ivec2(i & ${(1 << ROW_LOG2) - 1}, i >> ${ROW_LOG2}); }
`;

/** Layers that are no channel of a field: what a fragment shows. */
export const LAYERS = {
  normals: { text: 'Normals', source: 'colour = 0.5 + 0.5 * normalize(shadingNormal());', normal: true },
  faces: { text: 'Normals of faces', source: 'colour = 0.5 + 0.5 * normalize(geometric());' },
  fields: { text: 'Fields', source: 'colour = u_flat;' },
  supports: { text: 'Supports', source: 'colour = u_flat;' },
  levels: { text: 'Levels asked', source: 'colour = hue(clamp(log2(max(pixelWidth() * u_cells, 1.0)) / 6.0, 0.0, 1.0));' },
  density: {
    text: 'Texels per voxel', source: 'colour = hue(0.5 + 0.125 * log2(max(texelsPerUnit(v_uv0) / u_cells, 1e-6)));', uv: true,
  },
};

const HUE = `
vec3 hue(float t) {
  return clamp(vec3(1.5) - abs(4.0 * clamp(t, 0.0, 1.0) - vec3(3.0, 2.0, 1.0)), 0.0, 1.0);
}`;

/**
 * The fragment shader of a part. field: of fields.js; material: the header's, with the effects to be shown; layer: 'picture',
 * the name of a channel or a key of LAYERS; lit: whether it stands in light.
 */
export function fragmentSource({ field, material, attributes, layer, lit, peels }) {
  const isLit = lit && layer === 'picture' && material.effects.includes('lit');
  const needsNormal = isLit || LAYERS[layer]?.normal;
  const look = needsNormal ? shownLook(material, field) : { effects: [], maps: [], parameters: {} };
  const { maps } = look;
  const needsAlpha = material.alpha_mode !== 0 && field.channels.includes('alpha');
  const wanted = new Set(maps.map((name) => fieldChannel(field, name)));
  if (layer === 'picture') wanted.add('base_colour');
  if (field.channels.includes(layer)) wanted.add(layer);
  if (needsAlpha) wanted.add('alpha');
  const asks = field.channels.some((name) => wanted.has(name)) || field.told.kind === 'images';
  return [
    HEAD(attributes, peels), needsNormal ? shadingSource(look.effects, maps, look.parameters) : '',
    asks ? field.source(wanted) : '', LAYERS[layer]?.uv && !(asks && field.told.kind !== 'voxels') ? DENSITY_GLSL : '', HUE,
    GEOMETRIC,
    needsNormal ? normalSource(field, maps, attributes, look) : '',
    mainSource({ field, material, attributes, layer, isLit, maps, asks, needsAlpha, peels, wanted, look }),
  ].join('\n');
}

/** A material's look for shadingSource(): a layer of normals asks for what turns them alone. */
function shownLook(material, field) {
  const { effects, maps, parameters } = material, read = new Set(channelsRead(new Set(effects)));
  const bends = (name) => effects.includes(`${name}_map`);
  return { effects, maps: maps.filter((name) => fieldChannel(field, name) && (read.has(name) || bends(name))), parameters };
}

/** What a field calls a material's channel: normal maps over voxels are deviations in object space. */
function fieldChannel(field, name) {
  const inVoxels = field.told.kind === 'voxels' || field.told.kind === 'latents';
  const channel = inVoxels && name.endsWith('normal') ? `${name}_object` : name;
  return field.channels.includes(channel) && (field.told.kind !== 'images' || name in field.maps) ? channel : undefined;
}

const GEOMETRIC = `
vec3 geometric() {
  vec3 n = cross(dFdx(v_world), dFdy(v_world));
  return gl_FrontFacing ? n : -n;
}
vec3 toEye() { return u_perspective ? u_eye - v_world : -u_forward; }`;

function normalSource(field, maps, attributes, look) {
  const turned = (name, plain) => {
    const channel = maps.includes(name) ? fieldChannel(field, name) : null;
    if (channel === null) return plain;
    if (channel.endsWith('_object')) return `deviatedNormal(f_${channel}, ${plain}, geometric())`;
    const tangent = attributes.tangent ? 'v_tangent' : 'vec4(0.0)';
    return `tangentSpaceNormal(f_${channel}, u_${name}_scale.x, ${plain}, ${tangent}, geometric())`;
  };
  const plain = attributes.normal ? 'v_normal' : 'geometric()', towards = look.effects.includes('lit') ? 'towardsViewer' : '';
  const facing = (text) => (towards ? `${towards}(${text}, geometric(), toEye())` : `(${text})`);
  return `
vec3 shadingNormal() { return ${facing(turned('normal', plain))}; }
vec3 coatNormal() { return ${facing(turned('clearcoat_normal', plain))}; }`;
}

function mainSource({ field, material, attributes, layer, isLit, maps, asks, needsAlpha, peels, wanted, look }) {
  const base = field.told.kind === 'images' || field.channels.includes('base_colour') ? 'f_base_colour' : 'vec3(1.0)';
  const finals = maps.filter((name) => !name.endsWith('normal'))
    .map((name) => `values.${name} = final_${name}(f_${fieldChannel(field, name)});`);
  const tangent = attributes.tangent && look.effects.includes('anisotropy') ? 'v_tangent' : 'vec4(0.0)';
  const lit = `Values values = constantValues(${base});
  ${finals.join(' ')}
  colour = exposed(radiance(values, shadingNormal(), coatNormal(), ${tangent}, toEye()));`;
  const other = layer === 'picture' ? `colour = ${base};` : LAYERS[layer]?.source ?? channelShown(field, layer, wanted);
  const shown = isLit ? lit : other;
  return `
void main() {
  ${peels ? 'if (gl_FragCoord.z > texelFetch(u_solid, ivec2(gl_FragCoord.xy), 0).r) discard;' : ''}
  ${peels > 1 ? 'if (gl_FragCoord.z <= texelFetch(u_before, ivec2(gl_FragCoord.xy), 0).r) discard;' : ''}
  ${asks ? 'ask();' : ''}
  float alpha = ${needsAlpha ? 'f_alpha' : '1.0'};
  ${material.alpha_mode === 1 ? 'if (alpha < u_cutoff) discard;\n  alpha = 1.0;' : ''}
  vec3 colour;
  ${shown}
  o_colour = vec4(clamp(colour, 0.0, 1.0) * alpha, alpha);
}`;
}

/** A channel as it is coded; a part without it is grey. */
function channelShown(field, layer, wanted) {
  if (!wanted.has(layer)) return 'colour = vec3(0.35);';
  const sizes = new Map(field.told.kind === 'images'
    ? Object.entries(field.maps).map(([name, [, , columns]]) => [name, name.endsWith('normal') ? 2 : columns.length])
    : field.planes.flatMap((plane) => plane.channels));
  if (layer === 'base_colour') return 'colour = f_base_colour;';
  if (!sizes.has(layer)) return layer === 'alpha' ? 'colour = vec3(f_alpha);' : 'colour = vec3(0.35);';
  return { 1: `colour = vec3(f_${layer});`, 2: `colour = vec3(f_${layer}, 0.5);`, 3: `colour = f_${layer};` }[sizes.get(layer)];
}
