// Frames by compute, the kernels: a visibility buffer in three steps, a list of visible pixels, and one pass over it. They follow
// frames_pixel.cu in one text.

#define STRIP 8      // rows of pixels that a warp goes through at a time
#define LITTLE 48    // pixels of a face's box up to which one thread fills it
#define FULL 0xffffffffu
#define THREAD (blockIdx.x * blockDim.x + threadIdx.x)

// counts: [0] strips of large faces, [1] visible pixels.
extern "C" __global__ void clear_kernel(uint64* visible, uint32* image, int pixels, uint32* counts) {
  const int i = THREAD;
  if (i < 2) counts[i] = 0u;
  if (i >= pixels) return;
  visible[i] = ~0ull;
  image[i] = 0x00ffffffu;
}

extern "C" __global__ void vertices_kernel(const Asset* asset, const Camera* camera, float4* seen) {
  const int v = THREAD;
  if (v < asset->vertices) seen[v] = seen_of(*asset, *camera, v);
}

// Small faces are filled here, large ones join the queue as strips of rows: (face, first row).
extern "C" __global__ void faces_kernel(const Asset* asset, const Camera* camera, const float4* seen, uint64* visible, int2* queue,
                                        uint32 room, uint32* counts) {
  const int f = THREAD, side = camera->side, lane = threadIdx.x & 31;
  Triangle t;
  const bool is_seen = f < asset->face_count && triangle_of(*asset, seen, f, side, t);
  const bool is_large = is_seen && (t.right - t.left + 1) * (t.bottom - t.top + 1) > LITTLE;
  const uint32 strips = is_large ? (uint32)((t.bottom - t.top) / STRIP + 1) : 0u;
  uint32 before = strips;
  for (int step = 1; step < 32; step *= 2) {
    const uint32 other = __shfl_up_sync(FULL, before, step);
    if (lane >= step) before += other;
  }
  uint32 first = 0u;
  if (lane == 31 && before) first = atomicAdd(counts, before);
  first = __shfl_sync(FULL, first, 31) + before - strips;
  for (uint32 n = 0; n < strips && first + n < room; n++) queue[first + n] = make_int2(f, t.top + (int)n * STRIP);
  if (!is_seen || is_large) return;
  for (int y = t.top; y <= t.bottom; y++) {
    for (int x = t.left; x <= t.right; x++) compete(t, f, x, y, side, visible);
  }
}

// A warp goes through one strip: 32 boxes of 32 columns are looked at together, then those that meet the face pixel by pixel.
extern "C" __global__ void strips_kernel(const Asset* asset, const Camera* camera, const float4* seen, uint64* visible,
                                         const int2* queue, uint32 room, const uint32* counts) {
  const int side = camera->side, lane = threadIdx.x & 31;
  const uint32 count = counts[0] < room ? counts[0] : room, warps = gridDim.x * blockDim.x / 32;
  for (uint32 item = THREAD / 32; item < count; item += warps) {
    const int2 strip = queue[item];
    Triangle t;
    triangle_of(*asset, seen, strip.x, side, t);
    const int bottom = least(strip.y + STRIP - 1, t.bottom);
    for (int begin = t.left; begin <= t.right; begin += 32 * 32) {
      const int box = begin + 32 * lane;
      uint32 left = __ballot_sync(FULL, box <= t.right && meets(t, box, strip.y, least(box + 31, t.right), bottom));
      for (; left; left &= left - 1u) {
        const int x = begin + 32 * (__ffs(left) - 1) + lane;
        for (int y = strip.y; x <= t.right && y <= bottom; y++) compete(t, strip.x, x, y, side, visible);
      }
    }
  }
}

// List of visible pixels; a block of 256 threads takes 16 x 16 of them, a warp 8 x 4, so that neighbours stay together.
extern "C" __global__ void list_kernel(const uint64* visible, int side, uint32* list, uint32* counts) {
  __shared__ uint32 sums[8], first;
  const int lane = threadIdx.x & 31, warp = threadIdx.x >> 5;
  const int x = blockIdx.x * 16 + (warp & 1) * 8 + (lane & 7), y = blockIdx.y * 16 + (warp >> 1) * 4 + (lane >> 3);
  const bool is_seen = x < side && y < side && visible[(long long)y * side + x] != ~0ull;
  const uint32 seen = __ballot_sync(FULL, is_seen);
  if (lane == 0) sums[warp] = __popc(seen);
  __syncthreads();
  if (threadIdx.x == 0) {
    uint32 total = 0u;
    for (int w = 0; w < 8; w++) {
      const uint32 own = sums[w];
      sums[w] = total;
      total += own;
    }
    first = total ? atomicAdd(counts + 1, total) : 0u;
  }
  __syncthreads();
  if (is_seen) list[first + sums[warp] + __popc(seen & ((1u << lane) - 1u))] = y * side + x;
}

