#include "simplify/relief/refine.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "geometry/constants.hpp"
#include "geometry/lanes.hpp"
#include "geometry/wide_vectors.hpp"
#include "simplify/relief/links.hpp"
#include "simplify/relief/raster.hpp"

namespace manip3d::relief_detail {
namespace {

// A vertex or an edge of the previous frame is replaced only if that leaves less than this share of
// its error.
constexpr float kKeptGain = 0.5F;

// Ticks are frequent, because a triangle of a sparse mesh has thousands of pixels.
constexpr std::uint32_t kFacesPerTick = 16;

// A flip leaves less than this share of the error. The rest prevents flips back and forth due to
// rounding.
constexpr float kGain = 0.999F;

struct SurfaceCorner {
  std::int32_t u, v;
  Vec3 point;
};

SurfaceCorner corner_of(const Triangulation& mesh, std::int32_t v) {
  const Triangulation::Vertex& vertex = mesh.vertex(v);
  return {vertex.u, vertex.v, vertex.point};
}

float triangle_error(const Surface& surface, const SurfaceCorner& a, const SurfaceCorner& b,
                     const SurfaceCorner& c) {
  const Vec3 normal = (b.point - a.point).cross(c.point - a.point);
  const float length = normal.norm();
  if (!(length > 0.0F)) return kInfinityF;
  const Vec3 n = normal / length;
  const float d = n.dot(a.point);
  float sum = 0.0F;
  visit_pixels(surface.cols(), {a.u, a.v}, {b.u, b.v}, {c.u, c.v}, SidePixels::kShared,
               [&](std::int32_t p) {
                 const Sample& s = surface.sample(p);
                 sum += s.weight * std::abs(n.x() * s.x + n.y() * s.y + n.z() * s.z - d);
               });
  return sum;
}

float triangle_error(const Surface& surface, const Triangulation& mesh, std::int32_t a,
                     std::int32_t b, std::int32_t c) {
  return triangle_error(surface, corner_of(mesh, a), corner_of(mesh, b), corner_of(mesh, c));
}

/// Six times the volume between the two pairs of triangles into which a quadrilateral can be cut:
/// an upper bound of the gain by a flip.
float volume_between(const Triangulation& mesh, const std::array<std::int32_t, 4>& abcd) {
  const Vec3& a = mesh.vertex(abcd[0]).point;
  const Vec3 ab = mesh.vertex(abcd[1]).point - a, ac = mesh.vertex(abcd[2]).point - a;
  return std::abs(ab.cross(ac).dot(mesh.vertex(abcd[3]).point - a));
}

/// Mean volume over the sides of every eighth triangle.
float mean_volume(const Triangulation& mesh) {
  constexpr std::int32_t kStride = 8;
  double sum = 0.0;
  std::int64_t count = 0;
  std::array<std::int32_t, 4> abcd{};
  for (std::int32_t t = 0; t < mesh.num_face_slots(); t += kStride) {
    if (!mesh.is_face(t)) continue;
    for (int i = 0; i < 3; ++i) {
      if (!mesh.quad(t, i, abcd)) continue;
      sum += volume_between(mesh, abcd);
      ++count;
    }
  }
  return count > 0 ? static_cast<float>(sum / static_cast<double>(count)) : 0.0F;
}

template <int kA, int kB, int kC, int kD>
Float4 pick(Float4 lanes) {
  return __builtin_shufflevector(lanes, lanes, kA, kB, kC, kD);
}

Float4 absolute(Float4 lanes) { return lanes < 0.0F ? -lanes : lanes; }

float sum_of(Float4 lanes) { return (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]); }

using FourPoints = std::array<Float4, 3>;  ///< x, y and z of each lane.

/// The planes of four triangles, one per lane: normal and distance from the origin.
struct FourPlanes {
  FourPoints normal;
  Float4 d;

