// MTL materials -> ours.
//
// MTL is a Phong model of 1990 with later keys, and exporters disagree on it. What we make of it:
//   emission       Ke.
//   PBR keys       with Pm or Pr above 0: metallic Pm, roughness Pr, base colour Kd.
//   glass          illum 6 or 7, or illum 4 or 9 with Tf or d < 1: transmits all, a solid of index
//                  Ni, sharp. Of Tf only the hue is used, scaled to a maximum of 1: for some
//                  exporters its level means clear, for others opaque.
//   d < 1 else     transmits 1 - d as a thin wall, sharp and unbent, which is what blending shows.
//   metal          no Kd to speak of (below a tenth of Ks): base colour Ks.
//   the rest       base colour Kd, and reflectance at normal incidence 0.08 Ks, the scale on which
//                  Blender and others write it (0.5 is the 4 % of glass); Ks 0 is purely diffuse.
//   roughness      from Ns where there is no Pr: GGX alpha = sqrt(2 / (Ns + 2)), which has the
//   width
//                  of the Phong lobe, and roughness = sqrt(alpha); Ns of 1000 and more is sharp.
// Every material is double sided.
#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "common/scene.h"

namespace preheat {

// Materials of all libraries of a file; the first of a name stays.
class MtlLibrary {
 public:
  // One of tinyobjloader's materials takes kilobytes, its shortest text some bytes.
  static constexpr std::size_t kMaterialsMax = 1U << 15U;

  // False, with nothing added: more than kMaterialsMax materials.
  [[nodiscard]] bool add(std::string_view mtl_text);

  [[nodiscard]] const std::vector<Material>& materials() const { return materials_; }
  // The index of a material, materials().size() if there is none of that name.
  [[nodiscard]] std::size_t find(std::string_view name) const;
  // A sentence for each kind of thing that was left out.
  [[nodiscard]] std::vector<std::string> notes() const;

 private:
  std::vector<Material> materials_{};
  std::map<std::string, std::size_t, std::less<>> index_by_name_{};
  std::size_t colour_textures_ = 0;
  std::size_t other_textures_ = 0;
};

[[nodiscard]] std::string_view trim(std::string_view text);

}  // namespace preheat
