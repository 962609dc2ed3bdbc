#include <algorithm>
#include <deque>
#include <string>
#include <unordered_set>

#include "manip3d/error.hpp"
#include "manip3d/simplify/grid_delaunay.hpp"

namespace manip3d {

/// Edges that a triangulation must have, and the flips that give it them.
class GridDelaunay::Constraints {
 public:
  explicit Constraints(GridDelaunay& mesh) : mesh_(mesh), from_(mesh.pixels_.size(), -1) {
    for (std::int32_t e = 0; e < static_cast<std::int32_t>(mesh.edges_.size()); ++e) {
      if ((e & 3) != 3) from_[mesh.edge(e).origin] = e;
    }
  }

  void add(std::int32_t a, std::int32_t b);
  void make_delaunay();

 private:
  using Ends = std::array<std::int32_t, 2>;

  [[nodiscard]] std::int32_t origin(std::int32_t e) const { return mesh_.edge(e).origin; }
  [[nodiscard]] std::int32_t twin(std::int32_t e) const { return mesh_.edge(e).twin; }
  [[nodiscard]] static std::uint64_t key(std::int32_t a, std::int32_t b) {
    return static_cast<std::uint64_t>(std::min(a, b)) << 32 |
           static_cast<std::uint64_t>(std::max(a, b));
  }
  [[nodiscard]] bool is_fixed(std::int32_t e) const {
    return fixed_.contains(key(origin(e), origin(next(e))));
  }

  template <typename Visit>
  std::int32_t find_around(std::int32_t vertex, const Visit& visit) const;
  [[nodiscard]] std::int32_t between(std::int32_t a, std::int32_t b) const;
  [[nodiscard]] bool is_ahead(std::int32_t a, std::int32_t b, std::int32_t p) const;
  [[nodiscard]] std::int32_t next_on_line(std::int32_t a, std::int32_t b) const;
  [[nodiscard]] std::int32_t collect_crossing(std::int32_t a, std::int32_t b);
  bool flip_crossing(std::int32_t a, std::int32_t b);
  void flip(std::int32_t e);

