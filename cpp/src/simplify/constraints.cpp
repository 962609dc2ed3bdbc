#include "simplify/constraints.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace manip3d {
namespace {

bool is_boundary_edge(const RingEdge& edge) { return edge.num_faces == 1; }

/// A vertex is manifold if none of its edges has more than two faces and its faces form one fan: a
/// closed fan has as many edges as faces, an open one has one edge more and two boundary edges.
bool is_manifold(const Ring& ring, std::int64_t num_faces) {
  std::int64_t boundary_edges = 0;
  for (const RingEdge& edge : ring.edges()) {
    if (edge.num_faces > 2) return false;
    boundary_edges += is_boundary_edge(edge) ? 1 : 0;
  }
  const auto num_edges = static_cast<std::int64_t>(ring.edges().size());
  if (boundary_edges == 0) return num_edges == num_faces;
  return boundary_edges == 2 && num_edges == num_faces + 1;
}

bool touches_several_wedges(const CollapseMesh& mesh, std::int32_t v) {
  std::int32_t first = -1;
  bool several = false;
  mesh.for_each_face(v, [&](std::int32_t f, std::int32_t c) {
    const std::int32_t wedge = mesh.wedges(f)[c];
    if (first < 0) first = wedge;
    several |= wedge != first;
  });
  return several;
}

/// Calls body(v, t, face) once for each edge v < t of each face.
template <typename Body>
void for_each_face_edge(const CollapseMesh& mesh, std::int32_t v, Body&& body) {
  mesh.for_each_face(v, [&](std::int32_t f, std::int32_t c) {
    for (const std::size_t other : {(c + 1) % 3, (c + 2) % 3}) {
      if (v < mesh.face(f)[other]) body(mesh.face(f)[other], f);
    }
  });
}

/// The plane through an edge, perpendicular to a face of it, times the squared length of the edge
/// [Garland & Heckbert 1997, sec. 6]; zero for degenerate faces.
Quadric edge_plane(const CollapseMesh& mesh, std::int32_t v, std::int32_t t, std::int32_t f) {
  const auto& face = mesh.face(f);
  const Eigen::Vector3d p = mesh.position(face[0]);
  const Eigen::Vector3d face_normal =
      (mesh.position(face[1]) - p).cross(mesh.position(face[2]) - p);
  const Eigen::Vector3d edge = mesh.position(t) - mesh.position(v);
  const Eigen::Vector3d normal = edge.cross(face_normal);
  const double length = normal.norm();
  if (!(length > 0.0)) return {};
  return Quadric::plane(normal / length, mesh.position(v), edge.squaredNorm());
}

Quadric scaled(Quadric quadric, double factor) { return quadric *= factor; }

/// Weight of the boundary planes at a vertex: W_b k (eq. 2.6), or the constant W_b.
double boundary_plane_weight(const CollapseMesh& mesh, const Ring& ring, std::int32_t v,
                             const VertexClass& vertex, const QemOptions& options) {
  if (options.boundary != BoundaryTerm::kCurvature) return options.boundary_weight;
  if (vertex.is_complex) return 0.0;  // its curvature is undefined, and it does not move
  std::array<std::int32_t, 2> neighbours{};
  std::size_t count = 0;
  for (const RingEdge& edge : ring.edges()) {
    if (is_boundary_edge(edge)) neighbours[count++] = edge.vertex;
  }
  return options.boundary_weight *
         boundary_curvature(mesh.position(neighbours[0]), mesh.position(v),
                            mesh.position(neighbours[1]), options.curvature, 1.0);
}

/// Adds the plane of each boundary edge to both of its ends, with the weight of that end.
void add_boundary_planes(const CollapseMesh& mesh, const std::vector<double>& weights, Ring& ring,
                         std::int32_t v, std::vector<Quadric>& quadrics) {
  mesh.gather_ring(v, ring);
  for_each_face_edge(mesh, v, [&](std::int32_t t, std::int32_t f) {
    if (!is_boundary_edge(*ring.find(t))) return;
    const Quadric plane = edge_plane(mesh, v, t, f);
    quadrics[v] += scaled(plane, weights[v]);
    quadrics[t] += scaled(plane, weights[t]);
  });
}

/// Adds a plane along each seam edge, perpendicular to each of its faces, to both of its ends.
void add_seam_planes(const CollapseMesh& mesh, double weight, Ring& ring, std::int32_t v,
                     std::vector<Quadric>& quadrics) {
  mesh.gather_ring(v, ring);
  for_each_face_edge(mesh, v, [&](std::int32_t t, std::int32_t f) {
    if (!ring.find(t)->is_seam) return;
    const Quadric plane = scaled(edge_plane(mesh, v, t, f), weight);
    quadrics[v] += plane;
    quadrics[t] += plane;
  });
}

}  // namespace

