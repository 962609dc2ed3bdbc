#include "manip3d/simplify/quality.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <optional>
#include <set>
#include <string>
#include <tuple>
#include <utility>

#include "geometry/union_find.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/patch_distance.hpp"
#include "simplify/attribute_quadric.hpp"
#include "simplify/collapse_mesh.hpp"
#include "simplify/collapse_rules.hpp"
#include "simplify/distance_guard.hpp"
#include "simplify/flat_heap.hpp"
#include "simplify/legality.hpp"
#include "simplify/pieces.hpp"
#include "simplify/surface_fit.hpp"
#include "simplify/usual_unit.hpp"

namespace manip3d {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

/// Pull of the middle of an edge on the new vertex, beside the quadrics: it decides only where
/// they do not (RockerArm: 1e-3 costs 5 % of error, 1e-6 none, but then vertices wander).
constexpr double kTowardsMiddle = 1e-5;

/// On flat regions every price is rounding noise: short edges go first there.
constexpr double kShortEdgeWeight = 1e-5;

/// The faces around an edge, counted in full, against a price that counts each face once: measured
/// on the many-part models, where 1 removes pieces too early.
constexpr double kSurfaceShare = 0.2;

/// A strip of width d along a border is d / 2 away from the border on average.
constexpr double kStripDistance = 0.5;

/// The link condition is waived if the cheapest legal collapse costs this many times more than the
/// forbidden one; 3 to 100 do the same on the models that need it.
constexpr double kFarCheaper = 30.0;

/// It is waived only for an error that can be seen: mean distance over the size of the mesh.
constexpr double kVisible = 1e-3;

/// A vertex whose borders and texture are still exact owes at most this for them, over its area (a
/// distance; the diagonal is 1).
constexpr double kOwesNothing = 1e-9;

/// Weight of the planes of borders that a vertex shall not leave, against its surface.
constexpr double kHeldFirmly = 1e6;

/// Edges whose proofs failed that are remembered at most (50 MB); those of others are tried again.
constexpr std::size_t kMostRefused = 1 << 20;

/// A piece that vanishes is missed more than its distance says.
constexpr double kPieceFactor = 2.0;

/// A piece with so few faces left has each of them far from most of what it stands for.
constexpr std::int64_t kLastFaces = 12;

/// The faces of an edge lie on one side if the mean of the unit vectors towards them is this long:
/// two of them open by less than 16 degrees.
constexpr double kOneSided = 0.99;

/// The sum of the area vectors around an edge is rounding noise below this share of their lengths,
/// as where front and back of a sheet cancel: no volume tells where the new vertex lies.
constexpr double kLeastVolume = 1e-6;

/// How far outside of the box of its original faces a vertex may end up, over the diagonal of the
/// box. The tip of a cone with the volume of a spherical cap that reaches 50 degrees from its axis
/// is as far outside; farther tips follow volumes that are mostly gone, and look like spikes.
constexpr double kReach = 0.1;

/// How far outside of the box of its original chart a texture coordinate may be fitted, over the
/// diagonal of the box. Rounded borders of charts ask for this much on the models with most seams.
constexpr double kTextureReach = 0.02;

/// A texture is weighted by the share of the area that shows one, but by no less than this.
constexpr double kLeastTextured = 0.01;

struct Entry {
  double price;           // per face that goes
  std::int32_t a, b;      // an edge; b < 0: the piece a
  std::uint32_t version;  // of the edge: the sum of its ends'
  friend bool operator<(const Entry& x, const Entry& y) {
    if (x.price != y.price) return x.price < y.price;
    return std::tie(x.a, x.b) < std::tie(y.a, y.b);
  }
};

/// A collapse: where the new vertex lies and what it costs.
struct Plan {
  double price = 0.0;  // per face that goes
  Vector3d position = Vector3d::Zero();
  double owed = 0.0;  // for borders and texture, since the beginning
};

enum class Place : std::uint8_t { kBest, kFirst, kSecond, kMiddle };

/// A textured wedge of the vertex that two become.
struct Textured {
  std::int32_t wedge;
  AttributeQuadric quadric;
  bool stays = false;  // it still has faces then
};

/// What the faces around an edge are like now: their quadric and area, and the plane
/// normal.p = offset on which the volume below them stays the same [Lindstrom & Turk 1998].
struct Star {
  Quadric quadric;
  double area = 0.0;
  Vector3d normal = Vector3d::Zero();
  double offset = 0.0;
};

/// The borders of a piece of the input, which go with it.
struct PieceBorders {
  double length = 0.0;      // of its boundaries and seams, times their weights
  double area = 0.0;        // of its faces
  double importance = 0.0;  // the largest of its vertices
};

class QualitySimplifier {
 public:
  QualitySimplifier(const MeshView& input, const QualityOptions& options, const Progress& progress)
      : input_(input),
        options_(options),
        progress_(progress),
        mesh_(input),
        pieces_(input, mesh_.scale(), part_of(progress, 0.0, 0.1)),
        ring_v_(mesh_.num_vertices()),
        ring_t_(mesh_.num_vertices()),
        surface_(mesh_.num_vertices()),
        borders_(mesh_.num_vertices()),
        part_(mesh_.num_vertices()),
        area_(mesh_.num_vertices(), 0.0),
        border_(mesh_.num_vertices(), 0.0),
        owed_(mesh_.num_vertices(), 0.0),
        version_(mesh_.num_vertices(), 0),
        blocked_(mesh_.num_vertices(), false),
        into_(mesh_.num_vertices(), -1),
        is_locked_(options.locked),
        importance_(options.importance),
        is_textured_(input.has_texcoords() && options.texture_weight > 0.0) {
    if (options.max_distance < std::numeric_limits<double>::infinity()) {
      guard_.emplace(input, options.max_distance, [this] {
        if (progress_) progress_(fraction_);
      });
    }
    Ticker ticker(progress);
    if (is_textured_) {
      measure_texture();
      texture_.resize(mesh_.num_wedges());
      find_charts();
      jumps_.resize(mesh_.num_vertices());
      jump_.resize(mesh_.num_vertices(), 0.0);
    }
    for (std::int32_t f = 0; f < mesh_.num_slots(); ++f) {
      ticker.tick();
      if (mesh_.is_alive(f)) add_face(f);
    }
    for (std::int32_t v = 0; v < mesh_.num_vertices(); ++v) {
      ticker.tick();
      add_borders(v);
    }
    for (std::int32_t i = 0; i < pieces_.size(); ++i) {
      PieceBorders& own = piece_borders_.emplace_back();
      for (const std::int32_t v : pieces_.vertices(i)) {
        if (is_locked(v)) kept_pieces_.insert(i);
        own.length += border_[v];
        own.area += area_[v];
        own.importance = std::max(own.importance, importance(v));
      }
    }
    for (Eigen::Index v = 0; v < input.colors.rows(); ++v) {
      colors_.emplace_back(input.colors.row(v).cast<double>().transpose());
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
      if (is_forbidden_cheaper(entry.price) && relax_rules()) {
        push_all_edges();
        continue;
      }
      queue_.pop();
      entry.b < 0 ? try_piece(entry) : try_edge(entry);
      // A step that keeps a distance can take as long as hundreds of others.
      if (progress_ && (guard_ || step % 512 == 0)) {
        const double gone = start - static_cast<double>(mesh_.num_faces());
        fraction_ = 0.2 + 0.6 * gone / std::max(1.0, start - target);
        progress_(fraction_);
      }
    }
    return finish();
  }

