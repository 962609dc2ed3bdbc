#include "manip3d/metrics/boundary_gap.hpp"

#include <cmath>
#include <optional>

#include "geometry/constants.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/bvh.hpp"
#include "manip3d/geometry/topology.hpp"
#include "manip3d/geometry/weld.hpp"
#include "metrics/common.hpp"

namespace manip3d {
namespace {

using Eigen::Vector3d;

constexpr double kStep = 1e-3;  // longest piece of an edge, in diagonals of the original
// A lower limit, because the search for cracks visits length / tolerance points.
constexpr double kSmallestTolerance = 1e-6;

struct Segment {
  Vector3d start, end;
  [[nodiscard]] double length() const { return (end - start).norm(); }
  [[nodiscard]] Vector3d at(double t) const { return start + t * (end - start); }
};

// The boundary edges of a mesh with queries for their nearest points; in the tree, edges are
// triangles without area.
class BoundaryCurve {
 public:
  BoundaryCurve(const MeshView& mesh, bool weld, const Progress& progress) {
    Faces faces = mesh.faces;
    if (weld) faces = weld_indices(mesh.faces, weld_rows<3>(mesh.vertices, progress));
    const Edges edges = find_edges(faces, mesh.num_vertices());
    for (Eigen::Index e = 0; e < edges.size(); ++e) {
      if (edges.is_boundary(e)) segments_.push_back(segment_of(mesh, faces, edges, e));
    }
    if (segments_.empty()) return;
    TriangleMesh needles;
    needles.vertices.resize(2 * size(), 3);
    needles.faces.resize(size(), 3);
    for (std::int32_t i = 0; i < size(); ++i) {
      needles.vertices.row(2 * i) = segments_[i].start;
      needles.vertices.row(2 * i + 1) = segments_[i].end;
      needles.faces.row(i) << 2 * i, 2 * i + 1, 2 * i + 1;
    }
    bvh_.emplace(needles, progress);
  }

  [[nodiscard]] std::int64_t size() const { return static_cast<std::int64_t>(segments_.size()); }
  [[nodiscard]] const Segment& operator[](std::int64_t i) const { return segments_[i]; }
  [[nodiscard]] double distance(const Vector3d& point) const {
    return bvh_ ? bvh_->closest_point(point).distance : kInfinity;
  }

 private:
  // The positions are those of the edge's face, with or without welding.
  static Segment segment_of(const MeshView& mesh, const Faces& faces, const Edges& edges,
                            Eigen::Index edge) {
    const std::int32_t f = edges.faces_of(edge).front();
    int opposite = 0;
    while (faces(f, opposite) == edges.vertices(edge, 0) ||
           faces(f, opposite) == edges.vertices(edge, 1)) {
      ++opposite;
    }
    return {mesh.vertices.row(mesh.faces(f, (opposite + 1) % 3)),
            mesh.vertices.row(mesh.faces(f, (opposite + 2) % 3))};
  }

  std::vector<Segment> segments_;
  std::optional<TriangleBvh> bvh_;
};

// Moments of a distance along curves.
struct LengthMoments {
  double length = 0.0;
  double sum = 0.0;
  double squares = 0.0;
  double max = 0.0;
  std::int64_t count = 0;

