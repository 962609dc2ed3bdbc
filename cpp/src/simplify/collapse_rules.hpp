#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

namespace manip3d {

// The rules that refuse a collapse of v and t in the modes `quality` and `fast`. Nothing is locked
// but what the caller locks: boundaries may shrink, holes may close, seams may be left, all at
// their price. Refused is what makes, by Rules,
//
//   an edge of three faces or more                      kLink         kAll
//   two faces on the same three vertices                kDuplicate    kAll, kAnyEdges
//   a face that turns by more than 78 degrees           kFlip         kAll, kAnyEdges
//   a face without area, the last faces of a piece      kDegenerate   always
//
// A complex edge has three faces or more. Where v or t has one already, more of them do no harm,
// and of two faces on the same vertices one goes: forbidding both kept models that are full of
// such edges from their targets until all rules fell. Where two faces lie back to back before the
// collapse, two do so after it: such a sheet is meant to be seen from both sides.

/// Rules on what is forbidden. Later ones hold only when the target was out of reach before, or, in
/// the mode `quality`, for a collapse that the first rule forbids while all others cost more.
enum class Rules : std::uint8_t {
  kAll,       // no new edge with more than two faces, no flip, no degenerate or duplicate face
  kAnyEdges,  // edges may get more faces
  kFlips,     // faces may turn over, and of two on the same vertices one goes
};

constexpr bool is_complex_edge(std::int64_t num_faces) { return num_faces > 2; }

/// The edges v w and t w become one, of those faces that are not on v t too: with `on_first` faces
/// on v w, `on_second` on t w, `on_both` faces v t w.
constexpr bool makes_complex_edge(std::int64_t on_first, std::int64_t on_second,
                                  std::int64_t on_both) {
  const std::int64_t left = on_first + on_second - 2 * on_both;
  return is_complex_edge(left) && left > std::max(on_first, on_second);
}

/// `has_complex_edge`: v or t has one before they collapse.
constexpr bool may_make_complex_edge(Rules rules, bool has_complex_edge) {
  return rules != Rules::kAll || has_complex_edge;
}

/// Whether two faces may come to lie on the same vertices, of which one then goes.
constexpr bool may_double_faces(Rules rules, bool has_complex_edge) {
  return rules == Rules::kFlips || has_complex_edge;
}

constexpr bool may_turn_faces(Rules rules) { return rules == Rules::kFlips; }

/// A vertex with more faces is a hub: the middle of a disc, the tip of a cone with very many sides.
/// Looking at all of its faces after each collapse beside it would take the square of their number.
constexpr std::int32_t kHub = 512;

/// The other two corners of a face around a vertex, counter-clockwise.
using Side = std::array<std::int32_t, 2>;

/// Appends the sides of faces that lie back to back around one vertex, the lower end first; sorts
/// the sides of its faces.
inline void append_twins(std::vector<Side>& sides, std::vector<Side>& twins) {
  std::sort(sides.begin(), sides.end());
  const auto last = std::unique(sides.begin(), sides.end());
  for (auto side = sides.begin(); side != last; ++side) {
    const auto [a, b] = *side;
    if (a < b && std::binary_search(sides.begin(), last, Side{b, a})) twins.push_back({a, b});
  }
}

/// The key by which faces around one vertex are doubles: one of each key stays. `twins` are sorted.
inline Side double_key(const Side& side, const std::vector<Side>& twins) {
  const Side sorted{std::min(side[0], side[1]), std::max(side[0], side[1])};
  return std::binary_search(twins.begin(), twins.end(), sorted) ? side : sorted;
}

}  // namespace manip3d