 private:
  // --- The original surface ------------------------------------------------------------------

  [[nodiscard]] Vector3d area_vector(std::int32_t f) const {
    const auto& face = mesh_.face(f);
    const Vector3d& p = mesh_.position(face[0]);
    return (mesh_.position(face[1]) - p).cross(mesh_.position(face[2]) - p);
  }

  [[nodiscard]] bool shows_texture(std::int32_t f) const {
    const auto& wedges = mesh_.wedges(f);
    return mesh_.has_texture(wedges[0]) && std::ranges::all_of(wedges, [&](std::int32_t wedge) {
             return mesh_.uv(wedge).cwiseAbs().maxCoeff() < kFarthestTexture;
           });
  }

  /// The length on the surface of a unit of texture, on average.
  void measure_texture() {
    double on_surface = 0.0, in_texture = 0.0, whole = 0.0;
    for (std::int32_t f = 0; f < mesh_.num_slots(); ++f) {
      if (!mesh_.is_alive(f)) continue;
      whole += area_vector(f).norm();
      if (!shows_texture(f)) continue;
      const auto& w = mesh_.wedges(f);
      on_surface += area_vector(f).norm();
      const Vector2d e1 = mesh_.uv(w[1]) - mesh_.uv(w[0]), e2 = mesh_.uv(w[2]) - mesh_.uv(w[0]);
      in_texture += std::abs(e1.x() * e2.y() - e1.y() * e2.x());
    }
    if (!(in_texture > 0.0)) return;
    texture_length_ = std::sqrt(on_surface / in_texture);
    texture_share_ = std::max(on_surface / whole, kLeastTextured);
  }

  /// Charts are wedges joined by faces: a collapse never merges wedges of two charts.
  void find_charts() {
    UnionFind sets(mesh_.num_wedges());
    for (std::int32_t f = 0; f < mesh_.num_slots(); ++f) {
      if (!mesh_.is_alive(f)) continue;
      const auto& wedges = mesh_.wedges(f);
      sets.join(wedges[0], wedges[1]);
      sets.join(wedges[0], wedges[2]);
    }
    chart_.resize(mesh_.num_wedges());
    for (std::int32_t w = 0; w < mesh_.num_wedges(); ++w) {
      const std::int32_t root = sets.root(w);  // the least of its set
      if (root == w) {
        chart_[w] = static_cast<std::int32_t>(chart_box_.size());
        chart_box_.emplace_back();
      } else {
        chart_[w] = chart_[root];
      }
      chart_box_[chart_[w]].extend(mesh_.uv(w));
    }
  }

  /// Each corner stands for a third of the face.
  void add_face(std::int32_t f) {
    const auto& face = mesh_.face(f);
    Eigen::AlignedBox3d box;
    for (const std::int32_t v : face) box.extend(mesh_.position(v));
    for (const std::int32_t v : face) part_[v].extend(box);
    const Vector3d normal = area_vector(f);
    const double length = normal.norm();
    if (!(length > 0.0)) return;
    const double area = length / 6.0;
    const Quadric plane = Quadric::plane(normal / length, mesh_.position(face[0]), area);
    for (const std::int32_t v : face) {
      surface_[v] += plane;
      area_[v] += area;
    }
    whole_area_ += 3.0 * area;
    if (!is_textured_ || !shows_texture(f)) return;
    const auto& wedges = mesh_.wedges(f);
    const AttributeQuadric texture = AttributeQuadric::triangle(
        {mesh_.position(face[0]), mesh_.position(face[1]), mesh_.position(face[2])},
        {mesh_.uv(wedges[0]), mesh_.uv(wedges[1]), mesh_.uv(wedges[2])}, area);
    for (const std::int32_t wedge : wedges) texture_[wedge] += texture;
  }

  /// Whether all faces of an edge of v lie on one side of it: on a boundary, and on the rim of a
  /// sheet whose front and back are faces of their own, where the surface ends as well.
  [[nodiscard]] bool is_one_sided(std::int32_t v, const RingEdge& edge) const {
    if (edge.num_faces == 1) return true;
    const Vector3d along = (mesh_.position(edge.vertex) - mesh_.position(v)).normalized();
    Vector3d sum = Vector3d::Zero();
    mesh_.for_each_face(v, [&](std::int32_t f, std::int32_t c) {
      const std::int32_t a = mesh_.face(f)[(c + 1) % 3], b = mesh_.face(f)[(c + 2) % 3];
      if (a != edge.vertex && b != edge.vertex) return;
      const Vector3d to_third = mesh_.position(a == edge.vertex ? b : a) - mesh_.position(v);
      sum += (to_third - along.dot(to_third) * along).normalized();
    });
    return sum.norm() > kOneSided * edge.num_faces;
  }

  /// Planes through boundaries and seams, perpendicular to their faces; each end stands for half
  /// of an edge. A corner of a border has two planes and is dear, a straight one is cheap along it.
  void add_borders(std::int32_t v) {
    mesh_.gather_ring(v, ring_v_);
    mesh_.for_each_face(v, [&](std::int32_t f, std::int32_t c) {
      for (const std::size_t other : {(c + 1) % 3, (c + 2) % 3}) {
        const std::int32_t t = mesh_.face(f)[other];
        const RingEdge& edge = *ring_v_.find(t);
        if (t < v) continue;
        const bool is_boundary = is_one_sided(v, edge);
        if (!is_boundary && !edge.is_seam) continue;
        const Vector3d along = mesh_.position(t) - mesh_.position(v);
        const Vector3d across = along.cross(area_vector(f));
        const double length = across.norm();
        if (!(length > 0.0)) continue;
        const double weight =
            is_boundary ? options_.boundary_weight : options_.seam_weight / edge.num_faces;
        const Quadric plane =
            Quadric::plane(across / length, mesh_.position(v), 0.5 * weight * along.norm());
        borders_[v] += plane;
        borders_[t] += plane;
        border_[v] += 0.5 * weight * along.norm();
        border_[t] += 0.5 * weight * along.norm();
        if (!is_textured_ || !edge.is_seam) continue;
        const double jump =
            0.5 * along.norm() * texture_factor() * texture_jump(f, v, t) / edge.num_faces;
        const Quadric shown = Quadric::plane(across / length, mesh_.position(v), jump);
        for (const std::int32_t end : {v, t}) {
          jumps_[end] += shown;
          jump_[end] += jump;
        }
      }
    });
  }

