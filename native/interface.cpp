// The C interface (texf.h): one decode, and the arrays of what was decoded.
#include <cmath>
#include <new>

#include "core.hpp"

namespace texf {
namespace {

// ---- What is no array, as JSON

class Json {
 public:
  std::string text;
  Json& open(char bracket) { return comma(), text += bracket, fresh_ = true, *this; }
  Json& close(char bracket) { return text += bracket, fresh_ = false, *this; }
  Json& key(const char* name) { return string(name), text += ':', fresh_ = true, *this; }
  Json& number(double value) {  // with all its decimals: m / 2^n is m * 5^n / 10^n
    int exponent;
    double left = std::frexp(value < 0 ? -value : value, &exponent);
    u64 m = u64(std::ldexp(left, 53));
    exponent -= 53;
    for (; m > 0 && m % 2 == 0 && exponent < 0; m /= 2) exponent++;
    std::string digits = decimal(m);
    for (int n = exponent; m > 0 && n != 0; n += n < 0 ? 1 : -1) multiply(digits, n < 0 ? 5 : 2);
    comma();
    if (value < 0) text += '-';
    text += digits;
    if (m > 0 && exponent < 0) text += "e-" + decimal(-exponent);
    return *this;
  }
  Json& string(const std::string& value) {
    comma();
    text += '"';
    for (char c : value) {
      if (c == '"' || c == '\\') text += '\\';
      if (u8(c) < 32) text += c < 16 ? "\\u000" : "\\u001", text += "0123456789abcdef"[c % 16];
      else text += c;
    }
    text += '"';
    return *this;
  }
  Json& field(const char* name, double value) { return key(name).number(value); }

