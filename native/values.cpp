// Clauses 7, attributes by RAHT, and 11, attributes by 3DNTC.
#include "core.hpp"

namespace texf {
namespace {

constexpr u32 NONE = 0xffffffff;
// Called by itself: engines of WebAssembly begin with slow code and take better code at the next call, never in the middle of one.
#define TEXF_OFTEN __attribute__((noinline))
// Of vectors: compiled twice where the loader chooses by the processor.
#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define TEXF_VECTORS __attribute__((noinline, target_clones("avx2", "default")))
#else
#define TEXF_VECTORS TEXF_OFTEN
#endif
#define TEXF_INLINE inline __attribute__((always_inline))  // vectors are not passed between code for different processors
constexpr i64 LARGEST = 1 << 22;

#if defined(__wasm_simd128__)
constexpr int LANES = 4;
#elif defined(__wasm__)
constexpr int LANES = 1;
#else
constexpr int LANES = 8;
#endif
typedef i32 Lanes __attribute__((vector_size(4 * LANES)));
typedef i32 Four __attribute__((vector_size(16)));
constexpr int REALS = LANES > 1 ? LANES / 2 : 1;
typedef double Reals __attribute__((vector_size(8 * REALS)));
typedef i32 Whole __attribute__((vector_size(4 * REALS)));

template <typename V>
TEXF_INLINE V loaded(const void* from) {
  V v;
  memcpy(&v, from, sizeof v);
  return v;
}
template <typename V>
TEXF_INLINE V absolute(V v) { return v < 0 ? -v : v; }
template <typename V>
TEXF_INLINE V least(V a, V b) { return a < b ? a : b; }

// ---- Small functions and tables of clause 7

const i64 STEP_TABLE[6] = {2580, 2896, 3251, 3649, 4096, 4598};
const u8 FALLOFF_TABLE[31] = {64, 64, 63, 62, 60, 58, 56, 53, 50, 47, 43, 40, 36, 33, 30, 27, 24, 21, 18, 16, 13, 11, 10, 8, 7, 6, 5, 4, 3, 2, 2};
const u16 SQUASH_TABLE[45] = {1,     2,     3,     5,     8,     13,    22,    36,    60,    98,    162,   267,   439,   720,   1179,
                              1921,  3108,  4971,  7812,  11955, 17625, 24743, 32768, 40793, 47911, 53581, 57724, 60565, 62428, 63615,
                              64357, 64816, 65097, 65269, 65374, 65438, 65476, 65500, 65514, 65523, 65528, 65531, 65533, 65534, 65535};

i64 step_of(int qp) { return STEP_TABLE[qp % 6] << (qp / 6); }
int half_of(i64 w) { return std::max(bit_length(u64(w)) - 1, 0) / 2; }
int sign_of(i64 a) { return a == 0 ? 0 : a > 0 ? 1 : 2; }

struct Tables {
  u16 squash[5633];   // by x + 2816
  i16 stretch[4096];
  u8 fine[97], classes[256];
  i16 learning[1522];  // 16 + 1536 // (16 + count)
  i32 refinement[24];
  Tables() {
    for (int x = 0; x < 5633; x++) squash[x] = u16((SQUASH_TABLE[x / 128] * (128 - x % 128) + SQUASH_TABLE[std::min(x / 128 + 1, 44)] * (x % 128) + 64) >> 7);
    for (int v = 0, x = 0; v < 4096; v++) {
      while (x < 5632 && squash[x] < 16 * v + 8) x++;
      stretch[v] = i16(x - 2816);
    }
    for (int v = 0; v < 97; v++) {
      fine[v] = 0;
      for (int entry : {1, 2, 4, 6, 8, 12, 16, 24, 36, 56, 96}) fine[v] += entry <= v;
    }
    for (int e = 0; e < 256; e++) classes[e] = e > 28 ? 6 : e > 12 ? 5 : e > 6 ? 4 : e > 3 ? 3 : e > 1 ? 2 : u8(e);
    for (int n = 0; n < 1522; n++) learning[n] = i16(16 + 1536 / (16 + n));
    for (int j = 0; j < 24; j++) refinement[j] = squash[std::min(256 * j, 5632)] << 6;
  }
};
const Tables tables;

const std::array<std::array<u32, 64 * 64>, 2> gains = [] {  // by half, and weights of 1 to 64
  std::array<std::array<u32, 64 * 64>, 2> g;
  for (int a = 1; a <= 64; a++)
    for (int b = 1; b <= 64; b++)
      for (int half = 0; half < 2; half++) g[half][64 * (a - 1) + b - 1] = u32(isqrt((i64(a + b) << (34 - half)) / (a * b)));
  return g;
}();

const std::array<u8, 256> counts = [] {
  std::array<u8, 256> t{};
  for (int mask = 1; mask < 256; mask++) t[mask] = u8(t[mask >> 1] + (mask & 1));
  return t;
}();
int ones(u32 mask) { return counts[mask]; }  // of eight bits

int fine(i64 v) { return tables.fine[v < 96 ? v : 96]; }
int class_of(i64 e) { return tables.classes[e < 255 ? e : 255]; }

// a // b in binary64: exact where b < 2^20 and the quotient's magnitude is below 2^24, since a + 1/2 is no nearer to a multiple of b
// than 1/2, 2^-21 of the quotient's unit, and all roundings together are below 2^-26.
i64 by_reciprocal(i64 a, double reciprocal) { return i64((double(a) + 0.5) * reciprocal + 16777216.0) - 16777216; }
i64 quotient(i64 a, i64 b) { return b < 1 << 20 && magnitude(a) < b << 23 ? by_reciprocal(a, 1.0 / double(b)) : floor_div(a, b); }

// ---- 7.6.4

// Whole numbers in binary64, where all of them are exact.
struct WeightSet {
  double weight[8];
  i32 bias = 0, count = 0;
  WeightSet() { std::fill(weight, weight + 8, 13107.0); }
  template <int m>
  TEXF_INLINE i32 output(const Reals* s) const {
    Reals sums = loaded<Reals>(weight) * s[0];
    for (int i = REALS; i < m; i += REALS) sums += loaded<Reals>(weight + i) * s[i / REALS];
    double sum = 256.0 * bias;
    for (int l = 0; l < REALS; l++) sum += sums[l];
    return i32(clip(-2816, 2816, i64(sum) >> 16));
  }
  template <int m>
  TEXF_INLINE void learn(const Reals* s, i32 y, int bit) {
    i32 error = (65536 * bit - tables.squash[y + 2816]) * tables.learning[count];
    double part = error / 1048576.0;
    const Reals most = Reals{} + 1048576.0;
    for (int i = 0; i < m; i += REALS) {
      Reals change = s[i / REALS] * part + 1.0 / 2097152, w = loaded<Reals>(weight + i) + ((change + 6755399441055744.0) - 6755399441055744.0);  // nearest, never a tie
      w = least<Reals>(w < -most ? -most : w, most);
      memcpy(weight + i, &w, sizeof w);
    }
    bias = i32(clip(-(1 << 20), 1 << 20, bias + ((256 * i64(error) + (1 << 19)) >> 20)));
    count = std::min(count + 1, 1521);
  }
};

class Mixer {  // contexts of several kinds of bits, each with its models, and what mixes them
 public:
  Mixer() = default;
  Mixer(std::initializer_list<std::initializer_list<u32>> sizes, size_t num_sets, size_t num_refinements)
      : sets_(num_sets), refinements_(num_refinements) {
    u32 sum = 0;
    int number = 0;
    for (const auto& kind : sizes) {
      int model = 0;
      for (u32 size : kind) {
        starts_[number][model++] = sum;
        sum += size;
      }
      number++;
    }
    contexts_.resize(sum);
    for (auto& set : refinements_) std::copy(tables.refinement, tables.refinement + 24, set.begin());
  }
  // numbers: the context of each of m models
  template <int m>
  TEXF_VECTORS int bit(RangeDecoder& decoder, int kind, const u32* numbers, u32 first, u32 second, u32 refinement) {
    Context* context[m];
    i32 stretched[8] = {};
    for (int i = 0; i < m; i++) {
      context[i] = &contexts_[starts_[kind][i] + numbers[i]];
      stretched[i] = tables.stretch[(context[i]->fast + context[i]->slow()) >> 11];
    }
    Reals s[8 / REALS];
    for (int i = 0; i < 8; i += REALS) s[i / REALS] = __builtin_convertvector(loaded<Whole>(stretched + i), Reals);
    WeightSet &a = sets_[first], &b = sets_[second];
    i32 x1 = a.output<m>(s), x2 = b.output<m>(s), x = ((x1 + x2) >> 1) + 2816;
    i32* entry = &refinements_[refinement][x >> 8];
    i64 r = x & 255, refined = (entry[0] * (256 - r) + entry[1] * r) >> 14;
    int bit = decoder.likely(u32(clip(8, 65528, (tables.squash[x] + refined) >> 1)));
    a.learn<m>(s, x1, bit);
    b.learn<m>(s, x2, bit);
    for (int i = 0; i < m; i++) context[i]->template adapt<4>(bit);
    entry += r >= 128;
    *entry += (bit * ((1 << 22) - 1) - *entry) >> 6;
    return bit;
  }
  template <int most = 8>
  int bit_of(int m, RangeDecoder& decoder, int kind, const u32* numbers, u32 first, u32 second, u32 refinement) {
    if constexpr (most > 1)
      if (m < most) return bit_of<most - 1>(m, decoder, kind, numbers, first, second, refinement);
    return bit<most>(decoder, kind, numbers, first, second, refinement);
  }

