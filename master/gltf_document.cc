#include "master/gltf_document.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <nlohmann/json.hpp>
#include <utility>

namespace preheat {

namespace {

using Json = nlohmann::json;

constexpr std::size_t kJsonBytesMax = std::size_t{256} << 20U;
// Reading JSON into structs recurses, so its depth is bounded before.
constexpr int kJsonDepthMax = 128;
// The structs for an element are some hundred times larger than its shortest JSON, so their number
// is bounded before they are made.
struct ArrayLimit {
  const char* key;
  std::size_t count;
};
constexpr std::array kArrayLimits{
    ArrayLimit{"accessors", 1U << 21U}, ArrayLimit{"bufferViews", 1U << 21U},
    ArrayLimit{"buffers", 1U << 16U},   ArrayLimit{"cameras", 1U << 16U},
    ArrayLimit{"materials", 1U << 16U}, ArrayLimit{"meshes", 1U << 20U},
    ArrayLimit{"nodes", 1U << 20U},     ArrayLimit{"scenes", 1U << 16U},
};
constexpr std::uint32_t kGlbMagic = 0x46546C67;      // "glTF"
constexpr std::uint32_t kGlbChunkJson = 0x4E4F534A;  // "JSON"
constexpr std::uint32_t kGlbChunkBinary = 0x004E4942;
constexpr std::size_t kGlbHeaderBytes = 12;
constexpr std::size_t kGlbChunkHeaderBytes = 8;

// What becomes of an extension that a file uses. All others are refused where a file requires them.
enum class Support { kModelled, kLeftOut, kTexture };
struct Extension {
  std::string_view name;
  Support support;
};
constexpr std::array kExtensions{
    Extension{"KHR_lights_punctual", Support::kModelled},
    Extension{"KHR_mesh_quantization", Support::kModelled},
    Extension{"KHR_materials_emissive_strength", Support::kModelled},
    Extension{"KHR_materials_ior", Support::kModelled},
    Extension{"KHR_materials_pbrSpecularGlossiness", Support::kModelled},
    Extension{"KHR_materials_specular", Support::kModelled},
    Extension{"KHR_materials_transmission", Support::kModelled},
    Extension{"KHR_materials_volume", Support::kModelled},
    Extension{"KHR_materials_anisotropy", Support::kLeftOut},
    Extension{"KHR_materials_clearcoat", Support::kLeftOut},
    Extension{"KHR_materials_diffuse_transmission", Support::kLeftOut},
    Extension{"KHR_materials_dispersion", Support::kLeftOut},
    Extension{"KHR_materials_iridescence", Support::kLeftOut},
    Extension{"KHR_materials_sheen", Support::kLeftOut},
    Extension{"KHR_materials_unlit", Support::kLeftOut},
    Extension{"KHR_materials_variants", Support::kLeftOut},
    Extension{"KHR_animation_pointer", Support::kLeftOut},
    Extension{"KHR_xmp_json_ld", Support::kLeftOut},
    Extension{"EXT_lights_image_based", Support::kLeftOut},
    Extension{"MSFT_lod", Support::kLeftOut},
    Extension{"KHR_texture_basisu", Support::kTexture},
    Extension{"KHR_texture_transform", Support::kTexture},
    Extension{"EXT_texture_avif", Support::kTexture},
    Extension{"EXT_texture_webp", Support::kTexture},
    Extension{"MSFT_texture_dds", Support::kTexture},
};

tl::unexpected<Error> rejected(std::string message) {
  return fail(ExitCode::kSceneRejected, std::move(message));
}

std::uint32_t read_u32(std::span<const std::byte> bytes, std::size_t offset) {
  std::uint32_t value = 0;
  std::memcpy(&value, bytes.subspan(offset, sizeof value).data(), sizeof value);
  return value;
}

struct Container {
  std::string_view json{};
  std::span<const std::byte> binary{};
};

Result<Container> open_glb(std::span<const std::byte> bytes) {
  if (bytes.size() < kGlbHeaderBytes + kGlbChunkHeaderBytes) {
    return rejected("the GLB header is cut short");
  }
  if (read_u32(bytes, 4) != 2) {
    return rejected(fmt::format("GLB version {}, but only 2 is supported", read_u32(bytes, 4)));
  }
  if (read_u32(bytes, 8) > bytes.size()) {
    return rejected(fmt::format("the GLB declares {} bytes, but the file has {}",
                                read_u32(bytes, 8), bytes.size()));
  }
  Container container;
  std::size_t offset = kGlbHeaderBytes;
  for (int chunk = 0; chunk < 2 && bytes.size() - offset >= kGlbChunkHeaderBytes; ++chunk) {
    const std::uint32_t length = read_u32(bytes, offset);
    const std::uint32_t kind = read_u32(bytes, offset + 4);
    offset += kGlbChunkHeaderBytes;
    if (length > bytes.size() - offset) {
      return rejected(fmt::format("GLB chunk {} declares {} bytes, but {} are left", chunk, length,
                                  bytes.size() - offset));
    }
    const auto content = bytes.subspan(offset, length);
    if (chunk == 0 && kind != kGlbChunkJson) { return rejected("the first GLB chunk is not JSON"); }
    if (chunk == 0) {
      container.json = {reinterpret_cast<const char*>(content.data()), content.size()};
    } else if (kind == kGlbChunkBinary) {
      container.binary = content;
    }
    offset += length;
  }
  return container;
}

Result<Container> open_container(const MappedFile& file) {
  const auto bytes = file.bytes();
  if (bytes.size() >= 4 && read_u32(bytes, 0) == kGlbMagic) { return open_glb(bytes); }
  return Container{file.text(), {}};
}

// Brackets outside strings, counted without building anything.
bool is_too_deep(std::string_view text) {
  int depth = 0;
  bool in_string = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (in_string) {
      if (c == '\\') { ++i; }
      if (c == '"') { in_string = false; }
    } else if (c == '"') {
      in_string = true;
    } else if (c == '{' || c == '[') {
      if (++depth > kJsonDepthMax) { return true; }
    } else if (c == '}' || c == ']') {
      --depth;
    }
  }
  return false;
}

Result<Json> parse_json(std::string_view text) {
  if (text.size() > kJsonBytesMax) {
    return rejected(
        fmt::format("{} bytes of JSON, at most {} are read", text.size(), kJsonBytesMax));
  }
  if (is_too_deep(text)) {
    return rejected(fmt::format("the JSON nests deeper than {} levels", kJsonDepthMax));
  }
  if (text.starts_with("\xEF\xBB\xBF")) { text.remove_prefix(3); }
  try {
    Json json = Json::parse(text);
    if (!json.is_object()) { return rejected("the JSON is not an object"); }
    return json;
  } catch (const Json::exception& error) {
    return rejected(fmt::format("the JSON is malformed: {}", error.what()));
  }
}

// [64] per character, 255 = none.
constexpr std::array<std::uint8_t, 256> base64_table() {
  constexpr std::string_view kDigits =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::array<std::uint8_t, 256> table{};
  table.fill(255);
  for (std::size_t i = 0; i < kDigits.size(); ++i) {
    table[static_cast<unsigned char>(kDigits[i])] = static_cast<std::uint8_t>(i);
  }
  return table;
}

Result<std::vector<std::byte>> decode_data_uri(std::string_view uri) {
  static constexpr auto kTable = base64_table();
  const std::size_t comma = uri.find(',');
  if (comma == std::string_view::npos || !uri.substr(0, comma).ends_with(";base64")) {
    return rejected("a buffer's data URI is not base64");
  }
  std::string_view text = uri.substr(comma + 1);
  while (!text.empty() && text.back() == '=') { text.remove_suffix(1); }
  std::vector<std::byte> bytes;
  bytes.reserve(text.size() / 4 * 3 + 2);
  std::uint32_t pending = 0;
  unsigned pending_bits = 0;
  for (const char c : text) {
    const std::uint8_t digit = kTable[static_cast<unsigned char>(c)];
    if (digit == 255) { return rejected("a buffer's data URI holds characters outside base64"); }
    pending = (pending << 6U) | digit;
    pending_bits += 6;
    if (pending_bits >= 8) {
      pending_bits -= 8;
      bytes.push_back(static_cast<std::byte>((pending >> pending_bits) & 0xFFU));
    }
  }
  return bytes;
}

// Empty: the buffer has no URI.
Result<std::string> buffer_uri(const Json& buffer, std::size_t index) {
  const auto uri = buffer.find("uri");
  if (uri == buffer.end()) { return std::string(); }
  if (!uri->is_string()) { return rejected(fmt::format("buffer {}: the URI is no string", index)); }
  return uri->get<std::string>();
}

Result<std::filesystem::path> buffer_path(const std::filesystem::path& file,
                                          const std::string& uri) {
  const auto decoded = decode_percent(uri);
  if (!decoded) { return tl::unexpected(decoded.error()); }
  return resolve_below(file, *decoded);
}

// All bytes of the buffer's source, as many as there are.
Result<std::span<const std::byte>> open_buffer(const std::filesystem::path& file,
                                               const Json& buffer, std::size_t index,
                                               std::span<const std::byte> binary,
                                               GltfDocument& document) {
  const auto uri = buffer_uri(buffer, index);
  if (!uri) { return tl::unexpected(uri.error()); }
  if (uri->empty()) { return index == 0 ? binary : std::span<const std::byte>{}; }
  if (uri->starts_with("data:")) {
    auto bytes = decode_data_uri(*uri);
    if (!bytes) { return tl::unexpected(bytes.error()); }
    return document.decoded.emplace_back(*std::move(bytes));
  }
  const auto path = buffer_path(file, *uri);
  if (!path) { return tl::unexpected(path.error()); }
  auto mapped = MappedFile::open(*path);
  if (!mapped) { return tl::unexpected(mapped.error()); }
  return document.files.emplace_back(*std::move(mapped)).bytes();
}

Result<void> open_buffers(const std::filesystem::path& file, const Json& json,
                          std::span<const std::byte> binary, GltfDocument& document) {
  const auto buffers = json.find("buffers");
  if (buffers == json.end()) { return {}; }
  if (!buffers->is_array()) { return rejected("'buffers' is not an array"); }
  for (std::size_t i = 0; i < buffers->size(); ++i) {
    const Json& buffer = (*buffers)[i];
    const auto length = buffer.is_object() ? buffer.find("byteLength") : buffer.end();
    if (length == buffer.end() || !length->is_number_unsigned()) {
      return rejected(fmt::format("buffer {} has no valid byteLength", i));
    }
    const auto bytes = open_buffer(file, buffer, i, binary, document);
    if (!bytes) { return tl::unexpected(bytes.error()); }
    // A buffer without a source is only a place-holder for compressed data: no view of it is valid.
    const bool has_source = buffer.contains("uri") || (i == 0 && !binary.empty());
    const auto declared = length->get<std::uint64_t>();
    if (has_source && declared > bytes->size()) {
      return rejected(
          fmt::format("buffer {} declares {} bytes, but there are {}", i, declared, bytes->size()));
    }
    document.buffers.push_back(has_source ? bytes->first(declared) : *bytes);
  }
  return {};
}

bool refuse_image(tinygltf::Image*, int, std::string*, std::string*, int, int, const unsigned char*,
                  int, void*) {
  return false;
}

// A template, as only later versions have the last member, and demand it.
template <class FsCallbacks>
FsCallbacks refusing_files() {
  FsCallbacks files{};
  files.FileExists = [](const std::string&, void*) { return false; };
  files.ExpandFilePath = [](const std::string& path, void*) { return path; };
  files.ReadWholeFile = [](std::vector<unsigned char>*, std::string*, const std::string&, void*) {
    return false;
  };
  files.WriteWholeFile = [](std::string*, const std::string&, const std::vector<unsigned char>&,
                            void*) { return false; };
  if constexpr (requires { files.GetFileSizeInBytes; }) {
    files.GetFileSizeInBytes = [](std::size_t*, std::string*, const std::string&, void*) {
      return false;
    };
  }
  return files;
}

// tinygltf reads what is left of the JSON; should a version of it want a file after all, every
// callback refuses.
Result<void> read_structs(Json json, tinygltf::Model& model) {
  for (const char* key : {"buffers", "images", "textures", "samplers", "animations", "skins"}) {
    json.erase(key);
  }
  const std::string text = json.dump();
  tinygltf::TinyGLTF reader;
  reader.SetImageLoader(refuse_image, nullptr);
  reader.SetFsCallbacks(refusing_files<tinygltf::FsCallbacks>());
  std::string error;
  std::string warning;
  bool done = false;
  try {
    done = reader.LoadASCIIFromString(&model, &error, &warning, text.data(),
                                      static_cast<unsigned>(text.size()), "");
  } catch (const std::exception& exception) { error = exception.what(); }
  if (done && error.empty()) { return {}; }
  for (char& c : error) { c = c == '\n' ? ' ' : c; }
  return rejected(fmt::format("invalid glTF: {}", error));
}

Result<void> check_version(const Json& json) {
  const auto asset = json.find("asset");
  if (asset == json.end() || !asset->is_object() || !asset->contains("version") ||
      !(*asset)["version"].is_string()) {
    return rejected("the glTF has no asset.version");
  }
  const auto version = (*asset)["version"].get<std::string>();
  if (!version.starts_with("2.")) {
    return rejected(fmt::format("glTF version {}, but only 2.0 is supported", version));
  }
  return {};
}

std::vector<std::string> strings_of(const Json& json, const char* key) {
  std::vector<std::string> strings;
  const auto array = json.find(key);
  if (array == json.end() || !array->is_array()) { return strings; }
  for (const Json& value : *array) {
    if (value.is_string()) { strings.push_back(value.get<std::string>()); }
  }
  return strings;
}

const Extension* find_extension(std::string_view name) {
  const auto* const found =
      std::find_if(kExtensions.begin(), kExtensions.end(),
                   [&](const Extension& extension) { return extension.name == name; });
  return found == kExtensions.end() ? nullptr : found;
}

Result<void> check_extensions(const Json& json, GltfDocument& document) {
  for (const std::string& name : strings_of(json, "extensionsRequired")) {
    if (find_extension(name) == nullptr) {
      return rejected(
          fmt::format("the file requires the extension {}, which is not supported", name));
    }
  }
  for (std::string& name : strings_of(json, "extensionsUsed")) {
    const Extension* const extension = find_extension(name);
    // Textures are all left out, which is said of them by kind.
    if (extension == nullptr || extension->support == Support::kLeftOut) {
      document.extensions_left_out.push_back(std::move(name));
    }
  }
  return {};
}

Result<void> check_array_sizes(const Json& json) {
  for (const ArrayLimit& limit : kArrayLimits) {
    const auto array = json.find(limit.key);
    if (array != json.end() && array->size() > limit.count) {
      return rejected(
          fmt::format("{} {}, at most {} are read", array->size(), limit.key, limit.count));
    }
  }
  return {};
}

Result<Json> parse_and_check(std::string_view text) {
  auto json = parse_json(text);
  if (!json) { return json; }
  if (auto checked = check_version(*json); !checked) { return tl::unexpected(checked.error()); }
  if (auto checked = check_array_sizes(*json); !checked) { return tl::unexpected(checked.error()); }
  return json;
}

std::size_t component_bytes(int component_type) {
  switch (component_type) {
    case TINYGLTF_COMPONENT_TYPE_BYTE:
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
      return 1;
    case TINYGLTF_COMPONENT_TYPE_SHORT:
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
      return 2;
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT:
    case TINYGLTF_COMPONENT_TYPE_FLOAT:
      return 4;
    default:
      return 0;
  }
}

bool is_unsigned(int component_type) {
  return component_type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE ||
         component_type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT ||
         component_type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT;
}

template <class T>
T load(const std::byte* bytes) {
  T value{};
  std::memcpy(&value, bytes, sizeof value);
  return value;
}

std::uint32_t load_unsigned(const std::byte* bytes, int component_type) {
  switch (component_type) {
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
      return load<std::uint8_t>(bytes);
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
      return load<std::uint16_t>(bytes);
    default:
      return load<std::uint32_t>(bytes);
  }
}

// The bytes of a view from `offset` on.
Result<std::span<const std::byte>> view_bytes(const GltfDocument& document, int view_index,
                                              std::size_t offset, std::string_view name) {
  const auto& views = document.model.bufferViews;
  if (view_index < 0 || static_cast<std::size_t>(view_index) >= views.size()) {
    return rejected(fmt::format("{}: there is no buffer view {}", name, view_index));
  }
  const tinygltf::BufferView& view = views[static_cast<std::size_t>(view_index)];
  if (view.buffer < 0 || static_cast<std::size_t>(view.buffer) >= document.buffers.size()) {
    return rejected(fmt::format("buffer view {}: there is no buffer {}", view_index, view.buffer));
  }
  const auto buffer = document.buffers[static_cast<std::size_t>(view.buffer)];
  if (view.byteOffset > buffer.size() || view.byteLength > buffer.size() - view.byteOffset) {
    return rejected(fmt::format("buffer view {}: bytes {} + {} are beyond buffer {} of {} bytes",
                                view_index, view.byteOffset, view.byteLength, view.buffer,
                                buffer.size()));
  }
  if (offset > view.byteLength) {
    return rejected(fmt::format("{}: offset {} is beyond buffer view {} of {} bytes", name, offset,
                                view_index, view.byteLength));
  }
  return buffer.subspan(view.byteOffset, view.byteLength).subspan(offset);
}

// Whether `count` elements fit, without overflow for any count.
bool holds(std::span<const std::byte> bytes, std::size_t count, std::size_t stride,
           std::size_t element_bytes) {
  if (count == 0) { return true; }
  return bytes.size() >= element_bytes && (bytes.size() - element_bytes) / stride >= count - 1;
}

}  // namespace