 private:
  static void multiply(std::string& digits, int factor) {
    int carry = 0;
    for (size_t i = digits.size(); i-- > 0; carry /= 10) {
      carry += factor * (digits[i] - '0');
      digits[i] = char('0' + carry % 10);
    }
    if (carry > 0) digits.insert(digits.begin(), char('0' + carry));
  }
  void comma() {
    if (!fresh_) text += ',';
    fresh_ = false;
  }
  bool fresh_ = true;
};

void describe_network(const AttributeUnit& unit, Json& json) {
  json.open('{').field("features", unit.num_features).field("octaves", unit.wave_octaves).field("first_wave", unit.first_wave);
  json.key("widths").open('[');
  for (int width : unit.widths) json.number(width);
  json.close(']').key("levels").open('[');
  u64 row = 0;
  for (const LatentLevel& level : unit.levels) {
    json.open('{').field("resolution", level.resolution).field("log2", level.table_log2).key("first_rows").open('[');
    if (level.table_log2 > 0) json.number(double(row));  // one table for all fields
    for (size_t i = 0, first = row; i < level.num_latents.size(); first += level.num_latents[i++]) json.number(double(first));
    json.close(']').close('}');
    row += level.num_rows;
  }
  json.close(']').close('}');
}

std::string description_of(const Asset& asset) {
  Json json;
  json.open('{').field("position_bits", asset.position_bits).field("side", asset.side).field("lod", asset.lod);
  json.key("origin").open('[').number(asset.origin[0]).number(asset.origin[1]).number(asset.origin[2]).close(']');
  json.key("groups").open('[');
  for (const ChannelGroup& group : asset.groups) {
    json.open('{').field("components", group.components).key("semantics").open('[');
    for (int semantic : group.semantics) json.number(semantic);
    json.close(']').close('}');
  }
  json.close(']').key("materials").open('[');
  for (const Material& material : asset.materials) {
    json.open('{').key("name").string(material.name).field("alpha_mode", material.alpha_mode);
    json.field("alpha_cutoff", material.alpha_cutoff).field("flags", material.flags).field("normal_rule", material.normal_rule);
    json.field("normal_angle", material.normal_angle).field("channels", material.channels).key("parameters").open('{');
    for (const Parameter& parameter : material.parameters) {
      json.key(std::to_string(parameter.id).c_str()).open('[');
      for (float value : parameter.value) json.number(value);
      json.close(']');
    }
    json.close('}').close('}');
  }
  json.close(']').key("units").open('[');
  for (const GeometryUnit& unit : asset.units) {
    json.open('{').field("field", unit.field).field("material", unit.material).field("vertices", double(unit.position.size() / 3));
    json.field("faces", double(unit.num_faces())).close('}');
  }
  json.close(']').key("fields").open('[');
  for (size_t i = 0; i < asset.fields.size(); i++) {
    const Field& field = asset.fields[i];
    json.open('{').field("planar", field.planar).field("resolution", field.resolution).field("width", field.width);
    json.field("height", field.height).field("wrap_s", field.wrap[0]).field("wrap_t", field.wrap[1]);
    json.field("fraction_bits", field.fraction_bits).field("levels_left_out", asset.levels_left_out(i)).key("level_shift").open('[');
    for (size_t g = 0; g < asset.groups.size(); g++) json.number(asset.level_shift[i * asset.groups.size() + g]);
    json.close(']').key("qp").open('[');
    for (size_t g = 0; g < asset.groups.size(); g++) {
      int qp = -1;
      for (const AttributeUnit& unit : asset.attributes)
        if (unit.codec == RAHT && unit.field == i && size_t(unit.group) == g) qp = unit.qp[0];
      json.number(qp);
    }
    json.close(']').close('}');
  }
  json.close(']').field("sharp_edges", asset.has_marks).field("coded_normals", asset.has_normals);
  json.field("neural", asset.attributes.size() == 1 && asset.attributes[0].codec == NEURAL);
  if (!asset.latents.empty()) describe_network(asset.attributes[0], json.key("network"));
  json.key("skipped").open('[');
  for (int type : asset.skipped) json.number(type);
  json.close(']').close('}');
  return json.text;
}

// The texels of a group as an image of the level of detail. What is not in the field gets the mean of what is in the smallest
// square of a quadtree around it that holds any, so that mipmaps meet nothing foreign.
struct Picture {  // a level of an image, and which of its texels have a value
  int width, height;
  std::vector<u8> texels, there;
};

template <int count>
std::vector<u8> filled_image(Picture whole) {
  std::vector<Picture> levels;
  levels.push_back(std::move(whole));
  while (levels.back().width > 1 || levels.back().height > 1) {
    const Picture& fine = levels.back();
    Picture coarse{(fine.width + 1) / 2, (fine.height + 1) / 2, {}, {}};
    size_t cells = size_t(coarse.width) * coarse.height;
    coarse.texels.resize(cells * count), coarse.there.resize(cells);
    for (size_t at = 0, y = 0; y < size_t(fine.height); y += 2)
      for (size_t x = 0; x < size_t(fine.width); x += 2, at++) {
        size_t first = y * fine.width + x;
        u32 sums[count] = {}, n = 0;
        for (size_t down = 0; down < 2 && y + down < size_t(fine.height); down++)
          for (size_t right = 0; right < 2 && x + right < size_t(fine.width); right++) {
            size_t from = first + down * fine.width + right;
            n += fine.there[from];
            for (int c = 0; c < count; c++) sums[c] += fine.texels[from * count + c];  // 0 where there is none
          }
        if (n == 0) continue;
        coarse.there[at] = 1;
        for (int c = 0; c < count; c++) coarse.texels[at * count + c] = n == 4 ? u8((sums[c] + 2) >> 2) : u8((sums[c] + n / 2) / n);
      }
    levels.push_back(std::move(coarse));
  }
  for (size_t l = levels.size() - 1; l-- > 0;) {
    Picture &fine = levels[l], &coarse = levels[l + 1];
    for (size_t at = 0, y = 0; y < size_t(fine.height); y++)
      for (size_t x = 0; x < size_t(fine.width); x++, at++)
        if (!fine.there[at]) memcpy(&fine.texels[at * count], &coarse.texels[(y / 2 * coarse.width + x / 2) * count], count);
  }
  return std::move(levels[0].texels);
}

std::vector<u8> image_of(const Asset& asset, size_t i, size_t g) {
  const Field& field = asset.fields[i];
  int left_out = std::max(asset.levels_left_out(i), int(asset.level_shift[i * asset.groups.size() + g]));
  int count = asset.groups[g].components, width = int(ceil_div(field.width, 1ll << left_out)), height = int(ceil_div(field.height, 1ll << left_out));
  Picture whole{width, height, std::vector<u8>(size_t(width) * height * count), std::vector<u8>(size_t(width) * height)};
  const std::vector<u8>& values = asset.values[i][g];
  std::vector<u64> cells = asset.cells(i, left_out);
  for (size_t n = 0; n < cells.size(); n++) {
    size_t at = gathered_bits(cells[n] >> 1) * width + gathered_bits(cells[n]);
    memcpy(&whole.texels[at * count], &values[n * count], count);
    whole.there[at] = 1;
  }
  return count == 1 ? filled_image<1>(std::move(whole)) : count == 2 ? filled_image<2>(std::move(whole)) : filled_image<3>(std::move(whole));
}

}  // namespace
}  // namespace texf

// ---- The C interface

using namespace texf;

texf_limits texf_usual_limits(void) {
  return {1ull << 28, 1ull << 24, 1ull << 24, 1ull << 26, 1ull << 27, 1ull << 31, 1ull << 28, 1ull << 20};
}

namespace {
#if defined(__cpp_exceptions)
template <typename What>
texf_refusal guarded(What what) {  // nothing is thrown across the C interface
  try {
    what();
  } catch (const texf_refusal& refused) {
    return refused;
  } catch (const std::bad_alloc&) {
    return {L07, 0, 0, 0, "there is not enough memory for this stream"};
  } catch (...) {
    return {C04, 0, 0, 0, "the decoder has failed"};
  }
  return {};
}
#else  // a sandbox: a refusal is kept where its host looks, and the program stops
texf_refusal kept;
template <typename What>
texf_refusal guarded(What what) {
  what();
  return {};
}
#endif
}  // namespace