  FourPlanes(const FourPoints& p, const FourPoints& q, const FourPoints& r) {
    const Float4 x1 = q[0] - p[0], y1 = q[1] - p[1], z1 = q[2] - p[2];
    const Float4 x2 = r[0] - p[0], y2 = r[1] - p[1], z2 = r[2] - p[2];
    normal = {y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2};
    auto& [x, y, z] = normal;
    const Float4 length = sqrt4(x * x + (y * y + z * z));
    const Float4 scale = 1.0F / (length > 0.0F ? length : all_of(1.0F));
    x *= scale, y *= scale, z *= scale;
    d = x * p[0] + (y * p[1] + z * p[2]);
  }
  /// Distances of four points from the planes of these lanes.
  template <int kA, int kB, int kC, int kD>
  [[nodiscard]] Float4 distances(const Float4& x, const Float4& y, const Float4& z) const {
    return absolute(pick<kA, kB, kC, kD>(normal[0]) * x + pick<kA, kB, kC, kD>(normal[1]) * y +
                    pick<kA, kB, kC, kD>(normal[2]) * z - pick<kA, kB, kC, kD>(d));
  }
};

/// Estimated errors of a convex quadrilateral with its current diagonal and with the other one.
struct DiagonalErrors {
  float now = 0.0F, flipped = 0.0F;
};

/// The diagonals cut the quadrilateral into four triangles around their intersection. Three pixels
/// of each triangle represent it, weighted by its share of the pixels.
MANIP3D_INLINE DiagonalErrors errors_of_samples(const Surface& surface, const Triangulation& mesh,
                                                const std::array<std::int32_t, 4>& abcd) {
  const Triangulation::Vertex &a = mesh.vertex(abcd[0]), &b = mesh.vertex(abcd[1]),
                              &c = mesh.vertex(abcd[2]), &d = mesh.vertex(abcd[3]);
  const auto [px, py, pz, flags] = transpose(
      {load4(&a.point.x()), load4(&b.point.x()), load4(&c.point.x()), load4(&d.point.x())});
  // Lanes: abc and bdc for the current diagonal, abd and adc for the flipped one.
  const FourPlanes planes({pick<0, 1, 0, 0>(px), pick<0, 1, 0, 0>(py), pick<0, 1, 0, 0>(pz)},
                          {pick<1, 3, 1, 3>(px), pick<1, 3, 1, 3>(py), pick<1, 3, 1, 3>(pz)},
                          {pick<2, 2, 3, 2>(px), pick<2, 2, 3, 2>(py), pick<2, 2, 3, 2>(pz)});
  const auto before_ad = static_cast<float>(mesh.orient(abcd[0], abcd[1], abcd[3]));
  const auto after_ad = static_cast<float>(mesh.orient(abcd[0], abcd[3], abcd[2]));
  const float share = before_ad / (before_ad + after_ad);
  const auto columns = [](int p, int q, int r, int s) {
    return Float4{static_cast<float>(p), static_cast<float>(q), static_cast<float>(r),
                  static_cast<float>(s)};
  };
  // Lanes: the sides ab, bd, dc and ca.
  const Float4 u = columns(a.u, b.u, d.u, c.u), v = columns(a.v, b.v, d.v, c.v);
  const float mid_u = u[1] + share * (u[3] - u[1]), mid_v = v[1] + share * (v[3] - v[1]);
  const Float4 u1 = u - mid_u, v1 = v - mid_v, u2 = pick<1, 2, 3, 0>(u1), v2 = pick<1, 2, 3, 0>(v1);
  const Float4 area = absolute(u1 * v2 - v1 * u2);
  Float4 now = all_of(0.0F), flipped = all_of(0.0F);
  constexpr std::array<std::array<float, 2>, 3> kPlaces = {
      {{0.25F, 0.25F}, {0.5F, 0.25F}, {0.25F, 0.5F}}};
  for (const auto& [first, second] : kPlaces) {
    const Int4 at_u = __builtin_convertvector(first * u1 + second * u2 + (mid_u + 0.5F), Int4);
    const Int4 at_v = __builtin_convertvector(first * v1 + second * v2 + (mid_v + 0.5F), Int4);
    const Int4 at = at_v * surface.cols() + at_u;
    const auto sample = [&](int i) { return load4(&surface.sample(at[i]).x); };
    const auto [x, y, z, weight] = transpose({sample(0), sample(1), sample(2), sample(3)});
    now += area * weight * planes.distances<0, 1, 1, 0>(x, y, z);
    flipped += area * weight * planes.distances<2, 2, 3, 3>(x, y, z);
  }
  return {sum_of(now), sum_of(flipped)};
}

/// Does a triangle hold pixels without confidence as well as others?
bool is_at_rim(const Surface& surface, const Triangulation& mesh, std::int32_t t) {
  const auto& [a, b, c] = mesh.triangle(t);
  const Triangulation::Vertex &p = mesh.vertex(a), &q = mesh.vertex(b), &r = mesh.vertex(c);
  const auto [first_u, last_u] = std::minmax({p.u, q.u, r.u});
  const auto [first_v, last_v] = std::minmax({p.v, q.v, r.v});
  if (surface.has_full_confidence(first_u, first_v, last_u, last_v)) return false;
  bool has_unsure = false, has_sure = false;
  visit_pixels(
      surface.cols(), {p.u, p.v}, {q.u, q.v}, {r.u, r.v}, SidePixels::kClosed,
      [&](std::int32_t pixel) { (surface.is_unsure(pixel) ? has_unsure : has_sure) = true; });
  return has_unsure && has_sure;
}

DiagonalErrors sampled_errors(const Surface& surface, const Triangulation& mesh,
                              const std::array<std::int32_t, 4>& abcd) {
  return errors_of_samples(surface, mesh, abcd);
}

#ifdef MANIP3D_AVX2
MANIP3D_AVX2 DiagonalErrors sampled_errors_wide(const Surface& surface, const Triangulation& mesh,
                                                const std::array<std::int32_t, 4>& abcd) {
  return errors_of_samples(surface, mesh, abcd);
}
#endif

}  // namespace

