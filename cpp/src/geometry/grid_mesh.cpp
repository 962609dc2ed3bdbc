#include "manip3d/geometry/grid_mesh.hpp"

#include <array>
#include <numeric>
#include <string>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/geometry/parallel.hpp"

namespace manip3d {
namespace {

using Triangle = std::array<std::int32_t, 3>;

class CellCutter {
 public:
  CellCutter(const PointGridView& grid, double max_edge)
      : grid_(grid), max_squared_(max_edge * max_edge) {}

  /// Writes the triangles of the cell below and right of `pixel`, as pixels; returns how many.
  int cut(std::int64_t pixel, std::array<Triangle, 2>& out) const {
    // Counter-clockwise with rows up; the other way round where rows go down.
    std::array<std::int64_t, 4> around = {pixel, pixel + 1, pixel + grid_.cols + 1,
                                          pixel + grid_.cols};
    if (!grid_.rows_up) std::swap(around[1], around[3]);
    std::array<std::int32_t, 4> corner{};
    std::size_t count = 0;
    for (const std::int64_t p : around) {
      if (grid_.valid[p] != 0) corner[count++] = static_cast<std::int32_t>(p);
    }
    if (count < 3) return 0;
    if (count == 3) return keep({corner[0], corner[1], corner[2]}, out, 0);
    const bool from_first =
        squared_distance(corner[0], corner[2]) <= squared_distance(corner[1], corner[3]);
    const std::size_t a = from_first ? 0 : 1;
    const int kept = keep({corner[a], corner[a + 1], corner[a + 2]}, out, 0);
    return keep({corner[a], corner[a + 2], corner[(a + 3) % 4]}, out, kept);
  }

 private:
  [[nodiscard]] double squared_distance(std::int32_t a, std::int32_t b) const {
    const float* p = grid_.points + 3 * std::int64_t{a};
    const float* q = grid_.points + 3 * std::int64_t{b};
    double sum = 0.0;
    for (int i = 0; i < 3; ++i) {
      const double difference = static_cast<double>(p[i]) - static_cast<double>(q[i]);
      sum += difference * difference;
    }
    return sum;
  }

  int keep(const Triangle& t, std::array<Triangle, 2>& out, int count) const {
    if (max_squared_ < std::numeric_limits<double>::infinity()) {
      for (std::size_t i = 0; i < 3; ++i) {
        if (!(squared_distance(t[i], t[(i + 1) % 3]) <= max_squared_)) return count;
      }
    }
    out[static_cast<std::size_t>(count)] = t;
    return count + 1;
  }

  const PointGridView& grid_;
  double max_squared_;
};

}  // namespace

DepthMesh grid_mesh(const PointGridView& grid, const GridMeshOptions& options,
                    const Registration* registration) {
  check_point_grid(grid);
  if (!(options.max_edge > 0.0)) {
    throw InputError("max_edge: expected > 0, got " + std::to_string(options.max_edge));
  }
  const CellCutter cutter(grid, options.max_edge);
  const auto in_row = [&](std::int64_t v, const auto& use) {
    std::array<Triangle, 2> triangles{};
    for (std::int64_t u = 0; v + 1 < grid.rows && u + 1 < grid.cols; ++u) {
      const int count = cutter.cut(v * grid.cols + u, triangles);
      for (int i = 0; i < count; ++i) use(triangles[static_cast<std::size_t>(i)]);
    }
  };
  // First count, so that each row knows where its vertices and triangles go.
  constexpr std::int64_t kRowsPerChunk = 8;
  std::vector<std::int64_t> vertices_before(static_cast<std::size_t>(grid.rows) + 1);
  std::vector<std::int64_t> triangles_before(static_cast<std::size_t>(grid.rows) + 1);
  parallel_chunks(grid.rows, kRowsPerChunk, options.num_threads,
                  [&](std::int64_t v0, std::int64_t v1) {
                    for (std::int64_t v = v0; v < v1; ++v) {
                      const auto slot = static_cast<std::size_t>(v) + 1;
                      for (std::int64_t u = 0; u < grid.cols; ++u) {
                        vertices_before[slot] += grid.valid[v * grid.cols + u] != 0 ? 1 : 0;
                      }
                      in_row(v, [&](const Triangle&) { ++triangles_before[slot]; });
                    }
                  });
  std::partial_sum(vertices_before.begin(), vertices_before.end(), vertices_before.begin());
  std::partial_sum(triangles_before.begin(), triangles_before.end(), triangles_before.begin());

  DepthMesh mesh;
  mesh.vertices.resize(vertices_before.back(), 3);
  mesh.pixels.resize(vertices_before.back(), 2);
  mesh.triangles.resize(triangles_before.back(), 3);
  std::vector<std::int32_t> vertex_of(static_cast<std::size_t>(grid.rows * grid.cols));
  parallel_chunks(
      grid.rows, kRowsPerChunk, options.num_threads, [&](std::int64_t v0, std::int64_t v1) {
        for (std::int64_t v = v0; v < v1; ++v) {
          auto next = vertices_before[static_cast<std::size_t>(v)];
          for (std::int64_t u = 0; u < grid.cols; ++u) {
            const std::int64_t pixel = v * grid.cols + u;
            if (grid.valid[pixel] == 0) continue;
            const float* point = grid.points + 3 * pixel;
            mesh.vertices.row(next) << point[0], point[1], point[2];
            mesh.pixels.row(next) << static_cast<std::int32_t>(u), static_cast<std::int32_t>(v);
            vertex_of[static_cast<std::size_t>(pixel)] = static_cast<std::int32_t>(next++);
          }
        }
      });
  parallel_chunks(
      grid.rows, kRowsPerChunk, options.num_threads, [&](std::int64_t v0, std::int64_t v1) {
        for (std::int64_t v = v0; v < v1; ++v) {
          auto next = triangles_before[static_cast<std::size_t>(v)];
          in_row(v, [&](const Triangle& t) {
            for (int i = 0; i < 3; ++i) {
              const auto pixel = static_cast<std::size_t>(t[static_cast<std::size_t>(i)]);
              mesh.triangles(next, i) = vertex_of[pixel];
            }
            ++next;
          });
        }
      });
  mesh.uvs.resize(mesh.vertices.rows(), 2);
  for (Eigen::Index i = 0; i < mesh.uvs.rows(); ++i) {
    const float* p = mesh.vertices.row(i).data();
    const std::array<float, 2> uv =
        registration == nullptr
            ? grid_uv(mesh.pixels(i, 0), mesh.pixels(i, 1), static_cast<double>(grid.cols),
                      static_cast<double>(grid.rows))
            : registered_uv({p[0], p[1], p[2]}, *registration);
    mesh.uvs.row(i) << uv[0], uv[1];
  }
  return mesh;
}

}  // namespace manip3d
