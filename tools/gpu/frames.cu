// Frames by compute, the kernels: a visibility buffer in three steps, a list of visible pixels, and one pass over it. They follow
// frames_pixel.cu and frames_tensor.cu in one text.

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

// ---- The network on tensor cores (frames_tensor.cu)

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
