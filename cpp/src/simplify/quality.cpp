#include "manip3d/simplify/quality.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <limits>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>

#include "manip3d/error.hpp"
#include "simplify/check_option.hpp"
#include "simplify/collapse_mesh.hpp"
#include "simplify/flat_heap.hpp"
#include "simplify/pieces.hpp"
#include "simplify/quality_attributes.hpp"
#include "simplify/quality_distance.hpp"
#include "simplify/quality_price.hpp"
#include "simplify/quality_rules.hpp"
#include "simplify/rounding_weld.hpp"
#include "simplify/surface_fit.hpp"
#include "simplify/turned_normals.hpp"
#include "simplify/usual_unit.hpp"

namespace manip3d {
namespace {

using namespace quality_detail;

/// The link condition is waived for a collapse if the cheapest legal collapse costs this many times
/// as much. Of 1, 1.5, 2 and 3, tried on 150 models, 1 and 1.5 have the smallest error, and with
/// 1.5 fewer edges get a third face.
constexpr double kWorthWaiving = 1.5;

/// The link condition is waived only for a visible error: a mean distance above this share of the
/// size of the mesh. Below it, whole pieces are removed instead.
constexpr double kVisible = 1e-3;

/// Borders and texture at a vertex count as exact if their error, divided by the vertex's area, is
/// at most this (a distance; the diagonal is 1).
constexpr double kExactAttributes = 1e-9;

/// Weight of the planes of borders that a vertex must not leave, relative to its surface.
constexpr double kHeldFirmly = 1e6;

/// Faces of the smallest closed piece.
constexpr std::int64_t kTetrahedron = 4;

/// From this number of remaining faces of a piece on, the loss by a collapse is measured at points
/// of the original surface. Each of so few faces is far from most of the surface that it
/// represents, which planes do not show.
constexpr std::int64_t kLastFaces = 12;

/// Largest distance of a vertex outside the box of its original faces, relative to the diagonal of
/// the box. The tip of a cone with the volume of a spherical cap that reaches 50 degrees from its
/// axis is this far outside. Tips that are farther outside preserve a volume that is mostly gone,
/// and look like spikes.
constexpr double kReach = 0.1;

/// Largest rounding error of a position that was scaled and scaled back, relative to the size of
/// the mesh and its coordinates: some 1000 times that of the four operations.
constexpr double kRounding = 1e-12;

struct Entry {
  double price;           // per removed face
  std::int32_t a, b;      // an edge; b < 0: the piece a
  std::uint32_t version;  // of the edge: the sum of the versions of its ends
  friend bool operator<(const Entry& x, const Entry& y) {
    if (x.price != y.price) return x.price < y.price;
    return std::tie(x.a, x.b) < std::tie(y.a, y.b);
  }
};

class QualitySimplifier {
 public:
  QualitySimplifier(const MeshView& input, const QualityOptions& options, const Progress& progress)
      : input_(input),
        options_(options),
        progress_(progress),
        mesh_(input),
        pieces_(input, mesh_.scale(), options.looks, part_of(progress, 0.0, 0.1),
                options.target_faces < kLastFaces),
        kept_(options),
        distance_(input, mesh_, options.max_distance,
                  [this] {
                    if (progress_) progress_(fraction_);
                  }),
        original_(input, mesh_, options, progress),
        prices_(mesh_, original_, kept_, pieces_),
        check_(mesh_, kept_, !distance_.has_limit()),
        wedges_(mesh_, original_),
        attributes_(input, mesh_, original_, kept_),
        doubled_(mesh_),
        version_(mesh_.num_vertices(), 0),
        blocked_(mesh_.num_vertices(), false),
        is_hub_(mesh_.num_vertices(), false),
        into_(mesh_.num_vertices(), -1) {
    for (std::int32_t i = 0; i < pieces_.size(); ++i) {
      const auto is_locked = [&](std::int32_t v) { return kept_.is_locked(v); };
      if (std::ranges::any_of(pieces_.vertices(i), is_locked)) kept_pieces_.insert(i);
    }
  }

