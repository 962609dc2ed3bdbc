#include "manip3d/simplify/grid_delaunay.hpp"

#include <algorithm>
#include <limits>
#include <string>

#include "manip3d/error.hpp"
#include "manip3d/geometry/camera.hpp"

namespace manip3d {
namespace {

void check_pixel(const Pixel& p) {
  if (p.u < 0 || p.v < 0 || p.u >= kMaxImageSide || p.v >= kMaxImageSide) {
    throw InputError("pixels: expected columns and rows from 0 to 16383, got (" +
                     std::to_string(p.u) + ", " + std::to_string(p.v) + ")");
  }
}

void check_pixels(std::span<const Pixel> pixels) {
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    check_pixel(pixels[i]);
    if (i > 0 && !(pixels[i - 1] < pixels[i])) {
      throw InputError("pixels: expected distinct pixels in row-major order, got (" +
                       std::to_string(pixels[i].u) + ", " + std::to_string(pixels[i].v) +
                       ") after (" + std::to_string(pixels[i - 1].u) + ", " +
                       std::to_string(pixels[i - 1].v) + ")");
    }
  }
}

}  // namespace

// Twice the signed area of abc: > 0 if counter-clockwise (u right, v up). Its magnitude is below
// 2^30.
std::int64_t GridDelaunay::orient(std::int32_t a, std::int32_t b, std::int32_t c) const {
  const Pixel &p = pixel(a), &q = pixel(b), &r = pixel(c);
  return std::int64_t{q.u - p.u} * (r.v - p.v) - std::int64_t{q.v - p.v} * (r.u - p.u);
}

// Whether the edge e, from a to b with p on its left and d on its right, must be replaced by the
// edge between p and d. The determinant is that of Guibas & Stolfi 1985: > 0 if d is inside the
// circle through a, b and p. Differences are below 2^14, so it is below 2^60.
bool GridDelaunay::is_illegal(std::int32_t e) const {
  const std::int32_t twin = edge(e).twin;
  const std::int32_t ia = edge(e).origin, ib = edge(twin).origin;
  const std::int32_t ip = edge(prev(e)).origin, id = edge(prev(twin)).origin;
  const Pixel &a = pixel(ia), &b = pixel(ib), &p = pixel(ip), &d = pixel(id);
  const std::int64_t au = a.u - d.u, av = a.v - d.v;
  const std::int64_t bu = b.u - d.u, bv = b.v - d.v;
  const std::int64_t pu = p.u - d.u, pv = p.v - d.v;
  const std::int64_t determinant = (au * au + av * av) * (bu * pv - bv * pu) -
                                   (bu * bu + bv * bv) * (au * pv - av * pu) +
                                   (pu * pu + pv * pv) * (au * bv - av * bu);
  if (determinant != 0) return determinant > 0;
  return std::max(p, d) < std::max(a, b);  // no diagonal ends in the last of the four
}

// Whether the angle at b, on the outer side of the front, is below 90 degrees.
bool GridDelaunay::is_narrow(std::int32_t a, std::int32_t b, std::int32_t c) const {
  const Pixel &p = pixel(a), &q = pixel(b), &r = pixel(c);
  return std::int64_t{p.u - q.u} * (r.u - q.u) + std::int64_t{p.v - q.v} * (r.v - q.v) > 0;
}

void GridDelaunay::link(std::int32_t e, std::int32_t twin) {
  edge(e).twin = twin;
  if (twin >= 0) {
    edge(twin).twin = e;
  } else {
    ring(~twin).edge = e;
  }
}

// Makes b follow a on the boundary, along half-edge e from b to a.
void GridDelaunay::set_boundary(std::int32_t a, std::int32_t b, std::int32_t e) {
  ring(a).next = b;
  ring(b).prev = a;
  link(e, ~a);
}

// Makes a triangle with half-edges e: a to b, e + 1: b to c, e + 2: c to a; returns e.
std::int32_t GridDelaunay::make_triangle(std::int32_t a, std::int32_t b, std::int32_t c) {
  const auto e = static_cast<std::int32_t>(edges_.size());
  edges_.insert(edges_.end(), {{a, ~0}, {b, ~0}, {c, ~0}, {-1, ~0}});
  return e;
}

