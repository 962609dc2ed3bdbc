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

#include "manip3d/files/byte_source.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

/// @file
/// Mesh files: the formats, and reading and writing of any of them.
namespace manip3d {

enum class MeshFormat : std::uint8_t { kObj, kPly, kOff, kStl, kGltf, kGlb };

/// The mesh of a Draco stream, as glTF's extension KHR_draco_mesh_compression stores it.
struct DracoMesh {
  struct Attribute {
    int num_components = 0;
    bool is_integer = false;
    std::vector<double> values;  ///< Values vertex by vertex.
  };
  Attribute corners;                              ///< Vertex indices, three per face.
  std::map<std::uint32_t, Attribute> attributes;  ///< Attributes by their unique ids.
};

/// Decodes a Draco stream.
/// @throws FormatError  it is damaged.
using DracoDecoder = std::function<DracoMesh(std::span<const std::byte> stream)>;

struct ReadOptions {
  /// Allow OBJ and glTF to name files outside of their own folder (absolute paths, `..`, links).
  bool allow_outside = false;
  /// Limit of uncompressed bytes; 0: compressed input is limited by its ratio (byte_source.hpp).
  std::uint64_t max_bytes = 0;
  /// Folder of the files that the mesh file names; empty: they are left out with a warning.
  /// read_mesh(path) sets it.
  std::filesystem::path folder;
  /// Decoder for glTF files with Draco compression; empty: such files are refused.
  DracoDecoder draco = {};
};

struct ReadResult {
  TriangleMesh mesh;
  MeshFormat format = MeshFormat::kObj;
  std::int64_t num_polygons = 0;  ///< Number of polygons before triangulation.
  std::int64_t num_skipped = 0;   ///< Statements, elements and properties that were not understood.
  std::vector<std::string> warnings;  ///< Messages for the user about what was left out.
};

/// Reads a mesh file; `.gz` and `.xz` are decompressed on the fly.
///
/// The suffix determines the format; without a known suffix, the content does. In the result all
/// positions are finite and all indices in range, so that `check_mesh` succeeds.
/// @throws FormatError  (with the file's name and the line or byte) the file cannot be read.
/// @throws std::filesystem::filesystem_error  for example, the file does not exist.
ReadResult read_mesh(const std::filesystem::path& path, const ReadOptions& options = {},
                     const Progress& progress = {});

/// Reads a mesh from memory, compressed or not.
/// @param format  empty: determined by the content.
ReadResult read_mesh(std::span<const std::byte> data, std::optional<MeshFormat> format,
                     const ReadOptions& options = {}, const Progress& progress = {});

struct WriteOptions {
  /// Folder of relative texture paths in the materials; empty: such textures are left out with a
  /// warning.
  std::filesystem::path texture_folder;
  /// glTF: limit of vertices per primitive; larger primitives are split. 0: no limit. 16-bit
  /// indices allow 65 535 vertices (65 535 itself is no valid index).
  std::int64_t max_vertices = 0;
  /// glTF: store positions, and texture coordinates within [0, 1], in 16 bits and normals in 8 bits
  /// (KHR_mesh_quantization, which readers must support). A position moves by at most 2.7e-5 of the
  /// longest side of the bounding box, and equal positions of meshes whose longest sides lie
  /// between the same powers of two times 65 534 stay equal.
  bool quantize = false;
  /// glTF: coarser levels of detail of the mesh with the same materials (MSFT_lod).
  std::vector<MeshView> coarser;
  /// Least share of the screen for which each level is made, the mesh itself included.
  std::vector<double> coverages;
  /// All companions (textures, material library, buffer) get a hash of their content in their name,
  /// for a folder whose other files cannot be seen, such as that of a URL.
  bool hash_names = false;
};

/// Writes a mesh in the format of the suffix (before `.gz` or `.xz`), completely or not at all.
/// @return  Messages for the user: what the format cannot hold and was left out.
/// @throws InputError  an unknown suffix, an invalid mesh, or an option that the format does not
///                     have.
/// @throws std::filesystem::filesystem_error  the operating system refused.
std::vector<std::string> write_mesh(const std::filesystem::path& path, const MeshView& mesh,
                                    const std::vector<Material>& materials,
                                    const WriteOptions& options = {},
                                    const Progress& progress = {});

/// The format of a suffix such as ".obj", in any case; empty: unknown.
std::optional<MeshFormat> format_of_suffix(std::string_view suffix);
/// The format by the first bytes of a file; empty: unknown.
std::optional<MeshFormat> format_of_content(std::string_view head,
                                            std::optional<std::uint64_t> size);
/// Suffixes of the formats that can be read or written, with their dots.
std::vector<std::string> readable_suffixes();
std::vector<std::string> writable_suffixes();
/// Returns "obj", "ply", ...
const char* format_name(MeshFormat format);

/// Returns the path of the file that a mesh file in `folder` names by `reference`. A relative
/// reference must not leave the folder, not even through symbolic links.
/// @throws InputError  the reference leads outside of the folder.
std::filesystem::path resolve_inside(const std::filesystem::path& folder,
                                     const std::string& reference);

}  // namespace manip3d