float triangle_error(const Surface& surface, const Triangle& corners) {
  const auto corner = [&](std::int32_t p) {
    return SurfaceCorner{surface.u(p), surface.v(p), surface.sample(p).point()};
  };
  return triangle_error(surface, corner(corners[0]), corner(corners[1]), corner(corners[2]));
}

void EdgeMemory::assign(const Surface& surface, const Triangulation& mesh) {
  edges_.clear();
  const auto place = [&](std::int32_t v) {
    return std::uint64_t{surface.place(mesh.vertex(v).u, mesh.vertex(v).v)};
  };
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    if (!mesh.is_face(t)) continue;
    for (int i = 0; i < 3; ++i) {  // an inner edge is visited from both sides
      const std::uint64_t a = place(mesh.triangle(t)[i]), b = place(mesh.triangle(t)[(i + 1) % 3]);
      if (a < b) edges_.push_back(a << 32 | b);
    }
  }
  std::sort(edges_.begin(), edges_.end());
}

bool EdgeMemory::has(const Surface& surface, const Triangulation& mesh, std::int32_t a,
                     std::int32_t b) const {
  if (edges_.empty()) return false;
  const Triangulation::Vertex &p = mesh.vertex(a), &q = mesh.vertex(b);
  const std::uint64_t m = surface.place(p.u, p.v), n = surface.place(q.u, q.v);
  return std::binary_search(edges_.begin(), edges_.end(), std::min(m, n) << 32 | std::max(m, n));
}

