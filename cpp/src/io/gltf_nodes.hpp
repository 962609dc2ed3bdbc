#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "io/gltf_document.hpp"
#include "manip3d/io/scene_file.hpp"

namespace manip3d {

inline constexpr const char* kInstancing = "EXT_mesh_gpu_instancing";

/// The affine map x -> linear x + translation.
struct GltfTransform {
  Eigen::Matrix3d linear = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  GltfTransform operator*(const GltfTransform& child) const {
    return {linear * child.linear, linear * child.translation + translation};
  }
  [[nodiscard]] bool mirrors() const { return linear.determinant() < 0.0; }
};

/// An instance of a mesh.
struct GltfInstance {
  std::int64_t mesh;
  GltfTransform transform = {};
  /// Weights of the morph targets; empty: all are zero.
  std::optional<JsonPlace> weights = std::nullopt;
  /// Transforms of the mesh by each joint of a skin; null: no skin.
  const std::vector<GltfTransform>* joints = nullptr;
};

/// The nodes of a file, which form a forest, and their skins.
class GltfNodes {
 public:
  /// @throws FormatError  a node has two parents or is its own ancestor.
  GltfNodes(GltfDocument& document, GltfBudget& budget);

  /// Instances of meshes in the default scene, in depth-first order of its nodes. Their `joints`
  /// point into this object.
  [[nodiscard]] std::vector<GltfInstance> drawn_instances();
  [[nodiscard]] std::vector<SceneNode> scene_nodes();
  /// For each node: is it part of any scene?
  [[nodiscard]] std::vector<bool> shown() const;

 private:
  using Indices = std::vector<std::int64_t>;

  /// The joints of a skin, and the maps from the mesh's coordinates to those of each joint.
  struct Skin {
    Indices joints;
    std::vector<GltfTransform> inverse_binds;
  };

  [[nodiscard]] JsonPlace node(std::int64_t index) const;
  void check_acyclic() const;
  [[nodiscard]] Indices drawn_roots() const;
  [[nodiscard]] Indices roots_of(const JsonPlace& scene) const;
  void mark_below(Indices roots, std::vector<bool>& marked) const;
  void add_instances(const JsonPlace& place, const GltfTransform& world,
                     std::vector<GltfInstance>& instances);
  std::optional<std::vector<GltfTransform>> gpu_instances(const JsonPlace& place);
  const Skin& skin(const JsonPlace& user);
  const std::vector<GltfTransform>& places_of_joints(const JsonPlace& user);
  const GltfTransform& world_of(std::int64_t index);

  GltfDocument& document_;
  GltfBudget& budget_;
  std::vector<Indices> children_;
  Indices parents_;                    ///< Parent of each node; -1: none.
  std::map<std::string, Skin> skins_;  ///< By JSON pointer.
  std::map<const Skin*, std::vector<GltfTransform>> places_of_joints_;
  /// Transforms to the scene's coordinates that world_of() has computed so far.
  std::map<std::int64_t, GltfTransform> worlds_;
};

}  // namespace manip3d
