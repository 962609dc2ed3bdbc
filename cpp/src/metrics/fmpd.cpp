#include "manip3d/metrics/fmpd.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include "geometry/union_find.hpp"
#include "manip3d/geometry/topology.hpp"
#include "metrics/common.hpp"

namespace manip3d {
namespace {

using Eigen::Vector3d;
using std::numbers::pi;

// The paper's constants, as in its authors' program.
constexpr double kMinRoughness = 0.0005;
constexpr double kMaxRoughness = 0.20;
constexpr double kMaxOverMean = 5.0;
constexpr double kExponent = 0.15;
constexpr double kScale = 8.0;
constexpr double kMinWeight = 0.001;
constexpr double kMaxWeight = 1000.0;

struct FaceTerms {
  double area;
  double angle[3];   // without an area: pi at a corner between the others, else 0
  double weight[3];  // of the edge opposite the corner: half its cotangent
};

// A power of two near the size of the mesh. In this unit no area overflows or underflows, even if
// the sizes of the two meshes differ strongly, and no bit of a ratio of areas changes.
double own_unit(const MeshView& mesh) {
  const BoundingBox box = bounding_box(mesh);
  const double size = (box.max - box.min).maxCoeff();
  return size > 0.0 ? std::ldexp(1.0, std::clamp(std::ilogb(size), -1000, 1000)) : 1.0;
}

std::vector<FaceTerms> face_terms(const MeshView& mesh, int num_threads, const Progress& progress) {
  const double unit = own_unit(mesh);
  std::vector<FaceTerms> terms(mesh.num_faces());
  const auto compute = [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t f = begin; f < end; ++f) {
      Vector3d p[3];
      for (int k = 0; k < 3; ++k) p[k] = mesh.vertices.row(mesh.faces(f, k)) / unit;
      const double doubled_area = (p[1] - p[0]).cross(p[2] - p[0]).norm();
      terms[f].area = 0.5 * doubled_area;
      for (int k = 0; k < 3; ++k) {
        const double dot = (p[(k + 1) % 3] - p[k]).dot(p[(k + 2) % 3] - p[k]);
        const double flat = dot < 0.0 ? pi : 0.0;
        terms[f].angle[k] = doubled_area > 0.0 ? std::atan2(doubled_area, dot) : flat;
        terms[f].weight[k] = std::clamp(0.5 * dot / doubled_area, kMinWeight, kMaxWeight);
      }
    }
  };
  parallel_chunks(mesh.num_faces(), 4096, num_threads, compute, progress);
  return terms;
}

enum class VertexKind : std::uint8_t { kInterior, kBoundary, kNonManifold };

// The faces around a manifold vertex form one fan, connected through edges with two faces. Fans end
// at edges with more faces, so the vertices of such edges have several fans.
std::vector<VertexKind> classify_vertices(const MeshView& mesh) {
  const Edges edges = find_edges(mesh.faces, mesh.num_vertices());
  std::vector<VertexKind> kinds(mesh.num_vertices(), VertexKind::kInterior);
  UnionFind fans(3 * mesh.num_faces());  // of corners
  const auto corner_at = [&](std::int32_t face, std::int32_t vertex) {
    int k = 0;
    while (mesh.faces(face, k) != vertex) ++k;
    return 3 * face + k;
  };
  for (Eigen::Index e = 0; e < edges.size(); ++e) {
    const auto faces = edges.faces_of(e);
    for (const std::int32_t v : {edges.vertices(e, 0), edges.vertices(e, 1)}) {
      if (edges.is_boundary(e)) kinds[v] = std::max(kinds[v], VertexKind::kBoundary);
      if (faces.size() == 2) fans.join(corner_at(faces[0], v), corner_at(faces[1], v));
    }
  }
  std::vector<std::int32_t> first_fan(kinds.size(), -1);
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f) {
    if (is_degenerate(mesh.faces, f)) continue;
    for (int k = 0; k < 3; ++k) {
      const std::int32_t v = mesh.faces(f, k);
      const std::int32_t root = fans.root(static_cast<std::int32_t>(3 * f + k));
      if (first_fan[v] == -1) first_fan[v] = root;
      if (first_fan[v] != root) kinds[v] = VertexKind::kNonManifold;
    }
  }
  return kinds;
}

// Roughness of each vertex, and the area that it represents.
struct Roughness {
  std::vector<double> local;
  std::vector<double> area;
  double total_area = 0.0;
  double mean = 0.0;
  std::int64_t skipped_faces = 0;
  bool is_non_manifold = false;
};