namespace {

/// The flip of an edge that is not on the boundary.
struct Flip {
  std::array<std::int32_t, 4> quad{};  ///< Result of Triangulation::quad().
  bool returns = false;                ///< The new edge is one of the previous frame.
  float gain = kGain;                  ///< Share of the error that the flip must go below.
};

/// Finds the flip of a triangle's edge; returns false if the quadrilateral around it has none.
bool find_flip(const Surface& surface, const Triangulation& mesh, const EdgeMemory& before,
               std::int32_t t, int i, Flip& flip) {
  const auto& q = flip.quad;
  if (!mesh.quad(t, i, flip.quad)) return false;
  const bool was = before.has(surface, mesh, q[1], q[2]);
  flip.returns = !was && before.has(surface, mesh, q[0], q[3]);
  flip.gain = was ? kGain * kKeptGain : flip.returns ? kGain / kKeptGain : kGain;
  return true;
}

}  // namespace

void Refiner::assign(const Triangulation& mesh) {
  make_room(errors_, mesh.num_face_slots());
  for (auto* marks : {&dirty_, &next_dirty_}) make_room(*marks, mesh.num_face_slots());
  errors_.assign(mesh.num_face_slots(), -1.0F);
  dirty_.assign(mesh.num_face_slots(), 1);
}

float Refiner::error_of(const Surface& surface, const Triangulation& mesh, std::int32_t t) {
  if (errors_[t] < 0.0F) {
    const Triangle& c = mesh.triangle(t);
    errors_[t] = triangle_error(surface, mesh, c[0], c[1], c[2]);
  }
  return errors_[t];
}

float Refiner::mean_error(const Surface& surface, const Triangulation& mesh) {
  double sum = 0.0;
  std::int64_t count = 0;
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    if (!mesh.is_face(t)) continue;
    const float error = error_of(surface, mesh, t);
    if (!(error < kInfinityF)) continue;
    sum += error;
    ++count;
  }
  return count > 0 ? static_cast<float>(sum / static_cast<double>(count)) : 0.0F;
}

int Refiner::flip_edges(const Surface& surface, Triangulation& mesh, int sweeps, float floor,
                        const EdgeMemory& before, const Progress& progress) {
  Ticker ticker(progress, kFacesPerTick);
  const float negligible = floor > 0.0F ? floor * mean_error(surface, mesh) : 0.0F;
  Flip flip;
  int total = 0;
  for (int sweep = 0; sweep < sweeps; ++sweep) {
    int flips = 0;
    next_dirty_.assign(dirty_.size(), 0);
    for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
      ticker.tick();
      if (!mesh.is_face(t)) continue;
      for (int i = 0; i < 3; ++i) {
        const std::int32_t o = mesh.neighbors(t)[i];
        if (o == Triangulation::kNone || (dirty_[t] == 0 && dirty_[o] == 0)) continue;
        if (o < t && dirty_[o] != 0 && next_dirty_[o] == 0 && next_dirty_[t] == 0)
          continue;  // the pair is tested from the other triangle
        if (!find_flip(surface, mesh, before, t, i, flip)) continue;
        const float limit = flip.gain * (error_of(surface, mesh, t) + error_of(surface, mesh, o));
        if (!(limit > 0.0F) || (limit < negligible && !flip.returns)) continue;
        const auto& q = flip.quad;
        const float first = triangle_error(surface, mesh, q[0], q[1], q[3]);
        if (!(first < limit)) continue;
        const float second = triangle_error(surface, mesh, q[0], q[3], q[2]);
        if (!(first + second < limit)) continue;
        mesh.flip(t, i);
        errors_[t] = first;
        errors_[o] = second;
        next_dirty_[t] = next_dirty_[o] = 1;
        ++flips;
      }
    }
    dirty_.swap(next_dirty_);
    total += flips;
    if (flips == 0) break;
  }
  return total;
}

void Refiner::flip_unsure(const Surface& surface, Triangulation& mesh, const EdgeMemory& before,
                          const Progress& progress) {
  constexpr int kMostSweeps = 20;
  assign(mesh);
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    dirty_[t] = mesh.is_face(t) && is_at_rim(surface, mesh, t) ? 1 : 0;
  }
  flip_edges(surface, mesh, kMostSweeps, 0.0F, before, progress);
}

