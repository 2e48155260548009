// Frames by compute, the functions of one vertex, face, tile row or pixel. Every one compiles for a GPU and by a C++ compiler too
// (frames_host.cu), where tests compare them with texf-render. What the field answers is what the shaders of js/src ask of it.
//
// Places are world coordinates from the centre of the source's bounding sphere in its radii; a picture spans 2 * zoom of them.

typedef unsigned int uint32;
typedef unsigned long long uint64;

#ifdef __CUDACC__
#define FN static __device__ __forceinline__
#define ATOMIC_MIN(place, value) atomicMin(place, value)
#else
#include <cmath>
#define FN static inline
#define ATOMIC_MIN(place, value) (*(place) = (value) < *(place) ? (value) : *(place))
struct int4 { int x, y, z, w; };
struct float4 { float x, y, z, w; };
struct uint2 { uint32 x, y; };
#endif

// Where a field's look-ups begin: tables in entries, bits in words; salt: of the hash of its latents.
struct Field {
  int table_at, table_log2, bits_at, latent_table_at, latent_log2, latent_bits_at;
  uint32 salt;
  int unused;
};

// Arrays of one asset, as frames_asset.py fills it: 8 bytes each, then numbers of 4 bytes.
struct Asset {
  const float* positions;     // [V * 3]
  const int* faces;           // [F * 3]
  const float* uv;            // [F * 6], texels of the full image; of texels and UV textures
  const float* density;       // [F], texels along one unit of places
  const int* face_field;      // [F]
  const Field* fields;
  const uint2* table;         // open-addressing tables of (code of a brick, its number + 1), all levels, field after field
  const uint2* bits;          // 16 a brick: occupancy, row of the first voxel
  const uint32* values;       // RGBA by row, all levels
  const uint32* images;       // RGBA by texel, all levels; A is 0 where a texel is not referenced
  const int4* image_levels;   // first texel, width, height, 0
  const uint2* latents;       // 16 codes of 4 bits by row
  const uint2* latent_table;  // as table, of the level of latents on the surface
  const uint2* latent_bits;
  const float* matrices;      // weights [outputs, inputs] by layer, then the biases of all layers
  const uint2* fragments;     // weights as tensor cores take them, see frames_asset.fragments_of
  int vertices, face_count;
  int size, last;                                // size: voxels a side on level 0; last: number of the coarsest level
  int width, height, wrap_s, wrap_t, image_last; // of the full image; wrap: 0 repeat, 1 clamp, 2 mirror
  int resolution0, resolution1, hash_log2, first1, first_wave;
  float scale, offset_x, offset_y, offset_z;     // grid coordinates of level 0 = place * scale + offset
};

// right, up, forward: orthonormal; zoom: half the picture's side.
struct Camera {
  float right[3], up[3], forward[3];
  float zoom;
  int side;        // pixels
  float fineness;  // level of a field over voxels that a pixel asks, 0 where a pixel is no wider than a voxel
};

// ---- Visibility

// Where a vertex lands: pixels from the picture's centre, y downwards, and depth.
FN float4 seen_of(const Asset& asset, const Camera& camera, int v) {
  const float *p = asset.positions + 3 * (long long)v, scale = 0.5f * camera.side / camera.zoom;
  float4 out;
  out.x = (p[0] * camera.right[0] + p[1] * camera.right[1] + p[2] * camera.right[2]) * scale;
  out.y = -(p[0] * camera.up[0] + p[1] * camera.up[1] + p[2] * camera.up[2]) * scale;
  out.z = p[0] * camera.forward[0] + p[1] * camera.forward[1] + p[2] * camera.forward[2];
  out.w = 1.0f;
  return out;
}

// A face made ready: corners in 1/256 pixel, clockwise on the screen, rows and columns of pixels, and its depth over the screen.
struct Triangle {
  int x[3], y[3];
  int left, right, top, bottom;
  double depth, step_x, step_y, low, high;
};

FN int snapped(float pixels, int side) { return (int)floor((double)pixels * 256.0 + 128.0 * side + 0.5); }
FN int least(int a, int b) { return a < b ? a : b; }
FN int most(int a, int b) { return a > b ? a : b; }

