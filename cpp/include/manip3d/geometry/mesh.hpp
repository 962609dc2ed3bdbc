#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace manip3d {

template <typename Scalar, int Columns>
using Rows = Eigen::Matrix<Scalar, Eigen::Dynamic, Columns, Eigen::RowMajor>;

using Vertices = Rows<double, 3>;      ///< (V, 3) coordinates in the file's own units and axes.
using Faces = Rows<std::int32_t, 3>;   ///< (F, 3) indices.
using Texcoords = Rows<double, 2>;     ///< (T, 2) texture coordinates u, v (v up, as in OBJ).
using Colors = Rows<std::uint8_t, 3>;  ///< (V, 3) sRGB.
using Indices = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 1>;

/// The continuation of a texture beyond its image, for texture coordinates outside of [0, 1].
enum class TextureWrap : std::uint8_t { kRepeat, kMirror, kClamp };

/// A texture image: a path (relative to the mesh file, if it comes from one) or the bytes of a
/// file.
struct Texture {
  std::string path;             ///< Empty when only the bytes are known.
  std::vector<std::byte> data;  ///< PNG or JPEG file content; empty when only the path is known.
  std::array<TextureWrap, 2> wrap = {TextureWrap::kRepeat, TextureWrap::kRepeat};  ///< u and v.
  bool smooth = true;  ///< Whether the pixels of an enlarged image are blended.
  [[nodiscard]] bool empty() const { return path.empty() && data.empty(); }
  /// Whether the image repeats and is smoothed, as formats without samplers assume.
  [[nodiscard]] bool has_usual_sampler() const {
    return smooth && wrap[0] == TextureWrap::kRepeat && wrap[1] == TextureWrap::kRepeat;
  }
};

enum class AlphaMode : std::uint8_t { kOpaque, kMask, kBlend };

/// Surface appearance, the metallic-roughness model of glTF 2.0.
struct Material {
  std::string name;
  double base_color[4] = {1.0, 1.0, 1.0, 1.0};  ///< Linear RGBA factor in [0, 1].
  double metallic = 0.0;
  double roughness = 1.0;
  /// Emitted light, linear RGB, at least 0. If there is a texture "emissive", this is its factor
  /// (0, 0, 0 then means 1, 1, 1).
  double emissive[3] = {0.0, 0.0, 0.0};
  AlphaMode alpha_mode = AlphaMode::kOpaque;
  double alpha_cutoff = 0.5;
  bool double_sided = true;  ///< Only glTF files define it; in other files, both sides are visible.
  /// By role: "base_color", "metallic_roughness", "normal", "occlusion", "emissive".
  std::map<std::string, Texture> textures;

  /// Whether the emitted light is above 0 in some channel.
  [[nodiscard]] bool emits() const {
    return emissive[0] > 0.0 || emissive[1] > 0.0 || emissive[2] > 0.0;
  }
};

/// Triangle mesh with per-corner attributes. Optional tables are empty (0 rows) when absent.
///
/// Corner c of face f uses vertices.row(faces(f, c)), texcoords.row(face_texcoords(f, c)) and
/// normals.row(face_normals(f, c)); an index of -1 means that the corner has no such attribute.
struct TriangleMesh {
  Vertices vertices;
  Faces faces;
  Texcoords texcoords;
  Faces face_texcoords;   ///< (F, 3) or empty.
  Vertices normals;       ///< (K, 3) or empty.
  Faces face_normals;     ///< (F, 3) or empty.
  Colors colors;          ///< (V, 3) or empty.
  Indices face_material;  ///< (F,) or empty; -1 = no material.
  std::vector<Material> materials;
};

/// A borrowed TriangleMesh: the same tables, except materials, as read-only maps.
struct MeshView {
  template <typename Matrix>
  using Map = Eigen::Map<const Matrix>;

  Map<Vertices> vertices{nullptr, 0, 3};
  Map<Faces> faces{nullptr, 0, 3};
  Map<Texcoords> texcoords{nullptr, 0, 2};
  Map<Faces> face_texcoords{nullptr, 0, 3};
  Map<Vertices> normals{nullptr, 0, 3};
  Map<Faces> face_normals{nullptr, 0, 3};
  Map<Colors> colors{nullptr, 0, 3};
  Map<Indices> face_material{nullptr, 0};

  MeshView() = default;
  MeshView(const TriangleMesh& mesh);  // NOLINT(google-explicit-constructor): a view of a mesh
  // Eigen::Map has no rebinding assignment; a view is made once and passed by reference.
  MeshView(const MeshView&) = default;
  MeshView& operator=(const MeshView&) = delete;
  ~MeshView() = default;

  [[nodiscard]] std::int64_t num_vertices() const { return vertices.rows(); }
  [[nodiscard]] std::int64_t num_faces() const { return faces.rows(); }
  [[nodiscard]] bool has_texcoords() const { return face_texcoords.rows() > 0; }
  [[nodiscard]] bool has_materials() const { return face_material.rows() > 0; }
  /// True when all three corners of the face have a texture coordinate.
  [[nodiscard]] bool face_has_texcoords(Eigen::Index face) const {
    return has_texcoords() && face_texcoords.row(face).minCoeff() >= 0;
  }
};

/// Checks the preconditions of all kernels: finite coordinates, indices in range, tables of
/// matching length, at most 2^31 - 1 vertices and faces. Every public function with a mesh calls
/// it.
/// @throws InputError  naming the table, the row, the expected and the actual value.
void check_mesh(const MeshView& mesh);

/// Axis-aligned box.
struct BoundingBox {
  Eigen::Vector3d min = Eigen::Vector3d::Zero();
  Eigen::Vector3d max = Eigen::Vector3d::Zero();
  [[nodiscard]] double diagonal() const { return (max - min).norm(); }
  [[nodiscard]] Eigen::Vector3d center() const { return 0.5 * min + 0.5 * max; }
};

/// Bounding box of the vertices that some face uses; both corners are the origin if the mesh has no
/// faces.
BoundingBox bounding_box(const MeshView& mesh);

}  // namespace manip3d