void Refiner::flip_sampled(const Surface& surface, Triangulation& mesh, int sweeps, float floor,
                           const EdgeMemory& before, const Progress& progress) {
  Ticker ticker(progress, kFacesPerTick);
  const float negligible = floor * mean_volume(mesh);
  Flip flip;
  auto* sampled = &sampled_errors;
#ifdef MANIP3D_AVX2
  if (has_avx2()) sampled = &sampled_errors_wide;
#endif
  for (int sweep = 0; sweep < sweeps; ++sweep) {
    bool flipped = false;
    next_dirty_.assign(dirty_.size(), 0);
    for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
      ticker.tick();
      if (!mesh.is_face(t)) continue;
      for (int i = 0; i < 3; ++i) {
        const std::int32_t o = mesh.neighbors(t)[i];
        // No neighbour, or tested from the other triangle.
        if (o < t || (dirty_[t] == 0 && dirty_[o] == 0)) continue;
        if (!find_flip(surface, mesh, before, t, i, flip)) continue;
        if (!flip.returns && !(volume_between(mesh, flip.quad) > negligible)) continue;
        const DiagonalErrors errors = sampled(surface, mesh, flip.quad);
        if (!(errors.flipped < flip.gain * errors.now)) continue;
        mesh.flip(t, i);
        next_dirty_[t] = next_dirty_[o] = 1;
        flipped = true;
      }
    }
    if (!flipped) return;
    dirty_.swap(next_dirty_);
  }
}

float Refiner::error_at(const Surface& surface, const Triangulation& mesh,
                        const Triangulation::Fan& fan, std::int32_t pixel, float most,
                        std::array<float, Triangulation::kMaxFan>& errors) {
  const SurfaceCorner center{surface.u(pixel), surface.v(pixel), surface.sample(pixel).point()};
  float sum = 0.0F;
  for (int i = 0; i < fan.size && sum < most; ++i) {
    const SurfaceCorner a = corner_of(mesh, fan.neighbors[i]), b = corner_of(mesh, fan.next(i));
    if (std::int64_t{a.u - center.u} * (b.v - center.v) -
            std::int64_t{a.v - center.v} * (b.u - center.u) <=
        0)
      return most;
    errors[i] = triangle_error(surface, center, a, b);
    sum += errors[i];
  }
  return sum;
}

void Refiner::leave_pixels(const Surface& surface, Triangulation& mesh, std::span<const Keep> keep,
                           const std::function<bool(std::int32_t)>& is_left) {
  constexpr int kSweeps = 4;  // a vertex may become movable through moves of its neighbours
  Triangulation::Fan fan;
  bool is_done = false;
  for (int sweep = 0; sweep < kSweeps && !is_done; ++sweep) {
    is_done = true;
    for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
      const Triangulation::Vertex& vertex = mesh.vertex(v);
      if (!vertex.alive() || !is_left(vertex.pixel) || !mesh.fan(v, fan) ||
          (!keep.empty() && keep[vertex.pixel] == Keep::kFixed)) {
        continue;
      }
      const std::int32_t best =
          vertex.on_boundary ? -1 : best_beside(surface, mesh, fan, vertex.pixel, is_left);
      if (best >= 0) {
        mesh.move(v, surface, best);
      } else if (!merge(surface, mesh, v, fan)) {
        const std::int32_t nearest =
            vertex.on_boundary ? nearest_in(surface, mesh, fan, vertex.pixel, is_left) : -1;
        if (nearest >= 0) {
          mesh.move(v, surface, nearest);
        } else {
          is_done = merge_with_fewer_edges(surface, mesh, v, fan) && is_done;
        }
      }
    }
  }
}

