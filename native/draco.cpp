// 5.6: a mesh of Draco's bitstream 2.2 with what the clause allows and no more: edgebreaker, by symbols or by valences; attributes
// of integers or of quantised floats, with every prediction that Draco's encoder has for them. A corner is 3 * face + 0, 1, 2.
#include <cmath>

#include "core.hpp"

namespace texf {

namespace {

constexpr u32 NONE = ~0u;

void need(bool holds) { require(holds, S22, "draco_data does not decode to a mesh"); }

// ---- Bytes, bits and symbols

struct Source {
  const u8 *at, *end;
  size_t left() const { return end - at; }
  const u8* take(u64 count) {
    need(count <= left());
    at += count;
    return at - count;
  }
  u32 byte() { return *take(1); }
  u32 word() {
    u32 value;
    memcpy(&value, take(4), 4);
    return value;
  }
  u64 count(int most_bytes) {
    u64 value = 0;
    for (int i = 0; i < most_bytes; i++) {
      u64 part = byte();
      value |= (part & 127) << (7 * i);
      if (part < 128) return value;
    }
    need(false);
    return 0;
  }
  u32 count() { return u32(count(5)); }  // what is above 32 bits has no influence
};

class Bits {  // the lowest of a byte first; 0 behind the last byte
 public:
  Bits() = default;
  explicit Bits(const Source& source) : data_(source.at), size_(source.left()) {}
  u32 read(u32 count) {  // of up to 32 bits
    u64 window = 0;
    memcpy(&window, data_ + (bit_ >> 3), std::min<size_t>(8, size_ - (bit_ >> 3)));
    window >>= bit_ & 7;
    bit_ = std::min(bit_ + count, 8 * size_);
    return u32(window & ((1ull << count) - 1));
  }
  size_t bytes() const { return (bit_ + 7) / 8; }

 private:
  const u8* data_ = nullptr;
  size_t size_ = 0, bit_ = 0;
};

struct Ans {  // a range asymmetric numeral system: its bytes are read from the last to the first
  const u8* data = nullptr;
  size_t left = 0;
  u32 state = 0;
  void start(const u8* bytes, u64 size, u32 least, size_t most_bytes) {
    need(size > 0);
    size_t length = 1 + (bytes[size - 1] >> 6);
    need(length <= most_bytes && length <= size);
    data = bytes;
    left = size - length;
    for (size_t i = length; i-- > 0;) state = state << 8 | bytes[left + i];
    state = (state & ~(3u << (8 * length - 2))) + least;
    need(state < least << 8);
  }
};

class CodedBits {
 public:
  CodedBits() = default;
  explicit CodedBits(Source& source) {
    one_ = u8(256 - source.byte());
    u32 size = source.count();
    ans_.start(source.take(size), size, 4096, 3);
  }
  bool read() {
    if (ans_.state < 4096 && ans_.left > 0) ans_.state = ans_.state << 8 | ans_.data[--ans_.left];
    u32 ones = (ans_.state >> 8) * one_, rest = ans_.state & 255;
    bool bit = rest < one_;
    ans_.state = bit ? ones + rest : ans_.state - ones - one_;
    return bit;
  }

 private:
  u32 one_ = 0;  // probability of 1, in 1/256
  Ans ans_;
};

class Symbols {
 public:
  Symbols(Source& source, int bits) : precision_(int(clip(12, 20, 3 * bits / 2))) {
    read_probabilities(source);
    u64 size = source.count(10);
    ans_.start(source.take(size), size, 4u << precision_, 4);
  }
  u32 read() {
    while (ans_.state < 4u << precision_ && ans_.left > 0) ans_.state = ans_.state << 8 | ans_.data[--ans_.left];
    u32 rest = ans_.state & ((1u << precision_) - 1), i = at_[rest >> (precision_ - 12)];
    while (rest >= first_[i + 1]) i++;  // 255 times at most
    ans_.state = (ans_.state >> precision_) * (first_[i + 1] - first_[i]) + rest - first_[i];
    return symbol_[i];
  }

