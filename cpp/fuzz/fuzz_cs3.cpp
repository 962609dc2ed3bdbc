// CS3 on arbitrary depth images and grids of points: an InputError, or a mesh of at most n points
// whose triangles lie over valid pixels; the same for one thread and for two.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "checks.hpp"
#include "manip3d/error.hpp"
#include "manip3d/simplify/cs3.hpp"
#include "mesh_from_bytes.hpp"

namespace {

using namespace manip3d;
using fuzzing::require;

Cs3Options take_options(fuzzing::Bytes& bytes) {
  Cs3Options options;
  options.num_threads = 1;
  options.target_points = bytes.take<std::uint8_t>();
  const auto choices = bytes.take<std::uint16_t>();
  options.importance = static_cast<Cs3Importance>(choices % 2);
  options.sampling = static_cast<Cs3Sampling>(choices / 2 % 2);
  options.distance_dependent = choices / 4 % 2 == 1;
  options.reading.stencil = static_cast<Cs3Reading::Stencil>(choices / 8 % 4);
  options.reading.beside_invalid = static_cast<Cs3Reading::BesideInvalid>(choices / 32 % 3);
  options.reading.rounding = static_cast<Cs3Reading::Rounding>(choices / 128 % 3);
  options.reading.outliers = bytes.take<std::uint8_t>() / 256.0;
  if (choices / 512 % 4 == 0) options.max_edge = bytes.take<float>();
  return options;
}

void check(const RangeImage& image, const Cs3Options& options) {
  const Cs3Result one = simplify_cs3(image, options);
  const auto& mesh = one.mesh;
  require(mesh.vertices.rows() <= options.target_points);
  require(mesh.vertices.allFinite());
  for (Eigen::Index t = 0; t < mesh.faces.rows(); ++t) {
    for (int i = 0; i < 3; ++i) {
      require(mesh.faces(t, i) >= 0 && mesh.faces(t, i) < mesh.vertices.rows());
    }
    const auto a = mesh.pixels.row(mesh.faces(t, 0)), b = mesh.pixels.row(mesh.faces(t, 1)),
               c = mesh.pixels.row(mesh.faces(t, 2));
    const int turn = (b(0) - a(0)) * (c(1) - a(1)) - (b(1) - a(1)) * (c(0) - a(0));
    require(image.rows_up() ? turn > 0 : turn < 0);
    const auto centroid = a + b + c;
    require(std::isfinite(image.point((2 * centroid(0) + 3) / 6, (2 * centroid(1) + 3) / 6)[2]));
  }
  Cs3Options threads = options;
  threads.num_threads = 2;
  const Cs3Result two = simplify_cs3(image, threads);
  require(two.mesh.pixels == mesh.pixels && two.mesh.faces == mesh.faces);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  fuzzing::Bytes bytes(data, std::min<std::size_t>(size, 4096));
  const std::int64_t cols = 1 + bytes.take<std::uint8_t>() % 80;
  const std::int64_t rows = 1 + bytes.take<std::uint8_t>() % 64;
  const Cs3Options options = take_options(bytes);
  const auto kind = bytes.take<std::uint8_t>() % 3;
  const auto count = static_cast<std::size_t>(rows * cols);
  try {
    const PixelRays rays({cols,
                          rows,
                          50.0,
                          kind == 0 ? 50.0 : -40.0,
                          20.5,
                          10.0,
                          {},
                          nullptr,
                          options.target_points % 2 == 1});
    if (kind == 0) {
      std::vector<std::uint16_t> depth(count);
      for (auto& z : depth) z = bytes.take<std::uint16_t>();
      check(RangeImage(DepthView{rows, cols, depth.data(), nullptr}, rays), options);
    } else if (kind == 1) {
      std::vector<float> depth(count);
      for (auto& z : depth) z = bytes.take<float>();
      check(RangeImage(DepthView{rows, cols, nullptr, depth.data()}, rays), options);
    } else {
      std::vector<float> points(3 * count);
      std::vector<std::uint8_t> valid(count);
      for (std::size_t i = 0; i < count; ++i) {
        valid[i] = bytes.take<std::uint8_t>() % 2;
        points[3 * i] = static_cast<float>(i % static_cast<std::size_t>(cols));
        points[3 * i + 1] = static_cast<float>(i / static_cast<std::size_t>(cols));
        points[3 * i + 2] = bytes.take<float>();
      }
      check(RangeImage({rows, cols, points.data(), valid.data(), options.target_points % 2 == 1}),
            options);
    }
  } catch (const InputError&) {
  }
  return 0;
}