  QualityResult run() {
    const auto start = static_cast<double>(mesh_.num_faces());
    const auto target = static_cast<double>(options_.target_faces);
    if (mesh_.num_faces() > options_.target_faces) {
      for (std::int32_t i = 0; i < pieces_.size(); ++i) push_piece(i);
      push_all_edges();
    }
    for (std::int64_t step = 0; mesh_.num_faces() > options_.target_faces; ++step) {
      if (queue_.empty()) {
        if (!relax_rules()) break;
        push_all_edges();
        continue;
      }
      const Entry entry = queue_.top();
      if (is_forbidden_cheaper(entry.price, kWorthWaiving) && may_relax_rules()) {
        try_forbidden();
        continue;
      }
      queue_.pop();
      entry.b < 0 ? try_piece(entry) : try_edge(entry);
      // With a distance limit, one step can take as long as hundreds of others.
      if (progress_ && (distance_.has_limit() || step % 512 == 0)) {
        const double gone = start - static_cast<double>(mesh_.num_faces());
        fraction_ = 0.2 + 0.6 * gone / std::max(1.0, start - target);
        progress_(fraction_);
      }
    }
    return finish();
  }

 private:
  // --- The queue -----------------------------------------------------------------------------

  void push_edge(std::int32_t v, std::int32_t t, std::int32_t num_faces) {
    if (kept_.is_locked(v) && kept_.is_locked(t)) return;
    if (mesh_.is_hub(v) || mesh_.is_hub(t)) return;  // priced once it has fewer faces
    const Plan best = prices_.plan(v, t, num_faces, Place::kBest);
    queue_.push({best.price, v, t, version_[v] + version_[t]});
  }

  void push_edges(std::int32_t v) {
    is_hub_[v] = mesh_.is_hub(v);
    if (is_hub_[v]) return;
    prices_.begin_edges(v);
    for (const RingEdge& edge : check_.edges(v)) {
      push_edge(std::max(v, edge.vertex), std::min(v, edge.vertex), edge.num_faces);
    }
    prices_.end_edges();
  }

  void push_all_edges() {
    Ticker ticker(part_of(progress_, 0.1, 0.2));
    for (std::int32_t v = 0; v < mesh_.num_vertices(); ++v) {
      ticker.tick();
      if (mesh_.is_isolated(v)) continue;
      is_hub_[v] = mesh_.is_hub(v);
      if (is_hub_[v]) continue;
      prices_.begin_edges(v);
      for (const RingEdge& edge : check_.edges(v)) {
        if (edge.vertex < v) push_edge(v, edge.vertex, edge.num_faces);
      }
    }
    prices_.end_edges();
  }

  void push_piece(std::int32_t i) {
    if (distance_.has_limit() || kept_pieces_.contains(i)) return;
    if (!pieces_.is_there(i) || !std::isfinite(pieces_.cost(i))) return;
    queue_.push({piece_price(i), i, -1, 0});
  }

  [[nodiscard]] double piece_price(std::int32_t i) const {
    // Removing more faces than the target needs has no value.
    return prices_.piece(i, std::max<std::int64_t>(1, mesh_.num_faces() - options_.target_faces));
  }

  /// Whether another entry is now cheaper than one whose price has increased from `expected` to
  /// `price`.
  [[nodiscard]] bool is_overtaken(double price, double expected) const {
    return price > expected && !queue_.empty() && price > queue_.top().price;
  }

  /// Whether removing faces at this price causes a visible error.
  [[nodiscard]] bool is_visible(double price) const {
    return price * static_cast<double>(mesh_.num_faces()) >= kVisible * original_.whole_area;
  }

  /// Whether a legal collapse of this price costs more than `times` the price of one that the link
  /// condition forbids, and its error is visible. Otherwise, a mesh with many holes or thin tubes
  /// would keep them at the expense of its shape.
  [[nodiscard]] bool is_forbidden_cheaper(double price, double times) {
    if (check_.rules() != Rules::kAll) return false;
    if (!is_visible(price)) return false;
    while (!forbidden_.empty()) {
      const Entry& entry = forbidden_.top();
      if (version_[entry.a] + version_[entry.b] == entry.version && !mesh_.is_isolated(entry.a) &&
          !mesh_.is_isolated(entry.b)) {
        return price > times * entry.price;
      }
      forbidden_.pop();
    }
    return false;
  }

  [[nodiscard]] bool may_relax_rules() {
    const bool error_limit = count(Rejection::kErrorLimit) > 0;
    return options_.target_faces > 0 && !error_limit && !distance_.has_limit() &&
           check_.rules() != Rules::kFlips;
  }

  bool relax_rules() {
    if (!may_relax_rules()) return false;
    check_.relax();
    return true;
  }

  /// Tries the cheapest collapse that the link condition forbids. The condition holds again
  /// afterwards.
  void try_forbidden() {
    const Entry entry = forbidden_.top();
    forbidden_.pop();
    check_.set_rules(Rules::kAnyEdges);
    try_edge(entry);
    check_.set_rules(Rules::kAll);
  }

