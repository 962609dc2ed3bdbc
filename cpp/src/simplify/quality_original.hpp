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

/// The mode `quality`: what each vertex stands for of the original mesh (quality_original), what a
/// collapse costs (quality_price), whether it is legal (quality_rules) and within max_distance
/// (quality_distance), what becomes of textures and colours (quality_attributes), and the queue of
/// collapses (quality).
namespace manip3d::quality_detail {

using Eigen::Vector2d;
using Eigen::Vector3d;

/// Normal of a face, as long as twice its area.
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

/// Area times root mean square, a bound of the integral of the distance.
inline double integral(double squares, double area) {
  return std::sqrt(std::max(0.0, squares) * area);
}

/// Which vertices the caller wants to stay where they are, and how much the others matter.
class Kept {
 public:
  explicit Kept(const QualityOptions& options)
      : locked_(options.locked), importance_(options.importance) {}

  [[nodiscard]] bool any_locked() const { return !locked_.empty(); }
  [[nodiscard]] bool is_locked(std::int32_t v) const { return !locked_.empty() && locked_[v]; }
  [[nodiscard]] double importance(std::int32_t v) const {
    return importance_.empty() ? 1.0 : importance_[v];
  }
  /// v becomes a part of t.
  void merge(std::int32_t v, std::int32_t t) {
    if (is_locked(v)) locked_[t] = true;
    if (!importance_.empty()) importance_[t] = std::max(importance_[v], importance_[t]);
  }

 private:
  std::vector<bool> locked_;        // of a vertex; empty: none
  std::vector<double> importance_;  // of a vertex; empty: all 1
};

/// What texture coordinates count that no picture shows. Of 1, 1/4, 1/10 and 1/40, tried on 21
/// parts of robots, a tenth takes most of what they cost the shape, for 1.4 times their error.
constexpr double kUnseen = 0.1;

/// The original faces and borders that each vertex stands for, as sums, which add up when two
/// vertices become one.
struct Original {
  Original(const CollapseMesh& mesh, const QualityOptions& options, bool has_texture,
           const Progress& progress);

  /// Makes borders of the edges of v at which the surface ends now, but did not when it was read
  /// (a plate that lost its thickness, a tube its cap): nothing else holds them in the plane of
  /// their faces. Returns whether there were such edges.
  bool guard_rims(const CollapseMesh& mesh, std::int32_t v, const Ring& ring);

  /// v becomes a part of t, which then owes so much for borders and texture.
  void merge(std::int32_t v, std::int32_t t, double owes);

  /// Root mean square distance from p to the planes of the original faces of v and t, or to those
  /// of their borders if that is more.
  [[nodiscard]] double error(std::int32_t v, std::int32_t t, const Vector3d& p) const;

  /// The price of the strips that borders sweep, for the sum of their squared distances and the
  /// weighted length: no more area is swept than there is around them, however many borders cross
  /// it (on models that give each face a chart of its own, all edges are borders).
  [[nodiscard]] double strips(double squares, double length, double area_around) const;

  /// The price of the strips along the seams of v and t that show the texture of the other side if
  /// the vertex lies at p, all over their width: of no more area than there is around them.
  [[nodiscard]] double wrong_side(std::int32_t v, std::int32_t t, const Vector3d& p) const;

  /// Price of a difference of texture coordinates of 1, for each unit of area.
  [[nodiscard]] double texture_factor() const {
    return seen() * options.texture_weight * texture_length / texture_share;
  }

  const QualityOptions& options;
  bool is_textured;
  std::vector<Quadric> surface;           // of a vertex: the original faces it stands for
  std::vector<Quadric> borders;           // of a vertex: the boundaries and seams
  std::vector<Quadric> jumps;             // of a vertex: the seams, weighted by what they show
  std::vector<double> jump;               // of a vertex: weighted length of those seams
  std::vector<double> seam;               // of a vertex: length of those seams
  std::vector<AttributeQuadric> texture;  // of a wedge
  std::vector<Eigen::AlignedBox3d> box;   // of a vertex: around those faces
  std::vector<double> area;               // of a vertex: of those faces
  double whole_area = 0.0;                // of all of them
  std::vector<double> border;             // of a vertex: weighted length of those borders
  std::vector<double> owed;               // of a vertex: Plan::owed of the collapses so far

 private:
  /// Share of its price that a texture has: all where a picture is shown.
  [[nodiscard]] double seen() const { return options.texture_seen ? 1.0 : kUnseen; }
  void measure_texture(const CollapseMesh& mesh);
  void add_face(const CollapseMesh& mesh, std::int32_t f);
  void add_borders(const CollapseMesh& mesh, std::int32_t v, Ring& ring);
  [[nodiscard]] double parted(const CollapseMesh& mesh, std::int32_t f, std::int32_t v,
                              std::int32_t t) const;

  double texture_length = 0.0;  // on the surface, of a unit of texture
  double texture_share = 1.0;   // of the area: what shows a texture
};

/// A strip of width d along a border is d / 2 away from the border on average.
constexpr double kStripDistance = 0.5;

}  // namespace manip3d::quality_detail
