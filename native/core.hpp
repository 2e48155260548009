// What the three parts of the decoder share: numbers (clause 4), readers of bytes and bits, the decoded asset.
#pragma once
#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <cstring>
#include <exception>
#include <memory>
#include <string>
#if defined(__cpp_exceptions)
#include <thread>
#endif
#include <vector>

#include "texf.h"

namespace texf {

using u8 = uint8_t;
using u16 = uint16_t;
using u32 = uint32_t;
using u64 = uint64_t;
using i8 = int8_t;
using i16 = int16_t;
using i32 = int32_t;
using i64 = int64_t;

// Arrays that resize() does not set to 0.
template <typename T>
struct Unset : std::allocator<T> {
  template <typename U>
  struct rebind { using other = Unset<U>; };
  template <typename U>
  void construct(U* place) { ::new (static_cast<void*>(place)) U; }
  template <typename U, typename... Of>
  void construct(U* place, Of&&... of) { ::new (static_cast<void*>(place)) U(std::forward<Of>(of)...); }
};
template <typename T>
using Array = std::vector<T, Unset<T>>;

// ---- Refusals. Where there are no exceptions the refusal is kept and the program stops: who runs a sandbox looks there.

// The codes of docs/guide/errors.md: 100 times the exit code, and the number; S22 is TXF-S22.
enum Finding : int {
  C02 = 100 * TEXF_STOPPED + 2,  // stopped by texf_set_stop()
  S01 = 100 * TEXF_INVALID + 1, S02, S03, S04, S05, S06, S07, S08, S09, S10, S11, S12, S13, S14, S20 = 100 * TEXF_INVALID + 20, S21, S22, S23, S24,
  S30 = 100 * TEXF_INVALID + 30, S32 = S30 + 2, S50 = 100 * TEXF_INVALID + 50, C04 = 100 * TEXF_INTERNAL + 4,
  U01 = 100 * TEXF_UNSUPPORTED + 1, U02, U03, U04, U07 = 100 * TEXF_UNSUPPORTED + 7, U09 = U07 + 2,
  L01 = 100 * TEXF_LIMIT + 1, L02, L03, L04, L05, L06, L07, L10 = 100 * TEXF_LIMIT + 10, L11
};

[[noreturn]] void refuse(const texf_refusal& refusal);
std::string decimal(u64 value);
[[noreturn]] void fail(Finding finding, const char* sentence);
[[noreturn]] void fail(Finding finding, const std::string& sentence);
[[noreturn]] void fail_value(Finding finding, u64 value, u64 allowed, const char* sentence);  // "sentence: value, allowed ..."

inline void require(bool holds, Finding finding, const char* sentence) {
  if (!holds) fail(finding, sentence);
}
inline void require_equal(u64 value, u64 coded, Finding finding, const char* sentence) {
  if (value != coded) fail_value(finding, value, coded, sentence);
}
inline void within(u64 count, u64 limit, Finding finding, const char* sentence) {
  if (limit > 0 && count > limit) fail_value(finding, count, limit, sentence);
}

#if defined(__cpp_exceptions)
inline thread_local const int32_t* stop_flag = nullptr;  // of texf_set_stop(); who hands work to another thread sets it there
inline void check_stop() {
  if (stop_flag && __atomic_load_n(stop_flag, __ATOMIC_RELAXED)) fail(C02, "stopped");
}
#else
inline void check_stop() {}  // a sandbox is stopped by its host
#endif

// Calls what(0) to what(count - 1) on up to `threads` threads. All are called, then the first by number that has thrown is thrown on.
template <typename What>
void side_by_side(int threads, size_t count, const What& what) {
#if defined(__cpp_exceptions)
  if (threads > 1 && count > 1) {
    std::atomic<size_t> next{0};
    std::vector<std::exception_ptr> thrown(count);
    auto work = [&, stop = stop_flag] {
      stop_flag = stop;
      for (size_t i; (i = next++) < count;) try {
          what(i);
        } catch (...) {
          thrown[i] = std::current_exception();
        }
    };
    std::vector<std::thread> others;
    others.reserve(threads);
    try {
      while (others.size() + 1 < std::min(count, size_t(threads))) others.emplace_back(work);
    } catch (...) {  // fewer threads, then
    }
    work();
    for (std::thread& other : others) other.join();
    for (const std::exception_ptr& one : thrown)
      if (one) std::rethrow_exception(one);
    return;
  }
#endif
  for (size_t i = 0; i < count; i++) what(i);
}

// The same by pieces: what(first, end).
template <typename What>
void by_pieces(int threads, size_t count, const What& what) {
  size_t pieces = threads > 1 ? std::min<size_t>(count, 4 * threads) : 1;
  side_by_side(threads, pieces, [&](size_t n) { what(count * n / pieces, count * (n + 1) / pieces); });
}

// ---- 4.1

inline i64 floor_div(i64 a, i64 b) { return a / b - (a % b < 0); }  // b > 0
inline i64 floor_mod(i64 a, i64 b) { return a % b < 0 ? a % b + b : a % b; }
inline i64 ceil_div(i64 a, i64 b) { return floor_div(a + b - 1, b); }
inline i64 clip(i64 low, i64 high, i64 v) { return v < low ? low : v > high ? high : v; }
inline i64 magnitude(i64 v) { return v < 0 ? -v : v; }
inline int bit_length(u64 v) { return v ? 64 - __builtin_clzll(v) : 0; }
i64 isqrt(u64 v);

u32 crc32(const void* data, size_t size, u32 before = 0);

inline u64 spread_bits(u64 v) {  // bit i to bit 3 i, 21 bits
  v = (v | v << 32) & 0x1f00000000ffffull;
  v = (v | v << 16) & 0x1f0000ff0000ffull;
  v = (v | v << 8) & 0x100f00f00f00f00full;
  v = (v | v << 4) & 0x10c30c30c30c30c3ull;
  return (v | v << 2) & 0x1249249249249249ull;
}
inline u64 gathered_bits(u64 v) {
  v &= 0x1249249249249249ull;
  v = (v | v >> 2) & 0x10c30c30c30c30c3ull;
  v = (v | v >> 4) & 0x100f00f00f00f00full;
  v = (v | v >> 8) & 0x1f0000ff0000ffull;
  v = (v | v >> 16) & 0x1f00000000ffffull;
  return (v | v >> 32) & 0x1fffffull;
}
inline u64 morton_key(u64 x, u64 y, u64 z) { return spread_bits(x) | spread_bits(y) << 1 | spread_bits(z) << 2; }

void sort_keys(std::vector<u64>& keys);  // ascending; by bytes, for many

// ---- 7.6: the range decoder and its contexts, which 8.4 and 11.9 use too

struct Context {
  u32 fast = 1 << 21, rest = 1 << 21;  // rest: slow, 24 bits, and the count
  u32 slow() const { return rest & 0xffffff; }
  template <int most>
  void adapt(int bit) {
    i32 target = bit * ((1 << 22) - 1), now = i32(slow());
    u32 count = rest >> 24, rate = 32 - __builtin_clz(count + 1);
    fast += (target - i32(fast)) >> (rate < most ? rate : most);
    rest = u32(now + ((target - now) >> rate)) | (count < 63 ? count + 1 : count) << 24;
  }
};

class RangeDecoder {
 public:
  RangeDecoder() = default;
  RangeDecoder(const u8* data, size_t size) : at_(data), end_(data + size) {
    for (int i = 0; i < 4; i++) code_ = code_ << 8 | next();
    code_ = std::min<u32>(code_, 0xfffffffe);
  }
  int split(u32 bound) {
    u32 bit = code_ < bound, without = bit - 1;  // no branch that is hard to foresee
    code_ -= bound & without;
    range_ = (bound & ~without) | ((range_ - bound) & without);
    while (range_ < 1u << 24) {
      range_ <<= 8;
      code_ = code_ << 8 | next();
    }
    return int(bit);
  }
  int likely(u32 p) { return split((range_ >> 16) * p); }
  int bypass() { return split(range_ >> 1); }
  template <int most = 3>
  int bit(Context& context) {
    int bit_read = likely(clip(24, 65512, (context.fast + context.slow()) >> 7));
    context.adapt<most>(bit_read);
    return bit_read;
  }
  u32 rest() {  // of 7.5.4
    int bits = 0;
    u32 value = 1;
    while (bits < 24 && bypass()) bits++;
    while (bits-- > 0) value = 2 * value + bypass();
    return value;
  }

