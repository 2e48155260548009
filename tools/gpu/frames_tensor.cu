// The network on tensor cores: a warp evaluates 32 points as two tiles of 16, weights and activations of 16 bits, sums of 32.
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

#ifdef __CUDACC__  // else frames_warp.cu has them
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
#endif

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
  alignas(16) uint32 inputs[WARPS][32 * ROW];
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
