#include "io/gltf.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <set>
#include <string_view>
#include <tuple>
#include <utility>

#include "io/colors.hpp"
#include "io/formats.hpp"
#include "io/gltf_deformation.hpp"
#include "io/gltf_document.hpp"
#include "io/gltf_scene.hpp"
#include "io/gltf_shell.hpp"
#include "io/warnings.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

// Memory that a mesh may take without `max_bytes`: the larger of kFreeBytes and kFreeRatio times
// the stored bytes of the file, of which compressed ones count five times.
constexpr std::int64_t kFreeBytes = std::int64_t{64} << 20;
constexpr std::int64_t kFreeRatio = 100;

struct Transform {
  Eigen::Matrix3d linear = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  Transform operator*(const Transform& child) const {
    return {linear * child.linear, linear * child.translation + translation};
  }
  [[nodiscard]] bool mirrors() const { return linear.determinant() < 0.0; }
};

constexpr const char* kTextureTransform = "KHR_texture_transform";

/// offset, rotation (radians) and scale of KHR_texture_transform: glTF's (u, v) becomes
/// offset + R (scale * (u, v)), R counter-clockwise as seen, where v points down.
struct TextureTransform {
  std::int64_t set = 0;  ///< The TEXCOORD that it transforms.
  std::array<double, 2> offset = {0.0, 0.0};
  double rotation = 0.0;
  std::array<double, 2> scale = {1.0, 1.0};

  auto operator<=>(const TextureTransform&) const = default;

  [[nodiscard]] Eigen::RowVector2d operator()(double u, double v) const {
    const double su = scale[0] * u, sv = scale[1] * v;
    const double c = std::cos(rotation), s = std::sin(rotation);
    return {offset[0] + c * su + s * sv, offset[1] - s * su + c * sv};
  }
};

/// The morph targets that change an attribute: accessors whose rows are added to those of the
/// attribute, each times its weight, which is not zero.
using Morph = std::vector<std::pair<const GltfAccessor*, double>>;

/// The accessors of one primitive; null where it has none.
struct Primitive {
  JsonPlace place;
  const GltfAccessor* position = nullptr;
  const GltfAccessor* normal = nullptr;
  const GltfAccessor* texcoord = nullptr;
  const GltfAccessor* color = nullptr;
  const GltfAccessor* indices = nullptr;
  std::vector<const GltfAccessor*> more_texcoords = {};  ///< TEXCOORD_1, ...; of scenes, if read.
  std::optional<JsonPlace> targets = std::nullopt;
  TextureTransform texture = {};
  std::int32_t material = -1;
  std::int64_t mode = kModeTriangles;

  [[nodiscard]] std::int64_t num_corners() const {
    return indices != nullptr ? indices->count : position->count;
  }
  [[nodiscard]] std::int64_t num_faces() const {
    return mode == kModeTriangles ? num_corners() / 3
                                  : std::max<std::int64_t>(num_corners() - 2, 0);
  }
};

/// The joints of a skin, and what takes the coordinates of a mesh to those of each.
struct Skin {
  std::vector<std::int64_t> joints;
  std::vector<Transform> inverse_binds;
};

struct Instance {
  std::int64_t mesh;
  Transform transform;
  std::optional<JsonPlace> weights;  ///< Weights of the morph targets; null: all are zero.
  /// Places of the mesh by each joint of a skin; null: no skin.
  const std::vector<Transform>* joints = nullptr;
};

/// One primitive of one instance, and the rows of the mesh's tables where its elements start.
/// Primitives that share an accessor share its rows: the first of them owns the rows and fills
/// them.
struct Draw {
  const Primitive* primitive;
  const Transform* transform;
  std::int64_t first_vertex = 0;
  std::int64_t first_texcoord = 0;
  std::int64_t first_normal = 0;
  std::int64_t first_face = 0;
  bool owns_vertices = false;
  bool owns_texcoords = false;
  bool owns_normals = false;
  const std::vector<Transform>* joints = nullptr;
  Morph vertex_morph = {};
  Morph normal_morph = {};
};

template <int N>
Eigen::Matrix<double, N, 1> numbers(const JsonPlace& place) {
  if (place.size() != N) place.fail("expected " + std::to_string(N) + " numbers");
  Eigen::Matrix<double, N, 1> values;
  for (int i = 0; i < N; ++i) values[i] = place.item(i).number();
  return values;
}

Transform matrix_transform(const JsonPlace& place) {
  const Eigen::Matrix<double, 16, 1> columns = numbers<16>(place);
  const Eigen::Matrix4d m = Eigen::Map<const Eigen::Matrix4d>(columns.data());
  if (m.row(3) != Eigen::RowVector4d(0, 0, 0, 1)) place.fail("expected 0 0 0 1 as the last row");
  return {m.topLeftCorner<3, 3>(), m.topRightCorner<3, 1>()};
}

Eigen::Matrix4d matrix_of(const Transform& transform) {
  Eigen::Matrix4d matrix = Eigen::Matrix4d::Identity();
  matrix.topLeftCorner<3, 3>() = transform.linear;
  matrix.topRightCorner<3, 1>() = transform.translation;
  return matrix;
}

/// The rotation of a quaternion x, y, z, w. Files are not exact: it is normalised first.
/// @param place  says where the quaternion is from, in the error for one that has no direction.
Eigen::Matrix3d rotation_of(const Eigen::Vector4d& xyzw, const JsonPlace& place) {
  const double length = xyzw.norm();
  if (!(length > 0.0 && std::isfinite(length))) {
    place.fail(std::string("expected a unit quaternion, got ") +
               (length > 0.0 ? "one without a finite length" : "zero"));
  }
  return Eigen::Quaterniond(xyzw.normalized()).toRotationMatrix();
}

Transform node_transform(const JsonPlace& node) {
  if (const auto matrix = node.find("matrix")) return matrix_transform(*matrix);
  Transform transform;
  if (const auto rotation = node.find("rotation")) {
    transform.linear = rotation_of(numbers<4>(*rotation), *rotation);
  }
  if (const auto scale = node.find("scale")) {
    transform.linear = transform.linear * numbers<3>(*scale).asDiagonal();
  }
  if (const auto translation = node.find("translation")) {
    transform.translation = numbers<3>(*translation);
  }
  return transform;
}

constexpr const char* kInstancing = "EXT_mesh_gpu_instancing";

class Reader {
 public:
  Reader(ByteSpan data, const GltfResource& resource, GltfBudget& budget, const DracoDecoder& draco)
      : budget_(budget), document_(data, resource, budget), draco_(draco) {}

  ReadResult read(const Progress& progress) {
    check_asset();
    collect_instances();
    expand_shown_meshes();
    plan_draws();
    allocate();
    fill(progress);
    read_materials();
    result_.num_polygons = num_faces_;
    return std::move(result_);
  }

  Scene read_scene(const GltfResource& resource, const Progress& progress) {
    is_scene_ = true;
    check_asset();
    document_.expand_draco(draco_, std::vector<bool>(document_.count("meshes"), true));
    Scene scene;
    scene.nodes = read_nodes();
    const std::vector<bool> is_shown = shown_nodes();
    const std::vector<MeshUse> uses = uses_of_meshes(scene.nodes, is_shown);
    const std::int64_t num_meshes = document_.count("meshes");
    GltfKept kept{std::vector<bool>(num_meshes, false), std::vector<bool>(num_meshes, false),
                  is_shown};
    for (std::int64_t m = 0; m < num_meshes; ++m) {
      scene.meshes.push_back(read_mesh_of_scene(m, reason_to_keep(m, uses[m])));
      SceneMesh& mesh = scene.meshes.back();
      if (mesh.fixed.empty()) warn_of_losses(m);
      kept.meshes[m] = !mesh.fixed.empty() && uses[m].is_shown;
      kept.replaced[m] = mesh.fixed.empty();
      if (progress) progress(static_cast<double>(m + 1) / static_cast<double>(num_meshes));
    }
    scene.materials = scene_materials();
    scene.warnings = std::move(result_.warnings);
    GltfScene shell = read_gltf_shell(document_, kept, resource, budget_, scene.warnings);
    constexpr auto kReplace = nlohmann::ordered_json::error_handler_t::replace;
    scene.document = shell.json.dump(-1, ' ', false, kReplace);
    scene.buffer = std::move(shell.buffer);
    return scene;
  }