 private:
  u32 next() { return at_ < end_ ? *at_++ : 0; }
  const u8 *at_ = nullptr, *end_ = nullptr;
  u32 range_ = 0xffffffff, code_ = 0;
};

// ---- The stream (clause 5) and what is decoded of it

struct Bytes {
  const u8* data = nullptr;
  size_t size = 0;
};

struct ChannelGroup {
  std::vector<u8> semantics;
  int components = 0;
};

struct Parameter {
  int id;
  std::vector<float> value;
};

struct Material {
  std::string name;
  int alpha_mode = 0, alpha_cutoff = 0, flags = 0, normal_rule = 0, normal_angle = 45;
  u32 channels = 0;
  std::vector<Parameter> parameters;
};

struct Field {
  bool planar = false;
  int resolution = 0, area_threshold = 0, width = 0, height = 0, wrap[2] = {0, 0}, fraction_bits = 0;
  u64 index = 0, num_keys = 0;
  u32 keys_crc = 0;
  std::vector<u64> keys;  // of the whole field
  int depth() const { return bit_length(resolution - 1); }  // D
};

struct GeometryUnit {
  u64 field = 0, material = 0;
  u64 vertices = 0, faces = 0;
  bool planar = false;
  i32 uv_origin[2] = {0, 0};
  int uv_bits = 0;
  u64 uv_range = 0;
  u32 crc = 0;
  Bytes draco;
  std::vector<u32> position;  // [V, 3]
  std::vector<i32> uv;        // [V, 2], with uv_origin
  std::vector<u32> corner;    // [F, 3]
  size_t num_faces() const { return corner.size() / 3; }
  const u32* at(size_t face, int turn) const { return &position[3 * size_t(corner[3 * face + turn])]; }
};

struct FilterStage {
  u32 mask = 0;
  std::vector<i8> coefficients;
};

struct LatentLevel {
  int resolution = 0, table_log2 = 0, threshold = 0;
  std::vector<u64> num_latents;
  u64 num_rows = 0;
  std::vector<std::vector<u64>> keys;  // of every field, where the level is not hashed
};

enum { RAHT = 0, NEURAL = 1, CONSTANT = 2, FIRST_PRIVATE = 192 };

struct AttributeUnit {
  u64 field = 0;
  int group = 0, codec = 0, level_shift = 0, components = 0, depth = 0;
  u32 values_crc = 0;
  // RAHT (5.7.1)
  bool planar = false;
  int colour_transform = 0, qp[3] = {0, 0, 0}, kernel[7] = {}, colour_range = 0, num_models = 0, planar_transform = 0;
  int dct_blocks = 0, component_cross = 0, residual = 0, residual_cross[3] = {0, 0, 0}, slice_level = 0;
  i32 root_mean[3] = {0, 0, 0};
  std::vector<FilterStage> filters;
  std::vector<u64> slice_first;
  std::vector<Bytes> codewords;
  // constant (5.7.6)
  u8 plane_value[3] = {0, 0, 0};
  // 3DNTC (5.7.4)
  int form = 0, num_features = 0, wave_octaves = 0, first_wave = 0;
  std::vector<int> widths;
  std::vector<LatentLevel> levels;
  Bytes network, latents;
};

struct Asset {
  int position_bits = 0, lod = 0, threads = 1;
  u32 chosen = ~0u;  // attribute units that are decoded
  double origin[3] = {0, 0, 0}, side = 0;
  std::vector<ChannelGroup> groups;
  std::vector<Material> materials;
  std::vector<Field> fields;
  std::vector<GeometryUnit> units;
  std::vector<AttributeUnit> attributes;
  std::vector<u8> metadata;
  std::vector<int> skipped;  // types of units
  bool has_marks = false, has_normals = false;
  u64 num_edges = 0, num_groups = 0;
  u32 marks_crc = 0, normals_crc = 0;
  int normal_step = 0;
  Bytes marks_data, residual_data;
  std::vector<u8> marks;     // 8.4.2
  std::vector<i16> normals;  // 8.4.4, [groups, 3]
  std::vector<std::vector<std::vector<u8>>> values;  // by field and group
  std::vector<u8> level_shift;                       // by field and group, of `values`
  std::vector<u8> latents, network;                  // of 3DNTC, in the resident form
  texf_limits limits = {};