// Gaussian curvature as the angle deficit, not divided by the area. Faces without an area count
// too: at a vertex on the side of a larger face, half of the turn may lie in such a face.
std::vector<double> curvatures(const MeshView& mesh, const std::vector<FaceTerms>& terms,
                               const std::vector<VertexKind>& kinds) {
  std::vector<double> curvature;
  curvature.reserve(kinds.size());
  for (const VertexKind kind : kinds) {
    curvature.push_back(kind == VertexKind::kBoundary ? pi : 2.0 * pi);
  }
  for (Eigen::Index f = 0; f < mesh.num_faces(); ++f) {
    for (int k = 0; k < 3; ++k) curvature[mesh.faces(f, k)] -= terms[f].angle[k];
  }
  return curvature;
}

// Magnitude of the Laplacian of the curvature's magnitude, with cotangent weights; 0 at vertices in
// no face with an area.
std::vector<double> local_roughness(const MeshView& mesh, const std::vector<FaceTerms>& terms,
                                    const std::vector<double>& curvature) {
  std::vector<double> weighted(curvature.size(), 0.0);
  std::vector<double> weights(curvature.size(), 0.0);
  for (Eigen::Index f = 0; f < mesh.num_faces(); ++f) {
    if (!(terms[f].area > 0.0)) continue;
    for (int k = 0; k < 3; ++k) {
      const std::int32_t i = mesh.faces(f, (k + 1) % 3);
      const std::int32_t j = mesh.faces(f, (k + 2) % 3);
      const double w = terms[f].weight[k];
      weighted[i] += w * std::abs(curvature[j]);
      weighted[j] += w * std::abs(curvature[i]);
      weights[i] += w;
      weights[j] += w;
    }
  }
  std::vector<double> local(curvature.size(), 0.0);
  for (std::size_t v = 0; v < local.size(); ++v) {
    if (!(weights[v] > 0.0)) continue;
    local[v] = std::abs(std::abs(curvature[v]) - weighted[v] / weights[v]);
  }
  return local;
}

Roughness measure_roughness(const MeshView& mesh, const char* name, int num_threads,
                            const Progress& progress) {
  const auto terms = face_terms(mesh, num_threads, progress);
  const auto kinds = classify_vertices(mesh);
  Roughness r;
  r.is_non_manifold = std::ranges::find(kinds, VertexKind::kNonManifold) != kinds.end();
  r.area.assign(kinds.size(), 0.0);
  for (Eigen::Index f = 0; f < mesh.num_faces(); ++f) {
    r.skipped_faces += terms[f].area > 0.0 ? 0 : 1;
    r.total_area += terms[f].area;
    for (int k = 0; k < 3; ++k) r.area[mesh.faces(f, k)] += terms[f].area / 3.0;
  }
  if (!(r.total_area > 0.0)) {
    throw InputError(std::string(name) + ": expected a surface with an area");
  }
  r.local = local_roughness(mesh, terms, curvatures(mesh, terms, kinds));
  for (std::size_t v = 0; v < kinds.size(); ++v) r.mean += r.local[v] * r.area[v];
  r.mean /= r.total_area;
  return r;
}

double global_roughness(const Roughness& r, double lower_mean) {
  const double highest = std::max(kMaxRoughness, kMaxOverMean * lower_mean);
  const double least = std::pow(kMinRoughness, kExponent);
  const double turn = std::pow(std::max(lower_mean, kMinRoughness), kExponent) - least;
  double sum = 0.0;
  for (std::size_t v = 0; v < r.local.size(); ++v) {
    const double local = std::clamp(r.local[v], kMinRoughness, highest);
    const double modulated = std::pow(local, kExponent) - least;
    const double excess = std::max(0.0, modulated - turn);
    sum += (modulated - 0.5 * excess) * r.area[v];
  }
  return sum / r.total_area;
}

}  // namespace

FmpdResult fmpd(const MeshView& original, const MeshView& simplified, const FmpdOptions& options,
                const Progress& progress) {
  const NormalizedPair pair(original, simplified);
  const Roughness a = measure_roughness(pair.original(), "original", options.num_threads,
                                        part_of(progress, 0.0, 0.5));
  const Roughness b = measure_roughness(pair.simplified(), "simplified", options.num_threads,
                                        part_of(progress, 0.5, 1.0));
  const double lower_mean = std::min(a.mean, b.mean);
  FmpdResult result;
  result.roughness_original = global_roughness(a, lower_mean);
  result.roughness_simplified = global_roughness(b, lower_mean);
  result.value = kScale * std::abs(result.roughness_original - result.roughness_simplified);
  if (options.clip) result.value = std::min(result.value, 1.0);
  result.skipped_faces = a.skipped_faces + b.skipped_faces;
  result.is_non_manifold = a.is_non_manifold || b.is_non_manifold;
  return result;
}

}  // namespace manip3d