 private:
  /// Each warning once, however often there is cause for it.
  // --- Version and extensions --------------------------------------------------------------

  void check_asset() {
    const JsonPlace version = document_.root().member("asset").member("version");
    if (!version.text().starts_with("2.")) {
      version.fail("expected glTF 2.x, got version " + version.text());
    }
    check_extensions();
    if (document_.place_meshes_without_nodes()) {
      warn(result_.warnings,
           "the file has no nodes: all its meshes are read, where their vertices are");
    }
    if (is_scene_) return;
    if (document_.count("animations") > 0) warn(result_.warnings, "animations are left out");
    if (document_.count("skins") > 0)
      warn(result_.warnings, "skins are left out: meshes have the pose of their joints");
  }

  void check_extensions() {
    // These extensions change how a mesh looks, not where it is: it is read without them, even if
    // the file requires them.
    constexpr std::array<std::string_view, 7> kLooks = {
        "EXT_texture_avif",     "EXT_texture_webp",   "KHR_lights_punctual", "KHR_technique_webgl",
        "KHR_techniques_webgl", "KHR_texture_basisu", "MSFT_texture_dds"};
    const auto appearance = [&](const std::string& name) {
      return name.starts_with("KHR_materials_") ||
             std::find(kLooks.begin(), kLooks.end(), name) != kLooks.end();
    };
    const auto is_known = [this](const std::string& name) {
      return name == "KHR_mesh_quantization" || name == kTextureTransform || name == kInstancing ||
             name == kEmissiveStrength || name == kDraco || is_meshopt_extension(name) ||
             (is_scene_ && is_kept_extension(name));
    };
    if (const auto required = document_.root().find("extensionsRequired")) {
      for (std::int64_t i = 0; i < required->size(); ++i) {
        const std::string& name = required->item(i).text();
        if (!is_known(name) && !appearance(name)) {
          required->item(i).fail("the file requires the extension " + name + ", which is not read");
        }
      }
    }
    if (const auto used = document_.root().find("extensionsUsed")) {
      for (std::int64_t i = 0; i < used->size(); ++i) {
        const std::string& name = used->item(i).text();
        if (!is_known(name)) warn(result_.warnings, "extension " + name + " is left out");
      }
    }
  }

  // --- Nodes -----------------------------------------------------------------------------

  /// Children of every node; each node has at most one parent and none is its own ancestor.
  std::vector<std::vector<std::int64_t>> read_forest(std::vector<bool>& has_parent) const {
    const std::int64_t num_nodes = document_.count("nodes");
    std::vector<std::vector<std::int64_t>> children(num_nodes);
    has_parent.assign(children.size(), false);
    for (std::int64_t n = 0; n < num_nodes; ++n) {
      const auto list = node(n).find("children");
      if (!list) continue;
      for (std::int64_t i = 0; i < list->size(); ++i) {
        const std::int64_t child = list->item(i).integer(0, num_nodes - 1);
        if (has_parent[child]) {
          list->item(i).fail("node " + std::to_string(child) + " has two parents");
        }
        has_parent[child] = true;
        children[n].push_back(child);
      }
    }
    check_acyclic(children, has_parent);
    return children;
  }

  /// With at most one parent each, a node is in or below a cycle unless a root reaches it.
  void check_acyclic(const std::vector<std::vector<std::int64_t>>& children,
                     const std::vector<bool>& has_parent) const {
    std::vector<std::int64_t> stack;
    std::vector<bool> reached(children.size(), false);
    for (std::size_t n = 0; n < children.size(); ++n) {
      if (!has_parent[n]) stack.push_back(static_cast<std::int64_t>(n));
    }
    while (!stack.empty()) {
      const std::size_t n = stack.back();
      stack.pop_back();
      reached[n] = true;
      stack.insert(stack.end(), children[n].begin(), children[n].end());
    }
    const auto lost = std::find(reached.begin(), reached.end(), false);
    if (lost != reached.end()) node(lost - reached.begin()).fail("the nodes form a cycle");
  }

  [[nodiscard]] JsonPlace node(std::int64_t index) const {
    return document_.root().member("nodes").item(index);
  }

  /// Roots of the default scene, else of the first scene, else all nodes without a parent.
  std::vector<std::int64_t> scene_roots(const std::vector<bool>& has_parent) const {
    if (document_.count("scenes") == 0) {
      std::vector<std::int64_t> roots;
      for (std::size_t n = 0; n < has_parent.size(); ++n) {
        if (!has_parent[n]) roots.push_back(static_cast<std::int64_t>(n));
      }
      return roots;
    }
    const auto chosen = document_.root().find("scene");
    return roots_of(
        chosen ? document_.object("scenes", *chosen) : document_.root().member("scenes").item(0),
        has_parent);
  }

  static std::vector<std::int64_t> roots_of(const JsonPlace& scene,
                                            const std::vector<bool>& has_parent) {
    std::vector<std::int64_t> roots;
    const auto list = scene.find("nodes");
    std::set<std::int64_t> listed;  // as large as the list: there may be as many scenes as nodes
    for (std::int64_t i = 0; list && i < list->size(); ++i) {
      const JsonPlace place = list->item(i);
      const std::int64_t n = place.integer(0, std::ssize(has_parent) - 1);
      if (has_parent[n]) place.fail("the root of a scene has a parent");
      if (!listed.insert(n).second) place.fail("node " + std::to_string(n) + " is listed twice");
      roots.push_back(n);
    }
    return roots;
  }

  void collect_instances() {
    std::vector<bool> has_parent;
    const auto children = read_forest(has_parent);
    struct Visit {
      std::int64_t node;
      Transform parent;
    };
    std::vector<Visit> stack;
    const auto push_reversed = [&](const std::vector<std::int64_t>& nodes, const Transform& t) {
      for (auto n = nodes.rbegin(); n != nodes.rend(); ++n) stack.push_back({*n, t});
    };
    push_reversed(scene_roots(has_parent), {});
    while (!stack.empty()) {
      const Visit visit = stack.back();
      stack.pop_back();
      const JsonPlace place = node(visit.node);
      const Transform world = visit.parent * node_transform(place);
      if (const auto mesh = place.find("mesh")) {
        const auto skin = place.find("skin");
        const auto* joints = skin ? &places_of_joints(*skin, children) : nullptr;
        const Transform& shown = joints != nullptr ? joints->front() : world;
        auto weights = place.find("weights");  // they replace those of the mesh
        if (!weights) weights = document_.object("meshes", *mesh).find("weights");
        const std::int64_t index = mesh->integer(0, document_.count("meshes") - 1);
        const auto placed = gpu_instances(place);
        if (!placed) instances_.push_back({index, shown, std::move(weights), joints});
        for (std::size_t i = 0; placed && i < placed->size(); ++i) {
          instances_.push_back({index, world * (*placed)[i], weights});
        }
      }
      push_reversed(children[visit.node], world);
    }
  }

  /// Places of a mesh by each joint of a skin. glTF places it by them, and not by the node that
  /// shows it.
  const std::vector<Transform>& places_of_joints(
      const JsonPlace& user, const std::vector<std::vector<std::int64_t>>& children) {
    const Skin& skin = read_skin(user);
    std::vector<Transform>& places = places_of_joints_[&skin];
    for (std::size_t i = places.size(); i < skin.joints.size(); ++i) {
      places.push_back(world_of(skin.joints[i], children) * skin.inverse_binds[i]);
    }
    return places;
  }