 private:
  void read_probabilities(Source& source) {
    u32 count = source.count(), sum = 0, part = 1u << (precision_ - 12);
    need(count > 0 && count / 64 <= source.left());
    for (u32 i = 0; i < count; i++) {
      u32 byte = source.byte(), probability = byte >> 2;
      if ((byte & 3) == 3) {  // that many more without one
        need(probability < count - i);
        i += probability;
        continue;
      }
      for (u32 more = 0; more < (byte & 3); more++) probability |= source.byte() << (8 * more + 6);
      if (probability == 0) continue;
      need(probability <= (1u << precision_) - sum);
      for (u32 p = (sum + part - 1) / part; p * part < sum + probability; p++) at_[p] = u32(symbol_.size());
      symbol_.push_back(i);
      first_.push_back(sum);
      sum += probability;
    }
    need(sum == 1u << precision_);
    first_.push_back(sum);
  }
  int precision_;
  std::vector<u32> symbol_, first_;  // those with a probability; where it begins, and the end
  u32 at_[4096];                     // by the first 12 bits: the first of `symbol_` that is there
  Ans ans_;
};

// Values that are coded as symbols, or in bits of which the number is a symbol for all `columns` of a row.
template <typename What>
void read_symbols(Source& source, size_t count, int columns, const What& what) {
  u32 scheme = count > 0 ? source.byte() : 2;
  if (scheme == 1) {
    u32 bits = source.byte();
    need(bits >= 1 && bits <= 18);
    Symbols symbols(source, bits);
    for (size_t i = 0; i < count; i++) what(i, symbols.read());
  } else if (scheme == 0) {
    Symbols lengths(source, 5);
    Bits bits(source);
    for (size_t i = 0; i < count;) {
      u32 length = lengths.read();
      need(length <= 32);
      for (int c = 0; c < columns; c++, i++) what(i, bits.read(length));
    }
    source.take(bits.bytes());
  } else {
    need(count == 0);
  }
}

// ---- Faces around vertices

u32 next(u32 corner) { return corner % 3 == 2 ? corner - 2 : corner + 1; }
u32 previous(u32 corner) { return corner % 3 == 0 ? corner + 2 : corner - 1; }

// The faces at a vertex are one fan, open or closed: as the edgebreaker below makes it, and a cut makes more vertices of it.
struct Fans {
  std::vector<u32> opposite, vertex;  // by corner: the corner across the edge, or NONE
  std::vector<u32> left;              // by vertex: the corner furthest to the left, some corner of a closed fan, NONE of no faces
  u32 swing_left(u32 corner) const {
    u32 across = opposite[next(corner)];
    return across == NONE ? NONE : next(across);
  }
  u32 swing_right(u32 corner) const {
    u32 across = opposite[previous(corner)];
    return across == NONE ? NONE : previous(across);
  }
};

enum Symbol : u32 { C, S, L, R, E };

class SymbolReader {
 public:
  bool by_valence = false;
  void start(Source& source) {
    if (by_valence) return;
    u64 size = source.count(10);
    bits_ = Bits(source);
    source.take(size);
  }
  void start_contexts(Source& source, u32 faces, u32 vertices) {
    if (!by_valence) return;
    valence_.assign(vertices, 0);
    for (std::vector<u8>& context : contexts_) {
      u32 count = source.count();
      need(count <= faces);
      context.resize(count);
      read_symbols(source, count, 1, [&](size_t i, u32 symbol) { context[i] = u8(std::min(symbol, 5u)); });
    }
  }
  u32 read() {
    if (by_valence) {
      if (!context_) return last_ = E;
      need(!context_->empty());
      last_ = context_->back();
      context_->pop_back();
      need(last_ <= E);
      return last_;
    }
    if (!bits_.read(1)) return C;
    return S + bits_.read(2);
  }
  void joined(u32 kept, u32 gone) {
    if (by_valence) valence_[kept] += valence_[gone];
  }
  void reached(const u32 vertex[3]) {  // of the newest face
    static const u8 more[5][3] = {{0, 1, 1}, {0, 1, 1}, {1, 2, 1}, {1, 1, 2}, {2, 2, 2}};
    for (int i = 0; i < 3; i++) valence_[vertex[i]] += more[last_][i];
    context_ = &contexts_[clip(2, 7, valence_[vertex[1]]) - 2];
  }