bool Refiner::merge(const Surface& surface, Triangulation& mesh, std::int32_t v,
                    const Triangulation::Fan& fan) {
  for (int i = 0; i < fan.num_neighbors; ++i) {
    if (!mesh.can_collapse(surface, v, fan, i)) continue;
    mesh.collapse(v, fan, i);
    return true;
  }
  return false;
}

bool Refiner::merge_with_fewer_edges(const Surface& surface, Triangulation& mesh, std::int32_t v,
                                     Triangulation::Fan& fan) {
  while (flip_away(mesh, v, fan)) {
    if (mesh.fan(v, fan) && merge(surface, mesh, v, fan)) return true;
  }
  return false;
}

bool Refiner::flip_away(Triangulation& mesh, std::int32_t v, const Triangulation::Fan& fan) {
  std::array<std::int32_t, 4> quad{};
  for (int k = 0; k < fan.size; ++k) {
    const std::int32_t t = fan.faces[k];
    for (int i = 0; i < 3; ++i) {
      if (mesh.triangle(t)[i] == v || !mesh.quad(t, i, quad)) continue;
      mesh.flip(t, i);
      return true;
    }
  }
  return false;
}

std::int32_t Refiner::nearest_in(const Surface& surface, const Triangulation& mesh,
                                 const Triangulation::Fan& fan, std::int32_t pixel,
                                 const std::function<bool(std::int32_t)>& is_left) {
  using Place = std::array<std::int32_t, 2>;
  const auto place_of = [&](std::int32_t v) -> Place {
    return {mesh.vertex(v).u, mesh.vertex(v).v};
  };
  const Place center = {surface.u(pixel), surface.v(pixel)};
  const auto is_legal = [&](std::int64_t u, std::int64_t v) {
    for (int i = 0; i < fan.size; ++i) {
      const Place a = place_of(fan.neighbors[i]), b = place_of(fan.next(i));
      if ((a[0] - u) * (b[1] - v) - (a[1] - v) * (b[0] - u) <= 0) return false;
    }
    return true;
  };
  std::int64_t least = std::numeric_limits<std::int64_t>::max();
  std::int32_t best = -1;
  for (int i = 0; i < fan.size; ++i) {
    visit_pixels(surface.cols(), center, place_of(fan.neighbors[i]), place_of(fan.next(i)),
                 SidePixels::kClosed, [&](std::int32_t other) {
                   const std::int64_t u = surface.u(other), v = surface.v(other);
                   const std::int64_t distance =
                       (u - center[0]) * (u - center[0]) + (v - center[1]) * (v - center[1]);
                   if (distance >= least || !surface.is_used(other) || is_left(other)) return;
                   if (mesh.num_at(other) > 0 || !is_legal(u, v)) return;
                   least = distance;
                   best = other;
                 });
  }
  return best;
}

std::int32_t Refiner::best_beside(const Surface& surface, const Triangulation& mesh,
                                  const Triangulation::Fan& fan, std::int32_t pixel,
                                  const std::function<bool(std::int32_t)>& is_left) {
  constexpr int kRadius = 2;
  std::array<float, Triangulation::kMaxFan> errors{};
  const int u = surface.u(pixel), v = surface.v(pixel);
  float least = kInfinityF;
  std::int32_t best = -1;
  for (int row = std::max(v - kRadius, 0); row <= std::min(v + kRadius, surface.rows() - 1);
       ++row) {
    for (int column = std::max(u - kRadius, 0); column <= std::min(u + kRadius, surface.cols() - 1);
         ++column) {
      const std::int32_t other = row * surface.cols() + column;
      if (!surface.is_used(other) || is_left(other)) continue;
      // An island over a closed hole attracts vertices, as in move_vertices().
      if (!are_linked(surface, pixel, column - u, row - v)) continue;
      const float error = error_at(surface, mesh, fan, other, least, errors);
      if (error < least) least = error, best = other;
    }
  }
  return best;
}

