#include "simplify/fast_pass.hpp"

#include <algorithm>
#include <bit>
#include <cstdint>
#include <limits>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

namespace manip3d::fast_detail {
namespace {

/// Largest share of the vertices that one pass removes. A larger share is faster, but follows the
/// order of prices less.
constexpr double kShareOfPass = 0.5;

/// Below kSmall faces, passes take hardly any time, and the order of prices matters more: a pass
/// removes a smaller share, from fewer candidates.
constexpr double kShareOfSmallPass = 0.1;
constexpr double kSmallCandidates = 1.0;
constexpr std::int64_t kSmall = 5000;
static_assert(kSmall <= kBlock);

/// A collapse may have to wait for the next pass, because a neighbour was collapsed in this one. A
/// small pass makes no collapse that costs this many times as much as a waiting one.
constexpr float kOvertakes = 8.0F;

/// If the best position of a collapse is refused, a large pass takes an end of the edge instead,
/// for at most this many times the price of the most expensive candidate.
constexpr float kLeap = 100.0F;

/// Candidates for each collapse that a pass wants: neighbours exclude each other.
constexpr double kCandidates = 3.0;

/// The link condition is waived if a legal collapse moves the surface three times as far (squared,
/// like all prices) as one that the condition refused: keeping holes and handles would cost the
/// shape around them. A small pass removes a whole piece before a collapse that moves the surface
/// three times as far.
constexpr float kFarCheaperSquared = 9.0F;

/// A hub (a vertex with very many faces) is skipped in a pass once its number of corners times its
/// number of refused collapses exceeds this.
constexpr std::int64_t kHubPatience = 1 << 14;

}  // namespace

std::array<std::int64_t, kNumRejections> FastPass::rejected() const {
  std::array<std::int64_t, kNumRejections> sum{};
  for (const std::vector<Worker>& level : workers_) {
    for (const Worker& worker : level) {
      for (std::size_t i = 0; i < sum.size(); ++i) sum[i] += worker.rejected[i];
    }
  }
  return sum;
}

double FastPass::squared_error() const {
  float most = 0.0F;
  for (const std::vector<Worker>& level : workers_) {
    for (const Worker& worker : level) most = std::max(most, worker.task.squared_error);
  }
  return most;
}

bool FastPass::is_small() const {
  return mesh_.num_faces() < kBlock && mesh_.num_faces() - pieces_.num_spent() < kSmall;
}

PassReport FastPass::run(std::int64_t needed, double patience, std::uint32_t visible,
                         double piece) {
  PassReport report;
  is_in_order_ = is_small();
  visible_ = visible;
  piece_ = key_of(kFarCheaperSquared * static_cast<float>(piece));
  prepare_workers();
  mesh_.over_blocks([&](std::int64_t block, std::int64_t begin, std::int64_t end) {
    price_edges(mesh_, pieces_, collapser_.squared_limit(), begin, end,
                workers_[0][block].candidates);
  });
  find_limit(needed, patience, report);
  mesh_.begin_pass();
  refusals_.assign(mesh_.vertices.size(), 0);
  if (is_in_order_) is_beside_.assign(mesh_.vertices.size(), 0);
  gather_candidates();
  // If flips are allowed, faces may also vanish as duplicates; a pass then removes at most half of
  // the needed faces.
  const std::int64_t quota =
      collapser_.rules == Rules::kFlips ? (needed + 1) / 2 : std::min(needed, 2 * report.wanted);
  report.collapses = collapse_candidates(quota);
  report.leaves_expensive =
      workers_.front().front().leaves_expensive;  // a small pass has one block
  for_each_worker([&](const Worker& worker) {
    report.removed += worker.task.removed;
    report.dearest = std::max(report.dearest, std::bit_cast<float>(worker.dearest));
    report.meets_forbidden |= worker.meets_forbidden;
    if (worker.beyond_piece == 0) return;
    report.meets_piece = true;
    const float far_cheaper = std::bit_cast<float>(worker.beyond_piece) / kFarCheaperSquared;
    report.piece_limit = std::max(piece, static_cast<double>(far_cheaper));
  });
  if (report.collapses > 0) end();
  return report;
}

/// Prepares a worker without candidates for each block of each level.
void FastPass::prepare_workers() {
  const int top = mesh_.top_level();
  if (workers_.size() <= static_cast<std::size_t>(top)) workers_.resize(top + 1);
  for (int level = 0; level < static_cast<int>(workers_.size()); ++level) {
    while (workers_[level].size() < static_cast<std::size_t>(mesh_.num_blocks(level))) {
      workers_[level].emplace_back(mesh_.arena);
    }
    for (Worker& worker : workers_[level]) {
      worker.task.level = level;
      worker.candidates.clear();
      worker.waiting.clear();
      worker.task.removed = worker.task.collapses = 0;
      worker.leaves_expensive = false;
      worker.forbids = kNoPrice;
      worker.meets_forbidden = false;
      worker.beyond_piece = 0;
      worker.dearest = 0;
      worker.task.most_at_end = kMaxPrice;
    }
  }
}

/// Finds the price up to which edges are candidates of this pass, from a histogram of all prices.
void FastPass::find_limit(std::int64_t needed, double patience, PassReport& report) {
  constexpr int kShift = 18;  // five bits of the mantissa
  constexpr std::size_t kBins = std::size_t{1} << (32 - kShift);
  // Each slice has its own histogram, which costs as much as 16 thousand edges.
  const std::int64_t num_slices = std::clamp<std::int64_t>(mesh_.num_blocks() / 4, 1, 8);
  const std::int64_t slice =
      std::max<std::int64_t>(1, (mesh_.num_blocks() + num_slices - 1) / num_slices);
  histogram_.assign(num_slices * kBins, 0);
  mesh_.tasks.over(mesh_.num_blocks(), slice, [&](std::int64_t begin, std::int64_t end) {
    std::uint32_t* bins = histogram_.data() + begin / slice * static_cast<std::int64_t>(kBins);
    for (std::int64_t block = begin; block < end; ++block) {
      for (const PricedEdge& edge : workers_[0][block].candidates) ++bins[edge.key >> kShift];
    }
  });
  for (std::size_t i = kBins; i < histogram_.size(); ++i) {
    histogram_[i % kBins] += histogram_[i];
  }
  if (collapser_.squared_limit() < std::numeric_limits<float>::infinity()) {
    for (const Worker& worker : workers_[0]) {
      report.num_too_expensive +=
          std::count_if(worker.candidates.begin(), worker.candidates.end(),
                        [](const PricedEdge& edge) { return edge.key == kTooExpensive; });
    }
  }
  const double share = (is_in_order_ ? kShareOfSmallPass : kShareOfPass) *
                       static_cast<double>(mesh_.num_faces() - pieces_.num_spent()) / 2.0;
  report.wanted = std::max<std::int64_t>(
      1, static_cast<std::int64_t>(std::min(0.5 * static_cast<double>(needed), share)));
  const double most = patience * (is_in_order_ ? kSmallCandidates : kCandidates) *
                      static_cast<double>(report.wanted);
  double sum = 0.0;
  report.is_everything = true;
  limit_ = kMaxPrice;
  for (std::size_t bin = 0; bin <= (kMaxPrice >> kShift); ++bin) {
    sum += histogram_[bin];
    if (sum < most || bin == (kMaxPrice >> kShift)) continue;
    report.is_everything = false;
    limit_ = static_cast<std::uint32_t>(((bin + 1) << kShift) - 1);
    break;
  }
  report.price_limit = std::bit_cast<float>(limit_);
}

/// Sorts the edges below the limit in each block of faces into those inside the block and those
/// that wait.
void FastPass::gather_candidates() {
  const bool is_one = mesh_.num_blocks() == 1;
  mesh_.over_blocks([&](std::int64_t block, std::int64_t, std::int64_t) {
    Worker& worker = workers_[0][block];
    Bulk<PricedEdge>& candidates = worker.candidates;
    std::size_t count = 0;
    for (const PricedEdge edge : candidates) {
      candidates[count] = edge;
      count += static_cast<std::size_t>(edge.key <= limit_);
    }
    candidates.resize(count);
    if (!is_one) {
      std::erase_if(candidates, [&](const PricedEdge& edge) {
        const bool waits = level_of(edge) > 0;
        if (waits) worker.waiting.push_back(edge);
        return waits;
      });
    }
    sort_by_price(candidates, worker.sorted);
  });
}

/// Gathers the edges for a block of a higher level from those that wait in its blocks of the level
/// below.
void FastPass::gather_waiting(int level) {
  const auto below = static_cast<std::int64_t>(workers_[level - 1].size());
  mesh_.tasks.over(mesh_.num_blocks(level), 1, [&](std::int64_t block, std::int64_t) {
    Worker& worker = workers_[level][block];
    const std::int64_t begin = block << kLevelBits, end = (block + 1) << kLevelBits;
    for (std::int64_t b = begin; b < std::min(end, below); ++b) {
      for (const PricedEdge& edge : workers_[level - 1][b].waiting) put(edge, worker);
    }
    sort_by_price(worker.candidates, worker.sorted);
  });
}

int FastPass::level_of(const PricedEdge& edge) const {
  const auto [v, t] = mesh_.edge_at(edge.slot);
  return std::max(mesh_.level[v], mesh_.level[t]);
}

void FastPass::put(const PricedEdge& edge, Worker& worker) const {
  (level_of(edge) <= worker.task.level ? worker.candidates : worker.waiting).push_back(edge);
}

/// Processes level after level; returns the number of collapses. Blocks of a level are independent,
/// because an edge inside a block touches only faces and vertices of that block.
std::int64_t FastPass::collapse_candidates(std::int64_t quota) {
  std::int64_t removed = 0, collapses = 0;
  const int top = mesh_.top_level();
  for (int level = 0; level <= top; ++level) {
    if (level > 0) gather_waiting(level);
    share_out(quota - removed, level, level == top);
    mesh_.tasks.over(mesh_.num_blocks(level), 1, [&](std::int64_t block, std::int64_t) {
      Worker& worker = workers_[level][block];
      if (worker.quota > 0) {
        collapse_in_order(worker.candidates, worker, worker.quota, level == top);
      }
    });
    for (const Worker& worker : workers_[level]) {
      removed += worker.task.removed;
      collapses += worker.task.collapses;
    }
  }
  return collapses;
}

/// Sets the number of faces that each block of a level may remove: its share by the number of its
/// candidates. With more, nothing would be left for the edges between blocks.
void FastPass::share_out(std::int64_t needed, int level, bool is_top) {
  std::int64_t all = 0;
  for (const Worker& worker : workers_[level]) {
    all += static_cast<std::int64_t>(worker.candidates.size() + worker.waiting.size());
  }
  const bool few = needed < 64 * mesh_.num_blocks(level);
  for (Worker& worker : workers_[level]) {
    if (is_top) {
      worker.quota = needed;
    } else if (few || all == 0) {
      worker.quota = 0;
      worker.waiting.insert(worker.waiting.end(), worker.candidates.begin(),
                            worker.candidates.end());
    } else {
      worker.quota = static_cast<std::int64_t>(static_cast<double>(needed) *
                                               static_cast<double>(worker.candidates.size()) /
                                               static_cast<double>(all));
    }
  }
}

/// The candidates of a block in order of their prices, and among them those that were postponed.
class FastPass::CheapestFirst {
 public:
  struct Next {
    EdgeInReach edge;
    bool was_postponed;
  };