// False where the face is turned away or covers no pixel's centre.
FN bool triangle_of(const Asset& asset, const float4* seen, int f, int side, Triangle& out) {
  const int* face = asset.faces + 3 * (long long)f;
  const float4 a = seen[face[0]], b = seen[face[1]], c = seen[face[2]];
  const int x0 = snapped(a.x, side), y0 = snapped(a.y, side);
  const int x1 = snapped(b.x, side), y1 = snapped(b.y, side), x2 = snapped(c.x, side), y2 = snapped(c.y, side);
  if ((long long)(x1 - x0) * (y2 - y0) - (long long)(x2 - x0) * (y1 - y0) >= 0) return false;  // counter-clockwise in the world
  out.x[0] = x0, out.y[0] = y0, out.x[1] = x2, out.y[1] = y2, out.x[2] = x1, out.y[2] = y1;
  out.left = most((least(x0, least(x1, x2)) + 127) >> 8, 0);
  out.right = least((most(x0, most(x1, x2)) - 128) >> 8, side - 1);
  out.top = most((least(y0, least(y1, y2)) + 127) >> 8, 0);
  out.bottom = least((most(y0, most(y1, y2)) - 128) >> 8, side - 1);
  if (out.left > out.right || out.top > out.bottom) return false;
  const double ux = (double)b.x - a.x, uy = (double)b.y - a.y, uz = (double)b.z - a.z;
  const double vx = (double)c.x - a.x, vy = (double)c.y - a.y, vz = (double)c.z - a.z, nz = ux * vy - uy * vx;
  const double over = nz != 0.0 ? -1.0 / nz : 0.0;
  out.step_x = (uy * vz - uz * vy) * over;
  out.step_y = (uz * vx - ux * vz) * over;
  out.depth = a.z + out.step_x * (0.5 - 0.5 * side - a.x) + out.step_y * (0.5 - 0.5 * side - a.y);
  out.low = fmin(a.z, fmin(b.z, c.z));
  out.high = fmax(a.z, fmax(b.z, c.z));
  return true;
}

// Whether a pixel's centre is on the inner side of all edges, borders by the top-left rule.
FN bool covers(const Triangle& t, int x, int y) {
  const int px = 256 * x + 128, py = 256 * y + 128;
  bool inside = true;
  for (int i = 0; i < 3; i++) {
    const int j = i == 2 ? 0 : i + 1, dx = t.x[j] - t.x[i], dy = t.y[j] - t.y[i];
    const long long e = (long long)dx * (py - t.y[i]) - (long long)dy * (px - t.x[i]);
    inside = inside && (e > 0 || (e == 0 && (dy < 0 || (dy == 0 && dx > 0))));
  }
  return inside;
}

// Whether any pixel of columns left..right and rows top..bottom may be inside: no edge has all four corners on its outer side.
FN bool meets(const Triangle& t, int left, int top, int right, int bottom) {
  bool meet = true;
  for (int i = 0; i < 3; i++) {
    const int j = i == 2 ? 0 : i + 1, dx = t.x[j] - t.x[i], dy = t.y[j] - t.y[i];
    const int px = 256 * (dy > 0 ? left : right) + 128, py = 256 * (dx > 0 ? bottom : top) + 128;
    meet = meet && (long long)dx * (py - t.y[i]) - (long long)dy * (px - t.x[i]) >= 0;
  }
  return meet;
}

// The face competes for a pixel: the nearest wins, of equally near ones the lowest number.
FN void compete(const Triangle& t, int f, int x, int y, int side, uint64* visible) {
  if (!covers(t, x, y)) return;
  double depth = t.depth + t.step_y * y + t.step_x * x;
  depth = fmin(fmax(depth, t.low), t.high);
  const uint64 key = ((uint64)(uint32)((depth + 2.0) * 1073741823.0) << 32) | (uint32)f;
  uint64* place = visible + (long long)y * side + x;
  if (key < *place) ATOMIC_MIN(place, key);
}

// Where on its face a pixel sees it: weights of the corners. Cut to the face, as pixel centres on snapped borders may lie beside it.
FN void weights_of(const float4 seen[3], float x, float y, float weight[3]) {
  const float ax = seen[0].x - x, ay = seen[0].y - y, bx = seen[1].x - x, by = seen[1].y - y, cx = seen[2].x - x, cy = seen[2].y - y;
  const float u = fminf(bx * cy - by * cx, 0.0f), v = fminf(cx * ay - cy * ax, 0.0f), w = fminf(ax * by - ay * bx, 0.0f);
  const float total = u + v + w;
  weight[0] = total < 0.0f ? u / total : 1.0f / 3.0f;
  weight[1] = total < 0.0f ? v / total : 1.0f / 3.0f;
  weight[2] = total < 0.0f ? w / total : 1.0f / 3.0f;
}

