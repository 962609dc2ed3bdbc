#include "simplify/quality_price.hpp"

#include <algorithm>
#include <array>
#include <limits>
#include <span>

#include "manip3d/geometry/patch_distance.hpp"

namespace manip3d::quality_detail {
namespace {

/// Weight of a pull of the new vertex to the middle of its edge, added to the quadrics. It matters
/// only where they have no unique minimum. (On RockerArm, 1e-3 raises the error by 5 %, 1e-6 not at
/// all, but vertices then wander.)
constexpr double kTowardsMiddle = 1e-5;

/// Share of the edge's length. If kTowardsMiddle moves a vertex off the planes in which it should
/// lie by at most this (1e-5 at a crease, more at needles, where it is the whole error of flat
/// parts), the move is undone. If by more, the surface is almost flat there and the pull decides.
constexpr double kOffPlanes = 1e-2;

/// On flat regions every price is rounding noise; with this share, short edges collapse first
/// there.
constexpr double kShortEdgePreference = 1e-5;

/// Factor on the price of the faces around an edge. They are counted fully for each edge, while a
/// price should count each face once. Measured on the models with many parts; with 1, pieces vanish
/// too early.
constexpr double kSurfaceShare = 0.2;

/// Factor on the price of removing a piece, which is more obvious than its distance suggests.
constexpr double kPieceFactor = 2.0;

/// If the sum of the area vectors around an edge is shorter than this share of the sum of their
/// lengths, it is rounding noise, as where front and back of a sheet cancel. The volume then gives
/// no condition on the new vertex.
constexpr double kMinVolume = 1e-6;

/// Weights of the corners, the midpoints of the edges and the centroid of a triangle in a
/// quadrature that is exact for cubic polynomials.
constexpr double kCornerWeight = 1.0 / 20.0, kMiddleWeight = 2.0 / 15.0, kCentreWeight = 9.0 / 20.0;

/// Mean distance of the points of a triangle from the nearest of some points.
double mean_distance(const Triangle3& corners, std::span<const Vector3d> from) {
  const auto nearest = [&](const Vector3d& point) {
    double least = std::numeric_limits<double>::infinity();
    for (const Vector3d& other : from) least = std::min(least, (point - other).norm());
    return least;
  };
  double mean = kCentreWeight * nearest((corners[0] + corners[1] + corners[2]) / 3.0);
  for (std::size_t c = 0; c < 3; ++c) {
    mean += kCornerWeight * nearest(corners[c]);
    mean += kMiddleWeight * nearest(0.5 * (corners[c] + corners[(c + 1) % 3]));
  }
  return mean;
}

/// Whether a face has the edge v a, but not the vertex t.
bool has_face_without(const CollapseMesh& mesh, std::int32_t v, std::int32_t a, std::int32_t t) {
  bool has_one = false;
  mesh.for_each_face_between(v, a,
                             [&](std::int32_t f) { has_one = has_one || !touches(mesh, f, t); });
  return has_one;
}

/// Whether a has faces that do not have both v and t.
bool has_faces_beside(const CollapseMesh& mesh, std::int32_t a, std::int32_t v, std::int32_t t) {
  bool has_one = false;
  mesh.for_each_face(a, [&](std::int32_t f, std::int32_t) {
    has_one = has_one || !touches(mesh, f, v) || !touches(mesh, f, t);
  });
  return has_one;
}

}  // namespace

void JoinedWedges::gather(std::int32_t v, std::int32_t t) {
  map_wedges(v, t);
  if (original_.is_textured) gather_textured(v, t);
}

void JoinedWedges::map_wedges(std::int32_t v, std::int32_t t) {
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

void JoinedWedges::gather_textured(std::int32_t v, std::int32_t t) {
  textured_.clear();
  const auto find = [&](std::int32_t wedge) {
    return std::find_if(textured_.begin(), textured_.end(),
                        [&](const Textured& known) { return known.wedge == wedge; });
  };
  mesh_.for_each_face(t, [&](std::int32_t f, std::int32_t c) {
    const std::int32_t wedge = mesh_.wedges(f)[c];
    if (!mesh_.has_texture(wedge)) return;
    auto known = find(wedge);
    if (known == textured_.end()) {
      known = textured_.insert(known, {wedge, original_.texture[wedge]});
    }
    if (!touches(mesh_, f, v)) known->stays = true;
  });
  for (const WedgeMap::Pair& pair : map_.pairs) {
    if (!mesh_.has_texture(pair.from)) continue;
    const auto known = find(pair.to);
    if (known == textured_.end()) {
      textured_.push_back({pair.to, original_.texture[pair.from]});
    } else {
      known->quadric += original_.texture[pair.from];
    }
  }
  mesh_.for_each_face(v, [&](std::int32_t f, std::int32_t c) {
    const std::int32_t wedge = mesh_.wedges(f)[c];
    if (mesh_.has_texture(wedge) && !touches(mesh_, f, t)) find(map_.at(wedge))->stays = true;
  });
}

double JoinedWedges::price(const Vector3d& p) const {
  double price = 0.0;
  for (const Textured& own : textured_) {
    if (!(own.quadric.weight > 0.0)) continue;
    double squares = own.quadric(p);
    if (!own.stays) {
      double least = std::numeric_limits<double>::infinity();
      const Vector2d meant = own.quadric.best(p);
      for (const Textured& other : textured_) {
        if (!other.stays || !(other.quadric.weight > 0.0)) continue;
        if (mesh_.surface(other.wedge) != mesh_.surface(own.wedge)) continue;
        least = std::min(least, (other.quadric.best(p) - meant).squaredNorm());
      }
      if (std::isfinite(least)) squares += own.quadric.weight * least;
    }
    price += original_.texture_factor() * integral(squares, own.quadric.weight);
  }
  return price;
}

Prices::Prices(const CollapseMesh& mesh, const Original& original, const Kept& kept,
               const Pieces& pieces)
    : mesh_(mesh), original_(original), kept_(kept), pieces_(pieces), wedges_(mesh, original) {
  for (std::int32_t i = 0; i < pieces.size(); ++i) {
    PieceBorders& own = piece_borders_.emplace_back();
    for (const std::int32_t v : pieces.vertices(i)) {
      own.length += original.border[v];
      own.area += original.area[v];
      own.importance = std::max(own.importance, kept.importance(v));
    }
  }
}

void Prices::begin_edges(std::int32_t v) {
  center_ = v;
  center_star_ = {};
  center_faces_.clear();
  mesh_.for_each_face(v, [&](std::int32_t f, std::int32_t) {
    center_faces_.push_back(star_face(f, mesh_.position(v)));
    center_faces_.back().add_to(center_star_);
  });
}

Prices::StarFace Prices::star_face(std::int32_t f, const Vector3d& p) const {
  const Vector3d normal = area_vector(mesh_, f);
  const double length = normal.norm();
  StarFace face{normal, normal.dot(p), 0.5 * length, {}};
  if (length > 0.0) face.quadric = Quadric::plane(normal / length, p, 0.5 * length);
  return face;
}

Prices::Star Prices::star_of(std::int32_t v, std::int32_t t) const {
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

Plan Prices::plan(std::int32_t v, std::int32_t t, std::int32_t num_edge_faces, Place place) {
  if (original_.is_textured) wedges_.gather(v, t);
  Quadric borders = original_.borders[v];
  borders += original_.borders[t];
  const Star star = star_of(v, t);
  const double length = (mesh_.position(t) - mesh_.position(v)).norm();
  const double area = original_.area[v] + original_.area[t];
  Plan plan;
  plan.position = position(v, t, place, star, borders, length);
  const Vector3d& p = plan.position;
  plan.attribute_price =
      original_.strips(borders(p), original_.border[v] + original_.border[t], area);
  if (original_.is_textured) {
    plan.attribute_price += wedges_.price(p) + original_.wrong_side(v, t, p);
  }
  if (original_.is_colored) plan.attribute_price += original_.wrong_color(v, t, p);
  plan.price = kSurfaceShare * integral(star.quadric(p), star.area) +
               std::max(0.0, plan.attribute_price - original_.attribute_price[v] -
                                 original_.attribute_price[t]) +
               spike(v, t, p) + kShortEdgePreference * area * length;
  plan.price *= std::max(kept_.importance(v), kept_.importance(t)) / num_edge_faces;
  return plan;
}

Vector3d Prices::position(std::int32_t v, std::int32_t t, Place place, const Star& star,
                          const Quadric& borders, double length) const {
  const Vector3d &first = mesh_.position(v), &second = mesh_.position(t);
  const Vector3d middle = 0.5 * (first + second);
  if (kept_.is_locked(v)) return first;
  if (kept_.is_locked(t)) return second;  // whatever the place: extract() puts it there
  if (place == Place::kFirst) return first;
  if (place == Place::kSecond) return second;
  if (place == Place::kMiddle) return middle;
  LeastSquares squares;
  squares.add(star.quadric, 1.0);
  squares.add(borders, length);
  if (original_.is_textured) {
    const double weight = original_.texture_factor() * original_.texture_factor();
    for (const Textured& own : wedges_.textured()) squares.add(own.quadric, weight);
    squares.add(original_.jumps[v], 1.0);
    squares.add(original_.jumps[t], 1.0);
  }
  if (original_.is_colored) {
    squares.add(original_.joined_colors(v, t), original_.color_factor() * original_.color_factor());
  }
  const double pull =
      kTowardsMiddle * (original_.area[v] + original_.area[t]) + 1e-9 * length * length;
  const bool has_volume = star.normal.norm() > kMinVolume * star.area;
  const Vector3d best =
      squares.solve(middle, pull, kOffPlanes * length,
                    has_volume ? star.normal : Vector3d(Vector3d::Zero()), star.offset);
  return best.allFinite() ? best : middle;
}

/// Price of a position far away from the edge, which the planes of the faces around do not show:
/// where opposite sides of a thin part meet, a spike is in all planes and preserves the volume. The
/// new faces form a cone, whose mean distance is a third of that of its tip; the distance of the
/// tip is at least that from the box of the old faces.
double Prices::spike(std::int32_t v, std::int32_t t, const Vector3d& p) const {
  const Vector3d &first = mesh_.position(v), &second = mesh_.position(t);
  if ((p - 0.5 * (first + second)).squaredNorm() <= (second - first).squaredNorm()) return 0.0;
  Eigen::AlignedBox3d box;
  double area = 0.0;
  for (const std::int32_t from : {v, t}) {
    mesh_.for_each_face(from, [&](std::int32_t f, std::int32_t c) {
      const auto& face = mesh_.face(f);
      const Vector3d &a = mesh_.position(face[(c + 1) % 3]), &b = mesh_.position(face[(c + 2) % 3]);
      for (const Vector3d& corner : {mesh_.position(from), a, b}) box.extend(corner);
      area += 0.5 * (a - p).cross(b - p).norm();
    });
  }
  return box.exteriorDistance(p) / 3.0 * area;
}

double Prices::lost_shape(std::int32_t v, std::int32_t t, const Vector3d& p) {
  gather_piece(t);
  const auto goes = [&](std::int32_t f) { return touches(mesh_, f, v) && touches(mesh_, f, t); };
  const auto moves = [&](std::int32_t f) { return touches(mesh_, f, v) || touches(mesh_, f, t); };
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
  // Parts of a piece that were connected only at one vertex may be separate by now. When the last
  // faces of such a part vanish, no other faces represent it here.
  if (!std::isfinite(farther)) return 0.0;
  return pieces_.area(piece) * std::max(0.0, farther) / static_cast<double>(samples.size());
}

double Prices::lost_strip(std::int32_t v, std::int32_t t, const Vector3d& p) const {
  double lost = 0.0;
  mesh_.for_each_face_between(v, t, [&](std::int32_t f) {
    const auto& face = mesh_.face(f);
    const std::int32_t tip = *std::ranges::find_if(
        face, [&](std::int32_t corner) { return corner != v && corner != t; });
    if (has_face_without(mesh_, v, tip, t) || has_face_without(mesh_, t, tip, v)) return;
    Triangle3 corners;
    for (std::size_t c = 0; c < 3; ++c) corners[c] = mesh_.position(face[c]);
    // The faces around the new vertex and around the tip stay near.
    std::array<Vector3d, 2> left{p, mesh_.position(tip)};
    const bool has_tip = has_faces_beside(mesh_, tip, v, t);
    const bool has_new =
        !has_tip || has_faces_beside(mesh_, v, v, t) || has_faces_beside(mesh_, t, v, t);
    const std::span<const Vector3d> both(left);
    lost += 0.5 * area_vector(mesh_, f).norm() *
            mean_distance(corners, both.subspan(has_new ? 0 : 1, has_new && has_tip ? 2 : 1));
  });
  return lost;
}

/// Gathers all remaining faces of the piece of a vertex in last_faces_.
void Prices::gather_piece(std::int32_t v) {
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

double Prices::piece(std::int32_t i, std::int64_t most_faces) const {
  const PieceBorders& own = piece_borders_[i];
  const double distance = pieces_.mean_distance(i);
  double price = kPieceFactor * (pieces_.cost(i) + pieces_.area(i) * pieces_.wrong_look(i)) +
                 original_.strips(own.length * distance * distance, own.length, own.area);
  if (original_.is_textured) {
    price += original_.texture_factor() * pieces_.texture_shift(i) * pieces_.area(i);
  }
  return own.importance * price / static_cast<double>(std::min(pieces_.num_faces(i), most_faces));
}

}  // namespace manip3d::quality_detail