  CheapestFirst(const FastPass& pass, const Bulk<PricedEdge>& candidates, Worker& worker)
      : mesh_(pass.mesh_),
        takes_any_(pass.is_in_order_),
        candidates_(candidates),
        near_(worker.in_reach),
        postponed_(worker.at_ends) {
    near_.clear();
    postponed_.clear();
  }

  /// @return  Nothing if there are no more candidates. In a large pass, most of those with an end
  ///          that has collapsed are skipped.
  std::optional<Next> next() {
    while (at_ == near_.size() && num_found_ < candidates_.size()) find_in_reach();
    const bool has_near = at_ < near_.size();
    if (!postponed_.empty() && (!has_near || postponed_.front().key < near_[at_].key)) {
      std::pop_heap(postponed_.begin(), postponed_.end(), IsDearer());
      const EdgeInReach edge = postponed_.back();
      postponed_.pop_back();
      return Next{edge, true};
    }
    if (!has_near) return std::nullopt;
    prefetch();
    return Next{near_[at_++], false};
  }

  /// Gives the edge once more, when no other one is cheaper than this price.
  void postpone(const EdgeInReach& edge, std::uint32_t price) {
    postponed_.push_back({price, edge.v, edge.t});
    std::push_heap(postponed_.begin(), postponed_.end(), IsDearer());
  }

