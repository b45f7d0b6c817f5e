#include "master/import_obj.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "master/mtl_material.h"
#include "master/polygon.h"
#include "master/scene_builder.h"
#include "master/scene_file.h"

namespace preheat {

namespace {

constexpr std::uint32_t kNone = 0xFFFFFFFFU;
constexpr std::size_t kVerticesMax = 0xFFFFFFFEU;
// Corners that share a position but not a normal are searched for in a chain of this length; beyond
// it a vertex is stored twice, so that no file makes the search long.
constexpr int kSharedSearchMax = 32;
constexpr std::size_t kLibrariesMax = 64;  // looking for one costs more than naming it

tl::unexpected<Error> rejected(std::string message) {
  return fail(ExitCode::kSceneRejected, std::move(message));
}

tl::unexpected<Error> rejected_at(std::size_t line, std::string_view why) {
  return rejected(fmt::format("line {}: {}", line, why));
}

// Lines that end in LF, CR LF or CR; a backslash at the end joins the next line.
class LineReader {
 public:
  explicit LineReader(std::string_view text) : rest_(text) {}

  bool next(std::string_view& line) {
    if (rest_.empty()) { return false; }
    line = take();
    if (!line.ends_with('\\')) { return true; }
    joined_.assign(line.substr(0, line.size() - 1));
    while (!rest_.empty()) {
      const std::string_view more = take();
      joined_.append(" ").append(more);
      if (!more.ends_with('\\')) { break; }
      joined_.pop_back();
    }
    line = joined_;
    return true;
  }
  [[nodiscard]] std::size_t number() const { return number_; }  // of the last line read, from 1

 private:
  std::string_view take() {
    ++number_;
    std::size_t end = 0;
    while (end < rest_.size() && rest_[end] != '\n' && rest_[end] != '\r') { ++end; }
    const std::string_view line = rest_.substr(0, end);
    const bool is_pair = rest_.substr(end).starts_with("\r\n");
    rest_.remove_prefix(std::min(end + (is_pair ? 2 : 1), rest_.size()));
    return line;
  }

  std::string_view rest_;
  std::string joined_;
  std::size_t number_ = 0;
};

bool is_space(char c) { return c == ' ' || c == '\t' || c == '\f' || c == '\v'; }

// Takes the next word off the text; empty at its end.
std::string_view next_word(std::string_view& text) {
  std::size_t begin = 0;
  while (begin < text.size() && is_space(text[begin])) { ++begin; }
  std::size_t end = begin;
  while (end < text.size() && !is_space(text[end])) { ++end; }
  const std::string_view word = text.substr(begin, end - begin);
  text.remove_prefix(end);
  return word;
}

// A whole word as a number, NaN and infinity among them.
std::optional<double> parse_number(std::string_view word) {
  if (word.starts_with('+')) { word.remove_prefix(1); }
  double value = 0.0;
  const char* const end = word.data() + word.size();
  const auto [stop, code] = std::from_chars(word.data(), end, value);
  // "1.#IND" and "1.#QNAN" are how old Windows programs print NaN.
  if (stop != end && *stop == '#') { return std::numeric_limits<double>::quiet_NaN(); }
  if (stop != end || word.empty()) { return std::nullopt; }
  if (code == std::errc::result_out_of_range) {
    return std::strtod(std::string(word).c_str(), nullptr);  // 0 or infinity
  }
  return value;
}

Result<Vec3d> parse_vec3(std::string_view text, std::size_t line) {
  Vec3d result{0.0};
  for (int axis = 0; axis < 3; ++axis) {
    const std::string_view word = next_word(text);
    const auto value = parse_number(word);
    if (!value) { return rejected_at(line, fmt::format("'{}' is not a number", word)); }
    result[axis] = *value;
  }
  return result;
}

// The index of an element by its number in the file, which counts from 1, or from the end of those
// read so far where negative.
Result<std::uint32_t> resolve_index(std::string_view word, std::size_t read_so_far,
                                    std::size_t total, std::size_t line, std::string_view what) {
  std::int64_t number = 0;
  const char* const end = word.data() + word.size();
  const auto [stop, code] = std::from_chars(word.data(), end, number);
  if (stop != end || code != std::errc{}) {
    return rejected_at(line, fmt::format("'{}' is not an index", word));
  }
  const std::int64_t index =
      number < 0 ? number + static_cast<std::int64_t>(read_so_far) : number - 1;
  if (number == 0 || index < 0 || index >= static_cast<std::int64_t>(total)) {
    return rejected_at(line,
                       fmt::format("{} {} is out of range: there are {}", what, number, total));
  }
  return static_cast<std::uint32_t>(index);
}

struct Corner {
  std::uint32_t position = 0;
  std::uint32_t normal = kNone;
};

// All faces of the file, as triangles over shared vertices.
class ObjMesh : public WorldMesh {
 public:
  [[nodiscard]] std::string label() const override { return "the OBJ file"; }
  [[nodiscard]] std::uint32_t vertex_count() const override {
    return static_cast<std::uint32_t>(vertices_.size());
  }
  [[nodiscard]] std::uint64_t triangle_count() const override { return triangles_.size(); }
  [[nodiscard]] Triangle triangle(std::uint64_t index) const override { return triangles_[index]; }
  [[nodiscard]] Vec3d position(std::uint32_t vertex) const override {
    return positions_[vertices_[vertex].position];
  }
  [[nodiscard]] Vec3d normal(std::uint32_t vertex) const override {
    const std::uint32_t index = vertices_[vertex].normal;
    return index == kNone ? Vec3d{0.0} : normals_[index];
  }
  // Decimal digits: as fine as whoever wrote them wanted.
  [[nodiscard]] double coordinate_spacing(std::uint32_t) const override { return 0.0; }