 private:
  Bits bits_;
  u32 last_ = E;
  std::vector<u32> valence_;     // by vertex
  std::vector<u8> contexts_[6];  // symbols, the last of them first
  std::vector<u8>* context_ = nullptr;
};

class Edgebreaker {
 public:
  Fans mesh, cut;  // cut: along the seams of an attribute
  bool has_cut = false;
  std::vector<u32> point;  // by corner
  u32 points = 0;

  Edgebreaker(Source& source, bool by_valence, u64 vertices, u64 faces) {
    need(faces <= 0x7fffffff / 3 && vertices <= 3 * faces && vertices * (vertices - 1) / 2 >= 3 * faces / 2);
    u32 seams = source.byte();
    require(seams <= 1, S20, "draco_data has seams of more than one attribute");
    u32 symbols = source.count(), splits = source.count();
    need(symbols <= faces && faces <= u64(symbols) + symbols / 3 && splits <= symbols);
    most_vertices_ = u32(vertices + splits);
    has_cut = seams > 0;
    read_events(source, symbols, faces);
    reader_.by_valence = by_valence;
    reader_.start(source);
    starts_ = CodedBits(source);
    CodedBits seam;
    if (has_cut) seam = CodedBits(source);
    reader_.start_contexts(source, faces, most_vertices_);
    mesh.opposite.assign(3 * faces, NONE);
    mesh.vertex.assign(3 * faces, NONE);
    for (u32 i = 0; i < symbols; i++) add_face(i, symbols);
    add_start_faces(symbols, faces);
    name_vertices();
    if (!has_cut) return;
    cut_along(seam);
    name_points();
  }

 private:
  struct Event {  // a face with one more edge that a later S takes
    u32 source, split;
    bool right;
  };

  void read_events(Source& source, u32 symbols, u32 faces) {
    u32 count = source.count(), last = 0;
    need(count <= faces);
    for (u32 i = 0; i < count; i++) {
      last += source.count();
      u32 back = source.count();
      need(back <= last);
      events_.push_back({last, last - back, false});
    }
    Bits bits(source);
    for (Event& event : events_) event.right = bits.read(1);
    source.take(bits.bytes());
    if (count > 0) waiting_.assign(symbols, NONE);
  }

  u32 vertex_of(u32 corner) {
    u32 v = mesh.vertex[corner];
    for (; same_[v] != v; v = same_[v]) same_[v] = same_[same_[v]];
    return v;
  }
  u32 new_vertex(u32 corner) {
    need(mesh.left.size() < most_vertices_);
    same_.push_back(u32(mesh.left.size()));
    mesh.left.push_back(corner);
    return mesh.vertex[corner] = same_.back();
  }
  u32 active() const {  // the corner across the edge at which the next face is put
    need(!stack_.empty());
    return stack_.back();
  }
  void need_open(u32 corner) const { need(mesh.opposite[corner] == NONE); }
  void join(u32 a, u32 b) {
    mesh.opposite[a] = b;
    mesh.opposite[b] = a;
  }

