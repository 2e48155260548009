// What a page or a sandbox calls, one decode an instance: memory is given back with the instance. A refusal stops the program
// (unreachable); refusal() says why, its finding is 0 where it has stopped for lack of memory.
#include <cstdlib>

#include <__verbose_abort>

#include "texf.h"

// In place of libc++'s, which prints: a page sees no output, and printf() takes a tenth of the module.
[[noreturn]] void std::_LIBCPP_ABI_NAMESPACE::__libcpp_verbose_abort(const char*, ...) noexcept { __builtin_trap(); }

#define EXPORT(name) extern "C" __attribute__((export_name(#name)))

namespace {
texf_limits limits = texf_usual_limits();
texf_asset* asset = nullptr;
size_t bytes = 0;
}  // namespace

extern "C" const texf_refusal* texf_kept_refusal(void);

EXPORT(allocate) void* exported_allocate(size_t size) { return malloc(size); }
EXPORT(release) void exported_release(void* memory) { free(memory); }
EXPORT(limits) texf_limits* exported_limits() { return &limits; }
EXPORT(decode) int exported_decode(const uint8_t* data, size_t size, int lod) {
  return texf_decode(data, size, lod, &limits, &asset, nullptr);
}
EXPORT(decode_chosen) int exported_decode_chosen(const uint8_t* data, size_t size, int lod, uint32_t chosen) {
  return texf_decode_chosen(data, size, lod, &limits, chosen, &asset, nullptr);
}
EXPORT(array) const void* exported_array(int kind, uint32_t i, uint32_t j) {
  return texf_array(asset, kind, i, j, &bytes);
}
EXPORT(array_bytes) size_t exported_array_bytes() { return bytes; }
EXPORT(refusal) const texf_refusal* exported_refusal() { return texf_kept_refusal(); }
