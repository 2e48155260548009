// Clause 6, which voxels and texels the surface touches, and 8.4, marks and normals of its edges and corners.
#include <cmath>

#include "core.hpp"

namespace texf {
namespace {

// ---- 6.1 to 6.3

using Point = std::array<i64, 3>;

struct Frame {
  Point start, end, apex;
  i64 columns, rows, unit;
};

i64 reach(const Point& u, const Point& v) {
  i64 largest = 0;
  for (int axis = 0; axis < 3; axis++) largest = std::max(largest, magnitude(u[axis] - v[axis]));
  return largest;
}

Frame frame_of(const GeometryUnit& unit, size_t face, int resolution, int position_bits) {
  Point p[3];
  for (int i = 0; i < 3; i++)
    for (int axis = 0; axis < 3; axis++) p[i][axis] = (i64(unit.at(face, i)[axis]) * resolution << 16) >> position_bits;
  for (int i : {0, 1, 0})
    if (p[i + 1] < p[i]) std::swap(p[i], p[i + 1]);
  const Point &a = p[0], &b = p[1], &c = p[2];
  i64 ab = reach(a, b), ac = reach(a, c), bc = reach(b, c);
  Frame frame = ab >= ac && ab >= bc ? Frame{a, b, c, 1, 1, 0} : ac >= bc ? Frame{a, c, b, 1, 1, 0} : Frame{b, c, a, 1, 1, 0};
  i64 base = std::max(ab, std::max(ac, bc));
  if (base == 0) return frame;
  i64 u[3], v[3];
  for (int axis = 0; axis < 3; axis++) {
    u[axis] = frame.end[axis] - frame.start[axis];
    v[axis] = frame.apex[axis] - frame.start[axis];
  }
  i64 cross[3], largest = 0, squares = 0;
  for (int axis = 0; axis < 3; axis++) {
    int y = (axis + 1) % 3, z = (axis + 2) % 3;
    cross[axis] = magnitude(u[y] * v[z] - u[z] * v[y]);
    largest = std::max(largest, cross[axis]);
  }
  int shift = std::max(0, bit_length(largest) - 30);
  for (i64 c : cross) squares += (c >> shift) * (c >> shift);
  i64 area = isqrt(squares) << shift;
  frame.columns = std::max<i64>(1, (2 * base + 65535) >> 16);
  frame.rows = std::max<i64>(1, (2 * (area / base) + 65535) >> 16);
  frame.unit = area / (frame.rows * frame.rows);
  return frame;
}

// Area weights of voxels up to `most`, which Weight holds, by bricks of 4 x 4 x 4 that are found through a hash table. Without weights
// where `most` is 0.
template <typename Weight>
class Weights {
 public:
  Weights(i64 most, u64 limit) : most_(u64(most)), limit_(limit), slots_(1 << 10, NONE) {}

  // Samples at (at + i * step) >> 32
  template <bool within_cube>
  void add(i64 count, const i64 from[3], const i64 step[3], u64 share, i64 resolution) {
    i64 at[3] = {from[0], from[1], from[2]};
    share = std::min(share, most_);
    for (i64 i = 0; i < count; i++) {
      u64 x = place<within_cube>(at[0], resolution), y = place<within_cube>(at[1], resolution), z = place<within_cube>(at[2], resolution);
      u64 key = x >> 2 | y >> 2 << 11 | z >> 2 << 22;
      if (key != key_) find(key);
      u64 voxel = ((x & 3) * 5 & 9) + ((y & 3) * 5 & 9) * 2 + ((z & 3) * 5 & 9) * 4;
      touched_[brick_] |= 1ull << voxel;
      if (weights_) weights_[voxel] = Weight(std::min(u64(weights_[voxel]) + share, most_));
      for (int axis = 0; axis < 3; axis++) at[axis] += step[axis];
    }
  }

  void merge(Weights& other) {
    for (size_t n = 0; n < other.bricks_.size(); n++) {
      find(other.bricks_[n]);
      touched_[brick_] |= other.touched_[n];
      for (int at = 0; at < 64 && most_ > 0; at++) weights_[at] = Weight(std::min(u64(weights_[at]) + other.weights_of(n)[at], most_));
    }
  }

  std::vector<u64> keys() {
    std::vector<u64> order(bricks_.size()), out;
    u64 count = 0;
    for (size_t n = 0; n < order.size(); n++) {
      order[n] = morton_key(bricks_[n] & 2047, bricks_[n] >> 11 & 2047, bricks_[n] >> 22) << 31 | n;  // at most 2^31 bricks
      for (u64 left = touched_[n]; left; left &= left - 1) count++;
    }
    if (limit_ > 0) within(std::min(count, limit_ + 1), limit_, L04, "touched voxels");
    sort_keys(order);
    out.reserve(count);
    for (u64 both : order) {
      size_t n = both & 0x7fffffff;
      const Weight* weights = most_ > 0 ? weights_of(n) : nullptr;
      for (u64 left = touched_[n]; left; left &= left - 1) {
        int at = __builtin_ctzll(left);
        if (!weights || weights[at] >= most_) out.push_back((both >> 31) << 6 | u64(at));
      }
    }
    return out;
  }

