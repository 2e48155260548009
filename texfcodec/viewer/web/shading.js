// Shading in GLSL ES 3.00 as texfcodec/render does it on the CPU, assembled from the effects that a material uses.

import { NORMAL_MAP_GLSL, TOWARDS_VIEWER_GLSL } from './frames.js';
import { CHARLIE_GLSL, FILM_GLSL, GGX_GLSL, LOBES_HEAD_GLSL, MAX_LIGHTS } from './lobes.js';
import { SKY_GLSL, STRETCHED_GLSL, THROUGH_GLSL, VECTORS_GLSL } from './lobes.js';
import { valuesSource } from './shading_values.js';
import { radianceSource, termsSource } from './terms.js';

const MIN_ALPHA = 2e-3; // GGX's alpha of a perfect mirror
const UNLIT = `
vec3 radiance(Values v, vec3 normal, vec3 coatNormal, vec4 tangent, vec3 view) {
  return v.base_colour / u_exposure;
}
`;

/** Names of the tables that a shader of these effects (a Set) reads. */
function tablesRead(effects) {
  if (!effects.has('lit')) return [];
  return ['prefiltered', 'ggx', ...(effects.has('sheen') ? ['charlie'] : [])];
}

/**
 * GLSL text, without #version and main, that shades points of a material: struct Values, constantValues(), final_CHANNEL(),
 * radiance(), exposed(), and for lit materials towardsViewer() and, where they have a normal map, tangentSpaceNormal() and
 * deviatedNormal(). effects, maps: names; parameters: names, or an object that has them as keys; see material_look() of
 * texfcodec/viewer/light.py. A clear coat without a normal map takes as coatNormal what glTF says: the interpolated normal.
 */
export function shadingSource(effects, maps, parameters) {
  const used = new Set(effects);
  const lit = used.has('lit');
  const names = Array.isArray(parameters) ? parameters : Object.keys(parameters);
  const bends = used.has('normal_map') || used.has('clearcoat_normal_map');
  const head = [
    'precision highp float;', 'precision highp int;', 'precision highp sampler2D;', 'uniform float u_exposure;',
    ...[...names].sort().map((name) => `uniform vec4 u_${name};`),
    ...tablesRead(used).map((name) => `uniform sampler2D u_${name};`),
  ].join('\n');
  const lobes = [
    LOBES_HEAD_GLSL, VECTORS_GLSL, SKY_GLSL, GGX_GLSL, used.has('anisotropy') && STRETCHED_GLSL,
    used.has('transmission') && THROUGH_GLSL, used.has('sheen') && CHARLIE_GLSL, used.has('iridescence') && FILM_GLSL,
  ].filter(Boolean).join('');
  const values = valuesSource(used, new Set(maps));
  if (!lit) return `${head}\n${values}${UNLIT}`;
  const frames = TOWARDS_VIEWER_GLSL + (bends ? NORMAL_MAP_GLSL : '');
  return `${head}\n${lobes}${frames}${values}${termsSource(used)}${radianceSource(used)}`;
}

const tableTextures = new WeakMap(); // by context, then by the table's array: a texture
const shadingLocations = new WeakMap(); // by program, then by name: a uniform's location

function locationOf(gl, program, name) {
  if (!shadingLocations.has(program)) shadingLocations.set(program, new Map());
  const known = shadingLocations.get(program);
  if (!known.has(name)) known.set(name, gl.getUniformLocation(program, name));
  return known.get(name);
}

/** Binds a table [X, Y] or [X, Y, K] as a texture, Y along a row, K from red on, to the active unit; made when first asked. */
function bindTable(gl, table) {
  if (!tableTextures.has(gl)) tableTextures.set(gl, new WeakMap());
  const known = tableTextures.get(gl);
  const kept = known.get(table);
  if (kept && gl.isTexture(kept)) { // it is none after the context was lost
    gl.bindTexture(gl.TEXTURE_2D, kept);
    return;
  }
  const [rows, columns, components = 1] = table.shape;
  const texels = new Float32Array(rows * columns * 4);
  for (let i = 0; i < rows * columns; i++) {
    for (let k = 0; k < components; k++) texels[4 * i + k] = table[components * i + k];
  }
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, columns, rows, 0, gl.RGBA, gl.FLOAT, texels);
  for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
  known.set(table, texture);
}

function setLights(gl, program, lights) {
  if (lights.length > MAX_LIGHTS) throw new Error(`an environment has ${lights.length} lights, a shader takes ${MAX_LIGHTS}`);
  const directions = new Float32Array(4 * MAX_LIGHTS);
  const irradiances = new Float32Array(3 * MAX_LIGHTS);
  lights.forEach((light, i) => {
    // The half vector turns half as fast as the light.
    directions.set([...light.direction, Math.max(light.radius / 2, MIN_ALPHA) ** 2], 4 * i);
    irradiances.set(light.irradiance, 3 * i);
  });
  gl.uniform1i(locationOf(gl, program, 'u_light_count'), lights.length);
  gl.uniform4fv(locationOf(gl, program, 'u_light_direction'), directions);
  gl.uniform3fv(locationOf(gl, program, 'u_light_irradiance'), irradiances);
}

/**
 * Uses a program that holds shadingSource() of a material and sets what that reads. light: of light_tables(), material: of
 * material_look(), both of texfcodec/viewer/light.py; a table is a typed array with a property shape. unit: the first free
 * texture unit; returns the next one. It leaves another unit active.
 */
export function setShading(gl, program, light, material, unit) {
  gl.useProgram(program);
  gl.uniform1f(locationOf(gl, program, 'u_exposure'), light.exposure);
  const effects = new Set(material.effects);
  for (const [name, numbers] of Object.entries(material.parameters)) {
    gl.uniform4f(locationOf(gl, program, `u_${name}`), ...[...numbers, 0, 0, 0].slice(0, 4));
  }
  if (!effects.has('lit')) return unit;
  setLights(gl, program, light.lights);
  gl.uniform3fv(locationOf(gl, program, 'u_diffuse_powers'), light.diffuse_powers);
  for (const name of tablesRead(effects)) {
    gl.activeTexture(gl.TEXTURE0 + unit);
    bindTable(gl, light[name]);
    gl.uniform1i(locationOf(gl, program, `u_${name}`), unit);
    unit += 1;
  }
  return unit;
}
