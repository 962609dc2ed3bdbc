#include "manip3d/geometry/grid_mesh.hpp"

#include <array>
#include <numeric>
#include <string>
#include <vector>

#include "geometry/cell_cut.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/parallel.hpp"

namespace manip3d {
namespace {

double squared_distance(const PointGridView& grid, std::int64_t a, std::int64_t b) {
  const float* p = grid.points + 3 * a;
  const float* q = grid.points + 3 * b;
  double sum = 0.0;
  for (int i = 0; i < 3; ++i) {
    const double difference = static_cast<double>(p[i]) - static_cast<double>(q[i]);
    sum += difference * difference;
  }
  return sum;
}

/// Calls use(a, b, c) for the triangles between a row of pixels and the next one.
template <typename Use>
void for_faces_of_row(const PointGridView& grid, std::int64_t v, double max_edge, const Use& use) {
  const bool limited = max_edge < std::numeric_limits<double>::infinity();
  const double max_squared = max_edge * max_edge;
  for (std::int64_t u = 0; v + 1 < grid.rows && u + 1 < grid.cols; ++u) {
    const auto corner = cell_corners(v * grid.cols + u, grid.cols, grid.rows_up);
    const auto distance = [&](int i, int j) {
      return squared_distance(grid, corner[i], corner[j]);
    };
    unsigned valid = 0;
    for (int i = 0; i < 4; ++i) valid |= (grid.valid[corner[i]] != 0 ? 1U : 0U) << i;
    if (valid == 0) continue;
    for (const auto& [i, j, k] : cell_triangles(cut_cell(valid, distance))) {
      const bool keeps =
          !limited || (distance(i, j) <= max_squared && distance(j, k) <= max_squared &&
                       distance(k, i) <= max_squared);
      if (keeps) use(corner[i], corner[j], corner[k]);
    }
  }
}

// Texture coordinates of the vertices in the colour image or, without one, in the depth image.
void set_texcoords(const PointGridView& grid, const Registration* registration, DepthMesh& mesh) {
  mesh.texcoords.resize(mesh.vertices.rows(), 2);
  for (Eigen::Index i = 0; i < mesh.texcoords.rows(); ++i) {
    const float* p = mesh.vertices.row(i).data();
    const std::array<float, 2> uv =
        registration == nullptr
            ? grid_texcoord(mesh.pixels(i, 0), mesh.pixels(i, 1), static_cast<double>(grid.cols),
                            static_cast<double>(grid.rows))
            : registered_texcoord({p[0], p[1], p[2]}, *registration);
    mesh.texcoords.row(i) << uv[0], uv[1];
  }
}

}  // namespace

DepthMesh grid_mesh(const PointGridView& grid, const GridMeshOptions& options,
                    const Registration* registration) {
  check_point_grid(grid);
  if (!(options.max_edge > 0.0)) {
    throw InputError("max_edge: expected > 0, got " + number_text(options.max_edge));
  }
  // First counts, so that each row knows where to write its vertices and triangles.
  constexpr std::int64_t kRowsPerChunk = 8;
  std::vector<std::int64_t> vertices_before(grid.rows + 1);
  std::vector<std::int64_t> faces_before(grid.rows + 1);
  parallel_chunks(
      grid.rows, kRowsPerChunk, options.num_threads, [&](std::int64_t v0, std::int64_t v1) {
        for (std::int64_t v = v0; v < v1; ++v) {
          const auto slot = static_cast<std::size_t>(v) + 1;
          for (std::int64_t u = 0; u < grid.cols; ++u) {
            vertices_before[slot] += grid.valid[v * grid.cols + u] != 0 ? 1 : 0;
          }
          for_faces_of_row(grid, v, options.max_edge, [&](auto...) { ++faces_before[slot]; });
        }
      });
  std::partial_sum(vertices_before.begin(), vertices_before.end(), vertices_before.begin());
  std::partial_sum(faces_before.begin(), faces_before.end(), faces_before.begin());

  DepthMesh mesh;
  mesh.vertices.resize(vertices_before.back(), 3);
  mesh.pixels.resize(vertices_before.back(), 2);
  mesh.faces.resize(faces_before.back(), 3);
  std::vector<std::int32_t> vertex_of(grid.rows * grid.cols);
  parallel_chunks(
      grid.rows, kRowsPerChunk, options.num_threads, [&](std::int64_t v0, std::int64_t v1) {
        for (std::int64_t v = v0; v < v1; ++v) {
          auto next = vertices_before[v];
          for (std::int64_t u = 0; u < grid.cols; ++u) {
            const std::int64_t pixel = v * grid.cols + u;
            if (grid.valid[pixel] == 0) continue;
            const float* point = grid.points + 3 * pixel;
            mesh.vertices.row(next) << point[0], point[1], point[2];
            mesh.pixels.row(next) << static_cast<std::int32_t>(u), static_cast<std::int32_t>(v);
            vertex_of[pixel] = static_cast<std::int32_t>(next++);
          }
        }
      });
  parallel_chunks(
      grid.rows, kRowsPerChunk, options.num_threads, [&](std::int64_t v0, std::int64_t v1) {
        for (std::int64_t v = v0; v < v1; ++v) {
          auto next = faces_before[v];
          for_faces_of_row(grid, v, options.max_edge,
                           [&](std::int64_t a, std::int64_t b, std::int64_t c) {
                             mesh.faces.row(next++) << vertex_of[a], vertex_of[b], vertex_of[c];
                           });
        }
      });
  set_texcoords(grid, registration, mesh);
  return mesh;
}

}  // namespace manip3d