  void add_face(u32 i, u32 symbols) {
    u32 symbol = reader_.read(), corner = 3 * i;
    if (symbol == C) close(corner);
    else if (symbol == S) merge(corner, i);
    else if (symbol == E) stack_.push_back(corner), new_vertex(corner), new_vertex(corner + 1), new_vertex(corner + 2);
    else extend(corner, symbol == R);
    stack_.back() = corner;
    if (reader_.by_valence) {
      u32 vertices[3] = {vertex_of(corner), vertex_of(corner + 1), vertex_of(corner + 2)};
      reader_.reached(vertices);
    }
    if (symbol == C || symbol == S) return;
    u32 coded = symbols - i - 1;  // the encoder's number
    for (; !events_.empty() && events_.back().source >= coded; events_.pop_back()) {
      need(events_.back().source == coded);
      waiting_[symbols - 1 - events_.back().split] = events_.back().right ? next(corner) : previous(corner);
    }
  }
  void close(u32 corner) {  // C: between two edges at a vertex, whose fan is closed
    u32 a = active(), x = vertex_of(next(a)), b = next(mesh.left[x]);
    need(a != b);
    need_open(a), need_open(b);
    u32 p = vertex_of(previous(a)), n = vertex_of(next(b));
    need(x != p && x != n);
    join(a, corner + 1), join(b, corner + 2);
    mesh.vertex[corner] = x, mesh.vertex[corner + 1] = n, mesh.vertex[corner + 2] = p;
    mesh.left[p] = corner + 2;
  }
  void extend(u32 corner, bool right) {  // L, R: at one edge, with a new vertex
    u32 a = active(), tip = corner + 1 + right, at_left = corner + right, at_right = right ? corner : corner + 2;
    need_open(a);
    join(a, tip);
    new_vertex(tip);
    u32 p = vertex_of(previous(a));
    mesh.vertex[at_right] = p, mesh.vertex[at_left] = vertex_of(next(a));
    mesh.left[p] = at_right;
  }
  void merge(u32 corner, u32 i) {  // S: between the last two edges, with two vertices becoming one
    u32 b = active();
    stack_.pop_back();
    if (!waiting_.empty() && waiting_[i] != NONE) stack_.push_back(waiting_[i]);
    u32 a = active();
    need(a != b);
    need_open(a), need_open(b);
    u32 p = vertex_of(previous(a)), n = vertex_of(next(b)), q = vertex_of(previous(b));
    need(p != n);
    join(a, corner + 2), join(b, corner + 1);
    mesh.vertex[corner] = p, mesh.vertex[corner + 1] = vertex_of(next(a)), mesh.vertex[corner + 2] = q;
    mesh.left[q] = corner + 2;
    reader_.joined(p, n);
    mesh.left[p] = mesh.left[n];
    mesh.left[n] = NONE;
    same_[n] = p;
    gone_.push_back(n);
  }
  void add_start_faces(u32 face, u32 faces) {
    for (; !stack_.empty(); stack_.pop_back()) {
      if (!starts_.read()) continue;
      need(face < faces);
      u32 a = stack_.back(), n = vertex_of(next(a)), b = next(mesh.left[n]), x = vertex_of(next(b)), c = next(mesh.left[x]);
      u32 p = vertex_of(next(c)), corner = 3 * face++;
      need(a != b && a != c && b != c && p == vertex_of(previous(a)));
      need_open(a), need_open(b), need_open(c);
      join(a, corner), join(b, corner + 1), join(c, corner + 2);
      mesh.vertex[corner] = x, mesh.vertex[corner + 1] = p, mesh.vertex[corner + 2] = n;
    }
    need(face == faces);
  }

  // Where no attribute has seams, vertices are points: the last ones take the places of those that are gone.
  void name_vertices() {
    std::vector<u32> name(same_.size());
    for (u32 v = 0; v < name.size(); v++) name[v] = v;
    points = u32(name.size());
    for (size_t i = 0; !has_cut && i < gone_.size(); i++) {
      while (mesh.left[points - 1] == NONE) points--;
      if (points - 1 < gone_[i]) continue;
      name[--points] = gone_[i];
      mesh.left[gone_[i]] = mesh.left[points];
      mesh.left[points] = NONE;
    }
    for (u32& v : name) v = name[v];  // the place it has moved to may have moved too; those below are known by then
    for (u32 corner = 0; corner < mesh.vertex.size(); corner++) mesh.vertex[corner] = name[vertex_of(corner)];
    if (!has_cut) point = mesh.vertex;
  }

  void cut_along(CodedBits& seam) {
    cut.opposite = mesh.opposite;
    cut.vertex.resize(mesh.vertex.size());
    for (u32 c = 0; c < cut.opposite.size(); c++) {
      u32 across = mesh.opposite[c];
      if (across == NONE || across / 3 < c / 3 || !seam.read()) continue;
      cut.opposite[c] = cut.opposite[across] = NONE;
    }
    for (u32 c : mesh.left) {
      if (c == NONE) continue;
      u32 first = c;
      for (u32 l = cut.swing_left(c); l != NONE; l = cut.swing_left(l)) {
        first = l;
        if (l == c) break;
      }
      cut.left.push_back(first);
      cut.vertex[first] = u32(cut.left.size() - 1);
      for (u32 r = mesh.swing_right(first); r != NONE && r != first; r = mesh.swing_right(r)) {
        if (cut.opposite[next(r)] == NONE) cut.left.push_back(r);
        cut.vertex[r] = u32(cut.left.size() - 1);
      }
    }
  }
  void name_points() {
    point.resize(mesh.vertex.size());
    points = 0;
    for (u32 first : mesh.left) {
      if (first == NONE) continue;
      if (mesh.swing_left(first) != NONE)
        for (u32 r = mesh.swing_right(first); r != NONE && r != first; r = mesh.swing_right(r))
          if (cut.vertex[r] != cut.vertex[first]) {
            first = r;
            break;
          }
      point[first] = points++;
      u32 before = first;
      for (u32 r = mesh.swing_right(first); r != NONE && r != first; before = r, r = mesh.swing_right(r)) {
        points += cut.vertex[r] != cut.vertex[before];
        point[r] = points - 1;
      }
    }
  }

