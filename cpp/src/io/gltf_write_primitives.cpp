#include "io/gltf_write_primitives.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <tuple>
#include <utility>

#include "io/colors.hpp"
#include "io/gltf_document.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kMaxSteps = 65535.0;

/// Faces whose corners have the same kinds of attributes.
struct FaceGroup {
  std::int32_t material;
  bool has_texcoords;
  bool has_normals;
  std::vector<std::int32_t> faces;
};

/// A vertex of a primitive, for one corner or several equal ones.
struct SplitVertex {
  std::int32_t vertex;
  std::int32_t texcoord;
  std::int32_t normal;
  std::int32_t next;  ///< Next split of the same vertex of the mesh; -1: none.
};

/// Vertices and faces of a primitive.
struct SplitFaces {
  std::vector<SplitVertex> vertices;
  std::vector<std::uint32_t> indices;  ///< Index into `vertices` of each corner.
};

bool face_has_normals(const MeshView& mesh, Eigen::Index face) {
  if (mesh.face_normals.rows() == 0) return false;
  for (int c = 0; c < 3; ++c) {
    const std::int32_t n = mesh.face_normals(face, c);
    // glTF requires unit length
    if (n < 0 || !(mesh.normals.row(n).squaredNorm() > 0.0)) return false;
  }
  return true;
}

/// Groups the faces, in the order of the first face of each group.
std::vector<FaceGroup> group_faces(const MeshView& mesh, std::size_t num_materials) {
  std::vector<FaceGroup> groups;
  std::map<std::tuple<std::int32_t, bool, bool>, std::size_t> known;
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f) {
    const std::int32_t material = mesh.has_materials() ? mesh.face_material[f] : -1;
    if (material >= static_cast<std::int64_t>(num_materials)) {
      throw InputError("face_material: expected indices below " + std::to_string(num_materials) +
                       " (the number of materials), got " + std::to_string(material) + " at row " +
                       std::to_string(f));
    }
    const bool uv = mesh.face_has_texcoords(f);
    const bool normals = face_has_normals(mesh, f);
    const auto [group, is_new] = known.try_emplace({material, uv, normals}, groups.size());
    if (is_new) groups.push_back({material, uv, normals, {}});
    groups[group->second].faces.push_back(static_cast<std::int32_t>(f));
  }
  return groups;
}

std::array<float, 256> linear_light() {
  std::array<float, 256> table{};
  for (std::size_t i = 0; i < table.size(); ++i) {
    table[i] = static_cast<float>(linear_from_srgb(static_cast<std::int32_t>(i)));
  }
  return table;
}

template <typename T>
std::string_view bytes_of(const std::vector<T>& values) {
  return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)};
}

void check_float32(const std::vector<float>& values, const char* name) {
  if (std::all_of(values.begin(), values.end(), [](float x) { return std::isfinite(x); })) return;
  throw InputError(std::string(name) + ": glTF holds float32, whose range a value exceeds");
}

/// Splits vertices of a mesh whose corners have different texture coordinates or normals.
class VertexSplitter {
 public:
  /// @param max_vertices  Largest number in a primitive; 0: no limit.
  VertexSplitter(const MeshView& mesh, std::int64_t max_vertices)
      : mesh_(mesh), max_vertices_(max_vertices), chains_(mesh.num_vertices(), -1) {}

  /// Takes faces of a group from `face` on, as many as the limit of vertices allows, and advances
  /// `face`.
  SplitFaces split(const FaceGroup& group, std::size_t& face) {
    const std::size_t most = max_vertices_ > 0 ? static_cast<std::size_t>(max_vertices_)
                                               : std::numeric_limits<std::size_t>::max();
    SplitFaces faces;
    faces.indices.reserve(3 * (group.faces.size() - face));
    for (; face < group.faces.size() && faces.vertices.size() <= most - 3; ++face) {
      const std::int32_t f = group.faces[face];
      for (int c = 0; c < 3; ++c) {
        faces.indices.push_back(split_of(faces.vertices, mesh_.faces(f, c),
                                         group.has_texcoords ? mesh_.face_texcoords(f, c) : -1,
                                         group.has_normals ? mesh_.face_normals(f, c) : -1));
      }
    }
    for (const SplitVertex& split : faces.vertices) chains_[split.vertex] = -1;
    return faces;
  }

