#include "manip3d/simplify/qem.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>

#include "manip3d/error.hpp"
#include "simplify/collapse_mesh.hpp"
#include "simplify/collapse_queue.hpp"
#include "simplify/constraints.hpp"
#include "simplify/distance_guard.hpp"
#include "simplify/legality.hpp"
#include "simplify/quadric.hpp"
#include "simplify/turned_normals.hpp"
#include "simplify/usual_unit.hpp"

namespace manip3d {
namespace {

/// On flat regions every cost is rounding noise. This fraction of the squared edge length (a
/// deviation of 3e-5 of the edge) is added, so that short edges collapse first there; elsewhere it
/// has no effect.
constexpr double kShortEdgePreference = 1e-9;

/// The best collapse of a hub is searched again after one in kHubChanges of its faces has changed,
/// or when it is at the top of the queue.
constexpr std::int32_t kHubChanges = 8;

/// Accumulated quadrics: of the faces alone (for the reported error) and with the constraints (for
/// the order), both weighted by area; optionally over (x, y, z, u, v) per wedge.
class Quadrics {
 public:
  Quadrics(const CollapseMesh& mesh, const QemOptions& options)
      : surface_(mesh.num_vertices()),
        area_(mesh.num_vertices(), 0.0),
        self_(mesh.num_vertices(), 0.0) {
    const bool textured = options.texture == TextureTerm::kQuadric5;
    if (textured) texture_.resize(mesh.num_wedges());
    for_each_face(mesh, [&](std::int32_t f) { add_face(mesh, f, textured); });
    const std::vector<VertexClass> classes = classify(mesh);
    constraint_ = constraint_quadrics(mesh, classes, options);
    if (options.texture == TextureTerm::kSeamPaper) weigh_seams(classes, options);
    for (std::int32_t v = 0; v < mesh.num_vertices(); ++v) update_self(mesh, v);
  }

  /// (Q_v + Q_t)(t); with a texture term, summed over the wedges, each at its replacement.
  [[nodiscard]] double cost(const CollapseMesh& mesh, std::int32_t v, std::int32_t t,
                            const WedgeMap* map) const {
    const Eigen::Vector3d& x = mesh.position(t);
    double cost = self_[t];
    if (map != nullptr) {
      for (const WedgeMap::Pair& pair : map->pairs) {
        cost += texture_[pair.from](point5(mesh, x, pair.to));
      }
    } else {
      cost += surface_[v](x);
    }
    if (!constraint_.empty()) cost += constraint_[v](x);
    return cost;
  }

  /// Squared error of the surface alone: quadric / weight, in units of the diagonal.
  [[nodiscard]] double squared_error(const CollapseMesh& mesh, std::int32_t v,
                                     std::int32_t t) const {
    const double area = area_[v] + area_[t];
    if (!(area > 0.0)) return 0.0;
    const Eigen::Vector3d& x = mesh.position(t);
    return (surface_[v](x) + surface_[t](x)) / area;
  }

  [[nodiscard]] double area(std::int32_t v) const { return area_[v]; }
  [[nodiscard]] bool is_textured() const { return !texture_.empty(); }

  /// Q_t += Q_v; call after the mesh has collapsed v onto t.
  void merge(const CollapseMesh& mesh, std::int32_t v, std::int32_t t, const WedgeMap& map) {
    surface_[t] += surface_[v];
    area_[t] += area_[v];
    if (!constraint_.empty()) constraint_[t] += constraint_[v];
    if (is_textured()) {
      for (const WedgeMap::Pair& pair : map.pairs) {
        if (pair.from != pair.to) texture_[pair.to] += texture_[pair.from];
      }
    }
    update_self(mesh, t);
  }

 private:
  template <typename Body>
  static void for_each_face(const CollapseMesh& mesh, Body&& body) {
    for (std::int32_t v = 0; v < mesh.num_vertices(); ++v) {
      mesh.for_each_face(v, [&](std::int32_t f, std::int32_t c) {
        if (c == 0) body(f);
      });
    }
  }

  static std::vector<VertexClass> classify(const CollapseMesh& mesh) {
    std::vector<VertexClass> classes(mesh.num_vertices());
    Ring ring(classes.size());
    for (std::int32_t v = 0; v < mesh.num_vertices(); ++v) {
      mesh.gather_ring(v, ring);
      classes[v] = classify_vertex(mesh, ring, v);
    }
    return classes;
  }

  static Vector5d point5(const CollapseMesh& mesh, const Eigen::Vector3d& x, std::int32_t wedge) {
    Vector5d p;
    p << x, mesh.uv(wedge);
    return p;
  }

