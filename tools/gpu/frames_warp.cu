// A warp of 32 threads on a CPU, for a test of frames_tensor.cu: what it takes of CUDA, by threads and a barrier. It follows
// frames_pixel.cu. Registers of matrices are where PTX's description of mma.m16n8k16 has them.
#include <barrier>
#include <cstring>
#include <thread>
#include <vector>

struct uint4 { uint32 x, y, z, w; };
struct Index { int x; };
static thread_local Index threadIdx;
static Index blockDim{32};
static std::barrier<> together(32);
static uint32 registers_a[32][4], registers_b[32][2];

static uint4 make_uint4(uint32 x, uint32 y, uint32 z, uint32 w) { return {x, y, z, w}; }
static void __syncwarp() { together.arrive_and_wait(); }
static void __syncthreads() { together.arrive_and_wait(); }

static uint32 half_of(float value) {
  const _Float16 half = (_Float16)value;
  unsigned short bits;
  memcpy(&bits, &half, 2);
  return bits;
}

static float value_of(uint32 word, int upper) {
  const unsigned short bits = (unsigned short)(upper ? word >> 16 : word);
  _Float16 half;
  memcpy(&half, &bits, 2);
  return (float)half;
}

static uint32 halves(float low, float high) { return half_of(low) | half_of(high) << 16; }

// a: row g or g + 8, columns 2 t, 2 t + 1, or 8 further; b: rows as those columns, column g; sum: row g or g + 8, columns 2 t, 2 t + 1.
static void multiply(float sum[4], const uint32 a[4], uint2 b) {
  const int lane = threadIdx.x;
  memcpy(registers_a[lane], a, sizeof registers_a[lane]);
  registers_b[lane][0] = b.x, registers_b[lane][1] = b.y;
  together.arrive_and_wait();
  for (int c = 0; c < 4; c++) {
    const int row = (lane >> 2) + 8 * (c >> 1), column = 2 * (lane & 3) + (c & 1);
    for (int k = 0; k < 16; k++) {
      const int t = (k & 7) >> 1, far = k >> 3;
      sum[c] += value_of(registers_a[4 * (row & 7) + t][(row >> 3) + 2 * far], k & 1) * value_of(registers_b[4 * column + t][far], k & 1);
    }
  }
  together.arrive_and_wait();
}
