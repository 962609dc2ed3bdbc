// Triangulation of arbitrary pixels: an InputError, or counter-clockwise triangles whose
// circumcircles contain no other pixel. With edges that it must have, they stay counter-clockwise.
#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "checks.hpp"
#include "manip3d/error.hpp"
#include "manip3d/simplify/grid_delaunay.hpp"
#include "mesh_from_bytes.hpp"

namespace {

using namespace manip3d;
using fuzzing::require;

std::int64_t turn(Pixel a, Pixel b, Pixel c) {
  return (b.u - a.u) * std::int64_t{c.v - a.v} - (b.v - a.v) * std::int64_t{c.u - a.u};
}

/// > 0 if d lies inside the circle through a, b, c.
std::int64_t in_circle(Pixel a, Pixel b, Pixel c, Pixel d) {
  const auto lifted = [&](Pixel p) {
    return (p.u - d.u) * std::int64_t{p.u - d.u} + (p.v - d.v) * std::int64_t{p.v - d.v};
  };
  return lifted(a) * turn(d, b, c) + lifted(b) * turn(d, c, a) + lifted(c) * turn(d, a, b);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  fuzzing::Bytes bytes(data, std::min<std::size_t>(size, 1024));
  // With small sides, most pixels are cocircular or collinear.
  const std::int32_t side = std::int32_t{1} << (bytes.take<std::uint8_t>() % 15);
  std::vector<Pixel> pixels = {{0, 0}, {side - 1, 0}, {0, side - 1}, {side - 1, side - 1}};
  if (bytes.take<std::uint8_t>() % 2 == 0) pixels.clear();
  while (!bytes.empty()) {
    const auto u = bytes.take<std::uint16_t>(), v = bytes.take<std::uint16_t>();
    pixels.push_back({u % side, v % side});
  }
  GridDelaunay delaunay;
  try {
    delaunay.triangulate(pixels);
  } catch (const InputError&) {
  }
  std::sort(pixels.begin(), pixels.end());
  pixels.erase(std::unique(pixels.begin(), pixels.end()), pixels.end());
  delaunay.triangulate(pixels);
  require(delaunay.num_faces() <= 2 * static_cast<std::int32_t>(pixels.size()));
  for (std::int32_t t = 0; t < delaunay.num_faces(); ++t) {
    const auto [a, b, c] = delaunay.triangle(t);
    require(turn(pixels[a], pixels[b], pixels[c]) > 0);
    for (const Pixel& d : pixels) require(in_circle(pixels[a], pixels[b], pixels[c], d) <= 0);
  }
  const std::int32_t num_faces = delaunay.num_faces();
  const auto n = static_cast<std::int32_t>(pixels.size());
  std::vector<std::array<std::int32_t, 2>> edges;  // many of them cross each other
  for (std::int32_t i = 0; i < n; ++i) edges.push_back({i, (7 * i + 3) % n});
  delaunay.constrain(edges);
  require(delaunay.num_faces() == num_faces);
  for (std::int32_t t = 0; t < num_faces; ++t) {
    const auto [a, b, c] = delaunay.triangle(t);
    require(turn(pixels[a], pixels[b], pixels[c]) > 0);
  }
  return 0;
}