// The face that a pixel sees and the weights of its corners.
FN int face_at(const Asset& asset, const float4* seen, const uint64* visible, int pixel, int side, float weight[3]) {
  const int f = (int)(uint32)visible[pixel];
  const int* face = asset.faces + 3 * (long long)f;
  const float4 corners[3] = {seen[face[0]], seen[face[1]], seen[face[2]]};
  weights_of(corners, pixel % side + 0.5f - 0.5f * side, pixel / side + 0.5f - 0.5f * side, weight);
  return f;
}

// Grid coordinates of level 0.
FN void grid_at(const Asset& asset, int f, const float weight[3], float grid[3]) {
  const int* face = asset.faces + 3 * (long long)f;
  const float *a = asset.positions + 3 * (long long)face[0], *b = asset.positions + 3 * (long long)face[1];
  const float* c = asset.positions + 3 * (long long)face[2];
  const float offset[3] = {asset.offset_x, asset.offset_y, asset.offset_z};
  for (int k = 0; k < 3; k++) grid[k] = (weight[0] * a[k] + weight[1] * b[k] + weight[2] * c[k]) * asset.scale + offset[k];
}

// ---- Voxels (js/src/glsl_voxels.js, spec clause 8.2)

FN int ones(uint32 x) {
#ifdef __CUDACC__
  return __popc(x);
#else
  return __builtin_popcount(x);
#endif
}

FN uint32 in_brick(int x, int y, int z) {
  const uint32 v[3] = {(uint32)x & 7u, (uint32)y & 7u, (uint32)z & 7u};
  uint32 out = 0u;
  for (int k = 0; k < 3; k++) out |= ((v[k] & 1u) | ((v[k] & 2u) << 2) | ((v[k] & 4u) << 4)) << k;
  return out;
}

// What was looked up last, as neighbouring corners share a brick.
struct LookUp {
  const uint2 *table, *bits;
  int log2, brick;
  uint32 code;
};

FN LookUp look_up(const uint2* table, const uint2* bits, int log2) {
  LookUp out;
  out.table = table, out.bits = bits, out.log2 = log2, out.brick = -1, out.code = 0xffffffffu;
  return out;
}

FN LookUp voxels_of(const Asset& asset, int field) {
  const Field& own = asset.fields[field];
  return look_up(asset.table + own.table_at, asset.bits + own.bits_at, own.table_log2);
}

// Row of a voxel among all levels, -1 where it is not active.
FN int row_of(LookUp& known, int level, int x, int y, int z, int size) {
  if (x < 0 || y < 0 || z < 0 || x >= size || y >= size || z >= size) return -1;
  const uint32 bx = x >> 3, by = y >> 3, bz = z >> 3;
  const uint32 code = level == 0 ? bx | (by << 10) | (bz << 20) : bx | (by << 9) | (bz << 18) | ((uint32)level << 27) | 0x80000000u;
  if (code != known.code) {
    known.code = code, known.brick = -1;
    const uint32 mask = (1u << known.log2) - 1u;
    uint32 slot = (code * 2654435769u) >> (32 - known.log2);
    for (uint32 step = 0u; step <= mask; step++) {
      const uint2 entry = known.table[slot];
      if (entry.y == 0u) break;
      if (entry.x == code) {
        known.brick = (int)entry.y - 1;
        break;
      }
      slot = (slot + 1u) & mask;
    }
  }
  if (known.brick < 0) return -1;
  const uint32 inside = in_brick(x, y, z), bit = inside & 31u;
  const uint2 word = known.bits[16 * known.brick + (int)(inside >> 5)];
  return (word.x >> bit) & 1u ? (int)word.y + ones(word.x & ((1u << bit) - 1u)) : -1;
}

FN int size_of(const Asset& asset, int level) { return most((asset.size + (1 << level) - 1) >> level, 1); }

FN void add(uint32 rgba, float share, float colour[3]) {
  colour[0] += share * (float)(rgba & 255u);
  colour[1] += share * (float)((rgba >> 8) & 255u);
  colour[2] += share * (float)((rgba >> 16) & 255u);
}