  /// From the coordinates of a node into those of the scene; each node is looked at once.
  Transform world_of(std::int64_t node_index,
                     const std::vector<std::vector<std::int64_t>>& children) {
    if (parents_.empty()) {
      parents_.assign(children.size(), -1);
      for (std::size_t n = 0; n < children.size(); ++n) {
        for (const std::int64_t child : children[n]) parents_[child] = static_cast<std::int64_t>(n);
      }
    }
    std::vector<std::int64_t> path;
    for (std::int64_t n = node_index; n >= 0 && !worlds_.contains(n); n = parents_[n]) {
      path.push_back(n);
    }
    for (auto n = path.rbegin(); n != path.rend(); ++n) {
      const Transform own = node_transform(node(*n));
      worlds_[*n] = parents_[*n] < 0 ? own : worlds_.at(parents_[*n]) * own;
    }
    return worlds_.at(node_index);
  }

  /// Places of a node's mesh by EXT_mesh_gpu_instancing, in the node's coordinates; null: once, at
  /// the node itself.
  std::optional<std::vector<Transform>> gpu_instances(const JsonPlace& node) {
    const auto extensions = node.find("extensions");
    const auto instancing = extensions ? extensions->find(kInstancing) : std::nullopt;
    if (!instancing) return std::nullopt;
    const JsonPlace attributes = instancing->member("attributes");
    const GltfAccessor* translation = attribute(attributes, "TRANSLATION", 3, 3);
    const GltfAccessor* rotation = attribute(attributes, "ROTATION", 4, 4);
    const GltfAccessor* scale = attribute(attributes, "SCALE", 3, 3);
    const GltfAccessor* first = translation ? translation : rotation ? rotation : scale;
    if (first == nullptr) return std::nullopt;
    for (const GltfAccessor* other : {rotation, scale}) {
      if (other != nullptr && other->count != first->count) {
        other->place.fail("has " + std::to_string(other->count) + " elements, another of " +
                          attributes.pointer() + " " + std::to_string(first->count));
      }
    }
    constexpr std::int64_t kNumbers = 3 + 4 + 3;  // of a translation, a rotation and a scale
    charge(first->count, sizeof(Transform) + sizeof(Instance) + kNumbers * sizeof(double),
           attributes.pointer());
    std::vector<Transform> placed(first->count);
    const auto rows_of = [](const GltfAccessor* accessor) {
      std::vector<double> rows(accessor ? accessor->count * accessor->num_components : 0);
      if (accessor != nullptr) accessor->decode(rows.data());
      return rows;
    };
    const std::vector<double> translations = rows_of(translation), rotations = rows_of(rotation),
                              scales = rows_of(scale);
    for (std::size_t i = 0; i < placed.size(); ++i) {
      if (rotation != nullptr) {
        const Eigen::Map<const Eigen::Vector4d> xyzw(rotations.data() + 4 * i);
        placed[i].linear = rotation_of(xyzw, rotation->place);
      }
      if (scale != nullptr) {
        const Eigen::Map<const Eigen::Vector3d> factors(scales.data() + 3 * i);
        placed[i].linear = placed[i].linear * factors.asDiagonal();
      }
      if (translation != nullptr) {
        placed[i].translation = Eigen::Map<const Eigen::Vector3d>(translations.data() + 3 * i);
      }
    }
    return placed;
  }

  /// A damaged stream of a mesh that no node shows does no harm.
  void expand_shown_meshes() {
    std::vector<bool> is_shown(document_.count("meshes"), false);
    for (const auto& instance : instances_) is_shown[instance.mesh] = true;
    document_.expand_draco(draco_, is_shown);
  }

  // --- Scenes ----------------------------------------------------------------------------

  /// Marks these nodes and all below them. What hangs on a marked node is marked already: however
  /// many scenes show a node, it is visited once.
  static void mark(std::vector<std::int64_t> stack,
                   const std::vector<std::vector<std::int64_t>>& children,
                   std::vector<bool>& marked) {
    while (!stack.empty()) {
      const std::size_t n = stack.back();
      stack.pop_back();
      if (marked[n]) continue;
      marked[n] = true;
      stack.insert(stack.end(), children[n].begin(), children[n].end());
    }
  }

  std::vector<SceneNode> read_nodes() {
    std::vector<bool> has_parent;
    const auto children = read_forest(has_parent);
    std::vector<bool> is_drawn(children.size(), false);
    mark(scene_roots(has_parent), children, is_drawn);
    std::vector<SceneNode> nodes(children.size());
    for (std::size_t n = 0; n < nodes.size(); ++n) {
      const JsonPlace place = node(static_cast<std::int64_t>(n));
      if (const auto name = place.find("name")) nodes[n].name = name->text();
      if (const auto mesh = place.find("mesh")) {
        static_cast<void>(document_.object("meshes", *mesh));  // checks the index
        nodes[n].mesh = static_cast<std::int32_t>(mesh->integer(0, document_.count("meshes") - 1));
      }
      const auto skin = place.find("skin");
      if (skin && nodes[n].mesh >= 0) {
        const Skin& read = read_skin(*skin);
        nodes[n].joint = static_cast<std::int32_t>(read.joints.front());
        nodes[n].inverse_bind = matrix_of(read.inverse_binds.front());
      }
      nodes[n].transform = matrix_of(node_transform(place));
      if (const auto placed = gpu_instances(place); placed && nodes[n].mesh >= 0) {
        nodes[n].instances.emplace();
        for (const Transform& transform : *placed) {
          nodes[n].instances->push_back(matrix_of(transform));
        }
      }
      nodes[n].is_drawn = is_drawn[n];
      for (const std::int64_t child : children[n]) {
        nodes[child].parent = static_cast<std::int32_t>(n);
      }
    }
    return nodes;
  }

  const Skin& read_skin(const JsonPlace& user) {
    const JsonPlace place = document_.object("skins", user);
    const auto [known, is_new] = skins_.try_emplace(place.pointer());
    Skin& skin = known->second;
    if (!is_new) return skin;
    const JsonPlace joints = place.member("joints");
    if (joints.size() == 0) joints.fail("expected at least one joint");
    charge(joints.size(), 2 * sizeof(Transform) + sizeof(std::int64_t), joints.pointer());
    for (std::int64_t i = 0; i < joints.size(); ++i) {
      skin.joints.push_back(joints.item(i).integer(0, document_.count("nodes") - 1));
    }
    skin.inverse_binds.resize(skin.joints.size());
    if (const GltfAccessor* given = attribute(place, "inverseBindMatrices", 16, 16)) {
      if (given->count < joints.size()) {
        given->place.fail("expected a matrix for each of " + std::to_string(joints.size()) +
                          " joints, got " + std::to_string(given->count));
      }
      charge(given->count, 16 * sizeof(double), given->place.pointer());
      std::vector<double> matrices(16 * given->count);
      given->decode(matrices.data());
      for (std::size_t i = 0; i < skin.joints.size(); ++i) {
        const Eigen::Map<const Eigen::Matrix4d> matrix(matrices.data() + 16 * i);
        skin.inverse_binds[i] = {matrix.topLeftCorner<3, 3>(), matrix.topRightCorner<3, 1>()};
      }
    }
    return skin;
  }

  /// Nodes that are part of any scene.
  std::vector<bool> shown_nodes() const {
    std::vector<bool> has_parent;
    const auto children = read_forest(has_parent);
    std::vector<bool> is_shown(children.size(), false);
    if (document_.count("scenes") == 0) mark(scene_roots(has_parent), children, is_shown);
    for (std::int64_t i = 0; i < document_.count("scenes"); ++i) {
      mark(roots_of(document_.root().member("scenes").item(i), has_parent), children, is_shown);
    }
    return is_shown;
  }

  /// The nodes that refer to a mesh, taken together.
  struct MeshUse {
    bool is_drawn = false;  ///< The default scene shows one of them.
    bool is_shown = false;  ///< Some scene does.
    bool has_skin = false;
  };

