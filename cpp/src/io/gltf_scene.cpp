#include "io/gltf_scene.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <map>
#include <numeric>
#include <string>
#include <string_view>
#include <utility>

#include "io/gltf_materials.hpp"
#include "io/gltf_write_primitives.hpp"
#include "io/warnings.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

using Json = nlohmann::ordered_json;

/// An origin relative to which float32 is precise enough for the mesh; 0 if possible.
Eigen::Vector3d origin_for_float32(const MeshView& mesh) {
  constexpr double kRelativeLoss = 1e-6;
  constexpr double kHalfUlp = 1.0 / (1 << 24);  // relative rounding error of float32
  constexpr double kSmallest = 1e-38;           // below this, float32 itself loses kRelativeLoss
  const BoundingBox box = bounding_box(mesh);
  if (box.diagonal() > 0.0 && box.diagonal() < kSmallest) {
    throw InputError("vertices: glTF holds float32, too coarse for a mesh of diagonal " +
                     number_text(box.diagonal()));
  }
  const double farthest = std::max(box.min.cwiseAbs().maxCoeff(), box.max.cwiseAbs().maxCoeff());
  if (!(farthest * kHalfUlp > kRelativeLoss * box.diagonal())) return Eigen::Vector3d::Zero();
  return box.center().cast<float>().cast<double>();  // exact also for readers with float32 nodes
}

constexpr const char* kQuantization = "KHR_mesh_quantization";

class SceneBuilder {
 public:
  SceneBuilder(const MeshView& mesh, const std::vector<Material>& materials,
               const GltfTextureReader& read_texture, std::vector<std::string>& warnings,
               const WriteOptions& options)
      : materials_(materials), read_texture_(read_texture), warnings_(warnings), options_(options) {
    levels_.push_back(&mesh);
    for (const MeshView& level : options.coarser) levels_.push_back(&level);
    for (const MeshView* level : levels_) check_mesh(*level);
    frame_.origin = origin_for_float32(mesh);
    if (options.quantize) frame_ = quantized_frame(levels_);
  }

  GltfScene build() {
    const PrimitiveOptions options{frame_, options_.max_vertices, materials_.size(),
                                   [this](std::int32_t material, bool has_texcoords) {
                                     return has_texcoords ? std::int64_t{material}
                                                          : untextured(material);
                                   }};
    options.check();
    scene_.json["asset"] = {{"version", "2.0"}, {"generator", "manip3d " MANIP3D_VERSION}};
    if (levels_.size() > 1) scene_.json["extensionsUsed"].push_back("MSFT_lod");
    if (frame_.is_quantized()) require_quantization(scene_.json);
    scene_.json["scene"] = 0;
    scene_.json["scenes"] = Json::array({{{"nodes", {0}}}});
    for (std::size_t level = 0; level < levels_.size(); ++level) write_node(level);
    for (const Material& material : materials_) write_material(material);
    for (const MeshView* level : levels_) {
      Json primitives = write_primitives(scene_, {*level}, options);
      scene_.json["meshes"].push_back({{"primitives", std::move(primitives)}});
    }
    return std::move(scene_);
  }

 private:
  void write_node(std::size_t level) {
    Json node = {{"mesh", level}};
    const Eigen::Vector3d& origin = frame_.origin;
    if (!origin.isZero(0.0)) node["translation"] = {origin.x(), origin.y(), origin.z()};
    if (frame_.is_quantized()) node["scale"] = {frame_.scale, frame_.scale, frame_.scale};
    if (level == 0 && levels_.size() > 1) {
      std::vector<std::size_t> ids(levels_.size() - 1);
      std::iota(ids.begin(), ids.end(), std::size_t{1});
      node["extensions"] = {{"MSFT_lod", {{"ids", ids}}}};
      node["extras"] = {{"MSFT_screencoverage", options_.coverages}};
    }
    scene_.json["nodes"].push_back(std::move(node));
  }

  // --- Materials -------------------------------------------------------------------------