  u32 most_vertices_;
  std::vector<Event> events_;
  SymbolReader reader_;
  CodedBits starts_;
  std::vector<u32> stack_, waiting_;  // active corners; those that a symbol waits for
  std::vector<u32> same_, gone_;      // by vertex: the one it became, or itself; those that are gone, in order
};

// ---- The order of an attribute's values

struct Order {
  std::vector<u32> corner, entry;  // of every value its first corner; of every vertex its value
};

struct Walk : Order {
  const Fans& fans;
  std::vector<u8> seen;  // faces
  explicit Walk(const Fans& of) : fans(of), seen(of.vertex.size() / 3) { entry.assign(of.left.size(), NONE); }
  bool is_new(u32 at) const { return at != NONE && !seen[at / 3]; }
  void visit(u32 at) {
    u32& value = entry[fans.vertex[at]];
    if (value != NONE) return;
    value = u32(corner.size());
    corner.push_back(at);
  }
  u32 right(u32 at) const { return fans.opposite[next(at)]; }
  u32 left(u32 at) const { return fans.opposite[previous(at)]; }
};

Order depth_first(const Fans& fans) {
  Walk walk(fans);
  std::vector<u32> stack;
  for (u32 start = 0; start < fans.vertex.size(); start += 3) {
    if (!walk.is_new(start)) continue;
    stack.push_back(start);
    walk.visit(start + 1), walk.visit(start + 2);
    while (!stack.empty()) {
      u32 corner = stack.back();
      if (!walk.is_new(corner)) stack.pop_back();
      else for (;;) {
        walk.seen[corner / 3] = 1;
        u32 right = walk.right(corner), left = walk.left(corner), vertex = fans.vertex[corner];
        if (walk.entry[vertex] == NONE) {
          walk.visit(corner);
          if (fans.swing_left(fans.left[vertex]) != NONE && right != NONE) {
            corner = right;
            continue;
          }
        }
        bool to_right = walk.is_new(right), to_left = walk.is_new(left);
        if (to_right == to_left) {
          stack.back() = left;
          if (to_right) stack.push_back(right);
          else stack.pop_back();
          break;
        }
        corner = to_right ? right : left;
      }
    }
  }
  return std::move(walk);
}

Order by_degree(const Fans& fans) {  // vertices that two faces predict before those that one does
  Walk walk(fans);
  std::vector<u32> stacks[3];
  std::vector<u8> degree(fans.left.size(), 0);
  for (u32 start = 0; start < fans.vertex.size(); start += 3) {
    stacks[0].push_back(start);
    walk.visit(start + 1), walk.visit(start + 2), walk.visit(start);
    int best = 0;
    auto priority = [&](u32 corner) {
      u32 vertex = fans.vertex[corner];
      if (walk.entry[vertex] != NONE) return 0;
      if (degree[vertex] < 2) degree[vertex]++;
      return degree[vertex] > 1 ? 1 : 2;
    };
    for (;;) {
      while (best < 3 && stacks[best].empty()) best++;
      if (best == 3) break;
      u32 corner = stacks[best].back();
      stacks[best].pop_back();
      while (walk.is_new(corner)) {
        walk.seen[corner / 3] = 1;
        walk.visit(corner);
        u32 right = walk.right(corner), left = walk.left(corner);
        bool to_right = walk.is_new(right);
        if (walk.is_new(left)) {
          int at = priority(left);
          if (!to_right && at <= best) {
            corner = left;
            continue;
          }
          stacks[at].push_back(left);
          best = std::min(best, at);
        }
        if (to_right) {
          int at = priority(right);
          if (at <= best) {
            corner = right;
            continue;
          }
          stacks[at].push_back(right);
          best = std::min(best, at);
        }
      }
    }
  }
  return std::move(walk);
}

// ---- Attributes

enum Coding : u32 { RAW, INTEGER, QUANTISED };
enum Scheme : int { UNPREDICTED = -2, DIFFERENCE = 0, PARALLELOGRAM = 1, PARALLELOGRAMS = 4, TEXTURE = 5 };

struct Attribute {
  u32 type = 0, kind = 0, columns = 0, coding = RAW;
  std::vector<u32> values;
  bool is_position() const { return type == 0 && kind == 6 && columns == 3; }
  bool is_uv(bool quantised) const { return type == (quantised ? 3 : 4) && kind == (quantised ? 9 : 6) && columns == 2; }
};

struct AttributeReader {  // of one attribute
  Source& source;
  const Fans& fans;
  const Order& order;
  const std::vector<u32>& point;  // by corner
  const std::vector<u32>* position;  // by point, or null where they are not read yet or not predicted
  Attribute& out;
  int scheme = UNPREDICTED;
  i64 low = 0, high = 0;  // of predicted values
  CodedBits creases[4] = {};
  u32 num_creases[4] = {};
  std::vector<u8> turns = {};