 private:
  static constexpr u32 NONE = 0xffffffff;
  static constexpr int PART = 1 << 10;  // bricks whose weights are allocated together
  static size_t mixed(u64 key) { return size_t((key * 0x9e3779b97f4a7c15ull) >> 32); }
  template <bool within_cube>
  static u64 place(i64 at, i64 resolution) { return u64(within_cube ? at >> 32 : clip(0, resolution - 1, at >> 32)); }
  Weight* weights_of(size_t brick) { return &parts_[brick / PART][64 * (brick % PART)]; }
  void find(u64 key) {
    size_t mask = slots_.size() - 1, at = mixed(key) & mask;
    while (slots_[at] != NONE && bricks_[slots_[at]] != key) at = (at + 1) & mask;
    if (slots_[at] == NONE) append(key, at);
    else brick_ = slots_[at];
    key_ = key;
    if (most_ > 0) weights_ = weights_of(brick_);
  }
  void append(u64 key, size_t at) {
    slots_[at] = brick_ = u32(bricks_.size());
    bricks_.push_back(key);
    touched_.push_back(0);
    within(bricks_.size(), limit_, L04, "touched voxels");
    if (most_ > 0 && brick_ % PART == 0) parts_.emplace_back(64 * PART, 0);
    if (2 * bricks_.size() <= slots_.size()) return;
    slots_.assign(2 * slots_.size(), NONE);
    for (u32 n = 0; n < bricks_.size(); n++) {
      size_t to = mixed(bricks_[n]) & (slots_.size() - 1);
      while (slots_[to] != NONE) to = (to + 1) & (slots_.size() - 1);
      slots_[to] = n;
    }
  }
  u64 most_, limit_, key_ = ~0ull;
  u32 brick_ = 0;              // of key_
  Weight* weights_ = nullptr;  // of its voxels
  std::vector<u32> slots_;
  std::vector<u64> bricks_, touched_;
  std::vector<std::vector<Weight>> parts_;
};

template <typename Weight>
void add_face(Weights<Weight>& weights, const Frame& f, i64 resolution) {  // 6.3
  i64 offset = f.columns > 4 * f.rows ? 0 : 1, rows = f.rows;
  for (i64 j = 0; j < rows; j++) {
    if (j % 64 == 0) check_stop();
    i64 left = 2 * rows - 2 * j - offset, count = std::max<i64>(1, (f.columns * left + 2 * rows - 1) / (2 * rows));
    i64 at[3], step[3], share = f.unit * (2 * rows - 2 * j - 1) / (2 * count);
    bool within_cube = true;
    for (int axis = 0; axis < 3; axis++) {
      i64 start = (f.start[axis] + floor_div((f.apex[axis] - f.start[axis]) * (2 * j + offset), 2 * rows)) * 65536;
      i64 half = floor_div(floor_div((f.end[axis] - f.start[axis]) * left, 2 * rows) * 65536, 2 * count);
      at[axis] = start + half;
      step[axis] = 2 * half;
      i64 last = at[axis] + (count - 1) * step[axis];
      within_cube = within_cube && std::min(at[axis], last) >= 0 && std::max(at[axis], last) >> 32 < resolution;
    }
    if (within_cube) weights.template add<true>(count, at, step, u64(share), resolution);
    else weights.template add<false>(count, at, step, u64(share), resolution);
  }
}

u64 samples_of_voxels(const Asset& asset, const GeometryUnit& unit, int resolution) {  // 10.1
  u64 samples = 0;
  for (size_t f = 0; f < unit.num_faces(); f++) {
    Frame frame = frame_of(unit, f, resolution, asset.position_bits);
    samples += u64(frame.columns * (frame.rows + 1) + 1) / 2 + frame.rows;
  }
  return samples;
}

// ---- 6.5. Lengths are doubled, in 2 * one a texel, so that the borders of places are whole numbers.

struct Triangle {
  i64 u[3], v[3], texel;
  Triangle(const GeometryUnit& unit, size_t face, int fraction_bits) : texel(1ll << fraction_bits) {
    for (int i = 0; i < 3; i++) {
      u[i] = 2 * i64(unit.uv[2 * size_t(unit.corner[3 * face + i])]);
      v[i] = 2 * i64(unit.uv[2 * size_t(unit.corner[3 * face + i]) + 1]);
    }
  }
  i64 first_row() const { return floor_div(*std::min_element(v, v + 3) - 3 * texel, 2 * texel) + 1; }
  i64 last_row() const { return floor_div(*std::max_element(v, v + 3) + texel - 1, 2 * texel); }