 private:
  u32 starts_[4][8];  // by kind and model
  std::vector<Context> contexts_;
  std::vector<WeightSet> sets_;
  std::vector<std::array<i32, 24>> refinements_;
};

enum { FLAG, ZERO, MORE, SIGN };             // 7.5.5
enum { COUNT = 0 };                          // in 7.11.4 in place of FLAG
enum { SIZE = 0, RESIDUAL_SIGN = 1 };        // 7.9

struct DctBlock {
  int count[3];
  i8 q[3][64];                      // limited to -127..127
};

struct SliceState {  // what a range is decoded with
  RangeDecoder decoder;
  std::vector<Context> direct, quiet;
  Mixer mixed, dct;
  std::vector<DctBlock> blocks;
};

// ---- 7.1. Of the neighbours (x, y, z) of a node number (z + 1) * 9 + (y + 1) * 3 + x + 1 stands in its row, or without z over texels

struct Level {
  size_t nodes = 0;
  Array<u32> first_child, parent, weight;  // parent, weight: not of voxels and texels
  Array<u8> children;                // a bit for every octant
  Array<u8> cell;                    // of texels alone: 8 * y + x in the square of 8 x 8
  Array<u32> rows;                   // neighbours of every node, once they are asked for
  // of the attribute that is decoded
  std::vector<u8> energy;            // two planes
  Array<i32> mean;                   // [nodes, components]
  Array<i8> q;                       // 7.11.2: q[1], q[3], q[4] of every component, limited to -2..2
  std::vector<u32> dct;              // 7.11.4: the number of the node's DCT block
  std::vector<u8> known;             // below one
  size_t count() const { return nodes; }
  u32 child(u32 node, int octant) const {
    return children[node] >> octant & 1 ? first_child[node] + ones(children[node] & ((1u << octant) - 1)) : NONE;
  }
};

struct Touch {
  u8 octant, steps;
};

struct Shape {  // what depends on the support alone
  int row, axes;
  int reach, side;  // places: -reach .. reach + 1 on every axis around a node's first child
  struct Direction {
    i8 x, y, z;
    u8 nonzero, facing;             // facing: children of the neighbour that touch the node
    u8 octants;                     // of the node that the neighbour's axes lead to
    u8 touches[8];                  // by child of the neighbour: how many there are of
    Touch touch[8][4];              // children of the node that it touches
  };
  Direction direction[27];
  u8 place[27][8];  // by direction and octant there
  u8 inside[27];    // octants of the places
  u8 own[8];        // the place of an own child
  int step[27];     // from a place to the one in that direction

  explicit Shape(bool planar) : row(planar ? 9 : 27), axes(planar ? 2 : 3), reach(planar ? 2 : 1), side(2 + 2 * reach) {
    const int strides[3] = {1, side, planar ? 0 : side * side};
    for (int octant = 0; octant < 8; octant++) {
      own[octant] = 0;
      for (int axis = 0; axis < axes; axis++) own[octant] += u8((reach + (octant >> axis & 1)) * strides[axis]);
    }
    for (int n = 0; n < row; n++) {
      Direction& d = direction[n];
      d = {i8(n % 3 - 1), i8(n / 3 % 3 - 1), i8(planar ? 0 : n / 9 - 1), 0, 0, 0, {}, {}};
      int at[3] = {d.x, d.y, d.z};
      for (int v : at) d.nonzero += v != 0;
      for (int octant = 0; octant < 8; octant++) {
        bool toward = true;
        for (int axis = 0; axis < 3; axis++) toward = toward && (at[axis] == 0 || (octant >> axis & 1) == (at[axis] > 0));
        d.octants |= toward << octant;
      }
      for (int child = 0; child < 8 && d.nonzero > 0; child++) {  // of the neighbour
        int count = 0;
        for (int octant = 0; octant < 8; octant++) {
          int steps = 0;
          bool touching = true;
          for (int axis = 0; axis < 3; axis++) {
            int away = std::abs(2 * at[axis] + (child >> axis & 1) - (octant >> axis & 1));
            touching = touching && away < 2;
            steps += away;
          }
          if (touching) d.touch[child][count++] = {u8(octant), u8(steps)};
        }
        d.touches[child] = u8(count);
        d.facing |= (count > 0) << child;
      }
      step[n] = d.x + side * d.y + strides[2] * d.z;
      inside[n] = 0;
      for (int octant = 0; octant < 8; octant++) {
        bool here = octant < 1 << axes;
        int to = own[0];
        for (int axis = 0; axis < axes; axis++) {
          int v = 2 * at[axis] + (octant >> axis & 1);
          here = here && v >= -reach && v <= reach + 1;
          to += v * strides[axis];
        }
        place[n][octant] = here ? u8(to) : 64;
        inside[n] |= here << octant;
      }
    }
  }
  int self() const { return row / 2; }
};

}  // namespace

struct Octree {
  Shape shape;
  std::vector<Level> levels;
  Array<i32> squares = {};  // means of texels while they are filtered
};

std::shared_ptr<Octree> octree_of(const std::vector<u64>& keys, int depth, bool planar) {
  auto octree = std::make_shared<Octree>(Octree{Shape(planar), std::vector<Level>(depth + 1)});
  std::vector<Level>& levels = octree->levels;
  levels[depth].nodes = keys.size();
  if (planar) {
    levels[depth].cell.resize(keys.size());
    for (size_t n = 0; n < keys.size(); n++)
      levels[depth].cell[n] = u8((keys[n] & 1) | (keys[n] >> 2 & 2) | (keys[n] >> 4 & 4) | (keys[n] << 2 & 8) | (keys[n] & 16) | (keys[n] >> 2 & 32));
  }
  std::vector<u64> above;
  for (int l = depth; l > 0; l--) {
    Level &lower = levels[l], &upper = levels[l - 1];
    const std::vector<u64>& of = l == depth ? keys : above;
    for (size_t n = 1; n < of.size(); n++) upper.nodes += of[n] >> 3 != of[n - 1] >> 3;
    upper.nodes += !of.empty();
    if (l < depth) lower.parent.resize(lower.nodes);
    upper.first_child.resize(upper.nodes);
    upper.weight.resize(upper.nodes);
    upper.children.resize(upper.nodes);
    if (l == depth) above.resize(upper.nodes);
    u32 p = 0;
    for (size_t n = 0; n < lower.nodes; p++) {
      u64 key = of[n] >> 3;
      u32 weight = 0, children = 0;
      upper.first_child[p] = u32(n);
      for (; n < lower.nodes && of[n] >> 3 == key; n++) {
        children |= 1 << (of[n] & 7);
        weight += l < depth ? lower.weight[n] : 1;
        if (l < depth) lower.parent[n] = p;
      }
      upper.weight[p] = weight;
      upper.children[p] = u8(children);
      above[p] = key;  // of those that are read
    }
    above.resize(p);
  }
  levels[0].rows.assign(octree->shape.row, NONE);
  levels[0].rows[octree->shape.self()] = 0;
  return octree;
}

namespace {

// Rows of the neighbours of all nodes of a level from those of its parents.
void find_neighbours(const Level& upper, const Shape& shape, Level& level, int threads) {
  level.rows.resize(level.count() * shape.row);
  by_pieces(threads, upper.count(), [&](size_t first, size_t end) {
    u32 around[64];  // by place
    for (size_t p = first; p < end; p++) {
      const u32* row = &upper.rows[p * shape.row];
      u32* to = &level.rows[size_t(upper.first_child[p]) * shape.row];
      std::fill(around, around + 64, NONE);
      for (int n = 0; n < shape.row; n++) {
        if (row[n] == NONE) continue;
        for (int left = upper.children[row[n]] & shape.inside[n]; left; left &= left - 1) {
          int octant = __builtin_ctz(left);
          around[shape.place[n][octant]] = upper.child(row[n], octant);
        }
      }
      for (int left = upper.children[p]; left; left &= left - 1) {
        const u32* own = around + shape.own[__builtin_ctz(left)];
        for (int n = 0; n < shape.row; n++) *to++ = own[shape.step[n]];
      }
    }
  });
}

// ---- 7.2 to 7.6

struct Range {
  u32 first, end;
};

template <int components>
struct Block {
  u32 node = 0;
  int mask = 0, splits = 0;         // octants; number of splits
  i32 W[15] = {};
  i32 predicted[components][8] = {};  // by octant
  i32 acc_shift[components] = {};   // shift of 7.5.5
  i32 q[components][7] = {};
  int energy[2] = {0, 0}, flag[2] = {0, 0};
  u32 near[2] = {0, 0}, far[2], near_weight = 0, far_weight = 3;  // 7.5.1
  int num_around = 0;
  i32 around[82][components];       // means less the node's own of 7.4.4's surroundings
  bool is_split(int n) const { return W[2 * n + 1] > 0 && W[2 * n + 2] > 0; }
};

struct Plane {  // what the contexts of a plane know
  int k, c0, c1, near_class, far_class, strength, near2, far2, own, around, earlier, rough, active, peak, b, luma2, near_exists, h;
  bool quiet, activity;             // activity: rough to peak are there
  int expected[3][7], down[3][7];   // -1 before they are asked
};

template <int components_>
class Raht {
  using Block = texf::Block<components_>;

 public:
  Raht(const AttributeUnit& unit, Octree& octree, int threads)
      : unit_(unit), shape_(octree.shape), models_(unit.num_models), threads_(threads), levels_(octree.levels), squares_(octree.squares) {
    for (Level& level : levels_) {
      level.mean.resize(level.count() * components_);
      if (&level != &levels_.back()) level.energy.assign(2 * level.count(), 0);
      level.q.clear();
      level.dct.clear();
      level.known.clear();
    }
    for (int c = 0; c < components_; c++) {
      step_[c] = step_of(unit.qp[c]);
      inverse_[c] = (1ll << 32) / step_[c];
    }
    // sums of differences that classes 1 to 4 of 7.7 begin with, by neighbour
    for (int class_ = 1; class_ < 5; class_++) least_[class_ - 1] = i32(ceil_div(2ll << (class_ + 28), inverse_[0]));
    for (int n = 0; n < shape_.row; n++)
      for (int octant = 0; octant < 8; octant++) {
        const Shape::Direction& d = shape_.direction[n];
        for (int i = 0; i < d.touches[octant]; i++) kernels_[n][octant][d.touch[octant][i].octant] = unit.kernel[3 + d.touch[octant][i].steps];
        if (d.nonzero > 0 && d.octants >> octant & 1) kernels_[n][8][octant] = unit.kernel[d.nonzero];
      }
    if (unit.colour_range > 0) falloff_inverse_ = (1ll << 32) / (unit.colour_range * step_[0]);
  }