 private:
  friend class ObjReader;

  std::vector<Vec3d> positions_;
  std::vector<Vec3d> normals_;
  std::vector<Corner> vertices_;
  std::vector<Triangle> triangles_;
};

// A material library that the file names: where it is, or why it is not read.
struct LibraryName {
  std::string name{};
  Result<std::filesystem::path> path{};
};

// The libraries of a file in order, each once.
class LibraryList {
 public:
  explicit LibraryList(const std::filesystem::path& scene_file) : scene_file_(scene_file) {}

  // "mtllib a.mtl b.mtl" names two libraries, or one with a space; a space may be escaped.
  void add(std::string_view text) {
    const std::string_view whole = trim(text);
    if (auto path = resolve_below(scene_file_, whole); exists(path)) {
      return add(std::string(whole), std::move(path));
    }
    std::string name;
    for (std::size_t i = 0; i <= whole.size(); ++i) {
      const bool is_end = i == whole.size() || whole[i] == ' ' || whole[i] == '\t';
      if (is_end && !name.empty()) {
        auto path = resolve_below(scene_file_, name);
        add(std::exchange(name, {}), std::move(path));
      } else if (!is_end) {
        const bool is_escape = whole.substr(i).starts_with("\\ ");
        if (is_escape) { ++i; }
        name.push_back(whole[i]);
      }
      if (libraries_.size() == kLibrariesMax) { return; }
    }
  }

  [[nodiscard]] const std::vector<LibraryName>& libraries() const { return libraries_; }

  static bool exists(const Result<std::filesystem::path>& path) {
    std::error_code ignored;
    return path && std::filesystem::is_regular_file(*path, ignored);
  }

 private:
  void add(std::string name, Result<std::filesystem::path> path) {
    if (libraries_.size() == kLibrariesMax) { return; }
    const bool is_known =
        std::any_of(libraries_.begin(), libraries_.end(),
                    [&](const LibraryName& library) { return library.name == name; });
    if (!is_known) { libraries_.push_back({std::move(name), std::move(path)}); }
  }

  const std::filesystem::path& scene_file_;
  std::vector<LibraryName> libraries_;
};

class ObjReader {
 public:
  ObjReader(const std::filesystem::path& file, std::string_view text) : file_(file), text_(text) {}

  Result<SceneDraft> run() {
    if (auto done = read_elements(); !done) { return tl::unexpected(done.error()); }
    if (auto done = read_faces(); !done) { return tl::unexpected(done.error()); }
    draft_.materials = library_.materials();
    if (uses_default_) {
      Material grey;
      grey.name = "default";
      grey.specular_color = Vec3(0.0F);
      draft_.materials.push_back(grey);
    }
    add_notes();
    draft_.meshes.push_back(std::move(mesh_));
    return std::move(draft_);
  }