  /// The cheapest legal one of collapses to the ends and the middle of an edge.
  [[nodiscard]] std::optional<Plan> plan_elsewhere(std::int32_t v, std::int32_t t, int num_faces) {
    std::optional<Plan> best;
    for (const Place place : {Place::kFirst, Place::kSecond, Place::kMiddle}) {
      const Plan other = prices_.plan(v, t, num_faces, place);
      if (best && !(other.price < best->price)) continue;
      if (!check_.check_faces(other.position)) best = other;
    }
    return best;
  }

  void try_edge(const Entry& entry) {
    const std::int32_t v = entry.a, t = entry.b;
    if (version_[v] + version_[t] != entry.version) return;
    if (mesh_.is_isolated(v) || mesh_.is_isolated(t)) return;
    const RingEdge* edge = check_.look_at(v, t);
    if (edge == nullptr) return;
    if (faces_left(t) <= edge->num_faces) return refuse(v, t, Rejection::kDegenerate);
    if (check_.breaks_link()) {
      if (check_.rules() == Rules::kAll) forbidden_.push(entry);
      return refuse(v, t, Rejection::kLink);
    }
    if (check_.takes_last_face_of_locked()) return refuse(v, t, Rejection::kDegenerate);
    if (kept_.is_locked(v) || kept_.is_locked(t)) {
      wedges_.gather(v, t);
      if (attributes_.changes_locked(v, t, wedges_.map())) {
        return refuse(v, t, Rejection::kAttribute);
      }
    }
    Plan best = prices_.plan(v, t, edge->num_faces, Place::kBest);
    if (const std::optional<Rejection> refusal = check_.check_faces(best.position)) {
      const std::optional<Plan> other = plan_elsewhere(v, t, edge->num_faces);
      if (!other) return refuse(v, t, *refusal);
      best = *other;
    }
    const double weight = std::max(kept_.importance(v), kept_.importance(t)) / edge->num_faces;
    const double lost = weight * prices_.lost_strip(v, t, best.position);
    const bool leaves_nothing = lost > best.price;
    best.price = std::max(best.price, lost);
    if (pieces_.has_samples() && faces_left(t) <= kLastFaces) {
      best.price = std::max(best.price, weight * prices_.lost_shape(v, t, best.position));
    }
    if (is_overtaken(best.price, entry.price)) {
      queue_.push({best.price, v, t, entry.version});
      return;
    }
    // A part that vanishes is more obvious than a hole or a handle that closes.
    if (leaves_nothing && is_forbidden_cheaper(best.price, 1.0) && may_relax_rules()) {
      queue_.push({best.price, v, t, entry.version});
      return try_forbidden();
    }
    const bool first = original_.add_missing_rims(mesh_, v, check_.first_ring());
    const bool second = original_.add_missing_rims(mesh_, t, check_.second_ring());
    if (first || second) return push_edge(v, t, edge->num_faces);
    const double error = mesh_.scale() * original_.error(v, t, best.position);
    if (error > options_.max_error) return refuse(v, t, Rejection::kErrorLimit);
    if (!distance_.allows_collapse(v, t, best.position)) {
      return refuse(v, t, Rejection::kDistanceLimit);
    }
    collapse(v, t, best);
    result_.max_error = std::max(result_.max_error, error);
    if (check_.rules() != Rules::kAll) ++result_.relaxed_collapses;
  }

  [[nodiscard]] std::int64_t& count(Rejection reason) {
    return result_.rejected[static_cast<std::size_t>(reason)];
  }

  void refuse(std::int32_t v, std::int32_t t, Rejection reason) {
    ++count(reason);
    blocked_[v] = blocked_[t] = true;  // tried again once something near them changes
  }

  /// Number of remaining faces of the piece with this vertex; only try_piece() removes the last
  /// ones.
  [[nodiscard]] std::int64_t faces_left(std::int32_t v) const {
    return pieces_.size() > 0 ? pieces_.num_faces(pieces_.of_vertex(v)) : mesh_.num_faces();
  }

  // --- Steps ---------------------------------------------------------------------------------

