#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "io/gltf_document.hpp"
#include "io/gltf_materials.hpp"

namespace manip3d {

/// A primitive of triangles and its accessors, which are null where it has none.
struct GltfPrimitive {
  JsonPlace place;
  const GltfAccessor* position = nullptr;
  const GltfAccessor* normal = nullptr;
  const GltfAccessor* texcoord = nullptr;
  const GltfAccessor* color = nullptr;
  const GltfAccessor* indices = nullptr;
  std::vector<const GltfAccessor*> more_texcoords = {};  ///< See more_texcoords_of().
  std::optional<JsonPlace> targets = std::nullopt;
  GltfTextureTransform texture = {};
  std::int32_t material = -1;
  std::int64_t mode = kModeTriangles;

  [[nodiscard]] std::int64_t num_corners() const;
  [[nodiscard]] std::int64_t num_faces() const;
  /// The vertex of each corner. @throws FormatError  an index beyond the vertices.
  [[nodiscard]] std::vector<std::uint32_t> corners() const;
  /// The corners of a face in the list of corners: glTF 2.0, section 3.7.2.1.
  [[nodiscard]] std::array<std::int64_t, 3> face_corners(std::int64_t face) const;
};

/// The primitives of a mesh that have triangles; the others are left out with a warning.
/// @throws FormatError  accessors that do not fit each other or their use.
std::vector<GltfPrimitive> read_primitives(GltfDocument& document, std::int64_t mesh,
                                           GltfTexcoords texcoords,
                                           std::vector<std::string>& warnings);

/// Name of an attribute.
inline std::string texcoords_in_set(std::int64_t set) { return "TEXCOORD_" + std::to_string(set); }

/// Whether a texture of a primitive is placed by another set of coordinates than the first, in one
/// of its materials.
bool reads_more_texcoords(const GltfDocument& document, const JsonPlace& primitive);

/// TEXCOORD_1, TEXCOORD_2, ... up to the first that is missing, where a texture reads one of them.
/// Sets that no texture reads are left out: their seams would cost faces.
std::vector<const GltfAccessor*> more_texcoords_of(GltfDocument& document,
                                                   const JsonPlace& primitive);

}  // namespace manip3d