 private:
  struct IsDearer {
    bool operator()(const EdgeInReach& a, const EdgeInReach& b) const {
      return std::tie(a.key, a.v, a.t) > std::tie(b.key, b.v, b.t);
    }
  };

  /// Replaces `near_` by the next candidates. Avoids a branch for each.
  void find_in_reach() {
    constexpr std::size_t kAtOnce = 64;
    near_.resize(2 * kAtOnce);
    std::size_t count = 0, end = num_found_;
    while (count < kAtOnce && end < candidates_.size()) {
      const std::size_t next = std::min(candidates_.size(), end + kAtOnce);
      for (std::size_t i = next; i < std::min(candidates_.size(), next + kAtOnce); ++i) {
        __builtin_prefetch(&mesh_.faces[candidates_[i].slot / 3]);
      }
      for (; end < next; ++end) {
        const auto [v, t] = mesh_.edge_at(candidates_[end].slot);
        near_[count] = {candidates_[end].key, v, t};
        count +=
            static_cast<std::size_t>(takes_any_ | ((mesh_.is_taken[v] | mesh_.is_taken[t]) == 0));
      }
    }
    near_.resize(count);
    num_found_ = end;
    at_ = 0;
  }

  /// Prefetches the data of the candidates after the next one, which are anywhere in the block.
  void prefetch() const {
    constexpr std::size_t kSoon = 4, kLater = 8;
    if (at_ + kLater < near_.size()) {
      for (const std::int32_t v : {near_[at_ + kLater].v, near_[at_ + kLater].t}) {
        __builtin_prefetch(&mesh_.vertices[v]);
        __builtin_prefetch(&mesh_.corners_by_vertex[mesh_.first_corner[v]]);
      }
    }
    if (at_ + kSoon < near_.size()) {
      for (const std::int32_t v : {near_[at_ + kSoon].v, near_[at_ + kSoon].t}) {
        const auto around = mesh_.corners(v);
        for (const std::uint32_t corner : around.first(std::min<std::size_t>(around.size(), 8))) {
          __builtin_prefetch(&mesh_.faces[corner / 3]);
        }
      }
    }
  }

