#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "simplify/relief_triangulation.hpp"

namespace manip3d::relief_detail {

/// Sum of weighted squared distances to planes, as a function of the offset from a vertex: exact
/// enough in single precision because the offsets are short.
struct LocalQuadric {
  float xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;  // A
  float bx = 0, by = 0, bz = 0;
  float c = 0;
  float weight = 0;  ///< Sum of the weights.

  void add_plane_through_origin(const Vec3& n, float w) {
    const Vec3 wn = w * n;
    xx += wn.x() * n.x(), xy += wn.x() * n.y(), xz += wn.x() * n.z();
    yy += wn.y() * n.y(), yz += wn.y() * n.z(), zz += wn.z() * n.z();
    weight += w;
  }
  /// Adds a quadric of another vertex that lies at `offset` from this one's.
  void add(const LocalQuadric& q, const Vec3& offset);
  [[nodiscard]] float operator()(const Vec3& p) const {
    const float x = p.x(), y = p.y(), z = p.z();
    return x * (xx * x + 2.0F * (xy * y + xz * z + bx)) + y * (yy * y + 2.0F * (yz * z + by)) +
           z * (zz * z + 2.0F * bz) + c;
  }
};

/// Removes vertices from a triangulation by collapsing edges onto one of their ends, where that
/// adds least to the sum of distances between the surface and the mesh.
///
/// The quadric of a vertex [Garland & Heckbert 1997] holds the planes of the surface near it, of
/// total weight w (their area). The mean distance is a sum of distances, not of squares, so the
/// price of a collapse is how much sqrt(w Q) grows, an estimate of area times distance. Boundary
/// edges add the area that is lost beside them.
class Collapser {
 public:
  /// @param keep  by pixel, may be empty: vertices there cost `keep_factor` times as much, or stay.
  void assign(const Triangulation& mesh, std::span<const Keep> keep, float keep_factor);
  /// Stops at `target` vertices or when no edge can collapse. Best first in rounds, each of which
  /// removes at most the share `round_share` of the vertices.
  void run(const Surface& surface, Triangulation& mesh, std::int64_t target, float round_share);

 private:
  struct Move {
    float price;
    std::int32_t vertex, to;
  };
  [[nodiscard]] float price(const Triangulation& mesh, std::int32_t v, std::int32_t to) const;
  /// The number in `fan` of the neighbour that v merges into at the lowest price, of those not
  /// touched in this round; -1 if there is none. `legal_on`: only where that is legal.
  int cheapest(const Triangulation& mesh, std::int32_t v, const Triangulation::Fan& fan,
               const Surface* legal_on, std::int32_t round, float& lowest) const;
  void find_moves(const Triangulation& mesh);
  void sort_moves(std::size_t count);
  bool collapse(const Surface& surface, Triangulation& mesh, const Move& move, std::int32_t round);

  std::vector<LocalQuadric> surface_;   ///< By vertex.
  std::vector<LocalQuadric> boundary_;  ///< By vertex.
  std::vector<float> spent_;            ///< By vertex: sqrt(w Q) at the vertex itself.
  std::vector<float> factor_;           ///< By vertex: on its price; infinite: it stays.
  std::vector<Move> moves_;
  std::vector<std::int32_t> touched_;  ///< The round in which a vertex last changed.
};

/// Removes the pieces with the fewest pixels, those without fixed vertices first, until at most
/// `target` vertices are left; returns the pixels that they held.
std::int64_t drop_small_pieces(Triangulation& mesh, std::int64_t target,
                               std::span<const Keep> keep);

}  // namespace manip3d::relief_detail
