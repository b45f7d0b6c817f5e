// A glTF 2.0 file taken apart: its JSON as tinygltf's structs, its buffers as checked byte ranges.
//
// tinygltf checks little, so it is shown little: it parses a copy of the JSON without buffers,
// images, textures and animations, and never opens a file or touches a byte of a buffer. Indices
// between its structs are as unchecked as in the file.
#pragma once

#include <tiny_gltf.h>

#include <cstddef>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "common/result.h"
#include "common/vec3.h"
#include "master/scene_file.h"

namespace preheat {

struct GltfDocument {
  tinygltf::Model model{};
  // As long as the buffer's byteLength; empty where another extension's data stands in for it.
  std::vector<std::span<const std::byte>> buffers{};
  std::size_t animation_count = 0;
  std::vector<std::string> extensions_left_out{};  // used by the file and not by us
  // What the spans point into.
  std::vector<MappedFile> files{};
  std::vector<std::vector<std::byte>> decoded{};
};

// Refused: whatever is malformed, versions other than 2, extensions that the file requires and that
// are not supported, compressed meshes, buffers shorter than declared or outside the scene's
// folder.
[[nodiscard]] Result<GltfDocument> read_gltf_document(const std::filesystem::path& file);

// The files that a document's buffers name, in order; data URIs are not among them.
[[nodiscard]] Result<std::vector<std::filesystem::path>> list_gltf_buffer_files(
    const std::filesystem::path& file);

// The elements of one accessor, every one of which lies inside its buffer.
class GltfAccessor {
 public:
  // Refused: indices out of range, short buffers, overlapping strides, unordered sparse indices.
  [[nodiscard]] static Result<GltfAccessor> make(const GltfDocument& document, int accessor_index);

  [[nodiscard]] std::size_t count() const { return count_; }
  [[nodiscard]] bool is_float() const { return component_type_ == TINYGLTF_COMPONENT_TYPE_FLOAT; }
  [[nodiscard]] bool is_vec3() const { return component_count_ == 3; }
  // Scalars of an unsigned type, as indices are.
  [[nodiscard]] bool is_index() const;
  // Float or one of the integers that KHR_mesh_quantization adds.
  [[nodiscard]] bool is_coordinate() const;

  // Requires: element < count() and is_vec3() or is_index().
  [[nodiscard]] Vec3d vec3(std::size_t element) const;
  [[nodiscard]] std::uint32_t index(std::size_t element) const;

 private:
  [[nodiscard]] const std::byte* find(std::size_t element) const;
  [[nodiscard]] double component(const std::byte* bytes, std::size_t number) const;
  [[nodiscard]] Result<void> read_sparse(const GltfDocument& document,
                                         const tinygltf::Accessor& accessor, std::string_view name);

  const std::byte* first_ = nullptr;
  std::size_t stride_ = 0;
  std::size_t count_ = 0;
  std::size_t component_count_ = 0;
  int component_type_ = 0;
  bool normalized_ = false;
  // Elements that replace those of the buffer view, by increasing index.
  std::size_t sparse_count_ = 0;
  int sparse_index_type_ = 0;
  const std::byte* sparse_indices_ = nullptr;
  const std::byte* sparse_values_ = nullptr;
};

}  // namespace preheat