  size_t entries() const { return order.corner.size(); }
  i64 value(u32 entry, u32 column) const { return i32(out.values[size_t(entry) * out.columns + column]); }

  void read() {
    size_t count = entries() * out.columns;
    if (out.coding == RAW) {
      const u8* data = source.take(4 * count);
      out.values.resize(count);
      memcpy(out.values.data(), data, 4 * count);
      return;
    }
    bool predicted = false;
    scheme = i8(source.byte());
    need(scheme == UNPREDICTED || scheme == DIFFERENCE || scheme == PARALLELOGRAM || scheme == PARALLELOGRAMS || scheme == TEXTURE);
    if (scheme != UNPREDICTED) {
      int transform = i8(source.byte());
      need(transform >= -1 && transform < 4);
      predicted = transform == 1;
      if (predicted && scheme == TEXTURE) {
        need(position && out.columns == 2);
        for (u32 axis : *position) require(axis >> 20 == 0, S23, "a position is not below 2^position_bits");
      }
    }
    read_values(count);
    for (u32& v : out.values) v = v & 1 ? ~(v >> 1) : v >> 1;
    if (!predicted) return;
    read_prediction();
    predict();
  }

  void read_values(size_t count) {
    bool coded = source.byte() > 0;
    u32 bytes = coded ? 0 : source.byte();
    need(bytes <= 4);
    const u8* data = source.take(u64(bytes) * count);
    out.values.assign(count, 0);
    if (coded) read_symbols(source, count, out.columns, [&](size_t i, u32 symbol) { out.values[i] = symbol; });
    for (size_t i = 0; i < bytes * count; i++) out.values[i / bytes] |= u32(data[i]) << (8 * (i % bytes));
  }

  void read_prediction() {
    for (int i = 0; scheme == PARALLELOGRAMS && i < 4; i++) {
      num_creases[i] = source.count();
      need(num_creases[i] <= fans.vertex.size());
      if (num_creases[i] > 0) creases[i] = CodedBits(source);
    }
    if (scheme == TEXTURE) {
      u32 count = source.word();
      need(count <= fans.vertex.size());
      CodedBits bits(source);
      turns.resize(count);
      bool turn = true;
      for (u8& t : turns) t = turn = turn == bits.read();
    }
    low = i32(source.word());
    high = i32(source.word());
    need(low <= high && high - low < 0x7fffffff);
  }

  void predict() {
    i64 range = high - low + 1;
    for (u32 e = 0; e < entries(); e++) {
      i64 guess[3] = {};
      for (u32 c = 0; e > 0 && c < out.columns; c++) guess[c] = value(e - 1, c);
      if (scheme == TEXTURE) by_texture(e, guess);
      else if (e > 0 && scheme == PARALLELOGRAM) parallelogram(e, order.corner[e], guess);
      else if (e > 0 && scheme == PARALLELOGRAMS) parallelograms(e, guess);
      for (u32 c = 0; c < out.columns; c++) {
        u32& v = out.values[size_t(e) * out.columns + c];
        i64 sum = i32(u32(clip(low, high, guess[c])) + v);
        v = u32(sum > high ? sum - range : sum < low ? sum + range : sum);
      }
    }
  }