  // The places of row j from `first` to `last`: the triangle's part between the borders of the row's squares reaches from one u to
  // another, and these are at corners or where edges cross a border.
  void run(i64 j, i64& first, i64& last) const {
    i64 low = (2 * j - 1) * texel, high = (2 * j + 3) * texel;
    first = INT64_MAX;
    last = INT64_MIN;
    auto meet = [&](i64 a, i64 b) {  // u = a / b
      first = std::min(first, floor_div(a - 3 * texel * b, 2 * texel * b) + 1);
      last = std::max(last, floor_div(a + texel * b - 1, 2 * texel * b));
    };
    for (int i = 0; i < 3; i++) {
      if (v[i] >= low && v[i] <= high) meet(u[i], 1);
      int k = (i + 1) % 3, from = v[i] < v[k] ? i : k, to = v[i] < v[k] ? k : i;
      i64 rise = v[to] - v[from];
      for (i64 border : {low, high})
        if (v[from] < border && border < v[to]) meet(u[from] * rise + (u[to] - u[from]) * (border - v[from]), rise);
    }
  }
};

i64 wrapped(int mode, i64 i, i64 size) {  // 6.5.3
  if (mode == 0) return floor_mod(i, size);
  if (mode == 1) return clip(0, size - 1, i);
  i64 t = floor_mod(i, 2 * size);
  return t < size ? t : 2 * size - 1 - t;
}

class Image {  // one bit a texel
 public:
  Image(i64 width, i64 height) : words_((width + 63) / 64), width_(width), height_(height), bits_(size_t(words_) * height, 0) {}
  void fill(i64 y, i64 first, i64 last) {
    u64* row = &bits_[size_t(words_) * y];
    u64 begin = ~0ull << (first & 63), end = ~0ull >> (63 - (last & 63));
    if (first / 64 == last / 64) {
      row[first / 64] |= begin & end;
      return;
    }
    row[first / 64] |= begin;
    for (i64 n = first / 64 + 1; n < last / 64; n++) row[n] = ~0ull;
    row[last / 64] |= end;
  }
  void merge(const Image& other) {
    for (size_t n = 0; n < bits_.size(); n++) bits_[n] |= other.bits_[n];
  }

  // side: squares of 8 x 8 a side, as a power of two
  std::vector<u64> keys(int side) const {
    u64 within[64], count = 0;  // a square
    for (u64 n = 0; n < 64; n++) within[n] = morton_key(even_bits(n), even_bits(n >> 1), 0);
    for (u64 word : bits_) count += u64(ones(word));
    std::vector<u64> out;
    out.reserve(count);
    for (u64 square = 0; square < 1ull << (2 * side); square++) {
      u64 x = even_bits(square), y = even_bits(square >> 1), listed[64];
      if (x * 8 >= u64(width_) || y * 8 >= u64(height_)) continue;
      int number = 0;
      for (u64 left = texels(x, y), first = morton_key(8 * x, 8 * y, 0); left; left &= left - 1) listed[number++] = first + within[__builtin_ctzll(left)];
      out.insert(out.end(), listed, listed + number);
    }
    return out;
  }