  virtual ~Asset() = default;  // of what is in truth a texf_asset
  bool chooses(size_t attribute) const { return chosen >> std::min<size_t>(attribute, 31) & 1; }
  int levels_left_out(size_t field) const { return std::min(lod, fields[field].depth()); }
  std::vector<u64> cells(size_t field, int shift) const;  // distinct key >> 3 * shift, ascending
};

// ---- stream.cpp
std::unique_ptr<Asset> read_stream(const u8* data, size_t size, const texf_limits& limits);  // steps 1 to 5 of 9.2
void decode_geometry(GeometryUnit& unit, int position_bits);                                // 5.6

// ---- draco.cpp: what stands behind the two counts of draco_data; UVs as the 32 bits that they are in Draco
void decode_draco(GeometryUnit& unit, Bytes data, bool by_valence);

std::unique_ptr<Asset> decode(const u8* data, size_t size, int lod, const texf_limits& limits, u32 chosen, int threads);  // 9.2, 8.3

// ---- surface.cpp
void count_samples(Asset& asset);                                                           // 10.1
std::vector<u64> active_voxels(const Asset& asset, size_t field, int resolution, int threshold, int threads);  // 6.1 to 6.4
std::vector<u64> referenced_texels(const Asset& asset, size_t field, int threads);                            // 6.5
void decode_marks(Asset& asset);                                                            // 8.4.2
void decode_normals(Asset& asset);                                                          // 8.4.3, 8.4.4
std::vector<std::vector<float>> shading_normals(const Asset& asset);                        // 8.4.1, of every unit's corners

// ---- values.cpp
struct Octree;  // 7.1
std::shared_ptr<Octree> octree_of(const std::vector<u64>& cells, int depth, bool planar);
std::vector<u8> decode_raht(const AttributeUnit& unit, Octree& octree, int lod, int threads);  // 7

class Network {  // 11
 public:
  explicit Network(const AttributeUnit& unit);  // needs the keys of its levels
  void answer(size_t field, const i64 position[3], i32* values);  // V of all components, 8 fractional bits
  static void centre(u64 key, int resolution, i64 position[3]);
  int outputs() const { return widths_.back(); }
  std::vector<u8> packed_rows() const;  // two codes a byte, the first in the low bits

 private:
  i64 row_of(size_t level, size_t field, const i64 at[3]) const;
  const AttributeUnit& unit_;
  std::vector<int> widths_;
  std::vector<std::vector<i32>> weights_, biases_;  // by layer
  std::vector<i8> rows_;                            // codes, row after row
  std::vector<std::vector<u64>> first_row_;         // by level and field
  std::vector<i32> in_, out_;
};
void decode_neural(Asset& asset);  // values of all fields and groups

}  // namespace texf

struct texf_asset : texf::Asset {
  std::string description;
  std::vector<std::vector<float>> corner_normals;
  std::vector<std::vector<texf::u64>> coarse_keys;
  std::vector<std::vector<texf::u8>> images;
};
