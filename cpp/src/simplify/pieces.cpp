#include "simplify/pieces.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <limits>

#include "manip3d/geometry/parallel.hpp"
#include "manip3d/geometry/topology.hpp"

namespace manip3d {
namespace {

/// Centroids per piece: enough for a mean distance, few enough for thousands of pieces.
constexpr std::size_t kSamples = 24;

}  // namespace

Pieces::Pieces(const MeshView& mesh, double scale, const Progress& progress)
    : mesh_(mesh), scale_(scale) {
  Components components = find_components(mesh.faces, mesh.num_vertices());
  of_vertex_ = std::move(components.of_vertex);
  if (components.count < 2) return;
  pieces_.resize(components.count);
  for (std::int32_t v = 0; v < mesh.num_vertices(); ++v) {
    if (of_vertex_(v) >= 0) pieces_[of_vertex_(v)].vertices.push_back(v);
  }
  for (std::int32_t f = 0; f < mesh.num_faces(); ++f) {
    if (is_degenerate(mesh.faces, f)) continue;
    Piece& piece = pieces_[of_vertex_(mesh.faces(f, 0))];
    piece.samples.push_back(f);
    piece.area += area(f);
    ++piece.faces;
  }
  for (Piece& piece : pieces_) {
    const std::size_t stride = (piece.samples.size() + kSamples - 1) / kSamples;
    std::size_t kept = 0;
    for (std::size_t i = 0; i < piece.samples.size(); i += stride) {
      piece.samples[kept++] = piece.samples[i];
    }
    piece.samples.resize(kept);
  }
  bvh_ = std::make_unique<TriangleBvh>(mesh, part_of(progress, 0.0, 0.5));
  parallel_chunks(
      size(), 16, 0,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) measure(static_cast<std::int32_t>(i));
      },
      part_of(progress, 0.5, 1.0));
}

Eigen::Vector3d Pieces::centroid(std::int32_t face) const {
  Eigen::RowVector3d sum = Eigen::RowVector3d::Zero();
  for (int c = 0; c < 3; ++c) sum += mesh_.vertices.row(mesh_.faces(face, c)) / 3.0;
  return sum;
}

double Pieces::area(std::int32_t face) const {
  const Eigen::Vector3d p = mesh_.vertices.row(mesh_.faces(face, 0)) / scale_,
                        q = mesh_.vertices.row(mesh_.faces(face, 1)) / scale_,
                        r = mesh_.vertices.row(mesh_.faces(face, 2)) / scale_;
  return 0.5 * (q - p).cross(r - p).norm();
}

double Pieces::mean_distance(std::int32_t piece) const {
  return pieces_[piece].area > 0.0 ? pieces_[piece].cost / pieces_[piece].area : 0.0;
}

bool Pieces::refresh(std::int32_t piece) {
  const auto& nearest = pieces_[piece].nearest;
  if (std::all_of(nearest.begin(), nearest.end(), [&](std::int32_t p) { return is_there(p); })) {
    return false;
  }
  measure(piece);
  return true;
}

void Pieces::measure(std::int32_t index) {
  Piece& piece = pieces_[index];
  piece.nearest.clear();
  double distances = 0.0, areas = 0.0;
  for (const std::int32_t f : piece.samples) {
    const SurfacePoint point = bvh_->closest_point_where(centroid(f), [&](std::int32_t face) {
      const std::int32_t other = of_vertex_(mesh_.faces(face, 0));
      return other >= 0 && other != index && is_there(other);
    });
    if (point.face < 0) {
      piece.cost = std::numeric_limits<double>::infinity();
      return;
    }
    distances += area(f) * (point.distance / scale_);
    areas += area(f);
    const std::int32_t other = of_vertex_(mesh_.faces(point.face, 0));
    if (std::find(piece.nearest.begin(), piece.nearest.end(), other) == piece.nearest.end()) {
      piece.nearest.push_back(other);
    }
  }
  piece.cost = areas > 0.0 ? piece.area * distances / areas : 0.0;
}

}  // namespace manip3d
