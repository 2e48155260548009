// The points of frames_host.cu by the network of frames_tensor.cu; count is a multiple of 32.

extern "C" void warp_points(const Asset* asset, const int* positions, int count, float* out) {
  static Shared shared;
  memset(&shared, 0xff, sizeof shared);
  std::vector<std::thread> lanes;
  for (int lane = 0; lane < 32; lane++) {
    lanes.emplace_back([=] {
      threadIdx.x = lane;
      load_network(*asset, shared);
      for (int i = lane; i < count; i += 32) network_of_warp(*asset, shared, positions[4 * i + 3], positions + 4 * i, out + 3 * i);
    });
  }
  for (std::thread& lane : lanes) lane.join();
}
