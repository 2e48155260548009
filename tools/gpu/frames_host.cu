// Frames on a CPU, for tests: the functions of frames_pixel.cu in plain loops. The network that tensor cores evaluate has no part
// here.

extern "C" void host_frame(const Asset* asset, const Camera* camera, float4* seen, uint64* visible, uint32* image, int kind) {
  const int side = camera->side;
  for (int v = 0; v < asset->vertices; v++) seen[v] = seen_of(*asset, *camera, v);
  for (int i = 0; i < side * side; i++) visible[i] = ~0ull;
  for (int f = 0; f < asset->face_count; f++) {
    Triangle t;
    if (!triangle_of(*asset, seen, f, side, t)) continue;
    for (int y = t.top; y <= t.bottom; y += 8) {  // as strips_kernel goes through large faces
      for (int x = t.left; x <= t.right; x += 32) {
        const int right = least(x + 31, t.right), bottom = least(y + 7, t.bottom);
        if (!meets(t, x, y, right, bottom)) continue;
        for (int row = y; row <= bottom; row++) {
          for (int column = x; column <= right; column++) compete(t, f, column, row, side, visible);
        }
      }
    }
  }
  for (int i = 0; i < side * side; i++) image[i] = ~visible[i] ? shade(*asset, *camera, seen, visible, i, kind) : 0x00ffffffu;
}

// positions: x, y, z of 2**24 a side and the field.
extern "C" void host_points(const Asset* asset, const int* positions, int count, float* out) {
  for (int i = 0; i < count; i++) network_at(*asset, positions[4 * i + 3], positions + 4 * i, out + 3 * i);
}
