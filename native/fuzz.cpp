// libFuzzer's target: any bytes are a stream that is decoded or refused. Checksums of units are made right, so that what is behind
// them is met; limits are small, so that an execution is quick.
#include "core.hpp"

namespace {

void mend(std::vector<texf::u8>& data) {
  size_t at = 8;
  while (at < data.size()) {
    size_t start = at++;
    texf::u64 length = 0;
    for (int i = 0; i < 8 && at < data.size(); i++) {
      texf::u8 byte = data[at++];
      length |= texf::u64(byte & 127) << (7 * i);
      if (byte < 128) break;
    }
    if (length > data.size() - at || data.size() - at - length < 4) return;
    texf::u32 crc = texf::crc32(&data[start], at + length - start);
    at += length;
    memcpy(&data[at], &crc, 4);
    at += 4;
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* bytes, size_t size) {
  std::vector<texf::u8> data(bytes, bytes + size);
  if (size > 8) mend(data);
  texf_limits limits = {1 << 16, 1 << 14, 1 << 14, 1 << 16, 1 << 18, 1 << 20, 1 << 16, 1 << 12};
  texf_asset* asset;
  if (texf_decode_threads(data.data(), data.size(), size % 3, &limits, 1 + size % 4, &asset, nullptr) != TEXF_OK) return 0;
  for (int kind = TEXF_DESCRIPTION; kind <= TEXF_IMAGE; kind++)
    for (texf::u32 i = 0; i < 3; i++)
      for (texf::u32 j = 0; j < 3; j++) {
        size_t count;
        texf_array(asset, kind, i, j, &count);
      }
  texf_free(asset);
  return 0;
}
