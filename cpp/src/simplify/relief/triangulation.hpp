#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "simplify/relief/raster.hpp"
#include "simplify/relief/surface.hpp"

namespace manip3d::relief_detail {

using Triangle = std::array<std::int32_t, 3>;

/// Price of a triangle over a place without surface: its area times the mean distance of its points
/// from its sides, which is a third of the inradius.
float price_of_cover(const Vec3& a, const Vec3& b, const Vec3& c);

/// A triangulation of some pixels in the pixel plane, with neighbours across edges, for removing
/// vertices and flipping edges. All triangles are counter-clockwise with v up, so it never folds
/// over as seen from the sensor.
///
/// If two fans of triangles meet at a pixel, each has its own vertex there: every vertex has one
/// fan, which is closed inside and open on the boundary.
class Triangulation {
 public:
  static constexpr std::int32_t kNone = -1;
  static constexpr int kMaxFan = 64;  ///< Triangles around a vertex.

  struct alignas(32) Vertex {
    std::int32_t pixel = 0;
    std::int32_t triangle = kNone;  ///< The first of its fan if on the boundary; kNone: removed.
    std::int32_t u = 0, v = 0;
    Vec3 point = Vec3::Zero();
    bool on_boundary = false;
    [[nodiscard]] bool alive() const { return triangle != kNone; }
  };

  /// The triangles around a vertex in order, and its neighbours. On the boundary there is one
  /// neighbour more than triangles, and the first and the last are on the boundary as well;
  /// elsewhere there are as many.
  struct Fan {
    int size = 0, num_neighbors = 0;
    std::array<std::int32_t, kMaxFan> faces;
    std::array<std::int32_t, kMaxFan + 1> neighbors;
    /// The neighbour after neighbour i around the fan's centre.
    [[nodiscard]] std::int32_t next(int i) const {
      return neighbors[i + 1 < num_neighbors ? i + 1 : 0];
    }
  };

  /// Builds the triangulation from triangles whose corners are pixels.
  void assign(const Surface& surface, std::span<const Triangle> faces);

  void clear();
  /// Frees the scratch memory of assign().
  void release_scratch() {
    release(first_side_);
    release(sides_);
  }
  /// Removes the slots of removed vertices and triangles; the others keep their order.
  void compact();
  /// Removes triangles that have no other neighbours than each other.
  void remove_piece(std::span<const std::int32_t> faces);

  [[nodiscard]] std::int32_t num_slots() const {
    return static_cast<std::int32_t>(vertices_.size());
  }
  [[nodiscard]] std::int64_t num_vertices() const { return num_alive_; }
  /// Vertices sorted by pixel, those of the same pixel by index.
  void sorted_vertices(std::vector<std::int32_t>& out, std::vector<std::int32_t>& scratch) const;
  [[nodiscard]] const Vertex& vertex(std::int32_t v) const { return vertices_[v]; }
  /// Number of vertices at a pixel, one for each fan.
  [[nodiscard]] int num_at(std::int32_t pixel) const { return num_at_[pixel]; }
  /// The first neighbour of a vertex around its fan; on the boundary if the vertex is.
  [[nodiscard]] std::int32_t first_neighbor(std::int32_t v) const {
    const std::int32_t t = vertices_[v].triangle;
    return faces_[t].corners[next_corner(corner(faces_[t].corners, v))];
  }
  [[nodiscard]] std::int32_t num_face_slots() const {
    return static_cast<std::int32_t>(faces_.size());
  }
  [[nodiscard]] bool is_face(std::int32_t t) const { return faces_[t].corners[0] != kNone; }
  [[nodiscard]] const Triangle& triangle(std::int32_t t) const { return faces_[t].corners; }
  /// Triangles across the sides opposite to the three corners, or kNone.
  [[nodiscard]] const Triangle& neighbors(std::int32_t t) const { return faces_[t].neighbors; }

  /// Whether t is a piece of its own.
  [[nodiscard]] bool is_alone(std::int32_t t) const {
    // A == of arrays would be a call that compares bytes.
    const auto [a, b, c] = faces_[t].neighbors;
    return a == kNone && b == kNone && c == kNone;
  }
  /// Distance of a point from the nearest vertex of other pieces than t, a piece of its own: the
  /// nearest among those in the smallest square of pixels around t that contains any. 1 (the
  /// diagonal of the surface) if there is none.
  [[nodiscard]] float distance_to_others(const Surface& surface, std::int32_t t,
                                         const Vec3& point) const;

  /// Returns false if there are more than kMaxFan triangles.
  bool fan(std::int32_t v, Fan& out) const;

