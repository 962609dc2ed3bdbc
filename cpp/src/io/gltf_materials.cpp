#include "io/gltf_materials.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string_view>
#include <utility>

#include "io/gltf_scene.hpp"
#include "io/warnings.hpp"

namespace manip3d {
namespace {

GltfTextureTransform read_texture_transform(const JsonPlace& place) {
  GltfTextureTransform transform;
  if (const auto offset = place.find("offset")) {
    Eigen::Map<Eigen::Vector2d>(transform.offset.data()) = vector_of<2>(*offset);
  }
  if (const auto rotation = place.find("rotation")) transform.rotation = rotation->number();
  if (const auto scale = place.find("scale")) {
    Eigen::Map<Eigen::Vector2d>(transform.scale.data()) = vector_of<2>(*scale);
  }
  return transform;
}

/// The set of texture coordinates that a texture uses, and how it transforms them; null without a
/// texture.
std::optional<GltfTextureTransform> placement_of(const JsonPlace& owner, const char* key) {
  const auto info = owner.find(key);
  if (!info) return std::nullopt;
  const auto extensions = info->find("extensions");
  const auto given = extensions ? extensions->find(kTextureTransform) : std::nullopt;
  auto set = given ? given->find("texCoord") : std::nullopt;  // replaces the texture's own
  if (!set) set = info->find("texCoord");
  GltfTextureTransform transform = given ? read_texture_transform(*given) : GltfTextureTransform();
  if (set) transform.set = set->integer(0, 255);
  return transform;
}

AlphaMode read_alpha_mode(const JsonPlace& place) {
  constexpr std::array<std::string_view, 3> kModes = {"OPAQUE", "MASK", "BLEND"};
  const auto found = std::find(kModes.begin(), kModes.end(), place.text());
  if (found == kModes.end()) place.fail("expected OPAQUE, MASK or BLEND");
  return static_cast<AlphaMode>(found - kModes.begin());
}

/// The colours that KHR_materials_pbrSpecularGlossiness gives a material; null where its core gives
/// colours to fall back on, unless only the extension names a texture of them.
std::optional<JsonPlace> specular_glossiness_of(const JsonPlace& material) {
  const auto extensions = material.find("extensions");
  const auto found = extensions ? extensions->find(kSpecularGlossiness) : std::nullopt;
  if (!found) return std::nullopt;
  const auto core = material.find("pbrMetallicRoughness");
  const char* told = found->has("diffuseTexture") ? "baseColorTexture" : "baseColorFactor";
  const bool falls_back = core && (core->has("baseColorTexture") || core->has(told));
  return falls_back ? std::nullopt : found;
}

TextureWrap wrap_of(const JsonPlace& sampler, const char* key) {
  const auto found = sampler.find(key);
  const double code = found ? found->number() : kGltfRepeat;
  if (code == kGltfMirror) return TextureWrap::kMirror;
  return code == kGltfClamp ? TextureWrap::kClamp : TextureWrap::kRepeat;
}

void read_sampler(const GltfDocument& document, const JsonPlace& place, Texture& texture) {
  const auto index = place.find("sampler");
  constexpr std::int64_t kMost = std::numeric_limits<std::int32_t>::max();
  if (!index || index->integer(0, kMost) >= document.count("samplers")) return;
  const JsonPlace sampler = document.object("samplers", *index);
  texture.wrap = {wrap_of(sampler, "wrapS"), wrap_of(sampler, "wrapT")};
  const auto filter = sampler.find("magFilter");
  texture.smooth = !filter || filter->number() != kGltfNearest;
}

/// Reads one material.
class MaterialReader {
 public:
  MaterialReader(GltfDocument& document, const JsonPlace& place, GltfTexcoords texcoords,
                 GltfBudget& budget, std::vector<std::string>& warnings)
      : document_(document), place_(place), budget_(budget), warnings_(warnings) {
    if (texcoords == GltfTexcoords::kPlaced) placed_ = first_texture_transform(place);
  }

  Material read() {
    Material m;
    m.metallic = 1.0;  // glTF's defaults, where ours are 0 and true
    m.double_sided = false;
    if (const auto name = place_.find("name")) m.name = name->text();
    if (const auto old = specular_glossiness_of(place_)) {
      read_specular_glossiness(*old, m);
    } else if (const auto pbr = place_.find("pbrMetallicRoughness")) {
      if (const auto color = pbr->find("baseColorFactor")) {
        Eigen::Map<Eigen::Vector4d>(m.base_color) = vector_of<4>(*color);
      }
      if (const auto metallic = pbr->find("metallicFactor")) m.metallic = metallic->number();
      if (const auto roughness = pbr->find("roughnessFactor")) m.roughness = roughness->number();
      read_texture(*pbr, "baseColorTexture", "base_color", m);
      read_texture(*pbr, "metallicRoughnessTexture", "metallic_roughness", m);
    }
    read_texture(place_, "normalTexture", "normal", m);
    read_texture(place_, "occlusionTexture", "occlusion", m);
    read_emission(m);
    if (const auto mode = place_.find("alphaMode")) m.alpha_mode = read_alpha_mode(*mode);
    if (const auto cutoff = place_.find("alphaCutoff")) m.alpha_cutoff = cutoff->number();
    if (const auto both = place_.find("doubleSided")) m.double_sided = both->boolean();
    return m;
  }

 private:
  /// A metal, which has a dark diffuse and a coloured specular part, becomes a dark non-metal.
  void read_specular_glossiness(const JsonPlace& place, Material& m) {
    if (const auto color = place.find("diffuseFactor")) {
      Eigen::Map<Eigen::Vector4d>(m.base_color) = vector_of<4>(*color);
    }
    m.metallic = 0.0;
    const auto glossiness = place.find("glossinessFactor");
    m.roughness = 1.0 - (glossiness ? std::clamp(glossiness->number(), 0.0, 1.0) : 1.0);
    read_texture(place, "diffuseTexture", "base_color", m);
  }

