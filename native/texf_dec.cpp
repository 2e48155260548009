// The decoder as a command, as conformance/run.py asks of any:  texf_dec IN.texf OUT_DIR [--lod L] [--queries FILE] [--threads N]
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <sys/stat.h>

#include "core.hpp"

using namespace texf;

namespace {

using Real = long double;  // what 8.2 tells apart is finer than binary64
using Point3 = std::array<Real, 3>;

bool read_file(const char* path, std::vector<u8>& out) {
  FILE* file = fopen(path, "rb");
  if (!file) return false;
  u8 part[65536];
  for (size_t n; (n = fread(part, 1, sizeof part, file)) > 0;) out.insert(out.end(), part, part + n);
  fclose(file);
  return true;
}

void write_file(const std::string& folder, const std::string& name, const void* data, size_t size) {
  FILE* file = fopen((folder + "/" + name + ".bin").c_str(), "wb");
  if (!file || (size > 0 && fwrite(data, 1, size, file) != size) || fclose(file) != 0) {
    fprintf(stderr, "%s: cannot be written\n", name.c_str());
    exit(2);
  }
}

// ---- Clause 9: rows of all triangles, canonical and sorted

using Row = std::array<i64, 17>;

std::vector<Row> rows_of(const Asset& asset, int columns, i64 only_field) {
  std::vector<Row> rows;
  for (const GeometryUnit& unit : asset.units)
    for (size_t f = 0; (only_field < 0 || i64(unit.field) == only_field) && f < unit.num_faces(); f++) {
      Row least{};
      for (int turn = 0; turn < 3; turn++) {
        Row row{};
        row[0] = unit.field;
        row[1] = unit.material;
        for (int i = 0; i < 3; i++) {
          size_t vertex = unit.corner[3 * f + (turn + i) % 3];
          for (int axis = 0; axis < columns; axis++)
            row[2 + columns * i + axis] = axis < 3 ? i64(unit.position[3 * vertex + axis]) : unit.uv[2 * vertex + axis - 3];
        }
        if (turn == 0 || row < least) least = row;
      }
      rows.push_back(least);
    }
  std::sort(rows.begin(), rows.end());
  return rows;
}

void write_rows(const std::string& folder, const std::string& name, const std::vector<Row>& rows, int columns) {
  std::vector<i64> numbers;
  for (const Row& row : rows) numbers.insert(numbers.end(), row.begin(), row.begin() + 2 + 3 * columns);
  write_file(folder, name, numbers.data(), 8 * numbers.size());
}

// ---- Clause 8.2

struct Query {
  i64 field, triangle;
  double point[3];
};

Real dot(const Point3& a, const Point3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Point3 minus(const Point3& a, const Point3& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }

// Squared distance and weights of the point of a triangle that is nearest to p.
Real nearest_on_face(const Point3& p, const Point3 corner[3], Real weight[3]) {
  Point3 u = minus(corner[1], corner[0]), v = minus(corner[2], corner[0]), d = minus(p, corner[0]);
  Real uu = dot(u, u), uv = dot(u, v), vv = dot(v, v), ud = dot(u, d), vd = dot(v, d), area = uu * vv - uv * uv;
  Real second = vv * ud - uv * vd, third = uu * vd - uv * ud;
  Real best = INFINITY;
  auto consider = [&](Real a, Real b, Real c) {
    Point3 away;
    for (int axis = 0; axis < 3; axis++) away[axis] = a * (corner[0][axis] - p[axis]) + b * (corner[1][axis] - p[axis]) + c * (corner[2][axis] - p[axis]);
    Real square = dot(away, away);
    if (square >= best) return;
    best = square;
    weight[0] = a, weight[1] = b, weight[2] = c;
  };
  if (area > 0 && second >= 0 && third >= 0 && second + third <= area) {
    consider(1 - second / area - third / area, second / area, third / area);
    return best;
  }
  for (int a = 0; a < 3; a++) {
    int b = (a + 1) % 3;
    Point3 along = minus(corner[b], corner[a]);
    Real length = dot(along, along), t = length > 0 ? dot(minus(p, corner[a]), along) / length : 0, w[3] = {0, 0, 0};
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    w[a] = 1 - t;
    w[b] += t;
    consider(w[0], w[1], w[2]);
  }
  return best;
}

class Answers {
 public:
  explicit Answers(const Asset& asset) : asset_(asset) {
    for (size_t i = 0; i < asset.fields.size(); i++) faces_.push_back(rows_of(asset, asset.fields[i].planar ? 5 : 3, i64(i)));
    if (asset.attributes.size() == 1 && asset.attributes[0].codec == NEURAL) network_ = std::make_unique<Network>(asset.attributes[0]);
  }

  std::vector<std::vector<double>> answer(const Query& query) {  // by group
    Real last = Real((1ll << asset_.position_bits) - 1);
    Point3 lattice{0, 0, 0};
    for (int axis = 0; axis < 3 && asset_.side > 0; axis++) lattice[axis] = (Real(query.point[axis]) - asset_.origin[axis]) / asset_.side * last;
    i64 field = query.field, triangle = query.triangle;
    if (field < 0) {
      Real best = INFINITY;
      for (size_t i = 0; i < faces_.size(); i++)
        for (size_t f = 0; f < faces_[i].size(); f++) {
          Real weight[3], away = nearest(lattice, i, f, weight);
          if (away < best) best = away, field = i64(i), triangle = i64(f);
        }
    }
    std::vector<std::vector<double>> out;
    std::vector<i32> of_network;
    if (network_) {
      i64 position[3];
      double cells = std::ldexp(1.0, asset_.position_bits), scale = (cells - 1) * (16777216.0 / cells);
      for (int axis = 0; axis < 3; axis++) {
        double x = asset_.side > 0 ? (query.point[axis] - asset_.origin[axis]) / asset_.side * scale : 0;
        position[axis] = i64(std::floor(x < 0 ? 0 : x > 16777215 ? 16777215 : x));
      }
      of_network.resize(network_->outputs());
      network_->answer(size_t(field), position, of_network.data());
    }
    size_t output = 0;
    for (size_t g = 0; g < asset_.groups.size(); g++) {
      int count = asset_.groups[g].components;
      std::vector<double> group_values(count, NAN);
      if (network_)
        for (double& v : group_values) v = of_network[output++] / 256.0;
      else if (!asset_.values[field][g].empty() && asset_.fields[field].planar)
        of_texels(lattice, size_t(field), g, size_t(triangle), group_values);
      else if (!asset_.values[field][g].empty())
        of_voxels(lattice, size_t(field), g, group_values);
      out.push_back(group_values);
    }
    return out;
  }

 private:
  Real nearest(const Point3& lattice, size_t field, size_t face, Real weight[3]) const {
    int columns = asset_.fields[field].planar ? 5 : 3;
    const Row& row = faces_[field][face];
    Point3 corner[3];
    for (int i = 0; i < 3; i++)
      for (int axis = 0; axis < 3; axis++) corner[i][axis] = row[2 + columns * i + axis];
    return nearest_on_face(lattice, corner, weight);
  }

  int level(size_t field, size_t group) const {
    return std::max(asset_.levels_left_out(field), int(asset_.level_shift[field * asset_.groups.size() + group]));
  }
  const std::vector<u64>& cells(size_t field, int level) {
    auto& kept = cells_[{field, level}];
    if (kept.empty()) kept = asset_.cells(field, level);
    return kept;
  }
  const u8* value_at(size_t field, size_t group, u64 key) {
    const auto& keys = cells(field, level(field, group));
    auto at = std::lower_bound(keys.begin(), keys.end(), key);
    if (at == keys.end() || *at != key) return nullptr;
    return &asset_.values[field][group][(at - keys.begin()) * asset_.groups[group].components];
  }

  void of_voxels(const Point3& lattice, size_t field, size_t group, std::vector<double>& out) {  // 8.2.1
    int lod = level(field, group);
    Real x[3], total = 0;
    std::vector<Real> sum(out.size(), 0);
    i64 base[3];
    for (int axis = 0; axis < 3; axis++) {
      x[axis] = lattice[axis] * asset_.fields[field].resolution / std::ldexp(Real(1), asset_.position_bits + lod);
      x[axis] = (x[axis] < -1e6L ? -1e6L : x[axis] > 1e6L ? 1e6L : x[axis]) - 0.5L;
      base[axis] = i64(std::floor(x[axis]));
    }
    for (int corner = 0; corner < 8; corner++) {
      Real weight = 1;
      bool inside = true;
      u64 at[3];
      for (int axis = 0; axis < 3; axis++) {
        int d = corner >> axis & 1;
        Real f = x[axis] - base[axis];
        weight *= d ? f : 1 - f;
        inside = inside && base[axis] + d >= 0 && base[axis] + d < 8192;
        at[axis] = u64(base[axis] + d);
      }
      const u8* value = inside && weight > 0 ? value_at(field, group, morton_key(at[0], at[1], at[2])) : nullptr;
      if (!value) continue;
      total += weight;
      for (size_t c = 0; c < sum.size(); c++) sum[c] += weight * value[c];
    }
    const u8* nearest = nullptr;
    if (total == 0) {
      const auto& keys = cells(field, lod);
      Real best = INFINITY;
      for (size_t n = 0; n < keys.size(); n++) {
        Real square = 0;
        for (int axis = 0; axis < 3; axis++) square += (Real(gathered_bits(keys[n] >> axis)) - x[axis]) * (Real(gathered_bits(keys[n] >> axis)) - x[axis]);
        if (square < best) best = square, nearest = &asset_.values[field][group][n * sum.size()];
      }
    }
    for (size_t c = 0; c < sum.size(); c++) out[c] = double(nearest ? Real(nearest[c]) : sum[c] / total);
  }

  void of_texels(const Point3& lattice, size_t number, size_t group, size_t face, std::vector<double>& out) {  // 8.2.2
    const Field& field = asset_.fields[number];
    Real weight[3];
    nearest(lattice, number, face, weight);
    int lod = level(number, group), size[2] = {field.width, field.height};
    i64 beside[2][2];
    Real part[2][2];
    for (int axis = 0; axis < 2; axis++) {
      Real u = 0;
      for (int i = 0; i < 3; i++) u += weight[i] * faces_[number][face][2 + 5 * i + 3 + axis];
      u /= 1 << field.fraction_bits;
      int mode = field.wrap[axis], s = size[axis];
      Real t = u - 2 * s * std::floor(u / (2 * s));
      Real folded = mode == 0 ? u - s * std::floor(u / s) : mode == 1 ? (u < -1 ? -1 : u > s + 1 ? s + 1 : u) : t < s ? t : 2 * s - t;
      Real x = folded / (1 << lod) - 0.5L;
      i64 i = i64(std::floor(x)), count = ceil_div(s, 1ll << lod);
      for (int d = 0; d < 2; d++) {
        beside[axis][d] = mode == 0 ? floor_mod(i + d, count) : clip(0, count - 1, i + d);
        part[axis][d] = d ? x - i : 1 - (x - i);
      }
    }
    Real total = 0;
    std::vector<Real> sum(out.size(), 0);
    for (int corner = 0; corner < 4; corner++) {
      Real w = part[0][corner & 1] * part[1][corner >> 1];
      const u8* value = w > 0 ? value_at(number, group, morton_key(u64(beside[0][corner & 1]), u64(beside[1][corner >> 1]), 0)) : nullptr;
      if (!value) continue;
      total += w;
      for (size_t c = 0; c < sum.size(); c++) sum[c] += w * value[c];
    }
    for (size_t c = 0; c < sum.size(); c++) out[c] = total > 0 ? double(sum[c] / total) : 0;
  }

  struct Key {
    size_t field;
    int level;
    bool operator<(const Key& o) const { return field != o.field ? field < o.field : level < o.level; }
  };
  const Asset& asset_;
  std::vector<std::vector<Row>> faces_;  // of every field, as clause 9 orders them
  std::unique_ptr<Network> network_;
  std::map<Key, std::vector<u64>> cells_;
};

void write_arrays(texf_asset& asset, const std::string& folder) {
  size_t bytes;
  write_rows(folder, "geometry", rows_of(asset, 3, -1), 3);
  for (u32 i = 0; i < asset.fields.size(); i++) {
    std::string field = "field" + std::to_string(i);
    const void* keys = texf_array(&asset, TEXF_KEYS, i, 0, &bytes);
    write_file(folder, field + "_keys", keys, bytes);
    if (asset.fields[i].planar) write_rows(folder, field + "_uv", rows_of(asset, 5, i), 5);
    for (u32 g = 0; g < asset.groups.size(); g++)
      if (const void* values = texf_array(&asset, TEXF_VALUES, i, g, &bytes)) write_file(folder, field + "_group" + std::to_string(g) + "_values", values, bytes);
  }
  if (asset.has_marks) write_file(folder, "sharp_edges", asset.marks.data(), asset.marks.size());
  if (asset.has_normals) write_file(folder, "coded_normals", asset.normals.data(), 2 * asset.normals.size());
}

void write_answers(const Asset& asset, const std::string& folder, const std::vector<u8>& query_data) {
  Answers source(asset);
  std::vector<std::vector<double>> answers(asset.groups.size());
  for (size_t at = 0; at + 40 <= query_data.size(); at += 40) {
    Query query;
    memcpy(&query, &query_data[at], 40);
    auto values = source.answer(query);
    for (size_t g = 0; g < values.size(); g++) answers[g].insert(answers[g].end(), values[g].begin(), values[g].end());
  }
  for (size_t g = 0; g < answers.size(); g++) write_file(folder, "group" + std::to_string(g) + "_answers", answers[g].data(), 8 * answers[g].size());
}

}  // namespace

int main(int argc, char** argv) {
  const char *paths[2] = {}, *queries = nullptr;
  int lod = 0, count = 0, threads = 1;
  for (int i = 1; i < argc; i++) {
    std::string word = argv[i];
    if (word == "--lod" && i + 1 < argc) lod = atoi(argv[++i]);
    else if (word == "--threads" && i + 1 < argc) threads = atoi(argv[++i]);
    else if (word == "--queries" && i + 1 < argc) queries = argv[++i];
    else if (count < 2) paths[count++] = argv[i];
    else count = 3;
  }
  if (count < 1 || count > 2) {
    fprintf(stderr, "usage: texf_dec IN.texf [OUT_DIR] [--lod L] [--queries FILE] [--threads N]\n");
    return 1;
  }
  std::vector<u8> data, query_data;
  if (!read_file(paths[0], data) || (queries && !read_file(queries, query_data))) {
    fprintf(stderr, "%s: cannot be read\n", queries && !data.empty() ? queries : paths[0]);
    return 2;
  }
  texf_asset* asset;
  texf_refusal refusal;
  int code = texf_decode_threads(data.data(), data.size(), lod, nullptr, threads, &asset, &refusal);
  if (code != TEXF_OK) {
    fprintf(stderr, "TXF-%c%02d: %s\n", "---SCUL"[code], refusal.finding % 100, refusal.sentence);
    return code;
  }
  if (count == 2) {
    mkdir(paths[1], 0777);
    write_arrays(*asset, paths[1]);
    if (queries) write_answers(*asset, paths[1], query_data);
  } else {
    size_t bytes;
    const void* text = texf_array(asset, TEXF_DESCRIPTION, 0, 0, &bytes);
    fwrite(text, 1, bytes, stdout);
    putchar('\n');
  }
  texf_free(asset);
  return 0;
}