  /// Twice the signed area of a triangle in pixels.
  [[nodiscard]] std::int64_t orient(std::int32_t a, std::int32_t b, std::int32_t c) const {
    const Vertex &p = vertices_[a], &q = vertices_[b], &r = vertices_[c];
    return doubled_area({p.u, p.v}, {q.u, q.v}, {r.u, r.v});
  }

  /// The triangle outside a boundary vertex, between its outer neighbours, where the boundary turns
  /// inwards. It is filled when v merges into one of them.
  struct Bay {
    bool free = true;    ///< It contains nothing else.
    float price = 0.0F;  ///< Price of covering its pixels without surface.
  };
  [[nodiscard]] bool has_bay(std::int32_t v, const Fan& fan) const {
    return vertices_[v].on_boundary &&
           orient(v, fan.neighbors[0], fan.neighbors[fan.num_neighbors - 1]) < 0;
  }
  [[nodiscard]] Bay bay(const Surface& surface, std::int32_t v, const Fan& fan) const;

  /// Whether `fan`'s centre v may merge into its neighbour number i.
  [[nodiscard]] bool can_collapse(const Surface& surface, std::int32_t v, const Fan& fan,
                                  int i) const;
  /// Merges v into its neighbour number i of `fan`.
  void collapse(std::int32_t v, const Fan& fan, int i);

  /// The other two vertices of a hole of three vertices at v; the triangle (v, first, second)
  /// closes it. {kNone, kNone} if there is no such hole, or something is inside it.
  [[nodiscard]] std::array<std::int32_t, 2> hole_of_three(const Surface& surface,
                                                          std::int32_t v) const;
  /// Fills a hole of three vertices, which become interior ones.
  void close_hole(std::int32_t v, const std::array<std::int32_t, 2>& others);

  /// The quadrilateral around the side of t opposite its corner i: corners a (corner i), b and c
  /// (the ends of the side), and d (on the other side). Returns false on the boundary, or if it is
  /// not strictly convex.
  bool quad(std::int32_t t, int i, std::array<std::int32_t, 4>& abcd) const;
  /// Replaces the side bc by ad: triangle t becomes abd, the other one adc.
  void flip(std::int32_t t, int i);

  /// Adds a vertex at a pixel to the boundary edge from `from` to its first neighbour, which must
  /// make no triangle fold over.
  void split_boundary(std::int32_t from, const Surface& surface, std::int32_t pixel);

  /// Moves a vertex to another pixel.
  void move(std::int32_t v, const Surface& surface, std::int32_t pixel);
  /// Places a vertex at an offset from its pixel's point.
  void slide(std::int32_t v, const Surface& surface, const Vec3& offset) {
    vertices_[v].point = surface.sample(vertices_[v].pixel).point() + offset;
  }

 private:
  static int next_corner(int i) { return i < 2 ? i + 1 : 0; }
  static int previous_corner(int i) { return i > 0 ? i - 1 : 2; }
  /// Index of corner v, computed without branches, which would be unpredictable.
  static int corner(const Triangle& t, std::int32_t v) {
    const int later = t[0] != v ? 1 : 0;
    return later + (later & (t[1] != v ? 1 : 0));
  }
  /// The triangle on the other side of t's side opposite its corner v, or kNone.
  [[nodiscard]] std::int32_t across(std::int32_t t, std::int32_t v) const {
    return faces_[t].neighbors[corner(faces_[t].corners, v)];
  }
  void link_neighbors(std::span<const Triangle> faces);
  void split_fans(const Surface& surface, std::span<const Triangle> faces);
  void relink(std::int32_t t, std::int32_t from, std::int32_t to);
  void find_first(std::int32_t v, std::int32_t t);
  void remove_vertex(std::int32_t v);

  std::vector<Vertex> vertices_;
  /// Both are read together.
  struct alignas(32) Face {
    Triangle corners, neighbors;
  };
  std::vector<Face> faces_;
  std::int64_t num_alive_ = 0;
  std::vector<std::uint8_t> num_at_;  ///< By pixel: number of vertices.
  // Scratch memory of assign(): sides whose other triangle is not found yet.
  struct Side {
    std::int32_t end, next;  ///< Pixel where the side ends; next side from the same pixel.
  };
  std::vector<std::int32_t> first_side_;  ///< By pixel where sides start; kNone between calls.
  std::vector<Side> sides_;               ///< By three times the triangle plus the opposite corner.
  std::vector<std::int32_t> new_number_;  ///< Scratch of compact().
};

}  // namespace manip3d::relief_detail