  /// By mesh. One pass over the nodes: there may be as many meshes as nodes.
  [[nodiscard]] std::vector<MeshUse> uses_of_meshes(const std::vector<SceneNode>& nodes,
                                                    const std::vector<bool>& is_shown) const {
    std::vector<MeshUse> uses(document_.count("meshes"));
    for (std::size_t n = 0; n < nodes.size(); ++n) {
      if (nodes[n].mesh < 0) continue;
      MeshUse& use = uses[nodes[n].mesh];
      use.is_drawn = use.is_drawn || nodes[n].is_drawn;
      use.is_shown = use.is_shown || is_shown[n];
      use.has_skin = use.has_skin || node(static_cast<std::int64_t>(n)).has("skin");
    }
    return uses;
  }

  SceneMesh read_mesh_of_scene(std::int64_t index, std::string fixed) {
    SceneMesh mesh;
    mesh.fixed = std::move(fixed);
    const JsonPlace place = document_.root().member("meshes").item(index);
    if (const auto name = place.find("name")) mesh.name = name->text();
    mesh_ = TriangleMesh();
    draws_.clear();
    texcoord_rows_.clear();
    num_vertices_ = num_texcoords_ = num_normals_ = num_faces_ = 0;
    with_colors_ = false;
    // The morph targets of a mesh that may be replaced are added to it again when it is shown.
    instances_ = {{index, Transform(), mesh.fixed.empty() ? std::nullopt : place.find("weights")}};
    plan_draws();
    allocate();
    fill({});
    if (num_faces_ == 0) mesh.fixed = "it has no triangles";
    if (mesh.fixed.empty()) {
      mesh.deformation = deformation_of_draws();
      mesh.more_texcoords = more_texcoords_of_draws();
    }
    mesh.mesh = std::move(mesh_);
    return mesh;
  }

  Deformation deformation_of_draws() {
    std::vector<PlacedPrimitive> placed;
    for (const Draw& draw : draws_) {
      if (!draw.owns_vertices) continue;
      placed.push_back({draw.primitive->place, draw.first_vertex, draw.primitive->position->count});
    }
    return read_deformation(document_, placed, num_vertices_, budget_);
  }

  MoreTexcoords more_texcoords_of_draws() {
    MoreTexcoords more;
    for (const Draw& draw : draws_) {
      more.num_sets = std::max(more.num_sets, std::ssize(draw.primitive->more_texcoords));
    }
    if (more.num_sets == 0) return more;
    const std::int64_t width = 2 * more.num_sets;
    charge(num_vertices_, width * static_cast<std::int64_t>(sizeof(float)), "meshes");
    more.values.assign(num_vertices_ * width, std::numeric_limits<float>::quiet_NaN());
    for (const Draw& draw : draws_) {
      if (!draw.owns_vertices) continue;
      const auto& sets = draw.primitive->more_texcoords;
      for (std::size_t set = 0; set < sets.size(); ++set) {
        charge(sets[set]->count, 2 * sizeof(double), sets[set]->place.pointer());
        std::vector<double> values(2 * sets[set]->count);
        sets[set]->decode(values.data());
        for (std::int64_t i = 0; i < std::ssize(values); ++i) {
          more.values[(draw.first_vertex + i / 2) * width + 2 * set + i % 2] =
              static_cast<float>(values[i]);
        }
      }
    }
    return more;
  }

  /// Why a mesh must stay as it is in the file: a TriangleMesh in its place would lose something
  /// that the scene needs. Empty: it can be replaced.
  [[nodiscard]] std::string reason_to_keep(std::int64_t mesh, const MeshUse& use) const {
    if (!use.is_drawn) return "the default scene does not show it";
    const JsonPlace list = document_.root().member("meshes").item(mesh).member("primitives");
    for (std::int64_t i = 0; i < list.size(); ++i) {
      const JsonPlace place = list.item(i);
      const JsonPlace attributes = place.member("attributes");
      if (!attributes.has("POSITION")) return "it has primitives without POSITION";
    }
    return reason_not_to_deform(list, use.has_skin);
  }

  /// Names what a replaced mesh loses.
  void warn_of_losses(std::int64_t mesh) {
    constexpr std::array<std::string_view, 4> kHeld = {"POSITION", "NORMAL", "TEXCOORD_0",
                                                       "COLOR_0"};
    const JsonPlace list = document_.root().member("meshes").item(mesh).member("primitives");
    for (std::int64_t i = 0; i < list.size(); ++i) {
      const JsonPlace place = list.item(i);
      if (!has_triangles(place)) continue;
      const JsonPlace attributes = place.member("attributes");
      const bool keeps_more = reads_more_texcoords(place);
      for (const auto& [name, accessor] : attributes.value().items()) {
        const bool is_held = name.starts_with("JOINTS_") || name.starts_with("WEIGHTS_") ||
                             (keeps_more && is_more_texcoords(attributes, name)) ||
                             std::find(kHeld.begin(), kHeld.end(), name) != kHeld.end();
        if (is_held) continue;
        std::string why;
        if (name == "TANGENT") why = ": viewers compute it from the texture coordinates";
        if (name.starts_with("TEXCOORD_") && !keeps_more) why = ": no texture reads it";
        warn(result_.warnings, name + " of meshes that are simplified is left out" + why);
      }
      const auto color = attributes.find("COLOR_0");
      if (color && document_.accessor(*color).num_components == 4) {
        warn(result_.warnings, "alpha of vertex colours of meshes that are simplified is left out");
      }
      if (place.has("extras")) {
        warn(result_.warnings, "extras of primitives that are simplified are left out");
      }
      const auto extensions = place.find("extensions");
      if (!extensions) continue;
      for (const auto& [name, content] : extensions->value().items()) {
        if (name == kVariants) continue;
        warn(result_.warnings, "extensions of primitives that are simplified are left out");
      }
    }
  }

  /// Whether a texture of a primitive is placed by another set of coordinates than the first, in
  /// one of its materials. Sets that no texture reads are left out: their seams would cost faces.
  [[nodiscard]] bool reads_more_texcoords(const JsonPlace& primitive) const {
    const auto needs = [this](const std::optional<JsonPlace>& material) {
      return material && needs_more_texcoords(document_.object("materials", *material).value());
    };
    if (needs(primitive.find("material"))) return true;
    const auto extensions = primitive.find("extensions");
    const auto variants = extensions ? extensions->find(kVariants) : std::nullopt;
    const auto mappings = variants ? variants->find("mappings") : std::nullopt;
    for (std::int64_t i = 0; mappings && i < mappings->size(); ++i) {
      if (needs(mappings->item(i).find("material"))) return true;
    }
    return false;
  }

  /// Whether a material's texture is placed by another set of coordinates than the first.
  static bool needs_more_texcoords(const JsonPlace::Json& value) {
    if (!value.is_structured()) return false;
    if (value.is_object()) {
      const auto set = value.find("texCoord");
      if (set != value.end() && set->is_number() && set->get<double>() != 0.0) return true;
    }
    return std::any_of(value.begin(), value.end(), needs_more_texcoords);
  }

  /// Whether an attribute is one of TEXCOORD_1, TEXCOORD_2, ... up to the first that is missing.
  static bool is_more_texcoords(const JsonPlace& attributes, const std::string& name) {
    for (int set = 1; attributes.has(texcoords_in_set(set).c_str()); ++set) {
      if (name == texcoords_in_set(set)) return true;
    }
    return false;
  }

  /// All materials of the file, by their index there; what they lack stays in the document.
  std::vector<Material> scene_materials() {
    const std::size_t num_warnings = result_.warnings.size();
    std::vector<Material> materials;
    for (std::int64_t i = 0; i < document_.count("materials"); ++i) {
      materials.push_back(read_material(document_.root().member("materials").item(i)));
    }
    result_.warnings.resize(num_warnings);
    return materials;
  }

  // --- Primitives ------------------------------------------------------------------------

  const GltfAccessor* attribute(const JsonPlace& attributes, const char* name, int fewest,
                                int most) {
    const auto user = attributes.find(name);
    if (!user) return nullptr;
    const GltfAccessor& accessor = document_.accessor(*user);
    if (accessor.num_components < fewest || accessor.num_components > most) {
      accessor.place.fail(std::string("the type does not suit ") + name);
    }
    return &accessor;
  }

