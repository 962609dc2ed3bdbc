#include "manip3d/simplify/fast.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <utility>

#include "manip3d/error.hpp"
#include "simplify/check_option.hpp"
#include "simplify/fast_collapse.hpp"
#include "simplify/fast_mesh.hpp"
#include "simplify/fast_pass.hpp"
#include "simplify/fast_pieces.hpp"
#include "simplify/fast_prices.hpp"
#include "simplify/fast_quadrics.hpp"
#include "simplify/rounding_weld.hpp"
#include "simplify/turned_normals.hpp"
#include "simplify/usual_unit.hpp"

namespace manip3d {
namespace {

using namespace fast_detail;

/// Smallest visible error, as a mean distance divided by the size of the mesh. Below it, the link
/// condition is not waived.
constexpr double kVisibleDistance = 1e-3;

/// Runs passes until the target is reached or nothing more can be done. If the rules keep the
/// target out of reach, they are waived one after the other.
class FastSimplifier {
 public:
  /// @param is_welded  Whether RoundingWeld changed the mesh.
  FastSimplifier(const MeshView& input, const BoundingBox& box, const FastOptions& options,
                 bool is_welded, const Progress& progress)
      : options_(options),
        tasks_(options.num_threads, progress),
        mesh_(input, box, options.locked, tasks_),
        pieces_(mesh_, options.looks),
        collapser_(mesh_, squared_limit()),
        passes_(mesh_, pieces_, collapser_) {
    has_short_edges_ = sum_quadrics(
        mesh_, {options.boundary_weight, options.seam_weight, options.color_weight, is_welded});
    tasks_.report(0.16);
    pieces_.find();
  }

  /// Whether some edge may be short enough for RoundingWeld.
  [[nodiscard]] bool has_short_edges() const { return has_short_edges_; }

  QualityResult run() {
    const auto start = static_cast<double>(mesh_.num_faces());
    const auto target = static_cast<double>(options_.target_faces);
    bool is_fresh = true;
    while (mesh_.num_faces() > options_.target_faces) {
      const double gone = start - static_cast<double>(mesh_.num_faces());
      tasks_.report(0.2 + 0.7 * gone / std::max(1.0, start - target));
      if (!std::exchange(is_fresh, false)) {
        mesh_.build_adjacency();
        if (!mesh_.is_complex.empty() || collapser_.rules != Rules::kAll) {
          mesh_.find_complex_edges();
        }
      }
      if (!pass()) break;
    }
    tasks_.report(0.9);
    return finish();
  }

 private:
  [[nodiscard]] float squared_limit() const {
    // The share of a few roundings in single precision keeps the recorded error within the limit.
    constexpr double kBelow = 1.0 - 1e-6;
    const double limit = options_.max_error / mesh_.scale;
    return limit < 1e18 ? static_cast<float>(kBelow * limit * limit)
                        : std::numeric_limits<float>::infinity();
  }

  /// Makes the cheapest collapses; returns false if nothing more can be done.
  bool pass() {
    const std::int64_t needed = mesh_.num_faces() - options_.target_faces;
    const bool may_take_pieces = options_.target_faces > 0 && passes_.is_small();
    const double piece = may_take_pieces ? pieces_.cheapest_price(needed, options_.max_error)
                                         : std::numeric_limits<double>::infinity();
    const PassReport report = passes_.run(needed, patience_, visible_price(), piece);
    if (collapser_.rules != Rules::kAll) result_.relaxed_collapses += report.collapses;
    if (report.meets_piece) {
      remove_pieces(report.piece_limit, FastPieces::Choice::kInstead);
      return true;  // the price of a piece that stays has changed
    }
    // A piece is cheap if it costs no more than a collapse that was made. The candidates that were
    // refused may be far dearer.
    const float cheap = report.is_everything ? 0.0F : std::min(report.price_limit, report.dearest);
    const std::int64_t vanished = remove_pieces(cheap, FastPieces::Choice::kCheap);
    if (report.meets_forbidden) {
      collapser_.rules = Rules::kAnyEdges;
      return true;
    }
    if (report.collapses > 0 && report.leaves_expensive) return true;
    if (vanished > 0 || report.progress() >= 0.25) {
      if (report.progress() >= 0.75) patience_ = std::max(1.0, 0.5 * patience_);
      return true;
    }
    // Too few candidates were legal: the next pass gets more; if all were candidates, rules are
    // waived.
    if (!report.is_everything) {
      patience_ *= 4.0;
      return true;
    }
    // With fewer, another pass is not worthwhile.
    if (report.collapses > needed / 1000) return true;
    num_too_expensive_ += report.num_too_expensive;
    return takes_pieces_or_other_rules(report.collapses > 0) || report.collapses > 0;
  }

