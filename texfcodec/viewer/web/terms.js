// GLSL of the terms of materials, and how the radiance of a point is put together from those that a material uses.

const GLOSS = `
// A point in light. nv: cosine of normal and view, at least LEAST; sky: the share of the sky that reaches it.
struct Lit {
  vec3 normal;
  vec3 view;
  float nv;
  float sky;
};

// A lobe before Fresnel's law; a, b: its reflectance under a white sky at Fresnel's two ends.
struct Gloss {
  LightSums lights;
  vec3 sky;
  float a;
  float b;
};

Lit litPoint(vec3 normal, vec3 view) {
  vec3 v = unitOr(view, vec3(0.0, 0.0, 1.0)), n = unitOr(normal, v);
  return Lit(n, v, max(dot(n, v), LEAST), 1.0);
}

// The sky in the mirror direction of a normal, drawn towards the surface's by what a rough lobe loses below the horizon.
vec3 mirroredSky(Lit p, vec3 axis, float roughness) {
  vec3 mirror = 2.0 * dot(axis, p.view) * axis - p.view;
  return skyPrefiltered(mix(mirror, p.normal, roughness * roughness), roughness) * p.sky;
}

Gloss gloss(Lit p, float roughness) {
  vec2 ends = lookUp(u_ggx, sqrt(p.nv), roughness).xy;
  LightSums lights = ggxLights(p.normal, p.view, p.nv, roughness * roughness);
  return Gloss(lights, mirroredSky(p, p.normal, roughness), ends.x, ends.y);
}

// What light that bounces more than once within the roughness adds, as a factor.
vec3 gain(Gloss lobe, vec3 f0) {
  return 1.0 + f0 * (1.0 / (lobe.a + lobe.b) - 1.0);
}

// Share of a white sky that is reflected.
float albedo(Gloss lobe, vec3 f0, float f90) {
  float most = max(max(f0.x, f0.y), f0.z);
  return min(gain(lobe, vec3(most)).x * (most * lobe.a + f90 * lobe.b), 1.0);
}

vec3 reflectedLight(Gloss lobe, vec3 f0, float f90) {
  vec3 seen = lobe.sky * (f0 * lobe.a + f90 * lobe.b) + f0 * lobe.lights.spec + f90 * lobe.lights.specEdge;
  return gain(lobe, f0) * seen;
}
`;

const ANISOTROPY = `
// Directions along and across which the lobe is stretched. A map's direction without a length counts as the tangent.
void stretch(Lit p, vec3 anisotropy, vec4 tangent, out vec3 along, out vec3 crosswise) {
  vec2 way = 2.0 * anisotropy.xy - 1.0;
  way = length(way) > 1e-3 ? way / length(way) : vec2(1.0, 0.0);
  float c = cos(u_anisotropy_rotation.x), s = sin(u_anisotropy_rotation.x);
  way = vec2(c * way.x - s * way.y, s * way.x + c * way.y);
  vec3 raw = unitOr(tangent.xyz, vec3(0.0)), level = raw - dot(p.normal, raw) * p.normal;
  vec3 t = dot(level, level) > 1e-6 ? normalize(level) : across(p.normal);
  vec3 b = cross(p.normal, t) * (tangent.w < 0.0 ? -1.0 : 1.0);
  along = way.x * t + way.y * b;
  crosswise = way.x * b - way.y * t;
}

// Exact under the lights; under the sky the round lobe, about the mirror direction of a bent normal.
Gloss anisotropicGloss(Lit p, float roughness, vec3 anisotropy, vec4 tangent) {
  vec3 along, crosswise;
  stretch(p, anisotropy, tangent, along, crosswise);
  float alpha = roughness * roughness, wide = alpha + (1.0 - alpha) * anisotropy.z * anisotropy.z;
  LightSums lights = ggxLightsStretched(p.normal, p.view, p.nv, vec3[2](along, crosswise), float[2](wide, alpha));
  vec3 plane = cross(cross(crosswise, p.view), crosswise);
  float keep = 1.0 - anisotropy.z * (1.0 - roughness);
  vec3 bent = mix(plane, p.normal, keep * keep * keep * keep);
  bent /= sqrt(max(dot(bent, bent), 1e-12));
  vec2 ends = lookUp(u_ggx, sqrt(p.nv), roughness).xy;
  return Gloss(lights, mirroredSky(p, bent, roughness), ends.x, ends.y);
}
`;

