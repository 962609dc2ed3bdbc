#include "simplify/relief/triangulation.hpp"

#include <algorithm>
#include <limits>
#include <numeric>
#include <utility>

#include "simplify/relief/raster.hpp"

namespace manip3d::relief_detail {

float price_of_cover(const Vec3& a, const Vec3& b, const Vec3& c) {
  const float area = 0.5F * (b - a).cross(c - a).norm();
  const float perimeter = (b - a).norm() + (c - b).norm() + (a - c).norm();
  return perimeter > 0.0F ? area * (2.0F / 3.0F) * area / perimeter : 0.0F;
}

void Triangulation::link_neighbors(std::span<const Triangle> faces) {
  // Each side waits at the pixel where it starts until the triangle on its other side is found.
  const auto num_faces = static_cast<std::int32_t>(faces.size());
  make_room(sides_, std::int64_t{3} * num_faces);
  sides_.resize(3 * faces.size());
  make_room(faces_, num_faces);
  faces_.resize(faces.size());
  for (std::int32_t t = 0; t < num_faces; ++t) {
    const auto link = [&](int i, std::int32_t start, std::int32_t end) {
      std::int32_t* waiting = &first_side_[end];
      while (*waiting != kNone && sides_[*waiting].end != start) waiting = &sides_[*waiting].next;
      const std::int32_t other = *waiting;
      if (other == kNone) {
        sides_[3 * t + i] = {end, first_side_[start]};
        first_side_[start] = 3 * t + i;
        faces_[t].neighbors[i] = kNone;
        return;
      }
      *waiting = sides_[other].next;
      faces_[t].neighbors[i] = other / 3;
      faces_[other / 3].neighbors[other % 3] = t;
    };
    const auto [a, b, c] = faces[t];
    link(0, b, c);
    link(1, c, a);
    link(2, a, b);
  }
  for (std::int32_t t = 0; t < num_faces; ++t) {  // leaves no waiting sides for the next mesh
    for (int i = 0; i < 3; ++i) {
      if (faces_[t].neighbors[i] == kNone) first_side_[faces[t][next_corner(i)]] = kNone;
    }
  }
}

void Triangulation::split_fans(const Surface& surface, std::span<const Triangle> faces) {
  for (Face& face : faces_) face.corners = {kNone, kNone, kNone};
  make_room(vertices_, static_cast<std::int64_t>(faces.size()) / 2);
  vertices_.clear();
  for (std::int32_t from = 0; from < num_face_slots(); ++from) {
    for (int i = 0; i < 3; ++i) {
      if (faces_[from].corners[i] != kNone) continue;
      const std::int32_t pixel = faces[from][i];
      const auto id = static_cast<std::int32_t>(vertices_.size());
      std::int32_t t = from;
      int k = i;
      do {
        faces_[t].corners[k] = id;
        t = faces_[t].neighbors[next_corner(k)];
        if (t == kNone) break;
        k = corner(faces[t], pixel);
      } while (t != from);
      std::int32_t first = from;
      if (t == kNone) {  // go backwards to the start of the fan
        k = i;
        for (;;) {
          const std::int32_t before = faces_[first].neighbors[previous_corner(k)];
          if (before == kNone) break;
          first = before;
          k = corner(faces[first], pixel);
          faces_[first].corners[k] = id;
        }
      }
      const int v = surface.v(pixel);
      vertices_.push_back(
          {pixel, first, pixel - v * surface.cols(), v, surface.sample(pixel).point(), t == kNone});
    }
  }
  num_alive_ = static_cast<std::int64_t>(vertices_.size());
  num_at_.assign(surface.num_pixels(), 0);
  for (const Vertex& vertex : vertices_) ++num_at_[vertex.pixel];
}

void Triangulation::assign(const Surface& surface, std::span<const Triangle> faces) {
  if (first_side_.size() < surface.num_pixels()) first_side_.resize(surface.num_pixels(), kNone);
  link_neighbors(faces);
  split_fans(surface, faces);
}

void Triangulation::compact() {
  make_room(new_number_, std::max(num_face_slots(), num_slots()));
  new_number_.resize(faces_.size());
  std::int32_t count = 0;
  for (std::int32_t t = 0; t < num_face_slots(); ++t) new_number_[t] = is_face(t) ? count++ : kNone;
  for (std::int32_t t = 0; t < num_face_slots(); ++t) {
    if (new_number_[t] == kNone) continue;
    Face face = faces_[t];
    for (std::int32_t& n : face.neighbors) n = n == kNone ? kNone : new_number_[n];
    faces_[new_number_[t]] = face;
  }
  faces_.resize(count);
  for (Vertex& vertex : vertices_) {
    if (vertex.alive()) vertex.triangle = new_number_[vertex.triangle];
  }
  new_number_.resize(vertices_.size());
  count = 0;
  for (std::int32_t v = 0; v < num_slots(); ++v) {
    if (!vertices_[v].alive()) continue;
    new_number_[v] = count;
    vertices_[count++] = vertices_[v];
  }
  vertices_.resize(count);
  for (Face& face : faces_) {
    for (std::int32_t& v : face.corners) v = new_number_[v];
  }
}

void Triangulation::clear() {
  vertices_.clear();
  faces_.clear();
  num_alive_ = 0;
}

void Triangulation::sorted_vertices(std::vector<std::int32_t>& out,
                                    std::vector<std::int32_t>& scratch) const {
  constexpr int kBits = 10;
  constexpr std::int32_t kDigits = 1 << kBits;
  std::array<std::int32_t, kDigits> first_of{};
  std::int32_t most = 0;
  make_room(out, num_slots());
  make_room(scratch, num_slots());
  out.clear();
  for (std::int32_t v = 0; v < num_slots(); ++v) {
    if (!vertices_[v].alive()) continue;
    out.push_back(v);
    most = std::max(most, vertices_[v].pixel);
  }
  // Radix sort by the digits of the pixel, the last one first; vertices of the same pixel keep
  // their order.
  scratch.resize(out.size());
  for (int shift = 0; shift < 31 && most >> shift != 0; shift += kBits) {
    const auto digit = [&](std::int32_t v) { return vertices_[v].pixel >> shift & (kDigits - 1); };
    first_of.fill(0);
    for (const std::int32_t v : out) ++first_of[digit(v)];
    std::exclusive_scan(first_of.begin(), first_of.end(), first_of.begin(), 0);
    for (const std::int32_t v : out) scratch[first_of[digit(v)]++] = v;
    out.swap(scratch);
  }
}

void Triangulation::remove_vertex(std::int32_t v) {
  vertices_[v].triangle = kNone;
  --num_alive_;
  --num_at_[vertices_[v].pixel];
}

void Triangulation::remove_piece(std::span<const std::int32_t> faces) {
  for (const std::int32_t t : faces) {
    for (const std::int32_t v : faces_[t].corners) {
      if (!vertices_[v].alive()) continue;
      remove_vertex(v);
    }
    faces_[t].corners = {kNone, kNone, kNone};
  }
}

float Triangulation::distance_to_others(const Surface& surface, std::int32_t t,
                                        const Vec3& point) const {
  std::array<std::int32_t, 2> low = {surface.cols(), surface.rows()}, high = {-1, -1};
  for (const std::int32_t v : faces_[t].corners) {
    low = {std::min(low[0], vertices_[v].u), std::min(low[1], vertices_[v].v)};
    high = {std::max(high[0], vertices_[v].u), std::max(high[1], vertices_[v].v)};
  }
  float nearest = std::numeric_limits<float>::infinity();
  const auto look = [&](int u, int v) {
    const std::int32_t pixel = v * surface.cols() + u;
    int others = num_at_[pixel];
    if (others == 0) return;
    for (const std::int32_t own : faces_[t].corners)
      others -= vertices_[own].pixel == pixel ? 1 : 0;
    if (others > 0) nearest = std::min(nearest, (surface.sample(pixel).point() - point).norm());
  };
  for (int v = low[1]; v <= high[1]; ++v) {
    for (int u = low[0]; u <= high[0]; ++u) look(u, v);
  }
  // Then ring by ring around that square.
  for (int ring = 1; !(nearest < 1.0F); ++ring) {
    const int left = low[0] - ring, right = high[0] + ring;
    const int below = low[1] - ring, above = high[1] + ring;
    if (left < 0 && below < 0 && right >= surface.cols() && above >= surface.rows()) return 1.0F;
    const int from_u = std::max(left, 0), to_u = std::min(right, surface.cols() - 1);
    const int from_v = std::max(below, 0), to_v = std::min(above, surface.rows() - 1);
    for (int u = from_u; u <= to_u; ++u) {
      if (below >= 0) look(u, below);
      if (above < surface.rows()) look(u, above);
    }
    for (int v = from_v; v <= to_v; ++v) {
      if (left >= 0) look(left, v);
      if (right < surface.cols()) look(right, v);
    }
  }
  return nearest;
}

bool Triangulation::fan(std::int32_t v, Fan& out) const {
  const std::int32_t first = vertices_[v].triangle;
  std::int32_t t = first;
  out.size = 0;
  int k = 0;
  do {
    if (out.size == kMaxFan) return false;
    k = corner(faces_[t].corners, v);
    out.faces[out.size] = t;
    out.neighbors[out.size++] = faces_[t].corners[next_corner(k)];
    const std::int32_t next = faces_[t].neighbors[next_corner(k)];
    if (next == kNone) {
      out.neighbors[out.size] = faces_[t].corners[previous_corner(k)];
      out.num_neighbors = out.size + 1;
      return true;
    }
    t = next;
  } while (t != first);
  out.num_neighbors = out.size;
  return true;
}

// A bay is free if no vertex except its corners lies on its sides, and no other fan has a vertex at
// its middle one. Then no vertex ever lies on an edge of others, and anything that reached into the
// bay would have to cross its edges.
Triangulation::Bay Triangulation::bay(const Surface& surface, std::int32_t v,
                                      const Fan& fan) const {
  const Vertex& b = vertices_[v];
  const Vertex& a = vertices_[fan.neighbors[0]];
  const Vertex& c = vertices_[fan.neighbors[fan.num_neighbors - 1]];
  Bay bay;
  if (orient(v, fan.neighbors[0], fan.neighbors[fan.num_neighbors - 1]) == -1) {
    bay.free = num_at_[b.pixel] == 1;  // it contains no pixels except its corners
    return bay;
  }
  int without = 0, pixels = 0;
  visit_pixels(surface.cols(), {a.u, a.v}, {b.u, b.v}, {c.u, c.v}, SidePixels::kClosed,
               [&](std::int32_t p) {
                 const int own = p == b.pixel ? 1 : 0;
                 const bool at_end = p == a.pixel || p == c.pixel;
                 bay.free = bay.free && (at_end || num_at_[p] == own);
                 without += surface.is_used(p) ? 0 : 1;
                 ++pixels;
               });
  if (!bay.free || without == 0) return bay;
  bay.price = price_of_cover(a.point, b.point, c.point) * static_cast<float>(without) /
              static_cast<float>(pixels);
  return bay;
}

bool Triangulation::can_collapse(const Surface& surface, std::int32_t v, const Fan& fan,
                                 int i) const {
  const std::int32_t target = fan.neighbors[i];
  for (int k = 0; k < fan.size; ++k) {
    const std::int32_t a = fan.neighbors[k], b = fan.next(k);
    if (a != target && b != target && orient(target, a, b) <= 0) return false;
  }
  if (!vertices_[v].on_boundary) return true;
  // A single triangle is cut off if there is another one behind it.
  if (fan.size == 1) return across(fan.faces[0], v) != kNone;
  // Only along the boundary, and never closing a hole.
  const int last = fan.num_neighbors - 1;
  if (i != 0 && i != last) return false;
  const std::int32_t first = fan.neighbors[0], end = fan.neighbors[last];
  Fan around;
  if (!this->fan(target, around)) return false;
  const std::int32_t other = i == 0 ? end : first;
  for (int k = 0; k < around.num_neighbors; ++k) {
    if (around.neighbors[k] == other) return false;
  }
  const std::int64_t turn = orient(v, first, end);
  if (turn == 0) return num_at_[vertices_[v].pixel] == 1;
  return turn > 0 || bay(surface, v, fan).free;
}

void Triangulation::relink(std::int32_t t, std::int32_t from, std::int32_t to) {
  if (t == kNone) return;
  for (std::int32_t& n : faces_[t].neighbors) {
    if (n == from) {
      n = to;
      return;
    }
  }
}

void Triangulation::find_first(std::int32_t v, std::int32_t t) {
  // Without a boundary, any triangle of the fan may be its first. The order of the fan follows from
  // the choice, and with it the last bits of sums over the fan.
  if (!vertices_[v].on_boundary) {
    vertices_[v].triangle = faces_[t].neighbors[next_corner(corner(faces_[t].corners, v))];
    return;
  }
  for (;;) {
    const std::int32_t before = faces_[t].neighbors[previous_corner(corner(faces_[t].corners, v))];
    if (before == kNone) break;
    t = before;
  }
  vertices_[v].triangle = t;
}

void Triangulation::collapse(std::int32_t v, const Fan& fan, int i) {
  const std::int32_t target = fan.neighbors[i];
  std::int32_t stays = kNone;  // a triangle that the target keeps
  std::array<std::int32_t, 2> side{}, at_side{};
  int sides = 0;
  for (int k = 0; k < fan.size; ++k) {
    const std::int32_t t = fan.faces[k];
    const std::int32_t a = fan.neighbors[k], b = fan.next(k);
    if (a != target && b != target) {
      faces_[t].corners[corner(faces_[t].corners, v)] = target;
      stays = t;
      continue;
    }
    // The two remaining neighbours of t become neighbours of each other.
    const std::int32_t beyond = faces_[t].neighbors[corner(faces_[t].corners, v)];
    const std::int32_t within = faces_[t].neighbors[corner(faces_[t].corners, target)];
    relink(beyond, t, within);
    relink(within, t, beyond);
    side[sides] = a == target ? b : a;
    at_side[sides++] = beyond != kNone ? beyond : within;
    faces_[t].corners = {kNone, kNone, kNone};
  }
  remove_vertex(v);
  find_first(target, stays != kNone ? stays : at_side[0]);
  for (int k = 0; k < sides; ++k) find_first(side[k], at_side[k]);
}

std::array<std::int32_t, 2> Triangulation::hole_of_three(const Surface& surface,
                                                         std::int32_t v) const {
  constexpr std::array<std::int32_t, 2> kNoHole = {kNone, kNone};
  // Each boundary edge goes from a vertex to its first neighbour; around a hole, these are
  // clockwise.
  const std::int32_t second = first_neighbor(v), first = first_neighbor(second);
  if (first_neighbor(first) != v || orient(v, first, second) <= 0) return kNoHole;
  const Vertex &a = vertices_[v], &b = vertices_[first], &c = vertices_[second];
  // A piece within the hole has a vertex off the corners, or is one triangle over all three of
  // them.
  bool free = std::min({num_at_[a.pixel], num_at_[b.pixel], num_at_[c.pixel]}) == 1;
  visit_pixels(surface.cols(), {a.u, a.v}, {b.u, b.v}, {c.u, c.v}, SidePixels::kClosed,
               [&](std::int32_t p) {
                 const bool at_corner = p == a.pixel || p == b.pixel || p == c.pixel;
                 free = free && (at_corner || num_at_[p] == 0);
               });
  return free ? std::array<std::int32_t, 2>{first, second} : kNoHole;
}

void Triangulation::close_hole(std::int32_t v, const std::array<std::int32_t, 2>& others) {
  const auto t = static_cast<std::int32_t>(faces_.size());
  const Triangle hole = {v, others[0], others[1]};
  faces_.push_back({hole, {}});
  for (int i = 0; i < 3; ++i) {
    // The first triangle of a corner's fan is behind the side to the previous corner.
    const std::int32_t behind = vertices_[hole[i]].triangle;
    faces_[t].neighbors[next_corner(i)] = behind;
    faces_[behind].neighbors[previous_corner(corner(faces_[behind].corners, hole[i]))] = t;
  }
  for (const std::int32_t at : hole) vertices_[at].on_boundary = false;
}

bool Triangulation::quad(std::int32_t t, int i, std::array<std::int32_t, 4>& abcd) const {
  const std::int32_t across = faces_[t].neighbors[i];
  if (across == kNone) return false;
  const std::int32_t a = faces_[t].corners[i], b = faces_[t].corners[next_corner(i)],
                     c = faces_[t].corners[previous_corner(i)];
  const Triangle& other = faces_[across].corners;
  const std::int32_t d = other[0] != b && other[0] != c   ? other[0]
                         : other[1] != b && other[1] != c ? other[1]
                                                          : other[2];
  abcd = {a, b, c, d};
  return orient(a, b, d) > 0 && orient(a, d, c) > 0;
}

void Triangulation::flip(std::int32_t t, int i) {
  const std::int32_t o = faces_[t].neighbors[i];
  std::array<std::int32_t, 4> abcd{};
  quad(t, i, abcd);
  const auto [a, b, c, d] = abcd;
  const std::int32_t ca = faces_[t].neighbors[next_corner(i)],
                     ab = faces_[t].neighbors[previous_corner(i)];
  const std::int32_t cd = faces_[o].neighbors[corner(faces_[o].corners, b)];
  const std::int32_t db = faces_[o].neighbors[corner(faces_[o].corners, c)];
  faces_[t].corners = {a, b, d};
  faces_[t].neighbors = {db, o, ab};
  faces_[o].corners = {a, d, c};
  faces_[o].neighbors = {cd, ca, t};
  relink(db, o, t);
  relink(ca, t, o);
  find_first(a, t);
  find_first(b, t);
  find_first(d, t);
  find_first(c, o);
}

void Triangulation::split_boundary(std::int32_t from, const Surface& surface, std::int32_t pixel) {
  const std::int32_t t = vertices_[from].triangle;
  const int k = corner(faces_[t].corners, from);
  const std::int32_t to = faces_[t].corners[next_corner(k)],
                     apex = faces_[t].corners[previous_corner(k)];
  const std::int32_t behind_apex_from = faces_[t].neighbors[next_corner(k)],
                     behind_to_apex = faces_[t].neighbors[k];
  const auto added = static_cast<std::int32_t>(faces_.size());
  const auto v = static_cast<std::int32_t>(vertices_.size());
  faces_[t].corners = {apex, from, v};
  faces_[t].neighbors = {kNone, added, behind_apex_from};
  faces_.push_back({{apex, v, to}, {kNone, behind_to_apex, t}});
  relink(behind_to_apex, t, added);
  vertices_.push_back(
      {pixel, added, surface.u(pixel), surface.v(pixel), surface.sample(pixel).point(), true});
  if (vertices_[to].triangle == t) vertices_[to].triangle = added;
  ++num_alive_;
  ++num_at_[pixel];
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