// One pass over visible pixels.
#define SHADE_KERNEL(name, kind)                                                                                            \
  extern "C" __global__ void name(const Asset* asset, const Camera* camera, const float4* seen, const uint64* visible,     \
                                  const uint32* list, const uint32* counts, uint32* image) {                               \
    const uint32 count = counts[1];                                                                                        \
    for (uint32 i = THREAD; i < count; i += gridDim.x * blockDim.x) {                                                      \
      const int pixel = (int)list[i];                                                                                      \
      image[pixel] = shade(*asset, *camera, seen, visible, pixel, kind);                                                   \
    }                                                                                                                      \
  }
SHADE_KERNEL(voxels_kernel, VOXELS)
SHADE_KERNEL(texels_kernel, TEXELS)
SHADE_KERNEL(neural_plain_kernel, NEURAL)

// positions: x, y, z of 2**24 a side and the field.
extern "C" __global__ void points_plain_kernel(const Asset* asset, const int* positions, int count, float* out) {
  const int i = THREAD;
  if (i < count) network_at(*asset, positions[4 * i + 3], positions + 4 * i, out + 3 * i);
}

// ---- The network on tensor cores: a warp evaluates 32 points as two tiles of 16, weights and activations of 16 bits, sums of 32.
// What a product leaves in a thread's registers is just what the next layer's product takes from them (mma.m16n8k16).

#define WARPS 4
#define PADDED 64             // inputs with zeros, a multiple of 16
#define ROW (PADDED / 2 + 4)  // words of a point in shared memory: 8 lanes of 16 bytes meet every bank once
#define TILES1 (PADDED / 16 * HIDDEN1 / 8)
#define TILES2 (HIDDEN1 / 16 * HIDDEN2 / 8)
#define TILES3 (HIDDEN2 / 16 * HIDDEN3 / 8)
#define TILES4 (HIDDEN3 / 16)
#define TILES (TILES1 + TILES2 + TILES3 + TILES4)
#define BIASES (HIDDEN1 + HIDDEN2 + HIDDEN3 + 8)

FN uint32 halves(float low, float high) {
  uint32 out;
  asm("cvt.rn.f16x2.f32 %0, %1, %2;" : "=r"(out) : "f"(high), "f"(low));
  return out;
}

FN void multiply(float sum[4], const uint32 a[4], uint2 b) {
  asm("mma.sync.aligned.m16n8k16.row.col.f32.f16.f16.f32 {%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, {%0, %1, %2, %3};"
      : "+f"(sum[0]), "+f"(sum[1]), "+f"(sum[2]), "+f"(sum[3])
      : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b.x), "r"(b.y));
}

// in, out: [2 tiles][16 components each][4 registers]; fragment: of the layer, tile after tile; bias: of the layer.
template <int INS, int OUTS>
FN void hidden_layer(const uint32 (&in)[2][INS][4], uint32 (&out)[2][OUTS][4], const uint2* fragment, const float* bias, int lane) {
#pragma unroll
  for (int o = 0; o < OUTS; o++) {
    float sum[2][2][4];
#pragma unroll
    for (int n = 0; n < 2; n++) {
      const float even = bias[16 * o + 8 * n + 2 * (lane & 3)], odd = bias[16 * o + 8 * n + 2 * (lane & 3) + 1];
#pragma unroll
      for (int m = 0; m < 2; m++) sum[m][n][0] = sum[m][n][2] = even, sum[m][n][1] = sum[m][n][3] = odd;
#pragma unroll
      for (int i = 0; i < INS; i++) {
        const uint2 b = fragment[((2 * o + n) * INS + i) * 32 + lane];
        multiply(sum[0][n], in[0][i], b);
        multiply(sum[1][n], in[1][i], b);
      }
#pragma unroll
      for (int m = 0; m < 2; m++) {
#pragma unroll
        for (int k = 0; k < 4; k++) sum[m][n][k] = hard_gelu(limited(sum[m][n][k]));
        out[m][o][2 * n] = halves(sum[m][n][0], sum[m][n][1]);
        out[m][o][2 * n + 1] = halves(sum[m][n][2], sum[m][n][3]);
      }
    }
  }
}

struct Shared {
  uint2 fragments[TILES * 32];
  float biases[BIASES];
  __align__(16) uint32 inputs[WARPS][32 * ROW];
};

FN void load_network(const Asset& asset, Shared& shared) {
  for (int i = threadIdx.x; i < TILES * 32; i += blockDim.x) shared.fragments[i] = asset.fragments[i];
  const float* bias = asset.matrices + INPUTS * HIDDEN1 + HIDDEN1 * HIDDEN2 + HIDDEN2 * HIDDEN3 + HIDDEN3 * OUTPUTS;
  const int known = HIDDEN1 + HIDDEN2 + HIDDEN3 + OUTPUTS;
  for (int i = threadIdx.x; i < BIASES; i += blockDim.x) shared.biases[i] = i < known ? bias[i] : 0.0f;
  __syncthreads();
}

