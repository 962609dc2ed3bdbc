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

/// Pieces of the mesh (faces joined by vertices), if there are several: each may vanish as a whole.
class FastPieces {
 public:
  explicit FastPieces(FastMesh& mesh) : mesh_(mesh) {}

  /// After sum_quadrics(), whose weights the prices of the pieces have.
  void find();

  /// Which pieces remove() takes.
  enum class Choice : std::uint8_t {
    kCheap,     // those below the limit that do not go beyond the target
    kInstead,   // those below the limit, which stand in for so many faces as the target asks for
    kNear,      // the cheapest that are not missed at once and do not go beyond the target
    kCheapest,  // the cheapest, whatever they cost, that do not go beyond the target
    kAny,       // one, even if less is left than the target asks for
  };

  /// Takes away the pieces that cost least; how many faces that were.
  /// @param limit  price up to which pieces are cheap, in the unit of the collapses' prices.
  std::int64_t remove(double limit, Choice choice, std::int64_t target, double max_error);

  /// The price of the cheapest piece that may go instead of so many faces; infinity: there is none.
  [[nodiscard]] double cheapest_price(std::int64_t needed, double max_error) const;

  /// Whether no edge of the piece of a face can collapse: it is a triangle or a tetrahedron. Their
  /// edges are as cheap as they are short, and thousands of them would be all candidates of a pass.
  [[nodiscard]] bool is_spent(const Triple& face) const;
  /// Faces of pieces that only go as a whole, at most.
  [[nodiscard]] std::int64_t num_spent() const { return num_spent_; }

  [[nodiscard]] std::int64_t num_removed() const { return num_removed_; }
  /// How often a piece stayed because its distance is above max_error.
  [[nodiscard]] std::int64_t num_too_far() const { return num_too_far_; }
  /// The largest mean distance of a piece that vanished, in input units.
  [[nodiscard]] double error() const { return error_; }

 private:
  [[nodiscard]] bool is_connected() const;
  void count_faces();
  [[nodiscard]] std::int32_t piece_of(const Triple& face) const {
    return pieces_->of_vertex(mesh_.id[face[0]]);
  }
  [[nodiscard]] double price_of(std::int32_t i, std::int64_t most_faces) const;
  /// Prices and pieces, the cheapest at the top.
  using Queue = std::priority_queue<std::pair<double, std::int32_t>,
                                    std::vector<std::pair<double, std::int32_t>>, std::greater<>>;
  [[nodiscard]] Queue price_pieces(double limit, bool is_forced, std::int64_t most_faces) const;

  FastMesh& mesh_;
  TriangleMesh welded_;
  std::optional<MeshView> view_;
  std::optional<Pieces> pieces_;
  std::vector<std::int64_t> faces_of_piece_;
  std::vector<double> piece_weight_;   // of all planes of a piece, as read
  std::vector<std::uint8_t> is_kept_;  // pieces with locked vertices
  std::int64_t num_spent_ = 0, num_removed_ = 0, num_too_far_ = 0;
  double error_ = 0.0;
};

}  // namespace manip3d::fast_detail