  /// How far the texture of a face is from those of the others on its edge v t, where they show the
  /// same material: the mean of both ends, the largest of the faces.
  [[nodiscard]] double texture_jump(std::int32_t f, std::int32_t v, std::int32_t t) const {
    const auto uv = [&](std::int32_t face, std::int32_t at) -> const Vector2d& {
      const auto& corners = mesh_.face(face);
      const std::size_t c = corners[0] == at ? 0 : corners[1] == at ? 1 : 2;
      return mesh_.uv(mesh_.wedges(face)[c]);
    };
    if (!shows_texture(f)) return 0.0;
    double jump = 0.0;
    mesh_.for_each_face(v, [&](std::int32_t g, std::int32_t) {
      if (g == f || !touches(g, t) || !shows_texture(g)) return;
      if (mesh_.surface(mesh_.wedges(g)[0]) != mesh_.surface(mesh_.wedges(f)[0])) return;
      jump =
          std::max(jump, 0.5 * (uv(f, v) - uv(g, v)).norm() + 0.5 * (uv(f, t) - uv(g, t)).norm());
    });
    return jump;
  }

  // --- The price of a collapse ---------------------------------------------------------------

  /// A face with its part in a star.
  struct StarFace {
    Vector3d normal;  // twice the area long
    double offset = 0.0, area = 0.0;
    Quadric quadric;

    void add_to(Star& star) const {
      star.normal += normal;
      star.offset += offset;
      if (!(area > 0.0)) return;
      star.quadric += quadric;
      star.area += area;
    }
  };

  [[nodiscard]] StarFace star_face(std::int32_t f, const Vector3d& p) const {
    const Vector3d normal = area_vector(f);
    const double length = normal.norm();
    StarFace face{normal, normal.dot(p), 0.5 * length, {}};
    if (length > 0.0) face.quadric = Quadric::plane(normal / length, p, 0.5 * length);
    return face;
  }

  /// All edges of v are priced next: its own faces are looked at once.
  void keep_star(std::int32_t v) {
    center_ = v;
    center_star_ = {};
    center_faces_.clear();
    mesh_.for_each_face(v, [&](std::int32_t f, std::int32_t) {
      center_faces_.push_back(star_face(f, mesh_.position(v)));
      center_faces_.back().add_to(center_star_);
    });
  }

  [[nodiscard]] Star star_of(std::int32_t v, std::int32_t t) const {
    Star star;
    const auto add = [&](std::int32_t from, std::int32_t seen) {
      std::size_t i = 0;
      mesh_.for_each_face(from, [&](std::int32_t f, std::int32_t c) {
        const std::size_t here = i++;
        const auto& face = mesh_.face(f);
        if (face[(c + 1) % 3] == seen || face[(c + 2) % 3] == seen) return;
        if (from == center_) {
          center_faces_[here].add_to(star);
        } else {
          star_face(f, mesh_.position(from)).add_to(star);
        }
      });
    };
    if (v == center_) {
      star = center_star_;
    } else {
      add(v, -1);
    }
    add(t, v);
    return star;
  }

  /// Which wedge of t each wedge of v becomes: that across a face on the edge; others stay.
  void map_wedges(std::int32_t v, std::int32_t t) {
    map_.pairs.clear();
    mesh_.for_each_face(v, [&](std::int32_t f, std::int32_t c) {
      const std::int32_t from = mesh_.wedges(f)[c];
      for (const std::size_t other : {(c + 1) % 3, (c + 2) % 3}) {
        if (mesh_.face(f)[other] == t && map_.at(from) < 0) {
          map_.pairs.push_back({from, mesh_.wedges(f)[other]});
        }
      }
    });
    mesh_.for_each_face(v, [&](std::int32_t f, std::int32_t c) {
      const std::int32_t from = mesh_.wedges(f)[c];
      if (map_.at(from) < 0) map_.pairs.push_back({from, from});
    });
  }

  /// The textured wedges of the vertex that v and t become, with their quadrics.
  void gather_wedges(std::int32_t v, std::int32_t t) {
    map_wedges(v, t);
    wedges_.clear();
    const auto find = [&](std::int32_t wedge) {
      return std::find_if(wedges_.begin(), wedges_.end(),
                          [&](const Textured& known) { return known.wedge == wedge; });
    };
    mesh_.for_each_face(t, [&](std::int32_t f, std::int32_t c) {
      const std::int32_t wedge = mesh_.wedges(f)[c];
      if (!mesh_.has_texture(wedge)) return;
      auto known = find(wedge);
      if (known == wedges_.end()) known = wedges_.insert(known, {wedge, texture_[wedge]});
      if (!touches(f, v)) known->stays = true;
    });
    for (const WedgeMap::Pair& pair : map_.pairs) {
      if (!mesh_.has_texture(pair.from)) continue;
      const auto known = find(pair.to);
      if (known == wedges_.end()) {
        wedges_.push_back({pair.to, texture_[pair.from]});
      } else {
        known->quadric += texture_[pair.from];
      }
    }
    mesh_.for_each_face(v, [&](std::int32_t f, std::int32_t c) {
      const std::int32_t wedge = mesh_.wedges(f)[c];
      if (mesh_.has_texture(wedge) && !touches(f, t)) find(map_.at(wedge))->stays = true;
    });
  }

  /// The price of the texture at the vertex that v and t become. Where a wedge loses its last face,
  /// what is left of its surface shows the one that is most like it.
  [[nodiscard]] double shifted_texture(const Vector3d& p) const {
    double price = 0.0;
    for (const Textured& own : wedges_) {
      if (!(own.quadric.weight > 0.0)) continue;
      double squares = own.quadric(p);
      if (!own.stays) {
        double least = std::numeric_limits<double>::infinity();
        const Vector2d meant = own.quadric.best(p);
        for (const Textured& other : wedges_) {
          if (!other.stays || !(other.quadric.weight > 0.0)) continue;
          if (mesh_.surface(other.wedge) != mesh_.surface(own.wedge)) continue;
          least = std::min(least, (other.quadric.best(p) - meant).squaredNorm());
        }
        if (std::isfinite(least)) squares += own.quadric.weight * least;
      }
      price += texture_factor() * integral(squares, own.quadric.weight);
    }
    return price;
  }

  /// Area times root mean square, a bound of the integral of the distance.
  static double integral(double squares, double area) {
    return std::sqrt(std::max(0.0, squares) * area);
  }

  /// The price of the strips that borders sweep, for the sum of their squared distances and the
  /// weighted length: no more area is swept than there is around them, however many borders cross
  /// it (on models that give each face a chart of its own, all edges are borders).
  [[nodiscard]] double strips(double squares, double length, double area) const {
    if (!(squares > 0.0) || !(length > 0.0)) return 0.0;
    const double most = std::max(options_.boundary_weight, options_.seam_weight);
    return kStripDistance * std::min(squares, most * area * std::sqrt(squares / length));
  }