 private:
  static u64 even_bits(u64 v) {
    v &= 0x55555555;
    v = (v | v >> 1) & 0x33333333;
    v = (v | v >> 2) & 0x0f0f0f0f;
    v = (v | v >> 4) & 0x00ff00ff;
    return (v | v >> 8) & 0xffff;
  }
  static int ones(u64 v) {
    v -= v >> 1 & 0x5555555555555555;
    v = (v & 0x3333333333333333) + (v >> 2 & 0x3333333333333333);
    return int(((v + (v >> 4)) & 0x0f0f0f0f0f0f0f0f) * 0x0101010101010101 >> 56);
  }
  u64 texels(u64 x, u64 y) const {  // of square (x, y), in Morton order
    static const u8 place[8] = {0, 2, 8, 10, 32, 34, 40, 42};
    u64 out = 0;
    for (u64 v = 0; v < 8 && 8 * y + v < u64(height_); v++) {
      u64 row = bits_[size_t(words_) * (8 * y + v) + x / 8] >> (8 * x & 63) & 255;
      row = (row | row << 12) & 0xf000f;
      out |= ((row | row << 2) & 0x330033) << place[v];
    }
    return out;
  }
  i64 words_, width_, height_;
  std::vector<u64> bits_;
};

void fill_wrapped(Image& image, i64 y, i64 first, i64 last, int mode, i64 width) {
  if (mode == 1) return image.fill(y, clip(0, width - 1, first), clip(0, width - 1, last));
  if (last - first + 1 >= (mode == 0 ? width : 2 * width)) return image.fill(y, 0, width - 1);
  while (first <= last) {  // at most three pieces
    i64 turn = floor_div(first, width), until = std::min(last, turn * width + width - 1), a = first - turn * width, b = until - turn * width;
    if (mode == 2 && (turn & 1)) image.fill(y, width - 1 - b, width - 1 - a);
    else image.fill(y, a, b);
    first = until + 1;
  }
}

}  // namespace

void count_samples(Asset& asset) {
  u64 samples = 0;
  const AttributeUnit* neural = asset.attributes.size() == 1 && asset.attributes[0].codec == NEURAL ? &asset.attributes[0] : nullptr;
  for (const Field& field : asset.fields)
    if (field.planar) samples += u64(field.width) * field.height / 16;
  for (const GeometryUnit& unit : asset.units) {
    const Field& field = asset.fields[unit.field];
    if (field.planar) {
      for (size_t f = 0; f < unit.num_faces(); f++) {
        Triangle triangle(unit, f, field.fraction_bits);
        samples += triangle.last_row() - triangle.first_row() + 1;
      }
    } else {
      samples += samples_of_voxels(asset, unit, field.resolution);
      for (size_t l = 0; neural && l < neural->levels.size(); l++)
        if (neural->levels[l].table_log2 == 0) samples += samples_of_voxels(asset, unit, neural->levels[l].resolution);
    }
    within(samples, asset.limits.samples, L05, "samples");
  }
}

namespace {

// Calls what(unit, face) for the faces of a field from the first to the one before `end`, counted over all units.
template <typename What>
void for_faces(const Asset& asset, size_t field, size_t first, size_t end, const What& what) {
  size_t at = 0;
  for (const GeometryUnit& unit : asset.units) {
    if (unit.field != field) continue;
    for (size_t f = first > at ? first - at : 0; f < unit.num_faces() && at + f < end; f++) what(unit, f);
    at += unit.num_faces();
  }
}

// Sums of parts, each of a share of a field's faces: what(part, unit, face).
template <typename Part, typename What>
Part sum_of_faces(const Asset& asset, size_t field, int threads, const Part& none, const What& what) {
  size_t faces = 0;
  for (const GeometryUnit& unit : asset.units) faces += unit.field == field ? unit.num_faces() : 0;
  std::vector<Part> parts(size_t(std::max(1, threads)), none);
  side_by_side(threads, parts.size(), [&](size_t n) {
    for_faces(asset, field, faces * n / parts.size(), faces * (n + 1) / parts.size(), [&](const GeometryUnit& unit, size_t f) { what(parts[n], unit, f); });
  });
  for (size_t n = 1; n < parts.size(); n++) parts[0].merge(parts[n]);
  return std::move(parts[0]);
}

}  // namespace

std::vector<u64> active_voxels(const Asset& asset, size_t field, int resolution, int threshold, int threads) {
  auto keys_of = [&](const auto& none) {
    return sum_of_faces(asset, field, threads, none, [&](auto& weights, const GeometryUnit& unit, size_t f) {
      add_face(weights, frame_of(unit, f, resolution, asset.position_bits), resolution);
    }).keys();
  };
  i64 least = i64(threshold) << 24;
  return threshold < 256 ? keys_of(Weights<u32>(least, asset.limits.voxels)) : keys_of(Weights<u64>(least, asset.limits.voxels));
}

std::vector<u64> referenced_texels(const Asset& asset, size_t index, int threads) {
  const Field& field = asset.fields[index];
  Image image = sum_of_faces(asset, index, threads, Image(field.width, field.height), [&](Image& part, const GeometryUnit& unit, size_t f) {
    Triangle triangle(unit, f, field.fraction_bits);
    if (f % 64 == 0) check_stop();
    for (i64 j = triangle.first_row(), end = triangle.last_row(); j <= end; j++) {
      i64 first, last;
      triangle.run(j, first, last);
      fill_wrapped(part, wrapped(field.wrap[1], j, field.height), first, last, field.wrap[0], field.width);
    }
  });
  return image.keys(bit_length((field.resolution + 7) / 8 - 1));
}

// ---- 8.4

namespace {

struct Corners {  // of all faces of all units, one after the other
  std::vector<std::array<u32, 3>> place;  // ranks of the corners' positions in the order of z, y, x
  std::vector<u32> material;
  std::vector<std::array<i32, 3>> position;  // by rank, x, y, z

