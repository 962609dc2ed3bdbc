#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/geometry/triangulate_polygon.hpp"
#include "manip3d/io/mesh_file.hpp"
#include "parse/input_buffer.hpp"

namespace manip3d {

/// A table that grows row by row in place: the C library moves large blocks without copying
/// them, and memory that was never written is never resident.
template <typename Matrix>
class GrowingTable {
 public:
  using Scalar = typename Matrix::Scalar;
  static constexpr int kColumns = Matrix::ColsAtCompileTime;

  [[nodiscard]] std::int64_t size() const { return size_; }
  [[nodiscard]] bool empty() const { return size_ == 0; }
  [[nodiscard]] Scalar* row(std::int64_t i) { return matrix_.data() + i * kColumns; }
  [[nodiscard]] const Scalar* row(std::int64_t i) const { return matrix_.data() + i * kColumns; }

  /// Makes room for rows whose bytes are known to be in the file.
  void reserve(std::int64_t rows) {
    if (rows > matrix_.rows()) matrix_.conservativeResize(rows, Eigen::NoChange);
  }
  /// Room for one more row; its content is to be written by the caller.
  Scalar* append(const InputBuffer& input) {
    if (size_ == matrix_.rows()) grow(input);
    return row(size_++);
  }
  /// Appends rows of `value` until there are `rows`.
  void fill(std::int64_t rows, Scalar value, const InputBuffer& input) {
    while (size_ < rows) std::fill_n(append(input), kColumns, value);
  }
  Matrix take() {
    matrix_.conservativeResize(size_, Eigen::NoChange);
    size_ = 0;
    return std::move(matrix_);
  }

 private:
  void grow(const InputBuffer& input) {
    input.check_expansion(static_cast<std::uint64_t>(size_) * kColumns * sizeof(Scalar));
    matrix_.conservativeResize(std::max<std::int64_t>(64, size_ + size_ / 2), Eigen::NoChange);
  }

  Matrix matrix_;
  std::int64_t size_ = 0;
};

/// Collects what a reader finds and makes a TriangleMesh of it; all readers share it.
///
/// A polygon of n corners takes its n - 2 rows at once and is cut at the end, when all positions
/// are known. Tables of attributes that never occur are never made.
class MeshBuilder {
 public:
  static constexpr std::int32_t kNone = -1;

  struct Corner {
    std::int32_t vertex = kNone;
    std::int32_t texcoord = kNone;
    std::int32_t normal = kNone;
  };

  /// @param first_index  how the format counts, for messages: OBJ from 1, others from 0.
  explicit MeshBuilder(const InputBuffer& input, std::int64_t first_index = 0)
      : input_(input), first_index_(first_index) {}

  GrowingTable<Vertices> vertices;
  GrowingTable<Texcoords> texcoords;
  GrowingTable<Vertices> normals;
  GrowingTable<Rows<float, 3>> colors;  ///< 0 to 1; shorter than vertices: white.

  void reserve_faces(std::int64_t num_faces) { faces_.reserve(num_faces); }

  /// Fewer than three corners make no face: such polygons are left out, and finish() warns.
  /// @param corners   indices >= -1, and vertices known to be >= 0.
  /// @param material  index into the materials of the mesh or -1.
  void add_polygon(std::span<const Corner> corners, std::int32_t material,
                   const FormatError::Position& position);

  /// Gives the faces of the last polygon a colour, 0xRRGGBB in sRGB.
  ///
  /// Few colours become materials, which keep their borders; more than that the mean at each
  /// vertex. Where the file has colours of vertices or materials, these count instead.
  void color_last_polygon(std::int32_t rgb);

  [[nodiscard]] std::int64_t num_polygons() const { return num_polygons_; }
  [[nodiscard]] std::int64_t num_faces() const { return faces_.size(); }

  /// Checks indices that pointed to rows not read yet, cuts the polygons, moves the tables out.
  /// @throws FormatError  an index of a vertex or texture coordinate out of range, at the position
  /// of the first such polygon.
  void finish(ReadResult& result);

 private:
  struct Polygon {
    std::int64_t first_face;    ///< First of the n - 2 rows of the polygon.
    std::int64_t first_corner;  ///< Index into corners_.
    std::int64_t num_corners;
  };
  struct ForwardReference {
    std::int64_t face;
    FormatError::Position position;
  };

  void add_triangle(const Corner& a, const Corner& b, const Corner& c);
  void warn_of_losses(ReadResult& result);
  /// Whether all normals that faces name are there: they do not change the surface.
  [[nodiscard]] bool check_forward_references() const;
  void cut_polygons();
  [[nodiscard]] Colors take_colors();
  void use_face_colors(ReadResult& result);

  const InputBuffer& input_;
  std::int64_t first_index_;
  GrowingTable<Faces> faces_;
  GrowingTable<Faces> face_texcoords_;
  GrowingTable<Faces> face_normals_;
  GrowingTable<Indices> face_material_;
  GrowingTable<Indices> face_colors_;  ///< 0xRRGGBB or kNone.
  std::int64_t last_face_ = 0;         ///< The first face of the last polygon.
  std::vector<Polygon> polygons_;
  GrowingTable<Faces> corners_;  ///< vertex, texcoord, normal of the corners of polygons_.
  std::vector<ForwardReference> forward_;
  std::int64_t num_polygons_ = 0;
  std::int64_t num_short_ = 0;  ///< Polygons of fewer than three corners.
  FormatError::Position first_short_;
};

}  // namespace manip3d
