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
/// glTF counts v downwards, TriangleMesh upwards: v is flipped both ways. Coordinates are left
/// alone. Colours of glTF are linear, those of TriangleMesh sRGB.
namespace manip3d {

/// The first `size` bytes (fewer if it is shorter) of the file that a percent-decoded relative URI
/// names. @throws InputError  it must not be read.
using GltfResource =
    std::function<std::vector<std::byte>(const std::string& uri, std::int64_t size)>;

/// Memory that a file may take: its uncompressed bytes, its JSON as objects, the tables of the
/// mesh.
///
/// A small file can name one mesh in many nodes, count zeros, or be compressed.
class GltfBudget {
 public:
  /// @param stored_bytes  of the file, compressed if it is.
  /// @param max_bytes     0: 64 MiB or 100 times the stored bytes, whichever is more. Beyond
  ///                      2^63 - 1: as that.
  explicit GltfBudget(std::int64_t stored_bytes, std::uint64_t max_bytes = 0);

  /// Another file was read.
  void add_file(std::int64_t stored_bytes) { stored_bytes_ += stored_bytes; }
  /// Counts the bytes of a compressed stream five times, because plain accessors take five to ten
  /// times as many. Streams may overlap, but together they count as no more than the files.
  void add_compressed(std::int64_t bytes) {
    compressed_ = std::min(compressed_ + bytes, stored_bytes_);
  }
  /// @throws FormatError  that is too much; names `who`.
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

/// The triangles of the default scene, in depth-first order of its nodes.
///
/// Node transforms are applied; one that mirrors turns its triangles around. Primitives of one
/// node that share their POSITION accessor share their vertices; instances of a mesh share their
/// texture coordinates. All component types, strides, sparse accessors, triangles, strips and
/// fans, KHR_mesh_quantization, KHR_draco_mesh_compression, EXT_ and KHR_meshopt_compression,
/// KHR_texture_transform (of the first texture of a material, in the texture coordinates; textures
/// placed otherwise are left out with a warning).
/// A file without nodes has all its meshes read as they are, with a warning. Meshes have the shape
/// of the default weights of their morph targets, in the pose of the joints of their skins. Points,
/// lines, the skins and morph targets themselves, animations, extensions of lights, materials and
/// image formats, and others that are not required are left out with a warning. Where only some
/// primitives have vertex colours, the others are white.
/// @param data       a .gltf or .glb, told apart by the first four bytes.
/// @param resource   called for external buffers; external images stay paths.
/// @param budget     what reading it may cost.
/// @param draco      decodes KHR_draco_mesh_compression; empty: primitives that only a Draco stream
///                   holds are refused.
/// @throws FormatError  not glTF 2.x, lengths or indices that do not fit, nodes that are not a
///                      forest, nesting deeper than 64, a required extension that is not known (it
///                      is named), a mesh beyond the budget. The message holds a JSON pointer.
ReadResult parse_gltf(std::span<const std::byte> data, const GltfResource& resource,
                      GltfBudget budget, const Progress& progress = {},
                      const DracoDecoder& draco = {});

/// Reads the file as a scene: see read_scene(). Images are read by `resource`, too.
Scene parse_gltf_scene(std::span<const std::byte> data, const GltfResource& resource,
                       GltfBudget budget, const Progress& progress = {},
                       const DracoDecoder& draco = {});

}  // namespace manip3d