 private:
  std::uint32_t split_of(std::vector<SplitVertex>& splits, std::int32_t vertex,
                         std::int32_t texcoord, std::int32_t normal) {
    std::int32_t& chain = chains_[vertex];
    for (std::int32_t i = chain; i >= 0; i = splits[i].next) {
      const SplitVertex& split = splits[i];
      if (split.texcoord == texcoord && split.normal == normal) {
        return static_cast<std::uint32_t>(i);
      }
    }
    splits.push_back({vertex, texcoord, normal, chain});
    chain = static_cast<std::int32_t>(splits.size()) - 1;
    return static_cast<std::uint32_t>(chain);
  }

  const MeshView& mesh_;
  std::int64_t max_vertices_;
  std::vector<std::int32_t> chains_;  ///< Per vertex of the mesh: its latest split; -1: none.
};

/// Writes a primitive and its accessors into a scene.
class PrimitiveWriter {
 public:
  PrimitiveWriter(GltfScene& scene, const SceneTriangles& triangles, const PositionFrame& frame,
                  const FaceGroup& group, const SplitFaces& faces)
      : scene_(scene),
        mesh_(triangles.mesh),
        deformation_(triangles.deformation),
        more_texcoords_(triangles.more_texcoords),
        alphas_(triangles.alphas),
        frame_(frame),
        group_(group),
        vertices_(faces.vertices),
        indices_(faces.indices) {}

  /// Writes the primitive without its material.
  Json write() {
    Json attributes;
    attributes["POSITION"] = write_positions();
    if (group_.has_normals) attributes["NORMAL"] = write_normals();
    if (group_.has_texcoords) attributes["TEXCOORD_0"] = write_texcoords();
    write_more_texcoords(attributes);
    if (mesh_.colors.rows() > 0) attributes["COLOR_0"] = write_colors();
    write_joints(attributes);
    Json primitive = {{"attributes", std::move(attributes)}, {"indices", write_indices()}};
    for (std::int64_t t = 0; t < deformation_.num_targets; ++t) {
      Json target = {{"POSITION", write_moves(deformation_.targets, t, "targets")}};
      if (group_.has_normals && !deformation_.target_normals.empty()) {
        target["NORMAL"] = write_moves(deformation_.target_normals, t, "target_normals");
      }
      primitive["targets"].push_back(std::move(target));
    }
    return primitive;
  }

 private:
  std::size_t write_accessor(std::string_view bytes, GltfType type, std::size_t count,
                             const char* shape, std::size_t stride = 0) {
    Json accessor = {{"bufferView", scene_.add_buffer_view(bytes, stride)},
                     {"componentType", static_cast<int>(type)},
                     {"count", count},
                     {"type", shape}};
    scene_.json["accessors"].push_back(std::move(accessor));
    return scene_.json["accessors"].size() - 1;
  }

  std::size_t write_normalized(std::string_view bytes, GltfType type, const char* shape,
                               std::size_t stride = 0) {
    const std::size_t index = write_accessor(bytes, type, vertices_.size(), shape, stride);
    scene_.json["accessors"][index]["normalized"] = true;
    return index;
  }

  /// Converts a value in [0, 1] to a normalised 16-bit integer.
  static std::uint16_t in_16_bits(double value) {
    return static_cast<std::uint16_t>(std::clamp(value, 0.0, 1.0) * kMaxSteps + 0.5);
  }

  // The integers are not marked as normalised, because trimesh 5 would not divide them.
  std::size_t write_quantized_positions() {
    // four per vertex, because elements begin at multiples of 4 bytes
    std::vector<std::uint16_t> values;
    values.reserve(4 * vertices_.size());
    std::array<std::uint16_t, 3> low{65535, 65535, 65535}, high{};
    for (const SplitVertex& split : vertices_) {
      for (int axis = 0; axis < 3; ++axis) {
        const double offset = mesh_.vertices(split.vertex, axis) - frame_.origin[axis];
        const double steps = std::floor(offset / frame_.scale + 0.5);
        const auto value = static_cast<std::uint16_t>(std::clamp(steps, 0.0, kMaxSteps));
        values.push_back(value);
        low[axis] = std::min(low[axis], value);
        high[axis] = std::max(high[axis], value);
      }
      values.push_back(0);
    }
    const std::size_t index =
        write_accessor(bytes_of(values), GltfType::kUnsignedShort, vertices_.size(), "VEC3", 8);
    scene_.json["accessors"][index]["min"] = low;
    scene_.json["accessors"][index]["max"] = high;
    return index;
  }