  const FastMesh& mesh_;
  const bool takes_any_;  ///< Also gives edges with an end that has collapsed.
  const Bulk<PricedEdge>& candidates_;
  std::size_t num_found_ = 0;            ///< Candidates that are or were in `near_`.
  std::vector<EdgeInReach>& near_;       ///< The next candidates.
  std::size_t at_ = 0;                   ///< The next one in `near_`.
  std::vector<EdgeInReach>& postponed_;  ///< A heap with the cheapest one on top.
};

/// Collapses candidates from the cheapest one on, until the quota is reached or the rest has to
/// wait.
void FastPass::collapse_in_order(const Bulk<PricedEdge>& candidates, Worker& worker,
                                 std::int64_t quota, bool may_exceed) {
  const float slack = is_in_order_ ? 1.0F : kLeap;
  worker.task.most = std::max(limit_, key_of(slack * std::bit_cast<float>(limit_)));
  CheapestFirst cheapest(*this, candidates, worker);
  while (worker.task.removed < quota) {
    const std::optional<CheapestFirst::Next> next = cheapest.next();
    if (!next) break;
    const auto [key, v, t] = next->edge;
    if (mesh_.is_taken[v] != 0 || mesh_.is_taken[t] != 0) {
      note_waiting(key, worker);
      continue;
    }
    if (is_hub(v) || is_hub(t)) continue;
    if (is_beyond(key, next->was_postponed, worker)) break;
    const std::int64_t left =
        may_exceed ? std::numeric_limits<std::int64_t>::max() : quota - worker.task.removed;
    worker.task.most_at_end = key;
    worker.task.end_price = kNoPrice;
    const auto reason = collapser_.collapse(v, t, worker.task, left);
    if (!reason) {
      if (mesh_.is_taken[v] != 0) note_collapse(key, worker);
    } else if (worker.task.end_price != kNoPrice) {
      cheapest.postpone(next->edge, worker.task.end_price);
    } else {
      note_refusal(next->edge, *reason, worker);
    }
  }
}

/// Whether a candidate of this price, and with it all later ones, is left to other passes; notes
/// the reason.
bool FastPass::is_beyond(std::uint32_t key, bool was_postponed, Worker& worker) const {
  if (is_in_order_ && key > worker.task.most && worker.task.collapses > 0) {
    worker.leaves_expensive = true;
    return true;
  }
  if (is_in_order_ && key > piece_) {
    worker.beyond_piece = key;
    return true;
  }
  if (key > worker.forbids && (is_in_order_ || !was_postponed)) {
    worker.meets_forbidden = true;
    return true;
  }
  return false;
}

/// In a small pass, lets no collapse overtake a waiting candidate at many times its price. Prices
/// increase, so that the first waiting candidate decides.
void FastPass::note_waiting(std::uint32_t key, Worker& worker) const {
  if (!is_in_order_) return;
  const std::uint32_t most = key_of(kOvertakes * std::bit_cast<float>(key));
  worker.task.most = std::min(worker.task.most, most);
}

void FastPass::note_collapse(std::uint32_t key, Worker& worker) {
  worker.dearest = std::max(worker.dearest, key);
  if (!is_in_order_) return;
  for (const Fan* fan : {&worker.task.first, &worker.task.second}) {
    for (const auto& [a, b] : fan->rest) is_beside_[a] = is_beside_[b] = 1;
  }
}

/// Counts a rejected collapse. One that breaks the link condition forbids candidates that are far
/// more expensive. In a small pass, one beside faces that have changed may be legal in the next.
void FastPass::note_refusal(const EdgeInReach& candidate, Rejection reason, Worker& worker) {
  const auto [key, v, t] = candidate;
  ++worker.rejected[static_cast<std::size_t>(reason)];
  if (reason == Rejection::kLink) {
    const float price = kFarCheaperSquared * std::bit_cast<float>(key);
    worker.forbids = std::min(worker.forbids, std::max(visible_, key_of(price)));
  }
  if (refusals_[v] < 0xFFFFU) ++refusals_[v];
  if (refusals_[t] < 0xFFFFU) ++refusals_[t];
  if (is_in_order_ && (is_beside_[v] != 0 || is_beside_[t] != 0)) note_waiting(key, worker);
}

/// Whether the edges of a vertex are skipped because it has very many faces: after some refused
/// collapses, or at once if each of its faces may have a texture coordinate of its own.
bool FastPass::is_hub(std::int32_t v) const {
  const auto num_faces = static_cast<std::int64_t>(mesh_.corners(v).size());
  return num_faces * refusals_[v] > kHubPatience || (mesh_.has_wedges() && num_faces > kHub);
}

/// Applies the pass to the mesh.
void FastPass::end() {
  for (std::vector<Worker>& level : workers_) {
    mesh_.tasks.over(static_cast<std::int64_t>(level.size()), 1, [&](std::int64_t i, std::int64_t) {
      mix_colors(mesh_, level[i].task.mixes);
      level[i].task.mixes.clear();
    });
  }
  mesh_.end_pass();
  std::vector<std::int32_t> around;
  std::vector<Triple> twins;
  for_each_worker([&](Worker& worker) {
    const CollapseTask& task = worker.task;
    around.insert(around.end(), task.doubling.begin(), task.doubling.end());
    twins.insert(twins.end(), task.twin_faces.begin(), task.twin_faces.end());
    worker.task.doubling.clear();
    worker.task.twin_faces.clear();
  });
  if (!around.empty()) mesh_.remove_double_faces(around, std::move(twins));
}

}  // namespace manip3d::fast_detail