  void add_face(const CollapseMesh& mesh, std::int32_t f, bool textured) {
    const auto& face = mesh.face(f);
    const auto& wedges = mesh.wedges(f);
    const Eigen::Vector3d &p = mesh.position(face[0]), &q = mesh.position(face[1]),
                          &r = mesh.position(face[2]);
    const Eigen::Vector3d normal = (q - p).cross(r - p);
    const double length = normal.norm();
    if (!(length > 0.0)) return;
    const double area = 0.5 * length;
    const Quadric quadric = Quadric::plane(normal / length, p, area);
    for (const std::int32_t v : face) {
      surface_[v] += quadric;
      area_[v] += area;
    }
    if (!textured) return;
    const TextureQuadric texture = TextureQuadric::plane(
        point5(mesh, p, wedges[0]), point5(mesh, q, wedges[1]), point5(mesh, r, wedges[2]), area);
    for (const std::int32_t wedge : wedges) texture_[wedge] += texture;
  }

  void weigh_seams(const std::vector<VertexClass>& classes, const QemOptions& options) {
    if (constraint_.empty()) constraint_.resize(surface_.size());
    for (std::size_t v = 0; v < surface_.size(); ++v) {
      if (!classes[v].is_seam) continue;
      Quadric weighted = surface_[v];
      weighted += constraint_[v];
      weighted *= options.seam_weight - 1.0;
      constraint_[v] += weighted;
    }
  }

  /// Updates Q_t(t), a lower bound of the cost of every collapse onto t.
  void update_self(const CollapseMesh& mesh, std::int32_t t) {
    const Eigen::Vector3d& x = mesh.position(t);
    double self = 0.0;
    if (is_textured()) {
      seen_.clear();
      mesh.for_each_face(t, [&](std::int32_t f, std::int32_t c) {
        const std::int32_t wedge = mesh.wedges(f)[c];
        if (std::find(seen_.begin(), seen_.end(), wedge) != seen_.end()) return;
        seen_.push_back(wedge);
        self += texture_[wedge](point5(mesh, x, wedge));
      });
    } else {
      self = surface_[t](x);
    }
    if (!constraint_.empty()) self += constraint_[t](x);
    self_[t] = self;
  }

  std::vector<Quadric> surface_;
  std::vector<Quadric> constraint_;  // empty: none
  std::vector<TextureQuadric> texture_;
  std::vector<double> area_;
  std::vector<double> self_;
  std::vector<std::int32_t> seen_;
};

/// 2 area / longest edge squared, 0.866 for an equilateral triangle (MeshLab's quality).
double face_quality(const Eigen::Vector3d& p, const Eigen::Vector3d& q, const Eigen::Vector3d& r) {
  const double longest =
      std::max({(q - p).squaredNorm(), (r - q).squaredNorm(), (p - r).squaredNorm()});
  return longest > 0.0 ? (q - p).cross(r - p).norm() / longest : 0.0;
}

class QemSimplifier {
 public:
  QemSimplifier(const MeshView& input, const QemOptions& options)
      : input_(input),
        options_(options),
        mesh_(input),
        quadrics_(mesh_, options),
        legality_(mesh_, options),
        queue_(mesh_.num_vertices()),
        changes_(mesh_.num_vertices(), 0),
        ring_(mesh_.num_vertices()) {
    if (options.max_distance < std::numeric_limits<double>::infinity()) {
      guard_.emplace(input, options.max_distance);
    }
  }

  QemResult run(const Progress& progress) {
    QemResult result;
    fill_queue(progress);
    const double start = static_cast<double>(mesh_.num_faces());
    std::int64_t collapses_at_fill = -1;
    for (std::int64_t step = 0; mesh_.num_faces() > options_.target_faces; ++step) {
      if (queue_.empty()) {
        // A rejected collapse may have become legal through changes farther away. If none has,
        // reaching the target has priority over keeping the seams.
        const auto num_collapses = static_cast<std::int64_t>(result.collapses.size());
        if (num_collapses == collapses_at_fill && !leave_seams()) break;
        collapses_at_fill = num_collapses;
        fill_queue(progress);
        continue;
      }
      try_cheapest(result);
      // With a distance limit, one step can take as long as hundreds of others.
      if (progress && (guard_ || step % 512 == 0)) {
        const double gone = start - static_cast<double>(mesh_.num_faces());
        progress(gone / std::max(1.0, start - static_cast<double>(options_.target_faces)));
      }
    }
    return finish(std::move(result));
  }