  std::size_t write_positions() {
    if (frame_.is_quantized()) return write_quantized_positions();
    std::vector<float> values;
    values.reserve(3 * vertices_.size());
    constexpr float kHuge = std::numeric_limits<float>::max();
    Eigen::Vector3f low = Eigen::Vector3f::Constant(kHuge);
    Eigen::Vector3f high = -low;
    for (const SplitVertex& split : vertices_) {
      const Eigen::Vector3f p =
          (mesh_.vertices.row(split.vertex).transpose() - frame_.origin).cast<float>();
      values.insert(values.end(), p.data(), p.data() + 3);
      low = low.cwiseMin(p);
      high = high.cwiseMax(p);
    }
    check_float32(values, "vertices");
    const std::size_t index =
        write_accessor(bytes_of(values), GltfType::kFloat, vertices_.size(), "VEC3");
    scene_.json["accessors"][index]["min"] = {low.x(), low.y(), low.z()};
    scene_.json["accessors"][index]["max"] = {high.x(), high.y(), high.z()};
    return index;
  }

  std::size_t write_quantized_normals() {
    std::vector<std::int8_t> values;
    values.reserve(4 * vertices_.size());
    for (const SplitVertex& split : vertices_) {
      const Eigen::Vector3d unit =
          Eigen::Vector3d(mesh_.normals.row(split.normal).transpose()).stableNormalized();
      for (int axis = 0; axis < 3; ++axis) {
        values.push_back(static_cast<std::int8_t>(std::lround(127.0 * unit[axis])));
      }
      values.push_back(0);
    }
    return write_normalized(bytes_of(values), GltfType::kByte, "VEC3", 4);
  }

  std::size_t write_normals() {
    if (frame_.is_quantized()) return write_quantized_normals();
    std::vector<float> values;
    values.reserve(3 * vertices_.size());
    for (const SplitVertex& split : vertices_) {
      const Eigen::Vector3d normal = mesh_.normals.row(split.normal).transpose();
      const Eigen::Vector3f unit = normal.stableNormalized().cast<float>();
      values.insert(values.end(), unit.data(), unit.data() + 3);
    }
    return write_accessor(bytes_of(values), GltfType::kFloat, vertices_.size(), "VEC3");
  }

  /// Are all texture coordinates in [0, 1]? Those of repeated textures stay float32.
  [[nodiscard]] bool is_within_picture() const {
    return std::ranges::all_of(vertices_, [&](const SplitVertex& split) {
      const auto uv = mesh_.texcoords.row(split.texcoord);
      return uv.minCoeff() >= 0.0 && uv.maxCoeff() <= 1.0;
    });
  }

  std::size_t write_quantized_texcoords() {
    std::vector<std::uint16_t> values;
    values.reserve(2 * vertices_.size());
    for (const SplitVertex& split : vertices_) {
      values.push_back(in_16_bits(mesh_.texcoords(split.texcoord, 0)));
      values.push_back(in_16_bits(1.0 - mesh_.texcoords(split.texcoord, 1)));
    }
    return write_normalized(bytes_of(values), GltfType::kUnsignedShort, "VEC2");
  }

  std::size_t write_texcoords() {
    if (frame_.is_quantized() && is_within_picture()) return write_quantized_texcoords();
    std::vector<float> values;
    values.reserve(2 * vertices_.size());
    for (const SplitVertex& split : vertices_) {
      values.push_back(static_cast<float>(mesh_.texcoords(split.texcoord, 0)));
      values.push_back(static_cast<float>(1.0 - mesh_.texcoords(split.texcoord, 1)));
    }
    check_float32(values, "texcoords");
    return write_accessor(bytes_of(values), GltfType::kFloat, vertices_.size(), "VEC2");
  }

