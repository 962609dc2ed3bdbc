#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <utility>

#include "io/gltf.hpp"
#include "io/gltf_asset.hpp"
#include "io/gltf_deformation.hpp"
#include "io/gltf_primitives.hpp"
#include "io/gltf_shell.hpp"
#include "io/gltf_triangles.hpp"
#include "io/warnings.hpp"

namespace manip3d {
namespace {

/// Properties of all nodes together that refer to a mesh.
struct MeshUse {
  bool is_drawn = false;  ///< At least one is in the default scene.
  bool is_shown = false;  ///< At least one is in some scene.
  bool has_skin = false;
};

JsonPlace mesh_place(const GltfDocument& document, std::int64_t mesh) {
  return document.root().member("meshes").item(mesh);
}

/// The uses of each mesh, in one pass over the nodes, because there may be as many meshes as nodes.
std::vector<MeshUse> uses_of_meshes(const GltfDocument& document,
                                    const std::vector<SceneNode>& nodes,
                                    const std::vector<bool>& is_shown) {
  std::vector<MeshUse> uses(document.count("meshes"));
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    if (nodes[n].mesh < 0) continue;
    const JsonPlace place = document.root().member("nodes").item(static_cast<std::int64_t>(n));
    MeshUse& use = uses[nodes[n].mesh];
    use.is_drawn = use.is_drawn || nodes[n].is_drawn;
    use.is_shown = use.is_shown || is_shown[n];
    use.has_skin = use.has_skin || place.has("skin");
  }
  return uses;
}

/// Reason why a mesh must stay as in the file, because a TriangleMesh could not replace it without
/// losses that matter; empty if it can be replaced.
std::string reason_to_keep(const JsonPlace& mesh, const MeshUse& use) {
  if (!use.is_drawn) return "the default scene does not show it";
  const JsonPlace primitives = mesh.member("primitives");
  for (std::int64_t i = 0; i < primitives.size(); ++i) {
    if (!primitives.item(i).member("attributes").has("POSITION")) {
      return "it has primitives without POSITION";
    }
  }
  return reason_not_to_deform(primitives, use.has_skin);
}

/// Warns of data that the new triangles of a primitive will not have.
void warn_of_losses(GltfDocument& document, const JsonPlace& primitive,
                    std::vector<std::string>& warnings) {
  const JsonPlace attributes = primitive.member("attributes");
  std::set<std::string> held = {"POSITION", "NORMAL", "TEXCOORD_0", "COLOR_0"};
  const std::int64_t num_more = std::ssize(more_texcoords_of(document, primitive));
  for (std::int64_t set = 1; set <= num_more; ++set) held.insert(texcoords_in_set(set));
  for (const auto& [name, accessor] : attributes.value().items()) {
    if (name.starts_with("JOINTS_") || name.starts_with("WEIGHTS_") || held.contains(name)) {
      continue;
    }
    std::string why;
    if (name == "TANGENT") why = ": viewers compute it from the texture coordinates";
    if (name.starts_with("TEXCOORD_") && !reads_more_texcoords(document, primitive)) {
      why = ": no texture reads it";
    }
    warn(warnings, name + " of meshes that are simplified is left out" + why);
  }
  if (primitive.has("extras")) {
    warn(warnings, "extras of primitives that are simplified are left out");
  }
  const auto extensions = primitive.find("extensions");
  if (!extensions) return;
  for (const auto& [name, content] : extensions->value().items()) {
    if (name == kVariants) continue;
    warn(warnings, "extensions of primitives that are simplified are left out");
  }
}

/// Reads TEXCOORD_1, TEXCOORD_2, ... of a mesh's vertices.
MoreTexcoords read_more_texcoords(GltfDocument& document,
                                  const std::vector<PlacedPrimitive>& primitives,
                                  std::int64_t num_vertices, GltfBudget& budget) {
  MoreTexcoords more;
  for (const PlacedPrimitive& primitive : primitives) {
    more.num_sets =
        std::max(more.num_sets, std::ssize(more_texcoords_of(document, primitive.place)));
  }
  if (more.num_sets == 0) return more;
  const std::int64_t width = 2 * more.num_sets;
  budget.charge(num_vertices, width * static_cast<std::int64_t>(sizeof(float)), "meshes");
  more.values.assign(num_vertices * width, std::numeric_limits<float>::quiet_NaN());
  for (const PlacedPrimitive& primitive : primitives) {
    std::int64_t column = 0;
    for (const GltfAccessor* set : more_texcoords_of(document, primitive.place)) {
      budget.charge(set->count, 2 * sizeof(double), set->place.pointer());
      std::vector<double> values(2 * set->count);
      set->decode(values.data());
      for (std::int64_t i = 0; i < set->count; ++i) {
        float* row = more.values.data() + (primitive.first_vertex + i) * width + column;
        row[0] = static_cast<float>(values[2 * i]);
        row[1] = static_cast<float>(values[2 * i + 1]);
      }
      column += 2;
    }
  }
  return more;
}

/// Reads alpha of COLOR_0 of a mesh's vertices; empty: all are opaque, or no material shows alpha.
std::vector<float> read_alphas(GltfDocument& document, const JsonPlace& primitives,
                               const std::vector<PlacedPrimitive>& owners,
                               std::int64_t num_vertices, GltfBudget& budget) {
  bool is_shown = false, is_clear = false;
  for (std::int64_t i = 0; i < primitives.size(); ++i) {
    is_shown = is_shown || shows_alpha(document, primitives.item(i));
  }
  if (!is_shown) return {};
  budget.charge(num_vertices, sizeof(float), "meshes");
  std::vector<float> alphas(num_vertices, 1.0F);
  for (const PlacedPrimitive& owner : owners) {
    const GltfAccessor* color =
        document.attribute(owner.place.member("attributes"), "COLOR_0", 3, 4);
    if (color == nullptr || color->num_components != 4) continue;
    budget.charge(color->count, 4 * sizeof(double), color->place.pointer());
    std::vector<double> values(4 * color->count);
    color->decode(values.data());
    for (std::int64_t i = 0; i < color->count; ++i) {
      const double alpha = std::clamp(values[4 * i + 3], 0.0, 1.0);
      alphas[owner.first_vertex + i] = static_cast<float>(alpha);
      is_clear = is_clear || alpha < 1.0;
    }
  }
  return is_clear ? alphas : std::vector<float>();
}

SceneMesh read_scene_mesh(GltfDocument& document, std::int64_t index, std::string fixed,
                          GltfBudget& budget, std::vector<std::string>& warnings) {
  const JsonPlace place = mesh_place(document, index);
  SceneMesh read;
  read.fixed = std::move(fixed);
  if (const auto name = place.find("name")) read.name = name->text();
  GltfInstance instance{.mesh = index};
  // A mesh that can be replaced stays without its morph targets, because viewers add them when they
  // show it.
  if (!read.fixed.empty()) instance.weights = place.find("weights");
  std::vector<std::string> in_document;  // warnings about parts that the document keeps
  GltfTriangles triangles =
      read_triangles(document, {instance}, GltfTexcoords::kStored, budget, in_document, {});
  read.mesh = std::move(triangles.mesh);
  for (std::string& text : triangles.losses) {
    if (read.fixed.empty()) warn(warnings, std::move(text));
  }
  if (read.mesh.faces.rows() == 0) read.fixed = "it has no triangles";
  if (read.fixed.empty()) {
    const std::int64_t num_vertices = read.mesh.vertices.rows();
    read.deformation = read_deformation(document, triangles.owners, num_vertices, budget);
    read.more_texcoords = read_more_texcoords(document, triangles.owners, num_vertices, budget);
    read.alphas =
        read_alphas(document, place.member("primitives"), triangles.owners, num_vertices, budget);
  }
  return read;
}

}  // namespace

