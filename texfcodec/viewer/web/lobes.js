// GLSL of how a rough surface reflects: microfacet lobes under the lights, and their tables under the sky.

/** The most lights that a shader takes. */
export const MAX_LIGHTS = 8;

export const LOBES_HEAD_GLSL = `
const float LEAST = 1e-3;  // cosine of the steepest view; steeper ones count as this
const float PI = 3.14159265359;
const float INV_PI = 0.31830988618;
const vec3 DIELECTRIC = vec3(0.04);  // reflectance seen straight on at ior 1.5

uniform vec3 u_diffuse_powers[9];
uniform int u_light_count;
uniform vec4 u_light_direction[${MAX_LIGHTS}];  // in w what a light adds to alpha squared
uniform vec3 u_light_irradiance[${MAX_LIGHTS}];
`;

export const VECTORS_GLSL = `
vec3 unitOr(vec3 v, vec3 instead) {
  float largest = max(max(abs(v.x), abs(v.y)), abs(v.z));
  if (any(isnan(v)) || any(isinf(v)) || !(largest > 0.0)) return instead;
  vec3 scaled = v / largest;  // so that no square leaves the range of floats
  return scaled / length(scaled);
}

// Some unit direction across a normal.
vec3 across(vec3 n) {
  vec3 axis = abs(n.x) < 0.7 ? vec3(1.0, 0.0, 0.0) : vec3(0.0, 1.0, 0.0);
  return normalize(axis - dot(n, axis) * n);
}
`;

export const SKY_GLSL = `
// Bilinear by hand, because filtering of float textures is an extension. x: along the rows, from the first to the last.
vec4 lookUp(sampler2D table, float x, float y) {
  ivec2 last = textureSize(table, 0) - 1;
  vec2 place = clamp(vec2(y, x), 0.0, 1.0) * vec2(last);
  ivec2 at = min(ivec2(place), last - 1);
  vec2 part = place - vec2(at);
  vec4 low = mix(texelFetch(table, at, 0), texelFetch(table, at + ivec2(0, 1), 0), part.y);
  vec4 high = mix(texelFetch(table, at + ivec2(1, 0), 0), texelFetch(table, at + ivec2(1, 1), 0), part.y);
  return mix(low, high, part.x);
}

// The sky's irradiance over pi.
vec3 skyIrradiance(vec3 normal) {
  vec3 sum = u_diffuse_powers[8];
  for (int i = 7; i >= 0; i--) sum = sum * normal.y + u_diffuse_powers[i];
  return sum;
}

vec3 skyPrefiltered(vec3 direction, float roughness) {
  return lookUp(u_prefiltered, 0.5 + 0.5 * direction.y, roughness).rgb;
}
`;

export const GGX_GLSL = `
// What all lights give, with weights 1 - f and f, f being Schlick's fifth power at the half vector; plain: cosine over pi.
struct LightSums {
  vec3 spec;
  vec3 specEdge;
  vec3 plain;
};

// Schlick's share of f90 over f0.
float F_SchlickWeight(float cosine) {
  float rest = 1.0 - clamp(cosine, 0.0, 1.0);
  float square = rest * rest;
  return square * square * rest;
}

// square: of alpha, everywhere.
float D_GGX(float square, float nh) {
  nh = min(nh, 1.0);
  float stretched = (1.0 - nh) * (1.0 + nh) + nh * nh * square;
  return square * INV_PI / (stretched * stretched);
}

float V_SmithGGXCorrelated(float square, float nl, float nv) {
  float seen = nl * sqrt(nv * nv * (1.0 - square) + square) + nv * sqrt(nl * nl * (1.0 - square) + square);
  return 0.5 / max(seen, 1e-7);
}

float ggx(float square, float nh, float nl, float nv) {
  return D_GGX(square, nh) * V_SmithGGXCorrelated(square, nl, nv) * nl;
}

// Length of v + l: twice its cosine to either.
float alongHalf(vec3 v, vec3 towards) {
  return sqrt(max(2.0 + 2.0 * dot(v, towards), 1e-6));
}

void addLight(inout LightSums sums, vec3 irradiance, float value, float along, float nl) {
  float weight = value * F_SchlickWeight(along * 0.5);
  sums.spec += irradiance * (value - weight);
  sums.specEdge += irradiance * weight;
  sums.plain += irradiance * (INV_PI * nl);
}

LightSums ggxLights(vec3 n, vec3 v, float nv, float alpha) {
  LightSums sums = LightSums(vec3(0.0), vec3(0.0), vec3(0.0));
  float facing = dot(n, v);
  for (int i = 0; i < u_light_count; i++) {
    vec3 towards = u_light_direction[i].xyz;
    float nl = max(dot(n, towards), 0.0);
    float along = alongHalf(v, towards);
    float value = ggx(alpha * alpha + u_light_direction[i].w, (facing + nl) / along, nl, nv);
    addLight(sums, u_light_irradiance[i], value, along, nl);
  }
  return sums;
}
`;

