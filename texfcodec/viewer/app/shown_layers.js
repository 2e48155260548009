// What of the materials is shown: all of it, one channel, or all but some effects. The shaders are those of three.js, with an end of ours.

import {Color, Material} from 'three';

const coded = (colour) => `sRGBTransferOETF(vec4(${colour}, 1.0)).rgb`; // as glTF stores it

/** Layers: [text, GLSL of the colour, what must be defined for it]. */
export const LAYERS = {
  base_colour: ['Base colour', coded('diffuseColor.rgb'), 'PI'],
  alpha: ['Alpha', 'vec3(diffuseColor.a)', 'PI'],
  normal: ['Normal', 'inverseTransformDirection(normal, viewMatrix) * 0.5 + 0.5', 'STANDARD'],
  occlusion: ['Occlusion', 'vec3(ambientOcclusion)', 'USE_AOMAP'],
  roughness: ['Roughness', 'vec3(roughnessFactor)', 'STANDARD'],
  metallic: ['Metallic', 'vec3(metalnessFactor)', 'STANDARD'],
  emissive: ['Emissive', coded('totalEmissiveRadiance'), 'STANDARD'],
  clearcoat: ['Clearcoat', 'vec3(material.clearcoat)', 'USE_CLEARCOAT'],
  clearcoat_roughness: ['Clearcoat roughness', 'vec3(material.clearcoatRoughness)', 'USE_CLEARCOAT'],
  clearcoat_normal: ['Clearcoat normal', 'inverseTransformDirection(clearcoatNormal, viewMatrix) * 0.5 + 0.5', 'USE_CLEARCOAT'],
  sheen_colour: ['Sheen colour', coded('material.sheenColor'), 'USE_SHEEN'],
  sheen_roughness: ['Sheen roughness', 'vec3(material.sheenRoughness)', 'USE_SHEEN'],
  specular: ['Specular', 'vec3(specularIntensityFactor)', 'USE_SPECULAR'],
  specular_colour: ['Specular colour', coded('specularColorFactor'), 'USE_SPECULAR'],
  transmission: ['Transmission', 'vec3(material.transmission)', 'USE_TRANSMISSION'],
  thickness: ['Thickness', 'vec3(material.thickness / thickness)', 'USE_TRANSMISSION'],
  iridescence: ['Iridescence', 'vec3(material.iridescence)', 'USE_IRIDESCENCE'],
  iridescence_thickness: ['Iridescence thickness', 'vec3(material.iridescenceThickness / 1000.0)', 'USE_IRIDESCENCE'],
  anisotropy: ['Anisotropy', 'vec3(material.anisotropy)', 'USE_ANISOTROPY'],
  normals: ['Normals', 'inverseTransformDirection(normal, viewMatrix) * 0.5 + 0.5', 'STANDARD'],
  faces: ['Normals of faces', 'inverseTransformDirection(normal, viewMatrix) * 0.5 + 0.5', 'STANDARD'],
  fields: ['Fields', 'viewerFlat', 'PI'],
  cubes: ['Voxels as cubes', coded('diffuseColor.rgb'), 'PI'],
  triangles: ['Triangles', coded('diffuseColor.rgb'), 'PI'],
};
const MISSING = ['', 'vec3(0.5)', 'PI'];
const STRUCTURE = ['normals', 'faces', 'fields', 'cubes', 'triangles'];

/** Effects: [property of a material that has them, its value without, property of a map that must be there too, that map's channel]. */
const EFFECTS = {
  metal: ['metalness', 0],
  normal_map: ['normalScale', 0, 'normalMap', 'normal_object'],
  occlusion: ['aoMapIntensity', 0, 'aoMap', 'occlusion'],
  emission: ['emissiveIntensity', 0],
  clearcoat: ['clearcoat', 0],
  clearcoat_normal_map: ['clearcoatNormalScale', 0, 'clearcoatNormalMap', 'clearcoat_normal_object'],
  sheen: ['sheen', 0],
  specular: ['specularIntensity', 0],
  transmission: ['transmission', 0],
  volume: ['thickness', 0],
  iridescence: ['iridescence', 0],
  anisotropy: ['anisotropy', 0],
  dispersion: ['dispersion', 0],
  ior: ['ior', 1.5],
};
const CHANNELS_SPECULAR = ['specular', 'specular_colour'];