int Refiner::move_vertices(const Surface& surface, Triangulation& mesh, int radius,
                           std::span<const Keep> keep, const Progress& progress) {
  Ticker ticker(progress, kFacesPerTick);
  Triangulation::Fan fan;
  int moved = 0;
  std::array<float, Triangulation::kMaxFan> best_errors{}, errors{};
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    ticker.tick();
    const Triangulation::Vertex& vertex = mesh.vertex(v);
    const Keep kept = keep.empty() ? Keep::kFree : keep[vertex.pixel];
    if (!vertex.alive() || vertex.on_boundary || kept == Keep::kFixed || !mesh.fan(v, fan))
      continue;
    float now = 0.0F;
    for (int i = 0; i < fan.size; ++i) now += error_of(surface, mesh, fan.faces[i]);
    if (kept == Keep::kPrefer) now *= kKeptGain;
    const int u0 = vertex.u, v0 = vertex.v;
    std::int32_t best = -1;
    for (int dv = -radius; dv <= radius; ++dv) {
      for (int du = -radius; du <= radius; ++du) {
        if (du == 0 && dv == 0) continue;
        if (u0 + du < 0 || v0 + dv < 0 || u0 + du >= surface.cols() || v0 + dv >= surface.rows())
          continue;
        const std::int32_t pixel = (v0 + dv) * surface.cols() + u0 + du;
        if (!surface.is_used(pixel) || surface.is_unsure(pixel)) continue;
        const float sum = error_at(surface, mesh, fan, pixel, now, errors);
        // Pixels of an island over a closed hole are a step away. Triangles to them are steep and
        // therefore near many pixels, but cover none.
        if (!(sum < 0.999F * now) || !are_linked(surface, vertex.pixel, du, dv)) continue;
        now = sum;
        best = pixel;
        best_errors = errors;
      }
    }
    if (best < 0) continue;
    mesh.move(v, surface, best);
    for (int i = 0; i < fan.size; ++i)
      errors_[fan.faces[i]] = best_errors[i], dirty_[fan.faces[i]] = 1;
    ++moved;
  }
  return moved;
}

/// The terms that one triangle adds to the normal equations of its corners a, b, c.
Refiner::Block Refiner::normal_equations(const Surface& surface, const Triangulation& mesh,
                                         const std::vector<Vec3>& directions, std::int32_t t) {
  Block block{};
  const Triangle& f = mesh.triangle(t);
  const SurfaceCorner a = corner_of(mesh, f[0]), b = corner_of(mesh, f[1]),
                      c = corner_of(mesh, f[2]);
  const Vec3 normal = (b.point - a.point).cross(c.point - a.point);
  const float length = normal.norm();
  if (!(length > 0.0F)) return block;
  const Vec3 n = normal / length;
  const float d = n.dot(a.point);
  // Distance by which the plane moves per unit that a corner slides.
  const float ka = n.dot(directions[f[0]]), kb = n.dot(directions[f[1]]);
  const float kc = n.dot(directions[f[2]]);
  const float inverse = 1.0F / static_cast<float>(mesh.orient(f[0], f[1], f[2]));
  const auto ub = static_cast<float>(b.u - a.u), vb = static_cast<float>(b.v - a.v);
  const auto uc = static_cast<float>(c.u - a.u), vc = static_cast<float>(c.v - a.v);
  visit_pixels(surface.cols(), {a.u, a.v}, {b.u, b.v}, {c.u, c.v}, SidePixels::kShared,
               [&](std::int32_t p) {
                 const Sample& s = surface.sample(p);
                 const auto du = static_cast<float>(surface.u(p) - a.u);
                 const auto dv = static_cast<float>(surface.v(p) - a.v);
                 const float wb = (du * vc - dv * uc) * inverse;
                 const float wc = (ub * dv - vb * du) * inverse;
                 const float pa = (1.0F - wb - wc) * ka, pb = wb * kb, pc = wc * kc;
                 const float e = s.weight * (n.x() * s.x + n.y() * s.y + n.z() * s.z - d);
                 block.aa += s.weight * pa * pa, block.bb += s.weight * pb * pb;
                 block.cc += s.weight * pc * pc, block.ab += s.weight * pa * pb;
                 block.bc += s.weight * pb * pc, block.ca += s.weight * pc * pa;
                 block.ra += pa * e, block.rb += pb * e, block.rc += pc * e;
               });
  return block;
}

