#include "manip3d/io/mesh_file.hpp"

#include <algorithm>
#include <cstring>
#include <memory>
#include <system_error>

#include "io/formats.hpp"
#include "io/warnings.hpp"
#include "manip3d/error.hpp"
#include "parse/letters.hpp"

namespace manip3d {
namespace fs = std::filesystem;
namespace {

using MeshReader = ReadResult (*)(ByteSource&, const ReadOptions&, const Progress&);
using Writer = void (*)(Output&, const WriteJob&);

struct Format {
  MeshFormat format;
  const char* name;
  const char* suffix;
  MeshReader read;  ///< Null: the format cannot be read.
  Writer write;     ///< Null: the format cannot be written.
};

// A new format needs one line here.
constexpr Format kFormats[] = {
    {MeshFormat::kObj, "obj", ".obj", read_obj, write_obj},
    {MeshFormat::kPly, "ply", ".ply", read_ply, write_ply},
    {MeshFormat::kOff, "off", ".off", read_off, write_off},
    {MeshFormat::kStl, "stl", ".stl", read_stl, write_stl},
    {MeshFormat::kGltf, "gltf", ".gltf", read_gltf, write_gltf},
    {MeshFormat::kGlb, "glb", ".glb", read_gltf, write_glb},
};

const Format* find_format(MeshFormat format) {
  const auto* found = std::find_if(std::begin(kFormats), std::end(kFormats),
                                   [&](const Format& f) { return f.format == format; });
  return found == std::end(kFormats) ? nullptr : found;
}

std::string known_suffixes() {
  std::string text;
  for (const Format& f : kFormats) text += std::string(text.empty() ? "" : " ") + f.suffix;
  return text + ", then .gz or .xz if wanted";
}

// Returns bytes that were read ahead to the reader.
class Rewound final : public ByteSource {
 public:
  Rewound(ByteSource& source, std::size_t size) : source_(source), head_(size, '\0') {
    std::size_t got = 0;
    while (got < size) {
      const std::size_t more = source.read(head_.data() + got, size - got);
      if (more == 0) break;
      got += more;
    }
    head_.resize(got);
  }
  std::size_t read(char* data, std::size_t size) override {
    if (position_ == head_.size()) return source_.read(data, size);
    const std::size_t got = head_.copy(data, size, position_);
    position_ += got;
    return got;
  }
  [[nodiscard]] std::optional<std::uint64_t> remaining() const override {
    const auto rest = source_.remaining();
    return rest ? std::optional(*rest + head_.size() - position_) : std::nullopt;
  }
  [[nodiscard]] std::uint64_t stored_bytes() const override { return source_.stored_bytes(); }
  [[nodiscard]] std::uint64_t stored_size() const override { return source_.stored_size(); }
  [[nodiscard]] bool expansion_allowed() const override { return source_.expansion_allowed(); }
  [[nodiscard]] const std::string& head() const { return head_; }

