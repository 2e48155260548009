// GLSL: voxels found by brick and bits, and the trilinear answer of spec clause 8.2.

/** Number of bits that are set, and where a voxel is in its brick; part of every look-up. */
export const BITS_GLSL = `
int ones(uint x) {
  x -= (x >> 1) & 0x55555555u;
  x = (x & 0x33333333u) + ((x >> 2) & 0x33333333u);
  return int((((x + (x >> 4)) & 0x0f0f0f0fu) * 0x01010101u) >> 24);
}
// Three bits of each coordinate, as they alternate in a Morton key.
uint inBrick(ivec3 v) {
  uvec3 u = uvec3(v & 7);
  u = (u & 1u) | ((u & 2u) << 2) | ((u & 4u) << 4);
  return u.x | (u.y << 1) | (u.z << 2);
}
`;

/** `int row_NAME(int level, ivec3 voxel, int size)`: the row of a voxel among all levels, -1 where it is not active.
 * @param {string} name */
export function lookUpGlsl(name) {
  return `
uniform highp usampler2D u_${name}_table, u_${name}_bits;
uniform int u_${name}_log2;
uint last_${name} = 0xffffffffu;
int brick_${name} = -1;
int find_${name}(uint code) {
  uint slot = (code * 2654435769u) >> (32 - u_${name}_log2), mask = (1u << u_${name}_log2) - 1u;
  for (uint step = 0u; step <= mask; step++) {
    uvec2 entry = texelFetch(u_${name}_table, place(int(slot)), 0).rg;
    if (entry.y == 0u) return -1;
    if (entry.x == code) return int(entry.y) - 1;
    slot = (slot + 1u) & mask;
  }
  return -1;
}
int row_${name}(int level, ivec3 voxel, int size) {
  if (any(lessThan(voxel, ivec3(0))) || any(greaterThanEqual(voxel, ivec3(size)))) return -1;
  uvec3 brick = uvec3(voxel >> 3);
  uint code = level == 0 ? brick.x | (brick.y << 10) | (brick.z << 20)
    : brick.x | (brick.y << 9) | (brick.z << 18) | (uint(level) << 27) | 0x80000000u;
  if (code != last_${name}) {
    last_${name} = code;
    brick_${name} = find_${name}(code);
  }
  if (brick_${name} < 0) return -1;
  uint inside = inBrick(voxel), bit = inside & 31u;
  uvec2 word = texelFetch(u_${name}_bits, place(brick_${name} * 16 + int(inside >> 5)), 0).rg;
  if (((word.x >> bit) & 1u) == 0u) return -1;
  return int(word.y) + ones(word.x & ((1u << bit) - 1u));
}
`;
}

/**
 * Sizes of levels, and who answers where no corner of a cell is active: on slivers whose voxels hold too little surface to be
 * coded, and in the idle corners of pixel quads, which lie off the surface and are many: so this is short.
 */
export const LEVELS_GLSL = `
uniform int u_size, u_last;
int sizeOf(int level) { return max((u_size + (1 << level) - 1) >> level, 1); }
// The nearest active voxel of the 27 about a place, on the finest level that has one.
int substitute(int level, vec3 grid) {
  int row = -1;
  for (; row < 0 && level <= u_last; level++) {
    float least = 3.0;
    for (int q = 0; q < 27; q++) {
      ivec3 voxel = ivec3(floor(grid)) + ivec3(q % 3, (q / 3) % 3, q / 9) - 1;
      vec3 away = vec3(voxel) + 0.5 - grid;
      float square = dot(away, away);
      int nearby = square < least ? row_voxels(level, voxel, sizeOf(level)) : -1;
      if (nearby < 0) continue;
      least = square;
      row = nearby;
    }
    grid *= 0.5;
  }
  return row;
}
`;