  Plan plan(std::int32_t v, std::int32_t t, std::int32_t num_edge_faces, Place place) {
    if (is_textured_) gather_wedges(v, t);
    Quadric borders = borders_[v];
    borders += borders_[t];
    const Star star = star_of(v, t);
    const double length = (mesh_.position(t) - mesh_.position(v)).norm();
    Plan plan;
    plan.position = position(v, t, place, star, borders, length);
    const Vector3d& p = plan.position;
    plan.owed = strips(borders(p), border_[v] + border_[t], area_[v] + area_[t]);
    if (is_textured_) {
      plan.owed += shifted_texture(p);
      // Along a seam that moves away, a strip shows the other side's texture.
      Quadric jumps = jumps_[v];
      jumps += jumps_[t];
      plan.owed += kStripDistance * integral(jumps(p), jump_[v] + jump_[t]);
    }
    plan.price = kSurfaceShare * integral(star.quadric(p), star.area) +
                 std::max(0.0, plan.owed - owed_[v] - owed_[t]) + spike(v, t, p) +
                 kShortEdgeWeight * (area_[v] + area_[t]) * length;
    plan.price *= std::max(importance(v), importance(t)) / num_edge_faces;
    return plan;
  }

  [[nodiscard]] double texture_factor() const {
    return options_.texture_weight * texture_length_ / texture_share_;
  }

  [[nodiscard]] Vector3d position(std::int32_t v, std::int32_t t, Place place, const Star& star,
                                  const Quadric& borders, double length) const {
    const Vector3d &first = mesh_.position(v), &second = mesh_.position(t);
    const Vector3d middle = 0.5 * (first + second);
    if (place == Place::kFirst || is_locked(v)) return first;
    if (place == Place::kSecond || is_locked(t)) return second;
    if (place == Place::kMiddle) return middle;
    LeastSquares squares;
    squares.add(star.quadric, 1.0);
    squares.add(borders, length);
    if (is_textured_) {
      const double weight = texture_factor() * texture_factor();
      for (const Textured& own : wedges_) squares.add(own.quadric, weight);
      squares.add(jumps_[v], 1.0);
      squares.add(jumps_[t], 1.0);
    }
    squares.add(middle, kTowardsMiddle * (area_[v] + area_[t]) + 1e-9 * length * length);
    const bool has_volume = star.normal.norm() > kLeastVolume * star.area;
    const Vector3d best =
        squares.solve(has_volume ? star.normal : Vector3d(Vector3d::Zero()), star.offset);
    return best.allFinite() ? best : middle;
  }

  /// What the planes of the faces around an edge do not tell of a place far away from it: where
  /// opposite sides of a thin part meet, a spike lies in all planes and keeps the volume. The new
  /// faces form a cone, whose mean distance is a third of that of its tip, and the tip is at least
  /// as far away as the box of the old faces.
  [[nodiscard]] double spike(std::int32_t v, std::int32_t t, const Vector3d& p) const {
    const Vector3d &first = mesh_.position(v), &second = mesh_.position(t);
    if ((p - 0.5 * (first + second)).squaredNorm() <= (second - first).squaredNorm()) return 0.0;
    Eigen::AlignedBox3d box;
    double area = 0.0;
    for (const std::int32_t from : {v, t}) {
      mesh_.for_each_face(from, [&](std::int32_t f, std::int32_t c) {
        const auto& face = mesh_.face(f);
        const Vector3d &a = mesh_.position(face[(c + 1) % 3]),
                       &b = mesh_.position(face[(c + 2) % 3]);
        for (const Vector3d& corner : {mesh_.position(from), a, b}) box.extend(corner);
        area += 0.5 * (a - p).cross(b - p).norm();
      });
    }
    return box.exteriorDistance(p) / 3.0 * area;
  }

  /// The price of a collapse among the last faces of a piece, measured: how much farther from its
  /// faces the original surface of the piece is afterwards on average, over its area. The planes
  /// around an edge do not tell: front and back of a shell can fold onto each other in all of them.
  [[nodiscard]] double lost_shape(std::int32_t v, std::int32_t t, const Vector3d& p) {
    gather_piece(t);
    const auto goes = [&](std::int32_t f) { return touches(f, v) && touches(f, t); };
    const auto moves = [&](std::int32_t f) { return touches(f, v) || touches(f, t); };
    const std::int32_t piece = pieces_.of_vertex(t);
    const std::vector<Vector3d> samples = pieces_.samples(piece);
    double farther = 0.0;
    for (const Vector3d& sample : samples) {
      const Vector3d point = mesh_.from_input(sample);
      double before = std::numeric_limits<double>::infinity(), after = before;
      for (const std::int32_t f : last_faces_) {
        Triangle3 corners;
        for (int c = 0; c < 3; ++c) corners[c] = mesh_.position(mesh_.face(f)[c]);
        const double now = distance(point, corners);
        before = std::min(before, now);
        if (goes(f)) continue;
        for (int c = 0; c < 3; ++c) {
          const std::int32_t corner = mesh_.face(f)[c];
          if (corner == v || corner == t) corners[c] = p;
        }
        after = std::min(after, moves(f) ? distance(point, corners) : now);
      }
      farther += after - before;
    }
    // Parts of a piece that hung together at one vertex can be apart by now: the last faces of such
    // a part have no others here that could stand for it.
    if (!std::isfinite(farther)) return 0.0;
    return pieces_.area(piece) * std::max(0.0, farther) / static_cast<double>(samples.size());
  }

  [[nodiscard]] bool touches(std::int32_t f, std::int32_t v) const {
    const auto& face = mesh_.face(f);
    return face[0] == v || face[1] == v || face[2] == v;
  }

  /// All faces that are left of the piece of a vertex, into last_faces_.
  void gather_piece(std::int32_t v) {
    last_faces_.clear();
    around_.assign(1, v);
    const auto add = [](std::vector<std::int32_t>& known, std::int32_t x) {
      if (std::find(known.begin(), known.end(), x) == known.end()) known.push_back(x);
    };
    for (std::size_t i = 0; i < around_.size(); ++i) {
      mesh_.for_each_face(around_[i], [&](std::int32_t f, std::int32_t) { add(last_faces_, f); });
      for (const std::int32_t f : last_faces_) {
        for (const std::int32_t corner : mesh_.face(f)) add(around_, corner);
      }
    }
  }

  // --- The queue -----------------------------------------------------------------------------

  void push_edge(std::int32_t v, std::int32_t t, std::int32_t num_faces) {
    if (is_locked(v) && is_locked(t)) return;
    const Plan best = plan(v, t, num_faces, Place::kBest);
    queue_.push({best.price, v, t, version_[v] + version_[t]});
  }

  void push_edges(std::int32_t v) {
    mesh_.gather_ring(v, ring_v_);
    keep_star(v);
    for (const RingEdge& edge : ring_v_.edges()) {
      push_edge(std::max(v, edge.vertex), std::min(v, edge.vertex), edge.num_faces);
    }
    center_ = -1;
  }

