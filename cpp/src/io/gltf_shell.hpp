#pragma once

#include <string>
#include <vector>

#include "io/gltf_document.hpp"
#include "io/gltf_scene.hpp"

namespace manip3d {

/// Whether a scene keeps an extension: those that refer to nothing but what keeps its index
/// (nodes, materials, textures, images), and those whose accessors the shell knows of.
bool is_kept_extension(const std::string& name);

/// The parts that the shell of a file keeps.
struct GltfKept {
  std::vector<bool> meshes;    ///< Whether a mesh keeps its primitives.
  std::vector<bool> replaced;  ///< Whether other triangles take the place of its triangles.
  std::vector<bool> nodes;     ///< Whether a node keeps what it shows.
};

/// Member of a replaced mesh in the shell: KHR_materials_variants of its primitives by the index of
/// their material, for those that take their place.
constexpr const char* kVariantsOfMaterials = "manip3d_variants";
constexpr const char* kVariants = "KHR_materials_variants";

/// All of a glTF file but the primitives that are not kept, with one buffer that holds what is
/// still referred to, images included.
/// @throws FormatError  references or lengths that do not fit.
GltfScene read_gltf_shell(GltfDocument& source, const GltfKept& kept, const GltfResource& resource,
                          GltfBudget& budget, std::vector<std::string>& warnings);

}  // namespace manip3d
