#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "io/gltf_document.hpp"
#include "io/gltf_materials.hpp"

namespace manip3d {

/// A primitive of triangles with its accessors; null: it has no such accessor.
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
  bool shows_alpha = false;  ///< See manip3d::shows_alpha().
  std::int64_t mode = kModeTriangles;

  [[nodiscard]] std::int64_t num_corners() const;
  [[nodiscard]] std::int64_t num_faces() const;
  /// The vertex of each corner.
  /// @throws FormatError  an index is beyond the vertices.
  [[nodiscard]] std::vector<std::uint32_t> corners() const;
  /// The corners of a face, as indices into corners(): glTF 2.0, section 3.7.2.1.
  [[nodiscard]] std::array<std::int64_t, 3> face_corners(std::int64_t face) const;
};

/// Reads the primitives with triangles of a mesh; others are left out with a warning.
/// @throws FormatError  accessors do not fit each other or their use.
std::vector<GltfPrimitive> read_primitives(GltfDocument& document, std::int64_t mesh,
                                           GltfTexcoords texcoords,
                                           std::vector<std::string>& warnings);

/// Name of the attribute with a set of texture coordinates.
inline std::string texcoords_in_set(std::int64_t set) { return "TEXCOORD_" + std::to_string(set); }

/// Does the material of a primitive show alpha, instead of ignoring it?
bool shows_alpha(const GltfDocument& document, const JsonPlace& primitive);

/// Does any material of a primitive have a texture that uses a set of coordinates other than the
/// first?
bool reads_more_texcoords(const GltfDocument& document, const JsonPlace& primitive);

/// TEXCOORD_1, TEXCOORD_2, ... up to the first missing one, if a texture uses one of them.
/// Otherwise they are left out, because their seams would cost faces.
std::vector<const GltfAccessor*> more_texcoords_of(GltfDocument& document,
                                                   const JsonPlace& primitive);

}  // namespace manip3d
