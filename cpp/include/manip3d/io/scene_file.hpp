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
/// Scenes of glTF files: nodes in a hierarchy, and meshes that several nodes may show.
namespace manip3d {

struct SceneNode {
  std::string name;
  std::int32_t parent = -1;                                 ///< Index of a node; -1: a root.
  std::int32_t mesh = -1;                                   ///< Index of a mesh; -1: none.
  Eigen::Matrix4d transform = Eigen::Matrix4d::Identity();  ///< Into the parent's coordinates.
  bool is_drawn = false;                                    ///< Part of the default scene.
  /// Places of the mesh in the node's coordinates (EXT_mesh_gpu_instancing); null: it is drawn
  /// once, at the node itself.
  std::optional<std::vector<Eigen::Matrix4d>> instances = std::nullopt;
  /// The first joint of the node's skin, which places the mesh in the node's stead, and what takes
  /// the mesh's coordinates to the joint's; -1: no skin.
  std::int32_t joint = -1;
  Eigen::Matrix4d inverse_bind = Eigen::Matrix4d::Identity();
};

/// What moves the vertices of a mesh: the joints of a skin and morph targets. Borrowed.
struct DeformationView {
  std::int64_t num_influences = 0;        ///< Joints of a vertex: 4 for each of JOINTS_0, ...
  std::int64_t num_targets = 0;           ///< Morph targets.
  std::span<const std::uint16_t> joints;  ///< (V, num_influences) indices into the skin's joints.
  std::span<const float> weights;         ///< (V, num_influences)
  std::span<const float> targets;         ///< (num_targets, V, 3), added to the vertices.
  std::span<const float> target_normals;  ///< As targets, added to the normals; empty: none are.

  [[nodiscard]] bool empty() const { return num_influences == 0 && num_targets == 0; }
  /// @throws InputError  an array does not fit the number of vertices.
  void check(std::int64_t num_vertices) const;
};

/// As DeformationView, with arrays of its own.
struct Deformation {
  std::int64_t num_influences = 0;
  std::int64_t num_targets = 0;
  std::vector<std::uint16_t> joints;
  std::vector<float> weights;
  std::vector<float> targets;
  std::vector<float> target_normals;

  [[nodiscard]] bool empty() const { return num_influences == 0 && num_targets == 0; }
};

/// Sets of texture coordinates besides the first, TEXCOORD_1 and so on. Borrowed.
struct MoreTexcoordsView {
  std::int64_t num_sets = 0;
  /// (V, num_sets, 2), as glTF has them (v downwards); NaN where a vertex lacks a set.
  std::span<const float> values;

  /// @throws InputError  the values do not fit the number of vertices.
  void check(std::int64_t num_vertices) const;
};

/// As MoreTexcoordsView, with values of its own.
struct MoreTexcoords {
  std::int64_t num_sets = 0;
  std::vector<float> values;
};

struct SceneMesh {
  std::string name;
  /// In its own coordinates, without its morph targets (one that is fixed: in the shape of their
  /// default weights); its materials are those of the scene.
  TriangleMesh mesh;
  std::string fixed;  ///< Why it can only be written as it was read; empty: it may be replaced.
  Deformation deformation = {};       ///< Moves its vertices; empty where it is fixed.
  MoreTexcoords more_texcoords = {};  ///< Empty where it is fixed.
};

struct Scene {
  std::vector<SceneNode> nodes;
  std::vector<SceneMesh> meshes;
  std::vector<Material> materials;
  /// All of the file but the triangles that may be replaced: glTF's JSON without buffers, and the
  /// bytes of the one buffer that its bufferViews lie in.
  std::string document;
  std::string buffer;
  std::vector<std::string> warnings;  ///< Tell the user which parts were left out.
};

/// Reads a .gltf or .glb file, compressed or not, as a scene.
///
/// Nodes, cameras, lights, materials, textures, skins, animations and `extras` are kept as they
/// are; so are points and lines, and meshes whose morph targets change more than positions and
/// normals.
/// @throws FormatError  as read_mesh(); a file of another format.
Scene read_scene(const std::filesystem::path& path, const ReadOptions& options = {},
                 const Progress& progress = {});

/// The triangles of a mesh, and what their vertices have that a mesh has no place for.
struct SceneTriangles {
  MeshView mesh;
  DeformationView deformation = {};
  MoreTexcoordsView more_texcoords = {};
};

/// The meshes of one level of detail, one for each of Scene::meshes; none: as it was read. One
/// without faces is left out, and the nodes that show it stay.
using SceneLevel = std::vector<std::optional<SceneTriangles>>;

struct SceneWriteOptions {
  std::int64_t max_vertices = 0;  ///< As WriteOptions::max_vertices.
  /// Coarser levels of detail (MSFT_lod), and for all levels the least share of the screen.
  std::vector<SceneLevel> coarser;
  std::vector<double> coverages;
  /// As WriteOptions::quantize, each mesh in its own box: a child of its node moves and scales it.
  /// Meshes with joints or morph targets are not.
  bool quantize = false;
};

/// Writes a scene, with other triangles, as .gltf or .glb, whole or not at all.
/// @return what was left out, for the user.
/// @throws InputError  another suffix, a document that read_scene() did not make, meshes that do
///                     not fit it, and as write_mesh().
std::vector<std::string> write_scene(const std::filesystem::path& path, const std::string& document,
                                     const std::string& buffer, const SceneLevel& meshes,
                                     const SceneWriteOptions& options = {},
                                     const Progress& progress = {});

}  // namespace manip3d
