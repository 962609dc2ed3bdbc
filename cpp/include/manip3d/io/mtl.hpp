#pragma once

#include <string>
#include <vector>

#include "manip3d/files/byte_source.hpp"
#include "manip3d/geometry/mesh.hpp"

namespace manip3d {

/// Reads a material library of an OBJ file. Texture paths are kept, with `/` for `\`. A line that
/// cannot be understood changes nothing, as in other readers; `warnings` gets a message with `file`
/// and the line's number. Texture options that would change the picture cause a warning as well.
/// @throws FormatError  (with the line) more than 100 000 lines cannot be understood.
std::vector<Material> read_mtl(ByteSource& source, const std::string& file,
                               std::vector<std::string>& warnings);

}  // namespace manip3d