  void add(double distance, double piece) {
    length += piece;
    sum += distance * piece;
    squares += distance * distance * piece;
    max = std::max(max, distance);
    ++count;
  }
  void add(const LengthMoments& other) {
    length += other.length;
    sum += other.sum;
    squares += other.squares;
    max = std::max(max, other.max);
    count += other.count;
  }
  [[nodiscard]] std::optional<Deviation> deviation(double unit) const {
    if (!(length > 0.0)) return std::nullopt;
    return Deviation{sum / length * unit, std::sqrt(squares / length) * unit, max * unit, count};
  }
};

LengthMoments measure_edge(const Segment& edge, const BoundaryCurve& to, double step) {
  LengthMoments moments;
  const double length = edge.length();
  if (!(length > 0.0)) return moments;
  const double pieces = std::max(1.0, std::ceil(length / step));
  for (double i = 0.0; i < pieces; ++i) {
    moments.add(to.distance(edge.at((i + 0.5) / pieces)), length / pieces);
  }
  moments.max = std::max({moments.max, to.distance(edge.start), to.distance(edge.end)});
  return moments;
}

std::optional<Deviation> one_sided(const BoundaryCurve& from, const BoundaryCurve& to, double step,
                                   double unit, int num_threads, const Progress& progress) {
  const auto measure = [&](std::int64_t begin, std::int64_t end) {
    LengthMoments moments;
    for (std::int64_t i = begin; i < end; ++i) moments.add(measure_edge(from[i], to, step));
    return moments;
  };
  return accumulate_in_order<LengthMoments>(from.size(), num_threads, progress, measure)
      .deviation(unit);
}

// Share of the tolerance: pieces of an edge that are shorter are not halved again. What they hide
// is beyond the tolerance by half of this share at most.
constexpr double kShortestPiece = 1e-3;

// Whether the edge has a point beyond the tolerance. The distance changes at most as fast as the
// position, so between the ends it is at most half the sum of both ends' distances and the length.
bool is_crack(const Segment& edge, const BoundaryCurve& to, double tolerance) {
  const double at_start = to.distance(edge.start);
  const double at_end = to.distance(edge.end);
  if (std::max(at_start, at_end) > tolerance) return true;
  const double length = edge.length();
  if (0.5 * (at_start + at_end + length) <= tolerance || length < kShortestPiece * tolerance)
    return false;
  const Vector3d middle = edge.at(0.5);
  return is_crack({edge.start, middle}, to, tolerance) ||
         is_crack({middle, edge.end}, to, tolerance);
}

struct Cracks {
  std::int64_t count = 0;
  double length = 0.0;
  void add(const Cracks& other) {
    count += other.count;
    length += other.length;
  }
};

Cracks find_cracks(const BoundaryCurve& simplified, const BoundaryCurve& original, double tolerance,
                   int num_threads, const Progress& progress) {
  const auto find = [&](std::int64_t begin, std::int64_t end) {
    Cracks cracks;
    for (std::int64_t i = begin; i < end; ++i) {
      if (is_crack(simplified[i], original, tolerance)) cracks.add({1, simplified[i].length()});
    }
    return cracks;
  };
  return accumulate_in_order<Cracks>(simplified.size(), num_threads, progress, find);
}

}  // namespace

BoundaryGap boundary_gap(const MeshView& original, const MeshView& simplified,
                         const BoundaryGapOptions& options, const Progress& progress) {
  if (!(options.tolerance >= kSmallestTolerance && options.tolerance <= 1.0)) {
    throw InputError("tolerance: expected 1e-6 to 1, got " + number_text(options.tolerance));
  }
  const NormalizedPair pair(original, simplified);
  const double step = kStep * pair.diagonal();
  // Relative to the larger mesh, because an edge of a million diagonals must not take a million
  // times as long.
  const double step_back = std::max(step, kStep * bounding_box(pair.simplified()).diagonal());
  const BoundaryCurve a(pair.original(), options.weld, part_of(progress, 0.0, 0.0));
  const BoundaryCurve b(pair.simplified(), options.weld, part_of(progress, 0.0, 0.0));
  const Cracks cracks = find_cracks(b, a, options.tolerance * pair.diagonal(), options.num_threads,
                                    part_of(progress, 0.0, 0.2));
  BoundaryGap gap;
  gap.forward =
      one_sided(a, b, step, pair.unit(), options.num_threads, part_of(progress, 0.2, 0.6));
  gap.backward =
      one_sided(b, a, step_back, pair.unit(), options.num_threads, part_of(progress, 0.6, 1.0));
  gap.cracks = cracks.count;
  gap.crack_length = cracks.length * pair.unit();
  gap.diagonal = pair.diagonal() * pair.unit();
  return gap;
}

}  // namespace manip3d