Result<GltfDocument> read_gltf_document(const std::filesystem::path& file) {
  auto mapped = MappedFile::open(file);
  if (!mapped) { return tl::unexpected(mapped.error()); }
  const auto container = open_container(*mapped);
  if (!container) { return tl::unexpected(container.error()); }
  auto json = parse_and_check(container->json);
  if (!json) { return tl::unexpected(json.error()); }
  GltfDocument document;
  if (const auto animations = json->find("animations"); animations != json->end()) {
    document.animation_count = animations->size();
  }
  auto done = check_extensions(*json, document);
  if (!done) { return tl::unexpected(done.error()); }
  done = open_buffers(file, *json, container->binary, document);
  if (!done) { return tl::unexpected(done.error()); }
  done = read_structs(*std::move(json), document.model);
  if (!done) { return tl::unexpected(done.error()); }
  document.files.push_back(*std::move(mapped));
  return document;
}

Result<std::vector<std::filesystem::path>> list_gltf_buffer_files(
    const std::filesystem::path& file) {
  const auto mapped = MappedFile::open(file);
  if (!mapped) { return tl::unexpected(mapped.error()); }
  const auto container = open_container(*mapped);
  if (!container) { return tl::unexpected(container.error()); }
  const auto json = parse_and_check(container->json);
  if (!json) { return tl::unexpected(json.error()); }
  std::vector<std::filesystem::path> files;
  const auto buffers = json->find("buffers");
  if (buffers == json->end() || !buffers->is_array()) { return files; }
  for (std::size_t i = 0; i < buffers->size(); ++i) {
    const Json& buffer = (*buffers)[i];
    if (!buffer.is_object()) { continue; }
    const auto uri = buffer_uri(buffer, i);
    if (!uri) { return tl::unexpected(uri.error()); }
    if (uri->empty() || uri->starts_with("data:")) { continue; }
    auto path = buffer_path(file, *uri);
    if (!path) { return tl::unexpected(path.error()); }
    files.push_back(*std::move(path));
  }
  return files;
}