// The nearest active voxel of the 27 about a place, on the finest level that has one.
FN int substitute(const Asset& asset, LookUp& known, int level, float x, float y, float z) {
  int row = -1;
  for (; row < 0 && level <= asset.last; level++) {
    float nearest = 3.0f;
    for (int q = 0; q < 27; q++) {
      const int vx = (int)floorf(x) + q % 3 - 1, vy = (int)floorf(y) + (q / 3) % 3 - 1, vz = (int)floorf(z) + q / 9 - 1;
      const float dx = vx + 0.5f - x, dy = vy + 0.5f - y, dz = vz + 0.5f - z, square = dx * dx + dy * dy + dz * dz;
      const int found = square < nearest ? row_of(known, level, vx, vy, vz, size_of(asset, level)) : -1;
      if (found < 0) continue;
      nearest = square;
      row = found;
    }
    x *= 0.5f, y *= 0.5f, z *= 0.5f;
  }
  return row;
}

// Adds share times the trilinear answer of a level over its active cells.
FN void add_level(const Asset& asset, LookUp& known, int level, const float grid[3], float share, float colour[3]) {
  const float down = 1.0f / (float)(1 << level), x = grid[0] * down, y = grid[1] * down, z = grid[2] * down;
  const float lx = floorf(x - 0.5f), ly = floorf(y - 0.5f), lz = floorf(z - 0.5f);
  const float px = x - 0.5f - lx, py = y - 0.5f - ly, pz = z - 0.5f - lz;
  const int size = size_of(asset, level);
  float total = 0.0f, sum[3] = {0.0f, 0.0f, 0.0f};
  for (int q = 0; q < 8; q++) {
    const int dx = q & 1, dy = (q >> 1) & 1, dz = q >> 2;
    const float weight = (dx ? px : 1.0f - px) * (dy ? py : 1.0f - py) * (dz ? pz : 1.0f - pz);
    const int row = weight > 0.0f ? row_of(known, level, (int)lx + dx, (int)ly + dy, (int)lz + dz, size) : -1;
    if (row < 0) continue;
    total += weight;
    add(asset.values[row], weight, sum);
  }
  if (total > 0.0f) {
    for (int c = 0; c < 3; c++) colour[c] += share * sum[c] / total;
    return;
  }
  add(asset.values[most(substitute(asset, known, level, x, y, z), 0)], share, colour);
}

// A pixel that is wider than a voxel asks the two levels nearest to its width; level 0 where `finest` is false is someone else's.
FN void add_voxels(const Asset& asset, const Camera& camera, int field, const float grid[3], bool finest, float colour[3]) {
  const float fineness = fminf(camera.fineness, (float)asset.last);
  const int level = (int)fineness;
  const float part = fineness - level;
  LookUp known = voxels_of(asset, field);
  if (level > 0 || finest) add_level(asset, known, level, grid, 1.0f - part, colour);
  if (part > 0.0f) add_level(asset, known, level + 1, grid, part, colour);
}

// ---- Texels and UV textures (field/texels.py, render/textures.py)

FN float folded(float x, float size, int mode) {
  if (mode == 1) return fminf(fmaxf(x, -1.0f), size + 1.0f);
  if (mode == 0) return x - floorf(x / size) * size;
  x = x - floorf(x / (2.0f * size)) * (2.0f * size);
  return x < size ? x : 2.0f * size - x;
}

FN int beside(int i, int size, int mode) {
  if (mode == 0 && i < 0) return size - 1;
  if (mode == 0 && i >= size) return 0;
  return least(most(i, 0), size - 1);
}

// Adds share times the bilinear answer of a level of the image; texels that are not referenced are left out of the weights.
FN void add_texels(const Asset& asset, int level, float u, float v, float share, float colour[3]) {
  const int4 image = asset.image_levels[level];
  const float down = 1.0f / (float)(1 << level);
  const float x = folded(u, (float)asset.width, asset.wrap_s) * down - 0.5f, y = folded(v, (float)asset.height, asset.wrap_t) * down - 0.5f;
  const float lx = floorf(x), ly = floorf(y), px = x - lx, py = y - ly;
  float total = 0.0f, sum[3] = {0.0f, 0.0f, 0.0f};
  for (int q = 0; q < 4; q++) {
    const int dx = q & 1, dy = q >> 1;
    const float weight = (dx ? px : 1.0f - px) * (dy ? py : 1.0f - py);
    const int column = beside((int)lx + dx, image.y, asset.wrap_s), row = beside((int)ly + dy, image.z, asset.wrap_t);
    const uint32 rgba = asset.images[image.x + (long long)row * image.y + column];
    if (rgba < 0x01000000u) continue;
    total += weight;
    add(rgba, weight, sum);
  }
  for (int c = 0; c < 3; c++) colour[c] += total > 0.0f ? share * sum[c] / total : 0.0f;
}

