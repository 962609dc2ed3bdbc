#include "io/gltf_triangles.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <tuple>
#include <utility>

#include "io/colors.hpp"
#include "io/gltf_primitives.hpp"
#include "io/leave_out_nan.hpp"
#include "io/warnings.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

// Bytes per row in the tables of the mesh, with temporary ones.
constexpr std::int64_t kVertexBytes = 24;
constexpr std::int64_t kTexcoordBytes = 16;
constexpr std::int64_t kColorBytes = 3 + 32;  // and four doubles while it is decoded
constexpr std::int64_t kFaceBytes = 40;       // vertices, texcoords, normals, material

/// The morph targets that change an attribute: accessors with weights. The rows of each, times its
/// nonzero weight, are added to those of the attribute.
using Morph = std::vector<std::pair<const GltfAccessor*, double>>;

/// First row of a block in a table. Primitives with the same accessor share its rows: the first of
/// them owns and fills them.
struct TableRows {
  std::int64_t first = 0;
  bool are_owned = false;
};

/// A primitive of an instance, with its rows in the tables of the mesh.
struct Draw {
  const GltfPrimitive* primitive;
  const GltfTransform* transform;
  std::int64_t first_face = 0;
  TableRows vertices = {};
  TableRows texcoords = {};
  TableRows normals = {};
  const std::vector<GltfTransform>* joints = nullptr;
  Morph vertex_morph = {};
  Morph normal_morph = {};
};

/// Sizes of all tables, which are planned before any of them is allocated.
struct Plan {
  /// By mesh; `draws` point to these.
  std::map<std::int64_t, std::vector<GltfPrimitive>> primitives;
  std::vector<Draw> draws;
  bool with_colors = false;
  std::int64_t num_vertices = 0;
  std::int64_t num_texcoords = 0;
  std::int64_t num_normals = 0;
  std::int64_t num_faces = 0;
};

/// The matrix of cofactors of a linear map, negated if the map mirrors: the inverse transpose times
/// the absolute determinant, which also exists for singular maps.
Eigen::Matrix3d cofactors_of(const Eigen::Matrix3d& m) {
  Eigen::Matrix3d cofactors;
  cofactors << m.col(1).cross(m.col(2)), m.col(2).cross(m.col(0)), m.col(0).cross(m.col(1));
  return m.determinant() < 0.0 ? Eigen::Matrix3d(-cofactors) : cofactors;
}

/// Adds the morph targets to rows of three numbers.
void add_morph(const Morph& morph, double* rows) {
  for (const auto& [added, weight] : morph) {
    std::vector<double> values(3 * added->count);
    added->decode(values.data());
    for (std::size_t i = 0; i < values.size(); ++i) rows[i] += weight * values[i];
  }
}

class Planner {
 public:
  Planner(GltfDocument& document, GltfTexcoords texcoords, GltfBudget& budget,
          std::vector<std::string>& warnings)
      : document_(document), texcoords_(texcoords), budget_(budget), warnings_(warnings) {}

  Plan plan(const std::vector<GltfInstance>& instances) {
    for (const GltfInstance& instance : instances) {
      for (const GltfPrimitive& p : primitives_of(instance.mesh)) {
        budget_.charge(sizeof(Draw), p.place.pointer());
        plan_.with_colors = plan_.with_colors || p.color != nullptr;
      }
    }
    for (const GltfInstance& instance : instances) add_instance(instance);
    // Limit that keeps the numbers of a table of three columns within an int32.
    constexpr std::int64_t kMaxRows = std::numeric_limits<std::int32_t>::max() / 3;
    if (std::max({plan_.num_vertices, plan_.num_faces, plan_.num_normals, plan_.num_texcoords}) >
        kMaxRows) {
      throw FormatError::at_byte(
          0, "the scene has more than " + std::to_string(kMaxRows) + " vertices or faces");
    }
    return std::move(plan_);
  }

 private:
  const std::vector<GltfPrimitive>& primitives_of(std::int64_t mesh) {
    const auto [known, is_new] = plan_.primitives.try_emplace(mesh);
    if (is_new) known->second = read_primitives(document_, mesh, texcoords_, warnings_);
    return known->second;
  }

