#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "geometry/bulk.hpp"
#include "simplify/fast_collapse.hpp"
#include "simplify/fast_mesh.hpp"
#include "simplify/fast_pieces.hpp"
#include "simplify/fast_prices.hpp"

namespace manip3d::fast_detail {

/// The collapses of a pass, and the reasons why it stopped.
struct PassReport {
  std::int64_t collapses = 0;
  std::int64_t wanted = 1;             // number of collapses, of two faces, that the pass aims at
  std::int64_t removed = 0;            // number of faces
  std::int64_t num_too_expensive = 0;  // edges above max_error
  float price_limit = 0.0F;            // of the candidates
  float dearest = 0.0F;                // price of the most expensive collapse
  bool is_everything = false;          // all edges were candidates
  bool leaves_expensive = false;       // left expensive candidates to the next pass
  // Left collapses that cost far more than some that the link condition refused.
  bool meets_forbidden = false;
  bool meets_piece = false;  // left collapses that cost far more than a whole piece:
  double piece_limit = 0.0;  // pieces up to this price are removed instead

  /// Removed faces as a share of what the pass aims at. Where front and back of a sheet share their
  /// edges, a collapse removes four faces, and half of the wanted collapses would be all there are.
  [[nodiscard]] double progress() const {
    return 0.5 * static_cast<double>(removed) / static_cast<double>(wanted);
  }
};

/// Prices all edges and collapses them from the cheapest one on, each vertex at most once.
class FastPass {
 public:
  FastPass(FastMesh& mesh, const FastPieces& pieces, EdgeCollapser& collapser)
      : mesh_(mesh), pieces_(pieces), collapser_(collapser) {}

  /// @param needed    Number of faces to remove.
  /// @param patience  Factor on the usual number of candidates.
  /// @param visible   Price of a visible error; below it, the link condition is not waived.
  /// @param piece     Price of the cheapest piece; a small pass makes no collapse that is far more
  ///                  expensive.
  PassReport run(std::int64_t needed, double patience, std::uint32_t visible, double piece);

  /// Whether so few faces are left that a pass follows the order of prices.
  [[nodiscard]] bool is_small() const;

  /// Numbers of refused collapses in all passes, by reason.
  [[nodiscard]] std::array<std::int64_t, kNumRejections> rejected() const;
  /// The largest mean squared distance of a new vertex to its planes, in the mesh's own unit.
  [[nodiscard]] double squared_error() const;

 private:
  /// An edge with its price and its ends.
  struct EdgeInReach {
    std::uint32_t key;
    std::int32_t v, t;
  };
  /// The state of a block of a level.
  struct Worker {
    explicit Worker(Arena& arena) : candidates(arena), sorted(arena), waiting(arena) {}

    CollapseTask task;
    Bulk<PricedEdge> candidates;  // at first all edges of this block
    Bulk<PricedEdge> sorted;
    std::vector<EdgeInReach> in_reach;
    // Collapses whose best position was refused, at the price of an end of the edge.
    std::vector<EdgeInReach> at_ends;
    // Edges of this block that touch others; they wait for the next level.
    Bulk<PricedEdge> waiting;
    std::array<std::int64_t, kNumRejections> rejected{};
    std::int64_t quota = 0;
    bool leaves_expensive = false;
    bool meets_forbidden = false;
    std::uint32_t dearest = 0;  // price of the most expensive collapse
    // Price of a collapse that is replaced by the removal of a whole piece.
    std::uint32_t beyond_piece = 0;
    // From this price on, a collapse that the link condition refused is far cheaper.
    std::uint32_t forbids = kNoPrice;
  };

  class CheapestFirst;

  template <typename Body>
  void for_each_worker(const Body& body) {
    for (std::vector<Worker>& level : workers_) {
      for (Worker& worker : level) body(worker);
    }
  }
  void prepare_workers();
  void find_limit(std::int64_t needed, double patience, PassReport& report);
  void gather_candidates();
  void gather_waiting(int level);
  [[nodiscard]] int level_of(const PricedEdge& edge) const;
  void put(const PricedEdge& edge, Worker& worker) const;
  std::int64_t collapse_candidates(std::int64_t quota);
  void share_out(std::int64_t needed, int level, bool is_top);
  void collapse_in_order(const Bulk<PricedEdge>& candidates, Worker& worker, std::int64_t quota,
                         bool may_exceed);
  bool is_beyond(std::uint32_t key, bool was_postponed, Worker& worker) const;
  void note_waiting(std::uint32_t key, Worker& worker) const;
  void note_collapse(std::uint32_t key, Worker& worker);
  void note_refusal(const EdgeInReach& candidate, Rejection reason, Worker& worker);
  [[nodiscard]] bool is_hub(std::int32_t v) const;
  void end();

  FastMesh& mesh_;
  const FastPieces& pieces_;
  EdgeCollapser& collapser_;
  std::vector<std::vector<Worker>> workers_;  // by level and block
  std::vector<std::uint32_t> histogram_;
  std::vector<std::uint16_t> refusals_;  // by vertex
  std::vector<std::uint8_t> is_beside_;  // in a small pass, of a vertex: its faces changed
  bool is_in_order_ = false;             // is_small() at the beginning of the pass
  std::uint32_t limit_ = kMaxPrice;      // price of the candidates
  std::uint32_t visible_ = kNoPrice;
  std::uint32_t piece_ = kMaxPrice;  // from this price on, a whole piece is far cheaper
};

}  // namespace manip3d::fast_detail
