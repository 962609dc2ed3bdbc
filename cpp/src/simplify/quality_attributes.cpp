#include "simplify/quality_attributes.hpp"

#include <limits>

#include "geometry/union_find.hpp"
#include "manip3d/geometry/topology.hpp"

namespace manip3d::quality_detail {
namespace {

/// Largest distance of a fitted texture coordinate outside its original chart, relative to the
/// diagonal of the box of the chart. Round borders of charts need a little; it is less than the
/// margin that atlases have around charts, beyond which they show the background.
constexpr double kTextureReach = 0.003;

}  // namespace

Attributes::Attributes(const MeshView& input, CollapseMesh& mesh, Original& original,
                       const Kept& kept)
    : input_(input), mesh_(mesh), original_(original), kept_(kept) {
  if (original.is_textured) find_charts();
  for (Eigen::Index v = 0; v < input.colors.rows(); ++v) {
    colors_.emplace_back(input.colors.row(v).cast<double>().transpose() / 255.0);
  }
}

/// Charts are wedges connected by faces; a collapse never merges wedges of two charts.
void Attributes::find_charts() {
  UnionFind sets(mesh_.num_wedges());
  for (std::int32_t f = 0; f < mesh_.num_slots(); ++f) {
    if (!mesh_.is_alive(f)) continue;
    const auto& wedges = mesh_.wedges(f);
    sets.join(wedges[0], wedges[1]);
    sets.join(wedges[0], wedges[2]);
  }
  chart_.resize(mesh_.num_wedges());
  std::int32_t count = 0;
  for (std::int32_t w = 0; w < mesh_.num_wedges(); ++w) {
    const std::int32_t root = sets.root(w);  // the lowest wedge of its chart
    chart_[w] = root == w ? count++ : chart_[root];
  }
}

bool Attributes::changes_locked(std::int32_t v, std::int32_t t, const WedgeMap& map) const {
  const bool stays_first = kept_.is_locked(v);
  const auto [fixed, other] = stays_first ? std::pair(v, t) : std::pair(t, v);
  const auto continues = [&](std::int32_t wedge) {
    if (!stays_first) return map.at(wedge) != wedge;
    return std::ranges::any_of(map.pairs, [&](const auto& pair) { return pair.to == wedge; });
  };
  bool changes = false;
  mesh_.for_each_face(other, [&](std::int32_t f, std::int32_t c) {
    const std::int32_t wedge = mesh_.wedges(f)[c];
    changes =
        changes || (mesh_.has_texture(wedge) && !touches(mesh_, f, fixed) && !continues(wedge));
  });
  return changes;
}

void Attributes::collapse(std::int32_t v, std::int32_t t, const Vector3d& p,
                          const JoinedWedges& wedges) {
  if (original_.is_textured) set_texture(v, t, p, wedges);
  if (!colors_.empty()) colors_[t] = color_at(v, t, p);
}

/// Sets the best texture coordinate of each wedge, clamped to those around it, because the linear
/// continuation of a narrow face can be anywhere.
void Attributes::set_texture(std::int32_t v, std::int32_t t, const Vector3d& p,
                             const JoinedWedges& wedges) {
  uvs_.clear();
  for (const auto& [wedge, quadric, stays] : wedges.textured()) {
    original_.texture[wedge] = quadric;
    if (const auto from = locked_wedge(v, t, wedge, wedges.map())) {
      uvs_.emplace_back(wedge, mesh_.uv(*from));
      continue;
    }
    if (!(quadric.weight > 0.0)) continue;
    Vector2d low = Vector2d::Constant(std::numeric_limits<double>::infinity()), high = -low;
    for (const std::int32_t from : {v, t}) {
      mesh_.for_each_face(from, [&](std::int32_t f, std::int32_t c) {
        const auto& corners = mesh_.wedges(f);
        if ((from == v ? wedges.map().at(corners[c]) : corners[c]) != wedge) return;
        for (const std::int32_t corner : corners) {
          low = low.cwiseMin(mesh_.uv(corner));
          high = high.cwiseMax(mesh_.uv(corner));
        }
      });
    }
    uvs_.emplace_back(wedge, quadric.best(p).cwiseMax(low).cwiseMin(high));
  }
  for (const auto& [wedge, uv] : uvs_) mesh_.set_uv(wedge, uv);
}

/// Returns the wedge, at the locked one of v and t, that becomes this wedge or is this wedge.
std::optional<std::int32_t> Attributes::locked_wedge(std::int32_t v, std::int32_t t,
                                                     std::int32_t wedge,
                                                     const WedgeMap& map) const {
  std::optional<std::int32_t> found;
  if (kept_.is_locked(v)) {
    for (const WedgeMap::Pair& pair : map.pairs) {
      if (pair.to == wedge && mesh_.has_texture(pair.from)) found = pair.from;
    }
  } else if (kept_.is_locked(t)) {
    mesh_.for_each_face(t, [&](std::int32_t f, std::int32_t c) {
      if (mesh_.wedges(f)[c] == wedge) found = wedge;
    });
  }
  return found;
}

/// The best colour at p, clamped to those around, because the linear continuation of a narrow face
/// can be anything. For a locked vertex, and without a weight of colours, it is interpolated
/// between v and t by the position of p along the edge.
Vector3d Attributes::color_at(std::int32_t v, std::int32_t t, const Vector3d& p) const {
  if (original_.is_colored && !kept_.is_locked(v) && !kept_.is_locked(t)) {
    const ColorQuadric joined = original_.joined_colors(v, t);
    if (joined.weight > 0.0) {
      Vector3d low = colors_[t], high = low;
      for (const std::int32_t from : {v, t}) {
        mesh_.for_each_face(from, [&](std::int32_t f, std::int32_t) {
          for (const std::int32_t corner : mesh_.face(f)) {
            low = low.cwiseMin(colors_[corner]);
            high = high.cwiseMax(colors_[corner]);
          }
        });
      }
      return joined.best(p).cwiseMax(low).cwiseMin(high);
    }
  }
  const Vector3d edge = mesh_.position(t) - mesh_.position(v);
  const double squared = edge.squaredNorm();
  const double share =
      squared > 0.0 ? std::clamp((p - mesh_.position(v)).dot(edge) / squared, 0.0, 1.0) : 1.0;
  return (1.0 - share) * colors_[v] + share * colors_[t];
}

/// By face of the input: its chart, or -1.
std::vector<std::int32_t> Attributes::chart_of_faces() const {
  std::vector<std::int32_t> chart(static_cast<std::size_t>(mesh_.num_slots()), -1);
  for (std::int32_t f = 0; f < mesh_.num_slots(); ++f) {
    const std::int32_t wedge = mesh_.wedges(f)[0];
    if (!is_degenerate(input_.faces, f) && mesh_.has_texture(wedge)) chart[f] = chart_[wedge];
  }
  return chart;
}

/// The texture coordinate nearest to uv that is in the original chart of a wedge, or almost.
Vector2d Attributes::into_chart(const UvCharts& charts, std::int32_t wedge,
                                const Vector2d& uv) const {
  const auto nearest = charts.nearest(chart_[wedge], uv);
  if (!nearest || nearest->distance <= kTextureReach) return uv;
  return nearest->uv + (uv - nearest->uv) * (kTextureReach / nearest->distance);
}

void Attributes::fit_texture(SurfaceFit& fit, const std::vector<bool>& is_exact,
                             const Progress& progress) {
  const auto may_change = [&](std::int32_t v) { return !kept_.is_locked(v) && !is_exact[v]; };
  const UvCharts charts(input_, chart_of_faces(), part_of(progress, 0.0, 0.2));
  const auto set_texture = [&](std::int32_t wedge, const Vector2d& uv) {
    mesh_.set_uv(wedge, into_chart(charts, wedge, uv));
  };
  for (std::int32_t f = 0; f < mesh_.num_slots(); ++f) {
    if (!mesh_.is_alive(f) || !mesh_.has_texture(mesh_.wedges(f)[0])) continue;
    for (std::size_t c = 0; c < 3; ++c) {
      const std::int32_t wedge = mesh_.wedges(f)[c];
      if (may_change(mesh_.face(f)[c])) set_texture(wedge, mesh_.uv(wedge));
    }
  }
  fit.fit_texture(mesh_, chart_, may_change, set_texture, part_of(progress, 0.2, 1.0));
}

void Attributes::write_colors(const std::vector<std::int32_t>& kept, TriangleMesh& out) const {
  for (std::size_t i = 0; i < kept.size() && !colors_.empty(); ++i) {
    const Vector3d rounded = (255.0 * colors_[kept[i]].array() + 0.5).floor();
    out.colors.row(static_cast<Eigen::Index>(i)) = rounded.cast<std::uint8_t>().transpose();
  }
}

}  // namespace manip3d::quality_detail
