#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace manip3d {

/// A pixel: column u and row v, 0 to kMaxImageSide - 1.
struct Pixel {
  std::int32_t u = 0, v = 0;
  /// Row-major order.
  [[nodiscard]] bool operator<(const Pixel& other) const {
    return v != other.v ? v < other.v : u < other.u;
  }
  [[nodiscard]] bool operator==(const Pixel&) const = default;
};

/// Delaunay triangulation of distinct pixels: exact, unique and deterministic.
///
/// All predicates are exact in 64-bit integers, which limits images to 16 384 pixels a side. On a
/// grid, four pixels on a circle are common. Such ties are broken by symbolic perturbation: each
/// point, lifted to the paraboloid, is raised by an infinitesimal amount, which is larger by orders
/// of magnitude for later pixels in row-major order [after Devillers & Teillaud, "Perturbations for
/// Delaunay and weighted Delaunay 3D triangulations", 2011]. Four pixels on a circle are therefore
/// cut by the diagonal that does not end in the last of them, and the triangulation depends only on
/// the set of pixels.
///
/// The pixels are swept row by row [after Domiter & Zalik, "Sweep-line algorithm for constrained
/// Delaunay triangulation", 2008]: above the triangulated part runs a front, monotone in u, to
/// which each pixel is connected vertically, and edges are flipped [Lawson 1977] until they are
/// Delaunay. At the end, the bays of the front are filled up to the convex hull. About O(n) on
/// images, O(n^2) at worst. Reusing an object reuses its memory.
class GridDelaunay {
 public:
  /// @param pixels  Strictly increasing in row-major order; copied. If there are fewer than three,
  ///                or all are on a line, the result has no triangles.
  /// @throws InputError  pixels not in order (this includes repeated ones), or out of range.
  void triangulate(std::span<const Pixel> pixels);

  /// Makes the given edges edges of the triangulation, which stays Delaunay beside them.
  ///
  /// Edges that cross a given one are flipped away [Sloan, "A fast algorithm for generating
  /// constrained Delaunay triangulations", 1993]. A given edge with pixels on it becomes several.
  /// One that crosses an earlier one is left out, from the last pixel on it before the crossing.
  /// @param edges  Pairs of vertices, the more important ones first.
  /// @throws InputError  a vertex that does not exist.
  void constrain(std::span<const std::array<std::int32_t, 2>> edges);

  /// Reserves memory for this many pixels, so that triangulating up to as many allocates nothing.
  void reserve(std::int64_t num_pixels);

  [[nodiscard]] std::span<const Pixel> pixels() const { return pixels_; }
  [[nodiscard]] std::int32_t num_faces() const {
    return static_cast<std::int32_t>(edges_.size() / kStride);
  }
  /// Vertices of triangle t, counter-clockwise for u to the right and v up.
  [[nodiscard]] std::array<std::int32_t, 3> triangle(std::int32_t t) const {
    return {edge(kStride * t).origin, edge(kStride * t + 1).origin, edge(kStride * t + 2).origin};
  }

 private:
  // Half-edge e of triangle e / 4 runs from its origin to the origin of next(e); the fourth of each
  // triangle is unused. `twin` is the half-edge on the other side, or ~a on the boundary, where a
  // is the vertex in which it ends.
  struct HalfEdge {
    std::int32_t origin, twin;
  };
  static constexpr std::int32_t kStride = 4;
  static std::int32_t next(std::int32_t e) { return (e & 3) == 2 ? e - 2 : e + 1; }
  static std::int32_t prev(std::int32_t e) { return (e & 3) == 0 ? e + 2 : e - 1; }
  HalfEdge& edge(std::int32_t e) { return edges_[e]; }
  [[nodiscard]] const HalfEdge& edge(std::int32_t e) const { return edges_[e]; }
  [[nodiscard]] const Pixel& pixel(std::int32_t vertex) const { return pixels_[vertex]; }
  // The boundary is a ring of vertices in clockwise order: the front from left to right, then the
  // lower side.
  struct BoundaryVertex {
    std::int32_t next, prev;
    std::int32_t edge;  ///< The half-edge from `next` to this vertex.
  };
  BoundaryVertex& ring(std::int32_t vertex) { return ring_[vertex]; }

  [[nodiscard]] std::int64_t orient(std::int32_t a, std::int32_t b, std::int32_t c) const;
  [[nodiscard]] bool is_illegal(std::int32_t e) const;
  [[nodiscard]] bool is_narrow(std::int32_t a, std::int32_t b, std::int32_t c) const;
  void link(std::int32_t e, std::int32_t twin);
  void set_boundary(std::int32_t a, std::int32_t b, std::int32_t e);
  std::int32_t make_triangle(std::int32_t a, std::int32_t b, std::int32_t c);
  void flip(std::int32_t e);
  void legalize_star(std::int32_t e);
  void legalize(std::int32_t e, std::int32_t f);

  std::int32_t count_collinear() const;
  void start_fan(std::int32_t apex);
  std::int32_t find_below(std::int32_t u) const;
  void attach(std::int32_t a, std::int32_t p);
  void fill(std::int32_t b);
  void add(std::int32_t p);
  void add_right(std::int32_t p);
  void add_left(std::int32_t p);
  void smooth_left(std::int32_t p);
  void smooth_right(std::int32_t p);
  void fill_bays();

  class Constraints;

  std::vector<Pixel> pixels_;
  std::vector<HalfEdge> edges_;
  std::vector<BoundaryVertex> ring_;
  std::vector<std::int32_t> stack_;
  std::int32_t left_ = -1, right_ = -1, last_ = -1;  ///< Ends of the front; the last vertex added.
};

}  // namespace manip3d
