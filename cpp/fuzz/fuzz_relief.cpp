// The relief of arbitrary grids of points, frame by frame: an InputError, or meshes with at most
// the wanted number of points. These are planar, state whether they bridge pixels without depth,
// and have a face wherever the dense surface has one; the same for one thread and for two.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <set>
#include <utility>
#include <vector>

#include "checks.hpp"
#include "manip3d/error.hpp"
#include "manip3d/simplify/relief.hpp"
#include "mesh_from_bytes.hpp"

namespace {

using namespace manip3d;
using fuzzing::require;

struct Grid {
  std::int64_t rows, cols;
  bool rows_up;
  bool any_bits;
  std::vector<float> points;
  std::vector<std::uint8_t> valid;
  [[nodiscard]] PointGridView view() const {
    return {rows, cols, points.data(), valid.data(), rows_up};
  }
};

// Heights of arbitrary bits, or small whole numbers, which form planes and steps.
void fill(fuzzing::Bytes& bytes, Grid& grid) {
  for (std::size_t i = 0; i < grid.valid.size(); ++i) {
    const auto byte = bytes.take<std::uint8_t>();
    grid.valid[i] = byte % 4 != 0 ? 1 : 0;
    grid.points[3 * i] = static_cast<float>(i % static_cast<std::size_t>(grid.cols));
    grid.points[3 * i + 1] = static_cast<float>(i / static_cast<std::size_t>(grid.cols));
    grid.points[3 * i + 2] =
        grid.any_bits ? bytes.take<float>() : 50.0F + static_cast<float>(byte / 16);
  }
}

std::vector<float> take_confidence(fuzzing::Bytes& bytes, std::size_t count) {
  std::vector<float> confidence(count);
  for (float& share : confidence) share = static_cast<float>(bytes.take<std::uint8_t>()) / 255.0F;
  return confidence;
}

ReliefOptions take_options(fuzzing::Bytes& bytes) {
  ReliefOptions options;
  options.num_threads = 1;
  const auto choices = bytes.take<std::uint16_t>();
  options.target_points = bytes.take<std::uint8_t>();
  options.effort = static_cast<ReliefEffort>(choices % 5);
  options.from_origin = choices / 8 % 2 == 1;
  if (choices / 16 % 2 == 1) options.dense.max_edge = bytes.take<float>();
  if (choices / 32 % 2 == 1) options.stability = 1.0 + bytes.take<std::uint8_t>();
  options.move_points = choices / 64 % 2 == 1;
  for (int i = choices / 128 % 4; i > 0; --i) options.levels.push_back(bytes.take<std::uint8_t>());
  if (choices / 512 % 2 == 1) options.dense.max_step = bytes.take<float>();
  return options;
}

using Pixels = Rows<std::int32_t, 2>;

// Excludes the checks from coverage, so that the fuzzer does not search for inputs that reach new
// code in them.
#define MANIP3D_UNCOUNTED __attribute__((no_sanitize("coverage")))

// Is (u, v), in half pixels, strictly inside triangle t?
MANIP3D_UNCOUNTED bool is_inside(const Pixels& p, const Faces& faces, Eigen::Index t, int u,
                                 int v) {
  for (int i = 0; i < 3; ++i) {
    const auto a = p.row(faces(t, i)), b = p.row(faces(t, (i + 1) % 3));
    if ((b(0) - a(0)) * (v - 2 * a(1)) - (b(1) - a(1)) * (u - 2 * a(0)) <= 0) return false;
  }
  return true;
}

/// Checks that all vertices are used, and that triangles are oriented correctly, share edges like
/// those of a surface, and do not overlap.
/// @returns  true if a triangle lies over a pixel that is not valid, for example in a closed hole.
MANIP3D_UNCOUNTED bool check_surface(const Grid& grid, const Pixels& pixels, Faces faces,
                                     std::int64_t num_vertices) {
  bool bridges = false;
  std::set<std::pair<std::int32_t, std::int32_t>> edges;
  std::vector<bool> used(num_vertices);
  const std::int64_t width = 2 * grid.cols;
  std::vector<std::uint8_t> covered(2 * grid.rows * width);
  for (Eigen::Index t = 0; t < faces.rows(); ++t) {
    if (!grid.rows_up) std::swap(faces(t, 1), faces(t, 2));
    for (int i = 0; i < 3; ++i) {
      require(faces(t, i) >= 0 && faces(t, i) < num_vertices);
      used[faces(t, i)] = true;
      require(edges.emplace(faces(t, i), faces(t, (i + 1) % 3)).second);
    }
    const auto a = pixels.row(faces(t, 0)), b = pixels.row(faces(t, 1)),
               c = pixels.row(faces(t, 2));
    require((b(0) - a(0)) * (c(1) - a(1)) - (b(1) - a(1)) * (c(0) - a(0)) > 0);
    const int u0 = 2 * std::min({a(0), b(0), c(0)}), u1 = 2 * std::max({a(0), b(0), c(0)});
    const int v0 = 2 * std::min({a(1), b(1), c(1)}), v1 = 2 * std::max({a(1), b(1), c(1)});
    for (int v = v0; v <= v1; ++v) {
      for (int u = u0; u <= u1; ++u) {
        if (!is_inside(pixels, faces, t, u, v)) continue;
        require(++covered[v * width + u] == 1);
        const bool at_pixel = u % 2 == 0 && v % 2 == 0;
        bridges = bridges || (at_pixel && grid.valid[v / 2 * grid.cols + u / 2] == 0);
      }
    }
  }
  require(std::all_of(used.begin(), used.end(), [](bool is) { return is; }));
  return bridges;
}

MANIP3D_UNCOUNTED void check(const Grid& grid, const ReliefOptions& options,
                             const ReliefResult& result) {
  const DepthMesh& mesh = result.mesh;
  require(mesh.vertices.rows() <= options.target_points);
  require(mesh.pixels.rows() == mesh.vertices.rows() &&
          mesh.texcoords.rows() == mesh.vertices.rows());
  for (Eigen::Index i = 0; i < mesh.pixels.rows(); ++i) {
    const auto at = static_cast<std::size_t>(mesh.pixels(i, 1) * grid.cols + mesh.pixels(i, 0));
    require(grid.valid[at] != 0);
    for (int k = 0; k < 3 && !options.move_points; ++k) {
      require(mesh.vertices(i, k) == grid.points[3 * at + static_cast<std::size_t>(k)]);
    }
  }
  const bool bridges = check_surface(grid, mesh.pixels, mesh.faces, mesh.vertices.rows());
  // areas may overflow with arbitrary bits
  require(!bridges || result.cover.bridges > 0.0 || grid.any_bits);
  const bool has_surface =
      result.cover.outside < 1.0 &&
      std::any_of(grid.valid.begin(), grid.valid.end(), [](std::uint8_t is) { return is != 0; });
  if (has_surface && options.levels.empty()) {
    require(mesh.faces.rows() > 0);
    require(result.off.empty() ||
            std::find(result.off.begin(), result.off.end(), 0) != result.off.end());
  }
  require(result.levels.size() == options.levels.size());
  for (std::size_t i = 0; i < result.levels.size(); ++i) {
    require(result.levels[i].num_vertices <= options.levels[i]);
    check_surface(grid, mesh.pixels, result.levels[i].faces, result.levels[i].num_vertices);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  fuzzing::Bytes bytes(data, std::min<std::size_t>(size, 4096));
  const std::int64_t cols = 1 + bytes.take<std::uint8_t>() % 32;
  const std::int64_t rows = 1 + bytes.take<std::uint8_t>() % 24;
  const auto kind = bytes.take<std::uint8_t>();
  const ReliefOptions options = take_options(bytes);
  const auto count = static_cast<std::size_t>(rows * cols);
  Grid grid{rows,
            cols,
            kind % 2 == 0,
            kind / 8 % 4 == 0,
            std::vector<float>(3 * count),
            std::vector<std::uint8_t>(count)};
  Relief one, two;
  ReliefOptions threads = options;
  threads.num_threads = 2;
  ReliefResult result, same;
  std::vector<float> confidence;
  const int num_frames = kind / 2 % 4 == 0 ? 2 : 1;
  try {
    for (int frame = 0; frame < num_frames; ++frame) {
      fill(bytes, grid);
      if (kind / 2 % 4 == 1) confidence = take_confidence(bytes, count);
      one.run(grid.view(), options, result, confidence);
      check(grid, options, result);
      if (kind / 32 != 0) continue;
      two.run(grid.view(), threads, same, confidence);
      require(same.mesh.pixels == result.mesh.pixels);
      require(same.mesh.faces == result.mesh.faces);
    }
  } catch (const InputError&) {
  }
  return 0;
}