  void push_all_edges() {
    Ticker ticker(part_of(progress_, 0.1, 0.2));
    for (std::int32_t v = 0; v < mesh_.num_vertices(); ++v) {
      ticker.tick();
      if (mesh_.is_isolated(v)) continue;
      mesh_.gather_ring(v, ring_v_);
      keep_star(v);
      for (const RingEdge& edge : ring_v_.edges()) {
        if (edge.vertex < v) push_edge(v, edge.vertex, edge.num_faces);
      }
    }
    center_ = -1;
  }

  void push_piece(std::int32_t i) {
    if (guard_ || kept_pieces_.contains(i)) return;
    if (!pieces_.is_there(i) || !std::isfinite(pieces_.cost(i))) return;
    queue_.push({piece_price(i), i, -1, 0});
  }

  [[nodiscard]] double piece_price(std::int32_t i) const {
    const PieceBorders& own = piece_borders_[i];
    const double distance = pieces_.mean_distance(i);
    double price = kPieceFactor * pieces_.cost(i) +
                   strips(own.length * distance * distance, own.length, own.area);
    if (is_textured_) price += texture_factor() * pieces_.texture_shift(i) * pieces_.area(i);
    // Faces beyond the target are no gain.
    const std::int64_t needed =
        std::max<std::int64_t>(1, mesh_.num_faces() - options_.target_faces);
    return own.importance * price / static_cast<double>(std::min(pieces_.num_faces(i), needed));
  }

  /// Something else has become cheaper than what was on top.
  [[nodiscard]] bool is_overtaken(double price, double expected) const {
    return price > expected && !queue_.empty() && price > queue_.top().price;
  }

  /// Whether a collapse that the link condition forbids costs far less than the next legal one,
  /// whose error is large enough to be seen: a part with many holes, or small tubes, keeps them at
  /// the price of its shape otherwise.
  [[nodiscard]] bool is_forbidden_cheaper(double price) {
    if (rules_ != Rules::kAll) return false;
    if (price * static_cast<double>(mesh_.num_faces()) < kVisible * whole_area_) return false;
    while (!forbidden_.empty()) {
      const Entry& entry = forbidden_.top();
      if (version_[entry.a] + version_[entry.b] == entry.version && !mesh_.is_isolated(entry.a) &&
          !mesh_.is_isolated(entry.b)) {
        return price > kFarCheaper * entry.price;
      }
      forbidden_.pop();
    }
    return false;
  }

  bool relax_rules() {
    const bool error_limit = count(Rejection::kErrorLimit) > 0;
    if (options_.target_faces == 0 || error_limit || guard_ || rules_ == Rules::kFlips) {
      return false;
    }
    rules_ = rules_ == Rules::kAll ? Rules::kAnyEdges : Rules::kFlips;
    return true;
  }

  void try_edge(const Entry& entry) {
    const std::int32_t v = entry.a, t = entry.b;
    if (version_[v] + version_[t] != entry.version) return;
    if (mesh_.is_isolated(v) || mesh_.is_isolated(t)) return;
    mesh_.gather_ring(v, ring_v_);
    mesh_.gather_ring(t, ring_t_);
    const RingEdge* edge = ring_v_.find(t);
    if (edge == nullptr) return;
    if (faces_left(t) <= edge->num_faces) return refuse(v, t, Rejection::kDegenerate);
    if (breaks_link(v, t)) {
      if (rules_ == Rules::kAll) forbidden_.push(entry);
      return refuse(v, t, Rejection::kLink);
    }
    if (takes_last_face_of_locked(v, t)) return refuse(v, t, Rejection::kDegenerate);
    Plan best = plan(v, t, edge->num_faces, Place::kBest);
    std::optional<Rejection> refusal = check_faces(v, t, best.position);
    if (refusal) {
      const Rejection reason = *refusal;
      for (const Place place : {Place::kFirst, Place::kSecond, Place::kMiddle}) {
        const Plan other = plan(v, t, edge->num_faces, place);
        if (!refusal && !(other.price < best.price)) continue;
        if (check_faces(v, t, other.position)) continue;
        best = other;
        refusal.reset();
      }
      if (refusal) return refuse(v, t, reason);
    }
    if (pieces_.size() > 0 && faces_left(t) <= kLastFaces) {
      const double weight = std::max(importance(v), importance(t)) / edge->num_faces;
      best.price = std::max(best.price, weight * lost_shape(v, t, best.position));
    }
    if (is_overtaken(best.price, entry.price)) {
      queue_.push({best.price, v, t, entry.version});
      return;
    }
    const double error = mesh_.scale() * error_of(v, t, best.position);
    if (error > options_.max_error) return refuse(v, t, Rejection::kErrorLimit);
    // A proof that failed fails again while nothing changes.
    if (refused_.contains({v, t})) return refuse(v, t, Rejection::kDistanceLimit);
    if (guard_ && !keeps_distance({v, t}, best.position)) {
      if (refused_.size() < kMostRefused) refused_.insert({v, t});
      return refuse(v, t, Rejection::kDistanceLimit);
    }
    refused_.clear();
    collapse(v, t, best);
    result_.max_error = std::max(result_.max_error, error);
    if (rules_ != Rules::kAll) ++result_.relaxed_collapses;
  }

  /// Root mean square distance to the planes of the original faces, or to those of the borders.
  [[nodiscard]] double error_of(std::int32_t v, std::int32_t t, const Vector3d& p) const {
    const auto mean = [](double squares, double weight) {
      return weight > 0.0 ? std::max(0.0, squares) / weight : 0.0;
    };
    return std::sqrt(std::max(mean(surface_[v](p) + surface_[t](p), area_[v] + area_[t]),
                              mean(borders_[v](p) + borders_[t](p), border_[v] + border_[t])));
  }

  /// Whether all vertices of `moving` may go to p; if so, the guard takes it as done.
  [[nodiscard]] bool keeps_distance(std::initializer_list<std::int32_t> moving, const Vector3d& p) {
    touched_.clear();
    changed_.clear();
    around_.clear();
    const auto moves = [&](std::int32_t v) {
      return std::find(moving.begin(), moving.end(), v) != moving.end();
    };
    const auto sort_out = [](std::vector<std::int32_t>& faces) {
      std::sort(faces.begin(), faces.end());
      faces.erase(std::unique(faces.begin(), faces.end()), faces.end());
    };
    for (const std::int32_t v : moving) {
      mesh_.for_each_face(v, [&](std::int32_t f, std::int32_t) { touched_.push_back(f); });
    }
    sort_out(touched_);
    for (const std::int32_t f : touched_) {
      const auto& face = mesh_.face(f);
      DistanceGuard::Change change{f, {}};
      for (int c = 0; c < 3; ++c) {
        change.corners[c] = mesh_.to_input(moves(face[c]) ? p : mesh_.position(face[c]));
        if (moves(face[c])) continue;
        mesh_.for_each_face(face[c], [&](std::int32_t g, std::int32_t) {
          if (!std::binary_search(touched_.begin(), touched_.end(), g)) around_.push_back(g);
        });
      }
      if (std::count_if(face.begin(), face.end(), moves) == 1) changed_.push_back(change);
    }
    sort_out(around_);
    if (!guard_->allows(touched_, changed_, around_)) return false;
    guard_->commit();
    return true;
  }

