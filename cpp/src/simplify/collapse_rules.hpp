#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

namespace manip3d {

// The rules that reject a collapse of v and t in the modes `quality` and `fast`. Only vertices that
// the caller locks are locked: boundaries may shrink, holes may close and vertices may leave seams,
// all at their price. Rejected is a collapse that makes
//
//  an edge of three faces or more                      kLink         with kAll
//  two faces on the same three vertices                kDuplicate    with kAll, kAnyEdges
//  a face that turns by more than 78 degrees           kFlip         with kAll, kAnyEdges
//  a face without area, or removes a piece's last      kDegenerate   always
//
// A complex edge has three faces or more. If v or t already has one, more of them are allowed, and
// one of two faces on the same vertices is removed: forbidding both kept models with many such
// edges from their targets until all rules were waived. If two faces lie back to back before the
// collapse, two may do so after it, because such a sheet is meant to be seen from both sides.

/// The faces of an edge lie on one side of it, as at the rim of a thin shell, if the mean of the
/// unit vectors towards them is at least this long: two faces then form an angle of less than 16
/// degrees. The edge counts as a boundary.
constexpr double kOneSided = 0.99;

/// Sets of rules. A later set applies only if the target could not be reached before, or, in the
/// mode `quality`, to a collapse that only the first rule forbids while all others cost more.
enum class Rules : std::uint8_t {
  kAll,       // no new edge with more than two faces, no flipped, degenerate or duplicate face
  kAnyEdges,  // edges may get more faces
  kFlips,     // faces may flip, and one of two on the same vertices is removed
};

constexpr bool is_complex_edge(std::int64_t num_faces) { return num_faces > 2; }

/// Whether the collapse of an edge v t makes v w and t w, which become one edge, complex. There are
/// `on_first` faces on v w, `on_second` on t w, and `on_both` faces v t w, which are removed.
constexpr bool makes_complex_edge(std::int64_t on_first, std::int64_t on_second,
                                  std::int64_t on_both) {
  const std::int64_t left = on_first + on_second - 2 * on_both;
  return is_complex_edge(left) && left > std::max(on_first, on_second);
}

/// `has_complex_edge`: whether v or t has one before the collapse.
constexpr bool may_make_complex_edge(Rules rules, bool has_complex_edge) {
  return rules != Rules::kAll || has_complex_edge;
}

/// Whether two faces may get the same vertices; one of them is removed then.
constexpr bool may_double_faces(Rules rules, bool has_complex_edge) {
  return rules == Rules::kFlips || has_complex_edge;
}

constexpr bool may_turn_faces(Rules rules) { return rules == Rules::kFlips; }

/// A vertex with more faces is a hub: the centre of a disc, or the tip of a cone with very many
/// sides. Visiting all of its faces after each collapse beside it would take quadratic time.
constexpr std::int32_t kHub = 512;

/// The other two corners of a face around a vertex, counter-clockwise.
using Side = std::array<std::int32_t, 2>;

/// Appends the sides of faces that lie back to back around one vertex, the lower end first. Sorts
/// `sides`, which are those of all its faces.
inline void append_twins(std::vector<Side>& sides, std::vector<Side>& twins) {
  std::sort(sides.begin(), sides.end());
  const auto last = std::unique(sides.begin(), sides.end());
  for (auto side = sides.begin(); side != last; ++side) {
    const auto [a, b] = *side;
    if (a < b && std::binary_search(sides.begin(), last, Side{b, a})) twins.push_back({a, b});
  }
}

/// Key of a face around one vertex; of several faces with the same key, one stays. `twins` must be
/// sorted.
inline Side double_key(const Side& side, const std::vector<Side>& twins) {
  const Side sorted{std::min(side[0], side[1]), std::max(side[0], side[1])};
  return std::binary_search(twins.begin(), twins.end(), sorted) ? side : sorted;
}

}  // namespace manip3d