FN void texels_at(const Asset& asset, const Camera& camera, int f, const float weight[3], float colour[3]) {
  const float* uv = asset.uv + 6 * (long long)f;
  const float u = weight[0] * uv[0] + weight[1] * uv[2] + weight[2] * uv[4];
  const float v = weight[0] * uv[1] + weight[1] * uv[3] + weight[2] * uv[5];
  const float wide = asset.density[f] * 2.0f * camera.zoom / camera.side;
  const float fineness = fminf(wide > 1.0f ? log2f(wide) : 0.0f, (float)asset.image_last);
  const int level = (int)fineness;
  const float part = fineness - level;
  add_texels(asset, level, u, v, 1.0f - part, colour);
  if (part > 0.0f) add_texels(asset, level + 1, u, v, part, colour);
}

// ---- 3DNTC (js/src/glsl_neural.js, spec clause 11): two levels of 16 latents, the first on the surface, the second hashed

#define FEATURES 16
#define OCTAVES 3
#define INPUTS (2 * FEATURES + 6 * OCTAVES)
#define HIDDEN1 64
#define HIDDEN2 48
#define HIDDEN3 32
#define OUTPUTS 3

FN int local_of(int p, int resolution) { return (p >> 12) * resolution + (((p & 4095) * resolution) >> 12) - 2048; }

FN void add_codes(uint2 codes, float weight, float* sums) {
#ifdef __CUDACC__
#pragma unroll
#endif
  for (int k = 0; k < 8; k++) {  // a code of 4 bits with its sign, twice, plus 1
    sums[k] += weight * (float)(2 * ((int)(codes.x << (28 - 4 * k)) >> 28) + 1);
    sums[k + 8] += weight * (float)(2 * ((int)(codes.y << (28 - 4 * k)) >> 28) + 1);
  }
}

// Latents of one level at a place of 2**24 a side, weighted by where it stands in their cell.
FN void latents_at(const Asset& asset, int field, int level, const int position[3], float* out) {
  const Field& own = asset.fields[field];
  const int resolution = level == 0 ? asset.resolution0 : asset.resolution1;
  int cell[3];
  float part[3], total = 0.0f;
  for (int k = 0; k < 3; k++) {
    const int local = local_of(position[k], resolution);
    cell[k] = local >> 12;
    part[k] = (float)(local & 4095) / 4096.0f;
  }
  for (int c = 0; c < FEATURES; c++) out[c] = 0.0f;
  LookUp known = look_up(asset.latent_table + own.latent_table_at, asset.latent_bits + own.latent_bits_at, own.latent_log2);
  for (int q = 0; q < 8; q++) {
    const int dx = q & 1, dy = (q >> 1) & 1, dz = q >> 2, x = cell[0] + dx, y = cell[1] + dy, z = cell[2] + dz;
    const float weight = (dx ? part[0] : 1.0f - part[0]) * (dy ? part[1] : 1.0f - part[1]) * (dz ? part[2] : 1.0f - part[2]);
    if (weight < 1.0f / 16777216.0f) continue;
    const uint32 hash = (uint32)(x + 1) ^ ((uint32)(y + 1) * 2654435761u) ^ ((uint32)(z + 1) * 805459861u) ^ own.salt;
    const int row = level == 0 ? row_of(known, 0, x, y, z, resolution) : (int)(hash & ((1u << asset.hash_log2) - 1u)) + asset.first1;
    if (row < 0) continue;
    total += weight;
    add_codes(asset.latents[row], weight, out);
  }
  const float scale = total > 0.0f ? 1.0f / (16.0f * total) : 0.0f;
  for (int c = 0; c < FEATURES; c++) out[c] *= scale;
}

FN int absolute(int x) { return x < 0 ? -x : x; }

