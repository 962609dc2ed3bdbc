#pragma once

#include <compare>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "manip3d/geometry/range_image.hpp"
#include "manip3d/simplify/relief.hpp"
#include "simplify/relief/surface.hpp"
#include "simplify/relief/triangulation.hpp"

namespace manip3d::relief_detail {

/// Writes the mesh of a run and its smaller levels to a result, in which they share the vertices.
class ReliefWriter {
 public:
  /// The relief that is written; everything is borrowed.
  struct Meshes {
    const Surface& surface;
    const Triangulation& mesh;
    std::span<const Triangulation> levels;  ///< Smallest first; each holds the next smaller one.
    /// Whether a pixel of the surface is a pinhole: a vertex there is not written. Empty: none is.
    std::function<bool(std::int32_t)> is_pinhole;
    bool once = false;  ///< The mesh has one output vertex per pixel, as its levels always have.
  };
  /// Fills the vertices, pixels, texture coordinates and faces of the result, and its levels.
  void write(const Meshes& meshes, const PointGridView& grid, ReliefResult& result);

  /// After write(), the vertices of the mesh sorted by pixel. Without levels, the output vertices
  /// are in this order.
  [[nodiscard]] std::span<const std::int32_t> order() const { return order_; }
  /// After write(), the output vertex of a vertex of the mesh; kNone: it was left out.
  [[nodiscard]] std::int32_t number(std::int32_t vertex) const { return number_[vertex]; }

 private:
  /// Form in which a vertex is written.
  enum class Written : std::uint8_t {
    kNot,       ///< Left out.
    kAsOwn,     ///< Becomes an output vertex of its own.
    kWithLast,  ///< Shares that of the previous vertex in `order_`, at the same pixel.
  };
  struct Placed {
    std::int32_t pixel, number;
    auto operator<=>(const Placed&) const = default;
  };
  /// Fills `written_`. A vertex that could not leave a pinhole is not written, nor are its
  /// triangles and the vertices that lose all their triangles by this. Goes from the largest mesh
  /// to the smallest, because each mesh holds the vertices of the next smaller one: where a larger
  /// mesh has one vertex at a pixel and a smaller one has two (of fans that touch only there), the
  /// two share it.
  void find_written(const Meshes& meshes);
  /// find_written() for one mesh. `written_pixels_` are those of the next larger mesh before the
  /// call, and those of this mesh after it.
  void find_written_of(const Triangulation& mesh,
                       const std::function<bool(std::int32_t)>& is_pinhole,
                       std::vector<Written>& how);
  /// Fills `number_`: first the vertices that smaller meshes have in `placed_`, then new ones.
  /// @return  the number of output vertices so far.
  std::int32_t number_vertices(const Triangulation& mesh, std::span<const Written> how);
  void write_vertices(const Surface& surface, const PointGridView& grid, DepthMesh& out) const;
  void write_faces(const Triangulation& mesh, bool rows_up, Rows<std::int32_t, 3>& to) const;

  std::vector<std::int32_t> order_;    ///< Vertices of the latest mesh, sorted by pixel.
  std::vector<std::int32_t> sorting_;  ///< Scratch memory of Triangulation::sorted_vertices().
  std::vector<std::int32_t> number_;   ///< Vertex -> output vertex; kNone: left out.
  /// By mesh (the levels, smallest first, then the mesh) and vertex. An empty list stands for
  /// kAsOwn everywhere.
  std::vector<std::vector<Written>> written_;
  std::vector<std::uint8_t> may_write_;       ///< Scratch memory of find_written_of(), by vertex.
  std::vector<std::int32_t> written_pixels_;  ///< Pixels of the vertices that are written, sorted.
  std::vector<Placed> placed_;                ///< Output vertices sorted by pixel.
};

}  // namespace manip3d::relief_detail