void Refiner::fit(const Surface& surface, Triangulation& mesh,
                  const std::vector<Vec3>& directions) {
  solve(surface, mesh, directions);
  accept(surface, mesh, directions);
}

void Refiner::solve(const Surface& surface, const Triangulation& mesh,
                    const std::vector<Vec3>& directions) {
  constexpr int kSweeps = 4;  // Gauss-Seidel sweeps; the system is nearly diagonal
  make_room(offsets_, mesh.num_slots());
  make_room(blocks_, mesh.num_face_slots());
  offsets_.assign(mesh.num_slots(), 0.0F);
  blocks_.resize(mesh.num_face_slots());
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    if (mesh.is_face(t)) blocks_[t] = normal_equations(surface, mesh, directions, t);
  }
  // Evidence equal to a tenth of a pixel that a vertex stays, because some vertices have none of
  // their own.
  const float ridge = 0.1F * surface.mean_area();
  Triangulation::Fan fan;
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
      if (!mesh.vertex(v).alive() || !mesh.fan(v, fan)) continue;
      float right = 0.0F, own = ridge;
      for (int i = 0; i < fan.size; ++i) {
        const Block& k = blocks_[fan.faces[i]];
        const auto [a, b, c] = mesh.triangle(fan.faces[i]);
        if (a == v) {
          right += k.ra - k.ab * offsets_[b] - k.ca * offsets_[c], own += k.aa;
        } else if (b == v) {
          right += k.rb - k.ab * offsets_[a] - k.bc * offsets_[c], own += k.bb;
        } else {
          right += k.rc - k.ca * offsets_[a] - k.bc * offsets_[b], own += k.cc;
        }
      }
      offsets_[v] = right / own;
    }
  }
}

// Least squares are sensitive to the few pixels beside depth steps, which hardly change the mean
// distance. So each slide is accepted, halved or dropped by the mean distance.
void Refiner::accept(const Surface& surface, Triangulation& mesh,
                     const std::vector<Vec3>& directions) {
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    if (mesh.vertex(v).alive()) mesh.slide(v, surface, offsets_[v] * directions[v]);
  }
  assign(mesh);
  Triangulation::Fan fan;
  std::array<float, Triangulation::kMaxFan> best_errors{}, errors{};
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    if (!mesh.vertex(v).alive() || offsets_[v] == 0.0F || !mesh.fan(v, fan)) continue;
    float now = 0.0F;
    for (int i = 0; i < fan.size; ++i) now += error_of(surface, mesh, fan.faces[i]);
    float best = 1.0F;
    for (const float share : {0.5F, 0.0F}) {
      SurfaceCorner center = corner_of(mesh, v);
      center.point =
          surface.sample(mesh.vertex(v).pixel).point() + share * offsets_[v] * directions[v];
      float sum = 0.0F;
      int i = 0;
      for (; i < fan.size && sum < now; ++i) {
        errors[i] = triangle_error(surface, center, corner_of(mesh, fan.neighbors[i]),
                                   corner_of(mesh, fan.next(i)));
        sum += errors[i];
      }
      if (i < fan.size || !(sum < now)) continue;
      now = sum;
      best = share;
      best_errors = errors;
    }
    if (best == 1.0F) continue;
    offsets_[v] *= best;
    mesh.slide(v, surface, offsets_[v] * directions[v]);
    for (int i = 0; i < fan.size; ++i) errors_[fan.faces[i]] = best_errors[i];
  }
}

}  // namespace manip3d::relief_detail