  // Colours are written as floats: trimesh 5 takes 16-bit colours modulo 256, and 8 bits of linear
  // light represent only 183 of the 256 sRGB values.
  std::size_t write_colors() {
    static const std::array<float, 256> kLinear = linear_light();
    std::vector<float> values;
    values.reserve((alphas_.empty() ? 3 : 4) * vertices_.size());
    for (const SplitVertex& split : vertices_) {
      for (int c = 0; c < 3; ++c) values.push_back(kLinear[mesh_.colors(split.vertex, c)]);
      if (!alphas_.empty()) values.push_back(std::clamp(alphas_[split.vertex], 0.0F, 1.0F));
    }
    check_float32(values, "alphas");
    return write_accessor(bytes_of(values), GltfType::kFloat, vertices_.size(),
                          alphas_.empty() ? "VEC3" : "VEC4");
  }

  /// Writes TEXCOORD_1, ... up to the first set that no vertex of the primitive has.
  void write_more_texcoords(Json& attributes) {
    for (std::int64_t set = 0; set < more_texcoords_.num_sets; ++set) {
      std::vector<float> values;
      values.reserve(2 * vertices_.size());
      bool is_given = false;
      for (const SplitVertex& split : vertices_) {
        const std::int64_t row = 2 * (split.vertex * more_texcoords_.num_sets + set);
        for (std::int64_t i = row; i < row + 2; ++i) {
          const float value = more_texcoords_.values[i];
          is_given = is_given || !std::isnan(value);
          values.push_back(std::isnan(value) ? 0.0F : value);
        }
      }
      if (!is_given) return;
      check_float32(values, "more_texcoords");
      attributes["TEXCOORD_" + std::to_string(set + 1)] =
          write_accessor(bytes_of(values), GltfType::kFloat, vertices_.size(), "VEC2");
    }
  }

  /// Writes JOINTS_n and WEIGHTS_n with four joints each.
  void write_joints(Json& attributes) {
    for (std::int64_t first = 0; first < deformation_.num_influences; first += 4) {
      std::vector<std::uint16_t> joints;
      std::vector<float> weights;
      joints.reserve(4 * vertices_.size());
      weights.reserve(4 * vertices_.size());
      for (const SplitVertex& split : vertices_) {
        const std::int64_t row = split.vertex * deformation_.num_influences + first;
        for (std::int64_t i = row; i < row + 4; ++i) {
          joints.push_back(deformation_.joints[i]);
          weights.push_back(deformation_.weights[i]);
        }
      }
      check_float32(weights, "weights");
      const std::string set = std::to_string(first / 4);
      attributes["JOINTS_" + set] =
          write_accessor(bytes_of(joints), GltfType::kUnsignedShort, vertices_.size(), "VEC4");
      attributes["WEIGHTS_" + set] =
          write_accessor(bytes_of(weights), GltfType::kFloat, vertices_.size(), "VEC4");
    }
  }

  /// Writes the displacements of a morph target. Most targets move a small part of the vertices: a
  /// sparse accessor without the zero rows is written if it is shorter.
  std::size_t write_moves(std::span<const float> table, std::int64_t target, const char* name) {
    const float* rows = table.data() + 3 * target * mesh_.num_vertices();
    std::vector<float> values, moved_values;
    std::vector<std::uint32_t> moved;
    Eigen::Vector3f low = Eigen::Vector3f::Zero(), high = Eigen::Vector3f::Zero();
    for (std::size_t i = 0; i < vertices_.size(); ++i) {
      const Eigen::Map<const Eigen::Vector3f> row(rows + 3 * std::int64_t{vertices_[i].vertex});
      low = i == 0 ? Eigen::Vector3f(row) : low.cwiseMin(row);
      high = i == 0 ? Eigen::Vector3f(row) : high.cwiseMax(row);
      values.insert(values.end(), row.data(), row.data() + 3);
      if (row.isZero(0.0F)) continue;
      moved.push_back(static_cast<std::uint32_t>(i));
      moved_values.insert(moved_values.end(), row.data(), row.data() + 3);
    }
    check_float32(values, name);
    // 16 bytes per row instead of 12
    const bool is_sparse = 4 * moved.size() < 3 * vertices_.size();
    const std::size_t index =
        is_sparse ? write_sparse(moved, moved_values)
                  : write_accessor(bytes_of(values), GltfType::kFloat, vertices_.size(), "VEC3");
    scene_.json["accessors"][index]["min"] = {low.x(), low.y(), low.z()};
    scene_.json["accessors"][index]["max"] = {high.x(), high.y(), high.z()};
    return index;
  }

