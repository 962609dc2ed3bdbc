#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "manip3d/geometry/bvh.hpp"
#include "manip3d/geometry/mesh.hpp"

namespace manip3d {

/// The pieces of a mesh (faces joined by vertices) and what it costs to remove one as a whole: the
/// integral over its surface of the distance to the pieces that are still there, in the original
/// shape. Lengths are input units over `scale`. None when the mesh is one piece.
class Pieces {
 public:
  /// @param samples_one  a mesh of one piece, which cannot be removed, has samples, too.
  Pieces(const MeshView& mesh, double scale, const Progress& progress, bool samples_one = false);

  [[nodiscard]] std::int32_t size() const {
    return pieces_.size() > 1 ? static_cast<std::int32_t>(pieces_.size()) : 0;
  }
  [[nodiscard]] bool has_samples() const { return !pieces_.empty(); }
  /// Piece of a vertex; -1: it is in no face.
  [[nodiscard]] std::int32_t of_vertex(std::int32_t v) const { return of_vertex_[v]; }
  [[nodiscard]] const std::vector<std::int32_t>& vertices(std::int32_t piece) const {
    return pieces_[piece].vertices;
  }
  [[nodiscard]] std::int64_t num_faces(std::int32_t piece) const { return pieces_[piece].faces; }
  [[nodiscard]] bool is_there(std::int32_t piece) const { return pieces_[piece].faces > 0; }
  void remove_faces(std::int32_t piece, std::int64_t count) { pieces_[piece].faces -= count; }

  /// Infinite for the last piece. The result may change when other pieces go.
  [[nodiscard]] double cost(std::int32_t piece) const { return pieces_[piece].cost; }
  [[nodiscard]] double mean_distance(std::int32_t piece) const;
  /// How far the texture coordinates of the piece are on average from those of the places that the
  /// distance is measured to; 0 for parts that show another material there.
  [[nodiscard]] double texture_shift(std::int32_t piece) const {
    return pieces_[piece].texture_shift;
  }
  [[nodiscard]] double area(std::int32_t piece) const { return pieces_[piece].area; }
  /// Points at equal steps of area on the original surface, in the input's coordinates.
  [[nodiscard]] std::vector<Eigen::Vector3d> samples(std::int32_t piece) const;
  /// Measures the cost again if a piece it was measured to is gone; whether it was.
  bool refresh(std::int32_t piece);

 private:
  struct Piece {
    std::vector<std::int32_t> vertices;
    std::vector<std::int32_t> samples;  // faces with a point that stands for the surface
    std::vector<std::int32_t> nearest;  // the pieces that the samples are near to
    std::int64_t faces = 0;             // still there
    double area = 0.0;
    double cost = 0.0;
    double texture_shift = 0.0;
  };

  void measure(std::int32_t piece);
  [[nodiscard]] Eigen::Vector3d point_of(std::int32_t face, std::int64_t sample) const;
  [[nodiscard]] bool shows_texture(std::int32_t face) const;
  /// Whether both faces show a texture, of the same material.
  [[nodiscard]] bool looks_like(std::int32_t face, std::int32_t other) const;
  [[nodiscard]] Eigen::RowVector2d texture_at(std::int32_t face,
                                              const Eigen::Vector3d& barycentric) const;
  [[nodiscard]] double area_of_face(std::int32_t face) const;

  const MeshView& mesh_;
  double scale_;
  std::unique_ptr<TriangleBvh> bvh_;
  std::vector<Piece> pieces_;
  Indices of_vertex_;
};

}  // namespace manip3d
