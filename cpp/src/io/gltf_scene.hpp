#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "io/output.hpp"
#include "io/texture_files.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/io/mesh_file.hpp"
#include "manip3d/io/scene_file.hpp"

namespace manip3d {

/// A texture image to write.
struct GltfImage {
  std::string data;
  std::string mime_type;  ///< image/png or image/jpeg.
  std::string path;       ///< Path of the texture; "": only its bytes are known.
};

/// MIME type of an image by its first bytes, such as image/png; "": a type that bufferViews must
/// not contain.
std::string_view image_type(std::string_view data);

/// A mesh as glTF. `json` has no /buffers yet, and no uri or bufferView for each of `images`,
/// because these depend on where the bytes are stored.
struct GltfScene {
  nlohmann::ordered_json json;
  std::string buffer;
  std::vector<GltfImage> images;

  /// Appends bytes, 4-byte aligned, and returns the index of their bufferView.
  /// @param stride  Bytes from element to element; 0: elements without gaps.
  std::size_t add_buffer_view(std::string_view bytes, std::size_t stride = 0);
};

/// Returns the image file of a texture, or "" after a warning if it is not available.
using GltfTextureReader = std::function<std::string(const Texture& texture)>;

/// Builds a scene of one node with one mesh. Faces with the same material and the same kinds of
/// attributes form a primitive.
///
/// Vertices are split if their corners have different UV or normals; unused vertices are left out.
/// Positions are float32. If this would lose more than 1e-6 of the diagonal, they are stored
/// relative to the centre, and the node moves them back. Materials are double-sided, because other
/// formats do not distinguish sides. glTF does not allow faces without UV in a textured material: a
/// copy of the material without textures is written for them, whose `extras` name the original, so
/// that parse_gltf merges the two again. Coarser levels are further nodes, which the first one
/// names (MSFT_lod).
/// @throws InputError  no faces, a material index out of range, or values beyond float32.
GltfScene build_gltf(const MeshView& mesh, const std::vector<Material>& materials,
                     const GltfTextureReader& read_texture, std::vector<std::string>& warnings,
                     const WriteOptions& options = {});

/// Adds the extension for quantised attributes to the required ones.
void require_quantization(nlohmann::ordered_json& document);

/// Puts the images into the buffer and returns all bytes of a GLB file before the buffer.
/// @throws InputError  the file would exceed 4 GiB.
std::string finish_glb(GltfScene& scene);

/// Writes a GLB file.
/// @throws InputError  it would exceed 4 GiB.
void write_glb(Output& output, GltfScene& scene);

/// Writes a .gltf file to `path`, with its buffer and images in files beside it.
void write_gltf(Output& output, GltfScene& scene, const std::filesystem::path& path,
                CompanionFiles& files);

/// Extension for emissive light above 1.
constexpr const char* kEmissiveStrength = "KHR_materials_emissive_strength";

/// Member of a material's `extras`: the material of which this is a copy without textures.
constexpr const char* kUntexturedCopyOf = "manip3d_untextured_copy_of";

}  // namespace manip3d