#if defined(__cpp_exceptions)
void texf::refuse(const texf_refusal& refusal) { throw refusal; }
#else
void texf::refuse(const texf_refusal& refusal) {
  kept = refusal;
  __builtin_trap();
}
extern "C" const texf_refusal* texf_kept_refusal(void) { return &kept; }
#endif

int texf_decode(const uint8_t* data, size_t size, int lod, const texf_limits* limits, texf_asset** asset, texf_refusal* refusal) {
  return texf_decode_chosen(data, size, lod, limits, ~0u, asset, refusal);
}

namespace {
int decode_guarded(Bytes data, int lod, const texf_limits* limits, u32 chosen, int threads, texf_asset** asset, texf_refusal* refusal) {
  *asset = nullptr;
  texf_refusal found = guarded([&] {
    *asset = static_cast<texf_asset*>(decode(data.data, data.size, lod, limits ? *limits : texf_usual_limits(), chosen, threads).release());
  });
  if (refusal) *refusal = found;
  return found.finding / 100;
}
}  // namespace

int texf_decode_chosen(const uint8_t* data, size_t size, int lod, const texf_limits* limits, uint32_t chosen, texf_asset** asset,
                       texf_refusal* refusal) {
  return decode_guarded({data, size}, lod, limits, chosen, 1, asset, refusal);
}

int texf_decode_threads(const uint8_t* data, size_t size, int lod, const texf_limits* limits, int threads, texf_asset** asset,
                        texf_refusal* refusal) {
  return decode_guarded({data, size}, lod, limits, ~0u, std::min(threads, 256), asset, refusal);
}

void texf_free(texf_asset* asset) { delete asset; }

uint32_t texf_version(void) { return TEXF_INTERFACE; }

#if defined(__cpp_exceptions)
void texf_set_stop(const int32_t* flag) { stop_flag = flag; }
#endif

namespace {
template <typename T>
const void* array_of(const std::vector<T>& found, size_t* bytes) {
  *bytes = found.size() * sizeof(T);
  return found.empty() ? nullptr : found.data();
}

const void* find_array(texf_asset& asset, int kind, u32 i, u32 j, size_t* bytes) {
  bool of_unit = kind >= TEXF_POSITIONS && kind <= TEXF_NORMALS, of_field = kind == TEXF_KEYS || kind == TEXF_VALUES || kind == TEXF_IMAGE;
  if (of_unit && i >= asset.units.size()) return nullptr;
  if (of_field && (i >= asset.fields.size() || (kind != TEXF_KEYS && j >= asset.groups.size()))) return nullptr;
  switch (kind) {
    case TEXF_DESCRIPTION:
      if (asset.description.empty()) asset.description = description_of(asset);
      *bytes = asset.description.size();
      return asset.description.data();
    case TEXF_METADATA: return array_of(asset.metadata, bytes);
    case TEXF_POSITIONS: return array_of(asset.units[i].position, bytes);
    case TEXF_UVS: return array_of(asset.units[i].uv, bytes);
    case TEXF_FACES: return array_of(asset.units[i].corner, bytes);
    case TEXF_NORMALS:
      if (asset.corner_normals.empty()) asset.corner_normals = shading_normals(asset);
      return array_of(asset.corner_normals[i], bytes);
    case TEXF_KEYS:
      if (asset.levels_left_out(i) == 0) return array_of(asset.fields[i].keys, bytes);
      asset.coarse_keys.resize(asset.fields.size());
      if (asset.coarse_keys[i].empty()) asset.coarse_keys[i] = asset.cells(i, asset.levels_left_out(i));
      return array_of(asset.coarse_keys[i], bytes);
    case TEXF_VALUES: return array_of(asset.values[i][j], bytes);
    case TEXF_SHARP_EDGES: return array_of(asset.marks, bytes);
    case TEXF_CODED_NORMALS: return array_of(asset.normals, bytes);
    case TEXF_IMAGE: {
      if (!asset.fields[i].planar || asset.values[i][j].empty()) return nullptr;
      asset.images.resize(asset.fields.size() * asset.groups.size());
      std::vector<u8>& image = asset.images[i * asset.groups.size() + j];
      if (image.empty()) image = image_of(asset, i, j);
      return array_of(image, bytes);
    }
    case TEXF_LATENTS: return array_of(asset.latents, bytes);
    case TEXF_NETWORK: return array_of(asset.network, bytes);
    case TEXF_LATENT_KEYS: {
      if (asset.latents.empty() || j >= asset.attributes[0].levels.size() || i >= asset.attributes[0].levels[j].keys.size()) return nullptr;
      return array_of(asset.attributes[0].levels[j].keys[i], bytes);
    }
    default: return nullptr;
  }
}
}  // namespace

const void* texf_array(texf_asset* asset, int kind, uint32_t i, uint32_t j, size_t* bytes) {
  const void* found = nullptr;
  *bytes = 0;
  if (guarded([&] { found = find_array(*asset, kind, i, j, bytes); }).finding != 0) *bytes = 0;
  return *bytes > 0 ? found : nullptr;
}
