// Clauses 4 and 5: reading units, what binds them to each other (9.2), Draco; and the order of everything else.
#include <cmath>

#include "core.hpp"

namespace texf {

std::string decimal(u64 value) {
  std::string digits;
  do digits.insert(digits.begin(), char('0' + value % 10));
  while (value /= 10);
  return digits;
}

namespace {
[[noreturn]] void refuse_with(texf_refusal refusal, const std::string& sentence) {
  memcpy(refusal.sentence, sentence.data(), std::min(sentence.size(), sizeof refusal.sentence - 1));
  refuse(refusal);
}
}  // namespace

void fail(Finding finding, const char* sentence) { refuse_with({finding, 0, 0, 0, ""}, sentence); }
void fail(Finding finding, const std::string& sentence) { refuse_with({finding, 0, 0, 0, ""}, sentence); }

void fail_value(Finding finding, u64 value, u64 allowed, const char* sentence) {
  refuse_with({finding, 1, value, allowed, ""}, std::string(sentence) + ": " + decimal(value) + ", allowed " + decimal(allowed));
}

i64 isqrt(u64 v) {
  u64 last = 0xffffffff, r = std::min(u64(std::sqrt(double(v))), last);
  while (r * r > v) r--;
  while (r < last && (r + 1) * (r + 1) <= v) r++;
  return i64(r);
}

u32 crc32(const void* data, size_t size, u32 before) {
  static const auto table = [] {
    std::array<std::array<u32, 256>, 16> t{};
    const volatile u32 polynomial = 0xedb88320u;  // volatile: 16 kB that nothing compresses stay out of the module
    for (u32 n = 0; n < 256; n++) {
      u32 c = n;
      for (int k = 0; k < 8; k++) c = c & 1 ? polynomial ^ c >> 1 : c >> 1;
      t[0][n] = c;
    }
    for (int k = 1; k < 16; k++)
      for (u32 n = 0; n < 256; n++) t[k][n] = t[0][t[k - 1][n] & 255] ^ t[k - 1][n] >> 8;
    return t;
  }();
  const u8* at = static_cast<const u8*>(data);
  u32 c = ~before;
  for (; size >= 16; size -= 16, at += 16) {
    u64 parts[2];
    memcpy(parts, at, 16);
    parts[0] ^= c;
    c = 0;
    for (int k = 0; k < 16; k++) c ^= table[15 - k][parts[k / 8] >> (8 * (k % 8)) & 255];
  }
  while (size-- > 0) c = table[0][(c ^ *at++) & 255] ^ c >> 8;
  return ~c;
}

void sort_keys(std::vector<u64>& keys) {
  if (keys.empty()) return;
  std::vector<u64> other(keys.size());
  u64 differ = 0;
  for (u64 key : keys) differ |= key ^ keys[0];
  for (int shift = 0; shift < 64; shift += 8) {
    if (!(differ >> shift & 255)) continue;
    size_t begin[256] = {}, sum = 0;
    for (u64 key : keys) begin[key >> shift & 255]++;
    for (size_t& b : begin) {
      size_t count = b;
      b = sum;
      sum += count;
    }
    for (u64 key : keys) other[begin[key >> shift & 255]++] = key;
    keys.swap(other);
  }
}

std::vector<u64> Asset::cells(size_t field, int shift) const {
  const std::vector<u64>& keys = fields[field].keys;
  if (shift == 0) return keys;
  std::vector<u64> out;
  for (u64 key : keys)
    if (out.empty() || out.back() != key >> (3 * shift)) out.push_back(key >> (3 * shift));
  return out;
}

namespace {

// ---- 4.3

class Reader {
 public:
  explicit Reader(Bytes bytes) : at_(bytes.data), end_(bytes.data + bytes.size) {}
  size_t left() const { return end_ - at_; }
  const u8* at() const { return at_; }
  Bytes take(u64 count, const char* name) {
    if (count > left()) fail(S02, std::string(name) + ": the bytes end before it");
    Bytes found{at_, size_t(count)};
    at_ += count;
    return found;
  }
  Bytes rest() { return take(left(), "rest"); }
  u64 count_of(const char* name, u64 count, u64 least) {  // of elements of at least so many bytes each, all of which are there
    if (count * least > left()) fail(S02, std::string(name) + ": the bytes end before the last of " + decimal(count));
    return count;
  }
  u64 number(int size, const char* name, u64 low, u64 high) {
    Bytes bytes = take(size, name);
    u64 value = 0;
    for (int i = 0; i < size; i++) value |= u64(bytes.data[i]) << (8 * i);
    return ranged(value, name, low, high);
  }
  int u8_(const char* name, int low = 0, int high = 255) { return int(number(1, name, low, high)); }
  int u16_(const char* name, int low = 0, int high = 65535) { return int(number(2, name, low, high)); }
  u32 u32_(const char* name) { return u32(number(4, name, 0, 0xffffffff)); }
  i32 i32_(const char* name, i32 low, i32 high) {
    i32 value = i32(u32_(name));
    if (value < low || value > high) fail(S04, std::string(name) + (value < 0 ? " is -" : " is ") + decimal(magnitude(value)));
    return value;
  }
  int registry(const char* name, int low, int high) { return known(u8_(name, low), name, high); }
  static int known(u64 value, const char* name, int high) {
    if (value > u64(high)) fail(U09, std::string(name) + " is " + decimal(value));
    return int(value);
  }
  u64 v(const char* name, u64 low = 0, u64 high = (1ull << 56) - 1) {
    u64 value = 0;
    for (int i = 0; i < 8; i++) {
      u64 byte = u8_(name);
      value |= (byte & 127) << (7 * i);
      if (byte < 128) {
        if (byte == 0 && i > 0) fail(S05, std::string(name) + " is not in its shortest form");
        return ranged(value, name, low, high);
      }
    }
    fail(S05, std::string(name) + " has more than 8 bytes");
  }
  double f64(const char* name, double low = -1e300) {
    double value;
    memcpy(&value, take(8, name).data, 8);
    if (!(value >= low && value <= 1e300)) fail(S04, std::string(name) + " is out of its range");
    return value == 0 ? 0 : value;
  }
  float f32(const char* name) {
    float value;
    memcpy(&value, take(4, name).data, 4);
    if (!std::isfinite(value)) fail(S04, std::string(name) + " is not finite");
    return value;
  }
  std::string utf8(u64 count, const char* name) {
    Bytes bytes = take(count, name);
    for (size_t i = 0; i < bytes.size;) {
      u32 first = bytes.data[i];
      int more = first < 0x80 ? 0 : first < 0xc2 ? -1 : first < 0xe0 ? 1 : first < 0xf0 ? 2 : first < 0xf5 ? 3 : -1;
      u32 point = more == 1 ? first & 31 : more == 2 ? first & 15 : more == 3 ? first & 7 : first;
      bool right = more >= 0 && i + more < bytes.size;
      for (int k = 1; right && k <= more; k++) {
        right = bytes.data[i + k] >> 6 == 2;
        point = point << 6 | (bytes.data[i + k] & 63);
      }
      right = right && !(more == 2 && point < 0x800) && !(more == 3 && point < 0x10000) && point <= 0x10ffff &&
              !(point >= 0xd800 && point < 0xe000);
      if (!right) fail(S06, std::string(name) + " is not UTF-8");
      i += more + 1;
    }
    return std::string(reinterpret_cast<const char*>(bytes.data), bytes.size);
  }

