#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/io/byte_source.hpp"
#include "manip3d/progress.hpp"

/// @file
/// Mesh files: which formats there are, reading and writing of any of them.
namespace manip3d {

enum class MeshFormat : std::uint8_t { kObj, kPly, kOff, kStl, kGltf, kGlb };

/// The mesh of a Draco stream, as glTF's extension KHR_draco_mesh_compression stores it.
struct DracoMesh {
  struct Attribute {
    int num_components = 0;
    bool is_integer = false;
    std::vector<double> values;  ///< Vertex after vertex.
  };
  Attribute corners;                              ///< Vertex indices, three a face.
  std::map<std::uint32_t, Attribute> attributes;  ///< By their unique ids.
};

/// Decodes a Draco stream. @throws FormatError  it is damaged.
using DracoDecoder = std::function<DracoMesh(std::span<const std::byte> stream)>;

struct ReadOptions {
  /// Let OBJ and glTF name files outside of their own folder (absolute paths, `..`, links).
  bool allow_outside = false;
  /// 0: compressed input is limited by its ratio (byte_source.hpp); else the most uncompressed
  /// bytes to read.
  std::uint64_t max_bytes = 0;
  /// Folder of the files that the mesh file names; empty: they are left out with a warning.
  /// Set by read_mesh(path).
  std::filesystem::path folder;
  /// Called for glTF compressed with Draco; empty: it is refused.
  DracoDecoder draco = {};
};

struct ReadResult {
  TriangleMesh mesh;
  MeshFormat format = MeshFormat::kObj;
  std::int64_t num_polygons = 0;      ///< Before they were cut into triangles.
  std::int64_t num_skipped = 0;       ///< Statements, elements and properties not understood.
  std::vector<std::string> warnings;  ///< What was left out, for the user.
};

/// Reads a mesh file; `.gz` and `.xz` are decompressed on the fly.
///
/// The format is what the suffix says, else what the content shows. Every position is finite, every
/// index in range: `check_mesh` holds for the result.
/// @throws FormatError  with the file's name and the line or byte where reading stopped.
/// @throws std::filesystem::filesystem_error  missing file and the like.
ReadResult read_mesh(const std::filesystem::path& path, const ReadOptions& options = {},
                     const Progress& progress = {});

/// Reads a mesh from memory (compressed or not); `format`: none = what the content shows.
ReadResult read_mesh(std::span<const std::byte> data, std::optional<MeshFormat> format,
                     const ReadOptions& options = {}, const Progress& progress = {});

struct WriteOptions {
  /// Where relative texture paths of the materials start; empty: nowhere, such textures are left
  /// out with a warning.
  std::filesystem::path texture_folder;
  /// glTF: most vertices of a primitive, which is split where it has more; 0: any number. 65 535
  /// is what 16-bit indices reach (65 535 itself is not an index).
  std::int64_t max_vertices = 0;
  /// glTF: positions and texture coordinates within the picture in 16 bits, normals in 8
  /// (KHR_mesh_quantization, which readers must know): a position moves by at most 1.4e-5 of the
  /// longest side of the box.
  bool quantize = false;
  /// glTF: coarser levels of detail of the mesh, with the same materials (MSFT_lod); and for all
  /// levels, the mesh included, the least share of the screen that they are made for.
  std::vector<MeshView> coarser;
  std::vector<double> coverages;
};

/// Writes a mesh in the format that the suffix says (then `.gz` or `.xz`), whole or not at all.
/// @return what the format cannot hold and was left out, for the user.
/// @throws InputError  unknown suffix, invalid mesh, an option that the format does not know.
/// @throws std::filesystem::filesystem_error  the operating system refused.
std::vector<std::string> write_mesh(const std::filesystem::path& path, const MeshView& mesh,
                                    const std::vector<Material>& materials,
                                    const WriteOptions& options = {},
                                    const Progress& progress = {});

/// Format of a suffix such as ".obj" (any case), if there is one.
std::optional<MeshFormat> format_of_suffix(std::string_view suffix);
/// Format that the first bytes of a file show, if they do.
std::optional<MeshFormat> format_of_content(std::string_view head,
                                            std::optional<std::uint64_t> size);
/// Suffixes of the formats that are read and written, with their dots.
std::vector<std::string> readable_suffixes();
std::vector<std::string> writable_suffixes();
/// "obj", "ply", ...
const char* format_name(MeshFormat format);

/// The file that a mesh file in `folder` means by `reference`, if it exists; a relative reference
/// never leaves the folder, not even through symbolic links.
/// @throws InputError  it leads outside.
std::filesystem::path resolve_inside(const std::filesystem::path& folder,
                                     const std::string& reference);

}  // namespace manip3d