Result<GltfAccessor> GltfAccessor::make(const GltfDocument& document, int accessor_index) {
  const auto& accessors = document.model.accessors;
  if (accessor_index < 0 || static_cast<std::size_t>(accessor_index) >= accessors.size()) {
    return rejected(fmt::format("there is no accessor {}", accessor_index));
  }
  const tinygltf::Accessor& source = accessors[static_cast<std::size_t>(accessor_index)];
  const std::string name = fmt::format("accessor {}", accessor_index);
  const std::size_t component_size = component_bytes(source.componentType);
  if (component_size == 0) {
    return rejected(
        fmt::format("{}: component type {} is not allowed", name, source.componentType));
  }
  if (source.bufferView < 0) {
    return rejected(
        fmt::format("{} has no buffer view: all-zero and compressed data are not "
                    "supported",
                    name));
  }
  GltfAccessor accessor;
  accessor.count_ = source.count;
  accessor.component_type_ = source.componentType;
  accessor.normalized_ = source.normalized;
  accessor.component_count_ = static_cast<std::size_t>(
      tinygltf::GetNumComponentsInType(static_cast<std::uint32_t>(source.type)));
  const auto bytes = view_bytes(document, source.bufferView, source.byteOffset, name);
  if (!bytes) { return tl::unexpected(bytes.error()); }
  const std::size_t element_bytes = component_size * accessor.component_count_;
  const std::size_t stride =
      document.model.bufferViews[static_cast<std::size_t>(source.bufferView)].byteStride;
  accessor.stride_ = stride == 0 ? element_bytes : stride;
  if (accessor.stride_ < element_bytes) {
    return rejected(fmt::format("{}: elements of {} bytes overlap at a stride of {}", name,
                                element_bytes, stride));
  }
  if (!holds(*bytes, accessor.count_, accessor.stride_, element_bytes)) {
    return rejected(fmt::format("{}: {} elements at a stride of {} do not fit into {} bytes", name,
                                accessor.count_, accessor.stride_, bytes->size()));
  }
  accessor.first_ = bytes->data();
  if (source.sparse.isSparse) {
    if (auto done = accessor.read_sparse(document, source, name); !done) {
      return tl::unexpected(done.error());
    }
  }
  return accessor;
}

