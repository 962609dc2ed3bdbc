#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"
#include "manip3d/simplify/quality.hpp"
#include "simplify/attribute_quadric.hpp"
#include "simplify/collapse_mesh.hpp"
#include "simplify/quadric.hpp"

/// The mode `quality`: the part of the original mesh that each vertex represents
/// (quality_original), the price of a collapse (quality_price), whether it is legal (quality_rules)
/// and within max_distance (quality_distance), textures and colours (quality_attributes), and the
/// queue of collapses (quality).
namespace manip3d::quality_detail {

using Eigen::Vector2d;
using Eigen::Vector3d;

/// Normal of a face; its length is twice the area.
inline Vector3d area_vector(const CollapseMesh& mesh, std::int32_t f) {
  const auto& face = mesh.face(f);
  const Vector3d& p = mesh.position(face[0]);
  return (mesh.position(face[1]) - p).cross(mesh.position(face[2]) - p);
}

inline bool touches(const CollapseMesh& mesh, std::int32_t f, std::int32_t v) {
  const auto& face = mesh.face(f);
  return face[0] == v || face[1] == v || face[2] == v;
}

inline bool shows_texture(const CollapseMesh& mesh, std::int32_t f) {
  const auto& wedges = mesh.wedges(f);
  return mesh.has_texture(wedges[0]) && std::ranges::all_of(wedges, [&](std::int32_t wedge) {
           return mesh.uv(wedge).cwiseAbs().maxCoeff() < kFarthestTexture;
         });
}

/// Area times root mean square: an upper bound of the integral of the distance.
inline double integral(double squares, double area) {
  return std::sqrt(std::max(0.0, squares) * area);
}

/// Vertices that the caller locked, and the importance of the others.
class Kept {
 public:
  explicit Kept(const QualityOptions& options)
      : locked_(options.locked), importance_(options.importance) {}

  [[nodiscard]] bool any_locked() const { return !locked_.empty(); }
  [[nodiscard]] bool is_locked(std::int32_t v) const { return !locked_.empty() && locked_[v]; }
  [[nodiscard]] double importance(std::int32_t v) const {
    return importance_.empty() ? 1.0 : importance_[v];
  }
  /// Merges v into t.
  void merge(std::int32_t v, std::int32_t t) {
    if (is_locked(v)) locked_[t] = true;
    if (!importance_.empty()) importance_[t] = std::max(importance_[v], importance_[t]);
  }

 private:
  std::vector<bool> locked_;        // by vertex; empty: none
  std::vector<double> importance_;  // by vertex; empty: all 1
};

/// Factor on the weight of texture coordinates if no picture is shown. Of 1, 1/4, 1/10 and 1/40,
/// tried on 21 parts of robots, a tenth avoids most of the loss of shape, and multiplies the error
/// of the texture coordinates by 1.4.
constexpr double kUnseen = 0.1;

/// The original faces and borders that each vertex represents, as sums that are added when two
/// vertices are merged.
struct Original {
  /// @param input  The mesh from which `mesh` was made, with its colours.
  Original(const MeshView& input, const CollapseMesh& mesh, const QualityOptions& options,
           const Progress& progress);

  /// Adds a border at each edge of v where the surface ends now but did not in the input (a plate
  /// that lost its thickness, a tube that lost its cap), because nothing else holds such an edge in
  /// the plane of its faces. Returns whether there were such edges.
  bool add_missing_rims(const CollapseMesh& mesh, std::int32_t v, const Ring& ring);

  /// Merges v into t; `new_price` is the Plan::attribute_price of t from now on.
  void merge(std::int32_t v, std::int32_t t, double new_price);

  /// Frees what only the prices of collapses need.
  void free_prices() {
    const auto free = [](auto&... tables) { (std::decay_t<decltype(tables)>().swap(tables), ...); };
    free(surface, jumps, jump, seam, texture, color);
  }

  /// Root mean square distance from p to the planes of the original faces of v and t, or to those
  /// of their borders, whichever is larger.
  [[nodiscard]] double error(std::int32_t v, std::int32_t t, const Vector3d& p) const;

  /// Price of the strips that borders sweep, from the sum of their squared distances and the
  /// weighted length. The swept area is at most the area around, however many borders there are: on
  /// models that give each face a chart of its own, all edges are borders.
  [[nodiscard]] double strips(double squares, double length, double area_around) const;

  /// Price of the strips along the seams of v and t that show the texture of the other side if the
  /// vertex is at p, over their whole width; their area is at most the area around.
  [[nodiscard]] double wrong_side(std::int32_t v, std::int32_t t, const Vector3d& p) const;

  /// Price of the colours of the merged vertex if it is at p: the integral of the difference from
  /// the linear continuation of the original colours, at most that of a difference of 1.
  [[nodiscard]] double wrong_color(std::int32_t v, std::int32_t t, const Vector3d& p) const;

  /// The colours around the vertex into which v and t are merged.
  [[nodiscard]] ColorQuadric joined_colors(std::int32_t v, std::int32_t t) const {
    ColorQuadric joined = color[v];
    joined += color[t];
    return joined;
  }

  /// Price of a difference of 1 between colours, per unit of area.
  [[nodiscard]] double color_factor() const { return options.color_weight * color_length_; }

  /// Price of a difference of 1 between texture coordinates, per unit of area.
  [[nodiscard]] double texture_factor() const {
    return seen() * options.texture_weight * texture_length / texture_share;
  }

  const QualityOptions& options;
  bool is_textured, is_colored;
  std::vector<Quadric> surface;  // by vertex: planes of the original faces it represents
  std::vector<Quadric> borders;  // by vertex: planes of boundaries and seams
  std::vector<Quadric> jumps;    // by vertex: planes of seams, weighted by their texture jumps
  std::vector<double> jump;      // by vertex: weighted length of those seams
  std::vector<double> seam;      // by vertex: length of those seams
  std::vector<AttributeQuadric> texture;  // by wedge
  std::vector<ColorQuadric> color;        // by vertex; empty unless is_colored
  std::vector<Eigen::AlignedBox3d> box;   // by vertex: around those faces
  std::vector<double> area;               // by vertex: of those faces
  double whole_area = 0.0;                // sum over all faces
  std::vector<double> border;             // by vertex: weighted length of those borders
  /// By vertex: Plan::attribute_price of its collapses so far.
  std::vector<double> attribute_price;

 private:
  /// Factor on the price of a texture: 1 if a picture is shown.
  [[nodiscard]] double seen() const { return options.texture_seen ? 1.0 : kUnseen; }
  void measure_texture(const CollapseMesh& mesh);
  void add_face(const CollapseMesh& mesh, std::int32_t f);
  void add_colors(const MeshView& input, const CollapseMesh& mesh);
  void add_borders(const CollapseMesh& mesh, std::int32_t v, Ring& ring);
  void limit_jumps();
  [[nodiscard]] double parted(const CollapseMesh& mesh, std::int32_t f, std::int32_t v,
                              std::int32_t t) const;

  double texture_length = 0.0;  // length on the surface of a unit of texture
  double texture_share = 1.0;   // textured share of the area
  double color_length_ = 0.0;   // color_length()
};

/// The points of a strip of width d along a border are on average d / 2 away from the border.
constexpr double kStripDistance = 0.5;

}  // namespace manip3d::quality_detail
