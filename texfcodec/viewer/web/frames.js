// GLSL of shading normals: from interpolated normals and tangents, from normal maps, and turned to the viewer.

export const TOWARDS_VIEWER_GLSL = `
// Turned over where the face is seen from behind, as glTF asks of double-sided materials.
vec3 towardsViewer(vec3 normal, vec3 geometric, vec3 view) {
  return dot(geometric, view) < 0.0 ? -normal : normal;
}
`;

export const NORMAL_MAP_GLSL = `
vec3 usableNormal(vec3 normal, vec3 geometric) {
  return unitOr(normal, unitOr(geometric, vec3(0.0, 0.0, 1.0)));
}

// Of a map over texels. coded: red and green, 0..1; blue follows from length 1. Without a tangent the
// normal is what is left.
vec3 tangentSpaceNormal(vec2 coded, float scale, vec3 normal, vec4 tangent, vec3 geometric) {
  vec3 n = usableNormal(normal, geometric);
  vec3 t = unitOr(tangent.xyz, vec3(0.0));
  vec3 b = cross(n, t) * (tangent.w < 0.0 ? -1.0 : 1.0);
  vec2 flatter = 2.0 * coded - 1.0;
  float z = sqrt(max(1.0 - dot(flatter, flatter), 0.0));
  return unitOr(scale * (flatter.x * t + flatter.y * b) + z * n, n);
}

// Of a map over voxels, which holds deviations in object space.
vec3 deviatedNormal(vec3 coded, vec3 normal, vec3 geometric) {
  vec3 n = usableNormal(normal, geometric);
  vec3 total = n + 2.0 * coded - 1.0;
  return dot(total, total) < 1e-10 ? n : unitOr(total, n);
}
`;