  std::optional<Primitive> read_primitive(const JsonPlace& place) {
    Primitive p{.place = place};
    if (const auto mode = place.find("mode")) p.mode = mode->integer(0, kModeTriangleFan);
    if (p.mode < kModeTriangles) {
      if (!is_scene_) warn(result_.warnings, "points and lines are left out");
      return std::nullopt;
    }
    p.targets = place.find("targets");
    const JsonPlace attributes = place.member("attributes");
    if (!is_scene_ && attributes.has("TANGENT")) warn(result_.warnings, "tangents are left out");
    p.position = attribute(attributes, "POSITION", 3, 3);
    if (p.position == nullptr) {
      if (!is_scene_) warn(result_.warnings, "primitives without POSITION are left out");
      return std::nullopt;
    }
    p.normal = attribute(attributes, "NORMAL", 3, 3);
    if (const auto material = place.find("material")) {
      static_cast<void>(document_.object("materials", *material));  // checks the index
      p.material = static_cast<std::int32_t>(material->integer(0, (std::int64_t{1} << 31) - 1));
      if (!is_scene_) p.texture = texture_transform(document_.object("materials", *material));
    }
    p.texcoord = attribute(attributes, texcoords_in_set(p.texture.set).c_str(), 2, 2);
    p.color = attribute(attributes, "COLOR_0", 3, 4);
    std::vector<const GltfAccessor*> others = {p.normal, p.texcoord, p.color};
    const bool keeps_more = is_scene_ && reads_more_texcoords(place);
    while (keeps_more) {
      const std::string name = texcoords_in_set(std::ssize(p.more_texcoords) + 1);
      const GltfAccessor* more = attribute(attributes, name.c_str(), 2, 2);
      if (more == nullptr) break;
      p.more_texcoords.push_back(more);
      others.push_back(more);
    }
    for (const GltfAccessor* other : others) {
      if (other != nullptr && other->count != p.position->count) {
        other->place.fail("has " + std::to_string(other->count) + " elements, POSITION of " +
                          p.place.pointer() + " " + std::to_string(p.position->count));
      }
    }
    if (const auto indices = place.find("indices")) {
      p.indices = &document_.accessor(*indices);
      p.indices->check_indices();
    }
    if (p.mode == kModeTriangles && p.num_corners() % 3 != 0) {
      place.fail(std::to_string(p.num_corners()) + " corners do not make whole triangles");
    }
    return p;
  }

  static std::string texcoords_in_set(std::int64_t set) {
    return "TEXCOORD_" + std::to_string(set);
  }

  /// The transform of a material's first texture. A TriangleMesh has no place for it, so it is
  /// applied to the texture coordinates. Textures of the material with another transform are left
  /// out.
  static TextureTransform texture_transform(const JsonPlace& material) {
    if (const auto pbr = material.find("pbrMetallicRoughness")) {
      for (const char* key : {"baseColorTexture", "metallicRoughnessTexture"}) {
        if (const auto placed = placement(*pbr, key)) return *placed;
      }
    }
    for (const char* key : {"normalTexture", "occlusionTexture", "emissiveTexture"}) {
      if (const auto placed = placement(material, key)) return *placed;
    }
    return {};
  }

  /// The set of texture coordinates that a texture uses, and how it transforms them; null without
  /// a texture.
  static std::optional<TextureTransform> placement(const JsonPlace& owner, const char* key) {
    const auto info = owner.find(key);
    if (!info) return std::nullopt;
    const auto extensions = info->find("extensions");
    const auto given = extensions ? extensions->find(kTextureTransform) : std::nullopt;
    auto set = given ? given->find("texCoord") : std::nullopt;  // replaces the texture's own
    if (!set) set = info->find("texCoord");
    TextureTransform transform = given ? read_texture_transform(*given) : TextureTransform();
    if (set) transform.set = set->integer(0, 255);
    return transform;
  }

  static TextureTransform read_texture_transform(const JsonPlace& place) {
    TextureTransform transform;
    if (const auto offset = place.find("offset")) {
      Eigen::Map<Eigen::Vector2d>(transform.offset.data()) = numbers<2>(*offset);
    }
    if (const auto rotation = place.find("rotation")) transform.rotation = rotation->number();
    if (const auto scale = place.find("scale")) {
      Eigen::Map<Eigen::Vector2d>(transform.scale.data()) = numbers<2>(*scale);
    }
    return transform;
  }

  const std::vector<Primitive>& primitives_of(std::int64_t mesh) {
    const auto known = meshes_.find(mesh);
    if (known != meshes_.end()) return known->second;
    const JsonPlace list = document_.root().member("meshes").item(mesh).member("primitives");
    std::vector<Primitive> primitives;
    for (std::int64_t i = 0; i < list.size(); ++i) {
      if (auto primitive = read_primitive(list.item(i))) primitives.push_back(*primitive);
    }
    return meshes_.emplace(mesh, std::move(primitives)).first->second;
  }

  // --- Morph targets ---------------------------------------------------------------------

  /// The default weights of an instance's morph targets; empty: its primitives are as stored.
  std::vector<double> default_weights(const Instance& instance) {
    std::vector<double> weights;
    if (!instance.weights) return weights;
    const std::int64_t size = instance.weights->size();
    charge(size, sizeof(double), instance.weights->pointer());
    for (std::int64_t t = 0; t < size; ++t) {
      weights.push_back(instance.weights->item(t).number());
    }
    const auto is_zero = [](double weight) { return weight == 0.0; };
    if (std::all_of(weights.begin(), weights.end(), is_zero)) weights.clear();
    return weights;
  }

  /// The morph targets that the default shape adds to an attribute of a primitive.
  Morph morph_of(const Primitive& p, const std::vector<double>& weights, const char* name,
                 const GltfAccessor* base) {
    Morph morph;
    if (!p.targets || base == nullptr) return morph;
    const std::int64_t size = std::min<std::int64_t>(p.targets->size(), std::ssize(weights));
    for (std::int64_t t = 0; t < size; ++t) {
      if (weights[t] == 0.0) continue;
      const GltfAccessor* added = attribute(p.targets->item(t), name, 3, 3);
      if (added == nullptr) continue;
      if (added->count != base->count) {
        added->place.fail("has " + std::to_string(added->count) + " elements, " + name + " of " +
                          p.place.pointer() + " " + std::to_string(base->count));
      }
      charge(base->count + 1, kVertexBytes, p.place.pointer());
      morph.emplace_back(added, weights[t]);
    }
    return morph;
  }

  void warn_of_targets(const Primitive& p, const Instance& instance,
                       const std::vector<double>& weights) {
    if (is_scene_ || !p.targets) return;
    if (weights.empty()) return warn(result_.warnings, "morph targets are left out");
    warn(result_.warnings,
         "morph targets are left out; meshes have the shape of their default weights");
    if (p.targets->size() != std::ssize(weights)) {
      warn(result_.warnings,
           instance.weights->pointer() + ": expected " + std::to_string(p.targets->size()) +
               " weights (the morph targets), got " + std::to_string(weights.size()) +
               "; those without a partner are left out");
    }
    const std::int64_t size = std::min<std::int64_t>(p.targets->size(), std::ssize(weights));
    for (std::int64_t t = 0; t < size; ++t) {
      for (const char* name : {"TEXCOORD_0", "COLOR_0"}) {
        if (weights[t] != 0.0 && p.targets->item(t).has(name)) {
          warn(result_.warnings, std::string(name) + " of morph targets is left out");
        }
      }
    }
  }

  /// Adds the morph targets to rows of three numbers.
  static void apply(const Morph& morph, double* rows) {
    for (const auto& [added, weight] : morph) {
      std::vector<double> values(3 * added->count);
      added->decode(values.data());
      for (std::size_t i = 0; i < values.size(); ++i) rows[i] += weight * values[i];
    }
  }