Result<void> GltfAccessor::read_sparse(const GltfDocument& document,
                                       const tinygltf::Accessor& accessor, std::string_view name) {
  const auto& sparse = accessor.sparse;
  // Offsets are signed or not, by tinygltf's version.
  if (sparse.count < 0 || std::cmp_less(sparse.indices.byteOffset, 0) ||
      std::cmp_less(sparse.values.byteOffset, 0) || !is_unsigned(sparse.indices.componentType)) {
    return rejected(fmt::format("{}: its sparse part is malformed", name));
  }
  sparse_count_ = static_cast<std::size_t>(sparse.count);
  sparse_index_type_ = sparse.indices.componentType;
  const std::size_t index_bytes = component_bytes(sparse_index_type_);
  const std::size_t element_bytes = component_bytes(component_type_) * component_count_;
  const auto indices = view_bytes(document, sparse.indices.bufferView,
                                  static_cast<std::size_t>(sparse.indices.byteOffset), name);
  if (!indices) { return tl::unexpected(indices.error()); }
  const auto values = view_bytes(document, sparse.values.bufferView,
                                 static_cast<std::size_t>(sparse.values.byteOffset), name);
  if (!values) { return tl::unexpected(values.error()); }
  if (!holds(*indices, sparse_count_, index_bytes, index_bytes) ||
      !holds(*values, sparse_count_, element_bytes, element_bytes)) {
    return rejected(fmt::format("{}: {} sparse elements do not fit into their buffer views", name,
                                sparse_count_));
  }
  sparse_indices_ = indices->data();
  sparse_values_ = values->data();
  for (std::size_t i = 0; i < sparse_count_; ++i) {
    const std::uint32_t index =
        load_unsigned(sparse_indices_ + i * index_bytes, sparse_index_type_);
    const bool is_ordered = i == 0 || load_unsigned(sparse_indices_ + (i - 1) * index_bytes,
                                                    sparse_index_type_) < index;
    if (index >= count_ || !is_ordered) {
      return rejected(fmt::format("{}: sparse index {} is out of range or order", name, index));
    }
  }
  return {};
}