  [[nodiscard]] std::int64_t& count(Rejection reason) {
    return result_.rejected[static_cast<std::size_t>(reason)];
  }

  void refuse(std::int32_t v, std::int32_t t, Rejection reason) {
    ++count(reason);
    blocked_[v] = blocked_[t] = true;  // to be tried again when something near them changes
  }

  // --- What is legal -------------------------------------------------------------------------
  //
  // The rules are those of collapse_rules.hpp.

  /// Number of faces left of the piece with this vertex: only try_piece() takes the last ones.
  [[nodiscard]] std::int64_t faces_left(std::int32_t v) const {
    return pieces_.size() > 0 ? pieces_.num_faces(pieces_.of_vertex(v)) : mesh_.num_faces();
  }

  /// Whether v or t, whose rings were gathered, has an edge of three faces or more.
  [[nodiscard]] bool has_complex_edge() const {
    const auto has_one = [](const Ring& ring) {
      return std::any_of(ring.edges().begin(), ring.edges().end(),
                         [](const RingEdge& edge) { return is_complex_edge(edge.num_faces); });
    };
    return has_one(ring_v_) || has_one(ring_t_);
  }

  /// The guard of max_distance knows nothing of faces that go because they double others.
  [[nodiscard]] bool may_double() const {
    return may_double_faces(rules_, !guard_ && has_complex_edge());
  }

  [[nodiscard]] bool breaks_link(std::int32_t v, std::int32_t t) const {
    if (may_make_complex_edge(rules_, has_complex_edge())) return false;
    return std::any_of(ring_v_.edges().begin(), ring_v_.edges().end(), [&](const RingEdge& edge) {
      const RingEdge* other = ring_t_.find(edge.vertex);
      return other != nullptr &&
             makes_complex_edge(edge.num_faces, other->num_faces, count_faces(v, edge.vertex, t));
    });
  }

  [[nodiscard]] bool is_locked(std::int32_t v) const {
    return !is_locked_.empty() && is_locked_[v];
  }

  [[nodiscard]] double importance(std::int32_t v) const {
    return importance_.empty() ? 1.0 : importance_[v];
  }

  /// Whether a locked vertex has no faces but those on the edge, which go.
  [[nodiscard]] bool takes_last_face_of_locked(std::int32_t v, std::int32_t t) const {
    if (is_locked_.empty()) return false;
    const auto num_faces = [&](std::int32_t of) {
      std::int32_t faces = 0;
      mesh_.for_each_face(of, [&](std::int32_t, std::int32_t) { ++faces; });
      return faces;
    };
    if (is_locked(v) || is_locked(t)) {
      const std::int32_t on_edge = ring_v_.find(t)->num_faces;
      if (num_faces(v) + num_faces(t) == 2 * on_edge) return true;
    }
    return std::any_of(ring_v_.edges().begin(), ring_v_.edges().end(), [&](const RingEdge& edge) {
      const std::int32_t w = edge.vertex;
      return w != t && is_locked(w) && num_faces(w) == count_faces(w, v, t);
    });
  }

  [[nodiscard]] std::int32_t count_faces(std::int32_t w, std::int32_t a, std::int32_t b) const {
    std::int32_t faces = 0;
    mesh_.for_each_face(w, [&](std::int32_t f, std::int32_t) {
      const auto& face = mesh_.face(f);
      const auto has = [&](std::int32_t x) { return face[0] == x || face[1] == x || face[2] == x; };
      faces += has(a) && has(b) ? 1 : 0;
    });
    return faces;
  }

  [[nodiscard]] std::optional<Rejection> check_faces(std::int32_t v, std::int32_t t,
                                                     const Vector3d& p) const {
    std::optional<Rejection> refusal;
    const auto check = [&](std::int32_t from, std::int32_t other) {
      mesh_.for_each_face(from, [&](std::int32_t f, std::int32_t c) {
        const std::int32_t a = mesh_.face(f)[(c + 1) % 3], b = mesh_.face(f)[(c + 2) % 3];
        if (refusal || a == other || b == other) return;  // those on the edge go
        refusal = check_face(from, a, b, p);
        const bool meets = from == v && ring_t_.find(a) != nullptr && ring_t_.find(b) != nullptr;
        const bool is_forbidden = meets && !may_double();
        if (!refusal && is_forbidden && count_faces(t, a, b) > 0) refusal = Rejection::kDuplicate;
      });
    };
    check(v, t);
    check(t, v);
    return refusal;
  }

  /// The face (from, a, b) when its first vertex is at p.
  [[nodiscard]] std::optional<Rejection> check_face(std::int32_t from, std::int32_t a,
                                                    std::int32_t b, const Vector3d& p) const {
    const Vector3d &pa = mesh_.position(a), &pb = mesh_.position(b), &old = mesh_.position(from);
    const Vector3d before = (pa - old).cross(pb - old), after = (pa - p).cross(pb - p);
    const double longest =
        std::max({(pa - p).squaredNorm(), (pb - p).squaredNorm(), (pb - pa).squaredNorm()});
    if (!(after.norm() > kLeastSine * longest)) return Rejection::kDegenerate;
    if (may_turn_faces(rules_) || !(before.squaredNorm() > 0.0)) return std::nullopt;
    if (!(before.dot(after) > kLeastNormalCosine * before.norm() * after.norm())) {
      return Rejection::kFlip;
    }
    return std::nullopt;
  }

  // --- Steps ---------------------------------------------------------------------------------

  void collapse(std::int32_t v, std::int32_t t, const Plan& plan) {
    neighbours_.clear();
    for (const Ring* ring : {&ring_v_, &ring_t_}) {
      for (const RingEdge& edge : ring->edges()) neighbours_.push_back(edge.vertex);
    }
    if (is_textured_) {
      gather_wedges(v, t);
      set_texture(v, t, plan.position);
    } else {
      map_wedges(v, t);
    }
    if (!colors_.empty()) colors_[t] = color_at(v, t, plan.position);
    const bool is_doubling = may_double();
    if (is_doubling) find_twins(v, t);
    const std::int64_t before = mesh_.num_faces();
    mesh_.collapse(v, t, map_);
    mesh_.move(t, plan.position);
    if (is_doubling) remove_duplicates(t);
    part_[t].extend(part_[v]);
    surface_[t] += surface_[v];
    borders_[t] += borders_[v];
    if (is_textured_) {
      jumps_[t] += jumps_[v];
      jump_[t] += jump_[v];
    }
    area_[t] += area_[v];
    border_[t] += border_[v];
    owed_[t] = plan.owed;
    if (is_locked(v)) is_locked_[t] = true;
    if (!importance_.empty()) importance_[t] = std::max(importance_[v], importance_[t]);
    into_[v] = t;
    ++version_[t];
    if (pieces_.size() > 0) {
      pieces_.remove_faces(pieces_.of_vertex(t), before - mesh_.num_faces());
    }
    if (!mesh_.is_isolated(t)) push_edges(t);
    for (const std::int32_t w : neighbours_) {
      if (mesh_.is_isolated(w)) part_[t].extend(part_[w]);
      if (w == t || !blocked_[w] || mesh_.is_isolated(w)) continue;
      blocked_[w] = false;
      push_edges(w);
    }
  }