  bool parallelogram(u32 e, u32 corner, i64* guess) const {
    u32 across = fans.opposite[corner];
    if (across == NONE) return false;
    u32 o = order.entry[fans.vertex[across]], n = order.entry[fans.vertex[next(across)]];
    u32 p = order.entry[fans.vertex[previous(across)]];
    if (o >= e || n >= e || p >= e) return false;
    for (u32 c = 0; c < out.columns; c++) guess[c] = i32(value(n, c) + value(p, c) - value(o, c));
    return true;
  }

  void parallelograms(u32 e, i64* guess) {
    i64 each[4][3];
    int count = 0, used = 0;
    u32 start = order.corner[e];
    bool leftwards = true;
    for (u32 corner = start; corner != NONE && count < 4;) {
      count += parallelogram(e, corner, each[count]);
      corner = leftwards ? fans.swing_left(corner) : fans.swing_right(corner);
      if (corner == start) break;
      if (corner == NONE && leftwards) {
        leftwards = false;
        corner = fans.swing_right(start);
      }
    }
    u32 sum[3] = {};
    for (int i = 0; i < count; i++) {
      need(num_creases[count - 1]-- > 0);
      if (creases[count - 1].read()) continue;
      used++;
      for (u32 c = 0; c < out.columns; c++) sum[c] += u32(each[i][c]);
    }
    for (u32 c = 0; used > 0 && c < out.columns; c++) guess[c] = i32(sum[c]) / used;
  }

  const u32* position_of(u32 entry) const { return &(*position)[3 * size_t(point[order.corner[entry]])]; }

