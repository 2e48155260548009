// GLSL: texels of an image that the surface asks (spec clause 8.2), and whole images of a mesh.

/** Wrap modes: 0 repeat, 1 clamp, 2 mirror, as field/texels.py folds them. */
export const WRAP_GLSL = `
float folded(float x, float size, int mode) {
  if (mode == 1) return clamp(x, -1.0, size + 1.0);
  if (mode == 0) return x - floor(x / size) * size;
  x -= floor(x / (2.0 * size)) * (2.0 * size);
  return x < size ? x : 2.0 * size - x;
}
int beside(int i, int size, int mode) {
  if (mode == 0) return i < 0 ? size - 1 : (i >= size ? 0 : i);
  return clamp(i, 0, size - 1);
}
`;

/**
 * `void texels_P(int level, vec2 texel, out vec4 ...)`: bilinear over the texels that are asked, at UVs in texels of the full
 * image; a plane's level 0 is 2**u_shift_P of the full texels wide.
 */
export function bilinearGlsl(plane, textures) {
  const numbers = [...Array(textures).keys()], outs = numbers.map((t) => `out vec4 v${t}`).join(', ');
  return `
${numbers.map((t) => `uniform sampler2D u_values_${plane}_${t};`).join('\n')}
uniform sampler2D u_mask_${plane};
uniform ivec2 u_size_${plane};
uniform int u_shift_${plane};
void texels_${plane}(int level, vec2 texel, ${outs}) {
  ivec2 size = max((u_size_${plane} + (1 << level) - 1) >> level, 1);
  float cell = exp2(float(u_shift_${plane} + level));
  vec2 at = vec2(folded(texel.x, u_full.x, u_wrap.x), folded(texel.y, u_full.y, u_wrap.y)) / cell - 0.5;
  vec2 low = floor(at), part = at - low;
  float total = 0.0;
  ${numbers.map((t) => `v${t} = vec4(0.0);`).join(' ')}
  for (int q = 0; q < 4; q++) {
    ivec2 corner = ivec2(q & 1, q >> 1);
    vec2 share = mix(1.0 - part, part, vec2(corner));
    ivec2 cellAt = ivec2(beside(int(low.x) + corner.x, size.x, u_wrap.x), beside(int(low.y) + corner.y, size.y, u_wrap.y));
    cellAt = clamp(cellAt, ivec2(0), size - 1);
    float weight = share.x * share.y * texelFetch(u_mask_${plane}, cellAt, level).r;
    total += weight;
    ${numbers.map((t) => `v${t} += weight * texelFetch(u_values_${plane}_${t}, cellAt, level);`).join(' ')}
  }
  if (total > 0.0) { ${numbers.map((t) => `v${t} /= total;`).join(' ')} }
}
`;
}

/** Texels along one radius of the asset, from how UVs and places change from pixel to pixel; the same all over a face. */
export const DENSITY_GLSL = `
float texelsPerUnit(vec2 texel) {
  vec2 s = dFdx(texel), t = dFdy(texel);
  float area = length(cross(dFdx(v_world), dFdy(v_world)));
  return area > 0.0 ? sqrt(abs(s.x * t.y - s.y * t.x) / area) : 0.0;
}
`;