  /// Reads the texture `key` of `owner` as the material's `role`.
  void read_texture(const JsonPlace& owner, const char* key, const char* role, Material& material) {
    const auto info = owner.find(key);
    if (!info) return;
    const auto placement = placement_of(owner, key);
    if (placement->set != (placed_ ? placed_->set : 0)) {
      warn(warnings_,
           "textures on other texture coordinates than the first of their material are left "
           "out");
      return;
    }
    if (placed_ && *placement != *placed_) {
      warn(warnings_,
           std::string(kTextureTransform) +
               ": textures placed otherwise than the first of their material are left out");
      return;
    }
    const JsonPlace texture = document_.object("textures", info->member("index"));
    const auto source = texture.find("source");
    if (!source) {
      warn(warnings_, "textures that are not PNG or JPEG images are left out");
      return;
    }
    const JsonPlace image = document_.object("images", *source);
    if (const auto uri = image.find("uri")) {
      if (const std::string scheme = uri_scheme(uri->text()); !scheme.empty() && scheme != "data") {
        warn(warnings_, "remote images are left out");
        return;
      }
      budget_.charge(std::ssize(uri->text()), image.pointer());
    }
    Texture read = read_image(image);
    read_sampler(document_, texture, read);
    material.textures[role] = std::move(read);
  }

  Texture read_image(const JsonPlace& image) {
    Texture texture;
    if (const auto uri = image.find("uri")) {
      if (uri_scheme(uri->text()) == "data") {
        texture.data = decode_data_uri(*uri);
      } else {
        texture.path = decode_relative_uri(*uri);
      }
      return texture;
    }
    const ByteSpan bytes = document_.buffer_view(image.member("bufferView"));
    budget_.charge(std::ssize(bytes), image.pointer());
    texture.data.assign(bytes.begin(), bytes.end());
    return texture;
  }

  /// Reads what the surface emits. Where the emissive texture is left out, its factor is left out,
  /// too: it would make the whole surface shine.
  void read_emission(Material& m) {
    const auto factor = place_.find("emissiveFactor");
    if (!factor || vector_of<3>(*factor).isZero()) return;
    read_texture(place_, "emissiveTexture", "emissive", m);
    if (place_.has("emissiveTexture") && !m.textures.contains("emissive")) return;
    Eigen::Map<Eigen::Vector3d> light(m.emissive);
    light = vector_of<3>(*factor);
    const auto extensions = place_.find("extensions");
    const auto bright = extensions ? extensions->find(kEmissiveStrength) : std::nullopt;
    const auto strength = bright ? bright->find("emissiveStrength") : std::nullopt;
    if (strength) light *= strength->number();
    if (!light.allFinite()) place_.fail("the emissive light overflows");
    light = light.cwiseMax(0.0);
    if (light.isZero(0.0)) m.textures.erase("emissive");  // else 0 would count as 1 beside it
  }

  GltfDocument& document_;
  const JsonPlace& place_;
  GltfBudget& budget_;
  std::vector<std::string>& warnings_;
  /// The transform that the texture coordinates have got: a texture with another one is left out.
  std::optional<GltfTextureTransform> placed_;
};

}  // namespace

Eigen::RowVector2d GltfTextureTransform::operator()(double u, double v) const {
  const double su = scale[0] * u, sv = scale[1] * v;
  const double c = std::cos(rotation), s = std::sin(rotation);
  return {offset[0] + c * su + s * sv, offset[1] - s * su + c * sv};
}

GltfTextureTransform first_texture_transform(const JsonPlace& material) {
  if (const auto old = specular_glossiness_of(material)) {
    if (const auto placement = placement_of(*old, "diffuseTexture")) return *placement;
  } else if (const auto pbr = material.find("pbrMetallicRoughness")) {
    for (const char* key : {"baseColorTexture", "metallicRoughnessTexture"}) {
      if (const auto placement = placement_of(*pbr, key)) return *placement;
    }
  }
  for (const char* key : {"normalTexture", "occlusionTexture", "emissiveTexture"}) {
    if (const auto placement = placement_of(material, key)) return *placement;
  }
  return {};
}

GltfMeshMaterials read_mesh_materials(GltfDocument& document, GltfBudget& budget,
                                      std::vector<std::string>& warnings) {
  GltfMeshMaterials read;
  for (std::int64_t i = 0; i < document.count("materials"); ++i) {
    const JsonPlace place = document.root().member("materials").item(i);
    const auto extras = place.find("extras");
    const auto original =
        extras && extras->is_object() ? extras->find(kUntexturedCopyOf) : std::nullopt;
    if (original && i > 0) {
      read.rows.push_back(read.rows[original->integer(0, i - 1)]);
      continue;
    }
    read.rows.push_back(static_cast<std::int32_t>(read.materials.size()));
    read.materials.push_back(
        MaterialReader(document, place, GltfTexcoords::kPlaced, budget, warnings).read());
  }
  return read;
}

std::vector<Material> read_scene_materials(GltfDocument& document, GltfBudget& budget) {
  std::vector<std::string> in_document;  // what these warn of is not lost
  std::vector<Material> materials;
  for (std::int64_t i = 0; i < document.count("materials"); ++i) {
    const JsonPlace place = document.root().member("materials").item(i);
    materials.push_back(
        MaterialReader(document, place, GltfTexcoords::kStored, budget, in_document).read());
  }
  return materials;
}

}  // namespace manip3d