  QemResult replay(const std::vector<Collapse>& collapses, const Progress& progress) {
    QemResult result;
    Ticker ticker(progress);
    const auto exists = [&](std::int32_t v) {
      return v >= 0 && v < mesh_.num_vertices() && !mesh_.is_isolated(v);
    };
    for (const Collapse& collapse : collapses) {
      ticker.tick();
      if (mesh_.num_faces() <= options_.target_faces) break;
      bool is_edge = exists(collapse.removed) && exists(collapse.kept);
      if (is_edge) {
        mesh_.gather_ring(collapse.removed, ring_);
        is_edge = ring_.find(collapse.kept) != nullptr;
      }
      if (!is_edge) {
        throw InputError("collapses: expected the record of this mesh, but " +
                         std::to_string(collapse.removed) + " -> " + std::to_string(collapse.kept) +
                         " is no edge when its turn comes");
      }
      mesh_.map_wedges(collapse.removed, collapse.kept, map_);
      mesh_.collapse(collapse.removed, collapse.kept, map_);
      result.collapses.push_back(collapse);
      result.max_error = std::max(result.max_error, collapse.error);
    }
    return finish(std::move(result));
  }

 private:
  /// Allows seam vertices to leave their seam; returns false if they already may.
  bool leave_seams() {
    if (options_.texture != TextureTerm::kSeamPlanes || may_leave_seams_) return false;
    may_leave_seams_ = true;
    return true;
  }

  [[nodiscard]] bool is_locked_now(const VertexClass& vertex) const {
    VertexClass freed = vertex;
    if (may_leave_seams_) freed.is_seam_corner = false;
    return is_locked(freed, options_);
  }

  void fill_queue(const Progress& progress) {
    Ticker ticker(progress);
    for (std::int32_t v = 0; v < mesh_.num_vertices(); ++v) {
      ticker.tick();
      propose(v, nullptr);
    }
  }

  /// Queues the best collapse of v; with `after`, the best of those that are ordered after it.
  void propose(std::int32_t v, const Candidate* after) {
    if (mesh_.is_isolated(v)) return;
    changes_[v] = 0;
    mesh_.gather_ring(v, ring_);
    const VertexClass vertex = classify_vertex(mesh_, ring_, v);
    if (is_locked_now(vertex)) {
      queue_.remove(v);
      return;
    }
    Candidate best;
    for (const RingEdge& edge : ring_.edges()) {
      if (!may_collapse(vertex, edge)) continue;
      const Candidate candidate = price(v, edge.vertex);
      if (after != nullptr && !(*after < candidate)) continue;
      if (best.vertex < 0 || candidate < best) best = candidate;
    }
    best.vertex < 0 ? queue_.remove(v) : queue_.set(best);
  }

  /// Whether the class of a vertex allows a collapse along an edge.
  [[nodiscard]] bool may_collapse(const VertexClass& vertex, const RingEdge& edge) const {
    if (options_.boundary == BoundaryTerm::kCurvature && vertex.is_boundary &&
        edge.num_faces != 1) {
      return false;  // along the boundary only
    }
    return options_.texture != TextureTerm::kSeamPlanes || may_leave_seams_ || !vertex.is_seam ||
           edge.is_seam;
  }

  [[nodiscard]] Candidate price(std::int32_t v, std::int32_t t) {
    const WedgeMap* map = nullptr;
    if (quadrics_.is_textured()) {
      mesh_.map_wedges(v, t, map_);
      map = &map_;
    }
    const double squared_length = (mesh_.position(t) - mesh_.position(v)).squaredNorm();
    double cost = std::max(0.0, quadrics_.cost(mesh_, v, t, map)) +
                  kShortEdgePreference * quadrics_.area(v) * squared_length;
    if (options_.quality_threshold > 0.0) {
      // The divisor is at least this, so that needles are expensive, but still comparable.
      constexpr double kMinQuality = 1e-6;
      cost /= std::max(kMinQuality, std::min(worst_quality(v, t), options_.quality_threshold));
    }
    return {cost, squared_length, v, t};
  }

  [[nodiscard]] double worst_quality(std::int32_t v, std::int32_t t) const {
    double worst = 1.0;
    mesh_.for_each_face(v, [&](std::int32_t f, std::int32_t c) {
      const auto& face = mesh_.face(f);
      const std::int32_t a = face[(c + 1) % 3], b = face[(c + 2) % 3];
      if (a == t || b == t) return;
      worst =
          std::min(worst, face_quality(mesh_.position(t), mesh_.position(a), mesh_.position(b)));
    });
    return worst;
  }