export const STRETCHED_GLSL = `
// As ggxLights() with an alpha of its own along each of two tangents.
LightSums ggxLightsStretched(vec3 n, vec3 v, float nv, vec3 tangents[2], float alphas[2]) {
  LightSums sums = LightSums(vec3(0.0), vec3(0.0), vec3(0.0));
  float facing = dot(n, v), tv = dot(tangents[0], v), bv = dot(tangents[1], v);
  for (int i = 0; i < u_light_count; i++) {
    vec3 towards = u_light_direction[i].xyz;
    float nl = max(dot(n, towards), 0.0);
    float along = alongHalf(v, towards);
    float a = sqrt(alphas[0] * alphas[0] + u_light_direction[i].w), b = sqrt(alphas[1] * alphas[1] + u_light_direction[i].w);
    float tl = dot(tangents[0], towards), bl = dot(tangents[1], towards);
    float nh = (facing + nl) / along, th = (tv + tl) / along, bh = (bv + bl) / along;
    float stretched = (th / a) * (th / a) + (bh / b) * (bh / b) + nh * nh;
    float seen = nl * length(vec3(a * tv, b * bv, nv)) + nv * length(vec3(a * tl, b * bl, nl));
    float value = nl * (0.5 * INV_PI) / (a * b * stretched * stretched * max(seen, 1e-7));
    addLight(sums, u_light_irradiance[i], value, along, nl);
  }
  return sums;
}
`;

export const THROUGH_GLSL = `
// Light from behind a thin sheet: what the lobe reflects of lights that are mirrored to the eye's side.
vec3 ggxLightsThrough(vec3 n, vec3 v, float nv, float alpha) {
  vec3 sum = vec3(0.0);
  float facing = dot(n, v);
  for (int i = 0; i < u_light_count; i++) {
    vec3 towards = u_light_direction[i].xyz;
    float behind = -dot(n, towards);
    float along = sqrt(max(2.0 + 2.0 * (dot(v, towards) + 2.0 * behind * facing), 1e-6));
    float nl = max(behind, 0.0);
    sum += u_light_irradiance[i] * ggx(alpha * alpha + u_light_direction[i].w, (facing + nl) / along, nl, nv);
  }
  return sum;
}
`;

export const CHARLIE_GLSL = `
const float MIN_CHARLIE = 0.1;  // sheen roughness below this counts as this

float D_Charlie(float nh, float inverse) {
  float sine = sqrt(max((1.0 - nh) * (1.0 + nh), 1e-8));
  return (2.0 + inverse) * pow(sine, inverse) / (2.0 * PI);
}

float V_Neubelt(float nl, float nv) {
  return 1.0 / max(4.0 * (nl + nv - nl * nv), 1e-6);
}

vec3 charlieLights(vec3 n, vec3 v, float nv, float alpha) {
  vec3 sum = vec3(0.0);
  float facing = dot(n, v);
  for (int i = 0; i < u_light_count; i++) {
    vec3 towards = u_light_direction[i].xyz;
    float nl = max(dot(n, towards), 0.0);
    float nh = min((facing + nl) / alongHalf(v, towards), 1.0);
    sum += u_light_irradiance[i] * (D_Charlie(nh, 1.0 / alpha) * V_Neubelt(nl, nv) * nl);
  }
  return sum;
}
`;

/** Airy's sum over the reflections within a film, against Gaussians in wave number (see texfcodec/render/thin_film.py). */
export const FILM_GLSL = `
// One Gaussian of a colour matching function, transformed, at a difference of path in metres. The phase is counted in turns and
// reduced, because a GPU's cosine is good near 0 alone.
float filmBand(float size, float position, float variance, float path) {
  float turns = position * path, phase = 2.0 * PI * path;
  return size * sqrt(2.0 * PI * variance) / 1.0685e-7 * cos(2.0 * PI * (turns - round(turns))) * exp(-variance * phase * phase);
}

// Red, green and blue.
vec3 evalSensitivity(float path) {
  float x = filmBand(5.4856e-13, 1.6810e6, 4.3278e9, path) + filmBand(9.7470e-14, 2.2399e6, 4.5282e9, path);
  float y = filmBand(4.4201e-13, 1.7953e6, 9.3046e9, path);
  float z = filmBand(5.2481e-13, 2.2084e6, 6.6121e9, path);
  return x * vec3(3.2404542, -0.9692660, 0.0556434) + y * vec3(-1.5371385, 1.8760108, -0.2040259)
    + z * vec3(-0.4985314, 0.0415560, 1.0572252);
}

// Reflectance of a base (seen straight on: base) under a film in air; thickness in nanometres.
vec3 evalIridescence(float cosine, vec3 base, float ior, float thickness) {
  ior = 1.0 + (ior - 1.0) * smoothstep(0.0, 0.03, thickness);
  float inside = sqrt(1.0 - (1.0 - cosine * cosine) / (ior * ior));
  float outerNormal = ((ior - 1.0) / (ior + 1.0)) * ((ior - 1.0) / (ior + 1.0));
  float outer = outerNormal + (1.0 - outerNormal) * F_SchlickWeight(cosine);
  vec3 root = sqrt(clamp(base, 0.0, 0.9999));
  vec3 baseIor = (1.0 + root) / (1.0 - root);
  vec3 bend = (baseIor - ior) / (baseIor + ior), innerNormal = bend * bend;
  vec3 inner = innerNormal + (1.0 - innerNormal) * F_SchlickWeight(inside);
  vec3 turned = mix(vec3(-1.0), vec3(1.0), lessThan(baseIor, vec3(ior)));  // half a turn where the base is the denser one
  float through = 1.0 - outer, path = 2.0 * ior * thickness * inside * 1e-9;
  vec3 both = clamp(outer * inner, 1e-5, 0.9999);
  vec3 mean = through * through * inner / (1.0 - both);
  vec3 first = (mean - through) * sqrt(both), second = first * sqrt(both);
  vec3 sum = outer + mean + 2.0 * first * turned * evalSensitivity(path) + 2.0 * second * evalSensitivity(2.0 * path);
  return clamp(sum, 0.0, 1.0);
}
`;