 private:
  // First pass: vertices, normals and materials, which faces may name before they appear.
  Result<void> read_elements() {
    LibraryList names(file_);
    LineReader lines(text_);
    std::string_view line;
    while (lines.next(line)) {
      const std::string_view word = next_word(line);
      if (word == "v" || word == "vn") {
        const auto value = parse_vec3(line, lines.number());
        if (!value) { return tl::unexpected(value.error()); }
        auto& values = word == "v" ? mesh_->positions_ : mesh_->normals_;
        if (values.size() == kVerticesMax) { return rejected("more than 2^32 - 2 vertices"); }
        values.push_back(*value);
      } else if (word == "mtllib" && names.libraries().size() < kLibrariesMax) {
        names.add(line);
      }
    }
    read_libraries(names);
    return {};
  }

  void read_libraries(const LibraryList& names) {
    if (names.libraries().size() == kLibrariesMax) {
      draft_.notes.push_back(
          fmt::format("the first {} material libraries are read", kLibrariesMax));
    }
    for (const LibraryName& library : names.libraries()) {
      if (!library.path) {
        draft_.notes.push_back(
            fmt::format("a material library was not read: {}", library.path.error().message));
        continue;
      }
      const auto bytes = MappedFile::open(*library.path);
      if (!bytes) {
        draft_.notes.push_back(fmt::format("the material library '{}' was not read: {}",
                                           library.name, bytes.error().message));
        continue;
      }
      if (!library_.add(bytes->text())) {
        draft_.notes.push_back(
            fmt::format("the material library '{}' was not read: more than {} "
                        "materials",
                        library.name, MtlLibrary::kMaterialsMax));
      }
    }
  }

  // Second pass.
  Result<void> read_faces() {
    first_vertex_.assign(mesh_->positions_.size(), kNone);
    const auto default_material = static_cast<std::uint32_t>(library_.materials().size());
    std::uint32_t material = default_material;
    LineReader lines(text_);
    std::string_view line;
    while (lines.next(line)) {
      const std::string_view word = next_word(line);
      if (word == "v") {
        ++positions_so_far_;
      } else if (word == "vn") {
        ++normals_so_far_;
      } else if (word == "usemtl") {
        material = static_cast<std::uint32_t>(library_.find(trim(line)));
        if (material == default_material) { ++materials_missing_; }
      } else if (word == "f") {
        uses_default_ |= material == default_material;
        if (auto done = read_face(line, material, lines.number()); !done) { return done; }
      } else if (word == "l" || word == "p") {
        ++points_and_lines_;
      }
    }
    return {};
  }

  Result<void> read_face(std::string_view text, std::uint32_t material, std::size_t line) {
    face_.clear();
    for (std::string_view word = next_word(text); !word.empty() && !word.starts_with('#');
         word = next_word(text)) {
      const auto corner = parse_corner(word, line);
      if (!corner) { return tl::unexpected(corner.error()); }
      const auto vertex = shared_vertex(*corner);
      if (!vertex) { return tl::unexpected(vertex.error()); }
      face_.push_back(*vertex);
    }
    if (face_.size() < 3) {
      ++faces_too_small_;
      return {};
    }
    face_positions_.clear();
    for (const std::uint32_t vertex : face_) { face_positions_.push_back(mesh_->position(vertex)); }
    face_triangles_.clear();
    if (!triangulate_polygon(face_positions_, face_triangles_)) {
      return rejected_at(line, fmt::format("a concave polygon of {} vertices; at most {} are cut",
                                           face_.size(), kConcavePolygonVerticesMax));
    }
    for (const auto& [a, b, c] : face_triangles_) {
      mesh_->triangles_.push_back({{face_[a], face_[b], face_[c]}, material});
    }
    return {};
  }