// Flips the edge e, from a to b, between the triangles (a, b, p) and (b, a, d). Afterwards they are
// (a, d, p) with e from a to d, and (d, b, p) with e's old twin from b to p.
void GridDelaunay::flip(std::int32_t e) {
  const std::int32_t f = edge(e).twin;
  const std::int32_t e_next = next(e), f_next = next(f);
  const std::int32_t p = edge(prev(e)).origin, d = edge(prev(f)).origin;
  const std::int32_t beyond_bp = edge(e_next).twin, beyond_ad = edge(f_next).twin;
  edge(e_next).origin = d;
  edge(f_next).origin = p;
  link(e, beyond_ad);
  link(f, beyond_bp);
  link(e_next, f_next);
}

// Flips until all edges opposite the new vertex p are legal; e is such an edge with p on its left.
// Edges that end in p are legal, because p is new [Guibas & Stolfi 1985, lemma 10.2].
void GridDelaunay::legalize_star(std::int32_t e) {
  stack_.clear();
  while (true) {
    const std::int32_t f = edge(e).twin;
    if (f >= 0 && is_illegal(e)) {
      stack_.push_back(prev(f));
      flip(e);
    } else {
      if (stack_.empty()) return;
      e = stack_.back();
      stack_.pop_back();
    }
  }
}

// Flips until the edges e and f, and all edges around flipped ones, are legal.
void GridDelaunay::legalize(std::int32_t e, std::int32_t f) {
  stack_.clear();
  stack_.push_back(f);
  stack_.push_back(e);
  while (!stack_.empty()) {
    e = stack_.back();
    stack_.pop_back();
    f = edge(e).twin;
    if (f < 0 || !is_illegal(e)) continue;
    flip(e);
    stack_.insert(stack_.end(), {prev(f), f, prev(e), e});
  }
}

// Number of first vertices that lie on one line; if these are all, there is no triangle.
std::int32_t GridDelaunay::count_collinear() const {
  const auto n = static_cast<std::int32_t>(pixels_.size());
  std::int32_t count = std::min(n, 2);
  while (count < n && orient(0, 1, count) == 0) ++count;
  return count;
}

// Makes triangles from the vertices before `apex`, which lie on a line, to the apex.
void GridDelaunay::start_fan(std::int32_t apex) {
  const std::int32_t last = apex - 1;
  const bool counter_clockwise = orient(0, 1, apex) > 0;
  std::int32_t before = -1;  // shared half-edge of the previous triangle
  for (std::int32_t i = 0; i < last; ++i) {
    if (counter_clockwise) {
      const std::int32_t e = make_triangle(i, i + 1, apex);
      set_boundary(i + 1, i, e);
      if (i == 0) {
        set_boundary(0, apex, e + 2);
      } else {
        link(e + 2, before);
      }
      before = e + 1;
      if (i + 1 == last) set_boundary(apex, last, e + 1);
    } else {
      const std::int32_t e = make_triangle(i + 1, i, apex);
      set_boundary(i, i + 1, e);
      if (i == 0) {
        set_boundary(apex, 0, e + 1);
      } else {
        link(e + 1, before);
      }
      before = e + 2;
      if (i + 1 == last) set_boundary(last, apex, e + 2);
    }
  }
  // The front runs from the leftmost to the rightmost vertex; of two in a column, the later one is
  // the end.
  left_ = right_ = last_ = apex;
  for (const std::int32_t i : {0, last}) {
    if (pixel(i).u < pixel(left_).u || (pixel(i).u == pixel(left_).u && i > left_)) left_ = i;
    if (pixel(i).u > pixel(right_).u || (pixel(i).u == pixel(right_).u && i > right_)) right_ = i;
  }
}

// The last vertex of the front at or left of column u.
std::int32_t GridDelaunay::find_below(std::int32_t u) const {
  const auto node = [&](std::int32_t vertex) { return ring_[vertex]; };
  std::int32_t a = last_;
  if (u < pixel(a).u && u - pixel(left_).u < pixel(a).u - u) a = left_;
  while (pixel(a).u > u) a = node(a).prev;
  while (a != right_ && pixel(node(a).next).u <= u) a = node(a).next;
  return a;
}