  void try_cheapest(QemResult& result) {
    const Candidate candidate = queue_.top();
    const std::int32_t v = candidate.vertex, t = candidate.target;
    if (changes_[v] > 0) return propose(v, nullptr);
    // Q_t may have grown in the meantime; it never shrinks, so the costs in the queue are lower
    // bounds.
    if (price(v, t).cost > candidate.cost) {
      propose(v, nullptr);
      return;
    }
    const double squared = quadrics_.squared_error(mesh_, v, t);
    if (squared < 0.0) ++result.clamped_costs;
    const double error = mesh_.scale() * std::sqrt(std::max(0.0, squared));
    std::optional<Rejection> rejection =
        error > options_.max_error ? Rejection::kErrorLimit : legality_.check(v, t, map_);
    if (!rejection && guard_ && !keeps_distance(v, t)) rejection = Rejection::kDistanceLimit;
    if (rejection) {
      ++result.rejected[static_cast<std::size_t>(*rejection)];
      propose(v, &candidate);
      return;
    }
    if (may_leave_seams_ && leaves_seam(v, t)) ++result.off_seam_collapses;
    collapse(v, t);
    result.collapses.push_back({v, t, error});
    result.max_error = std::max(result.max_error, error);
  }

  /// Asks the guard of max_distance, which remembers the collapse for commit(). It reads the ring
  /// gathered by the legality check and must be called after it.
  [[nodiscard]] bool keeps_distance(std::int32_t v, std::int32_t t) {
    touched_.clear();
    changed_.clear();
    around_.clear();
    const auto has = [&](std::int32_t f, std::int32_t vertex) {
      const auto& face = mesh_.face(f);
      return std::find(face.begin(), face.end(), vertex) != face.end();
    };
    mesh_.for_each_face(v, [&](std::int32_t f, std::int32_t) {
      touched_.push_back(f);
      if (has(f, t)) return;
      DistanceGuard::Change change{f, {}};
      for (int k = 0; k < 3; ++k) {
        const std::int32_t vertex = mesh_.face(f)[k];
        change.corners[k] = input_.vertices.row(vertex == v ? t : vertex);
      }
      changed_.push_back(change);
    });
    for (const RingEdge& edge : legality_.ring().edges()) {
      mesh_.for_each_face(edge.vertex, [&](std::int32_t f, std::int32_t) {
        if (!has(f, v)) around_.push_back(f);
      });
    }
    std::sort(around_.begin(), around_.end());
    around_.erase(std::unique(around_.begin(), around_.end()), around_.end());
    return guard_->allows(touched_, changed_, around_);
  }

  [[nodiscard]] bool leaves_seam(std::int32_t v, std::int32_t t) {
    const Ring& ring = legality_.ring();
    const VertexClass vertex = classify_vertex(mesh_, ring, v);
    return vertex.is_seam && (vertex.is_seam_corner || !ring.find(t)->is_seam);
  }

  void collapse(std::int32_t v, std::int32_t t) {
    neighbours_.clear();
    for (const RingEdge& edge : legality_.ring().edges()) neighbours_.push_back(edge.vertex);
    if (guard_) guard_->commit();
    mesh_.collapse(v, t, map_);
    quadrics_.merge(mesh_, v, t, map_);
    queue_.remove(v);
    // Faces of the neighbours changed, and with them their edges, costs and legality; t is one of
    // them.
    for (const std::int32_t w : neighbours_) {
      if (mesh_.is_isolated(w)) {
        queue_.remove(w);
      } else if (!mesh_.is_hub(w) || ++changes_[w] > mesh_.degree(w) / kHubChanges) {
        propose(w, nullptr);
      }
    }
  }

  QemResult finish(QemResult result) {
    if (mesh_.num_faces() <= options_.target_faces) {
      result.stop = CollapseStop::kTargetReached;
    } else if (result.rejected[static_cast<std::size_t>(Rejection::kErrorLimit)] > 0) {
      result.stop = CollapseStop::kErrorLimit;
    } else if (result.rejected[static_cast<std::size_t>(Rejection::kDistanceLimit)] > 0) {
      result.stop = CollapseStop::kDistanceLimit;
    } else {
      result.stop = CollapseStop::kNoLegalCollapse;
    }
    if (guard_) result.distance_bound = guard_->bound();
    result.dropped_faces = mesh_.num_dropped();
    for (std::int32_t v = 0; v < mesh_.num_vertices(); ++v) {
      if (mesh_.is_isolated(v)) continue;
      mesh_.gather_ring(v, ring_);
      result.locked_vertices += is_locked_now(classify_vertex(mesh_, ring_, v)) ? 1 : 0;
    }
    result.mesh = mesh_.extract(input_, result.kept, result.vertex_map, result.face_map);
    mend_turned_normals(input_, result.face_map, result.mesh);
    follow_collapses(result);
    return result;
  }

