// RGBA pictures as blocks of 4 x 4 texels, 16 bytes each, with their mipmaps: BC7 in mode 6, or ASTC with one partition. Either has two
// endpoints and a weight of 16 levels a texel (ASTC with alpha: 8). Endpoints are the extremes on the principal axis, refined once by least
// squares. Formats: Khronos Data Format Specification 1.3, sections 20 (BC7) and 23 (ASTC). A module of its own, js/src/blocks.wasm, without
// a C library; a page takes it only where it uploads compressed textures.
#include <stdint.h>
#include <wasm_simd128.h>

#define EXPORT(name) extern "C" __attribute__((export_name(#name)))

extern "C" uint8_t __heap_base;

namespace {
enum Format { BC7 = 0, ASTC = 1 };
typedef float f32x4 __attribute__((vector_size(16)));
typedef int32_t i32x4 __attribute__((vector_size(16)));
typedef int16_t i16x8 __attribute__((vector_size(16)));

constexpr int T_SCALE = 64;  // units of projections a level: 255 * 2 (the longest diagonal) * 64 < 2^15

struct Block {
  i16x8 c[4][2];  // channels, texels in raster order
};
struct Ends {
  f32x4 low, high;
};

uint8_t nearest192[256], decoded192[256], trits[243];  // ASTC: code of an 8 bit value, its value, five trits as 8 bits
uint16_t linear[256];
uint8_t srgb[4096];  // of linear values in steps of 1/4096, which are finer than those of 8 bits of sRGB

// ---- Tables

int decoded_trits(int t) {  // five trits as a number of base 3 (section 23.12)
  int c, t4, t3, t2, t1, t0;
  if ((t >> 2 & 7) == 7) {
    c = (t >> 3 & 28) | (t & 3), t4 = t3 = 2;
  } else {
    c = t & 31;
    bool two = (t >> 5 & 3) == 3;
    t4 = two ? 2 : t >> 7, t3 = two ? t >> 7 : t >> 5 & 3;
  }
  if ((c & 3) == 3) {
    t2 = 2, t1 = c >> 4, t0 = (c >> 3 & 1) << 1 | (c >> 2 & 1 & ~(c >> 3));
  } else if ((c >> 2 & 3) == 3) {
    t2 = t1 = 2, t0 = c & 3;
  } else {
    t2 = c >> 4, t1 = c >> 2 & 3, t0 = (c >> 1 & 1) << 1 | (c & 1 & ~(c >> 1));
  }
  return t0 + 3 * (t1 + 3 * (t2 + 3 * (t3 + 3 * t4)));
}

int unquantised192(int code) {  // a trit above six bits fedcba
  int a = code & 1 ? 511 : 0, high = code >> 1 & 31, b = high << 4 | high >> 4;
  int t = ((code >> 6) * 5 + b) ^ a;
  return (a & 128) | t >> 2;
}

float power(float x, float exponent) {  // 2^(exponent * log2 x) for x in (0, 1], good to 1e-6
  int e = 0;
  while (x < 0.70710678f) x *= 2, e--;
  double y = (x - 1.0) / (x + 1.0), y2 = y * y, log2 = e + 2.8853900817779268 * y * (1 + y2 * (1 / 3.0 + y2 * (0.2 + y2 / 7 + y2 * y2 / 9)));
  double p = exponent * log2;
  int whole = int(p) - (p < 0);
  double z = (p - whole) * 0.6931471805599453, sum = 1, term = 1;
  for (int n = 1; n < 12; n++) sum += term *= z / n;
  while (whole < 0) sum *= 0.5, whole++;
  return float(sum);
}

void make_tables() {
  for (int t = 255; t >= 0; t--) trits[decoded_trits(t)] = uint8_t(t);
  for (int v = 0; v < 256; v++) {
    int best = 1 << 20;
    for (int code = 0; code < 192; code++) {
      int value = unquantised192(code), away = value > v ? value - v : v - value;
      if (away < best) best = away, nearest192[v] = uint8_t(code), decoded192[v] = uint8_t(value);
    }
    float x = v / 255.0f;
    linear[v] = uint16_t(65535 * (x <= 0.04045f ? x / 12.92f : power((x + 0.055f) / 1.055f, 2.4f)) + 0.5f);
  }
  for (int i = 0; i < 4096; i++) {
    float x = (i + 0.5f) / 4096;
    srgb[i] = uint8_t(255 * (x <= 0.0031308f ? 12.92f * x : 1.055f * power(x, 1 / 2.4f) - 0.055f) + 0.5f);
  }
}

// ---- Texels of a block

i32x4 sums(i32x4 a, i32x4 b, i32x4 c, i32x4 d) {  // of the four numbers of each
  i32x4 ab = __builtin_shufflevector(a, b, 0, 4, 1, 5) + __builtin_shufflevector(a, b, 2, 6, 3, 7);
  i32x4 cd = __builtin_shufflevector(c, d, 0, 4, 1, 5) + __builtin_shufflevector(c, d, 2, 6, 3, 7);
  return __builtin_shufflevector(ab, cd, 0, 1, 4, 5) + __builtin_shufflevector(ab, cd, 2, 3, 6, 7);
}
i32x4 dot(const i16x8* a, const i16x8* b) {
  return (i32x4)wasm_i32x4_dot_i16x8((v128_t)a[0], (v128_t)b[0]) + (i32x4)wasm_i32x4_dot_i16x8((v128_t)a[1], (v128_t)b[1]);
}
f32x4 floats(i32x4 v) { return __builtin_convertvector(v, f32x4); }
i32x4 ints(f32x4 v) { return (i32x4)wasm_i32x4_trunc_sat_f32x4((v128_t)v); }
f32x4 clamped(f32x4 v, float most) {
  return (f32x4)wasm_f32x4_pmin(wasm_f32x4_pmax((v128_t)v, wasm_f32x4_splat(0)), wasm_f32x4_splat(most));
}
float sum(f32x4 v) { return v[0] + v[1] + v[2] + v[3]; }

Block separated(const v128_t rows[4]) {
  Block block;
  for (int half = 0; half < 2; half++) {
    v128_t a = rows[2 * half], b = rows[2 * half + 1];
    v128_t rg = wasm_i8x16_shuffle(a, b, 0, 4, 8, 12, 16, 20, 24, 28, 1, 5, 9, 13, 17, 21, 25, 29);
    v128_t ba = wasm_i8x16_shuffle(a, b, 2, 6, 10, 14, 18, 22, 26, 30, 3, 7, 11, 15, 19, 23, 27, 31);
    block.c[0][half] = (i16x8)wasm_u16x8_extend_low_u8x16(rg), block.c[1][half] = (i16x8)wasm_u16x8_extend_high_u8x16(rg);
    block.c[2][half] = (i16x8)wasm_u16x8_extend_low_u8x16(ba), block.c[3][half] = (i16x8)wasm_u16x8_extend_high_u8x16(ba);
  }
  return block;
}

// Projections of texels, less their mean in quarters of a level, on a unit axis, in levels times T_SCALE.
void project(const Block& away, f32x4 axis, i16x8 t[2]) {
  i32x4 whole = ints(axis * 32767.0f);
  for (int half = 0; half < 2; half++) {
    v128_t all = wasm_i16x8_splat(0);
    for (int k = 0; k < 4; k++)
      all = wasm_i16x8_add(all, wasm_i16x8_q15mulr_sat((v128_t)(away.c[k][half] << 4), wasm_i16x8_splat(int16_t(whole[k]))));
    t[half] = (i16x8)all;
  }
}

// Nearest of levels 0 to `last` between projections from and to.
void weigh(const i16x8 t[2], float from, float to, int last, i16x8 weights[2]) {
  float scale = to > from ? last / (to - from) : 0;
  for (int half = 0; half < 2; half++) {
    f32x4 low = floats((i32x4)wasm_i32x4_extend_low_i16x8((v128_t)t[half])), high = floats((i32x4)wasm_i32x4_extend_high_i16x8((v128_t)t[half]));
    i32x4 a = ints(clamped((low - from) * scale + 0.5f, last + 0.5f)), b = ints(clamped((high - from) * scale + 0.5f, last + 0.5f));
    weights[half] = (i16x8)wasm_i16x8_narrow_i32x4((v128_t)a, (v128_t)b);
  }
}

f32x4 principal_axis(const Block& d) {  // the direction in which texels differ most, by three steps of power iteration
  i32x4 dots[4][4];
  for (int i = 0; i < 4; i++)
    for (int k = i; k < 4; k++) dots[i][k] = dots[k][i] = dot(d.c[i], d.c[k]);
  f32x4 rows[4];
  for (int i = 0; i < 4; i++) rows[i] = floats(sums(dots[i][0], dots[i][1], dots[i][2], dots[i][3]));
  float trace = rows[0][0] + rows[1][1] + rows[2][2] + rows[3][3];
  f32x4 axis = rows[0];
  float most = rows[0][0];
  for (int i = 1; i < 4; i++)
    if (rows[i][i] > most) most = rows[i][i], axis = rows[i];
  axis *= 1 / trace;
  for (int n = 0; n < 3; n++) axis = (rows[0] * axis[0] + rows[1] * axis[1] + rows[2] * axis[2] + rows[3] * axis[3]) * (1 / trace);
  return axis * (1 / __builtin_sqrtf(sum(axis * axis)));
}

// Endpoints with the least squared error under these weights, in levels less the mean; false where all weights are alike.
bool least_squares(const Block& d, const i16x8 w[2], int last, Ends& ends) {
  const i16x8 ones[2] = {(i16x8)wasm_i16x8_splat(1), (i16x8)wasm_i16x8_splat(1)};
  f32x4 towards = floats(sums(dot(d.c[0], w), dot(d.c[1], w), dot(d.c[2], w), dot(d.c[3], w))) * 0.25f;
  i32x4 moments = sums(dot(w, ones), dot(w, w), i32x4{}, i32x4{});
  float mean = moments[0] / 16.0f, spread = moments[1] - mean * moments[0];
  if (spread <= 0) return false;
  f32x4 slope = towards * (1 / spread);  // the texels' own mean is zero
  ends = {slope * -mean, slope * (last - mean)};
  return true;
}

// ---- BC7, mode 6

struct Coded {
  i32x4 q;  // 7 bits a channel
  int p;    // the lowest bit of all
  f32x4 value;
};

Coded coded7(f32x4 end, f32x4 counts) {
  Coded best{};
  float least = 1e30f;
  for (int p = 0; p < 2; p++) {
    i32x4 q = ints(clamped((end - float(p)) * 0.5f + 0.5f, 127.5f));
    f32x4 value = floats(q * 2 + p), away = (value - end) * counts;
    float error = sum(away * away);
    if (error < least) least = error, best = {q, p, value};
  }
  return best;
}

uint64_t nibbles(const i16x8 w[2]) {
  v128_t bytes = wasm_u8x16_narrow_i16x8((v128_t)w[0], (v128_t)w[1]);
  v128_t pairs = wasm_v128_and(wasm_v128_or(bytes, wasm_u16x8_shr(bytes, 4)), wasm_i16x8_splat(255));
  return uint64_t(wasm_i64x2_extract_lane(wasm_u8x16_narrow_i16x8(pairs, pairs), 0));
}

void pack7(Coded a, Coded b, uint64_t weights, uint8_t* out) {
  if (weights & 8) {  // the highest bit of the first weight is not sent
    weights = ~weights;
    Coded swapped = a;
    a = b, b = swapped;
  }
  uint64_t low = 1 << 6, high = b.p | (weights & 7) << 1 | weights >> 4 << 4;
  for (int k = 0; k < 4; k++) low |= uint64_t(a.q[k]) << (7 + 14 * k) | uint64_t(b.q[k]) << (14 + 14 * k);
  low |= uint64_t(a.p) << 63;
  *(uint64_t*)out = low, *(uint64_t*)(out + 8) = high;
}

// One value in all texels: exact, by weight 34 of 64 between an even and an odd end where channels are even and odd; 0 becomes 1 there.
void uniform7(i32x4 value, bool alpha, uint8_t* out) {
  if (!alpha) value[3] = value[0];
  Coded a{value >> 1, 0, {}}, b = a;
  bool odd = value[0] & 1, mixed = (value[1] & 1) != odd || (value[2] & 1) != odd || (value[3] & 1) != odd;
  a.p = b.p = odd;
  if (mixed) {
    a.p = 0, b.p = 1;
    for (int k = 0; k < 4; k++) a.q[k] = value[k] & 1 || value[k] == 0 ? value[k] >> 1 : (value[k] >> 1) - 1;
  }
  if (!alpha) a.q[3] = b.q[3] = 127;
  pack7(a, b, mixed ? 0x8888888888888888u : 0, out);
}

void bc7(f32x4 mean, const Block& d, Ends ends, bool alpha, uint8_t* out) {
  f32x4 counts = {1, 1, 1, alpha ? 1.0f : 0.0f};
  Coded a = coded7(mean + ends.low, counts), b = coded7(mean + ends.high, counts);
  f32x4 along = (b.value - a.value) * counts;
  float length = __builtin_sqrtf(sum(along * along));
  i16x8 t[2], weights[2] = {};
  if (length > 0) {
    f32x4 axis = along * (1 / length);
    float from = sum((a.value - mean) * axis) * T_SCALE;
    project(d, axis, t);
    weigh(t, from, from + length * T_SCALE, 15, weights);
  }
  pack7(a, b, nibbles(weights), out);
}

// ---- ASTC, blocks of 4 x 4

uint64_t reversed(uint64_t x) {
  x = __builtin_bswap64(x);
  x = (x >> 4 & 0x0f0f0f0f0f0f0f0f) | (x & 0x0f0f0f0f0f0f0f0f) << 4;
  x = (x >> 2 & 0x3333333333333333) | (x & 0x3333333333333333) << 2;
  return (x >> 1 & 0x5555555555555555) | (x & 0x5555555555555555) << 1;
}

uint64_t endpoint_bits(const uint8_t* codes, int count) {  // six bits and a trit each; trits in groups of five (23.12)
  static const uint8_t places[5] = {0, 2, 4, 5, 7}, sizes[5] = {2, 2, 1, 2, 1};
  uint64_t bits = 0;
  for (int first = 0, at = 0; first < count; first += 5) {
    int number = 0, many = count - first < 5 ? count - first : 5;
    for (int i = many - 1; i >= 0; i--) number = 3 * number + (codes[first + i] >> 6);
    for (int i = 0; i < many; i++, at += 6) {
      bits |= uint64_t(codes[first + i] & 63) << at;
      bits |= uint64_t(trits[number] >> places[i] & ((1 << sizes[i]) - 1)) << (at + 6);
      at += sizes[i];
    }
  }
  return bits;
}

void astc(f32x4 mean, const Block& d, Ends ends, bool alpha, uint8_t* out) {
  int channels = alpha ? 4 : 3, last = alpha ? 7 : 15, sums[2] = {0, 0};
  i32x4 wanted[2] = {ints(clamped(mean + ends.low + 0.5f, 255)), ints(clamped(mean + ends.high + 0.5f, 255))};
  f32x4 value[2] = {};
  for (int e = 0; e < 2; e++)
    for (int k = 0; k < channels; k++) {
      int v = decoded192[wanted[e][k]];
      value[e][k] = v;
      if (k < 3) sums[e] += v;
    }
  int first = sums[1] < sums[0];  // the end with the lesser sum is sent first
  f32x4 counts = {1, 1, 1, alpha ? 1.0f : 0.0f}, along = (value[1 - first] - value[first]) * counts;
  float length = __builtin_sqrtf(sum(along * along));
  i16x8 t[2], weights[2] = {};
  if (length > 0) {
    f32x4 axis = along * (1 / length);
    float from = sum((value[first] - mean) * axis) * T_SCALE;
    project(d, axis, t);
    weigh(t, from, from + length * T_SCALE, last, weights);
  }
  uint64_t levels = nibbles(weights), packed = levels;
  uint8_t codes[8];
  for (int k = 0; k < channels; k++)
    for (int e = 0; e < 2; e++) codes[2 * k + e] = nearest192[wanted[e ^ first][k]];
  if (alpha) {
    packed = 0;
    for (int i = 0; i < 16; i++) packed |= (levels >> 4 * i & 7) << 3 * i;
  }
  int mode = alpha ? 0x53 : 0x242, kind = alpha ? 12 : 8;  // 4 x 4 weights of 3 or 4 bits; endpoints are RGBA or RGB
  uint64_t ends_bits = endpoint_bits(codes, 2 * channels);  // at most 61
  *(uint64_t*)out = ends_bits << 17 | uint64_t(mode | kind << 13), *(uint64_t*)(out + 8) = ends_bits >> 47 | reversed(packed);
}

void uniform_astc(i32x4 value, bool alpha, uint8_t* out) {  // a void extent block has 16 bits a channel
  if (!alpha) value[3] = 255;
  *(uint64_t*)out = 0xfffffffffffffdfc, *(uint64_t*)(out + 8) = 0;
  for (int k = 0; k < 4; k++) out[8 + 2 * k] = out[9 + 2 * k] = uint8_t(value[k]);
}

// ---- Pictures

void code_block(const v128_t rows[4], Format format, bool alpha, uint8_t* out) {
  Block d = separated(rows);
  const i16x8 ones[2] = {(i16x8)wasm_i16x8_splat(1), (i16x8)wasm_i16x8_splat(1)};
  i32x4 total = sums(dot(d.c[0], ones), dot(d.c[1], ones), dot(d.c[2], ones), dot(d.c[3], ones));
  v128_t first = wasm_i32x4_splat(wasm_i32x4_extract_lane(rows[0], 0)), differ = wasm_v128_xor(rows[0], first);
  for (int y = 1; y < 4; y++) differ = wasm_v128_or(differ, wasm_v128_xor(rows[y], first));
  if (!alpha) differ = wasm_v128_and(differ, wasm_i32x4_splat(0xffffff));
  if (!wasm_v128_any_true(differ)) return format == BC7 ? uniform7(total >> 4, alpha, out) : uniform_astc(total >> 4, alpha, out);
  for (int k = 0; k < 4; k++)
    for (int half = 0; half < 2; half++)
      d.c[k][half] = k == 3 && !alpha ? i16x8{} : d.c[k][half] * 4 - (i16x8)wasm_i16x8_splat(int16_t(total[k] >> 2));
  f32x4 mean = floats(total) * (1 / 16.0f), axis = principal_axis(d);
  if (!alpha) mean[3] = 255;
  i16x8 t[2], weights[2];
  project(d, axis, t);
  v128_t low = wasm_i16x8_min((v128_t)t[0], (v128_t)t[1]), high = wasm_i16x8_max((v128_t)t[0], (v128_t)t[1]);
  int from = 32767, to = -32768;
  for (int i = 0; i < 8; i++) {
    int a = ((i16x8)low)[i], b = ((i16x8)high)[i];
    from = a < from ? a : from, to = b > to ? b : to;
  }
  int last = format == ASTC && alpha ? 7 : 15;
  Ends ends = {axis * (from * (1.0f / T_SCALE)), axis * (to * (1.0f / T_SCALE))};
  weigh(t, float(from), float(to), last, weights);
  least_squares(d, weights, last, ends);
  format == BC7 ? bc7(mean, d, ends, alpha, out) : astc(mean, d, ends, alpha, out);
}

uint8_t* code_level(const uint32_t* picture, int width, int height, Format format, bool alpha, uint8_t* out) {
  for (int y = 0; y < height; y += 4)
    for (int x = 0; x < width; x += 4, out += 16) {
      v128_t rows[4];
      for (int j = 0; j < 4; j++) {
        const uint32_t* row = picture + (y + j < height ? y + j : height - 1) * width;
        if (x + 4 <= width) {
          rows[j] = wasm_v128_load(row + x);
        } else {
          uint32_t four[4];
          for (int i = 0; i < 4; i++) four[i] = row[x + i < width ? x + i : width - 1];
          rows[j] = wasm_v128_load(four);
        }
      }
      code_block(rows, format, alpha, out);
    }
  return out;
}

// The next level in place of a picture, means of 2 x 2 texels, colours in linear light: written texels lie before all that are still read.
void halve(uint8_t* picture, int& width, int& height, bool colour) {
  int w = width > 1 ? width / 2 : 1, h = height > 1 ? height / 2 : 1;
  for (int y = 0; y < h; y++) {
    int top = height > 1 ? ((2 * y + 1) * height / h - 1) / 2 : 0, bottom = top + 1 < height ? top + 1 : top;
    for (int x = 0; x < w; x++) {
      int left = width > 1 ? ((2 * x + 1) * width / w - 1) / 2 : 0, right = left + 1 < width ? left + 1 : left;
      const uint8_t* from[4] = {picture + 4 * (top * width + left), picture + 4 * (top * width + right),
                                picture + 4 * (bottom * width + left), picture + 4 * (bottom * width + right)};
      uint8_t four[4];
      for (int k = 0; k < 4; k++) {
        int a = from[0][k], b = from[1][k], c = from[2][k], d = from[3][k];
        four[k] = colour && k < 3 ? srgb[(linear[a] + linear[b] + linear[c] + linear[d]) >> 6] : uint8_t((a + b + c + d + 2) >> 2);
      }
      __builtin_memcpy(picture + 4 * (y * w + x), four, 4);
    }
  }
  width = w, height = h;
}
}  // namespace

EXPORT(start) uint8_t* exported_start() { return &__heap_base; }

// Blocks of all levels, the largest first, from an RGBA picture, which is overwritten. format: 0 BC7, 1 ASTC; colour: RGB is sRGB; alpha:
// whether it counts, else it is 255 (BC7: or 254). Returns the end of the blocks.
EXPORT(encode) uint8_t* exported_encode(uint8_t* picture, int width, int height, int format, int colour, int alpha, uint8_t* out) {
  if (trits[242] == 0) make_tables();
  for (;; halve(picture, width, height, colour)) {
    out = code_level((const uint32_t*)picture, width, height, Format(format), alpha, out);
    if (width == 1 && height == 1) return out;
  }
}
