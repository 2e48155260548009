// What a shader has to know of a stream's materials: the effects that they use, and what these read (docs/design/materials.md). Python
// tests hold these tables against texfcodec/scene/effects.py and scene/channels.py.

const LARGEST = 65504, LARGEST_FLOAT = 3.4028234663852886e38, INFINITE = 'attenuation_distance', TURN = 'anisotropy_rotation';
const ALPHA_MODES = ['OPAQUE', 'MASK', 'BLEND'];

const DEFAULTS = {
  normal_scale: [1], occlusion_strength: [1], roughness: [1], metallic: [1], emissive: [0, 0, 0], emissive_strength: [1],
  clearcoat: [0], clearcoat_roughness: [0], clearcoat_normal_scale: [1], sheen_colour: [0, 0, 0], sheen_roughness: [0],
  specular: [1], specular_colour: [1, 1, 1], transmission: [0], thickness: [0], attenuation_distance: [Infinity],
  attenuation_colour: [1, 1, 1], iridescence: [0], iridescence_ior: [Math.fround(1.3)], iridescence_thickness_minimum: [100],
  iridescence_thickness_maximum: [400], anisotropy: [0], anisotropy_rotation: [0], diffuse_transmission: [0],
  diffuse_transmission_colour: [1, 1, 1], ior: [1.5], dispersion: [0],
};

const lit = (m) => !m.unlit;
const above = (name) => (m) => lit(m) && Math.max(...m.value(name)) > 0;
const mapped = (name, scale) => (m) => lit(m) && m.channels.includes(name) && m.value(scale)[0] !== 0;
const given = (names, maps = []) => (m) => lit(m) && (names.some((name) => name in m.sound) || maps.some((name) => m.channels.includes(name)));
const thick = above('thickness'), coated = above('clearcoat');

/** In the order of their bits. used: whether a material needs it; reads: channels with maps; takes: parameters. */
const EFFECTS = {
  lit: { used: lit, reads: ['roughness'], takes: ['roughness'] },
  mask: { used: (m) => m.alphaMode === 'MASK' },
  blend: { used: (m) => m.alphaMode === 'BLEND' },
  double_sided: { used: (m) => m.doubleSided },
  metal: { used: above('metallic'), reads: ['metallic'], takes: ['metallic'] },
  normal_map: { used: mapped('normal', 'normal_scale'), reads: ['normal'], takes: ['normal_scale'] },
  occlusion: { used: mapped('occlusion', 'occlusion_strength'), reads: ['occlusion'], takes: ['occlusion_strength'] },
  emission: {
    used: (m) => above('emissive')(m) && above('emissive_strength')(m), reads: ['emissive'], takes: ['emissive', 'emissive_strength'],
  },
  clearcoat: { used: coated, reads: ['clearcoat', 'clearcoat_roughness'], takes: ['clearcoat', 'clearcoat_roughness'] },
  clearcoat_normal_map: {
    used: (m) => coated(m) && mapped('clearcoat_normal', 'clearcoat_normal_scale')(m), reads: ['clearcoat_normal'],
    takes: ['clearcoat_normal_scale'],
  },
  sheen: { used: above('sheen_colour'), reads: ['sheen_colour', 'sheen_roughness'], takes: ['sheen_colour', 'sheen_roughness'] },
  specular: {
    used: given(['specular', 'specular_colour'], ['specular', 'specular_colour']), reads: ['specular', 'specular_colour'],
    takes: ['specular', 'specular_colour'],
  },
  transmission: { used: above('transmission'), reads: ['transmission'], takes: ['transmission'] },
  volume: { used: thick, reads: ['thickness'], takes: ['thickness', 'attenuation_distance', 'attenuation_colour'] },
  iridescence: {
    used: above('iridescence'), reads: ['iridescence', 'iridescence_thickness'],
    takes: ['iridescence', 'iridescence_ior', 'iridescence_thickness_minimum', 'iridescence_thickness_maximum'],
  },
  anisotropy: { used: above('anisotropy'), reads: ['anisotropy'], takes: ['anisotropy', TURN] },
  diffuse_transmission: {
    used: above('diffuse_transmission'), reads: ['diffuse_transmission', 'diffuse_transmission_colour'],
    takes: ['diffuse_transmission', 'diffuse_transmission_colour'],
  },
  dispersion: { used: (m) => thick(m) && above('dispersion')(m), takes: ['dispersion'] },
  ior: { used: given(['ior']), takes: ['ior'] },
};

/** What `?effects=all` takes where an asset says nothing: every effect, and every default, but that nothing becomes a metal. */
export const ALL_TERMS = {
  effects: Object.keys(EFFECTS),
  parameters: { ...Object.fromEntries(Object.entries(DEFAULTS).map(([name, value]) => [name, value.map(finite)])), metallic: [0] },
};

function finite(value) {
  return Math.min(value, LARGEST_FLOAT);
}

/** Parameters that differ from the default, each value within what shading takes; one that is no number counts as the default. */
function soundParameters(parameters) {
  const out = {};
  for (const [name, usual] of Object.entries(DEFAULTS)) {
    const values = parameters[name];
    if (!values || values.length !== usual.length || values.some(Number.isNaN)) continue;
    const low = name === TURN ? -LARGEST : 0, high = name === INFINITE ? Infinity : LARGEST;
    const sound = values.map((value) => Math.min(Math.max(value, low), high));
    if (sound.some((value, i) => value !== usual[i])) out[name] = sound;
  }
  return out;
}

/**
 * A material of a stream (engine.js) as a shader takes it: effects and maps are sorted names, parameters those that the effects
 * read, finite, a rotation between -pi and pi, where a GPU's cosine is good.
 */
export function lookOfMaterial(material) {
  const sound = soundParameters(material.parameters);
  const m = { ...material, sound, value: (name) => sound[name] ?? DEFAULTS[name] };
  const used = new Set(Object.keys(EFFECTS).filter((name) => EFFECTS[name].used(m)));
  if (!used.has('transmission')) { // what happens inside a volume is not seen where nothing goes through its surface
    used.delete('dispersion');
    if (!used.has('diffuse_transmission')) used.delete('volume');
  }
  const effects = [...used].sort();
  const named = (kind) => [...new Set(effects.flatMap((name) => EFFECTS[name][kind] ?? []))].sort();
  const parameters = Object.fromEntries(named('takes').map((name) => [name, m.value(name).map(finite)]));
  if (TURN in parameters) parameters[TURN] = [Math.atan2(Math.sin(parameters[TURN][0]), Math.cos(parameters[TURN][0]))];
  return {
    name: material.name, alpha_mode: ALPHA_MODES.indexOf(material.alphaMode), alpha_cutoff: material.alphaCutoff,
    double_sided: material.doubleSided, effects, parameters, maps: named('reads').filter((name) => material.channels.includes(name)),
  };
}