  std::vector<u8> decode(int lod) {
    int depth = unit_.depth, last = depth - lod;
    std::copy(unit_.root_mean, unit_.root_mean + components_, levels_[0].mean.begin());
    std::vector<SliceState> states;
    if (depth > 0) states.push_back(fresh_state(unit_.codewords[0]));
    if (unit_.slice_level > 0)
      require(unit_.slice_first.back() < levels_[unit_.slice_level].count(), S12, "a slice begins past the last node of its level");
    std::vector<Range> ranges{{0, 1}};
    for (d_ = 0; d_ < last; d_++) {
      if (levels_[d_].rows.empty()) find_neighbours(levels_[d_ - 1], shape_, levels_[d_], threads_);
      rows_ = levels_[d_].rows.data();
      if (unit_.slice_level == 0 || d_ < unit_.slice_level) {
        ranges = {{0, u32(levels_[d_].count())}};
      } else if (d_ == unit_.slice_level) {
        ranges.clear();
        for (size_t s = 0; s < unit_.slice_first.size(); s++) {
          bool final = s + 1 == unit_.slice_first.size();
          ranges.push_back({u32(unit_.slice_first[s]), final ? u32(levels_[d_].count()) : u32(unit_.slice_first[s + 1])});
          states.push_back(states[0]);
          states.back().decoder = RangeDecoder(unit_.codewords[s + 1].data, unit_.codewords[s + 1].size);
        }
        states.erase(states.begin());
      } else {
        ranges = ranges_below(ranges, levels_[d_ - 1]);
      }
      level_ = &levels_[d_];
      lower_ = &levels_[d_ + 1];
      upper_ = d_ > 0 ? &levels_[d_ - 1] : nullptr;
      level_class_ = std::min(depth - 1 - d_, 3);
      std::vector<u8> above(2 * level_->count(), 0);
      above_ = above.data();
      for (u32 node = 0; node < level_->count() && upper_; node++) memcpy(&above[2 * size_t(node)], &upper_->energy[2 * size_t(level_->parent[node])], 2);
      if (unit_.planar && models_ > 0) level_->q.assign(level_->count() * components_ * 3, 0);
      if (unit_.dct_blocks && depth - d_ == 3) prepare_dct();
      side_by_side(threads_, ranges.size(), [&](size_t s) { Raht(*this).decode_range(ranges[s], states[s]); });
    }
    Level& level = levels_[last];
    if (lod == 0 && depth > 0) filter(level);
    std::vector<u8> values = values_of(level);
    if (lod == 0 && unit_.residual > 0) {
      ranges = ranges_below(ranges, levels_[depth - 1]);
      std::vector<u8> x = values;
      std::vector<i16> k(values.size(), 0);
      side_by_side(threads_, ranges.size(), [&](size_t s) { residuals(ranges[s], states[s].decoder, x, values, k); });
    }
    return values;
  }

 private:
  SliceState fresh_state(Bytes codeword) const {
    SliceState state;
    state.decoder = RangeDecoder(codeword.data, codeword.size);
    if (models_ == 0) {
      state.direct.resize(4725);
      return state;
    }
    state.quiet.resize(256);
    state.mixed = Mixer({{2352, 1344, 4608, 3072, 2304, 2304, 2304, 5376},
                         {2268, 5292, 1296, 2304, 1728, 1512, 1296, 5103},
                         {945, 2160, 1728, 1260, 1728, 1080, 10935, 540},
                         {288, 567, 126, 648}}, 224, 139);
    if (unit_.dct_blocks)
      state.dct = Mixer({{12288, 12288, 27648, 12288},
                         {12288, 2304, 5184, 5184, 2304, 5184},
                         {2880, 6480, 6480, 2160, 6480},
                         {1728, 2028, 1728, 2496}}, 873, 621);
    return state;
  }

  static std::vector<Range> ranges_below(const std::vector<Range>& ranges, const Level& upper) {
    std::vector<Range> out;
    for (Range range : ranges)
      out.push_back({upper.first_child[range.first], upper.first_child[range.end - 1] + u32(ones(upper.children[range.end - 1]))});
    return out;
  }

  const u32* row_of(u32 node) const { return &rows_[size_t(node) * shape_.row]; }
  u32 neighbour(u32 node, int x, int y, int z) const { return row_of(node)[shape_.self() + x + 3 * y + 9 * z]; }
  const i32* mean_of(const Level& level, u32 node) const { return &level.mean[size_t(node) * components_]; }
  int above(u32 node, int k) const { return above_[2 * size_t(node) + k]; }
  i64 sixteenths(i64 v, int c) const { return (magnitude(v) * inverse_[c]) >> 28; }

  void decode_range(Range range, SliceState& state) {
    range_ = range;
    state_ = &state;
    if (unit_.dct_blocks && unit_.depth - d_ == 3) decode_dct_blocks();
    for (u32 node = range.first; node < range.end; node++) {
      if (node % 1024 == 0) check_stop();
      if (!level_->known.empty() && level_->known[node]) continue;
      int mask = level_->children[node];
      if (mask & (mask - 1)) {
        decode_block(node, mask);
      } else {
        for (int k = 0; k < 2; k++) level_->energy[2 * size_t(node) + k] = u8(above(node, k));
        std::copy_n(mean_of(*level_, node), components_, &lower_->mean[size_t(level_->first_child[node]) * components_]);
      }
    }
  }

  TEXF_OFTEN void decode_block(u32 node, int mask) {
    Block block;
    block.node = node;
    block.mask = mask;
    u32 child = level_->first_child[node];
    for (int left = mask; left; left &= left - 1) block.W[7 + __builtin_ctz(left)] = lower_->weight.empty() ? 1 : i32(lower_->weight[child++]);
    for (int n = 6; n >= 0; n--) block.W[n] = block.W[2 * n + 1] + block.W[2 * n + 2];
    block.splits = ones(mask) - 1;
    predict(block);
    const i64 half = block.W[0];
    const double reciprocal = 0.5 / double(half);
    for (int k = 0; k < (components_ > 1 ? 2 : 1); k++) {
      int c0 = k == 0 ? 0 : 1, c1 = k == 0 ? 1 : components_;
      if (k == 1 && unit_.component_cross > 0 && block.flag[0]) follow(block);
      for (int c = c0; c < c1; c++) {
        i64 acc = block.W[0];
        for (int left = mask; left; left &= left - 1) acc += 2 * i64(block.W[7 + __builtin_ctz(left)]) * block.predicted[c][__builtin_ctz(left)];
        block.acc_shift[c] = i32(half < 1 << 19 ? by_reciprocal(acc, reciprocal) : floor_div(acc, 2 * half));
      }
      parse_plane(block, k, c0, c1);
      if (!block.flag[k]) continue;
      i64 total = 0;
      for (int c = c0; c < c1; c++)
        for (int n = 0; n < 7; n++) total += magnitude(block.q[c][n]);
      block.energy[k] = int(std::min<i64>(255, 16 * total / (block.splits * (c1 - c0))));
    }
    for (int k = 0; k < 2; k++) level_->energy[2 * size_t(node) + k] = u8(block.energy[k]);
    if (!level_->q.empty())
      for (int c = 0; c < components_; c++)
        for (int i = 0; i < 3; i++) level_->q[(size_t(node) * components_ + c) * 3 + i] = i8(clip(-2, 2, block.q[c][i == 0 ? 1 : i + 2]));
    const i32* own = mean_of(*level_, node);
    for (int c = 0; c < components_; c++) {
      i32 v[15];
      if (block.flag[c > 0]) spread(block, c, own[c] - block.acc_shift[c], v);
      else std::fill(v + 7, v + 15, own[c] - block.acc_shift[c]);
      i32* to = &lower_->mean[size_t(level_->first_child[node]) * components_ + c];
      for (int left = mask; left; left &= left - 1) {
        int octant = __builtin_ctz(left);
        *to = i32(clip(-LARGEST, LARGEST, v[7 + octant] + block.predicted[c][octant]));
        to += components_;
      }
    }
  }

  // ---- 7.3

  bool decoded(u32 other, u32 node) const { return other >= range_.first && other < node; }

  // 7.3 and, in passing, what 7.4.4 and 7.5.1 find around a block
  TEXF_VECTORS void predict(Block& block) const {
    if (unit_.planar) predict_octants<4>(block);
    else predict_octants<8>(block);
  }

  template <int octants>
  TEXF_INLINE void predict_octants(Block& block) const {
    constexpr int vectors = octants / REALS;
    const i32* own = mean_of(*level_, block.node);
    Reals total[vectors], sum[components_][vectors] = {};  // by octant, of differences from the node's own mean: whole numbers below 2^53
    for (Reals& t : total) t = Reals{} + 64.0 * unit_.kernel[0];
    for (int k = 0; k < 2; k++) block.far[k] = 3 * above(block.node, k);
    auto add = [&](const i32* mean, const double* kernel) __attribute__((always_inline)) {
      i32 *delta = block.around[block.num_around++], difference = 0;
      for (int c = 0; c < components_; c++) difference += std::abs(delta[c] = mean[c] - own[c]);
      double falloff = falloff_inverse_ == 0 ? 64 : FALLOFF_TABLE[std::min<i64>(30, (difference * falloff_inverse_) >> 28)];
      for (int i = 0; i < vectors; i++) {
        Reals w = loaded<Reals>(kernel + i * REALS) * falloff;
        total[i] += w;
        for (int c = 0; c < components_; c++) sum[c][i] += w * double(delta[c]);
      }
    };
    const u32* row = row_of(block.node);
    for (int n = 0; n < (octants == 4 ? 9 : 27); n++) {
      u32 other = row[n];
      if (other == NONE || other == block.node) continue;
      const Shape::Direction& d = shape_.direction[n];
      bool before = decoded(other, block.node);
      if (d.nonzero < 3) {
        u32 w = 3 - d.nonzero;
        const u8* energy = (before ? level_->energy.data() : above_) + 2 * size_t(other);
        for (int k = 0; k < 2; k++) (before ? block.near : block.far)[k] += w * energy[k];
        (before ? block.near_weight : block.far_weight) += w;
      }
      if (!before) {
        add(mean_of(*level_, other), kernels_[n][8]);
        continue;
      }
      int children = level_->children[other];
      for (int left = children & d.facing; left; left &= left - 1) {
        int octant = __builtin_ctz(left);
        add(mean_of(*lower_, level_->first_child[other] + ones(children & ((1u << octant) - 1))), kernels_[n][octant]);
      }
    }
    for (int i = 0; i < vectors; i++) {
      Reals reciprocal = 1.0 / (2.0 * total[i]);
      for (int c = 0; c < components_; c++) {  // as by_reciprocal()
        Whole shift = __builtin_convertvector((2.0 * sum[c][i] + total[i] + 0.5) * reciprocal + 16777216.0, Whole) - (16777216 - own[c]);
        memcpy(&block.predicted[c][i * REALS], &shift, sizeof shift);
      }
    }
  }