 private:
  static u64 ranged(u64 value, const char* name, u64 low, u64 high) {
    if (value < low || value > high) fail(S04, std::string(name) + " is " + decimal(value) + ", not in its range");
    return value;
  }
  const u8 *at_, *end_;
};

// ---- 5.1, 5.2

enum { HEADER, MATERIALS, FIELD, GEOMETRY, ATTRIBUTE, END, METADATA = 128, SHARP_EDGES = 129, CODED_NORMALS = 130 };

struct Unit {
  int type;
  Bytes payload;
};

Unit read_unit(Reader& reader) {
  const u8* start = reader.at();
  Unit unit;
  unit.type = reader.u8_("unit_type");
  unit.payload = reader.take(reader.v("unit_length"), "payload");
  u32 crc = crc32(start, reader.at() - start);
  if (reader.u32_("unit_crc") != crc) fail(S03, "the unit_crc of a unit of type " + decimal(unit.type) + " does not match");
  return unit;
}

std::vector<Unit> units_of(Bytes data) {
  static const u8 signature[8] = {0x89, 0x54, 0x58, 0x46, 0x0d, 0x0a, 0x1a, 0x0a};
  require(data.size >= 8 && memcmp(data.data, signature, 8) == 0, S01, "the stream does not begin with the signature of 5.1");
  Reader reader({data.data + 8, data.size - 8});
  std::vector<Unit> units{read_unit(reader)};
  require(units[0].type == HEADER, S07, "the first unit is not the sequence header");
  require(units[0].payload.size > 0, S02, "the sequence header is empty");
  if (units[0].payload.data[0] != 1) fail(U04, "version is " + decimal(units[0].payload.data[0]));
  int last = HEADER;
  bool there[256] = {true};
  while (last != END) {
    Unit unit = read_unit(reader);
    bool once = unit.type <= MATERIALS || (unit.type >= METADATA && unit.type <= CODED_NORMALS);
    if (once && there[unit.type]) fail(S07, "a second unit of type " + decimal(unit.type));
    if (unit.type > END && unit.type < METADATA) fail(U01, "unit_type is " + decimal(unit.type));
    if (unit.type <= END) {
      require(unit.type >= last, S07, "the units do not ascend by type");
      last = unit.type;
    }
    there[unit.type] = true;
    units.push_back(unit);
  }
  require(units.back().payload.size == 0, S08, "the end unit is not empty");
  require(reader.left() == 0, S08, "bytes follow the end unit");
  return units;
}

// ---- 5.3, 5.4

const u8 CHANNEL_COMPONENTS[23] = {3, 1, 2, 3, 1, 1, 1, 3, 1, 1, 2, 3, 3, 1, 1, 3, 1, 1, 1, 1, 3, 1, 3};
const u32 SRGB = 1 << 0 | 1 << 7 | 1 << 12 | 1 << 15 | 1 << 22, BASE = 3;
const u32 NAMEABLE = 0x7fffff & ~(1u << 0 | 1u << 1 | 1u << 3 | 1u << 11);

u32 channels_of(const ChannelGroup& group) {
  u32 bits = 0;
  for (int semantic : group.semantics) bits |= 1u << semantic;
  return bits;
}

struct Counts {
  u64 materials, fields, geometry;
};

Counts read_header(Reader& reader, Asset& asset) {
  reader.u8_("version");
  asset.position_bits = reader.u8_("position_bits", 8, 20);
  for (double& o : asset.origin) o = reader.f64("origin");
  asset.side = reader.f64("side", 0);
  Counts counts;
  counts.materials = reader.v("num_materials", 0, 65536);
  counts.fields = reader.v("num_fields", 0, 256);
  counts.geometry = reader.v("num_geometry_units", 0, 1 << 24);
  asset.groups.resize(reader.count_of("channel_groups", reader.registry("num_channel_groups", 1, 23), 3));
  for (ChannelGroup& group : asset.groups) {
    group.semantics.resize(reader.count_of("group_semantics", reader.u8_("num_semantics", 1, 3), 1));
    for (u8& semantic : group.semantics) semantic = reader.registry("group_semantics", 0, 22);
    group.components = reader.u8_("group_components", 1, 3);
  }
  u32 met = 0;
  for (const ChannelGroup& group : asset.groups)
    for (int semantic : group.semantics) {
      require(!(met >> semantic & 1), S04, "a channel is there twice");
      met |= 1u << semantic;
    }
  for (const ChannelGroup& group : asset.groups) {
    int sum = 0;
    for (int semantic : group.semantics) sum += CHANNEL_COMPONENTS[semantic];
    bool grey = group.semantics.size() == 1 && SRGB >> group.semantics[0] & 1 && group.components == 1;
    if (group.components != sum && !grey) fail(U03, "group_components is " + decimal(group.components));
  }
  return counts;
}

std::vector<float> parameter_default(int id) {
  switch (id) {
    case 4: case 9: return {0, 0, 0};
    case 12: case 16: case 24: return {1, 1, 1};
    case 0: case 1: case 2: case 3: case 5: case 8: case 11: return {1};
    case 15: return {INFINITY};
    case 18: return {1.3f};
    case 19: return {100};
    case 20: return {400};
    case 25: return {1.5f};
    default: return {0};
  }
}

Material read_material(Reader& reader) {
  Material material;
  material.name = reader.utf8(reader.v("name_length", 0, 65535), "material_name");
  material.alpha_mode = reader.registry("alpha_mode", 0, 2);
  if (material.alpha_mode == 1) material.alpha_cutoff = reader.u16_("alpha_cutoff");
  material.flags = reader.registry("material_flags", 0, 3);
  if (!(material.flags & 2)) {
    material.normal_rule = reader.registry("normal_rule", 0, 6);
    material.normal_angle = reader.u8_("normal_angle", 0, 180);
  }
  material.channels = Reader::known(reader.v("material_channels"), "material_channels", (1 << 23) - 1);
  material.parameters.resize(reader.count_of("parameters", reader.registry("num_parameters", 0, 27), 5));
  for (Parameter& parameter : material.parameters) {
    parameter.id = reader.registry("parameter_id", 0, 26);
    parameter.value = parameter_default(parameter.id);
    for (float& value : parameter.value) value = reader.f32("parameter_value");
  }
  return material;
}

void check_material(const Material& material) {
  require(!(material.channels & ~NAMEABLE), S04, "material_channels has a bit of 0, 1, 3 or 11");
  for (size_t i = 0; i < material.parameters.size(); i++) {
    const Parameter& parameter = material.parameters[i];
    require(i == 0 || parameter.id > material.parameters[i - 1].id, S04, "parameter_id does not ascend");
    require(parameter.value != parameter_default(parameter.id), S04, "a parameter is its default");
  }
}

void read_materials(Reader& reader, Asset& asset, u64 count) {
  reader.count_of("materials", count, 5);
  while (asset.materials.size() < count) asset.materials.push_back(read_material(reader));
  for (const Material& material : asset.materials) check_material(material);
}

// ---- 5.5, 5.6

Field read_field(Reader& reader) {
  Field field;
  field.index = reader.v("field_index");
  field.planar = reader.registry("support", 0, 1) == 1;
  if (field.planar) {
    field.width = reader.u16_("width", 1, 16384);
    field.height = reader.u16_("height", 1, 16384);
    field.wrap[0] = reader.registry("wrap_s", 0, 2);
    field.wrap[1] = reader.registry("wrap_t", 0, 2);
    field.fraction_bits = reader.u8_("uv_fraction_bits", 0, 8);
    field.resolution = std::max(field.width, field.height);
  } else {
    field.resolution = reader.u16_("resolution", 1, 8192);
    field.area_threshold = reader.u16_("area_threshold");
  }
  field.num_keys = reader.v("num_keys", 1, 1 << 28);
  field.keys_crc = reader.u32_("keys_crc");
  return field;
}

GeometryUnit read_geometry(Reader& reader, const Asset& asset) {
  GeometryUnit unit;
  unit.field = reader.v("field_index");
  unit.material = reader.v("material_index");
  unit.vertices = reader.v("unit_vertices", 3);
  unit.faces = reader.v("unit_faces", 1);
  if (unit.field >= asset.fields.size()) {  // step 5 refuses it
    reader.rest();
    return unit;
  }
  unit.planar = asset.fields[unit.field].planar;
  if (unit.planar) {
    for (i32& o : unit.uv_origin) o = reader.i32_("uv_origin", -33554431, 33554431);
    unit.uv_bits = reader.u8_("uv_bits", 0, 20);
    if (unit.uv_bits > 0) unit.uv_range = reader.v("uv_range", 1, 1048575);
  }
  unit.crc = reader.u32_("geometry_crc");
  unit.draco = reader.rest();
  require(unit.uv_bits == 0 || unit.uv_range < 1ull << unit.uv_bits, S04, "uv_range is 2^uv_bits or more");
  return unit;
}

// ---- 5.7

void read_filter(Reader& reader, AttributeUnit& unit) {
  FilterStage stage;
  stage.mask = reader.u16_("filter_mask", 0, 32767);
  Bytes taps = reader.take((unit.planar ? 5 : 3) * __builtin_popcount(stage.mask), "filter_coefficients");
  for (size_t i = 0; i < taps.size; i++) stage.coefficients.push_back(i8(taps.data[i]));
  require(stage.mask >> (5 * unit.components) == 0, S04, "filter_mask has a bit of a component that is not there");
  unit.filters.push_back(stage);
}

void read_raht(Reader& reader, AttributeUnit& unit, const Field& field) {
  int count = unit.components;
  unit.planar = field.planar;
  unit.colour_transform = reader.registry("colour_transform", 0, 1);
  for (int c = 0; c < count; c++) unit.qp[c] = reader.u8_("qp", 0, 63);
  for (int& k : unit.kernel) k = reader.u8_("kernel");
  unit.colour_range = reader.u8_("colour_range");
  unit.num_models = reader.u8_("num_models", 0, 8);
  if (unit.planar) unit.planar_transform = reader.registry("planar_transform", 0, 1);
  if (unit.planar && unit.num_models > 0) unit.dct_blocks = reader.registry("dct_blocks", 0, 1);
  if (count > 1) unit.component_cross = reader.u8_("component_cross", 0, 16);
  u64 num_filters = reader.count_of("filters", reader.u8_("num_filters", 0, 3), 2);
  while (num_filters-- > 0) read_filter(reader, unit);
  unit.residual = reader.u8_("residual", 0, 128);
  for (int c = 0; c < count && unit.residual > 0; c++) unit.residual_cross[c] = reader.u8_("residual_cross", 0, 16);
  for (int c = 0; c < count; c++) unit.root_mean[c] = reader.i32_("root_mean", -1048576, 1048576);
  unit.slice_level = reader.u8_("slice_level", 0, std::min(12, std::max(0, unit.depth - 1)));
  u64 num_slices = unit.slice_level > 0 ? reader.v("num_slices", 1, 64) : 1;
  reader.count_of("slice_step", num_slices - 1, 1);
  unit.slice_first = {0};
  while (unit.slice_first.size() < num_slices) unit.slice_first.push_back(unit.slice_first.back() + reader.v("slice_step", 1));
  int level_index = reader.u8_("level_index", 0, 1);
  require(count == 3 || unit.colour_transform == 0, S04, "colour_transform without three components");
  require(unit.kernel[0] >= 1, S04, "kernel[0] is 0");
  require(unit.depth > 0 || unit.residual == 0, S04, "residual where there are no levels");
  std::vector<u64> lengths;
  u64 num_codewords = reader.count_of("codewords", unit.depth == 0 ? 0 : unit.slice_level > 0 ? 1 + num_slices : 1, 1);
  for (u64 n = 0; n < num_codewords; n++) {
    lengths.push_back(reader.v("codeword_length"));
    int levels = unit.slice_level == 0 ? unit.depth : n == 0 ? unit.slice_level : unit.depth - unit.slice_level;
    while (level_index && levels-- > 0) reader.v("level_bytes");
  }
  u64 sum = 0;
  for (u64 length : lengths) {
    require(length <= reader.left() - sum, S10, "the codeword lengths are more than the data");
    sum += length;
  }
  require_equal(sum, reader.left(), S10, "the codeword lengths do not add up to the data");
  for (u64 length : lengths) unit.codewords.push_back(reader.take(length, "codeword_data"));
}

void read_neural(Reader& reader, AttributeUnit& unit, const Asset& asset, u64 num_fields) {
  unit.form = reader.registry("form", 0, 1);
  unit.num_features = reader.u8_("num_features", 2, 64);
  unit.wave_octaves = reader.u8_("wave_octaves", 0, 8);
  unit.first_wave = reader.u16_("first_wave", 1, 16384);
  std::vector<int> hidden(reader.u8_("num_hidden", 1, 4));
  for (int& width : hidden) width = reader.u8_("hidden_width", 1, 128);
  unit.levels.resize(reader.count_of("latent_levels", reader.u8_("num_levels", 1, 4), 5));
  u64 latents = 0;
  for (LatentLevel& level : unit.levels) {
    level.resolution = reader.u16_("level_resolution", 1, 8192);
    level.table_log2 = reader.u8_("table_log2", 0, 24);
    level.threshold = reader.u16_("latent_threshold");
    level.num_latents.resize(level.table_log2 == 0 ? num_fields : 0);
    level.num_rows = level.table_log2 == 0 ? 0 : 1ull << level.table_log2;
    for (u64& count : level.num_latents) level.num_rows += count = reader.v("num_latents", 1);
    latents += level.num_rows * unit.num_features;
  }
  int outputs = 0;
  for (const ChannelGroup& group : asset.groups) outputs += group.components;
  unit.widths = {int(unit.levels.size()) * unit.num_features + 6 * unit.wave_octaves};
  unit.widths.insert(unit.widths.end(), hidden.begin(), hidden.end());
  unit.widths.push_back(outputs);
  size_t count = 0;
  for (size_t n = 0; n + 1 < unit.widths.size(); n++) count += size_t(unit.widths[n] + 1) * unit.widths[n + 1];
  unit.network = reader.take(2 * count, "network_data");
  unit.latents = reader.rest();
  require(unit.num_features % 2 == 0, S04, "num_features is odd");
  for (size_t i = 1; i < unit.network.size; i += 2)
    require((unit.network.data[i] >> 2 & 31) < 27, S50, "a parameter is not finite and of magnitude below 2^12");
  require(unit.form == 1 || unit.latents.size == latents / 2, S10, "latent_data is not as long as its rows");
  within(latents, asset.limits.latents, L10, "latents");
}

AttributeUnit read_attribute(Reader& reader, const Asset& asset, u64 num_fields) {
  AttributeUnit unit;
  unit.field = reader.v("field_index");
  unit.group = reader.u8_("group_index", 0, 22);
  unit.codec = reader.u8_("codec_id");
  std::string name = unit.codec >= FIRST_PRIVATE ? reader.utf8(reader.u8_("codec_name_length", 1), "codec_name") : "";
  unit.level_shift = reader.u8_("level_shift", 0, 13);
  unit.values_crc = reader.u32_("values_crc");
  require(unit.field < asset.fields.size(), S09, "an attribute unit names a field that is not there");
  require(size_t(unit.group) < asset.groups.size(), S09, "an attribute unit names a channel group that is not there");
  if (unit.codec > CONSTANT) fail(unit.codec >= FIRST_PRIVATE ? U07 : U02, "codec_id is " + decimal(unit.codec) + " " + name.substr(0, 60));
  const Field& field = asset.fields[unit.field];
  const ChannelGroup& group = asset.groups[unit.group];
  int most = unit.codec == NEURAL || channels_of(group) & BASE ? 0 : field.depth();
  require(unit.level_shift <= most, S04, "level_shift is more than it may be");
  unit.components = group.components;
  unit.depth = bit_length(ceil_div(field.resolution, 1 << unit.level_shift) - 1);
  if (unit.codec == RAHT) {
    read_raht(reader, unit, field);
  } else if (unit.codec == CONSTANT) {
    for (int c = 0; c < unit.components; c++) unit.plane_value[c] = reader.u8_("plane_value");
  } else {
    read_neural(reader, unit, asset, num_fields);
  }
  return unit;
}

// ---- 9.2, step 5

void check_units(const Asset& asset, const Counts& counts) {
  require(asset.fields.size() == counts.fields, S11, "num_fields is another number than that of the field units");
  require(asset.units.size() == counts.geometry, S11, "num_geometry_units is another number than that of the geometry units");
  require(counts.geometry > 0 || counts.fields == 0, S11, "fields without geometry units");
  std::vector<u32> used(asset.fields.size(), 0);
  std::vector<bool> has_geometry(asset.fields.size(), false);
  u32 all_used = 0, there = 0;
  for (size_t i = 0; i < asset.fields.size(); i++) require(asset.fields[i].index == i, S11, "field_index does not count up from 0");
  for (const GeometryUnit& unit : asset.units) {
    require(unit.field < asset.fields.size(), S09, "a geometry unit names a field that is not there");
    require(unit.material < asset.materials.size(), S09, "a geometry unit names a material that is not there");
    u32 named = asset.materials[unit.material].channels;
    if (!unit.planar) named = (named & ~(1u << 2 | 1u << 10)) | (named >> 2 & 1) << 3 | (named >> 10 & 1) << 11;
    used[unit.field] |= named;
    all_used |= named;
    has_geometry[unit.field] = true;
  }
  for (bool has : has_geometry) require(has, S11, "a field has no geometry unit");
  for (const ChannelGroup& group : asset.groups) there |= channels_of(group);
  require(!(all_used & ~there), S14, "a material names a channel that no group holds");
  require(asset.fields.empty() || !(there & ~(all_used | BASE)), S14, "a group holds a channel that nothing uses");
  bool neural = false, planar = false;
  for (const AttributeUnit& unit : asset.attributes) neural = neural || unit.codec == NEURAL;
  for (const Field& field : asset.fields) planar = planar || field.planar;
  if (neural) {
    require(asset.attributes.size() == 1, S11, "attribute units beside one of 3DNTC");
    require(asset.attributes[0].field == 0 && asset.attributes[0].group == 0, S11, "a 3DNTC unit is not that of field 0 and group 0");
    require(!planar, S13, "3DNTC with a field over texels");
  } else {
    size_t next = 0;
    for (size_t i = 0; i < asset.fields.size(); i++)
      for (size_t g = 0; g < asset.groups.size(); g++) {
        if (!(channels_of(asset.groups[g]) & (used[i] | BASE))) continue;
        require(next < asset.attributes.size(), S11, "an attribute unit is missing");
        const AttributeUnit& unit = asset.attributes[next++];
        require(unit.field == i && size_t(unit.group) == g, S11, "the attribute units are not those that the fields need, in order");
      }
    require(next == asset.attributes.size(), S11, "an attribute unit that no field needs");
  }
  bool marks = false, normals = false;
  for (const Material& material : asset.materials) {
    marks = marks || material.normal_rule >= 3;
    normals = normals || material.normal_rule == 6;
  }
  require(marks == asset.has_marks, S11, "a sharp edges unit without a rule that asks for it, or the other way round");
  require(normals == asset.has_normals, S11, "a coded normals unit without a rule that asks for it, or the other way round");
}

}  // namespace

std::unique_ptr<Asset> read_stream(const u8* data, size_t size, const texf_limits& limits) {
  within(size, limits.file_bytes, L01, "bytes of the stream");
  auto owner = std::make_unique<texf_asset>();
  Asset& asset = *owner;
  asset.limits = limits;
  Counts counts{};
  u64 vertices = 0, faces = 0, voxels = 0;
  bool materials = false;
  for (const Unit& unit : units_of({data, size})) {
    Reader reader(unit.payload);
    switch (unit.type) {
      case HEADER: counts = read_header(reader, asset); break;
      case MATERIALS:
        materials = true;
        read_materials(reader, asset, counts.materials);
        break;
      case FIELD:
        asset.fields.push_back(read_field(reader));
        within(voxels += asset.fields.back().num_keys, limits.voxels, L04, "voxels and texels");
        within(u64(asset.fields.back().width) * asset.fields.back().height, limits.texels, L11, "texels of an image");
        require(!asset.fields.back().planar || asset.fields.back().num_keys <= u64(asset.fields.back().width) * asset.fields.back().height, S04,
                "num_keys is more than the image has texels");
        break;
      case GEOMETRY:
        asset.units.push_back(read_geometry(reader, asset));
        within(vertices += asset.units.back().vertices, limits.vertices, L02, "vertices");
        within(faces += asset.units.back().faces, limits.faces, L03, "faces");
        break;
      case ATTRIBUTE: asset.attributes.push_back(read_attribute(reader, asset, counts.fields)); break;
      case METADATA:
        within(unit.payload.size, limits.metadata_bytes, L06, "bytes of metadata");
        if (reader.u8_("metadata_format") != 0) asset.skipped.push_back(unit.type);
        else asset.metadata.assign(reader.at(), reader.at() + reader.left());
        reader.rest();
        break;
      case SHARP_EDGES:
        asset.has_marks = true;
        asset.num_edges = reader.v("num_edges", 1);
        asset.marks_crc = reader.u32_("marks_crc");
        asset.marks_data = reader.rest();
        break;
      case CODED_NORMALS:
        asset.has_normals = true;
        asset.num_groups = reader.v("num_groups", 1);
        asset.normal_step = reader.u16_("normal_step", 1, 4096);
        asset.normals_crc = reader.u32_("normals_crc");
        asset.residual_data = reader.rest();
        break;
      case END: break;
      default: asset.skipped.push_back(unit.type); reader.rest();
    }
    if (reader.left() > 0) fail(S08, decimal(reader.left()) + " bytes are left over in a unit of type " + decimal(unit.type));
  }
  require(materials, S11, "there is no materials unit");
  check_units(asset, counts);
  return owner;
}

// ---- 5.6

namespace {

i64 whole_number(float value, int uv_bits, u64 uv_range) {  // 5.6.2, -1 where it stands for none
  i64 last = (1ll << uv_bits) - 1;
  double s = double(value) * (double(last) / double(uv_range)), n = std::floor(s + 0.5);
  if (!(n >= 0 && n <= double(last) && std::fabs(s - n) <= 0.25)) return -1;
  return (2 * i64(n) * i64(uv_range) + last) / (2 * last);
}

bool read_draco_header(Reader& draco, const GeometryUnit& unit) {  // and whether its symbols are coded by valences
  static const u8 start[11] = {0x44, 0x52, 0x41, 0x43, 0x4f, 2, 2, 1, 1, 0, 0};
  require(draco.left() >= 11 && memcmp(draco.take(11, "draco_data").data, start, 11) == 0, S20, "draco_data does not begin as 5.6 says");
  int traversal = draco.u8_("traversal type");
  require((traversal & ~2) == 0, S20, "draco_data has a traversal type other than 0 and 2");
  require_equal(draco.v("number of vertices"), unit.vertices, S21, "draco_data names another number of vertices");
  require_equal(draco.v("number of faces"), unit.faces, S21, "draco_data names another number of faces");
  return traversal > 0;
}

u32 geometry_crc(const GeometryUnit& unit) {  // 5.6.3
  int columns = unit.planar ? 5 : 3;
  u32 sum = 0;
  for (size_t f = 0; f < unit.num_faces(); f++) {
    i32 rows[3][15];
    for (int turn = 0; turn < 3; turn++)
      for (int i = 0; i < 3; i++) {
        u32 vertex = unit.corner[3 * f + (turn + i) % 3];
        for (int axis = 0; axis < columns; axis++)
          rows[turn][columns * i + axis] = axis < 3 ? i32(unit.position[3 * size_t(vertex) + axis]) : unit.uv[2 * size_t(vertex) + axis - 3];
      }
    int least = 0;
    for (int turn = 1; turn < 3; turn++)
      if (std::lexicographical_compare(rows[turn], rows[turn] + 3 * columns, rows[least], rows[least] + 3 * columns)) least = turn;
    sum += crc32(rows[least], 12 * columns);
  }
  return sum;
}

}  // namespace

void decode_geometry(GeometryUnit& unit, int position_bits) {
  Reader draco(unit.draco);
  bool by_valence = read_draco_header(draco, unit);
  decode_draco(unit, draco.rest(), by_valence);
  u64 points = unit.position.size() / 3, most = unit.planar ? 3 * unit.faces : unit.vertices;
  require(points >= unit.vertices && points <= most, S21, "draco_data decodes to another number of vertices");
  for (u32 p : unit.position) require(p >> position_bits == 0, S23, "a position is not below 2^position_bits");
  for (size_t i = 0; i < unit.uv.size(); i++) {
    i64 n = u32(unit.uv[i]);
    if (unit.uv_bits > 0) {
      float value;
      memcpy(&value, &unit.uv[i], 4);
      n = whole_number(value, unit.uv_bits, unit.uv_range);
    }
    require(n >= 0 && n < 1 << 20, S23, "a UV is out of its range");
    unit.uv[i] = i32(n) + unit.uv_origin[i % 2];
  }
  require(geometry_crc(unit) == unit.crc, S24, "geometry_crc does not match");
}

namespace {

// ---- Steps 6 and 7 of 9.2

void decode_field(Asset& asset, size_t i, size_t next, size_t end, int threads) {  // and its attribute units
  Field& field = asset.fields[i];
  field.keys = field.planar ? referenced_texels(asset, i, threads) : active_voxels(asset, i, field.resolution, field.area_threshold, threads);
  require_equal(field.keys.size(), field.num_keys, S30, "num_keys does not match");
  std::shared_ptr<Octree> octree;  // of groups with the same level_shift, one after the other
  int shift = -1;
  auto plant = [&](const AttributeUnit& unit) {
    if (shift == unit.level_shift) return;
    shift = unit.level_shift;
    octree = octree_of(shift == 0 ? field.keys : asset.cells(i, shift), unit.depth, unit.planar);
  };
  side_by_side(threads, 2, [&](size_t part) {
    if (part == 0) require(crc32(field.keys.data(), 8 * field.keys.size()) == field.keys_crc, S30, "keys_crc does not match");
    else if (threads > 1 && next < end && asset.attributes[next].codec == RAHT && asset.chooses(next)) plant(asset.attributes[next]);
  });
  for (; next < end; next++) {
    const AttributeUnit& unit = asset.attributes[next];
    check_stop();
    if (unit.codec == NEURAL || !asset.chooses(next)) continue;
    int lod = std::min(std::max(asset.lod - unit.level_shift, 0), unit.depth);
    std::vector<u8> values;
    if (unit.codec == CONSTANT) {
      size_t count = asset.cells(i, unit.level_shift + lod).size();
      for (size_t n = 0; n < count; n++) values.insert(values.end(), unit.plane_value, unit.plane_value + unit.components);
    } else {
      plant(unit);
      values = decode_raht(unit, *octree, lod, threads);
    }
    require(lod > 0 || crc32(values.data(), values.size()) == unit.values_crc, S32, "values_crc does not match");
    asset.values[i][unit.group] = std::move(values);
  }
}

void decode_fields(Asset& asset) {
  count_samples(asset);
  asset.values.assign(asset.fields.size(), std::vector<std::vector<u8>>(asset.groups.size()));
  asset.level_shift.assign(asset.fields.size() * asset.groups.size(), 0);
  std::vector<size_t> first{0};  // attribute unit of every field, and one more
  std::vector<size_t> wanted;    // fields
  for (size_t i = 0; i < asset.fields.size(); i++) {
    size_t end = first.back();
    bool some = false;
    for (; end < asset.attributes.size() && asset.attributes[end].field == i; end++) {
      asset.level_shift[i * asset.groups.size() + asset.attributes[end].group] = asset.attributes[end].level_shift;
      some = some || asset.chooses(end);
    }
    if (some || first.back() == end) wanted.push_back(i);
    first.push_back(end);
  }
  int threads = wanted.size() > 1 ? std::max<int>(1, asset.threads / int(wanted.size())) : asset.threads;
  side_by_side(asset.threads, wanted.size(), [&](size_t n) { decode_field(asset, wanted[n], first[wanted[n]], first[wanted[n] + 1], threads); });
  if (asset.attributes.size() == 1 && asset.attributes[0].codec == NEURAL && asset.chooses(0)) decode_neural(asset);
}

}  // namespace

std::unique_ptr<Asset> decode(const u8* data, size_t size, int lod, const texf_limits& limits, u32 chosen, int threads) {
  std::unique_ptr<Asset> asset = read_stream(data, size, limits);
  asset->chosen = chosen;
  asset->lod = std::max(lod, 0);
  asset->threads = threads;
  side_by_side(threads, asset->units.size(), [&](size_t i) { check_stop(), decode_geometry(asset->units[i], asset->position_bits); });
  if (asset->has_marks) decode_marks(*asset);
  if (asset->has_normals) decode_normals(*asset);
  decode_fields(*asset);
  return asset;
}

}  // namespace texf