Scene parse_gltf_scene(std::span<const std::byte> data, const GltfResource& resource,
                       GltfBudget budget, const Progress& progress, const DracoDecoder& draco) {
  GltfDocument document(data, resource, budget);
  Scene scene;
  check_gltf_asset(document, is_kept_extension, scene.warnings);
  const std::int64_t num_meshes = document.count("meshes");
  document.expand_draco(draco, std::vector<bool>(num_meshes, true));
  GltfNodes nodes(document, budget);
  scene.nodes = nodes.scene_nodes();
  GltfKept kept{std::vector<bool>(num_meshes, false), std::vector<bool>(num_meshes, false),
                nodes.shown()};
  const std::vector<MeshUse> uses = uses_of_meshes(document, scene.nodes, kept.nodes);
  for (std::int64_t m = 0; m < num_meshes; ++m) {
    const JsonPlace place = mesh_place(document, m);
    scene.meshes.push_back(
        read_scene_mesh(document, m, reason_to_keep(place, uses[m]), budget, scene.warnings));
    const bool is_replaced = scene.meshes.back().fixed.empty();
    const JsonPlace primitives = place.member("primitives");
    for (std::int64_t i = 0; is_replaced && i < primitives.size(); ++i) {
      if (has_triangles(primitives.item(i))) {
        warn_of_losses(document, primitives.item(i), scene.warnings);
      }
    }
    kept.meshes[m] = !is_replaced && uses[m].is_shown;
    kept.replaced[m] = is_replaced;
    if (progress) progress(static_cast<double>(m + 1) / static_cast<double>(num_meshes));
  }
  scene.materials = read_scene_materials(document, budget);
  GltfScene shell = read_gltf_shell(document, kept, resource, budget, scene.warnings);
  constexpr auto kReplace = nlohmann::ordered_json::error_handler_t::replace;
  scene.document = shell.json.dump(-1, ' ', false, kReplace);
  scene.buffer = std::move(shell.buffer);
  return scene;
}

}  // namespace manip3d