 private:
  ByteSource& source_;
  std::string head_;
  std::size_t position_ = 0;
};

std::optional<std::string> why_outside(const fs::path& folder, const std::string& reference) {
  try {
    resolve_inside(folder, reference);
    return std::nullopt;
  } catch (const InputError& error) {
    return error.what();
  }
}

// Exporters write texture paths of the author's machine, or of a folder from which the picture was
// taken when the files were passed on. If a file of that name is beside the mesh, it is used
// instead.
void find_textures_beside(const fs::path& folder, ReadResult& result) {
  const auto is_file = [&](const std::string& path) {
    std::error_code ignored;
    return !path.empty() && !why_outside(folder, path) &&
           fs::is_regular_file(folder / path, ignored);
  };
  for (Material& m : result.mesh.materials) {
    for (auto& [role, texture] : m.textures) {
      const std::string& path = texture.path;
      const std::string name = path.substr(path.find_last_of("/\\") + 1);
      const bool has_drive = path.size() > 2 && path[1] == ':';
      const bool is_absolute = has_drive || path.starts_with('/') || path.starts_with('\\');
      if ((!is_absolute && is_file(path)) || name == path || !is_file(name)) continue;
      if (!is_absolute) {
        warn(result.warnings, "texture '" + path + "' not found, '" + name + "' is used");
      }
      texture.path = name;
    }
  }
}

// Drops textures with relative paths outside of the mesh file's folder, or makes these paths
// absolute if the caller allows them, because code that opens a texture later need not know the
// folder.
void confine_textures(ReadResult& result, const ReadOptions& options) {
  if (options.folder.empty()) return;
  if (!options.allow_outside) find_textures_beside(options.folder, result);
  for (Material& m : result.mesh.materials) {
    for (auto item = m.textures.begin(); item != m.textures.end();) {
      Texture& texture = item->second;
      const auto outside =
          texture.path.empty() ? std::nullopt : why_outside(options.folder, texture.path);
      if (!outside) {
        ++item;
      } else if (options.allow_outside) {
        texture.path = fs::absolute(options.folder / texture.path).lexically_normal().string();
        ++item;
      } else {
        warn(result.warnings, "texture of material '" + m.name + "' left out: " + *outside);
        texture.path.clear();
        item = texture.empty() ? m.textures.erase(item) : std::next(item);
      }
    }
  }
}

ReadResult read_from(std::unique_ptr<ByteSource> stored, Compression compression,
                     std::optional<MeshFormat> format, const ReadOptions& options,
                     const Progress& progress) {
  const auto bytes = decompressed(std::move(stored), compression, options.max_bytes);
  constexpr std::size_t kLooked = 256;
  Rewound source(*bytes, kLooked);
  if (!format) format = format_of_content(source.head(), source.remaining());
  const Format* entry = format ? find_format(*format) : nullptr;
  if (entry == nullptr || entry->read == nullptr) {
    throw FormatError("unknown mesh format; manip3d reads " + known_suffixes(), {});
  }
  ReadResult result = entry->read(source, options, progress);
  result.format = entry->format;
  confine_textures(result, options);
  return result;
}

}  // namespace

ReadResult read_mesh(const fs::path& path, const ReadOptions& options, const Progress& progress) {
  ReadOptions here = options;
  here.folder = path.parent_path().empty() ? "." : path.parent_path();
  const auto format = format_of_suffix(without_compression_suffix(path).extension().string());
  // A shell's pipe, such as /dev/stdin, has no suffix. One with a suffix, often in a folder of
  // meshes, may never get a writer.
  const auto special = format ? SpecialFiles::kRefused : SpecialFiles::kAllowed;
  try {
    return read_from(file_source(path, special), compression_of(path), format, here, progress);
  } catch (const FormatError& error) {
    if (!error.file().empty()) throw;  // the error is in a file that the mesh file names
    throw error.in_file(path.string());
  }
}

ReadResult read_mesh(std::span<const std::byte> data, std::optional<MeshFormat> format,
                     const ReadOptions& options, const Progress& progress) {
  return read_from(memory_source(data), Compression::kNone, format, options, progress);
}

std::vector<std::string> write_mesh(const fs::path& path, const MeshView& mesh,
                                    const std::vector<Material>& materials,
                                    const WriteOptions& options, const Progress& progress) {
  check_mesh(mesh);
  const auto format = format_of_suffix(without_compression_suffix(path).extension().string());
  const Format* entry = format ? find_format(*format) : nullptr;
  if (entry == nullptr || entry->write == nullptr) {
    throw InputError("path: expected one of " + known_suffixes() + ", got '" + path.string() + "'");
  }
  const bool is_gltf = entry->format == MeshFormat::kGltf || entry->format == MeshFormat::kGlb;
  if (!is_gltf && (options.max_vertices != 0 || options.quantize || !options.coarser.empty())) {
    throw InputError(
        "path: levels of detail, parts of limited size and quantised values need .glb or .gltf, "
        "got '" +
        path.string() + "'");
  }
  std::vector<std::string> warnings;
  write_with_companions(path, compression_of(path), progress,
                        [&](Output& output, std::set<std::string>& taken) {
                          warnings.clear();
                          entry->write(output, {mesh, materials, options, path, warnings, taken});
                        });
  return warnings;
}

std::optional<MeshFormat> format_of_suffix(std::string_view suffix) {
  const std::string lower = lower_case(suffix);
  for (const Format& f : kFormats) {
    if (lower == f.suffix) return f.format;
  }
  return std::nullopt;
}

std::optional<MeshFormat> format_of_content(std::string_view head,
                                            std::optional<std::uint64_t> size) {
  constexpr std::size_t kStlHeader = 84;
  constexpr std::uint64_t kStlTriangle = 50;
  if (size && head.size() >= kStlHeader) {
    std::uint32_t count = 0;
    std::memcpy(&count, head.data() + kStlHeader - sizeof(count), sizeof(count));
    if (*size == kStlHeader + kStlTriangle * count) return MeshFormat::kStl;
  }
  if (starts_with_in_any_case(head, "solid")) return MeshFormat::kStl;
  for (const char* start : {"OFF", "COFF", "NOFF", "CNOFF", "nOFF", "STOFF", "STCOFF", "STNOFF",
                            "CSTOFF", "NCOFF", "NSTOFF", "NCSTOFF"}) {
    if (head.starts_with(start)) return MeshFormat::kOff;
  }
  for (const char* start : {"ply\n", "ply\r"}) {
    if (starts_with_in_any_case(head, start)) return MeshFormat::kPly;
  }
  if (head.starts_with("glTF")) return MeshFormat::kGlb;
  if (head.starts_with("{")) return MeshFormat::kGltf;
  // First lines of other formats that would be comments in OBJ.
  for (const char* start : {"#VRML", "#X3D", "#Inventor", "# vtk", "#usda"}) {
    if (head.starts_with(start)) return std::nullopt;
  }
  for (const char* start : {"v ", "#", "mtllib ", "o ", "g ", "vn ", "vt "}) {
    if (head.starts_with(start)) return MeshFormat::kObj;
  }
  return std::nullopt;
}

std::vector<std::string> readable_suffixes() {
  std::vector<std::string> suffixes;
  for (const Format& f : kFormats) {
    if (f.read != nullptr) suffixes.emplace_back(f.suffix);
  }
  return suffixes;
}

std::vector<std::string> writable_suffixes() {
  std::vector<std::string> suffixes;
  for (const Format& f : kFormats) {
    if (f.write != nullptr) suffixes.emplace_back(f.suffix);
  }
  return suffixes;
}

const char* format_name(MeshFormat format) {
  const Format* entry = find_format(format);
  return entry != nullptr ? entry->name : "";
}

fs::path resolve_inside(const fs::path& folder, const std::string& reference) {
  check_no_nul(reference);
  const fs::path path = folder / reference;  // an absolute reference replaces the folder
  std::error_code unreachable;
  const fs::path root = fs::weakly_canonical(fs::absolute(folder), unreachable);
  const fs::path target = fs::weakly_canonical(fs::absolute(path), unreachable);
  const auto [root_end, ignored] =
      std::mismatch(root.begin(), root.end(), target.begin(), target.end());
  const bool inside = root_end == root.end() || (root_end->empty() && !unreachable);
  if (unreachable || !inside) {
    throw InputError("'" + reference + "' lies outside of the mesh file's folder");
  }
  return path;
}

}  // namespace manip3d