  Json material_factors(const Material& m) {
    Json pbr = {{"baseColorFactor", m.base_color},
                {"metallicFactor", m.metallic},
                {"roughnessFactor", m.roughness}};
    Json material = {{"name", m.name}, {"pbrMetallicRoughness", std::move(pbr)}};
    if (m.alpha_mode == AlphaMode::kBlend) material["alphaMode"] = "BLEND";
    if (m.alpha_mode == AlphaMode::kMask) {
      material["alphaMode"] = "MASK";
      material["alphaCutoff"] = m.alpha_cutoff;
    }
    material["doubleSided"] = m.double_sided;
    return material;
  }

  void write_material(const Material& m) {
    Json material = material_factors(m);
    const auto add = [&](Json& owner, const char* role, const char* key) {
      const auto texture = m.textures.find(role);
      if (texture == m.textures.end() || texture->second.empty()) return;
      const std::int64_t index = texture_index(texture->second);
      if (index >= 0) owner[key] = {{"index", index}};
    };
    add(material["pbrMetallicRoughness"], "base_color", "baseColorTexture");
    add(material["pbrMetallicRoughness"], "metallic_roughness", "metallicRoughnessTexture");
    add(material, "normal", "normalTexture");
    add(material, "occlusion", "occlusionTexture");
    add(material, "emissive", "emissiveTexture");
    const bool has_image = material.contains("emissiveTexture");
    // Without its image, the factor alone would make the whole surface emit light.
    if (has_image || !m.textures.contains("emissive")) write_light(material, m, has_image);
    scene_.json["materials"].push_back(std::move(material));
  }

  /// glTF's factor is at most 1; brighter light needs an extension.
  void write_light(Json& material, const Material& m, bool has_image) {
    if (!m.emits()) {
      if (has_image) material["emissiveFactor"] = {1.0, 1.0, 1.0};
      return;
    }
    const double strength = std::max({1.0, m.emissive[0], m.emissive[1], m.emissive[2]});
    material["emissiveFactor"] = {m.emissive[0] / strength, m.emissive[1] / strength,
                                  m.emissive[2] / strength};
    if (strength == 1.0) return;
    material["extensions"] = {{kEmissiveStrength, {{"emissiveStrength", strength}}}};
    Json& used = scene_.json["extensionsUsed"];
    if (std::find(used.begin(), used.end(), kEmissiveStrength) == used.end()) {
      used.push_back(kEmissiveStrength);
    }
  }

  /// The index of a copy of the material without textures, for faces without texture coordinates.
  std::int64_t untextured(std::int32_t index) {
    const Material& m = materials_[index];
    if (m.textures.empty()) return index;
    const auto [copy, is_new] = untextured_.try_emplace(index, scene_.json["materials"].size());
    if (is_new) {
      Json material = material_factors(m);
      if (!m.textures.contains("emissive")) write_light(material, m, false);
      material["extras"] = {{kUntexturedCopyOf, index}};
      scene_.json["materials"].push_back(std::move(material));
    }
    return static_cast<std::int64_t>(copy->second);
  }

  /// The index of a texture; -1: it has no image. Textures with equal images and samplers are one.
  std::int64_t texture_index(const Texture& texture) {
    const std::int64_t image = image_index(texture);
    if (image < 0) return -1;
    const std::int64_t sampler = sampler_index(texture);
    const auto [known, is_new] =
        textures_.try_emplace(std::pair(image, sampler), std::ssize(scene_.json["textures"]));
    if (is_new) {
      Json entry = {{"source", image}};
      if (sampler >= 0) entry["sampler"] = sampler;
      scene_.json["textures"].push_back(std::move(entry));
    }
    return known->second;
  }