FN void inputs_at(const Asset& asset, int field, const int position[3], float* out) {
  latents_at(asset, field, 0, position, out);
  latents_at(asset, field, 1, position, out + FEATURES);
  for (int octave = 0; octave < OCTAVES; octave++) {
    for (int axis = 0; axis < 3; axis++) {
      const int phase = (int)((((uint32)position[axis] * ((uint32)asset.first_wave << octave)) >> 9) & 65535u);
      float* wave = out + 2 * FEATURES + 6 * octave + 2 * axis;
      wave[0] = (float)(absolute(phase - 32768) - 16384) / 16384.0f;
      wave[1] = (float)(absolute(((phase + 16384) & 65535) - 32768) - 16384) / 16384.0f;
    }
  }
}

FN float hard_gelu(float sum) {
  const float bent = fminf(fmaxf(sum, -1.5f), 1.5f);
  return sum > 1.5f ? sum : bent * (bent + 1.5f) / 3.0f;
}

FN float limited(float sum) { return fminf(fmaxf(sum, -1024.0f), 1024.0f); }

FN void layer(const float* weight, const float* bias, const float* in, float* out, int inputs, int outputs, bool hidden) {
  for (int o = 0; o < outputs; o++) {
    float sum = bias[o];
    for (int i = 0; i < inputs; i++) sum += weight[o * inputs + i] * in[i];
    out[o] = hidden ? hard_gelu(limited(sum)) : limited(sum);
  }
}

// Colour 0..255 of the last layer's answer.
FN float coded(float answer) { return 255.0f * fminf(fmaxf((answer + 1.0f) * 0.5f, 0.0f), 1.0f); }

// The network in plain arithmetic.
FN void network_at(const Asset& asset, int field, const int position[3], float colour[3]) {
  float a[HIDDEN1], b[HIDDEN1];
  const float *weight = asset.matrices, *bias = weight + INPUTS * HIDDEN1 + HIDDEN1 * HIDDEN2 + HIDDEN2 * HIDDEN3 + HIDDEN3 * OUTPUTS;
  inputs_at(asset, field, position, a);
  layer(weight, bias, a, b, INPUTS, HIDDEN1, true);
  weight += INPUTS * HIDDEN1, bias += HIDDEN1;
  layer(weight, bias, b, a, HIDDEN1, HIDDEN2, true);
  weight += HIDDEN1 * HIDDEN2, bias += HIDDEN2;
  layer(weight, bias, a, b, HIDDEN2, HIDDEN3, true);
  weight += HIDDEN2 * HIDDEN3, bias += HIDDEN3;
  layer(weight, bias, b, a, HIDDEN3, OUTPUTS, false);
  for (int c = 0; c < 3; c++) colour[c] = coded(a[c]);
}

FN void position_of(const Asset& asset, const float grid[3], int position[3]) {
  for (int k = 0; k < 3; k++) position[k] = (int)fminf(fmaxf(grid[k] * (16777216.0f / asset.size), 0.0f), 16777215.0f);
}

// ---- Pixels

FN uint32 packed(const float colour[3]) {
  uint32 out = 0xff000000u;
  for (int c = 0; c < 3; c++) out |= (uint32)rintf(fminf(fmaxf(colour[c], 0.0f), 255.0f)) << (8 * c);
  return out;
}

#define VOXELS 0
#define TEXELS 1
#define NEURAL 2

FN uint32 shade(const Asset& asset, const Camera& camera, const float4* seen, const uint64* visible, int pixel, int kind) {
  float weight[3], grid[3], colour[3] = {0.0f, 0.0f, 0.0f};
  const int f = face_at(asset, seen, visible, pixel, camera.side, weight);
  if (kind == TEXELS) {
    texels_at(asset, camera, f, weight, colour);
    return packed(colour);
  }
  grid_at(asset, f, weight, grid);
  if (kind == NEURAL && camera.fineness < 1.0f) {
    int position[3];
    position_of(asset, grid, position);
    network_at(asset, asset.face_field[f], position, colour);
    for (int c = 0; c < 3; c++) colour[c] *= 1.0f - camera.fineness;
    if (camera.fineness == 0.0f) return packed(colour);
  }
  add_voxels(asset, camera, asset.face_field[f], grid, kind == VOXELS, colour);
  return packed(colour);
}