double boundary_curvature(const Eigen::Vector3d& previous, const Eigen::Vector3d& vertex,
                          const Eigen::Vector3d& next, BoundaryCurvature kind, double diagonal) {
  constexpr double kLargest = 10.0;
  const Eigen::Vector3d first = (next - previous) / diagonal;                  // r'
  const Eigen::Vector3d second = (next - 2.0 * vertex + previous) / diagonal;  // r''
  const double speed = first.norm();
  if (!(speed > 0.0)) return kLargest;
  const double cross = second.cross(first).norm();
  const double k = kind == BoundaryCurvature::kTurning ? cross / (2.0 * speed * speed)
                                                       : cross / (speed * speed * speed);
  return std::min(k, kLargest);
}

VertexClass classify_vertex(const CollapseMesh& mesh, const Ring& ring, std::int32_t v) {
  std::int64_t num_faces = 0;
  mesh.for_each_face(v, [&](std::int32_t, std::int32_t) { ++num_faces; });
  const auto& edges = ring.edges();
  const auto boundary_neighbours = std::count_if(edges.begin(), edges.end(), is_boundary_edge);
  const auto seam_edges =
      std::count_if(edges.begin(), edges.end(), [](const RingEdge& edge) { return edge.is_seam; });
  VertexClass result;
  result.is_boundary = boundary_neighbours > 0;
  result.is_complex = result.is_boundary && boundary_neighbours != 2;
  result.is_manifold = is_manifold(ring, num_faces);
  result.is_seam = seam_edges > 0 || touches_several_wedges(mesh, v);
  result.is_seam_corner = result.is_seam && (result.is_boundary || seam_edges != 2);
  return result;
}

bool is_locked(const VertexClass& vertex, const QemOptions& options) {
  return (options.boundary == BoundaryTerm::kFreeze && vertex.is_boundary) ||
         (options.boundary == BoundaryTerm::kCurvature && vertex.is_complex) ||
         (options.texture == TextureTerm::kSeamLock && vertex.is_seam) ||
         (options.texture == TextureTerm::kSeamPlanes && vertex.is_seam_corner);
}

std::vector<Quadric> constraint_quadrics(const CollapseMesh& mesh,
                                         const std::vector<VertexClass>& classes,
                                         const QemOptions& options) {
  const auto any = [&](bool VertexClass::* property) {
    return std::any_of(classes.begin(), classes.end(),
                       [&](const VertexClass& vertex) { return vertex.*property; });
  };
  const bool boundary_planes =
      options.boundary != BoundaryTerm::kNone && any(&VertexClass::is_boundary);
  const bool seam_planes =
      options.texture == TextureTerm::kSeamPlanes && any(&VertexClass::is_seam);
  std::vector<Quadric> quadrics;
  if (!boundary_planes && !seam_planes) return quadrics;

  quadrics.resize(classes.size());
  Ring ring(classes.size());
  std::vector<double> weights(classes.size(), 0.0);
  for (std::int32_t v = 0; boundary_planes && v < mesh.num_vertices(); ++v) {
    if (!classes[v].is_boundary) continue;
    mesh.gather_ring(v, ring);
    weights[v] = boundary_plane_weight(mesh, ring, v, classes[v], options);
  }
  for (std::int32_t v = 0; v < mesh.num_vertices(); ++v) {
    const VertexClass& vertex = classes[v];
    if (boundary_planes && vertex.is_boundary) {
      add_boundary_planes(mesh, weights, ring, v, quadrics);
    }
    if (seam_planes && vertex.is_seam) {
      add_seam_planes(mesh, options.seam_weight, ring, v, quadrics);
    }
  }
  return quadrics;
}

}  // namespace manip3d