  void add_instance(const GltfInstance& instance) {
    std::map<std::tuple<const GltfAccessor*, const GltfAccessor*, Morph, const GltfAccessor*,
                        std::vector<const GltfAccessor*>>,
             std::int64_t>
        vertices;
    std::map<std::tuple<const GltfAccessor*, Morph, const GltfAccessor*>, std::int64_t> normals;
    const std::vector<double> weights = default_weights(instance);
    for (const GltfPrimitive& p : primitives_of(instance.mesh)) {
      Draw draw{.primitive = &p, .transform = &instance.transform, .first_face = plan_.num_faces};
      draw.vertex_morph = morph_of(p, weights, "POSITION", p.position);
      draw.normal_morph = morph_of(p, weights, "NORMAL", p.normal);
      warn_of_targets(p, instance, weights);
      const GltfAccessor* moved_by = nullptr;
      if (instance.joints != nullptr) {
        moved_by = document_.attribute(p.place.member("attributes"), "JOINTS_0", 4, 4);
        if (moved_by != nullptr) draw.joints = instance.joints;
      }
      // Appends rows for `key` to a table with `count` rows, unless it has rows already.
      const auto claim = [&](auto& table, auto key, std::int64_t& count, std::int64_t bytes) {
        const auto [row, is_new] = table.try_emplace(std::move(key), count);
        if (is_new) {
          budget_.charge(p.position->count, bytes, p.place.pointer());
          count += p.position->count;
        }
        return TableRows{row->second, is_new};
      };
      draw.vertices =
          claim(vertices,
                std::tuple(p.position, plan_.with_colors ? p.color : nullptr, draw.vertex_morph,
                           moved_by, p.more_texcoords),
                plan_.num_vertices, kVertexBytes + (plan_.with_colors ? kColorBytes : 0));
      if (p.texcoord != nullptr) {
        draw.texcoords = claim(texcoord_rows_, std::pair(p.texcoord, p.texture),
                               plan_.num_texcoords, kTexcoordBytes);
      }
      if (p.normal != nullptr) {
        draw.normals = claim(normals, std::tuple(p.normal, draw.normal_morph, moved_by),
                             plan_.num_normals, kVertexBytes);
      }
      budget_.charge(p.num_corners(), sizeof(std::uint32_t), p.place.pointer());
      budget_.charge(p.num_faces(), kFaceBytes, p.place.pointer());
      plan_.num_faces += p.num_faces();
      plan_.draws.push_back(std::move(draw));
    }
  }

  /// The default weights of an instance's morph targets; empty: no deformation.
  std::vector<double> default_weights(const GltfInstance& instance) {
    std::vector<double> weights;
    if (!instance.weights) return weights;
    const std::int64_t size = instance.weights->size();
    budget_.charge(size, sizeof(double), instance.weights->pointer());
    for (std::int64_t t = 0; t < size; ++t) {
      weights.push_back(instance.weights->item(t).number());
    }
    const auto is_zero = [](double weight) { return weight == 0.0; };
    if (std::all_of(weights.begin(), weights.end(), is_zero)) weights.clear();
    return weights;
  }

  /// The morph targets that change an attribute of a primitive in the default shape.
  Morph morph_of(const GltfPrimitive& p, const std::vector<double>& weights, const char* name,
                 const GltfAccessor* base) {
    Morph morph;
    if (!p.targets || base == nullptr) return morph;
    const std::int64_t size = std::min<std::int64_t>(p.targets->size(), std::ssize(weights));
    for (std::int64_t t = 0; t < size; ++t) {
      if (weights[t] == 0.0) continue;
      const GltfAccessor* added = document_.attribute(p.targets->item(t), name, 3, 3);
      if (added == nullptr) continue;
      if (added->count != base->count) {
        added->place.fail("has " + std::to_string(added->count) + " elements, " + name + " of " +
                          p.place.pointer() + " " + std::to_string(base->count));
      }
      budget_.charge(base->count + 1, kVertexBytes, p.place.pointer());
      morph.emplace_back(added, weights[t]);
    }
    return morph;
  }

  void warn_of_targets(const GltfPrimitive& p, const GltfInstance& instance,
                       const std::vector<double>& weights) {
    if (!p.targets) return;
    if (weights.empty()) return warn(warnings_, "morph targets are left out");
    warn(warnings_, "morph targets are left out; meshes have the shape of their default weights");
    if (p.targets->size() != std::ssize(weights)) {
      warn(warnings_, instance.weights->pointer() + ": expected " +
                          std::to_string(p.targets->size()) + " weights (the morph targets), got " +
                          std::to_string(weights.size()) +
                          "; those without a partner are left out");
    }
    const std::int64_t size = std::min<std::int64_t>(p.targets->size(), std::ssize(weights));
    for (std::int64_t t = 0; t < size; ++t) {
      for (const char* name : {"TEXCOORD_0", "COLOR_0"}) {
        if (weights[t] != 0.0 && p.targets->item(t).has(name)) {
          warn(warnings_, std::string(name) + " of morph targets is left out");
        }
      }
    }
  }

  GltfDocument& document_;
  GltfTexcoords texcoords_;
  GltfBudget& budget_;
  std::vector<std::string>& warnings_;
  Plan plan_;
  std::map<std::pair<const GltfAccessor*, GltfTextureTransform>, std::int64_t> texcoord_rows_;
};

