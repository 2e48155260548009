// The channels that shading reads: struct Values of a shader, from coded values and factors to what the terms take.

const LARGEST = '65504.0'; // of values that may be above 1

/**
 * By channel: the effect that reads it, its components, whether its values are sRGB-coded, the parameter that it is
 * multiplied with, and whether it may be above 1. A Python test holds this table against the package's own.
 */
export const SHADED_CHANNELS = {
  metallic: { effect: 'metal', size: 1, factor: 'metallic' },
  roughness: { effect: 'lit', size: 1, factor: 'roughness' },
  occlusion: { effect: 'occlusion', size: 1, factor: 'occlusion_strength' },
  emissive: { effect: 'emission', size: 3, srgb: true, factor: 'emissive', unbounded: true },
  clearcoat: { effect: 'clearcoat', size: 1, factor: 'clearcoat' },
  clearcoat_roughness: { effect: 'clearcoat', size: 1, factor: 'clearcoat_roughness' },
  sheen_colour: { effect: 'sheen', size: 3, srgb: true, factor: 'sheen_colour' },
  sheen_roughness: { effect: 'sheen', size: 1, factor: 'sheen_roughness' },
  specular: { effect: 'specular', size: 1, factor: 'specular' },
  specular_colour: { effect: 'specular', size: 3, srgb: true, factor: 'specular_colour' },
  transmission: { effect: 'transmission', size: 1, factor: 'transmission' },
  thickness: { effect: 'volume', size: 1, factor: 'thickness', unbounded: true },
  iridescence: { effect: 'iridescence', size: 1, factor: 'iridescence' },
  iridescence_thickness: { effect: 'iridescence', size: 1, factor: '' },
  anisotropy: { effect: 'anisotropy', size: 3, factor: 'anisotropy' },
  diffuse_transmission: { effect: 'diffuse_transmission', size: 1, factor: 'diffuse_transmission' },
  diffuse_transmission_colour: {
    effect: 'diffuse_transmission', size: 3, srgb: true, factor: 'diffuse_transmission_colour',
  },
};

const CODING = `
vec3 linearOf(vec3 coded) {
  vec3 c = clamp(coded, 0.0, 1.0);
  return mix(pow((c + 0.055) / 1.055, vec3(2.4)), c / 12.92, lessThanEqual(c, vec3(0.04045)));
}

vec3 exposed(vec3 light) {
  vec3 c = clamp(light * u_exposure, 0.0, 1.0);
  vec3 curved = 1.055 * pow(max(c, 0.0031308), vec3(1.0 / 2.4)) - 0.055;
  return mix(curved, c * 12.92, lessThanEqual(c, vec3(0.0031308)));
}
`;

/** Names of the channels beside base colour that a shader of these effects (a Set) reads, in a fixed order. */
export function channelsRead(effects) {
  return Object.keys(SHADED_CHANNELS).filter((name) => effects.has(SHADED_CHANNELS[name].effect));
}

function typeOf({ size }) {
  return size === 1 ? 'float' : `vec${size}`;
}

function factorOf({ factor, size }) {
  return `u_${factor}.${'xyz'.slice(0, size)}`;
}

function clamped(channel, value) {
  return `clamp(${value}, 0.0, ${channel.unbounded ? LARGEST : '1.0'})`;
}

/** The value of a channel that has no map: its factor, with the map that says nothing. */
function constantOf(name) {
  const channel = SHADED_CHANNELS[name];
  if (name === 'occlusion' || !channel.factor) return '1.0';
  if (name === 'anisotropy') return 'vec3(1.0, 0.5, clamp(u_anisotropy.x, 0.0, 1.0))';
  return clamped(channel, factorOf(channel));
}

function finalOf(name) {
  const channel = SHADED_CHANNELS[name];
  if (name === 'occlusion') return clamped(channel, `1.0 + ${factorOf(channel)} * (coded - 1.0)`);
  if (name === 'anisotropy') return clamped(channel, 'vec3(coded.xy, coded.z * u_anisotropy.x)');
  const share = channel.srgb ? 'linearOf(coded)' : 'coded';
  return clamped(channel, channel.factor ? `${share} * ${factorOf(channel)}` : share);
}

function finalSource(name) {
  const type = typeOf(SHADED_CHANNELS[name]);
  return `${type} final_${name}(${type} coded) {\n  return ${finalOf(name)};\n}\n`;
}

/**
 * GLSL of struct Values, constantValues(), final_CHANNEL() for every channel with a map, and exposed(). effects, maps: Sets.
 * constantValues() fills in every member; of a channel with a map it is what a map that says nothing gives.
 */
export function valuesSource(effects, maps) {
  const names = channelsRead(effects);
  const members = names.map((name) => `  ${typeOf(SHADED_CHANNELS[name])} ${name};`);
  const fillings = names.map((name) => `  v.${name} = ${constantOf(name)};`);
  return [
    CODING,
    ['struct Values {', '  vec3 base_colour;', ...members, '};\n'].join('\n'),
    ['Values constantValues(vec3 base_coded) {', '  Values v;', '  v.base_colour = linearOf(base_coded);', ...fillings,
      '  return v;', '}\n'].join('\n'),
    ...names.filter((name) => maps.has(name)).map(finalSource),
  ].join('\n');
}