const SPECULAR = `
// Reflectance straight on of what is no metal.
vec3 straightOn(vec3 colour, float strength) {
  float root = (IOR - 1.0) / (IOR + 1.0);
  return root * root * colour * strength;
}
`;

const IRIDESCENCE = `
// Reflectance straight on, mixed with that with which Schlick's law gives a thin film's at this view.
vec3 filmed(Lit p, Values v, vec3 f0) {
  float least = u_iridescence_thickness_minimum.x, most = u_iridescence_thickness_maximum.x;
  float thickness = least + (most - least) * v.iridescence_thickness;
  float edge = min(F_SchlickWeight(p.nv), 0.95);
  vec3 film = (evalIridescence(p.nv, f0, max(u_iridescence_ior.x, 1.0), thickness) - edge) / (1.0 - edge);
  return mix(f0, clamp(film, 0.0, 1.0), v.iridescence);
}
`;

const VOLUME = `
// What is left of light after the thickness: Beer's law.
vec3 volumeTint(float thickness) {
  vec3 colour = clamp(u_attenuation_colour.xyz, 1e-6, 1.0);
  return exp(log(colour) * min(thickness / max(u_attenuation_distance.x, 1e-6), 1e4));
}
`;

const DIFFUSE_TRANSMISSION = `
// Diffuse light from behind.
vec3 diffuseBehind(Lit p) {
  vec3 sum = skyIrradiance(-p.normal);
  for (int i = 0; i < u_light_count; i++) {
    sum += u_light_irradiance[i] * (max(-dot(p.normal, u_light_direction[i].xyz), 0.0) * INV_PI);
  }
  return sum;
}
`;

const REFRACTED = `
vec3 refracted(Lit p, float ior) {
  float turn = 1.0 / ior;
  float inside = sqrt(max(1.0 - turn * turn * (1.0 - p.nv * p.nv), 0.0));
  return (turn * p.nv - inside) * p.normal - turn * p.view;
}
`;

const DISPERSION = `
const float DISPERSION_SPREAD = 0.025;  // half the spread of ior over (ior - 1) at dispersion 1

// The sky along rays that are refracted less in red and more in blue.
vec3 dispersed(Lit p, float ior, float roughness) {
  float spread = (ior - 1.0) * DISPERSION_SPREAD * u_dispersion.x;
  float red = skyPrefiltered(refracted(p, max(ior - spread, 1.0)), roughness).r;
  float green = skyPrefiltered(refracted(p, ior), roughness).g;
  return vec3(red, green, skyPrefiltered(refracted(p, ior + spread), roughness).b);
}
`;

/**
 * Light through the surface: the sky straight on for a thin sheet, refracted for a volume; dispersed or not. A shader may have
 * the terms of a volume for a material without one; that is a thin sheet.
 */
function transmissionSource(effects) {
  const bent = effects.has('dispersion') ? 'dispersed(p, ior, rough)' : 'skyPrefiltered(refracted(p, ior), rough)';
  const straight = 'skyPrefiltered(-p.view, rough)';
  return `
vec3 lightThrough(Lit p, float roughness) {
  float ior = max(IOR, 1.0), rough = roughness * min(2.0 * ior - 2.0, 1.0);
  vec3 sky = ${effects.has('volume') ? `u_thickness.x > 0.0 ? ${bent} : ${straight}` : straight};
  return sky + ggxLightsThrough(p.normal, p.view, p.nv, rough * rough);
}
`;
}

const SHEEN = `
// Cloth fibres over what is below.
vec3 sheenOver(Lit p, vec3 colour, float roughness, vec3 below) {
  roughness = max(roughness, MIN_CHARLIE);
  float share = lookUp(u_charlie, sqrt(p.nv), roughness).x;
  vec3 sky = skyIrradiance(p.normal) * (p.sky * share);
  vec3 light = sky + charlieLights(p.normal, p.view, p.nv, roughness * roughness);
  return colour * light + below * (1.0 - max(max(colour.x, colour.y), colour.z) * share);
}
`;