  // --- Sizes, before anything is allocated -------------------------------------------------

  void charge(std::int64_t rows, std::int64_t bytes_per_row, const std::string& who) {
    budget_.charge(rows * bytes_per_row, who);
  }

  void plan_draws() {
    for (const Instance& instance : instances_) {
      for (const Primitive& p : primitives_of(instance.mesh)) {
        charge(1, sizeof(Draw), p.place.pointer());
        with_colors_ = with_colors_ || p.color != nullptr;
      }
    }
    for (const Instance& instance : instances_) plan_instance(instance);
    // A table of three columns then has no more numbers than an int32 counts.
    constexpr std::int64_t kMaxRows = std::numeric_limits<std::int32_t>::max() / 3;
    if (num_vertices_ > kMaxRows || num_faces_ > kMaxRows || num_normals_ > kMaxRows ||
        num_texcoords_ > kMaxRows) {
      throw FormatError::at_byte(
          0, "the scene has more than " + std::to_string(kMaxRows) + " vertices or faces");
    }
  }

  void plan_instance(const Instance& instance) {
    using Key = std::tuple<const GltfAccessor*, const GltfAccessor*, Morph, const GltfAccessor*,
                           std::vector<const GltfAccessor*>>;
    std::map<Key, std::int64_t> vertex_rows;
    std::map<std::tuple<const GltfAccessor*, Morph, const GltfAccessor*>, std::int64_t> normal_rows;
    const std::vector<double> weights = default_weights(instance);
    for (const Primitive& p : primitives_of(instance.mesh)) {
      Draw draw{.primitive = &p, .transform = &instance.transform, .first_face = num_faces_};
      draw.vertex_morph = morph_of(p, weights, "POSITION", p.position);
      draw.normal_morph = morph_of(p, weights, "NORMAL", p.normal);
      warn_of_targets(p, instance, weights);
      const GltfAccessor* moved_by = nullptr;
      if (instance.joints != nullptr) {
        moved_by = attribute(p.place.member("attributes"), "JOINTS_0", 4, 4);
        if (moved_by != nullptr) draw.joints = instance.joints;
      }
      // Gives `key` rows at the end of a table of `count` rows, unless it has some. Returns the
      // first of its rows, and whether they are new.
      const auto claim_rows = [&](auto& rows, const auto& key, std::int64_t& count,
                                  std::int64_t size, std::int64_t bytes) {
        const auto [row, is_new] = rows.try_emplace(key, count);
        if (is_new) {
          charge(size, bytes, p.place.pointer());
          count += size;
        }
        return std::pair(row->second, is_new);
      };
      const std::int64_t size = p.position->count;
      std::tie(draw.first_vertex, draw.owns_vertices) =
          claim_rows(vertex_rows,
                     Key(p.position, with_colors_ ? p.color : nullptr, draw.vertex_morph, moved_by,
                         p.more_texcoords),
                     num_vertices_, size, with_colors_ ? kVertexBytes + kColorBytes : kVertexBytes);
      if (p.texcoord != nullptr) {
        std::tie(draw.first_texcoord, draw.owns_texcoords) = claim_rows(
            texcoord_rows_, std::pair(p.texcoord, p.texture), num_texcoords_, size, kTexcoordBytes);
      }
      if (p.normal != nullptr) {
        std::tie(draw.first_normal, draw.owns_normals) =
            claim_rows(normal_rows, std::tuple(p.normal, draw.normal_morph, moved_by), num_normals_,
                       size, kVertexBytes);
      }
      charge(p.num_corners(), sizeof(std::uint32_t), p.place.pointer());
      charge(p.num_faces(), kFaceBytes, p.place.pointer());
      num_faces_ += p.num_faces();
      draws_.push_back(std::move(draw));
    }
  }

  void allocate() {
    mesh_.vertices.resize(num_vertices_, 3);
    mesh_.faces.resize(num_faces_, 3);
    mesh_.texcoords.resize(num_texcoords_, 2);
    mesh_.normals.resize(num_normals_, 3);
    if (num_texcoords_ > 0) mesh_.face_texcoords.setConstant(num_faces_, 3, -1);
    if (num_normals_ > 0) mesh_.face_normals.setConstant(num_faces_, 3, -1);
    if (with_colors_) mesh_.colors.resize(num_vertices_, 3);
    if (document_.count("materials") > 0) mesh_.face_material.setConstant(num_faces_, -1);
  }

  // --- Values ----------------------------------------------------------------------------

  void fill(const Progress& progress) {
    for (std::size_t i = 0; i < draws_.size(); ++i) {
      const Draw& draw = draws_[i];
      if (draw.owns_vertices) fill_vertices(draw);
      if (draw.owns_vertices && with_colors_) fill_colors(draw);
      if (draw.owns_texcoords) fill_texcoords(draw);
      if (draw.owns_normals) fill_normals(draw);
      fill_faces(draw);
      if (progress) progress(static_cast<double>(i + 1) / static_cast<double>(draws_.size()));
    }
  }

  void fill_vertices(const Draw& draw) {
    const GltfAccessor& accessor = *draw.primitive->position;
    accessor.decode(mesh_.vertices.data() + 3 * draw.first_vertex);
    apply(draw.vertex_morph, mesh_.vertices.data() + 3 * draw.first_vertex);
    const std::vector<Transform> places = places_of_vertices(draw);
    for (std::int64_t i = draw.first_vertex; i < draw.first_vertex + accessor.count; ++i) {
      auto row = mesh_.vertices.row(i);
      const Transform& place = places.empty()
                                   ? *draw.transform
                                   : places[static_cast<std::size_t>(i - draw.first_vertex)];
      row = (place.linear * row.transpose() + place.translation).transpose().eval();
      if (!row.allFinite()) {
        accessor.place.fail("element " + std::to_string(i - draw.first_vertex) +
                            " is not finite after the transform of its node");
      }
    }
  }

  /// Places of each vertex of a draw by the joints of a skin; empty: its node places it.
  std::vector<Transform> places_of_vertices(const Draw& draw) {
    std::vector<Transform> places;
    if (draw.joints == nullptr) return places;
    const JsonPlace& primitive = draw.primitive->place;
    const std::int64_t count = draw.primitive->position->count;
    const Deformation moves = read_influences(document_, primitive, count, budget_);
    charge(count, sizeof(Transform), primitive.pointer());
    places.reserve(count);
    for (std::int64_t i = 0; i < count; ++i) {
      Transform place{Eigen::Matrix3d::Zero(), Eigen::Vector3d::Zero()};
      double total = 0.0;
      for (std::int64_t k = i * moves.num_influences; k < (i + 1) * moves.num_influences; ++k) {
        const double weight = moves.weights[k];
        if (!(weight > 0.0)) continue;
        if (moves.joints[k] >= draw.joints->size()) {
          primitive.fail("vertex " + std::to_string(i) + " has joint " +
                         std::to_string(moves.joints[k]) + " of a skin with " +
                         std::to_string(draw.joints->size()));
        }
        const Transform& joint = (*draw.joints)[moves.joints[k]];
        place.linear += weight * joint.linear;
        place.translation += weight * joint.translation;
        total += weight;
      }
      places.push_back(total > 0.0 ? Transform{place.linear / total, place.translation / total}
                                   : *draw.transform);
    }
    return places;
  }

  /// Linear light to sRGB bytes, IEC 61966-2-1; a primitive without colours is white.
  void fill_colors(const Draw& draw) {
    if (draw.primitive->color == nullptr) {
      mesh_.colors.middleRows(draw.first_vertex, draw.primitive->position->count).setConstant(255);
      return;
    }
    const GltfAccessor& accessor = *draw.primitive->color;
    std::vector<double> linear(accessor.count * accessor.num_components);
    accessor.decode(linear.data());
    for (std::int64_t i = 0; i < accessor.count; ++i) {
      for (int c = 0; c < 3; ++c) {
        const double x = std::clamp(linear[i * accessor.num_components + c], 0.0, 1.0);
        const double y = srgb_from_linear(x);
        mesh_.colors(draw.first_vertex + i, c) = static_cast<std::uint8_t>(std::lround(255.0 * y));
      }
      const bool is_clear = accessor.num_components == 4 && linear[4 * i + 3] < 1.0;
      if (is_clear && !is_scene_) warn(result_.warnings, "alpha of vertex colors is left out");
    }
  }