TriangleMesh allocate(const Plan& plan, bool with_materials) {
  TriangleMesh mesh;
  mesh.vertices.resize(plan.num_vertices, 3);
  mesh.faces.resize(plan.num_faces, 3);
  mesh.texcoords.resize(plan.num_texcoords, 2);
  mesh.normals.resize(plan.num_normals, 3);
  if (plan.num_texcoords > 0) mesh.face_texcoords.setConstant(plan.num_faces, 3, -1);
  if (plan.num_normals > 0) mesh.face_normals.setConstant(plan.num_faces, 3, -1);
  if (plan.with_colors) mesh.colors.resize(plan.num_vertices, 3);
  if (with_materials) mesh.face_material.setConstant(plan.num_faces, -1);
  return mesh;
}

/// Fills the rows of draws in the tables of a mesh.
class TableWriter {
 public:
  TableWriter(TriangleMesh& mesh, GltfDocument& document, GltfBudget& budget,
              std::vector<std::string>& warnings)
      : mesh_(mesh), document_(document), budget_(budget), warnings_(warnings) {}

  void fill(const Draw& draw) {
    if (draw.vertices.are_owned) fill_vertices(draw);
    if (draw.vertices.are_owned && mesh_.colors.rows() > 0) fill_colors(draw);
    if (draw.texcoords.are_owned) fill_texcoords(draw);
    if (draw.normals.are_owned) fill_normals(draw);
    fill_faces(draw);
  }

  /// Leaves out texture coordinates and normals that are not finite; called after all draws.
  void finish(std::vector<std::string>& warnings) {
    if (!has_nan_) return;
    leave_out_nan(mesh_.texcoords.data(), mesh_.texcoords.rows(), 2, mesh_.face_texcoords.data(),
                  mesh_.face_texcoords.rows(), "texture coordinates", warnings);
    leave_out_nan(mesh_.normals.data(), mesh_.normals.rows(), 3, mesh_.face_normals.data(),
                  mesh_.face_normals.rows(), "normals", warnings);
  }

 private:
  void fill_vertices(const Draw& draw) {
    const GltfAccessor& accessor = *draw.primitive->position;
    double* first = mesh_.vertices.data() + 3 * draw.vertices.first;
    accessor.decode(first);
    add_morph(draw.vertex_morph, first);
    const std::vector<GltfTransform> places = places_of_vertices(draw);
    for (std::int64_t i = 0; i < accessor.count; ++i) {
      auto row = mesh_.vertices.row(draw.vertices.first + i);
      const GltfTransform& place = places.empty() ? *draw.transform : places[i];
      row = (place.linear * row.transpose() + place.translation).transpose().eval();
      if (!row.allFinite()) {
        accessor.place.fail("element " + std::to_string(i) +
                            " is not finite after the transform of its node");
      }
    }
  }

  /// Transforms of a draw's vertices by the joints of a skin; empty: its node's transform applies.
  std::vector<GltfTransform> places_of_vertices(const Draw& draw) {
    std::vector<GltfTransform> places;
    if (draw.joints == nullptr) return places;
    const JsonPlace& primitive = draw.primitive->place;
    const std::int64_t count = draw.primitive->position->count;
    const Deformation moves = read_influences(document_, primitive, count, budget_);
    budget_.charge(count, sizeof(GltfTransform), primitive.pointer());
    places.reserve(count);
    for (std::int64_t i = 0; i < count; ++i) {
      GltfTransform place{Eigen::Matrix3d::Zero(), Eigen::Vector3d::Zero()};
      double total = 0.0;
      for (std::int64_t k = i * moves.num_influences; k < (i + 1) * moves.num_influences; ++k) {
        const double weight = moves.weights[k];
        if (!(weight > 0.0)) continue;
        if (moves.joints[k] >= draw.joints->size()) {
          primitive.fail("vertex " + std::to_string(i) + " has joint " +
                         std::to_string(moves.joints[k]) + " of a skin with " +
                         std::to_string(draw.joints->size()));
        }
        const GltfTransform& joint = (*draw.joints)[moves.joints[k]];
        place.linear += weight * joint.linear;
        place.translation += weight * joint.translation;
        total += weight;
      }
      places.push_back(total > 0.0 ? GltfTransform{place.linear / total, place.translation / total}
                                   : *draw.transform);
    }
    return places;
  }