// Colours at the positions of a warp's 32 lanes, all of which take part.
FN void network_of_warp(const Asset& asset, Shared& shared, int field, const int position[3], float colour[3]) {
  const int lane = threadIdx.x & 31, group = lane >> 2, two = lane & 3;
  uint32* rows = shared.inputs[threadIdx.x >> 5];
  {
    float inputs[PADDED];
#pragma unroll
    for (int i = INPUTS; i < PADDED; i++) inputs[i] = 0.0f;
    inputs_at(asset, field, position, inputs);
#pragma unroll
    for (int i = 0; i < PADDED; i += 8) {
      reinterpret_cast<uint4*>(rows + lane * ROW)[i / 8] =
          make_uint4(halves(inputs[i], inputs[i + 1]), halves(inputs[i + 2], inputs[i + 3]), halves(inputs[i + 4], inputs[i + 5]),
                     halves(inputs[i + 6], inputs[i + 7]));
    }
  }
  __syncwarp();
  uint32 a[2][PADDED / 16][4], b[2][HIDDEN1 / 16][4], c[2][HIDDEN2 / 16][4], d[2][HIDDEN3 / 16][4];
#pragma unroll
  for (int m = 0; m < 2; m++) {
#pragma unroll
    for (int i = 0; i < PADDED / 16; i++) {
      const uint32 *upper = rows + (16 * m + group) * ROW + 8 * i + two, *lower = upper + 8 * ROW;
      a[m][i][0] = upper[0], a[m][i][1] = lower[0], a[m][i][2] = upper[4], a[m][i][3] = lower[4];
    }
  }
  const uint2* fragment = shared.fragments;
  const float* bias = shared.biases;
  hidden_layer(a, b, fragment, bias, lane);
  fragment += 32 * TILES1, bias += HIDDEN1;
  hidden_layer(b, c, fragment, bias, lane);
  fragment += 32 * TILES2, bias += HIDDEN2;
  hidden_layer(c, d, fragment, bias, lane);
  fragment += 32 * TILES3, bias += HIDDEN3;
  __syncwarp();
  float* answers = reinterpret_cast<float*>(rows);  // 8 components of 32 points
#pragma unroll
  for (int m = 0; m < 2; m++) {
    float sum[4] = {bias[2 * two], bias[2 * two + 1], bias[2 * two], bias[2 * two + 1]};
#pragma unroll
    for (int i = 0; i < HIDDEN3 / 16; i++) multiply(sum, d[m][i], fragment[32 * i + lane]);
    float *upper = answers + 9 * (16 * m + group) + 2 * two, *lower = upper + 9 * 8;
    upper[0] = sum[0], upper[1] = sum[1], lower[0] = sum[2], lower[1] = sum[3];
  }
  __syncwarp();
  for (int k = 0; k < 3; k++) colour[k] = coded(answers[9 * lane + k]);
  __syncwarp();
}

extern "C" __global__ void __launch_bounds__(32 * WARPS) neural_tensor_kernel(
    const Asset* asset, const Camera* camera, const float4* seen, const uint64* visible, const uint32* list, const uint32* counts,
    uint32* image) {
  __shared__ Shared shared;
  const uint32 count = counts[1];
  const float fineness = camera->fineness;
  if (fineness < 1.0f) load_network(*asset, shared);
  for (uint32 begin = blockIdx.x * blockDim.x; begin < count; begin += gridDim.x * blockDim.x) {
    const bool is_there = begin + threadIdx.x < count;
    const int pixel = (int)list[is_there ? begin + threadIdx.x : begin];
    float weight[3], grid[3], colour[3] = {0.0f, 0.0f, 0.0f};
    const int f = face_at(*asset, seen, visible, pixel, camera->side, weight);
    grid_at(*asset, f, weight, grid);
    if (fineness < 1.0f) {
      int position[3];
      position_of(*asset, grid, position);
      network_of_warp(*asset, shared, asset->face_field[f], position, colour);
      for (int k = 0; k < 3; k++) colour[k] *= 1.0f - fineness;
    }
    if (fineness > 0.0f) add_voxels(*asset, *camera, asset->face_field[f], grid, false, colour);
    if (is_there) image[pixel] = packed(colour);
  }
}

extern "C" __global__ void __launch_bounds__(32 * WARPS) points_tensor_kernel(const Asset* asset, const int* positions, int count,
                                                                              float* out) {
  __shared__ Shared shared;
  load_network(*asset, shared);
  for (int begin = blockIdx.x * blockDim.x; begin < count; begin += gridDim.x * blockDim.x) {
    const int i = least(begin + (int)threadIdx.x, count - 1);
    float colour[3];
    network_of_warp(*asset, shared, positions[4 * i + 3], positions + 4 * i, colour);
    for (int k = 0; k < 3; k++) out[3 * i + k] = colour[k];
  }
}

// Keeps the GPU busy while the host queues what is timed.
extern "C" __global__ void spin_kernel(long long cycles) {
  const long long begin = clock64();
  while (clock64() - begin < cycles) {
  }
}
