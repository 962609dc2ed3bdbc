#pragma once

#include <functional>
#include <string>
#include <vector>

#include "io/gltf_document.hpp"

namespace manip3d {

/// Extension of tiles: a point near which they lie, in coordinates of the earth.
inline constexpr const char* kCesiumRtc = "CESIUM_RTC";

/// Does the caller read an extension of this name, besides those that every reader reads?
using IsKeptExtension = std::function<bool(const std::string& name)>;

/// Refuses a file that cannot be read, warns of extensions that are left out, and gives each mesh
/// of a file without nodes a node of its own.
/// @throws FormatError  a version other than 2, or an unknown required extension.
void check_gltf_asset(GltfDocument& document, const IsKeptExtension& is_kept,
                      std::vector<std::string>& warnings);

}  // namespace manip3d
