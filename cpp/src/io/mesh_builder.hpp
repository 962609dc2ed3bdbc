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

/// A table that grows row by row in place. The C library moves large blocks without copying, and
/// memory that was never written is not resident.
template <typename Matrix>
class GrowingTable {
 public:
  using Scalar = typename Matrix::Scalar;
  static constexpr int kColumns = Matrix::ColsAtCompileTime;

  [[nodiscard]] std::int64_t size() const { return size_; }
  [[nodiscard]] bool empty() const { return size_ == 0; }
  [[nodiscard]] Scalar* row(std::int64_t i) { return matrix_.data() + i * kColumns; }
  [[nodiscard]] const Scalar* row(std::int64_t i) const { return matrix_.data() + i * kColumns; }

  /// Reserves rows whose bytes are known to be in the file.
  void reserve(std::int64_t rows) {
    if (rows > matrix_.rows()) matrix_.conservativeResize(rows, Eigen::NoChange);
  }
  /// Appends a row, which the caller must fill.
  Scalar* append(const InputBuffer& input) {
    if (size_ == matrix_.rows()) grow(input);
    return row(size_++);
  }
  /// Appends rows of `value` until there are `rows` rows.
  void fill(std::int64_t rows, Scalar value, const InputBuffer& input) {
    while (size_ < rows) std::fill_n(append(input), kColumns, value);
  }
  /// Keeps the rows for which `is_kept(row)`.
  template <typename IsKept>
  void keep(const IsKept& is_kept) {
    std::int64_t kept = 0;
    for (std::int64_t i = 0; i < size_; ++i) {
      if (is_kept(i)) std::copy_n(row(i), kColumns, row(kept++));
    }
    size_ = kept;
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

/// Builds a TriangleMesh from the data of a reader; common to all readers.
///
/// A polygon of n corners immediately takes the rows of its n - 2 triangles. It is triangulated at
/// the end, when all positions are known. Tables of attributes that do not occur are not allocated.
class MeshBuilder {
 public:
  static constexpr std::int32_t kNone = -1;

  struct Corner {
    std::int32_t vertex = kNone;
    std::int32_t texcoord = kNone;
    std::int32_t normal = kNone;
  };

  /// @param first_index  First index of the format, for messages: OBJ 1, others 0.
  explicit MeshBuilder(const InputBuffer& input, std::int64_t first_index = 0)
      : input_(input), first_index_(first_index) {}

  GrowingTable<Vertices> vertices;
  GrowingTable<Texcoords> texcoords;
  GrowingTable<Vertices> normals;
  GrowingTable<Rows<float, 3>>
      colors;  ///< 0 to 1, or all 0 to 255; vertices beyond its end are white.

  /// Whether texture coordinates or normals may be NaN or infinite: finish() leaves those out, and
  /// warns of it.
  bool may_have_nan = false;

  /// Notes that a coordinate ('x', 'y' or 'z') of the last vertex is NaN or infinite. finish()
  /// leaves such vertices out and warns of it, unless a face uses one.
  void add_not_finite(char coordinate, const FormatError::Position& position);
  /// @throws FormatError  a coordinate of a vertex is not finite.
  void check_positions() const;

  void reserve_faces(std::int64_t num_faces) { faces_.reserve(num_faces); }

  /// Adds a polygon. One with fewer than three corners is left out, and finish() warns of it.
  /// @param corners   Indices >= -1; vertices must be >= 0.
  /// @param material  Index into the materials of the mesh; -1: none.
  void add_polygon(std::span<const Corner> corners, std::int32_t material,
                   const FormatError::Position& position);

  /// Sets texture coordinates, which must exist, and the material of a face that is not part of a
  /// larger polygon. Called for each face in turn.
  void set_texture(std::int64_t face, const std::int32_t* texcoords_of_corners,
                   std::int32_t material);

  /// Gives the faces of the last polygon a colour, 0xRRGGBB in sRGB.
  ///
  /// A few colours become materials, so that borders stay sharp; if there are more, each vertex
  /// gets the mean. Colours of vertices or materials in the file take precedence.
  void color_last_polygon(std::int32_t rgb) { color_faces(last_face_, num_faces(), rgb); }
  /// Gives faces that come after all coloured ones a colour.
  void color_faces(std::int64_t begin, std::int64_t end, std::int32_t rgb);

  /// Changes the colour of faces that color_faces coloured before.
  void recolor_faces(std::int64_t begin, std::int64_t end, std::int32_t rgb);

  [[nodiscard]] std::int64_t num_polygons() const { return num_polygons_; }
  [[nodiscard]] std::int64_t num_faces() const { return faces_.size(); }

  /// Checks indices of rows that were not read yet, triangulates the polygons, and moves the tables
  /// to `result`.
  /// @throws FormatError  (at the first such polygon) the index of a vertex is out of range, or (at
  ///                      the vertex) a face uses a vertex that is not finite.
  void finish(ReadResult& result);

  /// Moves the colours of all vertices to the result; empty if the file has none.
  [[nodiscard]] Colors take_colors();

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

  /// A vertex with a coordinate that is NaN or infinite; small, because there may be millions.
  struct NotFinite {
    std::int64_t place;  ///< Line or byte.
    std::int32_t vertex;
    char coordinate;
    bool is_line;
  };

  [[noreturn]] static void refuse(const NotFinite& vertex);
  void add_triangle(const Corner& a, const Corner& b, const Corner& c);
  void warn_of_losses(ReadResult& result);
  /// Whether all texture coordinates and normals exist that faces refer to.
  struct Complete {
    bool texcoords = true, normals = true;
  };
  /// Missing texture coordinates and normals are no error, because they do not change the surface.
  [[nodiscard]] Complete check_forward_references() const;
  void leave_out_not_finite(ReadResult& result);
  void cut_polygons();
  void use_face_colors(ReadResult& result);

  const InputBuffer& input_;
  std::int64_t first_index_;
  GrowingTable<Faces> faces_;
  std::vector<NotFinite> not_finite_;  ///< In ascending order.
  GrowingTable<Faces> face_texcoords_;
  GrowingTable<Faces> face_normals_;
  GrowingTable<Indices> face_material_;
  GrowingTable<Indices> face_colors_;  ///< 0xRRGGBB or kNone.
  std::int64_t last_face_ = 0;         ///< The first face of the last polygon.
  std::vector<Polygon> polygons_;
  GrowingTable<Faces> corners_;  ///< vertex, texcoord, normal of the corners of polygons_.
  std::vector<ForwardReference> forward_;
  std::int64_t num_polygons_ = 0;
  std::int64_t num_short_ = 0;  ///< Polygons with fewer than three corners.
  FormatError::Position first_short_;
};

}  // namespace manip3d
