#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/io/mesh_file.hpp"
#include "manip3d/progress.hpp"

/// @file
/// Scenes of glTF files: a hierarchy of nodes, and meshes that several nodes may show.
namespace manip3d {

struct SceneNode {
  std::string name;
  std::int32_t parent = -1;  ///< Index of the parent node; -1: a root.
  std::int32_t mesh = -1;    ///< Index of the mesh; -1: none.
  /// From the node's to the parent's coordinates.
  Eigen::Matrix4d transform = Eigen::Matrix4d::Identity();
  bool is_drawn = false;  ///< The node is part of the default scene.
  /// Transforms of the instances of the mesh in the node's coordinates (EXT_mesh_gpu_instancing);
  /// empty: one instance at the node itself.
  std::optional<std::vector<Eigen::Matrix4d>> instances = std::nullopt;
  /// First joint of the node's skin; -1: no skin. With a skin, this joint determines the place of
  /// the mesh, and not the node.
  std::int32_t joint = -1;
  /// From the mesh's to the first joint's coordinates.
  Eigen::Matrix4d inverse_bind = Eigen::Matrix4d::Identity();
};

/// Deformation of the vertices of a mesh by the joints of a skin and by morph targets. Borrowed.
struct DeformationView {
  std::int64_t num_influences = 0;        ///< Joints per vertex: 4 for each of JOINTS_0, ...
  std::int64_t num_targets = 0;           ///< Number of morph targets.
  std::span<const std::uint16_t> joints;  ///< (V, num_influences) indices into the skin's joints.
  std::span<const float> weights;         ///< (V, num_influences)
  std::span<const float> targets;         ///< (num_targets, V, 3), which are added to the vertices.
  /// Like `targets`, added to the normals; empty: normals do not change.
  std::span<const float> target_normals;

  [[nodiscard]] bool empty() const { return num_influences == 0 && num_targets == 0; }
  /// @throws InputError  the size of an array does not fit the number of vertices.
  void check(std::int64_t num_vertices) const;
};

/// Like DeformationView, with its own arrays.
struct Deformation {
  std::int64_t num_influences = 0;
  std::int64_t num_targets = 0;
  std::vector<std::uint16_t> joints;
  std::vector<float> weights;
  std::vector<float> targets;
  std::vector<float> target_normals;

  [[nodiscard]] bool empty() const { return num_influences == 0 && num_targets == 0; }
};

/// Further sets of texture coordinates: TEXCOORD_1 and so on. Borrowed.
struct MoreTexcoordsView {
  std::int64_t num_sets = 0;
  /// (V, num_sets, 2) as in glTF (v downwards); NaN: the vertex lacks the set.
  std::span<const float> values;

  /// @throws InputError  the number of values does not fit the number of vertices.
  void check(std::int64_t num_vertices) const;
};

/// Like MoreTexcoordsView, with its own values.
struct MoreTexcoords {
  std::int64_t num_sets = 0;
  std::vector<float> values;
};

struct SceneMesh {
  std::string name;
  /// The mesh in its own coordinates, without its morph targets (if it is fixed: in the shape of
  /// their default weights). Its materials are those of the scene.
  TriangleMesh mesh;
  std::string fixed;  ///< Why the mesh can only be written unchanged; empty: it can be replaced.
  Deformation deformation = {};       ///< Deformation of its vertices; empty if it is fixed.
  MoreTexcoords more_texcoords = {};  ///< Empty if the mesh is fixed.
  /// (V,) alpha of the vertex colours, 0 to 1; empty: all are opaque, no material shows it, or the
  /// mesh is fixed.
  std::vector<float> alphas = {};
};

struct Scene {
  std::vector<SceneNode> nodes;
  std::vector<SceneMesh> meshes;
  std::vector<Material> materials;
  /// The file without the triangles that can be replaced: glTF's JSON without buffers, and the
  /// bytes of the only buffer that its bufferViews refer to.
  std::string document;
  std::string buffer;
  std::vector<std::string> warnings;  ///< Messages for the user about what was left out.
};

/// Reads a .gltf or .glb file, compressed or not, as a scene.
///
/// Nodes, cameras, lights, materials, textures, skins, animations and `extras` are kept unchanged.
/// Points, lines, and meshes whose morph targets change more than positions and normals are kept as
/// well.
/// @throws FormatError  as read_mesh(); the file is of another format.
Scene read_scene(const std::filesystem::path& path, const ReadOptions& options = {},
                 const Progress& progress = {});

/// The triangles of a mesh, with data of their vertices that MeshView does not have.
struct SceneTriangles {
  MeshView mesh;
  DeformationView deformation = {};
  MoreTexcoordsView more_texcoords = {};
  std::span<const float> alphas = {};  ///< (V,) of the vertex colours; empty: opaque. Borrowed.
};

/// The meshes of one level of detail, one for each of Scene::meshes; empty: unchanged. A mesh
/// without faces is left out; the nodes that show it stay.
using SceneLevel = std::vector<std::optional<SceneTriangles>>;

struct SceneWriteOptions {
  std::int64_t max_vertices = 0;  ///< See WriteOptions::max_vertices.
  /// Coarser levels of detail (MSFT_lod).
  std::vector<SceneLevel> coarser;
  /// Least share of the screen for which each level is made.
  std::vector<double> coverages;
  /// See WriteOptions::quantize. Each mesh is quantised in its own bounding box, and a child of its
  /// node restores position and scale. Meshes with joints or morph targets are not quantised.
  bool quantize = false;
  bool hash_names = false;  ///< See WriteOptions::hash_names.
};

/// Writes a scene with other triangles as .gltf or .glb, completely or not at all.
/// @return  Messages for the user: what was left out.
/// @throws InputError  another suffix, a document that is not from read_scene(), meshes that do not
///                     fit it; see write_mesh().
std::vector<std::string> write_scene(const std::filesystem::path& path, const std::string& document,
                                     const std::string& buffer, const SceneLevel& meshes,
                                     const SceneWriteOptions& options = {},
                                     const Progress& progress = {});

}  // namespace manip3d
