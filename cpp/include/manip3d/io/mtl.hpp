#pragma once

#include <string>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/io/byte_source.hpp"

namespace manip3d {

/// Reads a material library of an OBJ file. Texture paths are kept as they are written, with `/`
/// for `\`; options of textures that would change the picture are told in `warnings`.
/// @throws FormatError  with the line.
std::vector<Material> read_mtl(ByteSource& source, std::vector<std::string>& warnings);

}  // namespace manip3d
