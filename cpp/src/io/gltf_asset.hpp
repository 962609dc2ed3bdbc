#pragma once

#include <functional>
#include <string>
#include <vector>

#include "io/gltf_document.hpp"

namespace manip3d {

/// Whether a file's extension is read, beside those that every reader reads.
using IsKeptExtension = std::function<bool(const std::string& name)>;

/// Refuses a file that cannot be read, warns of extensions that are left out, and gives each mesh
/// of a file without nodes a node of its own.
/// @throws FormatError  another version than 2, or a required extension that is not known.
void check_gltf_asset(GltfDocument& document, const IsKeptExtension& is_kept,
                      std::vector<std::string>& warnings);

}  // namespace manip3d
