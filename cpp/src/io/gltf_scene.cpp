#include "io/gltf_scene.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <limits>
#include <map>
#include <numeric>
#include <string>
#include <tuple>
#include <utility>

#include "io/colors.hpp"
#include "io/gltf_document.hpp"
#include "io/warnings.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

using Json = nlohmann::ordered_json;

/// Corners of these faces carry the same kinds of attributes.
struct Group {
  std::int32_t material;
  bool has_texcoords;
  bool has_normals;
  std::vector<std::int32_t> faces;
};

/// A vertex of a primitive: what one corner, or several alike, point to.
struct Split {
  std::int32_t vertex;
  std::int32_t texcoord;
  std::int32_t normal;
  std::int32_t next;  ///< Another split of the same vertex, or -1.
};

bool face_has_normals(const MeshView& mesh, Eigen::Index face) {
  if (mesh.face_normals.rows() == 0) return false;
  for (int c = 0; c < 3; ++c) {
    const std::int32_t n = mesh.face_normals(face, c);
    if (n < 0 || !(mesh.normals.row(n).squaredNorm() > 0.0)) return false;  // glTF: unit length
  }
  return true;
}

/// Groups in the order of their first faces.
std::vector<Group> group_faces(const MeshView& mesh, std::size_t num_materials) {
  std::vector<Group> groups;
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

/// Origin for which float32 holds the mesh: 0 if that will do.
Eigen::Vector3d origin_for_float32(const MeshView& mesh) {
  constexpr double kRelativeLoss = 1e-6;
  constexpr double kHalfUlp = 1.0 / (1 << 24);  // relative rounding error of float32
  constexpr double kSmallest = 1e-38;           // below it float32 itself loses kRelativeLoss
  const BoundingBox box = bounding_box(mesh);
  if (box.diagonal() > 0.0 && box.diagonal() < kSmallest) {
    throw InputError("vertices: glTF holds float32, too coarse for a mesh of diagonal " +
                     std::to_string(box.diagonal() / kSmallest) + "e-38");
  }
  const double farthest = std::max(box.min.cwiseAbs().maxCoeff(), box.max.cwiseAbs().maxCoeff());
  if (!(farthest * kHalfUlp > kRelativeLoss * box.diagonal())) return Eigen::Vector3d::Zero();
  return box.center().cast<float>().cast<double>();  // exact for readers with float32 nodes too
}

constexpr double kMostSteps = 65535.0;
constexpr const char* kQuantization = "KHR_mesh_quantization";

using GltfMaterialOf = std::function<std::int64_t(std::int32_t material, bool has_texcoords)>;

/// Writes the triangles of meshes into a scene's accessors.
class PrimitiveWriter {
 public:
  PrimitiveWriter(GltfScene& scene, PositionFrame frame, std::int64_t max_vertices,
                  std::size_t num_materials, GltfMaterialOf material_of)
      : scene_(scene),
        frame_(std::move(frame)),
        max_vertices_(max_vertices),
        num_materials_(num_materials),
        material_of_(std::move(material_of)) {
    if (max_vertices != 0 && max_vertices < 3) {
      throw InputError("max_vertices: expected at least 3, got " + std::to_string(max_vertices));
    }
  }

  Json primitives(const MeshView& mesh, const DeformationView& deformation = {},
                  const MoreTexcoordsView& more_texcoords = {}) {
    check_mesh(mesh);
    deformation.check(mesh.num_vertices());
    more_texcoords.check(mesh.num_vertices());
    if (mesh.num_faces() == 0) throw InputError("mesh: glTF cannot hold a mesh without faces");
    mesh_ = &mesh;
    deformation_ = deformation;
    more_texcoords_ = more_texcoords;
    chains_.assign(mesh.num_vertices(), -1);
    Json primitives = Json::array();
    for (const Group& group : group_faces(mesh, num_materials_)) {
      for (std::size_t face = 0; face < group.faces.size();) {
        primitives.push_back(write_primitive(group, face));
      }
    }
    return primitives;
  }

 private:
  /// The faces of a group from `face` on, as many as the limit of vertices allows.
  Json write_primitive(const Group& group, std::size_t& face) {
    const std::vector<std::uint32_t> indices = split_vertices(group, face);
    Json attributes;
    attributes["POSITION"] = write_positions();
    if (group.has_normals) attributes["NORMAL"] = write_normals();
    if (group.has_texcoords) attributes["TEXCOORD_0"] = write_texcoords();
    write_more_texcoords(attributes);
    if (mesh_->colors.rows() > 0) attributes["COLOR_0"] = write_colors();
    write_joints(attributes);
    Json primitive = {{"attributes", std::move(attributes)}, {"indices", write_indices(indices)}};
    for (std::int64_t t = 0; t < deformation_.num_targets; ++t) {
      Json target = {{"POSITION", write_moves(deformation_.targets, t, "targets")}};
      if (group.has_normals && !deformation_.target_normals.empty()) {
        target["NORMAL"] = write_moves(deformation_.target_normals, t, "target_normals");
      }
      primitive["targets"].push_back(std::move(target));
    }
    if (group.material >= 0) {
      primitive["material"] = material_of_(group.material, group.has_texcoords);
    }
    return primitive;
  }

  /// Fills `splits_`; the indices of the corners into it.
  std::vector<std::uint32_t> split_vertices(const Group& group, std::size_t& face) {
    splits_.clear();
    const std::size_t most = max_vertices_ > 0 ? static_cast<std::size_t>(max_vertices_)
                                               : std::numeric_limits<std::size_t>::max();
    std::vector<std::uint32_t> indices;
    indices.reserve(3 * (group.faces.size() - face));
    for (; face < group.faces.size() && splits_.size() <= most - 3; ++face) {
      const std::int32_t f = group.faces[face];
      for (int c = 0; c < 3; ++c) {
        indices.push_back(split_of(mesh_->faces(f, c),
                                   group.has_texcoords ? mesh_->face_texcoords(f, c) : -1,
                                   group.has_normals ? mesh_->face_normals(f, c) : -1));
      }
    }
    for (const Split& split : splits_) chains_[split.vertex] = -1;
    return indices;
  }

  std::uint32_t split_of(std::int32_t vertex, std::int32_t texcoord, std::int32_t normal) {
    std::int32_t& chain = chains_[vertex];
    for (std::int32_t i = chain; i >= 0; i = splits_[i].next) {
      const Split& split = splits_[i];
      if (split.texcoord == texcoord && split.normal == normal) {
        return static_cast<std::uint32_t>(i);
      }
    }
    splits_.push_back({vertex, texcoord, normal, chain});
    chain = static_cast<std::int32_t>(splits_.size()) - 1;
    return static_cast<std::uint32_t>(chain);
  }

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
    const std::size_t index = write_accessor(bytes, type, splits_.size(), shape, stride);
    scene_.json["accessors"][index]["normalized"] = true;
    return index;
  }

  /// Values in [0, 1] as normalised 16-bit integers.
  static std::uint16_t in_16_bits(double value) {
    return static_cast<std::uint16_t>(std::clamp(value, 0.0, 1.0) * kMostSteps + 0.5);
  }

  // The integers are not normalised: trimesh 5 would not divide them.
  std::size_t write_quantized_positions() {
    std::vector<std::uint16_t> values;  // four to a vertex: elements begin at multiples of 4 bytes
    values.reserve(4 * splits_.size());
    std::array<std::uint16_t, 3> low{65535, 65535, 65535}, high{};
    for (const Split& split : splits_) {
      for (int axis = 0; axis < 3; ++axis) {
        const double offset = mesh_->vertices(split.vertex, axis) - frame_.origin[axis];
        const std::uint16_t value = in_16_bits(offset / frame_.scale / kMostSteps);
        values.push_back(value);
        low[axis] = std::min(low[axis], value);
        high[axis] = std::max(high[axis], value);
      }
      values.push_back(0);
    }
    const std::size_t index =
        write_accessor(bytes_of(values), GltfType::kUnsignedShort, splits_.size(), "VEC3", 8);
    scene_.json["accessors"][index]["min"] = low;
    scene_.json["accessors"][index]["max"] = high;
    return index;
  }

  std::size_t write_positions() {
    if (frame_.is_quantized()) return write_quantized_positions();
    std::vector<float> values;
    values.reserve(3 * splits_.size());
    constexpr float kHuge = std::numeric_limits<float>::max();
    Eigen::Vector3f low = Eigen::Vector3f::Constant(kHuge);
    Eigen::Vector3f high = -low;
    for (const Split& split : splits_) {
      const Eigen::Vector3f p =
          (mesh_->vertices.row(split.vertex).transpose() - frame_.origin).cast<float>();
      values.insert(values.end(), p.data(), p.data() + 3);
      low = low.cwiseMin(p);
      high = high.cwiseMax(p);
    }
    check_float32(values, "vertices");
    const std::size_t index =
        write_accessor(bytes_of(values), GltfType::kFloat, splits_.size(), "VEC3");
    scene_.json["accessors"][index]["min"] = {low.x(), low.y(), low.z()};
    scene_.json["accessors"][index]["max"] = {high.x(), high.y(), high.z()};
    return index;
  }

  std::size_t write_quantized_normals() {
    std::vector<std::int8_t> values;
    values.reserve(4 * splits_.size());
    for (const Split& split : splits_) {
      const Eigen::Vector3d unit =
          Eigen::Vector3d(mesh_->normals.row(split.normal).transpose()).stableNormalized();
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
    values.reserve(3 * splits_.size());
    for (const Split& split : splits_) {
      const Eigen::Vector3d normal = mesh_->normals.row(split.normal).transpose();
      const Eigen::Vector3f unit = normal.stableNormalized().cast<float>();
      values.insert(values.end(), unit.data(), unit.data() + 3);
    }
    return write_accessor(bytes_of(values), GltfType::kFloat, splits_.size(), "VEC3");
  }

  /// Whether all texture coordinates lie within the picture; those of repeated ones stay float32.
  [[nodiscard]] bool is_within_picture() const {
    return std::ranges::all_of(splits_, [&](const Split& split) {
      const auto uv = mesh_->texcoords.row(split.texcoord);
      return uv.minCoeff() >= 0.0 && uv.maxCoeff() <= 1.0;
    });
  }

  std::size_t write_quantized_texcoords() {
    std::vector<std::uint16_t> values;
    values.reserve(2 * splits_.size());
    for (const Split& split : splits_) {
      values.push_back(in_16_bits(mesh_->texcoords(split.texcoord, 0)));
      values.push_back(in_16_bits(1.0 - mesh_->texcoords(split.texcoord, 1)));
    }
    return write_normalized(bytes_of(values), GltfType::kUnsignedShort, "VEC2");
  }

  std::size_t write_texcoords() {
    if (frame_.is_quantized() && is_within_picture()) return write_quantized_texcoords();
    std::vector<float> values;
    values.reserve(2 * splits_.size());
    for (const Split& split : splits_) {
      values.push_back(static_cast<float>(mesh_->texcoords(split.texcoord, 0)));
      values.push_back(static_cast<float>(1.0 - mesh_->texcoords(split.texcoord, 1)));
    }
    check_float32(values, "texcoords");
    return write_accessor(bytes_of(values), GltfType::kFloat, splits_.size(), "VEC2");
  }

  // Floats: trimesh 5 takes 16 bits modulo 256, and 8 bits of linear light hold 183 of the 256 sRGB
  // values.
  std::size_t write_colors() {
    static const std::array<float, 256> kLinear = linear_light();
    std::vector<float> values;
    values.reserve(3 * splits_.size());
    for (const Split& split : splits_) {
      for (int c = 0; c < 3; ++c) values.push_back(kLinear[mesh_->colors(split.vertex, c)]);
    }
    return write_accessor(bytes_of(values), GltfType::kFloat, splits_.size(), "VEC3");
  }

  /// TEXCOORD_1, ... up to the first that no vertex of the primitive has.
  void write_more_texcoords(Json& attributes) {
    for (std::int64_t set = 0; set < more_texcoords_.num_sets; ++set) {
      std::vector<float> values;
      values.reserve(2 * splits_.size());
      bool is_given = false;
      for (const Split& split : splits_) {
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
          write_accessor(bytes_of(values), GltfType::kFloat, splits_.size(), "VEC2");
    }
  }

  /// JOINTS_n and WEIGHTS_n, four joints in each.
  void write_joints(Json& attributes) {
    for (std::int64_t first = 0; first < deformation_.num_influences; first += 4) {
      std::vector<std::uint16_t> joints;
      std::vector<float> weights;
      joints.reserve(4 * splits_.size());
      weights.reserve(4 * splits_.size());
      for (const Split& split : splits_) {
        const std::int64_t row = split.vertex * deformation_.num_influences + first;
        for (std::int64_t i = row; i < row + 4; ++i) {
          joints.push_back(deformation_.joints[i]);
          weights.push_back(deformation_.weights[i]);
        }
      }
      check_float32(weights, "weights");
      const std::string set = std::to_string(first / 4);
      attributes["JOINTS_" + set] =
          write_accessor(bytes_of(joints), GltfType::kUnsignedShort, splits_.size(), "VEC4");
      attributes["WEIGHTS_" + set] =
          write_accessor(bytes_of(weights), GltfType::kFloat, splits_.size(), "VEC4");
    }
  }

  /// What a morph target adds to the vertices. Most targets move a small part of a face: the rows
  /// that are zero are left out where that is shorter (a sparse accessor).
  std::size_t write_moves(std::span<const float> table, std::int64_t target, const char* name) {
    const float* rows = table.data() + 3 * target * mesh_->num_vertices();
    std::vector<float> values, moved_values;
    std::vector<std::uint32_t> moved;
    Eigen::Vector3f low = Eigen::Vector3f::Zero(), high = Eigen::Vector3f::Zero();
    for (std::size_t i = 0; i < splits_.size(); ++i) {
      const Eigen::Map<const Eigen::Vector3f> row(rows + 3 * std::int64_t{splits_[i].vertex});
      low = i == 0 ? Eigen::Vector3f(row) : low.cwiseMin(row);
      high = i == 0 ? Eigen::Vector3f(row) : high.cwiseMax(row);
      values.insert(values.end(), row.data(), row.data() + 3);
      if (row.isZero(0.0F)) continue;
      moved.push_back(static_cast<std::uint32_t>(i));
      moved_values.insert(moved_values.end(), row.data(), row.data() + 3);
    }
    check_float32(values, name);
    const bool is_sparse = 4 * moved.size() < 3 * splits_.size();  // 16 bytes a row for 12
    const std::size_t index =
        is_sparse ? write_sparse(moved, moved_values)
                  : write_accessor(bytes_of(values), GltfType::kFloat, splits_.size(), "VEC3");
    scene_.json["accessors"][index]["min"] = {low.x(), low.y(), low.z()};
    scene_.json["accessors"][index]["max"] = {high.x(), high.y(), high.z()};
    return index;
  }

  std::size_t write_sparse(const std::vector<std::uint32_t>& rows,
                           const std::vector<float>& values) {
    Json accessor = {{"componentType", static_cast<int>(GltfType::kFloat)},
                     {"count", splits_.size()},
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

  std::size_t write_indices(const std::vector<std::uint32_t>& indices) {
    // 65535 would be the primitive restart value of 16-bit indices.
    if (splits_.size() <= std::numeric_limits<std::uint16_t>::max()) {
      const std::vector<std::uint16_t> narrow(indices.begin(), indices.end());
      return write_accessor(bytes_of(narrow), GltfType::kUnsignedShort, narrow.size(), "SCALAR");
    }
    return write_accessor(bytes_of(indices), GltfType::kUnsignedInt, indices.size(), "SCALAR");
  }

  GltfScene& scene_;
  PositionFrame frame_;
  std::int64_t max_vertices_;
  std::size_t num_materials_;
  GltfMaterialOf material_of_;
  const MeshView* mesh_ = nullptr;    ///< The one that is being written.
  DeformationView deformation_;       ///< Its.
  MoreTexcoordsView more_texcoords_;  ///< Its.
  std::vector<Split> splits_;
  std::vector<std::int32_t> chains_;  ///< Per vertex of the mesh: its latest split, or -1.
};

class SceneBuilder {
 public:
  SceneBuilder(const MeshView& mesh, const std::vector<Material>& materials,
               const GltfTextureReader& read_texture, std::vector<std::string>& warnings,
               const WriteOptions& options)
      : materials_(materials), read_texture_(read_texture), warnings_(warnings), options_(options) {
    levels_.push_back(&mesh);
    for (const MeshView& level : options.coarser) levels_.push_back(&level);
    for (const MeshView* level : levels_) check_mesh(*level);
    frame_.origin = origin_for_float32(mesh);
    if (options.quantize) frame_ = quantized_frame(levels_);
  }

  GltfScene build() {
    PrimitiveWriter writer(scene_, frame_, options_.max_vertices, materials_.size(),
                           [this](std::int32_t material, bool has_texcoords) {
                             return has_texcoords ? std::int64_t{material} : untextured(material);
                           });
    scene_.json["asset"] = {{"version", "2.0"}, {"generator", "manip3d " MANIP3D_VERSION}};
    if (levels_.size() > 1) scene_.json["extensionsUsed"].push_back("MSFT_lod");
    if (frame_.is_quantized()) require_quantization(scene_.json);
    scene_.json["scene"] = 0;
    scene_.json["scenes"] = Json::array({{{"nodes", {0}}}});
    for (std::size_t level = 0; level < levels_.size(); ++level) write_node(level);
    for (const Material& material : materials_) write_material(material);
    for (const MeshView* level : levels_) {
      Json primitives = writer.primitives(*level);
      scene_.json["meshes"].push_back({{"primitives", std::move(primitives)}});
    }
    return std::move(scene_);
  }

 private:
  void write_node(std::size_t level) {
    Json node = {{"mesh", level}};
    const Eigen::Vector3d& origin = frame_.origin;
    if (!origin.isZero(0.0)) node["translation"] = {origin.x(), origin.y(), origin.z()};
    if (frame_.is_quantized()) node["scale"] = {frame_.scale, frame_.scale, frame_.scale};
    if (level == 0 && levels_.size() > 1) {
      std::vector<std::size_t> ids(levels_.size() - 1);
      std::iota(ids.begin(), ids.end(), std::size_t{1});
      node["extensions"] = {{"MSFT_lod", {{"ids", ids}}}};
      node["extras"] = {{"MSFT_screencoverage", options_.coverages}};
    }
    scene_.json["nodes"].push_back(std::move(node));
  }

  // --- Materials -------------------------------------------------------------------------

  Json material_factors(const Material& m) {
    Json pbr = {{"baseColorFactor", m.base_color},
                {"metallicFactor", m.metallic},
                {"roughnessFactor", m.roughness}};
    Json material = {{"name", m.name}, {"pbrMetallicRoughness", std::move(pbr)}};
    if (m.alpha_mode == AlphaMode::kBlend) material["alphaMode"] = "BLEND";
    if (m.alpha_mode == AlphaMode::kMask) {
      material["alphaMode"] = "MASK";
      material["alphaCutoff"] = m.alpha_cutoff;
    }
    material["doubleSided"] = m.double_sided;
    return material;
  }

  void write_material(const Material& m) {
    Json material = material_factors(m);
    const auto add = [&](Json& owner, const char* role, const char* key) {
      const auto texture = m.textures.find(role);
      if (texture == m.textures.end() || texture->second.empty()) return;
      const std::int64_t index = texture_index(texture->second);
      if (index >= 0) owner[key] = {{"index", index}};
    };
    add(material["pbrMetallicRoughness"], "base_color", "baseColorTexture");
    add(material["pbrMetallicRoughness"], "metallic_roughness", "metallicRoughnessTexture");
    add(material, "normal", "normalTexture");
    add(material, "occlusion", "occlusionTexture");
    add(material, "emissive", "emissiveTexture");
    const bool has_image = material.contains("emissiveTexture");
    // Without its image, the factor alone would make the whole surface glow.
    if (has_image || !m.textures.contains("emissive")) write_light(material, m, has_image);
    scene_.json["materials"].push_back(std::move(material));
  }

  /// glTF's factor goes up to 1; what is brighter needs an extension.
  void write_light(Json& material, const Material& m, bool has_image) {
    if (!m.emits()) {
      if (has_image) material["emissiveFactor"] = {1.0, 1.0, 1.0};
      return;
    }
    const double strength = std::max({1.0, m.emissive[0], m.emissive[1], m.emissive[2]});
    material["emissiveFactor"] = {m.emissive[0] / strength, m.emissive[1] / strength,
                                  m.emissive[2] / strength};
    if (strength == 1.0) return;
    material["extensions"] = {{kEmissiveStrength, {{"emissiveStrength", strength}}}};
    Json& used = scene_.json["extensionsUsed"];
    if (std::find(used.begin(), used.end(), kEmissiveStrength) == used.end()) {
      used.push_back(kEmissiveStrength);
    }
  }

  /// The material as faces without texture coordinates may have it.
  std::int64_t untextured(std::int32_t index) {
    const Material& m = materials_[index];
    if (m.textures.empty()) return index;
    const auto [copy, is_new] = untextured_.try_emplace(index, scene_.json["materials"].size());
    if (is_new) {
      Json material = material_factors(m);
      if (!m.textures.contains("emissive")) write_light(material, m, false);
      material["extras"] = {{kUntexturedCopyOf, index}};
      scene_.json["materials"].push_back(std::move(material));
    }
    return static_cast<std::int64_t>(copy->second);
  }

  /// Textures that show the same image are one; -1: there is no image. A file is read once.
  std::int64_t texture_index(const Texture& texture) {
    if (!texture.data.empty()) return index_of_image(texture);
    const auto [known, is_new] = index_of_path_.try_emplace(texture.path, -1);
    if (is_new) known->second = index_of_image(texture);
    return known->second;
  }

  std::int64_t index_of_image(const Texture& texture) {
    std::string data = read_texture_(texture);
    const char* mime_type = mime_type_of(data);
    if (mime_type == nullptr) {
      if (!data.empty()) {
        warn(warnings_,
             "texture '" + texture.path + "' is not a PNG or JPEG image and was left out");
      }
      return -1;
    }
    const auto known = std::find_if(scene_.images.begin(), scene_.images.end(),
                                    [&](const GltfImage& image) { return image.data == data; });
    if (known != scene_.images.end()) return known - scene_.images.begin();
    const std::size_t index = scene_.images.size();
    scene_.images.push_back({std::move(data), mime_type, texture.path});
    scene_.json["textures"].push_back({{"source", index}});
    scene_.json["images"].push_back(Json::object());
    return static_cast<std::int64_t>(index);
  }

  static const char* mime_type_of(std::string_view data) {
    if (data.starts_with("\x89PNG\r\n\x1A\n")) return "image/png";
    if (data.starts_with("\xFF\xD8\xFF")) return "image/jpeg";
    return nullptr;
  }

  std::vector<const MeshView*> levels_;
  const std::vector<Material>& materials_;
  const GltfTextureReader& read_texture_;
  std::vector<std::string>& warnings_;
  const WriteOptions& options_;
  PositionFrame frame_;
  GltfScene scene_;
  std::map<std::int32_t, std::size_t> untextured_;
  std::map<std::string, std::int64_t> index_of_path_;
};

}  // namespace

std::size_t GltfScene::add_buffer_view(std::string_view bytes, std::size_t stride) {
  buffer.resize((buffer.size() + 3) / 4 * 4, '\0');
  json["bufferViews"].push_back(
      {{"buffer", 0}, {"byteOffset", buffer.size()}, {"byteLength", bytes.size()}});
  if (stride > 0) json["bufferViews"].back()["byteStride"] = stride;
  buffer += bytes;
  return json["bufferViews"].size() - 1;
}

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
  return {all.min, side > 0.0 ? side / kMostSteps : 1.0};
}

void require_quantization(Json& document) {
  for (const char* list : {"extensionsUsed", "extensionsRequired"}) {
    Json& names = document[list];
    if (std::find(names.begin(), names.end(), kQuantization) == names.end()) {
      names.push_back(kQuantization);
    }
  }
}

Json write_primitives(GltfScene& scene, const SceneTriangles& triangles, std::size_t num_materials,
                      std::int64_t max_vertices, const PositionFrame& frame) {
  return PrimitiveWriter(scene, frame, max_vertices, num_materials,
                         [](std::int32_t material, bool) { return std::int64_t{material}; })
      .primitives(triangles.mesh, triangles.deformation, triangles.more_texcoords);
}

GltfScene build_gltf(const MeshView& mesh, const std::vector<Material>& materials,
                     const GltfTextureReader& read_texture, std::vector<std::string>& warnings,
                     const WriteOptions& options) {
  return SceneBuilder(mesh, materials, read_texture, warnings, options).build();
}

}  // namespace manip3d