  // ---- 7.4

  i64 gain(i64 w1, i64 w2, int half) const {
    if (w1 <= 64 && w2 <= 64) return gains[half][64 * (w1 - 1) + w2 - 1];
    return isqrt(((w1 + w2) << (34 - half)) / (w1 * w2));
  }

  void spread(const Block& block, int c, i32 mean, i32* v) const {
    v[0] = mean;
    bool square = unit_.planar_transform && block.is_split(3) && block.is_split(4);
    for (int n = 0; n < 7; n++) {
      i32 w1 = block.W[2 * n + 1], w2 = block.W[2 * n + 2];
      if (w1 == 0 || w2 == 0) {
        v[2 * n + 1] = v[2 * n + 2] = block.W[n] > 0 ? v[n] : 0;
        continue;
      }
      i32 q = block.q[c][n];
      if (square && n == 3) q = block.q[c][3] - block.q[c][4];
      if (square && n == 4) q = block.q[c][3] + block.q[c][4];
      if (q == 0) {
        v[2 * n + 1] = v[2 * n + 2] = v[n];
        continue;
      }
      i64 d = std::min(LARGEST - 1, (std::min(magnitude(q), LARGEST - 1) * step_[c] * gain(w1, w2, square && n > 2) + (1 << 16)) >> 17);
      if (q < 0) d = -d;
      v[2 * n + 1] = v[n] - i32(w1 == w2 ? (d + 1) >> 1 : floor_div(2 * w2 * d + w1 + w2, 2 * (i64(w1) + w2)));
      v[2 * n + 2] = v[2 * n + 1] + i32(d);
    }
  }

  void follow(Block& block) const {  // 7.4.4
    i64 sums[components_] = {};
    i32 detail[15];
    for (int n = 0; n < block.num_around; n++)
      for (int c = 0; c < components_; c++) sums[c] += i64(block.around[n][0]) * block.around[n][c];
    i64 spread_of = sums[0] + ((step_[0] * step_[0]) >> 2);
    spread(block, 0, 0, detail);
    for (int c = 1; c < components_; c++) {
      i64 factor = clip(-512, 512, floor_div(16 * unit_.component_cross * sums[c], spread_of));
      for (int left = block.mask; left; left &= left - 1) {
        int octant = __builtin_ctz(left);
        i32& predicted = block.predicted[c][octant];
        predicted = i32(clip(-LARGEST, LARGEST, predicted + ((factor * detail[7 + octant] + 128) >> 8)));
      }
    }
  }

  // ---- 7.5

  Plane plane_of(const Block& block, int k, int c0, int c1) const {
    Plane p;
    p.k = k;
    p.c0 = c0;
    p.c1 = c1;
    p.activity = false;
    u32 near = block.near[k], far = block.far[k], near_weight = block.near_weight, far_weight = block.far_weight;
    p.near_class = near_weight > 0 ? class_of((near + near_weight - 1) / near_weight) : 0;
    p.far_class = class_of((far + far_weight - 1) / far_weight);
    p.strength = std::max(p.near_class, p.far_class);
    p.quiet = near == 0 && far == 0;
    p.near_exists = near_weight > 0;
    p.near2 = near_weight > 0 ? fine((2 * near + near_weight - 1) / near_weight) : 0;
    p.far2 = fine((2 * far + far_weight - 1) / far_weight);
    p.own = fine(2 * above(block.node, k));
    p.b = 2 * k + (k == 1 ? block.flag[0] : 0);
    p.luma2 = k == 1 ? std::min(class_of(block.energy[0]), 5) : 0;
    return p;
  }

  void find_activity(const Block& block, Plane& p) const {  // 7.5.5
    const i32* own = mean_of(*level_, block.node);
    i64 variation = 0, sum = 0, largest = 0;
    int faces = 0, scale = 1;
    p.earlier = 0;
    for (int axis = 0; axis < shape_.axes; axis++, scale *= 4)
      for (int side = -1; side < 2; side += 2) {
        u32 other = row_of(block.node)[shape_.self() + side * (axis == 0 ? 1 : axis == 1 ? 3 : 9)];
        if (other == NONE) continue;
        faces++;
        for (int c = p.c0; c < p.c1; c++) variation += std::abs(mean_of(*level_, other)[c] - own[c]);
        if (side > 0 || other < range_.first) continue;
        int energy = level_->energy[2 * size_t(other) + p.k];
        p.earlier += scale * (energy == 0 ? 1 : energy < 8 ? 2 : 3);
      }
    for (int octant = 0; octant < 8; octant++)
      for (int c = p.c0; c < p.c1 && block.mask >> octant & 1; c++) {
        i64 deviation = std::abs(block.predicted[c][octant] - block.acc_shift[c]);
        sum += deviation;
        largest = std::max(largest, deviation);
      }
    int count = p.c1 - p.c0;
    p.h = half_of(block.W[0] >> 2);
    p.around = faces + (p.near_exists ? 8 : 0);
    p.rough = fine(sixteenths(variation << p.h, p.c0) / (std::max(faces, 1) * count));
    p.active = fine(sixteenths(sum << (p.h + 1), p.c0) / ((block.splits + 1) * count));
    p.peak = fine(sixteenths(largest << p.h, p.c0));
    for (int c = p.c0; c < p.c1; c++) std::fill(p.expected[c], p.expected[c] + 7, -1);
    p.activity = true;
  }

  i64 predicted_mean(const Block& block, int i, int c) const {  // Pm
    int first = i < 3 ? (i - 1) * 4 : i < 7 ? (i - 3) * 2 : i - 7, count = i < 3 ? 4 : i < 7 ? 2 : 1;
    i64 sum = 0;
    for (int octant = first; octant < first + count; octant++) sum += i64(block.W[7 + octant]) * block.predicted[c][octant];
    return quotient(sum, block.W[i]);
  }
  i64 slope(const Block& block, int c, int n) const {
    i64 rise = predicted_mean(block, 2 * n + 2, c) - predicted_mean(block, 2 * n + 1, c);
    return rise * (1ll << half_of(std::min(block.W[2 * n + 1], block.W[2 * n + 2])));
  }
  void expect(const Block& block, Plane& p, int c, int n) const {
    if (p.expected[c][n] >= 0) return;
    i64 steepness = slope(block, c, n);
    if (unit_.planar_transform && n > 2 && block.is_split(3) && block.is_split(4)) {
      i64 s3 = slope(block, c, 3), s4 = slope(block, c, 4);
      steepness = (181 * (n == 3 ? s4 + s3 : s4 - s3)) >> 8;
    }
    p.expected[c][n] = fine(sixteenths(steepness, c));
    p.down[c][n] = steepness < 0;
  }

  struct Beside {  // 7.11.2: q of the nodes around a block, by component
    const i8 *west, *north, *corner[3], *above;
  };
  Beside beside(u32 node) const {
    static const i8 nothing[3 * components_] = {};
    auto of = [&](int x, int y) {
      u32 other = neighbour(node, x, y, 0);
      return other != NONE && decoded(other, node) ? &level_->q[size_t(other) * components_ * 3] : nothing;
    };
    return {of(-1, 0), of(0, -1), {of(-1, -1), of(1, -1), of(-1, 1)}, upper_ ? &upper_->q[size_t(level_->parent[node]) * components_ * 3] : nothing};
  }

  int flag_bit(const Block& block, Plane& p) {
    u32 L = level_class_, size = std::min(block.splits, 3) - 1, near = p.near_class, far = p.far_class, b = p.b;
    if (models_ == 0) {
      u32 flag = p.k == 1 ? block.flag[0] : 0;
      return state_->decoder.bit(state_->direct[((((p.k * 4 + L) * 3 + size) * 2 + flag) * 7 + near) * 7 + far]);
    }
    if (p.quiet) return state_->decoder.bit<5>(state_->quiet[((b * 4 + L) * 8 + block.splits) * 2 + p.near_exists]);
    find_activity(block, p);
    u32 numbers[8] = {
        (((b * 4 + L) * 3 + size) * 7 + near) * 7 + far,
        ((b * 4 + L) * 12 + p.active) * 7 + near,
        ((b * 12 + p.far2) * 12 + p.near2) * 8 + block.splits,
        ((b * 4 + L) * 64 + p.earlier) * 3 + size,
        ((b * 4 + L) * 12 + p.rough) * 12 + p.active,
        ((b * 12 + p.own) * 8 + block.splits) * 6 + p.luma2,
        ((b * 4 + L) * 12 + p.peak) * 12 + p.far2,
        ((b * 16 + p.around) * 12 + p.active) * 7 + near,
    };
    return state_->mixed.bit_of(models_, state_->decoder, FLAG, numbers, (p.k * 4 + L) * 2 + b % 2, 100 + b * 7 + near, b * 7 + far);
  }

  struct At {
    u32 c, n, stage, ones, large, luma, left, alike, alike_signs;
  };

  int zero_bit(const Block& block, Plane& p, const At& at) {
    u32 c = at.c, L = level_class_, st = p.strength, z = std::min(at.ones, 2u), l = std::min(at.luma, 2u), l3 = std::min(at.luma, 3u);
    if (models_ == 0) return state_->decoder.bit(state_->direct[2352 + ((((c * 4 + L) * 3 + at.stage) * 3 + z) * 7 + st) * 3 + l]);
    expect(block, p, c, at.n);
    u32 e = p.expected[c][at.n];
    u32 numbers[8] = {
        ((((c * 4 + L) * 3 + at.stage) * 3 + z) * 7 + st) * 3 + l,
        (((c * 7 + at.n) * 12 + e) * 3 + z) * 7 + p.near_class,
        ((c * 12 + p.far2) * 12 + p.near2) * 3 + z,
        (((c * 8 + block.splits) * 8 + std::min(at.left, 7u)) * 3 + z) * 4 + L,
        ((c * 12 + p.active) * 12 + e) * 4 + L,
        (((c * 4 + l3) * 6 + p.luma2) * 7 + at.n) * 3 + z,
        ((c * 12 + p.rough) * 12 + p.active) * 3 + z,
        unit_.planar ? ((c * 7 + at.n) * 81 + at.alike) * 3 + z : ((c * 4 + L) * 16 + p.around) * 12 + e,
    };
    return state_->mixed.bit_of(models_, state_->decoder, ZERO, numbers, 16 + (c * 4 + L) * 3 + z, 128 + (c * 3 + at.stage) * 7 + st,
                             28 + (c * 3 + z) * 7 + st);
  }

