#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "manip3d/io/mesh_file.hpp"

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

/// The triangles of the default scene, in depth-first order of its nodes.
///
/// Node transforms are applied; one that mirrors turns its triangles around. Primitives of one
/// node that share their POSITION accessor share their vertices; instances of a mesh share their
/// texture coordinates. All component types, strides, sparse accessors, triangles, strips and
/// fans, KHR_mesh_quantization. Points, lines, skins, morph targets, animations and extensions
/// that are not required are left out with a warning; so are vertex colours unless every primitive
/// has them.
/// @param data       a .gltf or .glb, told apart by the first four bytes.
/// @param resource   called for external buffers; external images stay paths.
/// @param max_bytes  most bytes that the tables of the mesh may take; 0: 64 MiB or 100 times the
///                   bytes of the files, whichever is more (a small file can name one mesh in many
///                   nodes, or count zeros).
/// @throws FormatError  not glTF 2.x, lengths or indices that do not fit, nodes that are no forest,
///                      nesting deeper than 64, a required extension that is not known (it is
///                      named), a mesh beyond `max_bytes`. The message holds a JSON pointer.
ReadResult parse_gltf(std::span<const std::byte> data, const GltfResource& resource,
                      std::uint64_t max_bytes = 0, const Progress& progress = {});

}  // namespace manip3d
