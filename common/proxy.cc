#include "common/proxy.h"

namespace preheat {

Proxy build_proxy(const Scene& scene, const Octree& octree,
                  std::span<const std::uint32_t> voxel_roots) {
  static_cast<void>(scene);
  static_cast<void>(octree);
  return {.placeholder = std::vector<std::byte>(voxel_roots.size())};
}

std::vector<std::byte> encode_proxy(const Proxy& proxy) { return proxy.placeholder; }

Result<Proxy> decode_proxy(std::span<const std::byte> bytes, std::size_t voxel_count) {
  if (bytes.size() != voxel_count) { return fail(ExitCode::kStoreDamaged, "proxy: wrong size"); }
  return Proxy{.placeholder = {bytes.begin(), bytes.end()}};
}

}  // namespace preheat