  int sign_bit(const Block& block, Plane& p, const At& at) {
    if (models_ == 0) return state_->decoder.bypass();
    expect(block, p, at.c, at.n);
    u32 c = at.c, e = p.expected[c][at.n], down = p.down[c][at.n];
    u32 s0 = c > 0 ? sign_of(block.q[0][at.n]) : 0, s1 = c > 1 ? sign_of(block.q[components_ > 1][at.n]) : 0;
    u32 numbers[4] = {
        ((c * 2 + down) * 12 + e) * 4 + level_class_,
        unit_.planar ? ((c * 7 + at.n) * 9 + at.alike_signs) * 3 + s0 : (c * 3 + s0) * 3 + s1,
        ((c * 7 + at.n) * 3 + s0) * 2 + down,
        (((c * 3 + s0) * 3 + s1) * 2 + down) * 12 + e,
    };
    return state_->mixed.template bit_of<4>(std::min(models_, 4), state_->decoder, SIGN, numbers, 97 + c, 212 + e, 136 + c);
  }

  int more_bit(const Plane& p, const At& at, u32 i) {
    u32 c = at.c, st = p.strength, g = std::min(at.large, 2u), L = level_class_, i3 = std::min(i, 3u), l3 = std::min(at.luma, 3u);
    if (models_ == 0) return state_->decoder.bit(state_->direct[i == 0 ? 4620 + (c * 7 + st) * 3 + g : 4683 + c * 14 + std::min(i - 1, 13u)]);
    u32 e = p.expected[c][at.n];
    u32 numbers[8] = {
        ((c * 15 + i) * 7 + st) * 3 + g,
        ((c * 15 + i) * 12 + e) * 4 + L,
        ((c * 4 + i3) * 12 + p.far2) * 12 + p.near2,
        ((c * 15 + i) * 7 + at.n) * 4 + l3,
        ((c * 4 + i3) * 12 + p.active) * 12 + p.rough,
        ((c * 15 + i) * 6 + p.luma2) * 4 + l3,
        unit_.planar ? ((c * 15 + i) * 3 + (at.n >> 1)) * 81 + at.alike : (c * 15 + i) * 16 + p.around,
        ((c * 15 + i) * 4 + L) * 3 + g,
    };
    return state_->mixed.bit_of(models_, state_->decoder, MORE, numbers, 52 + c * 15 + i, 191 + c * 7 + st, 91 + c * 15 + i);
  }

  void parse_plane(Block& block, int k, int c0, int c1) {
    Plane p = plane_of(block, k, c0, c1);
    block.flag[k] = flag_bit(block, p);
    if (!block.flag[k]) return;
    if (models_ > 0 && !p.activity) find_activity(block, p);
    Beside around{};
    if (unit_.planar && models_ > 0) around = beside(block.node);
    At at{};
    at.left = block.splits * (c1 - c0);
    bool some = false;
    for (int c = c0; c < c1; c++) {
      at.c = c;
      at.ones = at.large = 0;
      for (int n = 0; n < 7; n++) {
        if (!block.is_split(n)) continue;
        at.n = n;
        at.left--;
        at.stage = n == 0 ? 0 : n < 3 ? 1 : 2;
        at.luma = c > 0 ? u32(std::min(std::abs(block.q[0][n]), 3)) : 0;
        if (unit_.planar && models_ > 0) {
          int i = 3 * c + (n == 1 ? 0 : n - 2), corners = 0;
          for (const i8* corner : around.corner) corners += std::abs(corner[i]);
          at.alike = 27 * std::abs(around.west[i]) + 9 * std::abs(around.north[i]) + 3 * std::min(corners, 2) + std::abs(around.above[i]);
          at.alike_signs = 3 * sign_of(around.west[i]) + sign_of(around.north[i]);
        }
        if ((at.left > 0 || some) && !zero_bit(block, p, at)) continue;
        int negative = sign_bit(block, p, at);
        i64 magnitude = 1;
        u32 i = 0;
        for (; i < 15 && more_bit(p, at, i); i++) magnitude++;
        if (i == 15) magnitude += i64(state_->decoder.rest()) - 1;
        block.q[c][n] = i32(negative ? -magnitude : magnitude);
        some = true;
        at.ones++;
        at.large += magnitude > 1;
      }
    }
  }

  // ---- 7.7

  u32 below(const u32* row, int x, int y, int z) const {  // the voxel at (x, y, z), each -2..3, from the first of a node of level D - 1
    auto part = [](int v) { return v < 0 ? -1 : v > 1 ? 1 : 0; };
    u32 other = row[shape_.self() + part(x) + 3 * part(y) + 9 * part(z)];
    return other == NONE ? NONE : levels_[unit_.depth - 1].child(other, (x & 1) | (y & 1) << 1 | (z & 1) << 2);
  }

  // Calls what(voxel, row of its parent, x, y, z of the voxel in it) for every voxel.
  template <typename What>
  void for_each_voxel(u32 first, u32 end, What what) const {
    const Level& upper = levels_[unit_.depth - 1];
    u32 p = u32(std::upper_bound(upper.first_child.begin(), upper.first_child.end(), first) - upper.first_child.begin()) - 1;
    for (u32 v = first; v < end; p++)
      for (int left = upper.children[p]; left; left &= left - 1, v++) {
        if (v % 1024 == 0) check_stop();
        int octant = __builtin_ctz(left);
        what(v, row_of(p), octant & 1, octant >> 1 & 1, octant >> 2);
      }
  }

  void filter(Level& level) const {
    int across = std::min(unit_.depth, 3);  // levels from a square of texels to them
    for (const FilterStage& stage : unit_.filters) {
      static const i8 none[5] = {};
      const i8* taps_of[15];
      int taps = unit_.planar ? 5 : 3, set = 0;
      for (int bit = 0; bit < 5 * components_; bit++)
        taps_of[bit] = stage.mask >> bit & 1 ? &stage.coefficients[taps * set++] : none;
      if (unit_.planar) {
        const Level& squares = levels_[unit_.depth - across];
        squares_.resize(std::max(squares_.size(), squares.count() * 64 * components_));
        i32* means = squares_.data();
        by_pieces(threads_, squares.count(), [&](size_t s, size_t end) {
          for (u32 v = first_below(unit_.depth - across, s); s < end; s++) {
            i32* of_square = means + s * 64 * components_;
            if (squares.weight[s] < 64) std::fill(of_square, of_square + 64 * components_, ABSENT);
            for (u32 n = 0; n < squares.weight[s]; n++, v++)
              for (int c = 0; c < components_; c++) of_square[c * 64 + level.cell[v]] = level.mean[size_t(v) * components_ + c];
          }
        });
        by_pieces(threads_, squares.count(), [&](size_t s, size_t end) {
          for (u32 v = first_below(unit_.depth - across, s); s < end; v += squares.weight[s++]) {
            if (s % 256 == 0) check_stop();
            filter_square(level, squares, u32(s), v, 1 << across, means, taps_of);
          }
        });
      } else {
        Array<i32> filtered = level.mean;
        by_pieces(threads_, levels_[unit_.depth - 1].count(), [&](size_t p, size_t end) {
          for (; p < end; p++) {
            if (p % 1024 == 0) check_stop();
            filter_children(level, levels_[unit_.depth - 1], u32(p), taps_of, filtered.data());
          }
        });
        level.mean.swap(filtered);
      }
    }
  }

  u32 first_below(int l, size_t node) const {  // voxel or texel of a node of level l
    u32 n = u32(node);
    for (; l < unit_.depth; l++) n = levels_[l].first_child[n];
    return n;
  }

  static constexpr i32 ABSENT = 1 << 30;
  static constexpr int WIDE = 16, PATCH = 12 * WIDE + 8;  // a row of a square and of what is around it; all rows

  // means: of every square, component and cell; `first` texel of square s, which has `side` cells on each axis
  TEXF_VECTORS void filter_square(Level& level, const Level& squares, u32 s, u32 first, int side, const i32* means, const i8* const* taps_of) const {
    i32 patch[components_ * PATCH], out[components_ * 64], classes[64];
    const u32* row = &squares.rows[size_t(s) * shape_.row];
    bool whole = true;
    for (int n = 0; n < 9; n++) whole = whole && row[n] != NONE && squares.weight[row[n]] == 64;
    if (!whole) std::fill(patch, patch + components_ * PATCH, ABSENT);
    for (int n = 0; n < 9; n++) {
      if (row[n] == NONE) continue;
      int dx = n % 3 - 1, dy = n / 3 - 1, x0 = dx < 0 ? side - 2 : 0, y0 = dy < 0 ? side - 2 : 0, width = dx ? 2 : side, height = dy ? 2 : side;
      for (int c = 0; c < components_; c++)
        for (int y = y0; y < y0 + height; y++)
          copy_row(&patch[c * PATCH + (side * dy + y + 2) * WIDE + side * dx + x0 + 2], &means[(size_t(row[n]) * components_ + c) * 64 + 8 * y + x0], width);
    }
    for (int y = 0; y < side; y++)
      for (int x = 0; x < 8; x += LANES) {
        if (whole) filter_lanes<true>(&patch[(y + 2) * WIDE + x + 2], &out[8 * y + x], classes, taps_of);
        else filter_lanes<false>(&patch[(y + 2) * WIDE + x + 2], &out[8 * y + x], classes, taps_of);
      }
    for (u32 n = 0; n < squares.weight[s]; n++)
      for (int c = 0; c < components_; c++) level.mean[size_t(first + n) * components_ + c] = out[64 * c + level.cell[first + n]];
  }

  static void copy_row(i32* to, const i32* from, int width) {
    if (width == 8) memcpy(to, from, 32);
    else if (width == 2) memcpy(to, from, 8);
    else memcpy(to, from, 16);
  }