/** Makes a material of three.js able to show a layer: it compiles with what stands in its userData. */
export function prepare(material) {
  const compile = material.onBeforeCompile, key = material.customProgramCacheKey.bind(material);
  const own = compile === Material.prototype.onBeforeCompile ? () => '' : key;
  const flat = {value: new Color().setHSL(hashed(material.name || material.uuid), 0.55, 0.55)};
  material.onBeforeCompile = (shader, renderer) => {
    const {layer} = material.userData, [, colour, needs] = layer ? LAYERS[layer] ?? MISSING : [];
    shader.uniforms.viewerFlat = flat;
    if (colour) {
      shader.fragmentShader = `uniform vec3 viewerFlat;\n${shader.fragmentShader}`.replace('#include <dithering_fragment>', `#include <dithering_fragment>
#ifdef ${needs}
  gl_FragColor.rgb = ${colour};
#else
  gl_FragColor.rgb = vec3(0.5);
#endif`);
    }
    compile.call(material, shader, renderer);
  };
  material.customProgramCacheKey = () => `${material.userData.layer ?? ''} ${own()}`;
}

function hashed(text) {
  let hash = 0;
  for (const letter of text) hash = Math.imul(hash ^ letter.charCodeAt(0), 0x9e3779b1) >>> 0;
  return hash / 2 ** 32;
}

/** Gives an asset's materials what settings {layer, lit, without: Set of effects} show of them. */
export function dress(asset, {layer, lit, without}) {
  const isThere = layer === 'picture' || hasLayer(asset, layer);
  for (const material of asset.materials) {
    const isFlat = layer === 'picture' && !lit && material.isMeshStandardMaterial, shown = isFlat ? 'base_colour' : layer === 'picture' ? null : isThere ? layer : 'missing';
    const state = material.userData, faces = shown === 'faces';
    Object.entries(EFFECTS).forEach(([name, [property, neutral]]) => {
      if (!(property in material)) return;
      const kept = state.kept ??= {}, value = material[property];
      kept[property] ??= value.clone?.() ?? value;
      if (value.isVector2) without.has(name) ? value.setScalar(neutral) : value.copy(kept[property]);
      else material[property] = without.has(name) ? neutral : kept[property];
    });
    state.flat ??= material.flatShading ?? false;
    if (state.layer === shown) continue;
    Object.assign(material, {wireframe: shown === 'triangles', needsUpdate: true}, 'flatShading' in material ? {flatShading: faces || state.flat} : {});
    Object.assign(state, {layer: shown, cubes: shown === 'cubes'});
  }
}

function uses(material, name) {
  const [property, neutral, map, channel] = EFFECTS[name], kept = material.userData.kept ?? {}, value = kept[property] ?? material[property];
  if (!material.isMeshStandardMaterial || value === undefined || value === neutral) return false;
  if (name === 'emission') return !material.emissive.equals(new Color(0));
  if (name === 'specular') return value !== 1 || material.specularColor.getHex() !== 0xffffff || CHANNELS_SPECULAR.some((key) => material.userData.channels?.includes(key));
  if (name === 'dispersion' || name === 'volume') return (kept.transmission ?? material.transmission) > 0;
  return !map || Boolean(material[map]) || Boolean(material.userData.channels?.includes(channel));
}

/** Names of the effects that the materials of assets use. */
export function effectsOf(assets) {
  return Object.keys(EFFECTS).filter((name) => assets.some((asset) => asset.materials.some((material) => uses(material, name))));
}

export function hasLayer(asset, layer) {
  if (layer === 'cubes') return Boolean(asset.stream?.userData.fields.some(({planar}) => !planar));
  return layer === 'picture' || STRUCTURE.includes(layer) || asset.channels.includes(layer);
}

/** Layers of assets as groups of [key, text]. */
export function layersOf(assets) {
  const there = Object.keys(LAYERS).filter((layer) => assets.some((asset) => hasLayer(asset, layer))).map((layer) => [layer, LAYERS[layer][0]]);
  return {'': [['picture', 'Picture']], Channels: there.filter(([layer]) => !STRUCTURE.includes(layer)), Structure: there.filter(([layer]) => STRUCTURE.includes(layer))};
}

export function worded(name) {
  const text = name.replaceAll('_', ' ');
  return text[0].toUpperCase() + text.slice(1);
}
