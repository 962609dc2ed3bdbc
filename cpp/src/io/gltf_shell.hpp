#pragma once

#include <string>
#include <vector>

#include "io/gltf_document.hpp"
#include "io/gltf_scene.hpp"

namespace manip3d {

/// Does a scene keep an extension? These are the extensions that refer only to objects with
/// unchanged indices (nodes, materials, textures, images), and those whose accessors the shell
/// knows.
bool is_kept_extension(const std::string& name);

/// The parts of a file that its shell keeps.
struct GltfKept {
  std::vector<bool> meshes;    ///< By mesh: are its primitives kept?
  std::vector<bool> replaced;  ///< By mesh: are its triangles replaced by others?
  std::vector<bool> nodes;     ///< By node: is its mesh kept?
};

/// Member of a replaced mesh in the shell: KHR_materials_variants of its primitives by the index of
/// their material, for the new primitives.
constexpr const char* kVariantsOfMaterials = "manip3d_variants";
constexpr const char* kVariants = "KHR_materials_variants";

/// Reads a glTF file except the primitives that are not kept. Everything that is still referred to
/// is in one buffer, images included.
/// @throws FormatError  references or lengths do not fit.
GltfScene read_gltf_shell(GltfDocument& source, const GltfKept& kept, const GltfResource& resource,
                          GltfBudget& budget, std::vector<std::string>& warnings);

}  // namespace manip3d