  // from: the means of a row's lanes, among those of all components around them; to: of the first component
  template <bool whole>
  TEXF_INLINE void filter_lanes(const i32* from, i32* to, i32* classes, const i8* const* taps_of) const {
    static const int steps[12] = {-1, 1, -WIDE, WIDE, -WIDE - 1, 1 - WIDE, WIDE - 1, WIDE + 1, -2, 2, -2 * WIDE, 2 * WIDE};
    Lanes own = loaded<Lanes>(from);
    if (!whole) own &= own < ABSENT;
    Lanes spread_of = own - own, count = spread_of, class_ = spread_of;
    auto difference_to = [&](const i32* at, int n) __attribute__((always_inline)) {
      Lanes near = loaded<Lanes>(at + steps[n]);
      return whole ? near - own : (near - own) & (near < ABSENT);
    };
    for (int n = 0; n < 8; n++) {
      spread_of += absolute(difference_to(from, n));
      count -= whole ? Lanes(own - own) - 1 : loaded<Lanes>(from + steps[n]) < ABSENT;
    }
    if (!whole) count = count < 1 ? own - own + 1 : count;
    for (i32 least_of : least_) class_ -= spread_of >= least_of * count;
    memcpy(classes, &class_, sizeof class_);
    for (int c = 0; c < components_; c++, from += PATCH, to += 64) {
      own = loaded<Lanes>(from);
      if (!whole) own &= own < ABSENT;
      i32 limit = i32(step_[c] >> 2), tap[5][LANES];
      for (int l = 0; l < LANES; l++) {
        const i8* f = taps_of[classes[l] * components_ + c];
        for (int r = 0; r < 5; r++) tap[r][l] = f[r];
      }
      // 512 * high + low is the sum of taps times sums, of which none fits 32 bits
      Lanes high = own - own, low = high + 256;
      auto weigh = [&](int r, Lanes sum) __attribute__((always_inline)) {
        Lanes f = loaded<Lanes>(tap[r]);
        high += f * (sum >> 9);
        low += f * (sum & 511);
      };
      for (int r = 0; r < 3; r++) {
        Lanes sum = own - own, limited = sum;
        for (int n = 4 * r; n < 4 * r + 4; n++) {
          Lanes difference = difference_to(from, n);
          sum += difference;
          if (r < 2) limited += least<Lanes>(difference < -limit ? sum - sum - limit : difference, sum - sum + limit);
        }
        weigh(r, sum);
        if (r < 2) weigh(3 + r, limited);
      }
      Lanes value = own + high + (low >> 9), most = own - own + i32(LARGEST);
      value = least<Lanes>(value < -most ? -most : value, most);
      memcpy(to, &value, sizeof value);
    }
  }

  TEXF_VECTORS void filter_children(const Level& level, const Level& upper, u32 p, const i8* const* taps_of, i32* filtered) const {
    static const i8 steps[26] = {-16, -4, -1, 1, 4, 16, -20, -17, -15, -12, -5, -3, 3, 5, 12, 15, 17, 20, -21, -19, -13, -11, 11, 13, 19, 21};
    Four means[64] = {};  // by place: components, 1
    i32 luma[64] = {};    // of the first component
    const u32* row = row_of(p);
    for (int n = 0; n < 27; n++) {
      if (row[n] == NONE) continue;
      for (int left = upper.children[row[n]] & shape_.inside[n]; left; left &= left - 1) {
        int octant = __builtin_ctz(left), place = shape_.place[n][octant];
        const i32* from = mean_of(level, upper.child(row[n], octant));
        luma[place] = from[0];
        means[place] = Four{from[0], components_ > 1 ? from[components_ > 1] : 0, components_ > 2 ? from[components_ - 1] : 0, 1};
      }
    }
    i32* out = filtered + size_t(upper.first_child[p]) * components_;
    for (int children = upper.children[p]; children; children &= children - 1, out += components_) {
      int place = shape_.own[__builtin_ctz(children)], class_ = 0;
      auto sum_of = [&](int n, int end) {
        Four sum = {};
        for (; n < end; n++) sum += means[place + steps[n]];
        return sum;
      };
      Four own = means[place], ring[3] = {sum_of(0, 6), sum_of(6, 18), sum_of(18, 26)}, by_x = {};
      own[3] = 0;
      for (int n = 0; n < 9; n++) by_x += absolute<Four>(loaded<Four>(&luma[(place & ~3) + 16 * (n / 3 - 1) + 4 * (n % 3 - 1)]) - own[0]);
      i32 count = ring[0][3] + ring[1][3] + ring[2][3], x = place & 3;
      i32 spread_of = by_x[x - 1] + by_x[x] + by_x[x + 1] - (26 - count) * std::abs(own[0]);
      while (class_ < 4 && spread_of >= least_[class_] * std::max(1, count)) class_++;
      for (Four& sum : ring) sum -= own * sum[3];
      for (int c = 0; c < components_; c++) {
        const i8* f = taps_of[class_ * components_ + c];
        out[c] = i32(clip(-LARGEST, LARGEST, own[c] + ((256 + i64(f[0]) * ring[0][c] + i64(f[1]) * ring[1][c] + i64(f[2]) * ring[2][c]) >> 9)));
      }
    }
  }

  // ---- 7.8

  std::vector<u8> values_of(const Level& level) const {
    std::vector<u8> values(level.mean.size());
    by_pieces(threads_, values.size() / components_, [&](size_t i, size_t end) {
      i *= components_, end *= components_;
      for (; i < end && unit_.colour_transform == 0; i++) values[i] = u8(clip(0, 255, (level.mean[i] + 2048) >> 12));
      for (; i < end; i += 3) {
        i64 y = 65536 * i64(level.mean[i]) + (1 << 27), cb = level.mean[i + 1], cr = level.mean[i + 2];
        values[i] = u8(clip(0, 255, (y + 103206 * cr) >> 28));
        values[i + 1] = u8(clip(0, 255, (y - 12276 * cb - 30679 * cr) >> 28));
        values[i + 2] = u8(clip(0, 255, (y + 121608 * cb) >> 28));
      }
    });
    return values;
  }

  // ---- 7.9

  void residuals(Range range, RangeDecoder& decoder, const std::vector<u8>& x, std::vector<u8>& y, std::vector<i16>& k) const {
    Mixer mixer({{576, 576, 4608, 576, 3072, 4608}, {27, 48, 144}}, 103, 51);
    int order[3] = {components_ == 3, components_ != 3, 2}, S = 2 * (unit_.residual - 1) + 1;
    for_each_voxel(range.first, range.end, [&](u32 v, const u32* row, int vx, int vy, int vz) {
      struct { u32 voxel; int w; } near[26];
      int count = 0;
      i64 W = 0, surprise = 0, before[3] = {0, 0, 0};
      for (int n = 0; n < shape_.row; n++) {
        const Shape::Direction& d = shape_.direction[n];
        u32 other = d.nonzero ? below(row, vx + d.x, vy + d.y, vz + d.z) : NONE;
        if (other == NONE) continue;
        int w = other >= range.first && other < v ? 8 >> d.nonzero : 0;
        near[count++] = {other, w};
        W += w;
      }
      for (int i = 0; i < components_; i++) {
        int c = order[i];
        size_t at = size_t(v) * components_ + c;
        i64 errors = 0, sizes = 0, largest = 0, variation = 0;
        for (int n = 0; n < count; n++) {
          size_t u = size_t(near[n].voxel) * components_ + c;
          variation += std::abs(int(x[u]) - x[at]);
          if (near[n].w == 0) continue;
          errors += near[n].w * (int(y[u]) - x[u]);
          sizes += near[n].w * std::abs(k[u]);
          largest = std::max<i64>(largest, std::abs(k[u]));
        }
        i64 base = W > 0 ? floor_div(32 * errors + W, 2 * W) : 0;
        i64 shift = base + ((unit_.residual_cross[c] * surprise + 8) >> 4) + 8;
        u32 fraction = shift & 15, energy = W > 0 ? fine(4 * sizes / W) : 0, big = fine(largest), activity = fine(variation / std::max(1, count));
        i64 lead = i > 0 ? before[0] : 0, second = i > 1 ? before[1] : 0;
        u32 l7 = u32(std::min<i64>(magnitude(lead), 7)), l15 = u32(std::min<i64>(magnitude(lead), 15)), s7 = u32(std::min<i64>(magnitude(second), 7));
        u32 size = 0;
        int negative = 0;
        while (size < 16) {
          u32 numbers[6] = {
              (c * 12 + energy) * 16 + size,
              (c * 12 + activity) * 16 + size,
              ((c * 16 + l15) * 6 + (energy >> 1)) * 16 + size,
              (c * 12 + big) * 16 + size,
              ((c * 8 + l7) * 8 + s7) * 16 + size,
              ((c * 8 + (fraction >> 1)) * 12 + energy) * 16 + size,
          };
          if (!mixer.bit<6>(decoder, SIZE, numbers, c * 16 + size, 48 + c * 12 + energy, c * 16 + size)) break;
          if (++size > 1) continue;
          u32 sign_lead = c * 3 + sign_of(lead), signs[3] = {sign_lead * 3 + sign_of(second), c * 16 + fraction, sign_lead * 16 + fraction};
          negative = mixer.bit<3>(decoder, RESIDUAL_SIGN, signs, 84 + c, 87 + fraction, 48 + c);
        }
        if (size == 16) size = u32(std::min<i64>(255, 15 + i64(decoder.rest())));
        k[at] = i16(negative ? -int(size) : int(size));
        y[at] = u8(clip(0, 255, clip(0, 255, x[at] + (shift >> 4)) + k[at] * S));
        before[i] = k[at];
        if (i == 0) surprise = 16 * (i64(y[at]) - x[at]) - base;
      }
    });
  }

  // ---- 7.11.4

  u32 first_texel(u32 node) const { return levels_[d_ + 2].first_child[levels_[d_ + 1].first_child[level_->first_child[node]]]; }

  static i64 basis(int f, int x) {
    static const i64 cosine[9] = {8192, 8035, 7568, 6811, 5793, 4551, 3135, 1598, 0};
    if (f == 0) return 5793;
    int m = (2 * x + 1) * f % 32;
    m = std::min(m, 32 - m);
    return m <= 8 ? cosine[m] : -cosine[16 - m];
  }