  explicit Corners(const Asset& asset) {
    std::vector<u64> places;
    size_t count = 0;
    for (const GeometryUnit& unit : asset.units) {
      for (size_t v = 0; v < unit.position.size() / 3; v++) places.push_back(key(&unit.position[3 * v]));
      count += unit.num_faces();
    }
    sort_keys(places);
    places.erase(std::unique(places.begin(), places.end()), places.end());
    for (u64 p : places) position.push_back({i32(p & 0xfffff), i32(p >> 20 & 0xfffff), i32(p >> 40)});
    place.reserve(count);
    for (const GeometryUnit& unit : asset.units) {
      std::vector<u32> rank(unit.position.size() / 3);
      for (size_t v = 0; v < rank.size(); v++)
        rank[v] = u32(std::lower_bound(places.begin(), places.end(), key(&unit.position[3 * v])) - places.begin());
      for (size_t f = 0; f < unit.num_faces(); f++) {
        place.push_back({rank[unit.corner[3 * f]], rank[unit.corner[3 * f + 1]], rank[unit.corner[3 * f + 2]]});
        material.push_back(unit.material);
      }
    }
  }
  size_t faces() const { return place.size(); }
  bool whole(size_t f) const { return place[f][0] != place[f][1] && place[f][1] != place[f][2] && place[f][0] != place[f][2]; }
  int corner_at(size_t f, u32 rank) const { return place[f][0] == rank ? 0 : place[f][1] == rank ? 1 : 2; }