  /// The faces of v and those of t that lie back to back.
  void find_twins(std::int32_t v, std::int32_t t) {
    twins_.clear();
    for (const std::int32_t from : {v, t}) {
      sides_.clear();
      mesh_.for_each_face(from, [&](std::int32_t f, std::int32_t c) {
        sides_.push_back({mesh_.face(f)[(c + 1) % 3], mesh_.face(f)[(c + 2) % 3]});
      });
      append_twins(sides_, twins_);
    }
    std::sort(twins_.begin(), twins_.end());
  }

  /// Among faces on the same three vertices, the first one of t's list stays; of twins, the first
  /// one on each side.
  void remove_duplicates(std::int32_t t) {
    keys_.clear();
    mesh_.for_each_face(t, [&](std::int32_t f, std::int32_t c) {
      const Side side{mesh_.face(f)[(c + 1) % 3], mesh_.face(f)[(c + 2) % 3]};
      keys_.emplace_back(double_key(side, twins_), f);
    });
    std::stable_sort(keys_.begin(), keys_.end(),
                     [](const auto& a, const auto& b) { return a.first < b.first; });
    doubled_.clear();
    for (std::size_t i = 1; i < keys_.size(); ++i) {
      if (keys_[i].first == keys_[i - 1].first) doubled_.push_back(keys_[i].second);
    }
    for (const std::int32_t f : doubled_) mesh_.remove_face(f);
  }

  /// The best texture coordinate of each wedge, within those around it: a linear continuation of
  /// a narrow face can be anywhere.
  void set_texture(std::int32_t v, std::int32_t t, const Vector3d& p) {
    uvs_.clear();
    for (const auto& [wedge, quadric, stays] : wedges_) {
      texture_[wedge] = quadric;
      if (const auto from = locked_wedge(v, t, wedge)) {
        uvs_.emplace_back(wedge, mesh_.uv(*from));
        continue;
      }
      if (!(quadric.weight > 0.0)) continue;
      Vector2d low = Vector2d::Constant(std::numeric_limits<double>::infinity()), high = -low;
      for (const std::int32_t from : {v, t}) {
        mesh_.for_each_face(from, [&](std::int32_t f, std::int32_t c) {
          const auto& corners = mesh_.wedges(f);
          if ((from == v ? map_.at(corners[c]) : corners[c]) != wedge) return;
          for (const std::int32_t corner : corners) {
            low = low.cwiseMin(mesh_.uv(corner));
            high = high.cwiseMax(mesh_.uv(corner));
          }
        });
      }
      uvs_.emplace_back(wedge, quadric.best(p).cwiseMax(low).cwiseMin(high));
    }
    for (const auto& [wedge, uv] : uvs_) mesh_.set_uv(wedge, uv);
  }

  /// The wedge of the locked one of v and t that becomes this wedge, or is it.
  [[nodiscard]] std::optional<std::int32_t> locked_wedge(std::int32_t v, std::int32_t t,
                                                         std::int32_t wedge) const {
    std::optional<std::int32_t> found;
    if (is_locked(v)) {
      for (const WedgeMap::Pair& pair : map_.pairs) {
        if (pair.to == wedge && mesh_.has_texture(pair.from)) found = pair.from;
      }
    } else if (is_locked(t)) {
      mesh_.for_each_face(t, [&](std::int32_t f, std::int32_t c) {
        if (mesh_.wedges(f)[c] == wedge) found = wedge;
      });
    }
    return found;
  }

  /// Between the colours of v and t, as p lies between them.
  [[nodiscard]] Vector3d color_at(std::int32_t v, std::int32_t t, const Vector3d& p) const {
    const Vector3d edge = mesh_.position(t) - mesh_.position(v);
    const double squared = edge.squaredNorm();
    const double share =
        squared > 0.0 ? std::clamp((p - mesh_.position(v)).dot(edge) / squared, 0.0, 1.0) : 1.0;
    return (1.0 - share) * colors_[v] + share * colors_[t];
  }