  /// Called when collapses run out: removes pieces near the rest, then waives a rule, then removes
  /// any piece. Returns whether one of these was possible.
  bool takes_pieces_or_other_rules(bool has_collapsed) {
    using Choice = FastPieces::Choice;
    if (options_.target_faces == 0 || num_above_limit() > 0) return false;
    Rules& rules = collapser_.rules;
    const Choice choice = rules == Rules::kFlips ? Choice::kCheapest : Choice::kNear;
    if (remove_pieces(0.0, choice) > 0) return true;
    if (rules != Rules::kFlips) {
      rules = rules == Rules::kAll ? Rules::kAnyEdges : Rules::kFlips;
      return true;
    }
    return !has_collapsed && remove_pieces(0.0, Choice::kAny) > 0;
  }

  std::int64_t remove_pieces(double limit, FastPieces::Choice choice) {
    return pieces_.remove(limit, choice, options_.target_faces, options_.max_error);
  }

  /// Number of steps that were impossible only because of max_error.
  [[nodiscard]] std::int64_t num_above_limit() const {
    return num_too_expensive_ + pieces_.num_too_far();
  }

  /// The price of a visible error; kNoPrice if the link condition must not be waived.
  [[nodiscard]] std::uint32_t visible_price() {
    if (collapser_.rules != Rules::kAll || options_.target_faces == 0) return kNoPrice;
    if (collapser_.squared_limit() < std::numeric_limits<float>::infinity()) return kNoPrice;
    if (!(whole_weight_ > 0.0)) {  // collapses add up weights, so they are computed once
      for (const QuadricVertex& v : mesh_.vertices) whole_weight_ += v.weight;
    }
    const double price = kVisibleDistance * kVisibleDistance * whole_weight_ /
                         static_cast<double>(mesh_.num_faces());
    return key_of(static_cast<float>(price));
  }

  QualityResult finish() {
    result_.dropped_faces += mesh_.num_dropped;
    result_.removed_pieces += pieces_.num_removed();
    result_.max_error = std::max(pieces_.error(), mesh_.scale * std::sqrt(passes_.squared_error()));
    result_.rejected = passes_.rejected();
    std::int64_t& above_limit = result_.rejected[static_cast<std::size_t>(Rejection::kErrorLimit)];
    above_limit += num_above_limit();
    if (mesh_.num_faces() <= options_.target_faces) {
      result_.stop = CollapseStop::kTargetReached;
    } else if (above_limit > 0) {
      result_.stop = CollapseStop::kErrorLimit;
    } else {
      result_.stop = CollapseStop::kNoLegalCollapse;
    }
    mesh_.write(result_);
    mend_turned_normals(mesh_.input, result_.face_map, result_.mesh);
    return std::move(result_);
  }

  const FastOptions& options_;
  Tasks tasks_;
  FastMesh mesh_;
  FastPieces pieces_;
  EdgeCollapser collapser_;
  FastPass passes_;
  bool has_short_edges_ = false;
  double patience_ = 1.0;      // factor on the usual number of candidates
  double whole_weight_ = 0.0;  // sum over the quadrics of all vertices
  std::int64_t num_too_expensive_ = 0;
  QualityResult result_;
};

void check_options(const MeshView& mesh, const FastOptions& options) {
  check_not_negative("target_faces", static_cast<double>(options.target_faces));
  check_not_negative("max_error", options.max_error, MayBeInfinite::kYes);
  check_not_negative("boundary_weight", options.boundary_weight);
  check_not_negative("seam_weight", options.seam_weight);
  check_not_negative("color_weight", options.color_weight);
  if (options.num_threads < 0) {
    throw InputError("num_threads: expected a number >= 0, got " +
                     std::to_string(options.num_threads));
  }
  const auto num_locked = static_cast<std::int64_t>(options.locked.size());
  if (num_locked != 0 && num_locked != mesh.num_vertices()) {
    throw InputError("locked: expected one for each vertex (" +
                     std::to_string(mesh.num_vertices()) + "), got " + std::to_string(num_locked));
  }
}

}  // namespace

QualityResult simplify_fast(const MeshView& mesh, const FastOptions& options,
                            const Progress& progress) {
  check_mesh(mesh);
  check_options(mesh, options);
  const UsualUnit usual(mesh);
  FastOptions in_unit = options;
  in_unit.max_error = usual.from_file(options.max_error);
  std::optional<FastSimplifier> simplifier;
  simplifier.emplace(usual.mesh(), usual.box(), in_unit, false, progress);
  const Progress rest = part_of(progress, 0.16, 1.0);
  // Only few meshes have vertices to weld, and looking for them takes time, so the edges are
  // measured while the mesh is loaded.
  std::optional<RoundingWeld> weld;
  if (mesh.num_faces() > options.target_faces && simplifier->has_short_edges()) {
    weld.emplace(usual.mesh(), options.locked);
    if (weld->any()) simplifier.emplace(weld->mesh(), usual.box(), in_unit, true, rest);
  }
  QualityResult result = simplifier->run();
  if (weld) weld->complete(result.vertex_map);
  usual.to_file(result.mesh.vertices);
  result.max_error = usual.to_file(result.max_error);
  return result;
}

}  // namespace manip3d
