// The heap of the WebAssembly module. The C library's asks the host for 64 kB at a time, and each time costs a page 0.1 ms; this one
// asks for 1 MB or an eighth of what it has. Block sizes are 4 a doubling, and the free blocks of a size are a list.
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <initializer_list>

namespace {

constexpr size_t PAGE = 65536, LEAST = 16, MOST = size_t(1) << 30;

struct Header {  // in the 16 bytes before what malloc() returns
  char* block;
  uint32_t number;
};

char *next_block = nullptr, *heap_end = nullptr, *free_blocks[128];

size_t size_of(uint32_t number) { return size_t(4 + number % 4) << (number / 4 + 4); }
uint32_t number_of(size_t size) {  // of the smallest block that holds so many bytes
  if (size <= size_of(0)) return 0;
  int top = 31 - __builtin_clz(uint32_t(size - 1));
  return uint32_t(4 * (top - 6) + ((size - 1) >> (top - 2)) - 3);
}

bool grow(size_t size) {
  size_t least = (size + PAGE - 1) / PAGE, usual = __builtin_wasm_memory_size(0) / 8;
  if (usual < LEAST) usual = LEAST;
  for (size_t pages : {usual > least ? usual : least, least}) {
    size_t at = __builtin_wasm_memory_grow(0, pages);
    if (at == ~size_t(0)) continue;
    char* begin = reinterpret_cast<char*>(at * PAGE);
    if (begin != heap_end) next_block = begin;
    heap_end = begin + pages * PAGE;
    return true;
  }
  return false;
}

Header& header(void* place) { return static_cast<Header*>(place)[-2]; }

}  // namespace

static_assert(sizeof(Header) == 8, "two of them are 16 bytes");

extern "C" {

__attribute__((noinline)) void* aligned_alloc(size_t alignment, size_t size) {
  if (size > MOST || alignment > PAGE) return nullptr;
  if (alignment < 16) alignment = 16;
  uint32_t number = number_of(size + alignment);
  char* block = free_blocks[number];
  if (block) {
    memcpy(&free_blocks[number], block, sizeof block);
  } else {
    if (size_t(heap_end - next_block) < size_of(number) && !grow(size_of(number))) return nullptr;
    block = next_block;
    next_block += size_of(number);
  }
  void* place = reinterpret_cast<void*>((reinterpret_cast<size_t>(block) + 16 + alignment - 1) & -alignment);
  header(place) = {block, number};
  return place;
}

void* malloc(size_t size) { return aligned_alloc(16, size); }

__attribute__((noinline)) void free(void* place) {
  if (!place) return;
  auto [block, number] = header(place);
  memcpy(block, &free_blocks[number], sizeof block);
  free_blocks[number] = block;
}

void* calloc(size_t count, size_t size) {
  if (size > 0 && count > MOST / size) return nullptr;
  void* place = malloc(count * size);
  return place ? memset(place, 0, count * size) : nullptr;
}

void* realloc(void* place, size_t size) {
  if (!place) return malloc(size);
  auto [block, number] = header(place);
  size_t held = size_t(block + size_of(number) - static_cast<char*>(place));
  if (size <= held) return place;
  void* other = malloc(size);
  if (!other) return nullptr;
  memcpy(other, place, held);
  free(place);
  return other;
}

}
