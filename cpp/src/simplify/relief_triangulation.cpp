#include "simplify/relief_triangulation.hpp"

#include <algorithm>
#include <utility>

#include "simplify/relief_raster.hpp"

namespace manip3d::relief_detail {

void Triangulation::link_neighbors(std::span<const Triangle> faces) {
  // The sides of the triangles by the pixel where they start.
  std::fill(first_side_.begin(), first_side_.end(), 0);
  for (const auto& [a, b, c] : faces) {
    ++first_side_[a + 1], ++first_side_[b + 1], ++first_side_[c + 1];
  }
  for (std::size_t p = 1; p < first_side_.size(); ++p) first_side_[p] += first_side_[p - 1];
  const auto num_faces = static_cast<std::int32_t>(faces.size());
  make_room(sides_, std::int64_t{3} * num_faces);
  sides_.resize(3 * faces.size());
  for (std::int32_t t = num_faces - 1; t >= 0; --t) {
    const auto [a, b, c] = faces[t];
    sides_[--first_side_[a + 1]] = {b, t};
    sides_[--first_side_[b + 1]] = {c, t};
    sides_[--first_side_[c + 1]] = {a, t};
  }
  // first_side_[p + 1] is now where pixel p starts, first_side_[p + 2] where it ends.
  const auto triangle_of = [&](std::int32_t start, std::int32_t end) {
    for (std::int32_t k = first_side_[start + 1]; k < first_side_[start + 2]; ++k) {
      if (sides_[k].end == end) return sides_[k].triangle;
    }
    return kNone;
  };
  make_room(neighbors_, num_faces);
  neighbors_.resize(faces.size());
  for (std::int32_t t = 0; t < num_faces; ++t) {
    const auto [a, b, c] = faces[t];
    neighbors_[t] = {triangle_of(c, b), triangle_of(a, c), triangle_of(b, a)};
  }
}

void Triangulation::split_fans(const Surface& surface, std::span<const Triangle> faces) {
  make_room(faces_, static_cast<std::int64_t>(faces.size()));
  faces_.assign(faces.size(), {kNone, kNone, kNone});
  vertices_.clear();
  for (std::size_t i = 0; i < 3 * faces.size(); ++i) {
    if (faces_[i / 3][i % 3] != kNone) continue;
    const std::int32_t pixel = faces[i / 3][i % 3];
    const auto id = static_cast<std::int32_t>(vertices_.size());
    auto first = static_cast<std::int32_t>(i / 3);
    bool on_boundary = true;
    for (const std::int32_t from = first;;) {  // backwards to where the fan starts
      const std::int32_t before = neighbors_[first][(corner(faces[first], pixel) + 2) % 3];
      if (before == kNone) break;
      first = before;
      if (first == from) {
        on_boundary = false;
        break;
      }
    }
    vertices_.push_back({pixel, first, surface.u(pixel), surface.v(pixel),
                         surface.sample(pixel).point(), on_boundary});
    for (std::int32_t t = first;;) {
      const int k = corner(faces[t], pixel);
      faces_[t][k] = id;
      t = neighbors_[t][(k + 1) % 3];
      if (t == kNone || t == first) break;
    }
  }
  num_alive_ = static_cast<std::int64_t>(vertices_.size());
  num_at_.assign(surface.num_pixels(), 0);
  for (const Vertex& vertex : vertices_) ++num_at_[vertex.pixel];
}

void Triangulation::assign(const Surface& surface, std::span<const Triangle> faces) {
  first_side_.resize(static_cast<std::size_t>(surface.cols()) * surface.rows() + 2);
  link_neighbors(faces);
  split_fans(surface, faces);
}

void Triangulation::clear() {
  vertices_.clear();
  faces_.clear();
  neighbors_.clear();
  num_alive_ = 0;
}

void Triangulation::sorted_vertices(std::vector<std::int32_t>& out) const {
  out.clear();
  for (std::int32_t v = 0; v < num_slots(); ++v) {
    if (vertices_[v].alive()) out.push_back(v);
  }
  std::sort(out.begin(), out.end(), [&](std::int32_t a, std::int32_t b) {
    return std::pair(vertices_[a].pixel, a) < std::pair(vertices_[b].pixel, b);
  });
}

void Triangulation::remove_vertex(std::int32_t v) {
  vertices_[v].triangle = kNone;
  --num_alive_;
  --num_at_[vertices_[v].pixel];
}

void Triangulation::remove_piece(std::span<const std::int32_t> faces) {
  for (const std::int32_t t : faces) {
    for (const std::int32_t v : faces_[t]) {
      if (!vertices_[v].alive()) continue;
      remove_vertex(v);
    }
    faces_[t] = {kNone, kNone, kNone};
  }
}

bool Triangulation::fan(std::int32_t v, Fan& out) const {
  const std::int32_t first = vertices_[v].triangle;
  std::int32_t t = first;
  out.size = 0;
  int k = 0;
  do {
    if (out.size == kMaxFan) return false;
    k = corner(faces_[t], v);
    out.faces[out.size] = t;
    out.neighbors[out.size++] = faces_[t][(k + 1) % 3];
    const std::int32_t next = neighbors_[t][(k + 1) % 3];
    if (next == kNone) {
      out.neighbors[out.size] = faces_[t][(k + 2) % 3];
      out.num_neighbors = out.size + 1;
      return true;
    }
    t = next;
  } while (t != first);
  out.num_neighbors = out.size;
  return true;
}

// A bay that is filled must hold no pixel: it would have no surface, or another one. On its sides
// lies no vertex but its corners, and no other fan meets its middle one: so no vertex ever lies on
// an edge of others, and whatever reached into the bay would have to cross its edges.
bool Triangulation::can_fill(const Surface& surface, std::int32_t first, std::int32_t v,
                             std::int32_t end) const {
  const Vertex &a = vertices_[first], &b = vertices_[v], &c = vertices_[end];
  const auto visit = [&](SidePixels edges, auto&& see) {
    visit_pixels(surface.cols(), {a.u, a.v}, {b.u, b.v}, {c.u, c.v}, edges, see);
  };
  bool free = true;
  visit(SidePixels::kOpen, [&](std::int32_t) { free = false; });
  visit(SidePixels::kClosed, [&](std::int32_t p) {
    const int own = p == b.pixel ? 1 : 0;
    const bool at_end = p == a.pixel || p == c.pixel;
    free = free && surface.sample(p).area > 0.0F && (at_end || num_at_[p] == own);
  });
  return free;
}

bool Triangulation::can_collapse(const Surface& surface, std::int32_t v, const Fan& fan,
                                 int i) const {
  const std::int32_t target = fan.neighbors[i];
  for (int k = 0; k < fan.size; ++k) {
    const std::int32_t a = fan.neighbors[k], b = fan.next(k);
    if (a != target && b != target && orient(target, a, b) <= 0) return false;
  }
  if (!vertices_[v].on_boundary) return true;
  // Along the boundary only, never the last triangle of a component, never closing a hole.
  const int last = fan.num_neighbors - 1;
  if ((i != 0 && i != last) || fan.size < 2) return false;
  const std::int32_t first = fan.neighbors[0], end = fan.neighbors[last];
  Fan around;
  if (!this->fan(target, around)) return false;
  const std::int32_t other = i == 0 ? end : first;
  for (int k = 0; k < around.num_neighbors; ++k) {
    if (around.neighbors[k] == other) return false;
  }
  const std::int64_t turn = orient(v, first, end);
  if (turn == 0) return num_at_[vertices_[v].pixel] == 1;
  return turn > 0 || can_fill(surface, first, v, end);
}

void Triangulation::relink(std::int32_t t, std::int32_t from, std::int32_t to) {
  if (t == kNone) return;
  for (std::int32_t& n : neighbors_[t]) {
    if (n == from) {
      n = to;
      return;
    }
  }
}

void Triangulation::find_first(std::int32_t v, std::int32_t t) {
  const std::int32_t from = t;
  for (;;) {
    const std::int32_t before = neighbors_[t][(corner(faces_[t], v) + 2) % 3];
    if (before == kNone || before == from) break;
    t = before;
  }
  vertices_[v].triangle = t;
}

void Triangulation::collapse(std::int32_t v, const Fan& fan, int i) {
  const std::int32_t target = fan.neighbors[i];
  std::int32_t stays = kNone;  // a triangle that the target has afterwards
  std::array<std::int32_t, 2> side{}, at_side{};
  int sides = 0;
  for (int k = 0; k < fan.size; ++k) {
    const std::int32_t t = fan.faces[k];
    const std::int32_t a = fan.neighbors[k], b = fan.next(k);
    if (a != target && b != target) {
      faces_[t][corner(faces_[t], v)] = target;
      stays = t;
      continue;
    }
    // Its two neighbours that remain become neighbours of each other.
    const std::int32_t beyond = neighbors_[t][corner(faces_[t], v)];
    const std::int32_t within = neighbors_[t][corner(faces_[t], target)];
    relink(beyond, t, within);
    relink(within, t, beyond);
    side[sides] = a == target ? b : a;
    at_side[sides++] = beyond != kNone ? beyond : within;
    faces_[t] = {kNone, kNone, kNone};
  }
  remove_vertex(v);
  find_first(target, stays);
  for (int k = 0; k < sides; ++k) find_first(side[k], at_side[k]);
}

bool Triangulation::quad(std::int32_t t, int i, std::array<std::int32_t, 4>& abcd) const {
  const std::int32_t across = neighbors_[t][i];
  if (across == kNone) return false;
  const std::int32_t a = faces_[t][i], b = faces_[t][(i + 1) % 3], c = faces_[t][(i + 2) % 3];
  const Triangle& other = faces_[across];
  const std::int32_t d = other[0] != b && other[0] != c   ? other[0]
                         : other[1] != b && other[1] != c ? other[1]
                                                          : other[2];
  abcd = {a, b, c, d};
  return orient(a, b, d) > 0 && orient(a, d, c) > 0;
}

void Triangulation::flip(std::int32_t t, int i) {
  const std::int32_t o = neighbors_[t][i];
  std::array<std::int32_t, 4> abcd{};
  quad(t, i, abcd);
  const auto [a, b, c, d] = abcd;
  const std::int32_t ca = neighbors_[t][(i + 1) % 3], ab = neighbors_[t][(i + 2) % 3];
  const std::int32_t cd = neighbors_[o][corner(faces_[o], b)];
  const std::int32_t db = neighbors_[o][corner(faces_[o], c)];
  faces_[t] = {a, b, d};
  neighbors_[t] = {db, o, ab};
  faces_[o] = {a, d, c};
  neighbors_[o] = {cd, ca, t};
  relink(db, o, t);
  relink(ca, t, o);
  find_first(a, t);
  find_first(b, t);
  find_first(d, t);
  find_first(c, o);
}

void Triangulation::move(std::int32_t v, const Surface& surface, std::int32_t pixel) {
  Vertex& vertex = vertices_[v];
  --num_at_[vertex.pixel];
  ++num_at_[pixel];
  vertex.pixel = pixel;
  vertex.u = surface.u(pixel);
  vertex.v = surface.v(pixel);
  vertex.point = surface.sample(pixel).point();
}

}  // namespace manip3d::relief_detail