  void collapse(std::int32_t v, std::int32_t t, const Plan& plan) {
    check_.neighbours(neighbours_);
    wedges_.gather(v, t);
    attributes_.collapse(v, t, plan.position, wedges_);
    const bool is_doubling = check_.may_double();
    if (is_doubling) doubled_.find_twins(v, t);
    const std::int64_t before = mesh_.num_faces();
    mesh_.collapse(v, t, wedges_.map());
    mesh_.move(t, plan.position);
    if (is_doubling) doubled_.remove(t);
    original_.merge(v, t, plan.attribute_price);
    kept_.merge(v, t);
    into_[v] = t;
    ++version_[t];
    if (pieces_.size() > 0) {
      pieces_.remove_faces(pieces_.of_vertex(t), before - mesh_.num_faces());
    }
    if (!mesh_.is_isolated(t)) push_edges(t);
    for (const std::int32_t w : neighbours_) {
      if (mesh_.is_isolated(w)) original_.box[t].extend(original_.box[w]);
      const bool was_hub = is_hub_[w] && !mesh_.is_hub(w);
      if (w == t || (!blocked_[w] && !was_hub) || mesh_.is_isolated(w)) continue;
      blocked_[w] = false;
      push_edges(w);
    }
  }

  void try_piece(const Entry& entry) {
    const std::int32_t i = entry.a;
    if (!pieces_.is_there(i)) return;
    if (is_visible(entry.price) && shrink_piece(i, entry.price)) return push_piece(i);
    if (pieces_.refresh(i) || is_overtaken(piece_price(i), entry.price)) return push_piece(i);
    const double error = mesh_.scale() * pieces_.mean_distance(i);
    if (error > options_.max_error) {
      ++count(Rejection::kErrorLimit);
      return;
    }
    result_.max_error = std::max(result_.max_error, error);
    for (const std::int32_t v : pieces_.vertices(i)) {
      while (!mesh_.is_isolated(v)) mesh_.remove_face(mesh_.first_face(v));
    }
    pieces_.remove_faces(i, pieces_.num_faces(i));
    ++result_.removed_pieces;
  }

  /// Makes a piece of at most four faces smaller against the rules, if that is cheaper than
  /// removing it: a tetrahedron, which no legal collapse makes smaller, becomes two faces back to
  /// back, and these become one. Larger pieces would fold at their bends.
  bool shrink_piece(std::int32_t i, double price) {
    const std::int64_t num_faces = pieces_.num_faces(i);
    if (num_faces > kTetrahedron) return false;
    std::vector<std::int32_t> left;
    std::ranges::copy_if(pieces_.vertices(i), std::back_inserter(left),
                         [&](std::int32_t v) { return !mesh_.is_isolated(v); });
    if (num_faces == 2 && left.size() == 3) {
      mesh_.remove_face(mesh_.first_face(left[0]));
      pieces_.remove_faces(i, 1);
      return true;
    }
    std::int32_t v = -1, t = -1;
    Plan best;
    best.price = price;
    for (std::size_t a = 0; a < left.size(); ++a) {
      for (std::size_t b = 0; b < a; ++b) {
        const std::optional<Plan> plan = plan_against_rules(left[a], left[b]);
        if (!plan || !(plan->price < best.price)) continue;
        best = *plan;
        v = left[a], t = left[b];
      }
    }
    if (v < 0) return false;
    const double error = mesh_.scale() * original_.error(v, t, best.position);
    if (error > options_.max_error) return false;
    result_.max_error = std::max(result_.max_error, error);
    check_.look_at(v, t);
    collapse(v, t, best);
    ++result_.relaxed_collapses;
    return true;
  }

  /// The cheapest collapse of an edge of a small piece to its ends or its middle, priced by the
  /// loss of shape and texture. It may flip faces and put them back to back, but must not make an
  /// edge with three faces. Other positions are not allowed, because flipped faces could become
  /// spikes there.
  [[nodiscard]] std::optional<Plan> plan_against_rules(std::int32_t v, std::int32_t t) {
    const RingEdge* edge = check_.look_at(v, t);
    if (edge == nullptr || faces_left(t) <= edge->num_faces || check_.breaks_link()) return {};
    const double weight = std::max(kept_.importance(v), kept_.importance(t)) / edge->num_faces;
    std::optional<Plan> best;
    for (const Place place : {Place::kFirst, Place::kSecond, Place::kMiddle}) {
      Plan plan = prices_.plan(v, t, edge->num_faces, place);
      const double attributes = std::max(
          0.0, plan.attribute_price - original_.attribute_price[v] - original_.attribute_price[t]);
      plan.price = weight * (prices_.lost_shape(v, t, plan.position) + attributes);
      if (best && !(plan.price < best->price)) continue;
      if (!check_.check_faces(plan.position, Rules::kFlips)) best = plan;
    }
    return best;
  }