  void by_texture(u32 e, i64* guess) {  // the triangle of the positions, turned and scaled into that of the UVs
    u32 n = order.entry[fans.vertex[next(order.corner[e])]], p = order.entry[fans.vertex[previous(order.corner[e])]];
    if (n >= e) return;
    i64 n_uv[2] = {value(n, 0), value(n, 1)};
    guess[0] = n_uv[0], guess[1] = n_uv[1];
    if (p >= e) return;
    i64 pn_uv[2] = {value(p, 0) - n_uv[0], value(p, 1) - n_uv[1]}, pn[3], cn[3], dot = 0, square = 0, far = 0;
    if (pn_uv[0] == 0 && pn_uv[1] == 0) return;
    for (int i = 0; i < 3; i++) {
      pn[i] = i64(position_of(p)[i]) - position_of(n)[i];
      cn[i] = i64(position_of(e)[i]) - position_of(n)[i];
      square += pn[i] * pn[i];
      dot += pn[i] * cn[i];
    }
    if (square == 0) return;
    need(std::max(magnitude(n_uv[0]), magnitude(n_uv[1])) <= INT64_MAX / square);
    need(magnitude(dot) <= INT64_MAX / std::max(magnitude(pn_uv[0]), magnitude(pn_uv[1])));
    for (int i = 0; i < 3; i++) {
      i64 off = cn[i] - dot * pn[i] / square;
      far += off * off;
    }
    u64 length = u64(isqrt(u64(far) * u64(square)));
    need(!turns.empty());
    u64 sign = turns.back() ? length : 0 - length;
    turns.pop_back();
    for (int i = 0; i < 2; i++) {
      u64 along = u64(n_uv[i]) * u64(square) + u64(dot) * u64(pn_uv[i]), beside = sign * u64(i == 0 ? pn_uv[1] : -pn_uv[0]);
      guess[i] = i32(i64(along + beside) / square);
    }
  }
};

void dequantise(Source& source, Attribute& attribute) {
  float least[2], range;
  memcpy(least, source.take(8), 8);
  memcpy(&range, source.take(4), 4);
  u32 bits = source.byte();
  need(bits >= 1 && bits <= 30);
  float step = range / float((1u << bits) - 1);
  for (size_t i = 0; i < attribute.values.size(); i++) {
    float value = float(i32(attribute.values[i])) * step + least[i % 2];
    memcpy(&attribute.values[i], &value, 4);
  }
}

struct Decoder {  // of attributes with values in one order
  int seams;
  bool by_corner, by_degree;
  std::vector<Attribute> attributes;
};

std::vector<Decoder> read_decoders(Source& source, const GeometryUnit& unit, bool has_cut) {
  std::vector<Decoder> decoders;
  bool used[2] = {};
  u32 count = source.byte(), attributes = 0;
  require(count <= 1u + unit.planar, S20, "the attributes of draco_data are not those of 5.6");
  for (u32 i = 0; i < count; i++) {
    int seams = std::max<int>(-1, i8(source.byte()));
    need(seams < int(has_cut) && !used[seams + 1]);
    used[seams + 1] = true;
    bool by_corner = source.byte() > 0;
    u32 traversal = source.byte();
    need(traversal < 2 && !(by_corner && (traversal > 0 || seams < 0)));
    decoders.push_back({seams, by_corner, traversal == 1, {}});
  }
  for (Decoder& decoder : decoders) {
    u32 more = source.count();
    need(more > 0 && more <= 5 * source.left());
    require((attributes += more) <= 1u + unit.planar, S20, "the attributes of draco_data are not those of 5.6");
    for (u32 i = 0; i < more; i++) {
      Attribute a;
      a.type = source.byte(), a.kind = source.byte(), a.columns = source.byte();
      source.byte();   // normalised
      source.count();  // unique id
      need(a.type < 5 && a.kind > 0 && a.kind < 12 && a.columns > 0);
      decoder.attributes.push_back(std::move(a));
    }
    for (Attribute& a : decoder.attributes) {
      a.coding = source.byte();
      need(a.coding <= QUANTISED && (a.coding != QUANTISED || a.kind == 9) && (a.coding != INTEGER || a.kind != 9));
    }
  }
  return decoders;
}

void check_kinds(const std::vector<Decoder>& decoders, const GeometryUnit& unit) {
  int positions = 0, uvs = 0;
  for (const Decoder& decoder : decoders)
    for (const Attribute& a : decoder.attributes) {
      positions += a.is_position();
      uvs += a.is_uv(unit.uv_bits > 0);
    }
  require(positions == 1 && uvs == unit.planar, S20, "the attributes of draco_data are not those of 5.6");
}

void read_attributes(Source& source, const Edgebreaker& faces, Decoder& decoder, GeometryUnit& unit,
                     const std::vector<u32>*& position) {
  const Fans& fans = decoder.by_corner ? faces.cut : faces.mesh;
  Order order = decoder.by_degree ? by_degree(fans) : depth_first(fans);
  auto by_point = [&](const Attribute& a, u32* out) {
    for (size_t c = 0; c < faces.point.size(); c++)
      memcpy(out + size_t(faces.point[c]) * a.columns, &a.values[size_t(order.entry[fans.vertex[c]]) * a.columns], 4 * a.columns);
  };
  for (Attribute& a : decoder.attributes) {
    AttributeReader{source, fans, order, faces.point, position, a}.read();
    if (!a.is_position()) continue;
    by_point(a, unit.position.data());
    if (a.coding != RAW) position = &unit.position;
  }
  for (Attribute& a : decoder.attributes) {
    if (a.coding == QUANTISED) dequantise(source, a);
    if (!a.is_position()) by_point(a, reinterpret_cast<u32*>(unit.uv.data()));
  }
}

}  // namespace

void decode_draco(GeometryUnit& unit, Bytes data, bool by_valence) {
  Source source{data.data, data.data + data.size};
  Edgebreaker faces(source, by_valence, unit.vertices, unit.faces);
  std::vector<Decoder> decoders = read_decoders(source, unit, faces.has_cut);
  check_kinds(decoders, unit);
  unit.position.resize(3 * size_t(faces.points));
  unit.uv.resize(unit.planar ? 2 * size_t(faces.points) : 0);
  const std::vector<u32>* position = nullptr;
  for (Decoder& decoder : decoders) read_attributes(source, faces, decoder, unit, position);
  unit.corner = std::move(faces.point);
}

}  // namespace texf