bool GltfAccessor::is_index() const {
  return component_count_ == 1 && is_unsigned(component_type_) && !normalized_;
}

bool GltfAccessor::is_coordinate() const {
  return component_count_ == 3 && component_type_ != TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT;
}

const std::byte* GltfAccessor::find(std::size_t element) const {
  const std::size_t index_bytes = component_bytes(sparse_index_type_);
  std::size_t low = 0;
  std::size_t high = sparse_count_;
  while (low < high) {
    const std::size_t middle = low + (high - low) / 2;
    const std::uint32_t index =
        load_unsigned(sparse_indices_ + middle * index_bytes, sparse_index_type_);
    if (index == element) {
      return sparse_values_ + middle * component_bytes(component_type_) * component_count_;
    }
    if (index < element) {
      low = middle + 1;
    } else {
      high = middle;
    }
  }
  return first_ + element * stride_;
}

double GltfAccessor::component(const std::byte* bytes, std::size_t number) const {
  const std::byte* const at = bytes + number * component_bytes(component_type_);
  // glTF 2.0 section 3.6.2.2: signed normalised integers clamp at -1.
  const auto scaled = [&](double value, double largest) {
    return normalized_ ? std::max(value / largest, -1.0) : value;
  };
  switch (component_type_) {
    case TINYGLTF_COMPONENT_TYPE_BYTE:
      return scaled(load<std::int8_t>(at), 127.0);
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
      return scaled(load<std::uint8_t>(at), 255.0);
    case TINYGLTF_COMPONENT_TYPE_SHORT:
      return scaled(load<std::int16_t>(at), 32767.0);
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
      return scaled(load<std::uint16_t>(at), 65535.0);
    default:
      return static_cast<double>(load<float>(at));
  }
}

Vec3d GltfAccessor::vec3(std::size_t element) const {
  const std::byte* const bytes = sparse_count_ == 0 ? first_ + element * stride_ : find(element);
  if (is_float()) {
    const auto values = load<std::array<float, 3>>(bytes);
    return {values[0], values[1], values[2]};
  }
  return {component(bytes, 0), component(bytes, 1), component(bytes, 2)};
}

std::uint32_t GltfAccessor::index(std::size_t element) const {
  return load_unsigned(find(element), component_type_);
}

}  // namespace preheat
