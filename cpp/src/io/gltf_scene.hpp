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
  std::string path;       ///< Path of the texture; "" when only its bytes are known.
};

/// MIME type of an image by its first bytes, such as image/png; "" for what no bufferView may hold.
std::string_view image_type(std::string_view data);

/// A mesh in glTF's terms. `json` lacks what depends on where the bytes go: /buffers, and for each
/// of `images`, in order, its uri or bufferView.
struct GltfScene {
  nlohmann::ordered_json json;
  std::string buffer;
  std::vector<GltfImage> images;

  /// Appends bytes, 4-byte aligned, and gives the index of their bufferView. `stride` 0: elements
  /// without gaps.
  std::size_t add_buffer_view(std::string_view bytes, std::size_t stride = 0);
};

/// The image file of a texture, or "" (with a warning of its own) where there is none to be had.
using GltfTextureReader = std::function<std::string(const Texture& texture)>;

/// One node with one mesh: a primitive for the faces that share material and kinds of attributes.
///
/// Vertices are split where the UV or normal of a corner differs; those that no face uses are left
/// out. Positions are float32; where that would lose more than 1e-6 of the diagonal, they are
/// stored around the centre and the node moves them back. Materials are double-sided: other
/// formats know no sides. A textured material of faces without UV is written a second time without
/// its textures, because glTF forbids the pair; its `extras` name the first, so that parse_gltf
/// makes one of the two again. Coarser levels are further nodes, named by the first (MSFT_lod).
/// @throws InputError  no faces, material index out of range, values beyond float32.
GltfScene build_gltf(const MeshView& mesh, const std::vector<Material>& materials,
                     const GltfTextureReader& read_texture, std::vector<std::string>& warnings,
                     const WriteOptions& options = {});

/// Names the extension of quantised attributes among those that readers must know.
void require_quantization(nlohmann::ordered_json& document);

/// Puts the images into the buffer and gives all bytes of a GLB file that precede the buffer.
/// @throws InputError  more than 4 GiB.
std::string finish_glb(GltfScene& scene);

/// Writes a GLB file. @throws InputError  more than 4 GiB.
void write_glb(Output& output, GltfScene& scene);

/// Writes a .gltf file to `path`, with its buffer and images beside it.
void write_gltf(Output& output, GltfScene& scene, const std::filesystem::path& path,
                CompanionFiles& files);

/// Extension for light of more than 1.
constexpr const char* kEmissiveStrength = "KHR_materials_emissive_strength";

/// Member of a material's `extras`: the material whose textures it lacks.
constexpr const char* kUntexturedCopyOf = "manip3d_untextured_copy_of";

}  // namespace manip3d