  /// The index of a texture's sampler; -1: the usual one, which needs none.
  std::int64_t sampler_index(const Texture& texture) {
    if (texture.has_usual_sampler()) return -1;
    constexpr std::array<int, 3> kWraps = {kGltfRepeat, kGltfMirror, kGltfClamp};
    Json sampler = {{"wrapS", kWraps[static_cast<std::size_t>(texture.wrap[0])]},
                    {"wrapT", kWraps[static_cast<std::size_t>(texture.wrap[1])]}};
    if (!texture.smooth) sampler["magFilter"] = kGltfNearest;
    Json& samplers = scene_.json["samplers"];
    const auto known = std::find(samplers.begin(), samplers.end(), sampler);
    const std::int64_t index = known - samplers.begin();
    if (known == samplers.end()) samplers.push_back(std::move(sampler));
    return index;
  }

  /// The index of an image; -1: there is none. Equal images are one; each file is read once.
  std::int64_t image_index(const Texture& texture) {
    if (!texture.data.empty()) return index_of_image(texture);
    const auto [known, is_new] = index_of_path_.try_emplace(texture.path, -1);
    if (is_new) known->second = index_of_image(texture);
    return known->second;
  }

  std::int64_t index_of_image(const Texture& texture) {
    std::string data = read_texture_(texture);
    const std::string_view type = image_type(data);
    if (type != "image/png" && type != "image/jpeg") {
      if (!data.empty()) {
        warn(warnings_,
             "texture '" + texture.path + "' is not a PNG or JPEG image and was left out");
      }
      return -1;
    }
    const auto known = std::find_if(scene_.images.begin(), scene_.images.end(),
                                    [&](const GltfImage& image) { return image.data == data; });
    if (known != scene_.images.end()) return known - scene_.images.begin();
    const std::size_t index = scene_.images.size();
    scene_.images.push_back({std::move(data), std::string(type), texture.path});
    scene_.json["textures"];  // its texture follows, but comes before the images in the file
    scene_.json["images"].push_back(Json::object());
    return static_cast<std::int64_t>(index);
  }

  std::vector<const MeshView*> levels_;
  const std::vector<Material>& materials_;
  const GltfTextureReader& read_texture_;
  std::vector<std::string>& warnings_;
  const WriteOptions& options_;
  PositionFrame frame_;
  GltfScene scene_;
  std::map<std::int32_t, std::size_t> untextured_;
  std::map<std::string, std::int64_t> index_of_path_;
  std::map<std::pair<std::int64_t, std::int64_t>, std::int64_t> textures_;  ///< Image and sampler.
};

}  // namespace

std::string_view image_type(std::string_view data) {
  if (data.starts_with("\x89PNG\r\n\x1A\n")) return "image/png";
  if (data.starts_with("\xFF\xD8\xFF")) return "image/jpeg";
  if (data.size() > 8 && data.starts_with("RIFF") && data.substr(8).starts_with("WEBP"))
    return "image/webp";
  if (data.starts_with("\xABKTX 20")) return "image/ktx2";
  if (data.starts_with("DDS ")) return "image/vnd-ms.dds";
  if (data.size() > 4 && data.substr(4).starts_with("ftypavif")) return "image/avif";
  return "";
}

std::size_t GltfScene::add_buffer_view(std::string_view bytes, std::size_t stride) {
  buffer.resize((buffer.size() + 3) / 4 * 4, '\0');
  json["bufferViews"].push_back(
      {{"buffer", 0}, {"byteOffset", buffer.size()}, {"byteLength", bytes.size()}});
  if (stride > 0) json["bufferViews"].back()["byteStride"] = stride;
  buffer += bytes;
  return json["bufferViews"].size() - 1;
}

void require_quantization(Json& document) {
  for (const char* list : {"extensionsUsed", "extensionsRequired"}) {
    Json& names = document[list];
    if (std::find(names.begin(), names.end(), kQuantization) == names.end()) {
      names.push_back(kQuantization);
    }
  }
}

GltfScene build_gltf(const MeshView& mesh, const std::vector<Material>& materials,
                     const GltfTextureReader& read_texture, std::vector<std::string>& warnings,
                     const WriteOptions& options) {
  return SceneBuilder(mesh, materials, read_texture, warnings, options).build();
}

}  // namespace manip3d
