#pragma once

#include <string>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/io/byte_source.hpp"

namespace manip3d {

/// Reads a material library of an OBJ file. Texture paths are kept as they are written, with `/`
/// for `\`. A line that cannot be understood leaves what it would set as it was, as in other
/// readers; it is told in `warnings`, with `file` and its number, and so are options of textures
/// that would change the picture.
/// @throws FormatError  with the line: more than 100 000 lines cannot be understood.
std::vector<Material> read_mtl(ByteSource& source, const std::string& file,
                               std::vector<std::string>& warnings);

}  // namespace manip3d
