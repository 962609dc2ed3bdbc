#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "manip3d/geometry/bvh.hpp"
#include "manip3d/geometry/mesh.hpp"

namespace manip3d {

/// The pieces of a mesh (faces connected by vertices) and the cost of removing each as a whole: the
/// integral over its surface of the distance to the remaining pieces, in their original shape.
/// Lengths are input units divided by `scale`. There are no pieces if the mesh is connected.
class Pieces {
 public:
  /// @param looks        By material; see QualityOptions::looks.
  /// @param samples_one  Take samples of a connected mesh as well, although it cannot be removed.
  Pieces(const MeshView& mesh, double scale, const std::vector<std::int32_t>& looks,
         const Progress& progress, bool samples_one = false);

  [[nodiscard]] std::int32_t size() const {
    return pieces_.size() > 1 ? static_cast<std::int32_t>(pieces_.size()) : 0;
  }
  [[nodiscard]] bool has_samples() const { return !pieces_.empty(); }
  /// Piece of a vertex; -1 if it is in no face.
  [[nodiscard]] std::int32_t of_vertex(std::int32_t v) const { return of_vertex_[v]; }
  [[nodiscard]] const std::vector<std::int32_t>& vertices(std::int32_t piece) const {
    return pieces_[piece].vertices;
  }
  [[nodiscard]] std::int64_t num_faces(std::int32_t piece) const { return pieces_[piece].faces; }
  [[nodiscard]] bool is_there(std::int32_t piece) const { return pieces_[piece].faces > 0; }
  void remove_faces(std::int32_t piece, std::int64_t count) { pieces_[piece].faces -= count; }

  /// Infinite for the last piece. The cost may change when other pieces are removed.
  [[nodiscard]] double cost(std::int32_t piece) const { return pieces_[piece].cost; }
  [[nodiscard]] double mean_distance(std::int32_t piece) const;
  /// Mean difference between the texture coordinates of the piece and those of the points to which
  /// the distance is measured; 0 for parts where the other piece has another look.
  [[nodiscard]] double texture_shift(std::int32_t piece) const {
    return pieces_[piece].texture_shift;
  }
  /// Mean distance by which the surface behind the piece would have to be farther away to be as
  /// wrong as it is because it looks different; 0 for parts that cannot be seen from outside.
  [[nodiscard]] double wrong_look(std::int32_t piece) const { return pieces_[piece].wrong_look; }
  [[nodiscard]] double area(std::int32_t piece) const { return pieces_[piece].area; }
  /// Points at equal steps of area on the original surface, in the input's coordinates.
  [[nodiscard]] std::vector<Eigen::Vector3d> samples(std::int32_t piece) const;
  /// Computes the cost again if a piece to which it was measured was removed; returns whether it
  /// did.
  bool refresh(std::int32_t piece);

 private:
  struct Piece {
    std::vector<std::int32_t> vertices;
    std::vector<std::int32_t> samples;  // faces with a sample of the surface
    std::vector<std::int32_t> nearest;  // the pieces nearest to the samples
    std::int64_t faces = 0;             // remaining ones
    double area = 0.0;
    double cost = 0.0;
    double texture_shift = 0.0;
    double wrong_look = 0.0;
  };

  void measure(std::int32_t piece);
  [[nodiscard]] Eigen::Vector3d point_of(std::int32_t face, std::int64_t sample) const;
  [[nodiscard]] bool shows_texture(std::int32_t face) const;
  [[nodiscard]] std::int32_t look_of(std::int32_t face) const;
  /// Whether both faces show a texture, of materials that look the same.
  [[nodiscard]] bool shares_texture(std::int32_t face, std::int32_t other) const;
  [[nodiscard]] double difference(std::int32_t face, const Eigen::Vector3d& barycentric,
                                  const SurfacePoint& other) const;
  [[nodiscard]] double seen(std::int32_t face, std::int64_t sample) const;
  [[nodiscard]] Eigen::RowVector2d texture_at(std::int32_t face,
                                              const Eigen::Vector3d& barycentric) const;
  [[nodiscard]] double area_of_face(std::int32_t face) const;

  const MeshView& mesh_;
  double scale_;
  const std::vector<std::int32_t>& looks_;
  std::unique_ptr<TriangleBvh> bvh_;
  std::vector<Piece> pieces_;
  Indices of_vertex_;
};

}  // namespace manip3d