  GridDelaunay& mesh_;
  std::vector<std::int32_t> from_;  ///< A half-edge that starts in each vertex.
  std::unordered_set<std::uint64_t> fixed_;
  std::deque<Ends> crossing_;
};

// The first half-edge from the vertex for which visit() is true, one triangle after the other; -1:
// none.
template <typename Visit>
std::int32_t GridDelaunay::Constraints::find_around(std::int32_t vertex, const Visit& visit) const {
  const std::int32_t start = from_[vertex];
  std::int32_t e = start;
  do {
    if (visit(e)) return e;
    e = twin(prev(e));
  } while (e >= 0 && e != start);
  if (e == start) return -1;
  for (e = twin(start); e >= 0; e = twin(e)) {  // on the boundary, the other way round
    e = next(e);
    if (visit(e)) return e;
  }
  return -1;
}

// A half-edge between two vertices, in either direction; -1: none.
std::int32_t GridDelaunay::Constraints::between(std::int32_t a, std::int32_t b) const {
  const std::int32_t e = find_around(
      a, [&](std::int32_t each) { return origin(next(each)) == b || origin(prev(each)) == b; });
  if (e < 0) return -1;
  return origin(next(e)) == b ? e : prev(e);
}

// Whether p lies on the line from a to b, on the side of b.
bool GridDelaunay::Constraints::is_ahead(std::int32_t a, std::int32_t b, std::int32_t p) const {
  if (mesh_.orient(a, b, p) != 0) return false;
  const Pixel &from = mesh_.pixel(a), &to = mesh_.pixel(b), &other = mesh_.pixel(p);
  return std::int64_t{to.u - from.u} * (other.u - from.u) +
             std::int64_t{to.v - from.v} * (other.v - from.v) >
         0;
}

// The neighbour of a that lies on the line to b; -1: none.
std::int32_t GridDelaunay::Constraints::next_on_line(std::int32_t a, std::int32_t b) const {
  std::int32_t found = -1;
  find_around(a, [&](std::int32_t e) {
    for (const std::int32_t p : {origin(next(e)), origin(prev(e))}) {
      if (is_ahead(a, b, p)) found = p;
    }
    return found >= 0;
  });
  return found;
}

// Collects the edges that the line from a to b crosses before it meets the next vertex, which is
// returned; -1: one of them must stay.
std::int32_t GridDelaunay::Constraints::collect_crossing(std::int32_t a, std::int32_t b) {
  crossing_.clear();
  const std::int32_t first = find_around(a, [&](std::int32_t e) {
    return mesh_.orient(a, b, origin(next(e))) < 0 && mesh_.orient(a, b, origin(prev(e))) > 0;
  });
  std::int32_t e = next(first);  // from the right side of the line to its left side
  while (true) {
    if (is_fixed(e)) return -1;
    crossing_.push_back({origin(e), origin(next(e))});
    const std::int32_t f = twin(e);
    const std::int32_t beyond = origin(prev(f));
    const std::int64_t side = mesh_.orient(a, b, beyond);
    if (side == 0) return beyond;
    e = side > 0 ? next(f) : prev(f);
  }
}

void GridDelaunay::Constraints::flip(std::int32_t e) {
  const std::int32_t f = twin(e);
  mesh_.flip(e);
  for (const std::int32_t each : {e, next(e), f, next(f)}) from_[origin(each)] = each;
}

// Flips the collected edges until none crosses the line from a to b; returns whether that worked.
bool GridDelaunay::Constraints::flip_crossing(std::int32_t a, std::int32_t b) {
  // An edge whose two triangles are not convex waits for others. A bound, because it is not proved
  // that waiting ends.
  const std::size_t most = 64 + crossing_.size() * crossing_.size();
  for (std::size_t step = 0; !crossing_.empty(); ++step) {
    if (step > most) return false;
    const Ends ends = crossing_.front();
    crossing_.pop_front();
    const std::int32_t e = between(ends[0], ends[1]);
    const std::int32_t p = origin(prev(e)), q = origin(prev(twin(e)));
    const bool is_convex =
        mesh_.orient(p, q, origin(e)) * mesh_.orient(p, q, origin(next(e))) < 0;  // below 2^60
    if (!is_convex) {
      crossing_.push_back(ends);
      continue;
    }
    flip(e);
    if (mesh_.orient(a, b, p) * mesh_.orient(a, b, q) < 0) crossing_.push_back({p, q});
  }
  return true;
}

void GridDelaunay::Constraints::add(std::int32_t a, std::int32_t b) {
  while (a != b) {
    std::int32_t end = next_on_line(a, b);
    if (end < 0) {
      end = collect_crossing(a, b);
      if (end < 0 || !flip_crossing(a, end)) return;
    }
    fixed_.insert(key(a, end));
    a = end;
  }
}

// Flips edges that are not fixed until all of them are legal.
void GridDelaunay::Constraints::make_delaunay() {
  std::vector<std::int32_t>& stack = mesh_.stack_;
  stack.clear();
  for (std::int32_t e = 0; e < static_cast<std::int32_t>(mesh_.edges_.size()); ++e) {
    if ((e & 3) != 3 && twin(e) > e) stack.push_back(e);
  }
  while (!stack.empty()) {
    const std::int32_t e = stack.back();
    stack.pop_back();
    const std::int32_t f = twin(e);
    if (f < 0 || is_fixed(e) || !mesh_.is_illegal(e)) continue;
    mesh_.flip(e);
    stack.insert(stack.end(), {prev(f), f, prev(e), e});
  }
}

void GridDelaunay::constrain(std::span<const std::array<std::int32_t, 2>> edges) {
  const auto n = static_cast<std::int32_t>(pixels_.size());
  for (const auto& edge : edges) {
    for (const std::int32_t vertex : edge) {
      if (vertex >= 0 && vertex < n) continue;
      throw InputError("edges: expected vertices from 0 to " + std::to_string(n - 1) + ", got " +
                       std::to_string(vertex));
    }
  }
  if (edges_.empty()) return;
  Constraints constraints(*this);
  for (const auto& [a, b] : edges) constraints.add(a, b);
  constraints.make_delaunay();
}

}  // namespace manip3d