  void fill_texcoords(const Draw& draw) {
    const GltfAccessor& accessor = *draw.primitive->texcoord;
    accessor.decode(mesh_.texcoords.data() + 2 * draw.first_texcoord);
    const TextureTransform& transform = draw.primitive->texture;
    if (transform != TextureTransform()) {
      for (std::int64_t i = draw.first_texcoord; i < draw.first_texcoord + accessor.count; ++i) {
        auto row = mesh_.texcoords.row(i);
        row = transform(row[0], row[1]);
        if (!row.allFinite()) accessor.place.fail("overflows in KHR_texture_transform");
      }
    }
    auto v = mesh_.texcoords.col(1).segment(draw.first_texcoord, accessor.count);
    v = (1.0 - v.array()).matrix().eval();
  }

  /// Normals are transformed by the matrix of cofactors: the inverse transpose times the
  /// determinant, which exists for a singular transform, too.
  void fill_normals(const Draw& draw) {
    const GltfAccessor& accessor = *draw.primitive->normal;
    accessor.decode(mesh_.normals.data() + 3 * draw.first_normal);
    apply(draw.normal_morph, mesh_.normals.data() + 3 * draw.first_normal);
    const std::vector<Transform> places = places_of_vertices(draw);
    const Eigen::Matrix3d& m = draw.transform->linear;
    if (m.isIdentity(0.0) && draw.normal_morph.empty() && places.empty()) return;
    Eigen::Matrix3d turned = cofactors_of(m);
    for (std::int64_t i = draw.first_normal; i < draw.first_normal + accessor.count; ++i) {
      if (!places.empty()) turned = cofactors_of(places[i - draw.first_normal].linear);
      const Eigen::Vector3d normal = turned * mesh_.normals.row(i).transpose();
      if (!normal.allFinite())
        accessor.place.fail("a normal overflows in the transform of its node");
      mesh_.normals.row(i) = normal.stableNormalized().transpose();
    }
  }

  /// The matrix of cofactors of a linear map, without the sign of one that mirrors.
  static Eigen::Matrix3d cofactors_of(const Eigen::Matrix3d& m) {
    Eigen::Matrix3d cofactors;
    cofactors << m.col(1).cross(m.col(2)), m.col(2).cross(m.col(0)), m.col(0).cross(m.col(1));
    return m.determinant() < 0.0 ? Eigen::Matrix3d(-cofactors) : cofactors;
  }

  [[nodiscard]] static std::vector<std::uint32_t> corners_of(const Primitive& p) {
    std::vector<std::uint32_t> corners;
    if (p.indices == nullptr) {
      corners.resize(p.position->count);
      std::iota(corners.begin(), corners.end(), 0U);
      return corners;
    }
    corners = p.indices->decode_indices();
    for (std::size_t i = 0; i < corners.size(); ++i) {
      if (corners[i] < static_cast<std::uint64_t>(p.position->count)) continue;
      p.indices->place.fail("element " + std::to_string(i) + " is " + std::to_string(corners[i]) +
                            ", " + p.place.pointer() + " has " + std::to_string(p.position->count) +
                            " vertices");
    }
    return corners;
  }

  /// The corners of face f in the list of corners: glTF 2.0, section 3.7.2.1.
  static std::array<std::int64_t, 3> face_corners(std::int64_t mode, std::int64_t f) {
    if (mode == kModeTriangleStrip) return {f, f + 1 + f % 2, f + 2 - f % 2};
    if (mode == kModeTriangleFan) return {f + 1, f + 2, 0};
    return {3 * f, 3 * f + 1, 3 * f + 2};
  }

  void fill_faces(const Draw& draw) {
    const Primitive& p = *draw.primitive;
    const std::vector<std::uint32_t> corners = corners_of(p);
    const bool mirrored = draw.transform->mirrors();
    for (std::int64_t f = 0; f < p.num_faces(); ++f) {
      std::array<std::int64_t, 3> from = face_corners(p.mode, f);
      if (mirrored) std::swap(from[1], from[2]);
      const std::int64_t face = draw.first_face + f;
      for (int c = 0; c < 3; ++c) {
        const std::int64_t i = corners[from[c]];
        const auto set = [&](Faces& table, std::int64_t row) {
          table(face, c) = static_cast<std::int32_t>(row + i);
        };
        set(mesh_.faces, draw.first_vertex);
        if (p.texcoord != nullptr) set(mesh_.face_texcoords, draw.first_texcoord);
        if (p.normal != nullptr) set(mesh_.face_normals, draw.first_normal);
      }
      if (mesh_.face_material.rows() > 0) mesh_.face_material[face] = p.material;
    }
  }

  // --- Materials -------------------------------------------------------------------------

  /// Our writer adds a copy without textures of each material that a face without texture
  /// coordinates has. Such a copy (kUntexturedCopyOf) becomes its original again.
  void read_materials() {
    std::vector<std::int32_t> rows;
    for (std::int64_t i = 0; i < document_.count("materials"); ++i) {
      const JsonPlace place = document_.root().member("materials").item(i);
      const auto extras = place.find("extras");
      const auto original =
          extras && extras->is_object() ? extras->find(kUntexturedCopyOf) : std::nullopt;
      if (original && i > 0) {
        rows.push_back(rows[original->integer(0, i - 1)]);
      } else {
        rows.push_back(static_cast<std::int32_t>(mesh_.materials.size()));
        mesh_.materials.push_back(read_material(place));
      }
    }
    for (std::int32_t& material : mesh_.face_material) {
      if (material >= 0) material = rows[material];
    }
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
    charge(static_cast<std::int64_t>(bytes.size()), 1, image.pointer());
    texture.data.assign(bytes.begin(), bytes.end());
    return texture;
  }

  /// Reads the texture `key` of a material into the material's textures, as `role`.
  /// @param shared  the transform that the texture coordinates have got: a texture with another one
  ///                is left out. Null for scenes, whose texture coordinates are as stored.
  void read_texture(const JsonPlace& owner, const char* key, const char* role,
                    const std::optional<TextureTransform>& shared, Material& material) {
    const auto info = owner.find(key);
    if (!info) return;
    const auto placed = placement(owner, key);
    if (placed->set != (shared ? shared->set : 0)) {
      warn(result_.warnings,
           "textures on other texture coordinates than the first of their material are left "
           "out");
      return;
    }
    if (shared && *placed != *shared) {
      warn(result_.warnings,
           std::string(kTextureTransform) +
               ": textures placed otherwise than the first of their material are left out");
      return;
    }
    const auto source = document_.object("textures", info->member("index")).find("source");
    if (!source) {
      warn(result_.warnings, "textures that are not PNG or JPEG images are left out");
      return;
    }
    const JsonPlace image = document_.object("images", *source);
    if (const auto uri = image.find("uri")) {
      if (const std::string scheme = uri_scheme(uri->text()); !scheme.empty() && scheme != "data") {
        warn(result_.warnings, "remote images are left out");
        return;
      }
      charge(static_cast<std::int64_t>(uri->text().size()), 1, image.pointer());
    }
    material.textures[role] = read_image(image);
  }