  // "position", "position/texture", "position//normal" or "position/texture/normal".
  Result<Corner> parse_corner(std::string_view word, std::size_t line) const {
    const std::size_t first = word.find('/');
    const std::size_t last = word.rfind('/');
    Corner corner;
    const auto position = resolve_index(word.substr(0, first), positions_so_far_,
                                        mesh_->positions_.size(), line, "vertex");
    if (!position) { return tl::unexpected(position.error()); }
    corner.position = *position;
    if (first != last && last + 1 < word.size()) {
      const auto normal = resolve_index(word.substr(last + 1), normals_so_far_,
                                        mesh_->normals_.size(), line, "normal");
      if (!normal) { return tl::unexpected(normal.error()); }
      corner.normal = *normal;
    }
    return corner;
  }

  // The vertex of this position and normal, found in the chain of those that share the position.
  Result<std::uint32_t> shared_vertex(const Corner& corner) {
    auto& vertices = mesh_->vertices_;
    std::uint32_t vertex = first_vertex_[corner.position];
    for (int steps = 0; vertex != kNone && steps < kSharedSearchMax; ++steps) {
      if (vertices[vertex].normal == corner.normal) { return vertex; }
      vertex = next_vertex_[vertex];
    }
    if (vertices.size() == kVerticesMax) { return rejected("more than 2^32 - 2 vertices"); }
    const auto added = static_cast<std::uint32_t>(vertices.size());
    vertices.push_back(corner);
    next_vertex_.push_back(std::exchange(first_vertex_[corner.position], added));
    return added;
  }

  void add_notes() {
    for (std::string& note : library_.notes()) { draft_.notes.push_back(std::move(note)); }
    const auto add = [&](std::size_t count, std::string_view what) {
      if (count > 0) { draft_.notes.push_back(fmt::format("{} {}", count, what)); }
    };
    add(materials_missing_, "uses of materials that no library defines: they are grey");
    add(points_and_lines_, "points and lines left out");
    add(faces_too_small_, "faces with fewer than 3 corners left out");
  }

  const std::filesystem::path& file_;
  std::string_view text_;
  SceneDraft draft_{};
  std::unique_ptr<ObjMesh> mesh_ = std::make_unique<ObjMesh>();
  MtlLibrary library_{};
  std::vector<std::uint32_t> first_vertex_{};  // by position: head of the chain of its vertices
  std::vector<std::uint32_t> next_vertex_{};   // by vertex
  std::size_t positions_so_far_ = 0;
  std::size_t normals_so_far_ = 0;
  bool uses_default_ = false;
  std::size_t materials_missing_ = 0;
  std::size_t points_and_lines_ = 0;
  std::size_t faces_too_small_ = 0;
  // Of the face being read, kept to save allocations.
  std::vector<std::uint32_t> face_{};
  std::vector<Vec3d> face_positions_{};
  std::vector<std::array<std::uint32_t, 3>> face_triangles_{};
};

// Past a UTF-8 mark; UTF-16 is refused.
Result<std::string_view> text_of(const MappedFile& file) {
  std::string_view text = file.text();
  if (text.starts_with("\xFE\xFF") || text.starts_with("\xFF\xFE")) {
    return rejected("the file is UTF-16 text; save it as UTF-8 or ASCII");
  }
  if (text.starts_with("\xEF\xBB\xBF")) { text.remove_prefix(3); }
  return text;
}

}  // namespace

Result<Scene> import_obj(const std::filesystem::path& file) {
  const auto mapped = MappedFile::open(file);
  if (!mapped) { return tl::unexpected(mapped.error()); }
  const auto text = text_of(*mapped);
  if (!text) { return tl::unexpected(text.error()); }
  auto draft = ObjReader(file, *text).run();
  if (!draft) { return tl::unexpected(draft.error()); }
  return build_scene(*std::move(draft));
}

Result<std::vector<std::filesystem::path>> list_obj_material_files(
    const std::filesystem::path& file) {
  const auto mapped = MappedFile::open(file);
  if (!mapped) { return tl::unexpected(mapped.error()); }
  const auto text = text_of(*mapped);
  if (!text) { return tl::unexpected(text.error()); }
  LibraryList names(file);
  LineReader lines(*text);
  std::string_view line;
  while (names.libraries().size() < kLibrariesMax && lines.next(line)) {
    if (next_word(line) == "mtllib") { names.add(line); }
  }
  std::vector<std::filesystem::path> files;
  for (const LibraryName& library : names.libraries()) {
    if (LibraryList::exists(library.path)) { files.push_back(*library.path); }
  }
  return files;
}

}  // namespace preheat
