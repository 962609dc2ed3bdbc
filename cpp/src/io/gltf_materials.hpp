#pragma once

#include <Eigen/Core>
#include <array>
#include <compare>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "io/gltf_document.hpp"
#include "manip3d/geometry/mesh.hpp"

namespace manip3d {

inline constexpr const char* kTextureTransform = "KHR_texture_transform";

/// Older model of materials, without core colours in many files.
inline constexpr const char* kSpecularGlossiness = "KHR_materials_pbrSpecularGlossiness";

/// Codes of samplers.
inline constexpr int kGltfRepeat = 10497, kGltfMirror = 33648, kGltfClamp = 33071;
inline constexpr int kGltfNearest = 9728;

/// Texture coordinates that a mesh gets; they decide which textures its materials keep.
enum class GltfTexcoords {
  /// One set for each material: that of its first texture, with the transform of that texture.
  /// Textures that are placed otherwise are left out.
  kPlaced,
  /// TEXCOORD_0 as stored.
  kStored,
};

/// Placement of a texture by KHR_texture_transform: glTF's (u, v) becomes
/// offset + R (scale * (u, v)). R turns counter-clockwise on screen, where v points down.
struct GltfTextureTransform {
  std::int64_t set = 0;  ///< The TEXCOORD that it transforms.
  std::array<double, 2> offset = {0.0, 0.0};
  double rotation = 0.0;  ///< Radians.
  std::array<double, 2> scale = {1.0, 1.0};

  auto operator<=>(const GltfTextureTransform&) const = default;

  [[nodiscard]] Eigen::RowVector2d operator()(double u, double v) const;
};

/// The transform of a material's first texture.
GltfTextureTransform first_texture_transform(const JsonPlace& material);

/// The materials of a mesh, whose texture coordinates are kPlaced.
struct GltfMeshMaterials {
  std::vector<Material> materials;
  std::vector<std::int32_t> rows;  ///< By the index of a material in the file.
};

/// Our writer adds a copy without textures of each material that a face without texture
/// coordinates has. Such a copy (kUntexturedCopyOf) is its original again.
GltfMeshMaterials read_mesh_materials(GltfDocument& document, GltfBudget& budget,
                                      std::vector<std::string>& warnings);

/// All materials of a scene, whose texture coordinates are kStored, by their index in the file;
/// what they lack stays in the document.
std::vector<Material> read_scene_materials(GltfDocument& document, GltfBudget& budget);

}  // namespace manip3d