  /// Maps the removed vertices to the output vertices of those onto which they moved.
  static void follow_collapses(QemResult& result) {
    for (auto c = result.collapses.rbegin(); c != result.collapses.rend(); ++c) {
      result.vertex_map[c->removed] = result.vertex_map[c->kept];
    }
  }

  const MeshView& input_;
  const QemOptions options_;
  CollapseMesh mesh_;
  Quadrics quadrics_;
  Legality legality_;
  CollapseQueue queue_;
  std::vector<std::int32_t> changes_;  // by hub: collapses beside it since the last search
  Ring ring_;
  WedgeMap map_;
  std::vector<std::int32_t> neighbours_;
  std::optional<DistanceGuard> guard_;  ///< Guard of max_distance; none if it is infinite.
  std::vector<std::int32_t> touched_, around_;
  std::vector<DistanceGuard::Change> changed_;
  bool may_leave_seams_ = false;
};

void check_options(const QemOptions& options) {
  const auto check = [](bool ok, const char* name, const char* expected, double got) {
    if (ok) return;
    throw InputError(std::string(name) + ": expected " + expected + ", got " + number_text(got));
  };
  check(options.target_faces >= 0, "target_faces", ">= 0",
        static_cast<double>(options.target_faces));
  check(options.max_error >= 0.0, "max_error", ">= 0", options.max_error);
  check(options.max_distance >= 0.0, "max_distance", ">= 0", options.max_distance);
  check(options.boundary_weight >= 0.0 && std::isfinite(options.boundary_weight), "boundary_weight",
        "a finite number >= 0", options.boundary_weight);
  check(options.seam_weight >= 1.0 && std::isfinite(options.seam_weight), "seam_weight",
        "a finite number >= 1", options.seam_weight);
  check(options.quality_threshold >= 0.0 && options.quality_threshold <= 1.0, "quality_threshold",
        "a number in [0, 1]", options.quality_threshold);
}

/// Number of faces without texture coordinates, on which the published baselines that preserve
/// texture do not work (table 2.3).
std::int64_t count_untextured(const MeshView& mesh) {
  std::int64_t count = 0;
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f) count += mesh.face_has_texcoords(f) ? 0 : 1;
  return count;
}

QemResult refuse(const MeshView& mesh, std::string message) {
  QemOptions untouched;
  untouched.target_faces = mesh.num_faces();
  QemResult result = QemSimplifier(mesh, untouched).run({});
  result.stop = CollapseStop::kRefused;
  result.message = std::move(message);
  return result;
}

}  // namespace

QemResult simplify_qem(const MeshView& mesh, const QemOptions& options, const Progress& progress) {
  check_mesh(mesh);
  check_options(options);
  if (options.texture == TextureTerm::kQuadric5) {
    const std::int64_t untextured = count_untextured(mesh);
    if (untextured > 0) {
      return refuse(mesh, "texture-preserving quadrics need texture coordinates on every face; " +
                              std::to_string(untextured) + " of " +
                              std::to_string(mesh.num_faces()) + " have none");
    }
  }
  const UsualUnit usual(mesh);
  QemOptions in_unit = options;
  in_unit.max_error = usual.from_file(options.max_error);
  in_unit.max_distance = usual.from_file(options.max_distance);
  QemResult result = QemSimplifier(usual.mesh(), in_unit).run(progress);
  usual.to_file(result.mesh.vertices);
  result.max_error = usual.to_file(result.max_error);
  for (Collapse& collapse : result.collapses) collapse.error = usual.to_file(collapse.error);
  if (result.distance_bound) result.distance_bound = usual.to_file(*result.distance_bound);
  return result;
}

QemResult replay_collapses(const MeshView& mesh, const QemOptions& options,
                           const std::vector<Collapse>& collapses, std::int64_t target_faces,
                           const Progress& progress) {
  check_mesh(mesh);
  QemOptions replayed = options;
  replayed.target_faces = target_faces;
  replayed.max_distance = std::numeric_limits<double>::infinity();
  check_options(replayed);
  return QemSimplifier(mesh, replayed).replay(collapses, progress);
}

}  // namespace manip3d
