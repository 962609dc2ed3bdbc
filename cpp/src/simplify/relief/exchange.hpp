#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "manip3d/progress.hpp"
#include "simplify/relief/boundary.hpp"
#include "simplify/relief/triangulation.hpp"

namespace manip3d::relief_detail {

/// Moves vertices from places where they save little to boundary edges, where they save more.
///
/// Collapses remove vertices one after another and never add one. In the end some boundary edges
/// leave out surface that a vertex on them would cover, while other vertices hardly matter.
class VertexExchange {
 public:
  /// In each of at most `rounds` rounds, vertices merge into neighbours and as many are added to
  /// boundary edges, while that lowers the sum of the error and of the prices of missing and of
  /// false surface, which are those of moves along the boundary.
  /// @param keep  By pixel, may be empty: only vertices at kFree pixels are removed.
  /// @return  Whether the mesh changed.
  bool run(const Surface& surface, Triangulation& mesh, std::span<const Keep> keep, int rounds,
           const Progress& progress);

 private:
  struct Removal {
    float cost;       ///< Infinite: the vertex must stay; without a neighbour, at least this.
    std::int32_t to;  ///< The neighbour; none if the vertex must stay or its removal is too dear.
  };
  struct Insertion {
    float gain;  ///< 0: nothing to gain.
    std::int32_t pixel;
  };
  /// @param most  Removals that cost as much are not computed to their end.
  [[nodiscard]] Removal removal_of(const Surface& surface, const Triangulation& mesh,
                                   std::int32_t v, float most) const;
  /// A pixel for a new vertex; `covered` weighs the surface that it adds, or takes away if
  /// negative.
  struct Place {
    std::int32_t pixel;
    float covered;
  };
  [[nodiscard]] Place best_place(const Surface& surface, const Triangulation& mesh, std::int32_t v,
                                 std::int32_t next, std::int32_t apex) const;
  [[nodiscard]] Insertion insertion_at(const Surface& surface, const Triangulation& mesh,
                                       std::int32_t v) const;
  void evaluate(const Surface& surface, const Triangulation& mesh, std::span<const Keep> keep,
                Ticker& ticker);
  [[nodiscard]] bool may_insert(const Surface& surface, const Triangulation& mesh,
                                std::int32_t from) const;
  [[nodiscard]] bool may_remove(const Surface& surface, const Triangulation& mesh, std::int32_t v,
                                Triangulation::Fan& fan, int& into) const;
  bool exchange(const Surface& surface, Triangulation& mesh, Ticker& ticker);
  void touch(std::int32_t v) { touched_[v] = is_stale_[v] = 1; }

  std::vector<std::int32_t> flaws_;  ///< Result of count_flaws().
  std::vector<std::int32_t>
      used_before_;  ///< By pixel: used pixels before it; one more at the end.
  BoundaryTiles tiles_;
  // By vertex; insertions are those on the edge from a boundary vertex to its first neighbour.
  std::vector<Removal> removals_;
  std::vector<Insertion> insertions_;
  std::vector<std::uint8_t> is_stale_;
  std::vector<std::uint8_t> touched_;          ///< Takes part in an exchange of this round.
  std::vector<std::int32_t> cheapest_, best_;  ///< Vertices by cost of removal, by gain.
};

}  // namespace manip3d::relief_detail