// Makes the triangle between p and the boundary edge from a to the next vertex.
void GridDelaunay::attach(std::int32_t a, std::int32_t p) {
  const std::int32_t b = ring(a).next;
  const std::int32_t below = ring(a).edge;
  const std::int32_t e = make_triangle(a, b, p);
  link(e, below);
  set_boundary(a, p, e + 2);
  set_boundary(p, b, e + 1);
  legalize_star(e);
}

// Makes the triangle between boundary vertex b and its two neighbours, which removes b from the
// boundary.
void GridDelaunay::fill(std::int32_t b) {
  const std::int32_t a = ring(b).prev, c = ring(b).next;
  const std::int32_t below_ab = ring(a).edge, below_bc = ring(b).edge;
  const std::int32_t e = make_triangle(a, b, c);
  link(e, below_ab);
  link(e + 1, below_bc);
  set_boundary(a, c, e + 2);
  legalize(e, e + 1);
}

void GridDelaunay::smooth_right(std::int32_t p) {
  for (std::int32_t b = ring(p).next; b != right_; b = ring(p).next) {
    const std::int32_t c = ring(b).next;
    if (orient(p, b, c) <= 0 || !is_narrow(p, b, c)) return;
    fill(b);
  }
}

void GridDelaunay::smooth_left(std::int32_t p) {
  for (std::int32_t b = ring(p).prev; b != left_; b = ring(p).prev) {
    const std::int32_t a = ring(b).prev;
    if (orient(a, b, p) <= 0 || !is_narrow(a, b, p)) return;
    fill(b);
  }
}

// Adds p to the right of all vertices. It sees either the edge below the end of the front, or the
// last edge of the front.
void GridDelaunay::add_right(std::int32_t p) {
  const std::int32_t end = right_;
  attach(orient(end, ring(end).next, p) > 0 ? end : ring(end).prev, p);
  right_ = p;
  for (std::int32_t b = ring(p).next; orient(p, b, ring(b).next) > 0; b = ring(p).next) fill(b);
  smooth_left(p);
}

void GridDelaunay::add_left(std::int32_t p) {
  const std::int32_t end = left_;
  attach(orient(ring(end).prev, end, p) > 0 ? ring(end).prev : end, p);
  left_ = p;
  for (std::int32_t b = ring(p).prev; orient(ring(b).prev, b, p) > 0; b = ring(p).prev) fill(b);
  smooth_right(p);
}

// Adds vertex p, which lies above or right of all vertices before it.
void GridDelaunay::add(std::int32_t p) {
  const std::int32_t u = pixel(p).u;
  if (u > pixel(right_).u) {
    add_right(p);
  } else if (u < pixel(left_).u) {
    add_left(p);
  } else {
    const std::int32_t a = find_below(u);
    const bool hides = pixel(a).u == u;  // a lies straight below p and leaves the front
    if (a == right_) {
      attach(ring(a).prev, p);
      right_ = p;
    } else {
      attach(a, p);
      if (hides && a == left_) left_ = p;
      if (hides && left_ != p) fill(a);
    }
    if (p != left_) smooth_left(p);
    if (p != right_) smooth_right(p);
  }
  last_ = p;
}

// Makes the front convex, from left to right [Graham 1972].
void GridDelaunay::fill_bays() {
  std::int32_t a = left_;
  while (a != right_ && ring(a).next != right_) {
    const std::int32_t b = ring(a).next;
    if (orient(a, b, ring(b).next) > 0) {
      fill(b);
      if (a != left_) a = ring(a).prev;
    } else {
      a = b;
    }
  }
}

void GridDelaunay::reserve(std::int64_t num_pixels) {
  const std::size_t n = num_pixels;
  pixels_.reserve(n);
  ring_.reserve(n);
  edges_.reserve(2 * n * kStride);
  stack_.reserve(2 * n * kStride);  // edges to test; each flip adds four and removes one
}

void GridDelaunay::triangulate(std::span<const Pixel> pixels) {
  check_pixels(pixels);
  reserve(static_cast<std::int64_t>(pixels.size()));
  pixels_.assign(pixels.begin(), pixels.end());
  edges_.clear();
  ring_.resize(pixels.size());
  const auto n = static_cast<std::int32_t>(pixels.size());
  const std::int32_t apex = count_collinear();
  if (apex == n) return;
  start_fan(apex);
  for (std::int32_t p = apex + 1; p < n; ++p) add(p);
  fill_bays();
}

}  // namespace manip3d