  /// Moves a vertex by a vector that brings `area` nearer to the original, if that is legal. A
  /// vertex whose borders and texture are still exact stays in the planes of its borders; other
  /// faces would otherwise pull it away from a texture that is exactly in place.
  void move_to_fit(std::int32_t v, const Vector3d& by, double area) {
    if (kept_.is_locked(v) || is_exact_[v] || !(by.squaredNorm() > 0.0)) return;
    Vector3d step = by;
    if (original_.border[v] > 0.0 &&
        original_.attribute_price[v] <= kExactAttributes * original_.area[v]) {
      const Quadric& q = original_.borders[v];
      Eigen::Matrix3d planes;
      planes << q.xx, q.xy, q.xz, q.xy, q.yy, q.yz, q.xz, q.yz, q.zz;
      planes *= kHeldFirmly * std::sqrt(area);
      planes.diagonal().array() += area;
      step = planes.llt().solve(area * by);
    }
    move_if_legal(v, mesh_.position(v) + step);
  }

  void move_if_legal(std::int32_t v, const Vector3d& p) {
    if (!p.allFinite() || check_.check_move(v, p)) return;
    if (distance_.allows_move(v, p)) mesh_.move(v, p);
  }

  /// Moves vertices back that preserve the volume, but are far away from the faces they represent.
  void pull_back_spikes() {
    for (std::int32_t v = 0; v < mesh_.num_vertices(); ++v) {
      if (mesh_.is_isolated(v) || kept_.is_locked(v)) continue;
      const Vector3d p = within(original_.box[v], kReach, mesh_.position(v));
      if (p != mesh_.position(v)) move_if_legal(v, p);
    }
  }

  /// Finds the vertices whose faces are all unchanged. Moving them has no benefit, and points of
  /// another surface nearby could pull them away.
  void find_exact() {
    is_exact_.assign(mesh_.num_vertices(), false);
    for (std::int32_t v = 0; v < mesh_.num_vertices(); ++v) {
      const auto& edges = check_.edges(v);
      is_exact_[v] = version_[v] == 0 && std::ranges::all_of(edges, [&](const RingEdge& edge) {
                       return version_[edge.vertex] == 0;
                     });
    }
  }

  // --- The result ----------------------------------------------------------------------------

  QualityResult finish() {
    if (mesh_.num_faces() > 0 && mesh_.any_moved()) fit_to_input();
    result_.stop = why_it_stopped();
    result_.distance_bound = distance_.bound();
    result_.dropped_faces = mesh_.num_dropped();
    extract();
    return std::move(result_);
  }

  /// Moves the vertices, and then the texture coordinates, nearer to those of the input.
  void fit_to_input() {
    Progress tell;
    if (progress_) {
      tell = [this](double fraction) {
        fraction_ = fraction;
        progress_(fraction);
      };
    }
    queue_ = {};  // frees memory for the fit
    forbidden_ = {};
    original_.free_prices();
    find_exact();
    pull_back_spikes();
    SurfaceFit fit(input_, [this](std::int32_t v) {
      return pieces_.size() == 0 || pieces_.is_there(pieces_.of_vertex(v));
    });
    const double end = original_.is_textured ? 0.95 : distance_.has_limit() ? 0.99 : 1.0;
    fit.run(
        mesh_,
        [this](std::int32_t v, const Vector3d& by, double area) { move_to_fit(v, by, area); },
        part_of(tell, 0.8, end));
    if (original_.is_textured) {
      attributes_.fit_texture(fit, is_exact_, part_of(progress_, 0.95, 1.0));
    }
  }

  [[nodiscard]] CollapseStop why_it_stopped() {
    if (mesh_.num_faces() <= options_.target_faces) return CollapseStop::kTargetReached;
    if (count(Rejection::kErrorLimit) > 0) return CollapseStop::kErrorLimit;
    if (count(Rejection::kDistanceLimit) > 0) return CollapseStop::kDistanceLimit;
    return CollapseStop::kNoLegalCollapse;
  }

  /// Extracts the mesh and the maps of the input's vertices and faces.
  void extract() {
    std::vector<std::int32_t> kept;
    result_.mesh = mesh_.extract(input_, kept, result_.vertex_map, result_.face_map);
    attributes_.write_colors(kept, result_.mesh);
    for (std::int32_t v = 0; v < mesh_.num_vertices(); ++v) {
      std::int32_t end = v;
      while (into_[end] >= 0) end = into_[end];
      result_.vertex_map[v] = result_.vertex_map[end];
    }
    restore_locked();
    mend_turned_normals(input_, result_.face_map, result_.mesh);
  }

