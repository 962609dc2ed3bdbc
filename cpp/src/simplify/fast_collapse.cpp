#include "simplify/fast_collapse.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

namespace manip3d::fast_detail {
namespace {

/// cos^2 78 deg; at 90 degrees a face could turn over in two steps.
constexpr float kMinSquaredCosine = 0.04F;

/// Largest distance of a new vertex from the middle of its edge: two edge lengths, squared.
constexpr float kFarthest = 4.0F;

/// Counts the faces around v and t that would have the same vertices as others after the collapse.
/// Finds the twins among them.
std::int64_t count_doubles(CollapseTask& task) {
  std::vector<Side>&sides = task.sides, &twins = task.twins;
  twins.clear();
  for (const Fan* fan : {&task.first, &task.second}) {
    sides.assign(fan->rest.begin(), fan->rest.end());
    append_twins(sides, twins);
  }
  std::sort(twins.begin(), twins.end());
  sides.clear();
  for (const Fan* fan : {&task.first, &task.second}) {
    for (const Side& side : fan->rest) sides.push_back(double_key(side, twins));
  }
  std::sort(sides.begin(), sides.end());
  return sides.end() - std::unique(sides.begin(), sides.end());
}

/// Whether check_links() finds nothing around two vertices inside a closed surface. Compares two
/// sides at a time without branches, because it rarely finds anything.
bool keeps_closed_links(const Fan& first, const Fan& second) {
  const std::size_t size = second.rest.size();
  unsigned broken = 0;
  for (const auto& [a, b] : first.rest) {
    bool is_across = false;
    for (const std::int32_t w : first.across) is_across |= w == a;
    const unsigned links = is_across ? 0U : ~0U;
    const Int4 along{a, b, a, b}, against{b, a, b, a};
    for (std::size_t i = 0; i < size; i += 2) {
      const Side &one = second.rest[i], &two = second.rest[std::min(i + 1, size - 1)];
      const Int4 sides{one[0], one[1], two[0], two[1]};
      const unsigned same = true_lanes(sides == along), turned = true_lanes(sides == against);
      broken |= (same & (same >> 1)) | (turned & (turned >> 1)) | (same & links);
    }
  }
  return (broken & 0b0101U) == 0;
}

std::int64_t faces_at(std::int32_t w, const Fan& fan) {
  std::int64_t faces = 0;
  for (const auto& [a, b] : fan.rest) faces += a == w || b == w ? 1 : 0;
  return faces;
}

/// The faces v t w are removed; the others on v w and on t w then share one edge.
bool makes_complex_edge_at(std::int32_t w, const Fan& first, const Fan& second) {
  const std::int64_t across = std::count(first.across.begin(), first.across.end(), w);
  const std::int64_t one = faces_at(w, first), two = faces_at(w, second);
  return makes_complex_edge(one + across, two + across, across);
}

/// check_links() for vertices with very many faces, by sorting.
std::optional<Rejection> check_long_links(const Fan& first, const Fan& second, Rules rules) {
  std::vector<Side> s1, s2;
  first.append_sides(s1);
  second.append_sides(s2);
  for (const auto& side : s1) {
    if (std::binary_search(s2.begin(), s2.end(), side)) return Rejection::kDuplicate;
  }
  if (rules != Rules::kAll) return std::nullopt;
  std::vector<std::int32_t> e1, e2;
  first.append_ends(e1);
  second.append_ends(e2);
  std::vector<std::int32_t> across(first.across.begin(), first.across.end());
  std::sort(across.begin(), across.end());
  const auto count_in = [](const std::vector<std::int32_t>& sorted, std::int32_t w) {
    const auto [low, high] = std::equal_range(sorted.begin(), sorted.end(), w);
    return static_cast<std::int64_t>(high - low);
  };
  for (auto w = e1.begin(); w != e1.end(); w = std::upper_bound(w, e1.end(), *w)) {
    const std::int64_t one = count_in(e1, *w), two = count_in(e2, *w), gone = count_in(across, *w);
    if (makes_complex_edge(one + gone, two + gone, gone)) return Rejection::kLink;
  }
  return std::nullopt;
}

}  // namespace

std::optional<Rejection> EdgeCollapser::collapse(std::int32_t v, std::int32_t t, CollapseTask& task,
                                                 std::int64_t quota) {
  Fan &first = task.first, &second = task.second;
  gather(v, t, first);
  gather(t, v, second);
  if (first.across.empty()) return std::nullopt;
  const bool is_doubling = may_double_faces(rules, has_complex_edge_at(v, t, task));
  const auto num_gone =
      static_cast<std::int64_t>(first.across.size()) + (is_doubling ? count_doubles(task) : 0);
  if (num_gone > quota) return std::nullopt;  // another collapse may fit
  if (first.rest.empty() && second.rest.empty() && !hangs_at_hub(first)) {
    return Rejection::kDegenerate;
  }
  if (takes_last_face_of_locked(v, t, first, task)) return Rejection::kDegenerate;
  if (!mesh_.locked.empty() && mesh_.has_wedges() && changes_locked(mesh_, v, t, task.merged)) {
    return Rejection::kAttribute;
  }
  if (!is_doubling) {
    if (const auto reason = check_links(v, t, first, second)) return reason;
  }
  const EdgeQuadric<float> edge(mesh_.vertices[v], mesh_.vertices[t]);
  Vector3f offset;
  if (const auto reason = find_place(v, t, edge, task, offset)) return reason;
  apply(v, t, offset, edge, task);
  if (is_doubling) {
    task.doubling.push_back(v);
    for (const auto& [a, b] : task.twins) task.twin_faces.push_back({v, a, b});
  }
  task.removed += num_gone;
  ++task.collapses;
  return std::nullopt;
}

/// Whether the third corner of a face alone on its edge is a vertex with very many faces. Such a
/// vertex collapses once per pass, so each face that is connected only through it would need a
/// pass.
bool EdgeCollapser::hangs_at_hub(const Fan& first) const {
  return first.across.size() == 1 && mesh_.corners(first.across.front()).size() > kHub;
}

/// Gathers the remaining faces of v, after the collapses of this pass.
void EdgeCollapser::gather(std::int32_t v, std::int32_t other, Fan& fan) const {
  fan.rest.resize(mesh_.corners(v).size());
  fan.across.resize(mesh_.corners(v).size());
  // Writes each face to both lists and advances at most one of them, to avoid branches.
  std::size_t num_rest = 0, num_across = 0;
  mesh_.for_each_face(v, [&](std::uint32_t, std::uint32_t, std::int32_t a, std::int32_t b) {
    const std::int32_t x = mesh_.remap[a], y = mesh_.remap[b];
    const bool is_across = x == other || y == other, is_there = x != y;
    fan.across[num_across] = x == other ? y : x;
    fan.rest[num_rest] = {x, y};
    num_across += static_cast<std::size_t>(is_there && is_across);
    num_rest += static_cast<std::size_t>(is_there && !is_across);
  });
  fan.rest.resize(num_rest);
  fan.across.resize(num_across);
}

/// Whether a locked vertex may have no faces except those on the edge, which are removed. While
/// blocks run in parallel, the state of its faces in other blocks is unknown.
bool EdgeCollapser::takes_last_face_of_locked(std::int32_t v, std::int32_t t, const Fan& first,
                                              const CollapseTask& task) const {
  if (mesh_.locked.empty()) return false;
  return std::any_of(first.across.begin(), first.across.end(), [&](std::int32_t w) {
    if (!mesh_.is_locked(w)) return false;
    if (mesh_.level[w] > task.level) return true;
    bool stays = false;
    mesh_.for_each_face(w, [&](std::uint32_t, std::uint32_t, std::int32_t a, std::int32_t b) {
      const std::int32_t x = mesh_.remap[a], y = mesh_.remap[b];
      const bool is_on_edge = (x == v && y == t) || (x == t && y == v);
      stays = stays || (x != y && x != w && y != w && !is_on_edge);
    });
    return !stays;
  });
}

/// Whether v or t, whose fans must be gathered, has an edge of three or more faces.
bool EdgeCollapser::has_complex_edge_at(std::int32_t v, std::int32_t t, CollapseTask& task) const {
  if (mesh_.is_complex.empty() || (mesh_.is_complex[v] == 0 && mesh_.is_complex[t] == 0))
    return false;
  const Fan &first = task.first, &second = task.second;
  if (is_complex_edge(static_cast<std::int64_t>(first.across.size()))) return true;
  for (const Fan* fan : {&first, &second}) {
    task.ends.assign(fan->across.begin(), fan->across.end());
    fan->append_ends(task.ends);
    if (has_complex_edge(task.ends)) return true;
  }
  return false;
}

/// Returns the first rule of collapse_rules.hpp about edges and faces around v and t that is
/// broken.
std::optional<Rejection> EdgeCollapser::check_links(std::int32_t v, std::int32_t t,
                                                    const Fan& first, const Fan& second) const {
  const auto is_across = [&](std::int32_t w) {
    return std::find(first.across.begin(), first.across.end(), w) != first.across.end();
  };
  const bool is_simple = mesh_.is_open[v] == 0 && mesh_.is_open[t] == 0;
  const bool is_long = first.rest.size() * second.rest.size() > 4096;
  if (is_long) return check_long_links(first, second, rules);
  if (is_simple && rules == Rules::kAll && keeps_closed_links(first, second)) {
    return std::nullopt;
  }
  for (const auto& [a, b] : first.rest) {
    const bool across_a = is_across(a);
    for (const auto& [x, y] : second.rest) {
      if ((x == a && y == b) || (x == b && y == a)) return Rejection::kDuplicate;
      if (rules != Rules::kAll) continue;
      if (is_simple) {
        if (a == x && !across_a) return Rejection::kLink;
      } else if (((a == x || a == y) && makes_complex_edge_at(a, first, second)) ||
                 ((b == x || b == y) && makes_complex_edge_at(b, first, second))) {
        return Rejection::kLink;
      }
    }
  }
  return std::nullopt;
}

/// Finds the position of the new vertex, as an offset from v: the minimum of the quadric, or else
/// the cheaper end of the edge, or else the other end. A legal end that costs more than is allowed
/// at once is noted in `task.end_price`. A locked end does not move.
std::optional<Rejection> EdgeCollapser::find_place(std::int32_t v, std::int32_t t,
                                                   const EdgeQuadric<float>& edge,
                                                   CollapseTask& task, Vector3f& offset) const {
  const Fan &first = task.first, &second = task.second;
  offset = {edge.ux, edge.uy, edge.uz};
  const bool is_first_fixed = mesh_.is_locked(v), is_second_fixed = mesh_.is_locked(t);
  if (is_first_fixed && is_second_fixed) return Rejection::kComplexVertex;
  const Vector3f to_second(edge.dx, edge.dy, edge.dz);
  if (is_first_fixed) offset.setZero();
  if (is_second_fixed) offset = to_second;
  auto reason = check_place(v, t, offset, edge, first, second);
  // Far away from its edge, a vertex can be near the planes of the faces although it is far from
  // the faces, which the quadric does not show.
  if ((offset - 0.5F * to_second).squaredNorm() > kFarthest * to_second.squaredNorm()) {
    reason = Rejection::kFlip;
  }
  if (reason && !is_first_fixed && !is_second_fixed) {
    Vector3f other = to_second, third = Vector3f::Zero();
    if (edge.value(0.0F, 0.0F, 0.0F) < edge.value(edge.dx, edge.dy, edge.dz)) {
      std::swap(other, third);
    }
    for (const Vector3f& place : {other, third}) {
      const std::uint32_t price = key_of(edge.price(edge.value(place.x(), place.y(), place.z())));
      if (price > task.most || check_place(v, t, place, edge, first, second)) continue;
      if (price > task.most_at_end) {
        task.end_price = price;
      } else {
        offset = place;
        reason.reset();
      }
      break;
    }
  }
  return reason;
}

/// Checks whether the new vertex may lie at `offset` from v:
///  a face would lose its area                                kDegenerate
///  a face would turn by more than 78 degrees                 kFlip
///  the error would be above max_error                        kErrorLimit
std::optional<Rejection> EdgeCollapser::check_place(std::int32_t v, std::int32_t t,
                                                    const Vector3f& offset,
                                                    const EdgeQuadric<float>& edge,
                                                    const Fan& first, const Fan& second) const {
  const Vector3f old = position_of(mesh_.vertices[v]), place = old + offset;
  const Vector3f u = place - old;  // as in apply(), which records the error
  const float value = edge.value(u.x(), u.y(), u.z());
  if (!(value <= squared_limit_ * edge.weight) && value > 0.0F) return Rejection::kErrorLimit;
  if (!offset.allFinite()) return Rejection::kDegenerate;
  const Vectors4 p = four_of(place);
  if (const auto reason = check_faces(first, four_of(old), p)) return reason;
  return check_faces(second, four_of(position_of(mesh_.vertices[t])), p);
}

/// Checks the faces of a fan whose vertex moves from `old` to `p`, four at a time.
std::optional<Rejection> EdgeCollapser::check_faces(const Fan& fan, const Vectors4& old,
                                                    const Vectors4& p) const {
  const bool may_turn = may_turn_faces(rules);
  for (std::size_t i = 0; i < fan.rest.size(); i += 4) {
    // The last face fills up the four.
    std::array<std::int32_t, 4> a{}, b{};
    for (std::size_t lane = 0; lane < 4; ++lane) {
      const Side& side = fan.rest[std::min(i + lane, fan.rest.size() - 1)];
      a[lane] = side[0];
      b[lane] = side[1];
    }
    const Vectors4 pa = mesh_.positions_of(a.data()), pb = mesh_.positions_of(b.data());
    const Vectors4 ea = pa - p, eb = pb - p;
    const Vectors4 after = ea.cross(eb), before = (pa - old).cross(pb - old);
    const Float4 area = after.squared_norm(), area_before = before.squared_norm();
    const Float4 la = ea.squared_norm(), lb = eb.squared_norm(), lc = (pb - pa).squared_norm();
    const Float4 longer = la < lb ? lb : la, longest = longer < lc ? lc : longer;
    const Float4 cosine = before.dot(after);
    const unsigned degenerate = ~true_lanes(area > kMinSquaredSine * longest * longest) & 15U;
    const unsigned flips =
        may_turn ? 0U
                 : true_lanes(area_before > 0.0F) &
                       ~(true_lanes(cosine > 0.0F) &
                         true_lanes(cosine * cosine > kMinSquaredCosine * area * area_before));
    if ((degenerate | flips) == 0) continue;
    // A face that had no area can neither lose it nor flip.
    const Float4 ka = (pa - old).squared_norm(), kb = (pb - old).squared_norm();
    const Float4 wider = ka < kb ? kb : ka, widest = wider < lc ? lc : wider;
    const unsigned had_area = true_lanes(area_before > kMinSquaredSine * widest * widest);
    const unsigned broken = (degenerate | flips) & had_area;
    if (broken == 0) continue;
    const auto lane = std::countr_zero(broken);
    return ((degenerate >> lane) & 1U) != 0 ? Rejection::kDegenerate : Rejection::kFlip;
  }
  return std::nullopt;
}

/// Collapses t onto v, which has the lower index and moves.
void EdgeCollapser::apply(std::int32_t v, std::int32_t t, const Vector3f& offset,
                          const EdgeQuadric<float>& edge, CollapseTask& task) {
  QuadricVertex& vertex = mesh_.vertices[v];
  const Vector3f old = position_of(vertex);
  const Vector3f p = old + offset;
  if (mesh_.has_wedges()) merge_wedges(mesh_, v, t, p, task.merged);
  if (!mesh_.normals.empty()) merge_normals(mesh_, v, t);
  if (!mesh_.colors.empty()) task.mixes.push_back(mix_of(mesh_, v, t, p));
  const Vector3f u = p - old;  // the offset as rounded to single precision
  vertex.x = p.x(), vertex.y = p.y(), vertex.z = p.z();
  vertex.xx = edge.xx, vertex.xy = edge.xy, vertex.xz = edge.xz;
  vertex.yy = edge.yy, vertex.yz = edge.yz, vertex.zz = edge.zz;
  vertex.bx = edge.bx + edge.xx * u.x() + edge.xy * u.y() + edge.xz * u.z();
  vertex.by = edge.by + edge.xy * u.x() + edge.yy * u.y() + edge.yz * u.z();
  vertex.bz = edge.bz + edge.xz * u.x() + edge.yz * u.y() + edge.zz * u.z();
  vertex.c = std::max(0.0F, edge.value(u.x(), u.y(), u.z()));
  vertex.weight = edge.weight;
  if (edge.weight > 0.0F) {
    task.squared_error = std::max(task.squared_error, vertex.c / edge.weight);
  }
  if (mesh_.is_locked(t)) {
    lock(v, t);
  } else if (!mesh_.is_locked(v)) {
    mesh_.is_moved[mesh_.id[v]] = 1;
  }
  mesh_.is_open[v] |= mesh_.is_open[t];
  mesh_.remap[t] = v;
  mesh_.is_taken[v] = mesh_.is_taken[t] = 1;
  mesh_.into[mesh_.id[t]] = mesh_.id[v];
}

/// Locks the vertex v, which takes the place of a locked vertex t.
void EdgeCollapser::lock(std::int32_t v, std::int32_t t) {
  mesh_.locked[mesh_.id[v]] = 1;
  mesh_.is_moved[mesh_.id[v]] = 0;
  mesh_.order.source[mesh_.id[v]] = mesh_.order.source[mesh_.id[t]];
}

}  // namespace manip3d::fast_detail