  void try_piece(const Entry& entry) {
    const std::int32_t i = entry.a;
    if (!pieces_.is_there(i)) return;
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

  /// Moves a vertex by a vector that brings an area nearer to the original, if that is legal. One
  /// for which nothing is owed yet stays in the planes of its borders: beside a texture that has
  /// kept its place exactly, other faces would pull it away.
  void move_to_fit(std::int32_t v, const Vector3d& by, double area) {
    if (is_locked(v) || !(by.squaredNorm() > 0.0)) return;
    Vector3d step = by;
    if (border_[v] > 0.0 && owed_[v] <= kOwesNothing * area_[v]) {
      const Quadric& q = borders_[v];
      Eigen::Matrix3d planes;
      planes << q.xx, q.xy, q.xz, q.xy, q.yy, q.yz, q.xz, q.yz, q.zz;
      planes *= kHeldFirmly * std::sqrt(area);
      planes.diagonal().array() += area;
      step = planes.llt().solve(area * by);
    }
    move_if_legal(v, mesh_.position(v) + step);
  }

  void move_if_legal(std::int32_t v, const Vector3d& p) {
    bool fits = p.allFinite();
    mesh_.for_each_face(v, [&](std::int32_t f, std::int32_t c) {
      const auto& face = mesh_.face(f);
      fits = fits && !check_face(v, face[(c + 1) % 3], face[(c + 2) % 3], p);
    });
    if (fits && (!guard_ || keeps_distance({v}, p))) mesh_.move(v, p);
  }

  /// The point of a box, widened by a share of its diagonal, that is nearest to p.
  template <typename Point, typename Box>
  static Point within(const Box& box, double reach, const Point& p) {
    const Point margin = Point::Constant(reach * box.diagonal().norm());
    return p.cwiseMax(box.min() - margin).cwiseMin(box.max() + margin);
  }

  /// Vertices lie where the volume is kept, which can be far away from all that they stand for.
  void pull_back_spikes() {
    for (std::int32_t v = 0; v < mesh_.num_vertices(); ++v) {
      if (mesh_.is_isolated(v) || is_locked(v)) continue;
      const Vector3d p = within(part_[v], kReach, mesh_.position(v));
      if (p != mesh_.position(v)) move_if_legal(v, p);
    }
  }

  // --- The result ----------------------------------------------------------------------------

  QualityResult finish() {
    if (mesh_.num_faces() > 0 && mesh_.any_moved()) fit_to_input();
    result_.stop = why_it_stopped();
    if (guard_) result_.distance_bound = guard_->bound();
    result_.dropped_faces = mesh_.num_dropped();
    extract();
    return std::move(result_);
  }

  /// Moves the vertices, and after them the texture coordinates, nearer to the input's.
  void fit_to_input() {
    Progress tell;
    if (progress_) {
      tell = [this](double fraction) {
        fraction_ = fraction;
        progress_(fraction);
      };
    }
    queue_ = {};  // room for the fit
    forbidden_ = {};
    pull_back_spikes();
    SurfaceFit fit(input_, [this](std::int32_t v) {
      return pieces_.size() == 0 || pieces_.is_there(pieces_.of_vertex(v));
    });
    const double end = is_textured_ ? 0.95 : guard_ ? 0.99 : 1.0;
    fit.run(
        mesh_,
        [this](std::int32_t v, const Vector3d& by, double area) { move_to_fit(v, by, area); },
        part_of(tell, 0.8, end));
    if (!is_textured_) return;
    const auto may_change = [&](std::int32_t v) { return !is_locked(v); };
    const auto set_texture = [&](std::int32_t wedge, const Vector2d& uv) {
      mesh_.set_uv(wedge, within(chart_box_[chart_[wedge]], kTextureReach, uv));
    };
    fit.fit_texture(mesh_, chart_, may_change, set_texture, part_of(progress_, 0.95, 1.0));
  }

  [[nodiscard]] CollapseStop why_it_stopped() {
    if (mesh_.num_faces() <= options_.target_faces) return CollapseStop::kTargetReached;
    if (count(Rejection::kErrorLimit) > 0) return CollapseStop::kErrorLimit;
    if (count(Rejection::kDistanceLimit) > 0) return CollapseStop::kDistanceLimit;
    return CollapseStop::kNoLegalCollapse;
  }

  /// The mesh of what is left, and where the input's vertices and faces went.
  void extract() {
    std::vector<std::int32_t> kept;
    result_.mesh = mesh_.extract(input_, kept, result_.vertex_map, result_.face_map);
    for (std::size_t i = 0; i < kept.size() && !colors_.empty(); ++i) {
      const Vector3d rounded = (colors_[kept[i]].array() + 0.5).floor();
      result_.mesh.colors.row(static_cast<Eigen::Index>(i)) =
          rounded.cast<std::uint8_t>().transpose();
    }
    for (std::int32_t v = 0; v < mesh_.num_vertices(); ++v) {
      std::int32_t end = v;
      while (into_[end] >= 0) end = into_[end];
      result_.vertex_map[v] = result_.vertex_map[end];
    }
    // Computed in other units, a locked place may be off by rounding.
    for (std::size_t v = 0; v < options_.locked.size(); ++v) {
      const std::int32_t row = result_.vertex_map[v];
      if (options_.locked[v] && row >= 0) {
        result_.mesh.vertices.row(row) = input_.vertices.row(static_cast<Eigen::Index>(v));
      }
    }
  }

  const MeshView& input_;
  const QualityOptions& options_;
  const Progress& progress_;
  CollapseMesh mesh_;
  Pieces pieces_;
  Ring ring_v_, ring_t_;
  std::vector<Quadric> surface_;           // of a vertex: the original faces it stands for
  std::vector<Quadric> borders_;           // of a vertex: the boundaries and seams
  std::vector<Quadric> jumps_;             // of a vertex: the seams, weighted by what they show
  std::vector<double> jump_;               // of a vertex: weighted length of those seams
  std::vector<AttributeQuadric> texture_;  // of a wedge
  std::vector<Eigen::AlignedBox3d> part_;  // of a vertex: the box of those faces
  std::vector<double> area_;               // of a vertex: of those faces
  double whole_area_ = 0.0;                // of all of them
  std::vector<double> border_;             // of a vertex: weighted length of those borders
  std::vector<double> owed_;               // of a vertex: Plan::owed of the collapses so far
  std::vector<std::uint32_t> version_;     // of a vertex: how often it moved
  std::vector<bool> blocked_;              // vertices with an edge that was refused
  std::vector<std::int32_t> into_;         // what a vertex collapsed onto, or -1
  std::vector<Vector3d> colors_;           // of a vertex; empty: none
  std::vector<bool> is_locked_;            // of a vertex; empty: none
  std::vector<double> importance_;         // of a vertex; empty: all 1
  std::vector<PieceBorders> piece_borders_;
  std::set<std::int32_t> kept_pieces_;  // those with a locked vertex
  bool is_textured_;
  std::vector<std::int32_t> chart_;             // of a wedge
  std::vector<Eigen::AlignedBox2d> chart_box_;  // of a chart: its original texture coordinates
  double texture_length_ = 0.0;                 // on the surface, of a unit of texture
  double texture_share_ = 1.0;                  // of the area: what shows a texture
  std::int32_t center_ = -1;                    // the vertex whose edges are being priced, or -1
  Star center_star_;
  std::vector<StarFace> center_faces_;
  FlatHeap<Entry> queue_, forbidden_;
  Rules rules_ = Rules::kAll;
  std::optional<DistanceGuard> guard_;  // of max_distance
  // Edges that the guard refused since the last collapse: one with two blocked ends is queued
  // twice.
  std::set<std::pair<std::int32_t, std::int32_t>> refused_;
  double fraction_ = 0.2;  // of the work that was last reported
  std::vector<std::int32_t> touched_, around_, last_faces_;
  std::vector<DistanceGuard::Change> changed_;
  WedgeMap map_;
  std::vector<Textured> wedges_;
  std::vector<std::pair<std::int32_t, Vector2d>> uvs_;
  std::vector<std::int32_t> neighbours_;
  std::vector<std::int32_t> doubled_;
  std::vector<std::pair<Side, std::int32_t>> keys_;
  std::vector<Side> sides_, twins_;  // in a collapse: of faces, and of those back to back
  QualityResult result_;
};

void check_options(const MeshView& mesh, const QualityOptions& options) {
  const auto check = [](const char* name, double value, bool may_be_infinite) {
    if (value >= 0.0 && (may_be_infinite || std::isfinite(value))) return;
    throw InputError(std::string(name) + ": expected a number >= 0, got " + std::to_string(value));
  };
  check("target_faces", static_cast<double>(options.target_faces), false);
  check("max_error", options.max_error, true);
  if (!(options.max_distance > 0.0)) {
    throw InputError("max_distance: expected a number > 0, got " +
                     std::to_string(options.max_distance) +
                     " (the published methods take 0: exactly coplanar collapses)");
  }
  check("boundary_weight", options.boundary_weight, false);
  check("seam_weight", options.seam_weight, false);
  check("texture_weight", options.texture_weight, false);
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
    throw InputError("importance: expected numbers > 0, got " + std::to_string(value) +
                     " at vertex " + std::to_string(v));
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
  QualityResult result = QualitySimplifier(usual.mesh(), in_unit, progress).run();
  usual.to_file(result.mesh.vertices);
  result.max_error = usual.to_file(result.max_error);
  if (result.distance_bound) result.distance_bound = usual.to_file(*result.distance_bound);
  return result;
}

}  // namespace manip3d