  /// Gives locked positions their exact values back, because the mesh was scaled. A larger move
  /// would invalidate the distance limit and the prices.
  void restore_locked() {
    for (std::size_t v = 0; v < options_.locked.size(); ++v) {
      const std::int32_t row = result_.vertex_map[v];
      if (!options_.locked[v] || row < 0) continue;
      const Eigen::RowVector3d exact = input_.vertices.row(static_cast<Eigen::Index>(v));
      const double rounding = kRounding * (mesh_.scale() + exact.cwiseAbs().maxCoeff());
      if (!((result_.mesh.vertices.row(row) - exact).cwiseAbs().maxCoeff() <= rounding)) {
        throw std::logic_error("a locked vertex has moved");
      }
      result_.mesh.vertices.row(row) = exact;
    }
  }

  const MeshView& input_;
  const QualityOptions& options_;
  const Progress& progress_;
  double fraction_ = 0.2;  // last reported progress
  CollapseMesh mesh_;
  Pieces pieces_;
  Kept kept_;
  WithinDistance distance_;
  Original original_;
  Prices prices_;
  CollapseCheck check_;
  JoinedWedges wedges_;
  Attributes attributes_;
  DoubledFaces doubled_;
  std::vector<std::uint32_t> version_;  // by vertex: number of its moves
  std::vector<bool> blocked_;           // vertices with a refused edge
  std::vector<bool> is_hub_;            // vertices whose edges wait until they have fewer faces
  std::vector<std::int32_t> into_;      // vertex onto which a vertex collapsed, or -1
  std::vector<bool> is_exact_;          // by vertex: all its faces are unchanged
  std::set<std::int32_t> kept_pieces_;  // pieces with a locked vertex
  FlatHeap<Entry> queue_, forbidden_;
  std::vector<std::int32_t> neighbours_;
  QualityResult result_;
};

void check_options(const MeshView& mesh, const QualityOptions& options) {
  check_not_negative("target_faces", static_cast<double>(options.target_faces));
  check_not_negative("max_error", options.max_error, MayBeInfinite::kYes);
  if (!(options.max_distance > 0.0)) {
    throw InputError("max_distance: expected a number > 0, got " +
                     number_text(options.max_distance) +
                     " (the published methods take 0: exactly coplanar collapses)");
  }
  check_not_negative("boundary_weight", options.boundary_weight);
  check_not_negative("seam_weight", options.seam_weight);
  check_not_negative("texture_weight", options.texture_weight);
  check_not_negative("color_weight", options.color_weight);
  const auto check_size = [&](const char* name, std::size_t size) {
    if (size == 0 || size == static_cast<std::size_t>(mesh.num_vertices())) return;
    throw InputError(std::string(name) + ": expected one for each vertex (" +
                     std::to_string(mesh.num_vertices()) + "), got " + std::to_string(size));
  };
  check_size("locked", options.locked.size());
  check_size("importance", options.importance.size());
  for (std::size_t v = 0; v < options.importance.size(); ++v) {
    const double value = options.importance[v];
    if (value > 0.0 && std::isfinite(value)) continue;
    throw InputError("importance: expected numbers > 0, got " + number_text(value) + " at vertex " +
                     std::to_string(v));
  }
}

}  // namespace

QualityResult simplify_quality(const MeshView& mesh, const QualityOptions& options,
                               const Progress& progress) {
  check_mesh(mesh);
  check_options(mesh, options);
  const UsualUnit usual(mesh);
  QualityOptions in_unit = options;
  in_unit.max_error = usual.from_file(options.max_error);
  in_unit.max_distance = usual.from_file(options.max_distance);
  // With max_distance, even rounding must not change the surface, so nothing is welded.
  std::optional<RoundingWeld> weld;
  if (mesh.num_faces() > options.target_faces && !std::isfinite(options.max_distance)) {
    weld.emplace(usual.mesh(), options.locked);
  }
  QualityResult result =
      QualitySimplifier(weld ? weld->mesh() : usual.mesh(), in_unit, progress).run();
  if (weld) weld->complete(result.vertex_map);
  usual.to_file(result.mesh.vertices);
  result.max_error = usual.to_file(result.max_error);
  if (result.distance_bound) result.distance_bound = usual.to_file(*result.distance_bound);
  return result;
}

}  // namespace manip3d
