#pragma once

#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "geometry/uv_charts.hpp"
#include "simplify/quality_price.hpp"
#include "simplify/surface_fit.hpp"

namespace manip3d::quality_detail {

/// Texture coordinates and colours of vertices that are merged.
class Attributes {
 public:
  Attributes(const MeshView& input, CollapseMesh& mesh, Original& original, const Kept& kept);

  /// Whether a locked one of v and t would get a texture coordinate that only the other one has.
  [[nodiscard]] bool changes_locked(std::int32_t v, std::int32_t t, const WedgeMap& map) const;
  /// Updates the attributes before v and t become one vertex at p, with these wedges.
  void collapse(std::int32_t v, std::int32_t t, const Vector3d& p, const JoinedWedges& wedges);
  /// Moves the texture coordinates nearer to those of the input, and into their charts.
  /// @param is_exact  By vertex: whether its texture coordinates must not change.
  void fit_texture(SurfaceFit& fit, const std::vector<bool>& is_exact, const Progress& progress);
  /// Writes the colours of the vertices that were kept.
  void write_colors(const std::vector<std::int32_t>& kept, TriangleMesh& out) const;

 private:
  void find_charts();
  [[nodiscard]] std::vector<std::int32_t> chart_of_faces() const;
  [[nodiscard]] Vector2d into_chart(const UvCharts& charts, std::int32_t wedge,
                                    const Vector2d& uv) const;
  void set_texture(std::int32_t v, std::int32_t t, const Vector3d& p, const JoinedWedges& wedges);
  [[nodiscard]] std::optional<std::int32_t> locked_wedge(std::int32_t v, std::int32_t t,
                                                         std::int32_t wedge,
                                                         const WedgeMap& map) const;
  [[nodiscard]] Vector3d color_at(std::int32_t v, std::int32_t t, const Vector3d& p) const;

  const MeshView& input_;
  CollapseMesh& mesh_;
  Original& original_;
  const Kept& kept_;
  std::vector<std::int32_t> chart_;  // by wedge
  std::vector<Vector3d> colors_;     // by vertex; empty: none
  std::vector<std::pair<std::int32_t, Vector2d>> uvs_;
};

/// The point of a box, widened by a share of its diagonal, that is nearest to p.
template <typename Point, typename Box>
Point within(const Box& box, double reach, const Point& p) {
  const Point margin = Point::Constant(reach * box.diagonal().norm());
  return p.cwiseMax(box.min() - margin).cwiseMin(box.max() + margin);
}

}  // namespace manip3d::quality_detail