  Material read_material(const JsonPlace& place) {
    std::optional<TextureTransform> shared;
    if (!is_scene_) shared = texture_transform(place);
    Material m;
    m.metallic = 1.0;  // glTF's defaults, where ours are 0 and true
    m.double_sided = false;
    if (const auto name = place.find("name")) m.name = name->text();
    if (const auto pbr = place.find("pbrMetallicRoughness")) {
      if (const auto color = pbr->find("baseColorFactor")) {
        Eigen::Map<Eigen::Vector4d>(m.base_color) = numbers<4>(*color);
      }
      if (const auto metallic = pbr->find("metallicFactor")) m.metallic = metallic->number();
      if (const auto roughness = pbr->find("roughnessFactor")) m.roughness = roughness->number();
      read_texture(*pbr, "baseColorTexture", "base_color", shared, m);
      read_texture(*pbr, "metallicRoughnessTexture", "metallic_roughness", shared, m);
    }
    read_texture(place, "normalTexture", "normal", shared, m);
    read_texture(place, "occlusionTexture", "occlusion", shared, m);
    read_emission(place, shared, m);
    if (const auto mode = place.find("alphaMode")) m.alpha_mode = read_alpha_mode(*mode);
    if (const auto cutoff = place.find("alphaCutoff")) m.alpha_cutoff = cutoff->number();
    if (const auto both = place.find("doubleSided")) m.double_sided = both->boolean();
    return m;
  }

  /// Reads what the surface emits. Where the emissive texture is left out, its factor is left out,
  /// too: it would make the whole surface shine.
  void read_emission(const JsonPlace& place, const std::optional<TextureTransform>& shared,
                     Material& m) {
    const auto factor = place.find("emissiveFactor");
    if (!factor || numbers<3>(*factor).isZero()) return;
    read_texture(place, "emissiveTexture", "emissive", shared, m);
    if (place.has("emissiveTexture") && !m.textures.contains("emissive")) return;
    Eigen::Map<Eigen::Vector3d> light(m.emissive);
    light = numbers<3>(*factor);
    const auto extensions = place.find("extensions");
    const auto bright = extensions ? extensions->find(kEmissiveStrength) : std::nullopt;
    const auto strength = bright ? bright->find("emissiveStrength") : std::nullopt;
    if (strength) light *= strength->number();
    if (!light.allFinite()) place.fail("the emissive light overflows");
    light = light.cwiseMax(0.0);
    if (light.isZero(0.0)) m.textures.erase("emissive");  // else 0 would count as 1 beside it
  }

  static AlphaMode read_alpha_mode(const JsonPlace& place) {
    constexpr std::array<std::string_view, 3> kModes = {"OPAQUE", "MASK", "BLEND"};
    const auto found = std::find(kModes.begin(), kModes.end(), place.text());
    if (found == kModes.end()) place.fail("expected OPAQUE, MASK or BLEND");
    return static_cast<AlphaMode>(found - kModes.begin());
  }

  // Bytes of one row in the tables of the mesh, temporaries included.
  static constexpr std::int64_t kVertexBytes = 24;
  static constexpr std::int64_t kTexcoordBytes = 16;
  static constexpr std::int64_t kColorBytes = 3 + 32;  // and four doubles while it is decoded
  static constexpr std::int64_t kFaceBytes = 40;       // vertices, texcoords, normals, material

  GltfBudget& budget_;
  GltfDocument document_;
  const DracoDecoder& draco_;
  bool is_scene_ = false;
  ReadResult result_;
  TriangleMesh& mesh_ = result_.mesh;
  std::vector<Instance> instances_;
  std::map<std::int64_t, std::vector<Primitive>> meshes_;
  std::map<std::string, Skin> skins_;  ///< By pointer.
  std::map<const Skin*, std::vector<Transform>> places_of_joints_;
  std::vector<std::int64_t> parents_;         ///< By node, -1: none; empty: not asked for yet.
  std::map<std::int64_t, Transform> worlds_;  ///< By node, those that world_of() has looked at.
  std::map<std::pair<const GltfAccessor*, TextureTransform>, std::int64_t> texcoord_rows_;
  std::vector<Draw> draws_;
  bool with_colors_ = false;
  std::int64_t num_vertices_ = 0;
  std::int64_t num_texcoords_ = 0;
  std::int64_t num_normals_ = 0;
  std::int64_t num_faces_ = 0;
};

/// The rest of a source, `most` bytes of it at most.
/// @param budget  is charged block by block, so that a source that is too long is not read to its
///                end; may be null.
Bytes read_all(ByteSource& source, std::size_t most, GltfBudget* budget) {
  constexpr std::size_t kBlock = std::size_t{1} << 16;
  Bytes bytes;
  bytes.reserve(std::min<std::size_t>(source.remaining().value_or(0), most));
  while (bytes.size() < most) {
    const std::size_t size = bytes.size();
    bytes.resize(size + std::min(kBlock, most - size));
    const std::size_t got =
        source.read(reinterpret_cast<char*>(bytes.data()) + size, bytes.size() - size);
    bytes.resize(size + got);
    if (budget != nullptr) budget->charge(static_cast<std::int64_t>(got), "file");
    if (got == 0) break;
  }
  return bytes;
}

Bytes read_beside(const ReadOptions& options, const std::string& uri, std::int64_t size) {
  if (options.folder.empty()) {
    throw InputError("'" + uri + "' cannot be read: no folder to find it in");
  }
  const auto place_of = [&](const std::string& name) {
    return options.allow_outside ? options.folder / name : resolve_inside(options.folder, name);
  };
  std::filesystem::path path = place_of(uri);
  if (!std::filesystem::exists(path) && uri.find('\\') != std::string::npos) {
    std::string slashed = uri;  // programs for Windows write its separators
    std::replace(slashed.begin(), slashed.end(), '\\', '/');
    path = place_of(slashed);
  }
  if (std::filesystem::exists(path) && !std::filesystem::is_regular_file(path)) {
    throw InputError("'" + uri + "' is not a regular file");
  }
  return read_all(*file_source(path), static_cast<std::size_t>(size), nullptr);
}

GltfResource resource_beside(const ReadOptions& options) {
  return [&options](const std::string& uri, std::int64_t size) {
    return read_beside(options, uri, size);
  };
}

}  // namespace

GltfBudget::GltfBudget(std::int64_t stored_bytes, std::uint64_t max_bytes)
    : stored_bytes_(stored_bytes),
      max_bytes_(static_cast<std::int64_t>(
          std::min<std::uint64_t>(max_bytes, std::numeric_limits<std::int64_t>::max()))) {}

void GltfBudget::charge(std::int64_t bytes, const std::string& who) {
  const std::int64_t limit =
      max_bytes_ > 0 ? max_bytes_
                     : std::max(kFreeBytes, kFreeRatio * (stored_bytes_ + 4 * compressed_));
  if (bytes <= limit - spent_) {  // the sum may not fit 64 bits
    spent_ += bytes;
    return;
  }
  throw FormatError::at_byte(0, who + ": the mesh takes more than " + std::to_string(limit) +
                                    " bytes, much for a file of " + std::to_string(stored_bytes_) +
                                    "; max_bytes allows it");
}

ReadResult parse_gltf(std::span<const std::byte> data, const GltfResource& resource,
                      GltfBudget budget, const Progress& progress, const DracoDecoder& draco) {
  return Reader(data, resource, budget, draco).read(progress);
}

Scene parse_gltf_scene(std::span<const std::byte> data, const GltfResource& resource,
                       GltfBudget budget, const Progress& progress, const DracoDecoder& draco) {
  return Reader(data, resource, budget, draco).read_scene(resource, progress);
}

ReadResult read_gltf(ByteSource& source, const ReadOptions& options, const Progress& progress) {
  GltfBudget budget(static_cast<std::int64_t>(source.stored_size()), options.max_bytes);
  const Bytes file = read_all(source, std::numeric_limits<std::size_t>::max(), &budget);
  return parse_gltf(file, resource_beside(options), budget, progress, options.draco);
}

Scene read_gltf_scene(ByteSource& source, const ReadOptions& options, const Progress& progress) {
  GltfBudget budget(static_cast<std::int64_t>(source.stored_size()), options.max_bytes);
  const Bytes file = read_all(source, std::numeric_limits<std::size_t>::max(), &budget);
  return parse_gltf_scene(file, resource_beside(options), budget, progress, options.draco);
}

}  // namespace manip3d
