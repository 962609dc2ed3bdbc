#include "io/gltf_nodes.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <set>
#include <utility>

namespace manip3d {
namespace {

GltfTransform matrix_transform(const JsonPlace& place) {
  const auto columns = vector_of<16>(place);
  const Eigen::Matrix4d m = Eigen::Map<const Eigen::Matrix4d>(columns.data());
  constexpr double kRounding = 1e-5;  // of exporters that compute with single precision
  if (!((m.row(3) - Eigen::RowVector4d(0, 0, 0, 1)).cwiseAbs().maxCoeff() <= kRounding)) {
    place.fail("expected 0 0 0 1 as the last row");
  }
  return {m.topLeftCorner<3, 3>(), m.topRightCorner<3, 1>()};
}

Eigen::Matrix4d matrix_of(const GltfTransform& transform) {
  Eigen::Matrix4d matrix = Eigen::Matrix4d::Identity();
  matrix.topLeftCorner<3, 3>() = transform.linear;
  matrix.topRightCorner<3, 1>() = transform.translation;
  return matrix;
}

/// The rotation of a quaternion x, y, z, w. It is normalised first, because files are not exact.
/// @param place  Place of the quaternion, for the error message if it has no direction.
Eigen::Matrix3d rotation_of(const Eigen::Vector4d& xyzw, const JsonPlace& place) {
  const double length = xyzw.norm();
  if (!(length > 0.0 && std::isfinite(length))) {
    place.fail(std::string("expected a unit quaternion, got ") +
               (length > 0.0 ? "one without a finite length" : "zero"));
  }
  return Eigen::Quaterniond(xyzw.normalized()).toRotationMatrix();
}

GltfTransform node_transform(const JsonPlace& node) {
  if (const auto matrix = node.find("matrix")) return matrix_transform(*matrix);
  GltfTransform transform;
  if (const auto rotation = node.find("rotation")) {
    transform.linear = rotation_of(vector_of<4>(*rotation), *rotation);
  }
  if (const auto scale = node.find("scale")) {
    transform.linear = transform.linear * vector_of<3>(*scale).asDiagonal();
  }
  if (const auto translation = node.find("translation")) {
    transform.translation = vector_of<3>(*translation);
  }
  return transform;
}

std::vector<double> decoded(const GltfAccessor* accessor) {
  std::vector<double> rows(accessor != nullptr ? accessor->count * accessor->num_components : 0);
  if (accessor != nullptr) accessor->decode(rows.data());
  return rows;
}

}  // namespace

GltfNodes::GltfNodes(GltfDocument& document, GltfBudget& budget)
    : document_(document),
      budget_(budget),
      children_(document.count("nodes")),
      parents_(children_.size(), -1) {
  for (std::int64_t n = 0; n < std::ssize(children_); ++n) {
    const auto list = node(n).find("children");
    for (std::int64_t i = 0; list && i < list->size(); ++i) {
      const std::int64_t child = list->item(i).integer(0, std::ssize(children_) - 1);
      if (parents_[child] >= 0) {
        list->item(i).fail("node " + std::to_string(child) + " has two parents");
      }
      parents_[child] = n;
      children_[n].push_back(child);
    }
  }
  check_acyclic();
}

JsonPlace GltfNodes::node(std::int64_t index) const {
  return document_.root().member("nodes").item(index);
}

/// Checks that the roots reach all nodes. Each node has at most one parent, so that unreached nodes
/// are in or below a cycle.
void GltfNodes::check_acyclic() const {
  Indices roots;
  for (std::int64_t n = 0; n < std::ssize(parents_); ++n) {
    if (parents_[n] < 0) roots.push_back(n);
  }
  std::vector<bool> reached(parents_.size(), false);
  mark_below(std::move(roots), reached);
  const auto lost = std::find(reached.begin(), reached.end(), false);
  if (lost != reached.end()) node(lost - reached.begin()).fail("the nodes form a cycle");
}

/// Marks these nodes and their descendants. The descendants of a marked node are marked already, so
/// that each node is visited once, however many scenes contain it.
void GltfNodes::mark_below(Indices roots, std::vector<bool>& marked) const {
  Indices& stack = roots;
  while (!stack.empty()) {
    const std::int64_t n = stack.back();
    stack.pop_back();
    if (marked[n]) continue;
    marked[n] = true;
    stack.insert(stack.end(), children_[n].begin(), children_[n].end());
  }
}

/// Roots of the default scene; without one, of the first scene; without scenes, all nodes without a
/// parent.
GltfNodes::Indices GltfNodes::drawn_roots() const {
  if (document_.count("scenes") == 0) {
    Indices roots;
    for (std::int64_t n = 0; n < std::ssize(parents_); ++n) {
      if (parents_[n] < 0) roots.push_back(n);
    }
    return roots;
  }
  const auto chosen = document_.root().find("scene");
  return roots_of(chosen ? document_.object("scenes", *chosen)
                         : document_.root().member("scenes").item(0));
}

GltfNodes::Indices GltfNodes::roots_of(const JsonPlace& scene) const {
  Indices roots;
  const auto list = scene.find("nodes");
  // a set as large as the list, because there may be as many scenes as nodes
  std::set<std::int64_t> listed;
  for (std::int64_t i = 0; list && i < list->size(); ++i) {
    const JsonPlace place = list->item(i);
    const std::int64_t n = place.integer(0, std::ssize(parents_) - 1);
    if (parents_[n] >= 0) place.fail("the root of a scene has a parent");
    if (!listed.insert(n).second) place.fail("node " + std::to_string(n) + " is listed twice");
    roots.push_back(n);
  }
  return roots;
}

std::vector<GltfInstance> GltfNodes::drawn_instances() {
  struct Visit {
    std::int64_t node;
    GltfTransform parent;
  };
  std::vector<GltfInstance> instances;
  std::vector<Visit> stack;
  const auto push_reversed = [&](const Indices& nodes, const GltfTransform& parent) {
    for (auto n = nodes.rbegin(); n != nodes.rend(); ++n) stack.push_back({*n, parent});
  };
  push_reversed(drawn_roots(), {});
  while (!stack.empty()) {
    const Visit visit = stack.back();
    stack.pop_back();
    const JsonPlace place = node(visit.node);
    const GltfTransform world = visit.parent * node_transform(place);
    if (place.has("mesh")) add_instances(place, world, instances);
    push_reversed(children_[visit.node], world);
  }
  return instances;
}

/// @param world  Transform from the node's coordinates to the scene's.
void GltfNodes::add_instances(const JsonPlace& place, const GltfTransform& world,
                              std::vector<GltfInstance>& instances) {
  const JsonPlace mesh = place.member("mesh");
  const auto skin = place.find("skin");
  const auto* joints = skin ? &places_of_joints(*skin) : nullptr;
  auto weights = place.find("weights");  // the node's weights replace the mesh's
  if (!weights) weights = document_.object("meshes", mesh).find("weights");
  const std::int64_t index = mesh.integer(0, document_.count("meshes") - 1);
  const auto placed = gpu_instances(place);
  if (!placed) {
    const GltfTransform& shown = joints != nullptr ? joints->front() : world;
    instances.push_back({index, shown, std::move(weights), joints});
    return;
  }
  for (const GltfTransform& own : *placed) instances.push_back({index, world * own, weights});
}

/// Transforms of the instances of a node's mesh by EXT_mesh_gpu_instancing, in the node's
/// coordinates; empty: one instance at the node itself.
std::optional<std::vector<GltfTransform>> GltfNodes::gpu_instances(const JsonPlace& place) {
  const auto extensions = place.find("extensions");
  const auto instancing = extensions ? extensions->find(kInstancing) : std::nullopt;
  if (!instancing) return std::nullopt;
  const JsonPlace attributes = instancing->member("attributes");
  const GltfAccessor* translation = document_.attribute(attributes, "TRANSLATION", 3, 3);
  const GltfAccessor* rotation = document_.attribute(attributes, "ROTATION", 4, 4);
  const GltfAccessor* scale = document_.attribute(attributes, "SCALE", 3, 3);
  const GltfAccessor* first = translation ? translation : rotation ? rotation : scale;
  if (first == nullptr) return std::nullopt;
  for (const GltfAccessor* other : {rotation, scale}) {
    if (other != nullptr && other->count != first->count) {
      other->place.fail("has " + std::to_string(other->count) + " elements, another of " +
                        attributes.pointer() + " " + std::to_string(first->count));
    }
  }
  constexpr std::int64_t kNumbers = 3 + 4 + 3;  // numbers of a translation, a rotation and a scale
  budget_.charge(first->count,
                 sizeof(GltfTransform) + sizeof(GltfInstance) + kNumbers * sizeof(double),
                 attributes.pointer());
  const std::vector<double> translations = decoded(translation), rotations = decoded(rotation),
                            scales = decoded(scale);
  std::vector<GltfTransform> placed(first->count);
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

const GltfNodes::Skin& GltfNodes::skin(const JsonPlace& user) {
  const JsonPlace place = document_.object("skins", user);
  const auto [known, is_new] = skins_.try_emplace(place.pointer());
  Skin& skin = known->second;
  if (!is_new) return skin;
  const JsonPlace joints = place.member("joints");
  if (joints.size() == 0) joints.fail("expected at least one joint");
  budget_.charge(joints.size(), 2 * sizeof(GltfTransform) + sizeof(std::int64_t), joints.pointer());
  for (std::int64_t i = 0; i < joints.size(); ++i) {
    skin.joints.push_back(joints.item(i).integer(0, std::ssize(parents_) - 1));
  }
  skin.inverse_binds.resize(skin.joints.size());
  if (const GltfAccessor* given = document_.attribute(place, "inverseBindMatrices", 16, 16)) {
    if (given->count < joints.size()) {
      given->place.fail("expected a matrix for each of " + std::to_string(joints.size()) +
                        " joints, got " + std::to_string(given->count));
    }
    budget_.charge(given->count, 16 * sizeof(double), given->place.pointer());
    const std::vector<double> matrices = decoded(given);
    for (std::size_t i = 0; i < skin.joints.size(); ++i) {
      const Eigen::Map<const Eigen::Matrix4d> matrix(matrices.data() + 16 * i);
      skin.inverse_binds[i] = {matrix.topLeftCorner<3, 3>(), matrix.topRightCorner<3, 1>()};
    }
  }
  return skin;
}

/// Transforms of a mesh by each joint of a skin. In glTF these place the mesh, and not the node
/// that shows it.
const std::vector<GltfTransform>& GltfNodes::places_of_joints(const JsonPlace& user) {
  const Skin& read = skin(user);
  std::vector<GltfTransform>& places = places_of_joints_[&read];
  for (std::size_t i = places.size(); i < read.joints.size(); ++i) {
    places.push_back(world_of(read.joints[i]) * read.inverse_binds[i]);
  }
  return places;
}

/// Transform from a node's coordinates to the scene's; computed once per node.
const GltfTransform& GltfNodes::world_of(std::int64_t index) {
  Indices path;
  for (std::int64_t n = index; n >= 0 && !worlds_.contains(n); n = parents_[n]) path.push_back(n);
  for (auto n = path.rbegin(); n != path.rend(); ++n) {
    const GltfTransform own = node_transform(node(*n));
    worlds_[*n] = parents_[*n] < 0 ? own : worlds_.at(parents_[*n]) * own;
  }
  return worlds_.at(index);
}

std::vector<SceneNode> GltfNodes::scene_nodes() {
  std::vector<bool> is_drawn(children_.size(), false);
  mark_below(drawn_roots(), is_drawn);
  std::vector<SceneNode> nodes(children_.size());
  for (std::int64_t n = 0; n < std::ssize(nodes); ++n) {
    SceneNode& read = nodes[n];
    const JsonPlace place = node(n);
    if (const auto name = place.find("name")) read.name = name->text();
    if (const auto mesh = place.find("mesh")) {
      static_cast<void>(document_.object("meshes", *mesh));  // checks the index
      read.mesh = static_cast<std::int32_t>(mesh->integer(0, document_.count("meshes") - 1));
    }
    const auto user = place.find("skin");
    if (user && read.mesh >= 0) {
      const Skin& own = skin(*user);
      read.joint = static_cast<std::int32_t>(own.joints.front());
      read.inverse_bind = matrix_of(own.inverse_binds.front());
    }
    read.transform = matrix_of(node_transform(place));
    if (const auto placed = gpu_instances(place); placed && read.mesh >= 0) {
      read.instances.emplace();
      for (const GltfTransform& own : *placed) read.instances->push_back(matrix_of(own));
    }
    read.is_drawn = is_drawn[n];
    for (const std::int64_t child : children_[n]) {
      nodes[child].parent = static_cast<std::int32_t>(n);
    }
  }
  return nodes;
}

std::vector<bool> GltfNodes::shown() const {
  std::vector<bool> is_shown(children_.size(), false);
  if (document_.count("scenes") == 0) mark_below(drawn_roots(), is_shown);
  for (std::int64_t i = 0; i < document_.count("scenes"); ++i) {
    mark_below(roots_of(document_.root().member("scenes").item(i)), is_shown);
  }
  return is_shown;
}

}  // namespace manip3d