  /// Converts colours from linear light to sRGB bytes (IEC 61966-2-1). A primitive without colours
  /// is white.
  void fill_colors(const Draw& draw) {
    const std::int64_t count = draw.primitive->position->count;
    if (draw.primitive->color == nullptr) {
      mesh_.colors.middleRows(draw.vertices.first, count).setConstant(255);
      return;
    }
    const GltfAccessor& accessor = *draw.primitive->color;
    std::vector<double> linear(count * accessor.num_components);
    accessor.decode(linear.data());
    for (std::int64_t i = 0; i < count; ++i) {
      for (int c = 0; c < 3; ++c) {
        const double x = std::clamp(linear[i * accessor.num_components + c], 0.0, 1.0);
        mesh_.colors(draw.vertices.first + i, c) =
            static_cast<std::uint8_t>(std::lround(255.0 * srgb_from_linear(x)));
      }
      const bool is_clear =
          draw.primitive->shows_alpha && accessor.num_components == 4 && linear[4 * i + 3] < 1.0;
      if (is_clear) warn(warnings_, "alpha of vertex colors is left out");
    }
  }

  /// Fills in the texture coordinates; v points downwards in glTF.
  void fill_texcoords(const Draw& draw) {
    const GltfAccessor& accessor = *draw.primitive->texcoord;
    has_nan_ |= !accessor.decode_any(mesh_.texcoords.data() + 2 * draw.texcoords.first);
    auto rows = mesh_.texcoords.middleRows(draw.texcoords.first, accessor.count);
    const GltfTextureTransform& transform = draw.primitive->texture;
    if (transform != GltfTextureTransform()) {
      for (auto row : rows.rowwise()) {
        if (!row.allFinite()) continue;
        row = transform(row[0], row[1]);
        if (!row.allFinite()) accessor.place.fail("overflows in KHR_texture_transform");
      }
    }
    rows.col(1) = (1.0 - rows.col(1).array()).matrix().eval();
  }

  void fill_normals(const Draw& draw) {
    const GltfAccessor& accessor = *draw.primitive->normal;
    double* first = mesh_.normals.data() + 3 * draw.normals.first;
    has_nan_ |= !accessor.decode_any(first);
    add_morph(draw.normal_morph, first);
    const std::vector<GltfTransform> places = places_of_vertices(draw);
    const Eigen::Matrix3d& m = draw.transform->linear;
    if (m.isIdentity(0.0) && draw.normal_morph.empty() && places.empty()) return;
    Eigen::Matrix3d turned = cofactors_of(m);
    for (std::int64_t i = 0; i < accessor.count; ++i) {
      if (!places.empty()) turned = cofactors_of(places[i].linear);
      auto row = mesh_.normals.row(draw.normals.first + i);
      if (!row.allFinite()) {
        has_nan_ = true;  // also if a morph target overflowed
        continue;
      }
      const Eigen::Vector3d normal = turned * row.transpose();
      if (!normal.allFinite()) {
        accessor.place.fail("a normal overflows in the transform of its node");
      }
      row = normal.stableNormalized().transpose();
    }
  }

  void fill_faces(const Draw& draw) {
    const GltfPrimitive& p = *draw.primitive;
    const std::vector<std::uint32_t> corners = p.corners();
    const bool mirrored = draw.transform->mirrors();
    for (std::int64_t f = 0; f < p.num_faces(); ++f) {
      std::array<std::int64_t, 3> from = p.face_corners(f);
      if (mirrored) std::swap(from[1], from[2]);
      const std::int64_t face = draw.first_face + f;
      for (int c = 0; c < 3; ++c) {
        const std::int64_t i = corners[from[c]];
        const auto set = [&](Faces& table, const TableRows& rows) {
          table(face, c) = static_cast<std::int32_t>(rows.first + i);
        };
        set(mesh_.faces, draw.vertices);
        if (p.texcoord != nullptr) set(mesh_.face_texcoords, draw.texcoords);
        if (p.normal != nullptr) set(mesh_.face_normals, draw.normals);
      }
      if (mesh_.face_material.rows() > 0) mesh_.face_material[face] = p.material;
    }
  }

  TriangleMesh& mesh_;
  GltfDocument& document_;
  GltfBudget& budget_;
  std::vector<std::string>& warnings_;
  bool has_nan_ = false;
};

}  // namespace

GltfTriangles read_triangles(GltfDocument& document, const std::vector<GltfInstance>& instances,
                             GltfTexcoords texcoords, GltfBudget& budget,
                             std::vector<std::string>& warnings, const Progress& progress) {
  const Plan plan = Planner(document, texcoords, budget, warnings).plan(instances);
  GltfTriangles triangles{allocate(plan, document.count("materials") > 0), {}, {}};
  TableWriter writer(triangles.mesh, document, budget, warnings);
  for (std::size_t i = 0; i < plan.draws.size(); ++i) {
    const Draw& draw = plan.draws[i];
    writer.fill(draw);
    if (draw.vertices.are_owned) {
      triangles.owners.push_back(
          {draw.primitive->place, draw.vertices.first, draw.primitive->position->count});
    }
    if (progress) progress(static_cast<double>(i + 1) / static_cast<double>(plan.draws.size()));
  }
  writer.finish(triangles.losses);
  return triangles;
}

}  // namespace manip3d
