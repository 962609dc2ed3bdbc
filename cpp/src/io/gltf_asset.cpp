#include "io/gltf_asset.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <string>
#include <string_view>

#include "io/gltf_materials.hpp"
#include "io/gltf_nodes.hpp"
#include "io/gltf_scene.hpp"
#include "io/warnings.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

/// Extensions that change how a mesh looks, not where it is: it is read without them, even if the
/// file requires them.
bool changes_looks(const std::string& name) {
  constexpr std::array<std::string_view, 7> kLooks = {
      "EXT_texture_avif",     "EXT_texture_webp",   "KHR_lights_punctual", "KHR_technique_webgl",
      "KHR_techniques_webgl", "KHR_texture_basisu", "MSFT_texture_dds"};
  return name.starts_with("KHR_materials_") ||
         std::find(kLooks.begin(), kLooks.end(), name) != kLooks.end();
}

bool is_read_extension(const std::string& name) {
  return name == "KHR_mesh_quantization" || name == kTextureTransform || name == kInstancing ||
         name == kEmissiveStrength || name == kDraco || name == kCesiumRtc ||
         is_meshopt_extension(name);
}

/// Warns of the point of the earth to which all coordinates of a tile are relative. A mesh does not
/// get it: its axes are those of the earth, and float32 is too coarse for its coordinates.
void warn_of_center(const GltfDocument& document, std::vector<std::string>& warnings) {
  const auto extensions = document.root().find("extensions");
  const auto found = extensions ? extensions->find(kCesiumRtc) : std::nullopt;
  const auto center = found ? found->find("center") : std::nullopt;
  if (!center) return;
  const Eigen::Vector3d point = vector_of<3>(*center);
  std::string text;
  for (const double x : point) text += (text.empty() ? "" : ", ") + number_text(x);
  warn(warnings, std::string(kCesiumRtc) + ": coordinates are relative to the point (" + text +
                     ") of the earth, which is left out");
}

}  // namespace

void check_gltf_asset(GltfDocument& document, const IsKeptExtension& is_kept,
                      std::vector<std::string>& warnings) {
  const JsonPlace version = document.root().member("asset").member("version");
  if (!version.text().starts_with("2.")) {
    version.fail("expected glTF 2.x, got version " + version.text());
  }
  const auto is_known = [&](const std::string& name) {
    return is_read_extension(name) || (is_kept && is_kept(name));
  };
  if (const auto required = document.root().find("extensionsRequired")) {
    for (std::int64_t i = 0; i < required->size(); ++i) {
      const std::string& name = required->item(i).text();
      if (!is_known(name) && !changes_looks(name)) {
        required->item(i).fail("the file requires the extension " + name + ", which is not read");
      }
    }
  }
  if (const auto used = document.root().find("extensionsUsed")) {
    for (std::int64_t i = 0; i < used->size(); ++i) {
      const std::string& name = used->item(i).text();
      if (is_known(name)) continue;
      warn(warnings, name == kSpecularGlossiness
                         ? "of extension " + name + " only diffuse colors and glossiness are read"
                         : "extension " + name + " is left out");
    }
  }
  if (!is_kept) warn_of_center(document, warnings);
  if (document.place_meshes_without_nodes()) {
    warn(warnings, "the file has no nodes: all its meshes are read, where their vertices are");
  }
}

}  // namespace manip3d