const CLEARCOAT = `
// A clear layer of ior 1.5 over what is below, with a normal of its own.
vec3 coatOver(Lit p, vec3 coatNormal, float strength, float roughness, vec3 below) {
  Lit coat = litPoint(coatNormal, p.view);
  coat.sky = p.sky;
  Gloss lobe = gloss(coat, roughness);
  return below * (1.0 - strength * albedo(lobe, DIELECTRIC, 1.0)) + strength * reflectedLight(lobe, DIELECTRIC, 1.0);
}
`;

/** GLSL of the terms that effects (a Set) ask for, in the order in which they build on each other. */
export function termsSource(effects) {
  const seesThrough = effects.has('transmission');
  return [
    `#define IOR ${effects.has('ior') ? 'u_ior.x' : '1.5'}`,
    GLOSS,
    effects.has('anisotropy') && ANISOTROPY,
    (effects.has('specular') || effects.has('ior')) && SPECULAR,
    effects.has('iridescence') && IRIDESCENCE,
    effects.has('volume') && VOLUME,
    effects.has('diffuse_transmission') && DIFFUSE_TRANSMISSION,
    seesThrough && effects.has('volume') && REFRACTED,
    seesThrough && effects.has('volume') && effects.has('dispersion') && DISPERSION,
    seesThrough && transmissionSource(effects),
    effects.has('sheen') && SHEEN,
    effects.has('clearcoat') && CLEARCOAT,
  ].filter(Boolean).join('');
}

/** The base where it is no metal: the diffuse light under the interface, what comes from behind, the reflected light. */
function dielectricSource(effects) {
  const strength = effects.has('specular') ? 'v.specular' : '1.0';
  const colour = effects.has('specular') ? 'v.specular_colour' : 'vec3(1.0)';
  const straight = effects.has('specular') || effects.has('ior') ? `straightOn(${colour}, ${strength})` : 'DIELECTRIC';
  const tint = effects.has('volume') ? ' * volumeTint(v.thickness)' : '';
  return [
    '\nvec3 dielectricLight(Lit p, Gloss lobe, Values v) {',
    `  vec3 straight = ${effects.has('iridescence') ? `filmed(p, v, ${straight})` : straight};`,
    `  float kept = 1.0 - albedo(lobe, straight, ${strength});`,
    '  vec3 under = v.base_colour * (skyIrradiance(p.normal) * p.sky + lobe.lights.plain) * kept;',
    effects.has('diffuse_transmission')
      && `  under = mix(under, diffuseBehind(p) * kept * v.diffuse_transmission_colour${tint}, v.diffuse_transmission);`,
    effects.has('transmission')
      && `  under = mix(under, lightThrough(p, v.roughness)${tint} * kept * v.base_colour, v.transmission);`,
    `  return under + reflectedLight(lobe, straight, ${strength});`,
    '}\n',
  ].filter(Boolean).join('\n');
}

/** GLSL of radiance(), which calls what the effects (a Set) ask for and nothing else. */
export function radianceSource(effects) {
  const metal = effects.has('iridescence') ? 'filmed(p, v, v.base_colour)' : 'v.base_colour';
  const lobe = effects.has('anisotropy') ? 'anisotropicGloss(p, v.roughness, v.anisotropy, tangent)' : 'gloss(p, v.roughness)';
  return [
    dielectricSource(effects),
    'vec3 radiance(Values v, vec3 normal, vec3 coatNormal, vec4 tangent, vec3 view) {',
    '  Lit p = litPoint(normal, view);',
    effects.has('occlusion') && '  p.sky = v.occlusion;',
    `  Gloss lobe = ${lobe};`,
    effects.has('metal') ? '  vec3 light = vec3(0.0);' : '  vec3 light = dielectricLight(p, lobe, v);',
    effects.has('metal') && '  if (v.metallic < 1.0) light = (1.0 - v.metallic) * dielectricLight(p, lobe, v);',
    effects.has('metal') && `  if (v.metallic > 0.0) light += v.metallic * reflectedLight(lobe, ${metal}, 1.0);`,
    effects.has('sheen') && '  light = sheenOver(p, v.sheen_colour, v.sheen_roughness, light);',
    effects.has('emission') && '  light += v.emissive * u_emissive_strength.x;',
    effects.has('clearcoat') && '  light = coatOver(p, coatNormal, v.clearcoat, v.clearcoat_roughness, light);',
    '  return light;',
    '}\n',
  ].filter(Boolean).join('\n');
}