 private:
  static u64 key(const u32* p) { return u64(p[2]) << 40 | u64(p[1]) << 20 | p[0]; }
};

using Vector = std::array<i64, 3>;

i64 dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
Vector difference(const Corners& corners, u32 from, u32 to) {
  const auto &a = corners.position[from], &b = corners.position[to];
  return {i64(b[0]) - a[0], i64(b[1]) - a[1], i64(b[2]) - a[2]};
}
Vector brought(Vector v) {  // to 14 bits
  int shift = bit_length(std::max(magnitude(v[0]), std::max(magnitude(v[1]), magnitude(v[2])))) - 14;
  for (i64& component : v) component = shift > 0 ? component >> shift : component * (1ll << -shift);
  return v;
}
Vector unit_of(Vector v) {
  i64 length = std::max<i64>(1, isqrt(dot(v, v)));
  for (i64& component : v) component = floor_div(component * (1 << 14), length);
  return v;
}
Vector normal_of(const Corners& corners, size_t f) {
  const auto& p = corners.place[f];
  return brought(cross(difference(corners, p[0], p[1]), difference(corners, p[0], p[2])));
}

struct Edge {
  u32 lesser, greater, face;
  bool same(const Edge& o) const { return lesser == o.lesser && greater == o.greater; }
};

// Sorts items by key(item), a number below `end`; what has the same key keeps its order.
template <typename Item, typename Key>
void sort_by(std::vector<Item>& items, size_t end, const Key& key) {
  std::vector<u32> next(end + 1, 0);
  for (const Item& item : items) next[key(item) + 1]++;
  for (size_t n = 0; n < end; n++) next[n + 1] += next[n];
  std::vector<Item> sorted(items.size());
  for (const Item& item : items) sorted[next[key(item)]++] = item;
  items.swap(sorted);
}

std::vector<Edge> edges_of(const Corners& corners) {  // an entry for every face, sorted by positions, then by face
  std::vector<Edge> edges;
  edges.reserve(3 * corners.faces());
  for (size_t f = 0; f < corners.faces(); f++)
    for (int i = 0; i < 3 && corners.whole(f); i++) {
      u32 a = corners.place[f][i], b = corners.place[f][(i + 1) % 3];
      edges.push_back({std::min(a, b), std::max(a, b), u32(f)});
    }
  sort_by(edges, corners.position.size(), [](const Edge& edge) { return edge.greater; });
  sort_by(edges, corners.position.size(), [](const Edge& edge) { return edge.lesser; });
  return edges;
}

double cosine(double angle) {  // of 0 to pi, to 1e-14: that of a fourth by its series, doubled twice; the C library's takes 9 kB of a page
  double square = angle * angle / 16, c = 1;
  for (int n = 18; n > 0; n -= 2) c = 1 - square * c / (n * (n - 1));
  for (int times = 0; times < 2; times++) c = 2 * c * c - 1;
  return c;
}

// Calls what(first entry, one after the last, number of the mark or -1) for every edge of 2 to 8 faces, in order.
template <typename What>
void for_each_edge(const Asset& asset, const Corners& corners, const std::vector<Edge>& edges, What what) {
  i64 marks = 0;
  for (size_t a = 0, b; a < edges.size(); a = b) {
    bool marked = false;
    for (b = a; b < edges.size() && edges[b].same(edges[a]); b++)
      marked = marked || asset.materials[corners.material[edges[b].face]].normal_rule >= 3;
    if (b - a >= 2 && b - a <= 8) what(a, b, marked ? marks++ : -1);
  }
}

int fold_of(const Corners& corners, const std::vector<Edge>& edges, size_t a, size_t b) {  // 8.4.2
  if (b - a > 2) return 13;
  Vector n = normal_of(corners, edges[a].face), m = normal_of(corners, edges[a + 1].face);
  if (dot(n, n) == 0 || dot(m, m) == 0) return 12;
  static const i64 steps[10] = {4090, 4065, 3973, 3617, 3072, 2404, 1692, 1024, 274, 4};
  i64 d = dot(n, m), q = d * d / ((dot(n, n) * dot(m, m)) >> 12);
  int fold = 0;
  for (i64 step : steps) fold += step > q;
  return fold < 10 && d < 0 ? 11 : fold;
}

u32 root_of(std::vector<u32>& above, u32 n) {
  while (above[n] != n) n = above[n] = above[above[n]];
  return n;
}
void join(std::vector<u32>& above, u32 a, u32 b) { above[root_of(above, a)] = root_of(above, b); }

std::vector<u32> alone(size_t count) {
  std::vector<u32> above(count);
  for (size_t n = 0; n < count; n++) above[n] = u32(n);
  return above;
}

void join_corners(const Corners& corners, std::vector<u32>& above, const Edge& edge, u32 other) {
  for (u32 rank : {edge.lesser, edge.greater})
    join(above, 3 * edge.face + corners.corner_at(edge.face, rank), 3 * other + corners.corner_at(other, rank));
}

std::array<u32, 3> oriented(const Corners& corners, size_t f) {  // a face's positions, from the least on
  const auto& p = corners.place[f];
  int least = int(std::min_element(p.begin(), p.end()) - p.begin());
  return {p[least], p[(least + 1) % 3], p[(least + 2) % 3]};
}

constexpr u32 NO_GROUP = 0xffffffff;

// 8.4.3: the number of every corner's group, NO_GROUP where it is in none that has a coded normal; and their number.
std::vector<u32> corner_groups(const Asset& asset, const Corners& corners, const std::vector<Edge>& edges, u32* count) {
  std::vector<u32> above = alone(3 * corners.faces());
  for_each_edge(asset, corners, edges, [&](size_t a, size_t b, i64 mark) {
    if (mark >= 0 && asset.marks[mark]) return;
    for (size_t i = a; i < b; i++)
      for (size_t k = i + 1; k < b; k++)
        if (b - a == 2 || dot(normal_of(corners, edges[i].face), normal_of(corners, edges[k].face)) >= 0)
          join_corners(corners, above, edges[i], edges[k].face);
  });
  std::vector<u32> order;
  for (size_t f = 0; f < corners.faces(); f++)
    if (corners.whole(f)) order.push_back(u32(f));
  for (int i : {2, 1, 0}) sort_by(order, corners.position.size(), [&](u32 f) { return oriented(corners, f)[i]; });
  for (size_t n = 1; n < order.size(); n++)
    if (oriented(corners, order[n]) == oriented(corners, order[n - 1]))
      for (u32 rank : corners.place[order[n]])
        join(above, 3 * order[n] + corners.corner_at(order[n], rank), 3 * order[n - 1] + corners.corner_at(order[n - 1], rank));
  std::vector<u32> asking;  // corners, by position and then by face
  for (u32 f : order)
    for (u32 i = 0; i < 3 && asset.materials[corners.material[f]].normal_rule == 6; i++) asking.push_back(3 * f + i);
  sort_by(asking, corners.position.size(), [&](u32 corner) { return corners.place[corner / 3][corner % 3]; });
  std::vector<u32> of_root(above.size(), NO_GROUP), group(above.size(), NO_GROUP);
  *count = 0;
  for (u32 corner : asking) {
    u32& number = of_root[root_of(above, corner)];
    if (number == NO_GROUP) number = (*count)++;
  }
  for (u32 f : order)
    for (u32 i = 0; i < 3; i++) group[3 * f + i] = of_root[root_of(above, 3 * f + i)];
  return group;
}

i64 coded_number(RangeDecoder& decoder, std::vector<Context>& table, int m, int zero) {  // 8.4.4
  if (!decoder.bit(table[17 * m + zero])) return 0;
  int negative = decoder.bypass();
  i64 v = 1;
  while (v <= 14 && decoder.bit(table[17 * m + 3 + v - 1])) v++;
  if (v == 15) {
    int k = 0;
    while (k < 12 && decoder.bit(table[153 + k])) k++;
    i64 rest = 1;
    while (k-- > 0) rest = 2 * rest + decoder.bypass();
    v += rest - 1;
  }
  return negative ? -v : v;
}

Vector bent(Vector z, i64 i, i64 j, i64 step) {
  int axis = 0;
  for (int k = 1; k < 3; k++)
    if (magnitude(z[k]) < magnitude(z[axis])) axis = k;
  Vector e = {axis == 0, axis == 1, axis == 2}, x = unit_of(cross(z, e)), y = cross(z, x);
  for (i64& component : y) component >>= 14;
  i64 p = i * step, q = j * step, r = (p * p + q * q) >> 14;
  Vector sum;
  for (int k = 0; k < 3; k++) sum[k] = 2 * p * x[k] + 2 * q * y[k] + ((1 << 14) - r) * z[k];
  return unit_of(brought(sum));
}

}  // namespace

void decode_marks(Asset& asset) {
  Corners corners(asset);
  std::vector<Edge> edges = edges_of(corners);
  u64 count = 0;
  for_each_edge(asset, corners, edges, [&](size_t, size_t, i64 mark) { count += mark >= 0; });
  require_equal(count, asset.num_edges, S30, "num_edges does not match");
  RangeDecoder decoder(asset.marks_data.data, asset.marks_data.size);
  std::vector<Context> table(2016);
  std::vector<std::array<u32, 2>> met(corners.position.size(), {0, 0});  // edges and sharp ones
  for_each_edge(asset, corners, edges, [&](size_t first, size_t last, i64 number) {
    if (number < 0) return;
    auto &a = met[edges[first].lesser], &b = met[edges[first].greater];
    u32 s = std::min(2u, std::min(a[1], b[1])) * 3 + std::min(2u, std::max(a[1], b[1]));
    u32 c = std::min(3u, std::min(a[0], b[0])) * 4 + std::min(3u, std::max(a[0], b[0]));
    u32 mark = decoder.bit(table[(fold_of(corners, edges, first, last) * 9 + s) * 16 + c]);
    for (auto* end : {&a, &b}) {
      (*end)[0]++;
      (*end)[1] += mark;
    }
    asset.marks.push_back(u8(mark));
  });
  require(crc32(asset.marks.data(), asset.marks.size()) == asset.marks_crc, S32, "marks_crc does not match");
}

void decode_normals(Asset& asset) {
  Corners corners(asset);
  u32 count = 0;
  std::vector<u32> group = corner_groups(asset, corners, edges_of(corners), &count);
  require_equal(count, asset.num_groups, S30, "num_groups does not match");
  std::vector<Vector> z(count, Vector{0, 0, 0});
  std::vector<u32> begin(count + 1, 0), members;  // corners of every group
  for (u32 g : group)
    if (g != NO_GROUP) begin[g + 1]++;
  for (u32 g = 0; g < count; g++) begin[g + 1] += begin[g];
  members.resize(begin[count]);
  std::vector<u32> next(begin.begin(), begin.end() - 1);
  for (u32 corner = 0; corner < group.size(); corner++)
    if (group[corner] != NO_GROUP) members[next[group[corner]]++] = corner;
  for (u32 corner : members) {
    const auto& p = corners.place[corner / 3];
    u32 here = p[corner % 3];
    Vector u = brought(difference(corners, here, p[(corner % 3 + 1) % 3]));
    Vector w = brought(difference(corners, here, p[(corner % 3 + 2) % 3])), n = unit_of(normal_of(corners, corner / 3));
    i64 s = isqrt(dot(cross(u, w), cross(u, w))), d = dot(u, w), t = (s << 12) / std::max<i64>(1, s + magnitude(d));
    i64 a = t + ((3 * t * (4096 - t) * (2 * t - 4096)) >> 27), angle = d < 0 ? 8192 - a : a;
    for (int k = 0; k < 3; k++) z[group[corner]][k] += angle * n[k];
  }
  RangeDecoder decoder(asset.residual_data.data, asset.residual_data.size);
  std::vector<Context> table(165);
  std::vector<u32> size(count, 0);
  for (u32 g = 0; g < count; g++) {
    u64 sum = 0, known = 0;
    for (u32 at = begin[g]; at < begin[g + 1]; at++)
      for (u32 turn = 1; turn < 3; turn++) {
        u32 other = group[members[at] / 3 * 3 + (members[at] % 3 + turn) % 3];
        if (other >= g) continue;  // NO_GROUP with them
        sum += size[other];
        known++;
      }
    int m = known == 0 ? 8 : std::min(7, bit_length(2 * sum / known));
    i64 i = coded_number(decoder, table, m, 0), j = coded_number(decoder, table, m, i != 0 ? 2 : 1);
    size[g] = u32(magnitude(i) + magnitude(j));
    bool none = z[g] == Vector{0, 0, 0};
    for (i64 component : bent(none ? Vector{0, 0, 1 << 14} : unit_of(brought(z[g])), i, j, asset.normal_step))
      asset.normals.push_back(i16(component));
  }
  require(crc32(asset.normals.data(), 2 * asset.normals.size()) == asset.normals_crc, S32, "normals_crc does not match");
}

std::vector<std::vector<float>> shading_normals(const Asset& asset) {
  using Real = std::array<double, 3>;
  Corners corners(asset);
  std::vector<Edge> edges = edges_of(corners);
  std::vector<Real> normal(corners.faces());  // of length 1, 0 without area
  std::vector<double> area(corners.faces());
  for (size_t f = 0; f < corners.faces(); f++) {
    const auto& p = corners.place[f];
    Vector n = cross(difference(corners, p[0], p[1]), difference(corners, p[0], p[2]));
    area[f] = std::sqrt(double(n[0]) * n[0] + double(n[1]) * n[1] + double(n[2]) * n[2]);
    for (int k = 0; k < 3; k++) normal[f][k] = area[f] > 0 ? n[k] / area[f] : 0;
  }
  auto angle_at = [&](size_t corner) {
    const auto& p = corners.place[corner / 3];
    Vector u = difference(corners, p[corner % 3], p[(corner % 3 + 1) % 3]), w = difference(corners, p[corner % 3], p[(corner % 3 + 2) % 3]);
    return std::atan2(area[corner / 3], double(dot(u, w)));
  };
  std::vector<std::array<float, 3>> found(3 * corners.faces());
  std::vector<u32> group(found.size(), NO_GROUP);
  u32 count;
  if (asset.has_normals) group = corner_groups(asset, corners, edges, &count);
  std::vector<bool> done(asset.materials.size(), false);
  for (size_t first = 0; first < asset.materials.size(); first++) {  // all materials of one rule at once
    if (done[first]) continue;
    int rule = asset.materials[first].normal_rule, angle = asset.materials[first].normal_angle;
    std::vector<bool> chosen(asset.materials.size(), false);
    for (size_t m = first; m < chosen.size(); m++)
      if (asset.materials[m].normal_rule == rule && asset.materials[m].normal_angle == angle) chosen[m] = done[m] = true;
    std::vector<u32> above = alone(found.size());
    double least = cosine(angle * 0.017453292519943295) - 1e-12;
    if (rule < 6 && angle > 0)
      for_each_edge(asset, corners, edges, [&](size_t a, size_t b, i64 mark) {
        if (rule >= 3 && mark >= 0 && asset.marks[mark]) return;
        for (size_t i = a; i < b; i++)
          for (size_t k = i + 1; k < b; k++) {
            const Real &n = normal[edges[i].face], &m = normal[edges[k].face];
            if (n[0] * m[0] + n[1] * m[1] + n[2] * m[2] >= least) join_corners(corners, above, edges[i], edges[k].face);
          }
      });
    std::vector<Real> sum(found.size(), Real{0, 0, 0});
    for (size_t corner = 0; corner < found.size(); corner++) {
      if (area[corner / 3] == 0) continue;
      double weight = rule % 3 == 0 ? area[corner / 3] : angle_at(corner) * (rule % 3 == 2 ? area[corner / 3] : 1);
      u32 root = root_of(above, u32(corner));
      for (int k = 0; k < 3; k++) sum[root][k] += weight * normal[corner / 3][k];
    }
    for (size_t corner = 0; corner < found.size(); corner++) {
      if (!chosen[corners.material[corner / 3]]) continue;
      Real n = rule == 6 || angle == 0 ? normal[corner / 3] : sum[root_of(above, u32(corner))];
      if (rule == 6 && group[corner] != NO_GROUP)
        for (int k = 0; k < 3; k++) n[k] = asset.normals[3 * size_t(group[corner]) + k];
      double length = std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
      if (length < 1e-300) n = normal[corner / 3], length = area[corner / 3] > 0 ? 1 : 0;
      if (length == 0) n = {0, 0, 1}, length = 1;
      for (int k = 0; k < 3; k++) found[corner][k] = float(n[k] / length);
    }
  }
  std::vector<std::vector<float>> out;
  size_t at = 0;
  for (const GeometryUnit& unit : asset.units) {
    const float* from = at < found.size() ? found[at].data() : nullptr;
    out.emplace_back(from, from + 9 * unit.num_faces());
    at += 3 * unit.num_faces();
  }
  return out;
}

}  // namespace texf