  std::size_t write_sparse(const std::vector<std::uint32_t>& rows,
                           const std::vector<float>& values) {
    Json accessor = {{"componentType", static_cast<int>(GltfType::kFloat)},
                     {"count", vertices_.size()},
                     {"type", "VEC3"}};
    if (!rows.empty()) {
      accessor["sparse"] = {{"count", rows.size()},
                            {"indices",
                             {{"bufferView", scene_.add_buffer_view(bytes_of(rows))},
                              {"componentType", static_cast<int>(GltfType::kUnsignedInt)}}},
                            {"values", {{"bufferView", scene_.add_buffer_view(bytes_of(values))}}}};
    }
    scene_.json["accessors"].push_back(std::move(accessor));
    return scene_.json["accessors"].size() - 1;
  }

  std::size_t write_indices() {
    // 65535 would be the primitive restart value of 16-bit indices.
    if (vertices_.size() <= std::numeric_limits<std::uint16_t>::max()) {
      const std::vector<std::uint16_t> narrow(indices_.begin(), indices_.end());
      return write_accessor(bytes_of(narrow), GltfType::kUnsignedShort, narrow.size(), "SCALAR");
    }
    return write_accessor(bytes_of(indices_), GltfType::kUnsignedInt, indices_.size(), "SCALAR");
  }

  GltfScene& scene_;
  const MeshView& mesh_;
  const DeformationView& deformation_;
  const MoreTexcoordsView& more_texcoords_;
  std::span<const float> alphas_;
  const PositionFrame& frame_;
  const FaceGroup& group_;
  const std::vector<SplitVertex>& vertices_;
  const std::vector<std::uint32_t>& indices_;
};

}  // namespace

PositionFrame quantized_frame(const std::vector<const MeshView*>& levels) {
  BoundingBox all = bounding_box(*levels.front());
  for (const MeshView* level : levels) {
    const BoundingBox box = bounding_box(*level);
    all.min = all.min.cwiseMin(box.min);
    all.max = all.max.cwiseMax(box.max);
  }
  const double side = (all.max - all.min).maxCoeff();
  const double farthest = std::max(all.min.cwiseAbs().maxCoeff(), all.max.cwiseAbs().maxCoeff());
  if (!(farthest <= double{std::numeric_limits<float>::max()})) {
    throw InputError("vertices: expected values that float32 can hold");
  }
  if (!(side > 0.0)) return {all.min, 1.0};
  const double least = std::max(side / (kMaxSteps - 1.0), std::numeric_limits<double>::min());
  const double scale = std::exp2(std::ceil(std::log2(least)));
  return {(all.min.array() / scale).floor() * scale, scale};
}

void PrimitiveOptions::check() const {
  if (max_vertices != 0 && max_vertices < 3) {
    throw InputError("max_vertices: expected at least 3, got " + std::to_string(max_vertices));
  }
}

Json write_primitives(GltfScene& scene, const SceneTriangles& triangles,
                      const PrimitiveOptions& options) {
  options.check();
  const MeshView& mesh = triangles.mesh;
  check_mesh(mesh);
  triangles.deformation.check(mesh.num_vertices());
  triangles.more_texcoords.check(mesh.num_vertices());
  if (!triangles.alphas.empty() && std::ssize(triangles.alphas) != mesh.num_vertices()) {
    throw InputError("alphas: expected " + std::to_string(mesh.num_vertices()) +
                     " (one for each vertex), got " + std::to_string(triangles.alphas.size()));
  }
  if (mesh.num_faces() == 0) throw InputError("mesh: glTF cannot hold a mesh without faces");
  VertexSplitter splitter(mesh, options.max_vertices);
  Json primitives = Json::array();
  for (const FaceGroup& group : group_faces(mesh, options.num_materials)) {
    for (std::size_t face = 0; face < group.faces.size();) {
      const SplitFaces faces = splitter.split(group, face);
      Json primitive = PrimitiveWriter(scene, triangles, options.frame, group, faces).write();
      if (group.material >= 0) {
        primitive["material"] = options.material_of
                                    ? options.material_of(group.material, group.has_texcoords)
                                    : group.material;
      }
      primitives.push_back(std::move(primitive));
    }
  }
  return primitives;
}

}  // namespace manip3d
