#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <queue>
#include <utility>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "simplify/fast_mesh.hpp"
#include "simplify/pieces.hpp"

namespace manip3d::fast_detail {

/// Pieces of the mesh (faces connected by vertices), if there are several. Each can be removed as a
/// whole.
class FastPieces {
 public:
  FastPieces(FastMesh& mesh, const std::vector<std::int32_t>& looks) : mesh_(mesh), looks_(looks) {}

  /// Finds the pieces; needs the weights that sum_quadrics() computes.
  void find();

  /// Pieces that remove() may remove.
  enum class Choice : std::uint8_t {
    kCheap,  // pieces below the limit, as long as the target is not undercut
    // Pieces below the limit, priced for at most the number of faces that the target still needs,
    // even if fewer faces than the target remain.
    kInstead,
    kNear,      // the cheapest near pieces, as long as the target is not undercut
    kCheapest,  // the cheapest pieces of any price, as long as the target is not undercut
    kAny,       // one piece, even if fewer faces than the target remain
  };

  /// Removes the cheapest pieces; returns the number of removed faces.
  /// @param limit  Price up to which pieces are cheap, in the unit of the collapses' prices.
  std::int64_t remove(double limit, Choice choice, std::int64_t target, double max_error);

  /// The price of the cheapest piece if `needed` faces are to be removed; infinity if there is
  /// none.
  [[nodiscard]] double cheapest_price(std::int64_t needed, double max_error) const;

  /// Whether no edge of the face's piece can collapse, because the piece is a triangle or a
  /// tetrahedron. Short edges are cheap, so thousands of such pieces would take up all candidates
  /// of a pass.
  [[nodiscard]] bool is_spent(const Triple& face) const;
  /// Upper bound of the number of faces in pieces that can only be removed as a whole.
  [[nodiscard]] std::int64_t num_spent() const { return num_spent_; }

  [[nodiscard]] std::int64_t num_removed() const { return num_removed_; }
  /// Number of times that a piece stayed because its distance was above max_error.
  [[nodiscard]] std::int64_t num_too_far() const { return num_too_far_; }
  /// The largest mean distance of a removed piece, in input units.
  [[nodiscard]] double error() const { return error_; }

 private:
  [[nodiscard]] bool is_connected() const;
  void add_looks();
  void count_faces();
  [[nodiscard]] std::int32_t piece_of(const Triple& face) const {
    return pieces_->of_vertex(mesh_.id[face[0]]);
  }
  [[nodiscard]] double price_of(std::int32_t i, std::int64_t most_faces) const;
  /// Prices and pieces; the cheapest is at the top.
  using Queue = std::priority_queue<std::pair<double, std::int32_t>,
                                    std::vector<std::pair<double, std::int32_t>>, std::greater<>>;
  [[nodiscard]] Queue price_pieces(double limit, bool is_forced, std::int64_t most_faces) const;

  FastMesh& mesh_;
  const std::vector<std::int32_t>& looks_;
  TriangleMesh welded_;
  std::optional<MeshView> view_;
  std::optional<Pieces> pieces_;
  std::vector<std::int64_t> faces_of_piece_;
  std::vector<double> piece_weight_;   // sum over all planes of a piece of the input
  std::vector<std::uint8_t> is_kept_;  // pieces with locked vertices
  std::int64_t num_spent_ = 0, num_removed_ = 0, num_too_far_ = 0;
  double error_ = 0.0;
};

}  // namespace manip3d::fast_detail