  void prepare_dct() {
    level_->dct.assign(level_->count(), NONE);
    for (int down = 0; down < 3; down++) levels_[d_ + down].known.assign(levels_[d_ + down].count(), false);
    for (int z = 0, sum = 1; sum <= 14; sum++)
      for (int i = 0; i <= sum; i++) {
        int u = sum % 2 == 0 ? i : sum - i, v = sum - u;
        if (u < 8 && v < 8) zigzag_[++z] = u8(8 * v + u);
      }
    for (int f = 0; f < 8; f++)
      for (int x = 0; x < 8; x++) {
        basis_[f][x] = turned_[x][f] = i32(basis(f, x));
        texel_[8 * f + x] = u8(morton_key(x, f, 0) % 8 + morton_key(x, f, 0) / 8 % 8 * 4 + morton_key(x, f, 0) / 64 * 16);
      }
  }

  void decode_dct_blocks() {
    for (u32 node = range_.first; node < range_.end; node++) {
      if (node % 1024 == 0) check_stop();
      if (level_->weight[node] != 64) continue;
      level_->dct[node] = u32(state_->blocks.size());
      state_->blocks.push_back({});
      decode_dct_block(node);
    }
  }

  // us, vs: columns and rows of `a` that are not all 0
  template <typename Number>
  TEXF_VECTORS void inverse(const i64* a, u32 us, u32 vs, i32 own, i32* out) const {
    for (int y = 0; y < 8; y++) {
      Number part[8] = {}, sum[8];
      for (u32 left = vs; left; left &= left - 1) {
        int v = __builtin_ctz(left);
        for (int u = 0; u < 8; u++) part[u] += Number(a[8 * v + u]) * Number(basis_[v][y]);
      }
      std::fill(sum, sum + 8, Number(1 << 27));
      for (u32 left = us; left; left &= left - 1) {
        int u = __builtin_ctz(left);
        for (int x = 0; x < 8; x++) sum[x] += part[u] * Number(basis_[u][x]);
      }
      for (int x = 0; x < 8; x++) out[texel_[8 * y + x] * components_] = i32(clip(-LARGEST, LARGEST, own + (i64(sum[x]) >> 28)));
    }
  }

  TEXF_OFTEN void decode_dct_block(u32 node) {
    DctBlock &block = state_->blocks.back(), *beside[3];
    const i32* texels[3];
    Level& texel_level = levels_[d_ + 3];
    const int away[3][2] = {{-1, 0}, {0, -1}, {-1, -1}};
    for (int i = 0; i < 3; i++) {
      u32 other = neighbour(node, away[i][0], away[i][1], 0);
      bool there = other != NONE && other >= range_.first && level_->dct[other] != NONE;
      beside[i] = there ? &state_->blocks[level_->dct[other]] : nullptr;
      texels[i] = there ? mean_of(texel_level, first_texel(other)) : nullptr;
    }
    const i32* own = mean_of(*level_, node);
    i32* out = &texel_level.mean[size_t(first_texel(node)) * components_];
    i64 total[2] = {0, 0};
    for (int c = 0; c < components_; c++) {
      i64 west[8] = {}, north[8] = {}, a[64] = {}, sizes = 0;
      auto edge = [&](const i32* from, int inner, int outer, i64* to) {  // at 8 * y + x, steps of the other axis
        double sums[8] = {};
        for (int i = 0; i < 8; i++) {
          int on = outer == 7 ? 8 * i : i;
          double value = 3 * from[texel_[on + outer] * components_ + c] - from[texel_[on + inner] * components_ + c] - 2 * own[c];
          for (int f = 0; f < 8; f++) sums[f] += value * turned_[i][f];
        }
        for (int f = 0; f < 8; f++) to[f] = i64(sums[f]) >> 15;
      };
      if (beside[0]) edge(texels[0], 6, 7, west);
      if (beside[1]) edge(texels[1], 48, 56, north);
      u32 us = 0, vs = 0;
      int left = block.count[c] = dct_count(block, beside, c, west, north);
      for (int z = 1; z < 64 && left > 0; z++) {
        i64 q = dct_coefficient(block, beside, c, z, &left, west, north);
        if (q == 0) continue;
        int place = zigzag_[z], u = place % 8, v = place / 8;
        total[c > 0] += magnitude(q);
        block.q[c][place] = i8(clip(-127, 127, q));
        i64 value = a[place] = clip(-(1 << 25), 1 << 25, q * step_[c]);
        sizes += magnitude(value);
        us |= 1 << u;
        vs |= 1 << v;
        west[v] -= u > 0 ? value >> 1 : (181 * value) >> 9;
        north[u] -= v > 0 ? value >> 1 : (181 * value) >> 9;
      }
      if (sizes < 1 << 26) inverse<double>(a, us, vs, own[c], out + c);  // sums below 2^53
      else inverse<i64>(a, us, vs, own[c], out + c);
    }
    int energy[2] = {int(std::min<i64>(255, 16 * total[0] / 63)),
                     components_ > 1 ? int(std::min<i64>(255, 16 * total[1] / (63 * (components_ - 1)))) : 0};
    u32 first = node;
    for (int down = 0, count = 1; down < 3; down++, count *= 4) {
      Level& level = levels_[d_ + down];
      for (int i = 0; i < count; i++) {
        level.known[first + i] = true;
        for (int k = 0; k < 2; k++) level.energy[2 * size_t(first + i) + k] = u8(energy[k]);
        int texels_of = 64 / count;
        for (int c = 0; c < components_ && down > 0; c++) {
          i64 sum = 0;
          for (int t = 0; t < texels_of; t++) sum += out[(i * texels_of + t) * components_ + c];
          level.mean[size_t(first + i) * components_ + c] = i32(floor_div(2 * sum + texels_of, 2 * texels_of));
        }
      }
      first = level.first_child[first];
    }
  }

  int dct_count(const DctBlock& block, DctBlock* const beside[3], int c, const i64* west, const i64* north) {
    u32 around, other = c > 0 ? block.count[c - 1] : beside[2] ? beside[2]->count[0] : 63;
    if (beside[0] && beside[1]) around = (beside[0]->count[c] + beside[1]->count[c] + 1) / 2;
    else if (beside[0] || beside[1]) around = (beside[0] ? beside[0] : beside[1])->count[c];
    else around = c > 0 ? block.count[0] : 32;
    u32 last = beside[0] ? u32(beside[0]->count[c]) : around;
    i64 sum = 0;
    for (int f = 0; f < 8; f++) sum += magnitude(west[f]) + magnitude(north[f]);
    u32 border = fine(sixteenths(sum, c) >> 3), node = 1, about = fine(around);
    for (int i = 0; i < 6; i++) {
      u32 numbers[4] = {(c * 64 + around) * 64 + node, (c * 64 + other) * 64 + node, ((c * 12 + border) * 12 + about) * 64 + node,
                        (c * 64 + last) * 64 + node};
      node = 2 * node + state_->dct.template bit<4>(state_->decoder, COUNT, numbers, c * 64 + node, 621 + c * 12 + about, c * 64 + node);
    }
    return int(node) - 64;
  }

  i64 dct_coefficient(const DctBlock& block, DctBlock* const beside[3], int c, int z, int* left, const i64* west, const i64* north) {
    int place_ = zigzag_[z], u = place_ % 8, v = place_ / 8;
    u32 place = place_;
    int of[3];
    for (int i = 0; i < 3; i++) of[i] = beside[i] ? beside[i]->q[c][place] : 0;
    auto lower = [&](int x, int y) { return u >= x && v >= y ? std::abs(int(block.q[c][place_ - x - 8 * y])) : 0; };
    u32 near = 2 * lower(1, 0) + 2 * lower(0, 1) + lower(1, 1) + lower(2, 0) + lower(0, 2);
    int q0 = c > 0 ? block.q[0][place] : 0, q1 = c > 1 ? block.q[1][place] : 0;
    u32 alike = fine(3 * std::abs(of[0]) + 3 * std::abs(of[1]) + 2 * std::abs(of[2])), signs = 3 * sign_of(of[0]) + sign_of(of[1]);
    u32 lead = sign_of(q0) + 3 * sign_of(q1), size = fine(near), rest = fine(63 - z);
    u32 l0 = std::min(std::abs(q0), 2), l1 = std::min(std::abs(q1), 2), l3 = std::min(std::abs(q0), 3);
    i64 w = u > 0 ? 2 * west[v] : (181 * west[v]) >> 6, h = v > 0 ? 2 * north[u] : (181 * north[u]) >> 6;
    i64 sw = sixteenths(w, c), sh = sixteenths(h, c);
    u32 expected = fine((u == 0 ? sw : v == 0 ? sh : (sw + sh) >> 1) >> 1);
    u32 from_w = 6 + (w < 0 ? -1 : 1) * class_of(sw >> 2), from_n = 6 + (h < 0 ? -1 : 1) * class_of(sh >> 2);
    u32 kind = u == 0 ? 0 : v == 0 ? 1 : u + v < 4 ? 2 : 3;
    Mixer& mixer = state_->dct;
    if (*left < 64 - z) {
      u32 about = fine(*left);
      u32 numbers[6] = {u32((c * 64 + z) * 64 + *left), (c * 64 + place) * 12 + alike, ((c * 12 + size) * 12 + alike) * 12 + rest,
                        (((c * 64 + place) * 3 + l0) * 3 + l1) * 3 + std::min(near, 2u), (c * 64 + place) * 12 + expected,
                        ((c * 12 + expected) * 12 + about) * 12 + rest};
      if (!mixer.bit<6>(state_->decoder, ZERO, numbers, 192 + c * 64 + z, 657 + c * 12 + about, 192 + c * 64 + z)) return 0;
    }
    --*left;
    u32 sign_numbers[4] = {(c * 64 + place) * 9 + signs, ((c * 13 + from_w) * 13 + from_n) * 4 + kind, (c * 64 + place) * 9 + lead,
                           (c * 64 + place) * 13 + (u <= v ? from_w : from_n)};
    int negative = mixer.bit<4>(state_->decoder, SIGN, sign_numbers, 429 + c * 64 + place, 729 + (c * 12 + expected) * 4 + kind, 429 + c * 64 + place);
    i64 magnitude = 1;
    u32 i = 0, about = fine(*left), diagonal = fine(u + v);
    for (; i < 15; i++, magnitude++) {
      u32 numbers[5] = {(c * 15 + i) * 64 + place, ((c * 15 + i) * 12 + size) * 12 + alike, ((c * 15 + i) * 12 + expected) * 12 + diagonal,
                        ((c * 15 + i) * 12 + about) * 4 + l3, ((c * 15 + i) * 12 + alike) * 12 + expected};
      if (!mixer.bit<5>(state_->decoder, MORE, numbers, 384 + c * 15 + i, 693 + c * 12 + size, 384 + c * 15 + i)) break;
    }
    if (i == 15) magnitude += i64(state_->decoder.rest()) - 1;
    return negative ? -magnitude : magnitude;
  }

