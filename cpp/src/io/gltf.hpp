#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "manip3d/io/mesh_file.hpp"
#include "manip3d/io/scene_file.hpp"

/// @file
/// glTF 2.0, as .gltf (JSON, with files beside it) and .glb (one binary file).
///
/// In glTF v points downwards, in TriangleMesh upwards: v is flipped in both directions.
/// Coordinates are not changed. Colours are linear in glTF and sRGB in TriangleMesh.
namespace manip3d {

/// Reads the first `size` bytes (fewer if it is shorter) of the file with a relative,
/// percent-decoded URI.
/// @throws InputError  the file must not be read.
using GltfResource =
    std::function<std::vector<std::byte>(const std::string& uri, std::int64_t size)>;

/// Limit of the memory that a file may take: its uncompressed bytes, its JSON as objects, and the
/// tables of the mesh.
///
/// Without a limit, a small file could name one mesh in many nodes, count zeros, or be compressed.
class GltfBudget {
 public:
  /// @param stored_bytes  Bytes of the file, compressed if it is.
  /// @param max_bytes     The limit; 0: 64 MiB or 100 times the stored bytes, whichever is larger.
  ///                      Values beyond 2^63 - 1 count as this.
  explicit GltfBudget(std::int64_t stored_bytes, std::uint64_t max_bytes = 0);

  /// Adds the bytes of another file that was read.
  void add_file(std::int64_t stored_bytes) { stored_bytes_ += stored_bytes; }
  /// Adds the bytes of a compressed stream. They count five times, because uncompressed accessors
  /// take five to ten times as many bytes. Streams may overlap, but all of them count as no more
  /// than the files.
  void add_compressed(std::int64_t bytes) {
    compressed_ = std::min(compressed_ + bytes, stored_bytes_);
  }
  /// Spends bytes of the budget.
  /// @throws FormatError  (naming `who`) the budget is exceeded.
  void charge(std::int64_t bytes, const std::string& who);
  void charge(std::int64_t rows, std::int64_t bytes_per_row, const std::string& who) {
    charge(rows * bytes_per_row, who);
  }

 private:
  std::int64_t stored_bytes_;
  std::int64_t max_bytes_;
  std::int64_t compressed_ = 0;
  std::int64_t spent_ = 0;
};

/// Reads the triangles of the default scene, in depth-first order of its nodes.
///
/// Node transforms are applied; the triangles of a mirroring one are reversed. Primitives of a node
/// with the same POSITION accessor share their vertices; instances of a mesh share their texture
/// coordinates. Meshes have the shape of the default weights of their morph targets and the pose of
/// the joints of their skins. In a file without nodes, all meshes are read untransformed, with a
/// warning. If only some primitives have vertex colours, the others are white.
///
/// Supported are all component types, strides, sparse accessors, triangles, strips and fans,
/// KHR_mesh_quantization, KHR_draco_mesh_compression, EXT_ and KHR_meshopt_compression, and
/// KHR_texture_transform: that of the first texture of a material is applied to the texture
/// coordinates, and textures with another one are left out with a warning. Also left out with a
/// warning are points, lines, skins and morph targets themselves, animations, extensions of lights,
/// materials and image formats, and other extensions that are not required.
/// @param data       A .gltf or .glb file, distinguished by the first four bytes.
/// @param resource   Reads external buffers; external images stay paths.
/// @param budget     Limit of memory.
/// @param draco      Decoder of KHR_draco_mesh_compression; empty: primitives that exist only as a
///                   Draco stream are refused.
/// @throws FormatError  not glTF 2.x, lengths or indices that do not fit, nodes that are not a
///                      forest, nesting deeper than 64, an unknown required extension (which is
///                      named), or a mesh beyond the budget. The message contains a JSON pointer.
ReadResult parse_gltf(std::span<const std::byte> data, const GltfResource& resource,
                      GltfBudget budget, const Progress& progress = {},
                      const DracoDecoder& draco = {});

/// Reads the file as a scene: see read_scene(). `resource` also reads images.
Scene parse_gltf_scene(std::span<const std::byte> data, const GltfResource& resource,
                       GltfBudget budget, const Progress& progress = {},
                       const DracoDecoder& draco = {});

}  // namespace manip3d