  const AttributeUnit& unit_;
  const Shape& shape_;
  int models_, threads_;
  std::vector<Level>& levels_;
  Array<i32>& squares_;
  i64 step_[3] = {1, 1, 1}, inverse_[3] = {}, falloff_inverse_ = 0;
  i32 least_[4];
  double kernels_[27][9][8] = {};  // 7.3: by direction and octant there, or 8 for the whole node, of every octant here
  u8 zigzag_[64] = {}, texel_[64];  // texel_: the number of the one at 8 * y + x
  i32 basis_[8][8];
  double turned_[8][8];
  const u32* rows_ = nullptr;  // neighbours of the nodes of the level
  // of the level and the range that are decoded
  int d_ = 0;
  const u8* above_ = nullptr;  // energies of the nodes' parents
  u32 level_class_ = 0;
  Level *upper_ = nullptr, *level_ = nullptr, *lower_ = nullptr;
  Range range_{0, 0};
  SliceState* state_ = nullptr;
};

}  // namespace

std::vector<u8> decode_raht(const AttributeUnit& unit, Octree& octree, int lod, int threads) {
  switch (unit.components) {
    case 1: return std::make_unique<Raht<1>>(unit, octree, threads)->decode(lod);
    case 2: return std::make_unique<Raht<2>>(unit, octree, threads)->decode(lod);
    default: return std::make_unique<Raht<3>>(unit, octree, threads)->decode(lod);
  }
}

// ---- 11

namespace {

i32 fixed_point(u32 half) {  // 11.6
  int e = half >> 10 & 31, s = e > 0 ? e - 9 : -8;
  i64 n = (half & 1023) + (e > 0 ? 1024 : 0), size = s >= 0 ? n << s : (n + (1ll << (-s - 1))) >> -s;
  return i32(half >> 15 ? -size : size);
}

i32 hard_gelu(i32 v) {
  i64 m = clip(-24576, 24576, v);
  return v > 24576 ? v : i32((m * (m + 24576) * 43691 + (1 << 30)) >> 31);
}

}  // namespace

Network::Network(const AttributeUnit& unit) : unit_(unit), widths_(unit.widths) {
  const u8* at = unit.network.data;
  auto next = [&] {
    i32 weight = fixed_point(at[0] | at[1] << 8);
    at += 2;
    return weight;
  };
  for (size_t n = 0; n + 1 < widths_.size(); n++) {
    weights_.emplace_back(size_t(widths_[n]) * widths_[n + 1]);
    biases_.emplace_back(widths_[n + 1]);
    for (i32& weight : weights_.back()) weight = next();
    for (i32& bias : biases_.back()) bias = next();
  }
  int F = unit.num_features;
  u64 num_rows = 0;
  for (const LatentLevel& level : unit.levels) {
    first_row_.emplace_back();
    for (const auto& keys : level.keys) {
      first_row_.back().push_back(num_rows);
      num_rows += keys.size();
    }
    if (level.table_log2 > 0) {
      first_row_.back().push_back(num_rows);
      num_rows += level.num_rows;
    }
  }
  rows_.resize(num_rows * F);
  if (unit.form == 0) {
    for (size_t i = 0; i < rows_.size(); i++) rows_[i] = i8(((unit.latents.data[i / 2] >> (i % 2 * 4) & 15) ^ 8) - 8);
    return;
  }
  RangeDecoder decoder(unit.latents.data, unit.latents.size);
  std::vector<Context> contexts(size_t(F) * 256);
  for (size_t row = 0; row < num_rows; row++)
    for (int k = 0; k < F; k++) {
      size_t i = row * F + k;
      int c1 = row > 0 ? rows_[i - F] : 0, c2 = row > 1 ? rows_[i - 2 * F] : 0, node = 1;
      Context* first = &contexts[(k * 16 + 4 * ((c1 + 8) >> 2) + ((c2 + 8) >> 2)) * 16];
      for (int b = 0; b < 4; b++) node = 2 * node + decoder.bit(first[node]);
      rows_[i] = i8(node - 24);
    }
}

i64 Network::row_of(size_t l, size_t field, const i64 at[3]) const {  // 11.3, -1 where there is none
  const LatentLevel& level = unit_.levels[l];
  if (level.table_log2 > 0) {
    u64 hashed = u64(at[0] + 1) ^ u64(at[1] + 1) * 2654435761u ^ u64(at[2] + 1) * 805459861u ^ u64(field) * 3674653429u;
    return i64(first_row_[l][0] + (hashed & ((1ull << level.table_log2) - 1)));
  }
  for (int axis = 0; axis < 3; axis++)
    if (at[axis] < 0 || at[axis] >= level.resolution) return -1;
  const std::vector<u64>& keys = level.keys[field];
  u64 key = morton_key(at[0], at[1], at[2]);
  auto place = std::lower_bound(keys.begin(), keys.end(), key);
  return place == keys.end() || *place != key ? -1 : i64(first_row_[l][field]) + (place - keys.begin());
}

std::vector<u8> Network::packed_rows() const {
  std::vector<u8> packed(rows_.size() / 2);
  for (size_t i = 0; i < packed.size(); i++) packed[i] = u8((rows_[2 * i] & 15) | (rows_[2 * i + 1] & 15) << 4);
  return packed;
}

void Network::centre(u64 key, int resolution, i64 position[3]) {  // 11.2
  for (int axis = 0; axis < 3; axis++) position[axis] = i64(((2 * gathered_bits(key >> axis) + 1) << 23) / resolution);
}

void Network::answer(size_t field, const i64 position[3], i32* values) {
  int F = unit_.num_features;
  std::vector<i32>&in = in_, &out = out_;
  in.assign(widths_[0], 0);
  i32* input = in.data();
  for (size_t l = 0; l < unit_.levels.size(); l++, input += F) {  // 11.4
    i64 base[3], f[3], total = 0, sum[64] = {};
    for (int axis = 0; axis < 3; axis++) {
      i64 u = ((position[axis] * unit_.levels[l].resolution) >> 12) - 2048;
      base[axis] = u >> 12;
      f[axis] = u & 4095;
    }
    for (int corner = 0; corner < 8; corner++) {
      i64 weight = 1, at[3];
      for (int axis = 0; axis < 3; axis++) {
        int d = corner >> axis & 1;
        weight *= d ? f[axis] : 4096 - f[axis];
        at[axis] = base[axis] + d;
      }
      weight >>= 12;
      i64 row = weight > 0 ? row_of(l, field, at) : -1;
      if (row < 0) continue;
      total += weight;
      for (int k = 0; k < F; k++) sum[k] += weight * (2 * rows_[row * F + k] + 1);
    }
    for (int k = 0; k < F && total > 0; k++) input[k] = i32((sum[k] * ((1ll << 38) / total) + (1 << 27)) >> 28);
  }
  for (int m = 0; m < unit_.wave_octaves; m++)  // 11.5
    for (int axis = 0; axis < 3; axis++) {
      i64 phase = ((position[axis] * (i64(unit_.first_wave) << m)) >> 9) & 65535;
      *input++ = i32(magnitude(phase - 32768) - 16384);
      *input++ = i32(magnitude(((phase + 16384) & 65535) - 32768) - 16384);
    }
  for (size_t n = 0; n + 1 < widths_.size(); n++) {  // 11.6
    out.resize(widths_[n + 1]);
    const i32* weight = weights_[n].data();
    for (int o = 0; o < widths_[n + 1]; o++) {
      i64 y = i64(biases_[n][o]) * 16384;
      for (int i = 0; i < widths_[n]; i++) y += i64(*weight++) * in[i];
      i32 v = i32(clip(-(1 << 24), 1 << 24, (y + (1 << 15)) >> 16));
      out[o] = n + 2 < widths_.size() ? hard_gelu(v) : v;
    }
    in.swap(out);
  }
  for (int o = 0; o < widths_.back(); o++) values[o] = i32(clip(0, 65280, ((i64(in[o]) + 16384) * 32640 + (1 << 13)) >> 14));  // 11.7
}

void decode_neural(Asset& asset) {
  AttributeUnit& unit = asset.attributes[0];
  for (LatentLevel& level : unit.levels)
    for (size_t i = 0; i < level.num_latents.size(); i++) {
      level.keys.push_back(active_voxels(asset, i, level.resolution, level.threshold, asset.threads));
      require_equal(level.keys.back().size(), level.num_latents[i], S30, "num_latents does not match");
    }
  Network network(unit);
  asset.latents = network.packed_rows();
  asset.network.assign(unit.network.data, unit.network.data + unit.network.size);
  std::vector<i32> answer(network.outputs());
  u32 crc = 0;
  for (size_t i = 0; i < asset.fields.size(); i++) {
    const Field& field = asset.fields[i];
    std::vector<u8> voxels(field.keys.size() * answer.size());
    for (size_t n = 0; n < field.keys.size(); n++) {
      i64 position[3];
      Network::centre(field.keys[n], field.resolution, position);
      if (n % 256 == 0) check_stop();
      network.answer(i, position, answer.data());
      for (size_t o = 0; o < answer.size(); o++) voxels[n * answer.size() + o] = u8((answer[o] + 128) >> 8);
    }
    crc = crc32(voxels.data(), voxels.size(), crc);
    int shift = 3 * asset.levels_left_out(i);
    for (size_t first = 0, end; first < field.keys.size(); first = end) {  // 8.3
      for (end = first; end < field.keys.size() && field.keys[end] >> shift == field.keys[first] >> shift;) end++;
      size_t o = 0;
      for (size_t g = 0; g < asset.groups.size(); g++)
        for (int c = 0; c < asset.groups[g].components; c++, o++) {
          u64 sum = 0;
          for (size_t n = first; n < end; n++) sum += voxels[n * answer.size() + o];
          asset.values[i][g].push_back(u8((2 * sum + (end - first)) / (2 * (end - first))));
        }
    }
  }
  require(crc == unit.values_crc, S32, "values_crc does not match");
}

}  // namespace texf
